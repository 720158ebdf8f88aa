//! Numbers as other programs write them: decimal point or comma, and marks between groups of three digits.

/// The character between the whole number and its decimals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum DecimalSign {
    /// 1234.5, also 1,234.5
    Point,
    /// 1234,5, also 1.234,5
    Comma,
}

impl DecimalSign {
    /// The character and the one that may stand between groups of three digits.
    fn signs(self) -> (char, char) {
        match self {
            DecimalSign::Point => ('.', ','),
            DecimalSign::Comma => (',', '.'),
        }
    }

    /// What a cell must be, for messages.
    pub(super) fn wanted(self) -> &'static str {
        match self {
            DecimalSign::Point => "a number with a decimal point",
            DecimalSign::Comma => "a number with a decimal comma",
        }
    }
}

/// Marks between groups of three digits that no program uses as the decimal sign.
const GROUP_MARKS: [char; 5] = [' ', '\u{a0}', '\u{202f}', '\'', '\u{2019}'];

/// The finite number in a cell; `None` if it is none.
pub(super) fn parse(cell: &str, sign: DecimalSign) -> Option<f64> {
    let cell = cell.trim();
    let (mantissa, exponent) = match cell.find(['e', 'E']) {
        Some(at) => (&cell[..at], &cell[at + 1..]),
        None => (cell, "0"),
    };
    let (minus, digits) = match mantissa.chars().next()? {
        '-' | '\u{2212}' => (true, &mantissa[mantissa.chars().next()?.len_utf8()..]),
        '+' => (false, &mantissa[1..]),
        _ => (false, mantissa),
    };
    let (decimal, group) = sign.signs();
    let (whole, fraction) = digits.split_once(decimal).unwrap_or((digits, ""));
    let whole = without_groups(whole, group)?;
    let all_digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if !all_digits(fraction) || (whole.is_empty() && fraction.is_empty()) {
        return None;
    }
    let exponent: i32 = exponent.parse().ok()?;
    let text = format!("{whole}.{fraction}e{exponent}");
    // A point without digits on one side of it is a number to Rust too.
    let value: f64 = text.parse().ok()?;
    Some(if minus { -value } else { value }).filter(|value| value.is_finite())
}

/// The digits of a whole number; `None` if it has other characters or groups that are not of three digits.
fn without_groups(whole: &str, group: char) -> Option<String> {
    let mark = whole.chars().find(|c| !c.is_ascii_digit());
    let Some(mark) = mark else {
        return Some(whole.to_owned());
    };
    if mark != group && !GROUP_MARKS.contains(&mark) {
        return None;
    }
    let groups: Vec<&str> = whole.split(mark).collect();
    let first_is_right = groups
        .first()
        .is_some_and(|first| (1..=3).contains(&first.len()) && !first.starts_with('0'));
    let rest_is_right = groups.iter().skip(1).all(|group| group.len() == 3);
    let digits = groups.concat();
    let right = first_is_right && rest_is_right && digits.bytes().all(|byte| byte.is_ascii_digit());
    right.then_some(digits)
}

/// True for a cell that is a number with one of the two signs.
pub(super) fn looks_numeric(cell: &str) -> bool {
    [DecimalSign::Point, DecimalSign::Comma]
        .into_iter()
        .any(|sign| parse(cell, sign).is_some())
}

/// What a cell says about the decimal sign of its file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SignEvidence {
    /// It is a number with one of the signs only.
    Certain(DecimalSign),
    /// It is another number with each of them: 1.234 (false) or 1,234 (true).
    Either { comma: bool },
    /// It is the same number with both, or none.
    Nothing,
}

/// What this cell says about the decimal sign.
pub(super) fn evidence(cell: &str) -> SignEvidence {
    let as_point = parse(cell, DecimalSign::Point);
    let as_comma = parse(cell, DecimalSign::Comma);
    match (as_point, as_comma) {
        (Some(_), None) => SignEvidence::Certain(DecimalSign::Point),
        (None, Some(_)) => SignEvidence::Certain(DecimalSign::Comma),
        (Some(a), Some(b)) if a != b => SignEvidence::Either {
            comma: cell.contains(','),
        },
        _ => SignEvidence::Nothing,
    }
}

/// Seconds since midnight of a clock time such as `10:31:07.250` or `31:07,25`.
pub(super) fn clock_s(cell: &str, sign: DecimalSign) -> Option<f64> {
    let parts: Vec<&str> = cell.trim().split(':').collect();
    let (last, before) = parts.split_last()?;
    if !(1..=2).contains(&before.len()) {
        return None;
    }
    let mut seconds = 0.0;
    for part in before {
        let whole: u32 = part.trim().parse().ok()?;
        seconds = (seconds + f64::from(whole)) * 60.0;
    }
    let last = parse(last, sign).filter(|s| (0.0..60.0).contains(s))?;
    Some(seconds + last)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_with_their_sign_and_groups() {
        use DecimalSign::{Comma, Point};
        for (cell, sign, wanted) in [
            ("1234.5", Point, 1234.5),
            ("1,234.5", Point, 1234.5),
            (" -0.5e-3 ", Point, -0.0005),
            ("1234,5", Comma, 1234.5),
            ("1.234,5", Comma, 1234.5),
            ("1 234,5", Comma, 1234.5),
            ("1\u{a0}234\u{a0}567,5", Comma, 1_234_567.5),
            ("1'234.5", Point, 1234.5),
            ("\u{2212}3,25", Comma, -3.25),
            ("+2E+2", Comma, 200.0),
            (",5", Comma, 0.5),
            ("7", Comma, 7.0),
        ] {
            assert_eq!(parse(cell, sign), Some(wanted), "{cell}");
        }
        for cell in [
            "", "-", ".", "1.2.3", "12,34.5", "0,001", "NaN", "inf", "1 23", "mm", "1e999", "=1+1",
        ] {
            assert_eq!(parse(cell, Point), None, "{cell}");
        }
    }

    #[test]
    fn a_cell_says_which_decimal_sign_its_file_has() {
        use SignEvidence::{Certain, Either, Nothing};
        for (cell, wanted) in [
            ("0,001", Certain(DecimalSign::Comma)),
            ("1.234,5", Certain(DecimalSign::Comma)),
            ("1,234,567", Certain(DecimalSign::Point)),
            ("0.5", Certain(DecimalSign::Point)),
            ("1,234", Either { comma: true }),
            ("1.234", Either { comma: false }),
            ("17", Nothing),
            ("text", Nothing),
        ] {
            assert_eq!(evidence(cell), wanted, "{cell}");
        }
    }

    #[test]
    fn a_clock_time_is_seconds_since_midnight() {
        assert_eq!(clock_s("10:31:07.250", DecimalSign::Point), Some(37_867.25));
        assert_eq!(clock_s("31:07,25", DecimalSign::Comma), Some(1867.25));
        for cell in ["7.25", "1:2:3:4", "10:61.5:7", "10:31:77", "-1:00", ""] {
            assert_eq!(clock_s(cell, DecimalSign::Point), None, "{cell}");
        }
    }
}
