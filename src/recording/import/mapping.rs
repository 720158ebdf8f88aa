//! Which column of a foreign table is time, displacement, force or cycle: by the user's word, or by name and unit.

use super::error::ImportError;
use super::layout::{ForeignColumn, TableLayout};
use super::unit::{ForeignUnit, Quantity};

/// A column of docs/formats.md that a foreign column can become.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub(crate) enum MapTarget {
    #[serde(rename = "time_s")]
    Time,
    #[serde(rename = "displacement_mm")]
    Displacement,
    #[serde(rename = "force_n")]
    Force,
    /// Number of the counted cycle; 0 outside the counted cycles.
    #[serde(rename = "cycle")]
    Cycle,
}

impl MapTarget {
    /// All targets, in the order of the CSV.
    pub(crate) const ALL: [MapTarget; 4] = [
        MapTarget::Time,
        MapTarget::Displacement,
        MapTarget::Force,
        MapTarget::Cycle,
    ];

    /// Name of the column in the CSV.
    pub(crate) fn name(self) -> &'static str {
        match self {
            MapTarget::Time => "time_s",
            MapTarget::Displacement => "displacement_mm",
            MapTarget::Force => "force_n",
            MapTarget::Cycle => "cycle",
        }
    }

    fn quantity(self) -> Option<Quantity> {
        match self {
            MapTarget::Time => Some(Quantity::Time),
            MapTarget::Displacement => Some(Quantity::Length),
            MapTarget::Force => Some(Quantity::Force),
            MapTarget::Cycle => None,
        }
    }

    /// Words of column names that stand for it, in lower case.
    fn words(self) -> &'static [&'static str] {
        match self {
            MapTarget::Time => &[
                "time",
                "zeit",
                "t",
                "temps",
                "tiempo",
                "tempo",
                "czas",
                "elapsed",
                "timestamp",
            ],
            MapTarget::Displacement => &[
                "displacement",
                "disp",
                "weg",
                "travel",
                "position",
                "pos",
                "stroke",
                "hub",
                "lvdt",
                "deflection",
                "federweg",
                "durchbiegung",
                "einfederung",
                "verschiebung",
                "extension",
                "course",
                "déplacement",
                "deplacement",
                "spostamento",
                "desplazamiento",
                "x",
                "s",
                "u",
            ],
            MapTarget::Force => &[
                "force",
                "kraft",
                "load",
                "last",
                "loadcell",
                "kraftaufnehmer",
                "kraftmessdose",
                "effort",
                "fuerza",
                "forza",
                "f",
                "fz",
            ],
            MapTarget::Cycle => &[],
        }
    }
}

/// Words of columns that were asked for or computed, not measured.
const NOT_MEASURED: [&str; 12] = [
    "command",
    "cmd",
    "soll",
    "sollwert",
    "setpoint",
    "target",
    "reference",
    "demand",
    "vorgabe",
    "twin",
    "model",
    "error",
];

/// One entry of `--map`: `COLUMN=TARGET`, with an optional factor behind it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MapEntry {
    /// Name of the foreign column, with or without its unit, or its place: `#2`.
    pub column: String,
    pub target: MapTarget,
    /// Factor from the foreign unit to s, mm or N; `None` leaves it to the unit in the header.
    pub factor: Option<f64>,
}

/// The entries of a text such as `Weg [mm]=displacement_mm,Kraft [kN]=force_n*1000`. Names may have commas and `=` in them.
pub(crate) fn parse_map(text: &str) -> Result<Vec<MapEntry>, String> {
    let mut entries = Vec::new();
    let mut pending = String::new();
    for part in text.split(',') {
        pending.push_str(part);
        match entry(&pending)? {
            Some(entry) => {
                entries.push(entry);
                pending.clear();
            }
            None => pending.push(','),
        }
    }
    match pending.trim_end_matches(',').trim() {
        "" => Ok(entries),
        rest => Err(format!(
            "\"{rest}\" is not COLUMN=TARGET, with a target of {}: write for example \"Kraft [kN]=force_n*1000\"",
            MapTarget::ALL.map(MapTarget::name).join(", ")
        )),
    }
}

/// One entry; `None` if the text does not end in a target.
fn entry(text: &str) -> Result<Option<MapEntry>, String> {
    let Some((column, right)) = text.rsplit_once('=') else {
        return Ok(None);
    };
    let right = right.trim();
    let (name, operator, number) = match right.find(['*', '/']) {
        Some(at) => (right[..at].trim(), &right[at..at + 1], right[at + 1..].trim()),
        None => (right, "", ""),
    };
    let Some(target) = MapTarget::ALL.into_iter().find(|target| target.name() == name) else {
        return Ok(None);
    };
    let number = match operator {
        "" => None,
        _ => Some(number.parse::<f64>().ok().filter(|n| n.is_finite() && *n != 0.0)),
    };
    let factor = match number {
        None => None,
        Some(Some(number)) if operator == "/" => Some(1.0 / number),
        Some(Some(number)) => Some(number),
        Some(None) => {
            return Err(format!(
                "\"{right}\": the factor must be a number other than 0, with a decimal point"
            ));
        }
    };
    Ok(Some(MapEntry {
        column: column.trim().to_owned(),
        target,
        factor,
    }))
}

/// A foreign column, what it becomes, and with which factor.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct MappedColumn {
    /// Name of the foreign column.
    pub column: String,
    /// Column of the CSV.
    pub target: MapTarget,
    /// Factor to s, mm or N, without the sign of `--flip`.
    pub factor: f64,
    /// Where the factor comes from, in words.
    pub reason: String,
    /// Index of the foreign column, from 0.
    #[serde(skip)]
    pub index: usize,
}

/// The columns that the user named.
pub(super) fn as_told(
    name: &str,
    layout: &TableLayout,
    entries: &[MapEntry],
) -> Result<Vec<MappedColumn>, ImportError> {
    let mut mapped: Vec<MappedColumn> = Vec::new();
    for entry in entries {
        if mapped.iter().any(|m| m.target == entry.target) {
            return Err(ImportError::Twice {
                name: name.to_owned(),
                target: entry.target.name(),
            });
        }
        let index = place(&entry.column, &layout.columns).map_err(|problem| ImportError::Column {
            name: name.to_owned(),
            column: entry.column.clone(),
            problem,
            columns: layout.names(),
        })?;
        let column = &layout.columns[index];
        let (factor, reason) = told_factor(name, column, entry)?;
        mapped.push(MappedColumn {
            column: column.name.clone(),
            target: entry.target,
            factor,
            reason,
            index,
        });
    }
    let needed = [MapTarget::Displacement, MapTarget::Force];
    match needed.iter().find(|t| !mapped.iter().any(|m| m.target == **t)) {
        None => Ok(mapped),
        Some(missing) => {
            let problem = format!("--map names no column for {}", missing.name());
            Err(unmapped(name, layout, problem, true))
        }
    }
}

/// Factor of a column that the user named, and why.
fn told_factor(name: &str, column: &ForeignColumn, entry: &MapEntry) -> Result<(f64, String), ImportError> {
    let unit = column.unit.filter(|_| entry.target.quantity().is_some());
    let fits = |unit: &ForeignUnit| Some(unit.quantity) == entry.target.quantity();
    match (entry.factor, unit) {
        (Some(factor), Some(unit)) if !fits(unit) || (unit.factor / factor - 1.0).abs() > 1e-6 => Ok((
            factor,
            format!("from --map, although the header says {}", unit.name),
        )),
        (Some(factor), _) => Ok((factor, "from --map".to_owned())),
        (None, Some(unit)) if fits(unit) => Ok((unit.factor, format!("unit {} in the header", unit.name))),
        (None, Some(unit)) => Err(ImportError::WrongQuantity {
            name: name.to_owned(),
            column: entry.column.clone(),
            target: entry.target.name(),
            unit: unit.name,
        }),
        (None, None) => Ok((1.0, "--map gives no factor and the header no unit".to_owned())),
    }
}

/// Index of the column with this name, with or without its unit, or at this place (`#2`).
fn place(wanted: &str, columns: &[ForeignColumn]) -> Result<usize, &'static str> {
    if let Some(number) = wanted.strip_prefix('#').and_then(|n| n.parse::<usize>().ok())
        && (1..=columns.len()).contains(&number)
    {
        return Ok(number - 1);
    }
    let alike = |a: &str, b: &str| a.trim().to_lowercase() == b.trim().to_lowercase();
    let rules: [&dyn Fn(&ForeignColumn) -> bool; 3] =
        [&|c| c.name == wanted, &|c| alike(&c.name, wanted), &|c| {
            alike(&c.bare, wanted)
        }];
    for rule in rules {
        let mut found = (0..columns.len()).filter(|&i| rule(&columns[i]));
        match (found.next(), found.next()) {
            (Some(only), None) => return Ok(only),
            (Some(_), Some(_)) => return Err("several columns have this name"),
            _ => {}
        }
    }
    Err("there is no such column")
}

/// The columns that names and units stand for. Nothing is taken that is not the only one of its kind, or whose unit is unknown.
pub(super) fn guessed(
    name: &str,
    layout: &TableLayout,
    with_time: bool,
) -> Result<Vec<MappedColumn>, ImportError> {
    let mut mapped = Vec::new();
    for target in [MapTarget::Time, MapTarget::Displacement, MapTarget::Force] {
        if target == MapTarget::Time && !with_time {
            continue;
        }
        match guess(target, &layout.columns) {
            Ok(Some(column)) => mapped.push(column),
            // The caller refuses a table without time.
            Ok(None) if target == MapTarget::Time => {}
            Ok(None) => {
                let problem = format!("no column looks like {}", target.name());
                return Err(unmapped(name, layout, problem, with_time));
            }
            Err(problem) => return Err(unmapped(name, layout, problem, with_time)),
        }
    }
    Ok(mapped)
}

/// How well a column stands for a target: 0 not at all, 1 by its unit, 2 by its name, 3 by both, 4 by the name of the contract.
fn likeness(target: MapTarget, column: &ForeignColumn) -> u32 {
    if column.name == target.name() {
        return 4;
    }
    let bare = column.bare.to_lowercase();
    let tokens: Vec<&str> = bare
        .split(|c: char| !c.is_alphanumeric())
        .map(numberless)
        .collect();
    // Long words also within others: `Kolbenweg`, `Axialkraft`.
    let has = |word: &&str| tokens.contains(word) || (word.chars().count() >= 5 && bare.contains(*word));
    if NOT_MEASURED.iter().any(has) || tokens.iter().any(|t| t.starts_with("soll")) {
        return 0;
    }
    let by_name = target.words().iter().any(has);
    match column.unit {
        Some(unit) if Some(unit.quantity) != target.quantity() => 0,
        Some(_) => 1 + 2 * u32::from(by_name),
        None => 2 * u32::from(by_name),
    }
}

/// A word without the number of its channel: `weg1` is `weg`, but `x3` stays.
fn numberless(token: &str) -> &str {
    let word = token.trim_end_matches(|c: char| c.is_ascii_digit());
    if word.chars().count() >= 3 { word } else { token }
}

fn guess(target: MapTarget, columns: &[ForeignColumn]) -> Result<Option<MappedColumn>, String> {
    let likeness: Vec<u32> = columns.iter().map(|column| likeness(target, column)).collect();
    let best = likeness.iter().copied().max().unwrap_or(0);
    if best == 0 {
        return Ok(None);
    }
    let places: Vec<usize> = (0..columns.len()).filter(|&i| likeness[i] == best).collect();
    let names: Vec<&str> = places.iter().map(|&i| columns[i].name.as_str()).collect();
    let (&[index], &[name]) = (places.as_slice(), names.as_slice()) else {
        return Err(format!(
            "several columns look like {}: {}",
            target.name(),
            names.join(", ")
        ));
    };
    let Some(unit) = columns[index].unit else {
        return Err(format!(
            "column {name} looks like {} and has no unit",
            target.name()
        ));
    };
    Ok(Some(MappedColumn {
        column: name.to_owned(),
        target,
        factor: unit.factor,
        reason: format!("unit {} in the header", unit.name),
        index,
    }))
}

/// The error that lists the columns, with a `--map` to type.
fn unmapped(name: &str, layout: &TableLayout, problem: String, with_time: bool) -> ImportError {
    let likeliest = |target: MapTarget| {
        let columns = layout.columns.iter();
        columns
            .map(|column| (likeness(target, column), column))
            .rev()
            .max_by_key(|(likeness, _)| *likeness)
            .filter(|(likeness, _)| *likeness > 0)
            .map(|(_, column)| column.name.as_str())
    };
    let time = likeliest(MapTarget::Time).filter(|_| with_time);
    let mut proposal: Vec<String> = Vec::new();
    proposal.extend(time.map(|column| format!("{column}=time_s")));
    for target in [MapTarget::Displacement, MapTarget::Force] {
        let column = likeliest(target).unwrap_or("COLUMN");
        proposal.push(format!("{column}={}", target.name()));
    }
    let problem = match layout.other_header {
        None => problem,
        Some(cells) => format!(
            "{problem}; the line above the numbers has {cells} cells and the rows have {}: where commas separate the columns, a \
             decimal comma also splits a number, so save the file with semicolons",
            layout.columns.len()
        ),
    };
    ImportError::Unmapped {
        name: name.to_owned(),
        problem,
        columns: layout.names(),
        proposal: proposal.join(","),
        more: match (with_time, time) {
            (true, None) => " --dt SECONDS".to_owned(),
            _ => String::new(),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::super::layout;
    use super::*;

    #[test]
    fn a_map_has_names_with_commas_units_and_factors() {
        let entries = parse_map("Weg, vorne [mm]=displacement_mm , a=b [kN]=force_n*1000,#3=time_s/1000")
            .expect("a map");
        let shown: Vec<_> = entries
            .iter()
            .map(|e| (e.column.as_str(), e.target.name(), e.factor))
            .collect();
        assert_eq!(
            shown,
            [
                ("Weg, vorne [mm]", "displacement_mm", None),
                ("a=b [kN]", "force_n", Some(1000.0)),
                ("#3", "time_s", Some(0.001)),
            ]
        );
    }

    #[test]
    fn a_map_that_names_no_target_is_refused_with_an_example() {
        for text in ["Weg", "Weg=mm", "Weg=displacement_mm,Kraft"] {
            let error = parse_map(text).expect_err(text);
            assert!(error.contains("Kraft [kN]=force_n*1000"), "{error}");
        }
        for text in ["F=force_n*", "F=force_n*0", "F=force_n*x"] {
            assert!(parse_map(text).expect_err(text).contains("factor"), "{text}");
        }
    }

    fn guess_in(header: &str) -> Result<String, String> {
        let text = format!("{header}\n1;2;3;4\n2;3;4;5\n");
        let layout = layout::find("f", &text).expect("a table");
        match guessed("f", &layout, true) {
            Ok(mapped) => {
                let parts: Vec<String> = mapped
                    .iter()
                    .map(|m| format!("{}={}*{}", m.column, m.target.name(), m.factor))
                    .collect();
                Ok(parts.join(","))
            }
            Err(error) => Err(error.to_string()),
        }
    }

    #[test]
    fn names_and_units_are_guessed_and_commands_are_not_taken() {
        for (header, wanted) in [
            (
                "Zeit [ms];Sollweg [mm];Kolbenweg [mm];Axialkraft [kN]",
                "Zeit [ms]=time_s*0.001,Kolbenweg [mm]=displacement_mm*1,Axialkraft [kN]=force_n*1000",
            ),
            (
                "t (s);Channel 1 (m);Channel 2 (N);Temp",
                "t (s)=time_s*1,Channel 1 (m)=displacement_mm*1000,Channel 2 (N)=force_n*1",
            ),
            (
                "force_n;time_s;displacement_mm;stroke_mm",
                "time_s=time_s*1,displacement_mm=displacement_mm*1,force_n=force_n*1",
            ),
        ] {
            assert_eq!(guess_in(header).as_deref(), Ok(wanted));
        }
    }

    #[test]
    fn decimal_commas_between_commas_are_recognised_by_the_header() {
        let layout = layout::find("f", "t,x,F\n0,0,1,5,2,5\n0,1,1,6,3,5\n").expect("a table");
        let error = guessed("f", &layout, true).expect_err("no header").to_string();
        assert!(
            error.contains("the line above the numbers has 3 cells and the rows have 6")
                && error.contains("save the file with semicolons"),
            "{error}"
        );
    }

    #[test]
    fn what_cannot_be_decided_is_listed_with_a_line_to_type() {
        let error = guess_in("t [s];Weg [mm];LVDT [mm];F [N]").expect_err("two of a kind");
        assert!(
            error.contains("several columns look like displacement_mm: Weg [mm], LVDT [mm]"),
            "{error}"
        );
        assert!(
            error.contains("--map \"t [s]=time_s,Weg [mm]=displacement_mm,F [N]=force_n\""),
            "{error}"
        );
        let error = guess_in("Kraft;Weg;x3;x4").expect_err("no units");
        assert!(
            error.contains("column Weg looks like displacement_mm and has no unit"),
            "{error}"
        );
        assert!(
            error.ends_with("--map \"Weg=displacement_mm,Kraft=force_n\" --dt SECONDS"),
            "{error}"
        );
    }
}
