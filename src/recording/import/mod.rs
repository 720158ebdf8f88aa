//! Foreign tables as recordings: other column names, units, separators and decimal signs, a preamble, no time, a wrong sign.
//!
//! `text` decodes the bytes, `layout` finds the table, `mapping` says which column is what (with `unit`), `values` reads the
//! cells (with `number`); `view` shows the table before that, `save` writes the recording. Everything that was decided is in [`Imported`], so that the caller can show it: nothing is guessed
//! silently.

mod error;
mod imported;
mod layout;
mod mapping;
mod number;
mod save;
mod text;
mod unit;
mod values;
mod view;

pub(crate) use error::ImportError;
pub(crate) use imported::Imported;
pub(crate) use mapping::{MapEntry, MapTarget, MappedColumn, parse_map};
pub(crate) use number::DecimalSign;
pub(crate) use save::{ImportSource, save};
pub(crate) use view::view;

use super::Recording;
use values::ValueReader;

/// Largest size of a foreign file in bytes: some 10 million rows.
pub(crate) const IMPORT_MAX_BYTES: u64 = 1 << 29;

/// Share of the samples by which displacement or force lies on the negative side before the caller is told.
const MOSTLY: f64 = 0.9;

/// What the user says about a foreign table.
#[derive(Debug, Clone, Default)]
pub(crate) struct ImportOptions {
    /// What the columns are; empty to take them from names and units.
    pub map: Vec<MapEntry>,
    /// Time between two samples in s, in place of a column of time.
    pub interval_s: Option<f64>,
    /// Decimal sign of the numbers; `None` takes it from the cells.
    pub decimal: Option<DecimalSign>,
    /// Turns the sign of the force.
    pub flip_force: bool,
    /// Turns the sign of the displacement.
    pub flip_displacement: bool,
}

/// Reads a foreign table. `name` is for messages.
pub(crate) fn import(name: &str, bytes: &[u8], options: &ImportOptions) -> Result<Imported, ImportError> {
    let (text, encoding) = text::decode(name, bytes)?;
    let layout = layout::find(name, &text)?;
    let guessed = options.map.is_empty();
    let mapped = match guessed {
        true => mapping::guessed(name, &layout, options.interval_s.is_none())?,
        false => mapping::as_told(name, &layout, &options.map)?,
    };
    check_time(name, &layout, &mapped, options)?;
    let found = match options.decimal {
        Some(sign) => values::FoundSign { sign, proven: true },
        None => values::decimal_sign(name, &text, &layout, &mapped)?,
    };
    let reader = ValueReader {
        name,
        layout: &layout,
        mapped: &mapped,
        sign: found.sign,
        interval_s: options.interval_s,
    };
    let (mut recording, empty_rows) = reader.read(&text)?;
    let flipped = flip(&mut recording, options);
    let mut notes = Vec::new();
    if !found.proven {
        notes.push(format!(
            "every number has three digits behind its point or comma, so the decimal sign is not certain: taken was {}; if the \
             values are a thousandfold wrong, add --decimal {}",
            found.sign.wanted(),
            match found.sign {
                DecimalSign::Point => "comma",
                DecimalSign::Comma => "point",
            }
        ));
    }
    if empty_rows > 0 {
        notes.push(format!("{empty_rows} rows without any value were left out"));
    }
    notes.extend(sign_note(&recording));
    let is_used = |i: &usize| mapped.iter().any(|m| m.index == *i);
    let unused = (0..layout.columns.len()).filter(|i| !is_used(i));
    let unused = unused.map(|i| layout.columns[i].name.clone()).collect();
    Ok(Imported {
        recording,
        encoding,
        separator: layout.separator,
        decimal: found.sign,
        header_row: layout.header_row,
        first_row: layout.first_row,
        mapped,
        guessed,
        unused,
        interval_s: options.interval_s,
        flipped,
        notes,
    })
}

/// Refuses a table with two times, and one without any.
fn check_time(
    name: &str,
    layout: &layout::TableLayout,
    mapped: &[MappedColumn],
    options: &ImportOptions,
) -> Result<(), ImportError> {
    let has_column = mapped.iter().any(|m| m.target == MapTarget::Time);
    match (has_column, options.interval_s) {
        (true, Some(_)) => Err(ImportError::Twice {
            name: name.to_owned(),
            target: MapTarget::Time.name(),
        }),
        (false, None) => Err(ImportError::NoTime {
            name: name.to_owned(),
            columns: layout.names(),
        }),
        _ => Ok(()),
    }
}

/// Turns the signs that the user asked for; names of the columns that were turned.
fn flip(recording: &mut Recording, options: &ImportOptions) -> Vec<&'static str> {
    recording.turn_signs(options.flip_force, options.flip_displacement);
    let columns = [
        (options.flip_displacement, MapTarget::Displacement),
        (options.flip_force, MapTarget::Force),
    ];
    let flipped = columns.into_iter().filter(|(wanted, _)| *wanted);
    flipped.map(|(_, target)| target.name()).collect()
}

/// Loading the spring is positive for both. Tells where it looks as if that is not so.
fn sign_note(recording: &Recording) -> Option<String> {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (x, f) = (&recording.displacement_mm, &recording.force_n);
    let (x_mean, f_mean) = (mean(x), mean(f));
    let together: f64 = x.iter().zip(f).map(|(x, f)| (x - x_mean) * (f - f_mean)).sum();
    let negative = |values: &[f64]| {
        let below = values.iter().filter(|v| **v < 0.0).count();
        below as f64 > MOSTLY * values.len() as f64
    };
    if together < 0.0 {
        let which = match (negative(x), negative(f)) {
            (true, false) => "--flip displacement",
            (false, true) => "--flip force",
            _ => "--flip force or --flip displacement",
        };
        return Some(format!(
            "the force falls where the displacement rises: both must be positive in the direction that loads the spring; if a sign \
             is wrong, add {which}"
        ));
    }
    (negative(x) && negative(f)).then(|| {
        "displacement and force are negative throughout: both must be positive in the direction that loads the spring; if loading \
         is negative here, add --flip force,displacement"
            .to_owned()
    })
}

#[cfg(test)]
mod tests;
