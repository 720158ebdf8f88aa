//! The units in the headers of other programs, and the quantity that each belongs to.

/// What a column measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Quantity {
    Time,
    Length,
    Force,
}

/// A unit of another program.
#[derive(Debug, PartialEq)]
pub(super) struct ForeignUnit {
    /// How it is written.
    pub name: &'static str,
    pub quantity: Quantity,
    /// Factor to s, mm or N.
    pub factor: f64,
}

const fn unit(name: &'static str, quantity: Quantity, factor: f64) -> ForeignUnit {
    ForeignUnit {
        name,
        quantity,
        factor,
    }
}

/// All units, with the other ways to write them. Where two differ in the case of a letter only (mN and MN), the case decides.
static UNITS: [ForeignUnit; 31] = [
    unit("s", Quantity::Time, 1.0),
    unit("sec", Quantity::Time, 1.0),
    unit("sek", Quantity::Time, 1.0),
    unit("seconds", Quantity::Time, 1.0),
    unit("ms", Quantity::Time, 1e-3),
    unit("msec", Quantity::Time, 1e-3),
    unit("us", Quantity::Time, 1e-6),
    unit("µs", Quantity::Time, 1e-6),
    unit("min", Quantity::Time, 60.0),
    unit("h", Quantity::Time, 3600.0),
    unit("mm", Quantity::Length, 1.0),
    unit("m", Quantity::Length, 1e3),
    unit("cm", Quantity::Length, 10.0),
    unit("um", Quantity::Length, 1e-3),
    unit("µm", Quantity::Length, 1e-3),
    unit("in", Quantity::Length, 25.4),
    unit("inch", Quantity::Length, 25.4),
    unit("inches", Quantity::Length, 25.4),
    unit("N", Quantity::Force, 1.0),
    unit("newton", Quantity::Force, 1.0),
    unit("daN", Quantity::Force, 10.0),
    unit("kN", Quantity::Force, 1e3),
    unit("mN", Quantity::Force, 1e-3),
    unit("MN", Quantity::Force, 1e6),
    unit("kgf", Quantity::Force, 9.80665),
    unit("kp", Quantity::Force, 9.80665),
    unit("kg", Quantity::Force, 9.80665),
    unit("lbf", Quantity::Force, 4.448_221_615_260_5),
    unit("lb", Quantity::Force, 4.448_221_615_260_5),
    unit("lbs", Quantity::Force, 4.448_221_615_260_5),
    unit("kip", Quantity::Force, 4_448.221_615_260_5),
];

/// Ends of names that are no unit unless they are in brackets: `force_min`, `signal in`.
const WORDS_TOO: [&str; 3] = ["min", "h", "in"];

/// The unit that is written like this, without brackets.
pub(super) fn find(text: &str) -> Option<&'static ForeignUnit> {
    // The Greek letter mu is another character than the micro sign.
    let text = text.trim().replace('\u{3bc}', "µ");
    let exact = UNITS.iter().find(|unit| unit.name == text);
    let alike = || {
        let mut alike = UNITS.iter().filter(|unit| unit.name.eq_ignore_ascii_case(&text));
        // Two of them: only the case tells mN from MN.
        alike.next().filter(|_| alike.next().is_none())
    };
    exact.or_else(alike)
}

/// A cell that is a unit and nothing else: `mm`, `[mm]`, `(mm)`.
pub(super) fn in_brackets_or_bare(cell: &str) -> Option<&'static ForeignUnit> {
    find(cell.trim().trim_matches(['[', ']', '(', ')']))
}

/// The name of a column without its unit, and the unit: `Weg [mm]`, `Weg (mm)`, `Weg/mm`, `weg_mm`, `Weg in mm`.
pub(super) fn split_name(cell: &str) -> (&str, Option<&'static ForeignUnit>) {
    let cell = cell.trim();
    for (open, close) in [('[', ']'), ('(', ')')] {
        if let Some((bare, unit)) = cell.strip_suffix(close).and_then(|c| c.rsplit_once(open)) {
            return (bare.trim(), find(unit));
        }
    }
    let Some((at, mark)) = cell.char_indices().rfind(|(_, c)| "/_, ".contains(*c)) else {
        return (cell, None);
    };
    let (bare, text) = (cell[..at].trim(), &cell[at + mark.len_utf8()..]);
    let (bare, said_in) = match bare.strip_suffix(" in") {
        Some(bare) => (bare, true),
        None => (bare, mark == '/'),
    };
    match find(text) {
        Some(unit) if bare.is_empty() || (!said_in && WORDS_TOO.contains(&unit.name)) => (cell, None),
        Some(unit) => (bare.trim_end_matches(','), Some(unit)),
        None => (cell, None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_is_split_into_name_and_unit() {
        for (cell, bare, unit) in [
            ("Weg [mm]", "Weg", Some("mm")),
            ("Kraft (KN)", "Kraft", Some("kN")),
            ("F/kN", "F", Some("kN")),
            ("time_ms", "time", Some("ms")),
            ("Zeit in s", "Zeit", Some("s")),
            ("s/m", "s", Some("m")),
            ("Weg, mm", "Weg", Some("mm")),
            ("displacement_m", "displacement", Some("m")),
            ("Hub [\u{3bc}m]", "Hub", Some("µm")),
            ("F [mN]", "F", Some("mN")),
            ("F [MN]", "F", Some("MN")),
            // Only the case tells the two apart, and this is neither.
            ("F [mn]", "F", None),
            ("force_min", "force_min", None),
            ("Signal in", "Signal in", None),
            ("Kraft", "Kraft", None),
            ("Temp [degC]", "Temp", None),
        ] {
            let found = split_name(cell);
            assert_eq!((found.0, found.1.map(|u| u.name)), (bare, unit), "{cell}");
        }
    }

    #[test]
    fn units_differ_in_their_names() {
        for unit in &UNITS {
            assert_eq!(find(unit.name), Some(unit));
        }
    }
}
