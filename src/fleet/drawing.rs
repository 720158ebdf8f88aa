//! Drawings: what the drawing of a family asks of a quantity, as the technician writes it. `docs/fleet.md` describes the file.
//!
//! ```toml
//! [family.F1.rate_n_per_mm]
//! nominal = "55.0 N/mm"
//! tolerance = "7 %"
//! ```

use std::collections::{BTreeMap, BTreeSet};

use serde::Deserialize;
use toml::{Spanned, Value};

use super::estimate::{EstimateRow, EstimateScale};
use crate::nearest;
use crate::profile::reader::line_column;

/// What drawings ask, family by family and quantity by quantity.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Drawings {
    /// Name of the file, for messages.
    file: String,
    families: BTreeMap<String, BTreeMap<String, DrawnLimits>>,
}

/// What a drawing asks of one quantity. At least one limit is there.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DrawnLimits {
    /// In the unit of the quantity; without it the mean of the family stands for it.
    pub nominal: Option<f64>,
    pub at_least: Option<DrawnLimit>,
    pub at_most: Option<DrawnLimit>,
    /// The limits as they are written: "tolerance 7 %".
    pub words: String,
    /// The unit that the values are written in; `None` if all are in percent.
    unit: Option<String>,
}

impl DrawnLimits {
    /// True if the mean of the family stands for the nominal.
    pub(super) fn about_family_mean(&self) -> bool {
        let of_nominal =
            |limit: &Option<DrawnLimit>| matches!(limit, Some(DrawnLimit::Offset(_) | DrawnLimit::Share(_)));
        self.nominal.is_none() && [self.at_least, self.at_most].iter().any(of_nominal)
    }

    /// True if a limit is a share of the mean of the family.
    fn is_share_of_mean(&self) -> bool {
        let share = |limit: &Option<DrawnLimit>| matches!(limit, Some(DrawnLimit::Share(_)));
        self.nominal.is_none() && [self.at_least, self.at_most].iter().any(share)
    }
}

/// A limit of a quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum DrawnLimit {
    /// A value in the unit of the quantity.
    Value(f64),
    /// A difference from the nominal, in the unit of the quantity.
    Offset(f64),
    /// A share of the nominal: 1.07 is 7 % above it.
    Share(f64),
}

impl DrawnLimit {
    /// The limit in the unit of the quantity.
    pub(super) fn at(self, nominal: f64) -> f64 {
        match self {
            DrawnLimit::Value(value) => value,
            DrawnLimit::Offset(offset) => nominal + offset,
            DrawnLimit::Share(share) => nominal * share,
        }
    }
}

/// Why a file of drawings cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DrawingError {
    /// A text that is no such file, or a value that means nothing.
    #[error("{file}, line {line}: {key}{reason}")]
    Text {
        file: String,
        line: usize,
        /// The key with its tables and ": "; empty where the whole line is wrong.
        key: String,
        reason: String,
    },
    /// None of the families is in the table of estimates.
    #[error(
        "{file}: none of its families is in the table of estimates, which has {known}: name them as specimens.csv does"
    )]
    NoFamily { file: String, known: String },
    /// A quantity that is not in the table of estimates.
    #[error(
        "{place}: the table of estimates has no such quantity{meant}; it has {known}: rename or remove it"
    )]
    UnknownQuantity {
        /// File and key.
        place: String,
        /// ": did you mean NAME?" or nothing.
        meant: String,
        known: String,
    },
    /// Percent of the mean of a quantity that may be 0.
    #[error(
        "{place}: percent of a mean that may be 0 mean nothing: add nominal, or enter the limits in {unit}"
    )]
    PercentOfMean {
        /// File and key.
        place: String,
        unit: String,
    },
    /// A value in another unit than the estimates.
    #[error("{place}: it is written in \"{written}\", but estimated in \"{unit}\": enter it in {unit}")]
    Unit {
        /// File and key.
        place: String,
        written: String,
        unit: String,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawDrawings {
    family: BTreeMap<String, BTreeMap<String, Spanned<RawLimits>>>,
}

/// Values as text with their unit; those of a pure number may be numbers.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawLimits {
    nominal: Option<Spanned<Value>>,
    tolerance: Option<Spanned<Value>>,
    at_least: Option<Spanned<Value>>,
    at_most: Option<Spanned<Value>>,
}

/// A number with the unit that is written behind it.
#[derive(Debug, Clone, PartialEq)]
struct WrittenValue {
    number: f64,
    unit: String,
}

impl WrittenValue {
    /// Reads `7 %`, `62.0 N/mm` or a plain number, which has the unit `1`.
    fn of(value: &Value) -> Result<WrittenValue, String> {
        let text = match value {
            Value::String(text) => text.trim().to_owned(),
            Value::Integer(number) => number.to_string(),
            Value::Float(number) => number.to_string(),
            _ => return Err("it is no value: write it as on the drawing, such as \"7 %\"".to_owned()),
        };
        let is_of_number = |c: char| c.is_ascii_digit() || matches!(c, '+' | '-' | '.');
        let end = text.find(|c| !is_of_number(c)).unwrap_or(text.len());
        let (number, unit) = (&text[..end], text[end..].trim());
        if unit.starts_with(',') {
            return Err(format!("\"{text}\" has a comma: write a decimal point"));
        }
        let number = number.parse::<f64>().ok().filter(|n| n.is_finite());
        Ok(WrittenValue {
            number: number.ok_or_else(|| {
                format!(
                    "\"{text}\" does not begin with a number: write it as on the drawing, such as \"7 %\""
                )
            })?,
            unit: if unit.is_empty() {
                "1".to_owned()
            } else {
                unit.to_owned()
            },
        })
    }

    fn is_percent(&self) -> bool {
        self.unit == "%"
    }

    /// The value in a sentence.
    fn words(&self) -> String {
        match self.unit.as_str() {
            "1" => self.number.to_string(),
            unit => format!("{} {unit}", self.number),
        }
    }
}

/// What is wrong with a key, and the key.
type WrongKey = (&'static str, String);

impl RawLimits {
    /// The limits; an error names the key and what is wrong with it.
    fn limits(&self) -> Result<DrawnLimits, WrongKey> {
        let read = |key: &'static str, value: &Option<Spanned<Value>>| {
            let value = value.as_ref().map(|v| WrittenValue::of(v.get_ref()));
            value.transpose().map_err(|reason| (key, reason))
        };
        let nominal = read("nominal", &self.nominal)?;
        let tolerance = read("tolerance", &self.tolerance)?;
        let [at_least, at_most] = [read("at_least", &self.at_least)?, read("at_most", &self.at_most)?];
        let (bounds, words) = match (&tolerance, &at_least, &at_most) {
            (None, None, None) => {
                return Err((
                    "",
                    "it has no limit: add tolerance, at_least or at_most".to_owned(),
                ));
            }
            (Some(tolerance), None, None) => (
                about_nominal(tolerance)?,
                format!("tolerance {}", tolerance.words()),
            ),
            (Some(_), ..) => {
                let reason = "it stands beside at_least or at_most: remove one of them".to_owned();
                return Err(("tolerance", reason));
            }
            _ => one_sided(&at_least, &at_most)?,
        };
        check_nominal(nominal.as_ref(), bounds)?;
        let written = [
            ("nominal", &nominal),
            ("tolerance", &tolerance),
            ("at_least", &at_least),
            ("at_most", &at_most),
        ];
        Ok(DrawnLimits {
            nominal: nominal.as_ref().map(|n| n.number),
            at_least: bounds[0],
            at_most: bounds[1],
            words,
            unit: one_unit(&written)?,
        })
    }
}

/// A lower and an upper limit.
type DrawnBounds = [Option<DrawnLimit>; 2];

fn check_nominal(nominal: Option<&WrittenValue>, bounds: DrawnBounds) -> Result<(), WrongKey> {
    let Some(nominal) = nominal else { return Ok(()) };
    if nominal.is_percent() {
        return Err((
            "nominal",
            "it is in percent: enter it in the unit of the quantity".to_owned(),
        ));
    }
    let in_percent = bounds.iter().any(|b| matches!(b, Some(DrawnLimit::Share(_))));
    match in_percent && nominal.number <= 0.0 {
        true => Err((
            "nominal",
            "it is not above 0, so percent of it mean nothing: enter the limits in the unit".to_owned(),
        )),
        false => Ok(()),
    }
}

/// The limits of a tolerance to both sides of the nominal.
fn about_nominal(tolerance: &WrittenValue) -> Result<DrawnBounds, WrongKey> {
    let number = tolerance.number;
    if number <= 0.0 {
        return Err(("tolerance", "it must be above 0".to_owned()));
    }
    match tolerance.is_percent() {
        true if number >= 100.0 => {
            let reason = "100 % and more leave no lower limit: enter at_most in place of it".to_owned();
            Err(("tolerance", reason))
        }
        true => Ok([-number, number].map(|n| Some(DrawnLimit::Share(1.0 + 0.01 * n)))),
        false => Ok([-number, number].map(|n| Some(DrawnLimit::Offset(n)))),
    }
}

/// The limits of `at_least` and `at_most`, of which one is there or both, and their words.
fn one_sided(
    at_least: &Option<WrittenValue>,
    at_most: &Option<WrittenValue>,
) -> Result<(DrawnBounds, String), WrongKey> {
    if let (Some(low), Some(high)) = (at_least, at_most) {
        if low.is_percent() != high.is_percent() {
            let reason = "one limit is in percent and the other is not: enter both in percent or in the unit";
            return Err(("at_least", reason.to_owned()));
        }
        if low.number >= high.number {
            return Err((
                "at_least",
                "it is not below at_most: correct one of them".to_owned(),
            ));
        }
    }
    let limit = |value: &WrittenValue| match value.is_percent() {
        true => DrawnLimit::Share(0.01 * value.number),
        false => DrawnLimit::Value(value.number),
    };
    let words = |(what, value): (&str, &Option<WrittenValue>)| {
        let of_nominal = |v: &WrittenValue| if v.is_percent() { " of the nominal" } else { "" };
        value
            .as_ref()
            .map(|v| format!("{what} {}{}", v.words(), of_nominal(v)))
    };
    let both = [("at least", at_least), ("at most", at_most)];
    let words: Vec<String> = both.into_iter().filter_map(words).collect();
    let bounds = [at_least, at_most].map(|value| value.as_ref().map(limit));
    Ok((bounds, words.join(", ")))
}

/// The unit that all values share which are not in percent.
fn one_unit(written: &[(&'static str, &Option<WrittenValue>)]) -> Result<Option<String>, WrongKey> {
    let mut unit: Option<&str> = None;
    let values = written
        .iter()
        .filter_map(|(key, value)| Some((*key, value.as_ref()?)));
    for (key, value) in values.filter(|(_, v)| !v.is_percent()) {
        match unit {
            Some(first) if first != value.unit => {
                let reason = format!(
                    "it is in {}, and another value in {first}: enter all in one unit",
                    value.unit
                );
                return Err((key, reason));
            }
            _ => unit = Some(&value.unit),
        }
    }
    Ok(unit.map(str::to_owned))
}

impl Drawings {
    /// Reads the text of a file; `file` is its name, for messages.
    pub(crate) fn read(file: &str, text: &str) -> Result<Drawings, DrawingError> {
        let refuse = |at: usize, key: String, reason: String| DrawingError::Text {
            file: file.to_owned(),
            line: line_column(text, at).0,
            key,
            reason,
        };
        let raw: RawDrawings = toml::from_str(text).map_err(|e| {
            let at = e.span().map_or(0, |span| span.start);
            refuse(at, String::new(), in_words(e.message()))
        })?;
        let mut families = BTreeMap::new();
        for (family, quantities) in raw.family {
            let of_family: &mut BTreeMap<_, _> = families.entry(family.clone()).or_default();
            for (quantity, raw) in quantities {
                let limits = raw.get_ref().limits().map_err(|(key, reason)| {
                    let point = if key.is_empty() { "" } else { "." };
                    let key = format!("family.{family}.{quantity}{point}{key}: ");
                    refuse(raw.span().start, key, reason)
                })?;
                of_family.insert(quantity, limits);
            }
        }
        Ok(Drawings {
            file: file.to_owned(),
            families,
        })
    }

    /// What the drawing of a family asks of a quantity.
    pub(super) fn limits(&self, family: &str, quantity: &str) -> Option<&DrawnLimits> {
        self.families.get(family)?.get(quantity)
    }

    /// Checks that the table of estimates has the families, quantities and units.
    pub(super) fn check(&self, rows: &[EstimateRow]) -> Result<(), DrawingError> {
        let families: BTreeSet<&str> = rows.iter().map(|row| row.family.as_str()).collect();
        let of_quantity = |row: &EstimateRow| (row.unit.clone(), row.scale);
        let units: BTreeMap<&str, (String, EstimateScale)> = rows
            .iter()
            .map(|row| (row.quantity.as_str(), of_quantity(row)))
            .collect();
        let file = &self.file;
        if !self
            .families
            .keys()
            .any(|family| families.contains(family.as_str()))
        {
            return Err(DrawingError::NoFamily {
                file: file.clone(),
                known: families.into_iter().collect::<Vec<_>>().join(", "),
            });
        }
        let asked = self
            .families
            .iter()
            .flat_map(|(f, of)| of.iter().map(move |(q, l)| (f, q, l)));
        for (family, quantity, limits) in asked {
            let place = format!("{file}, family.{family}.{quantity}");
            let Some((unit, scale)) = units.get(quantity.as_str()) else {
                let known: Vec<&str> = units.into_keys().collect();
                return Err(DrawingError::UnknownQuantity {
                    place,
                    meant: nearest::question(nearest::name(quantity, &known)),
                    known: known.join(", "),
                });
            };
            let unit = unit.clone();
            if let Some(written) = limits.unit.clone().filter(|written| *written != unit) {
                return Err(DrawingError::Unit { place, written, unit });
            }
            if *scale == EstimateScale::Absolute && limits.is_share_of_mean() {
                return Err(DrawingError::PercentOfMean { place, unit });
            }
        }
        Ok(())
    }

    /// The families that the table of estimates does not have, one sentence each.
    pub(super) fn families_without_runs(&self, rows: &[EstimateRow]) -> Vec<String> {
        let known: BTreeSet<&str> = rows.iter().map(|row| row.family.as_str()).collect();
        let unknown = self
            .families
            .keys()
            .filter(|family| !known.contains(family.as_str()));
        let known: Vec<&str> = known.iter().copied().collect();
        let sentence = |family: &String| {
            let file = &self.file;
            let meant = nearest::question(nearest::name(family, &known));
            format!(
                "No specimen of family {family} of {file} is in the table, so none was judged by its drawing{meant}."
            )
        };
        unknown
            .map(|family| sentence(family).replace("?.", "?"))
            .collect()
    }
}

/// What the reader of TOML says, with the key that a mistyped one stands for.
fn in_words(message: &str) -> String {
    let message = message.trim().replace('\n', "; ");
    let known = ["nominal", "tolerance", "at_least", "at_most"];
    let wrong = message
        .strip_prefix("unknown field `")
        .and_then(|rest| rest.split('`').next());
    let meant = wrong.and_then(|wrong| nearest::name(wrong, &known));
    match wrong {
        Some(wrong) => format!(
            "unknown key {wrong}{}; correct or remove it",
            nearest::question(meant)
        ),
        None => format!("{message}: correct it"),
    }
}

#[cfg(test)]
mod tests;
