//! Reads rows of tests from a CSV table.

use std::io::Read;

use super::IdentifyError;
use super::targets::{Aggregate, LoopTarget, TargetMotion};

/// Row number of the header.
const HEADER_ROW: usize = 1;

/// Reads rows of tests. The columns are found by name, in any order: `profile, motion (force-ramp | ramp | sine), stroke_mm,
/// duration_s, frequency_hz, valley_mm, peak_force_n, loop_energy_j`. Cells that the motion does not need stay empty;
/// `profile` is for the reader only.
pub(crate) fn read_targets(reader: impl Read) -> Result<Vec<LoopTarget>, IdentifyError> {
    let mut csv = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(reader);
    let header = csv
        .headers()
        .map_err(|e| refused(HEADER_ROW, "", not_csv(&e)))?
        .clone();
    for column in ["profile", "motion", "peak_force_n", "loop_energy_j"] {
        if !header.iter().any(|h| h == column) {
            let reason = "the column is missing: add it to the header".to_owned();
            return Err(refused(HEADER_ROW, column, reason));
        }
    }
    csv.records()
        .enumerate()
        .map(|(index, record)| {
            let row = HEADER_ROW + 1 + index;
            let record = record.map_err(|e| refused(row, "", not_csv(&e)))?;
            let cells = TargetCells {
                header: &header,
                record: &record,
                row,
            };
            cells.target()
        })
        .collect()
}

fn not_csv(error: &csv::Error) -> String {
    format!("{error}: save the table as CSV in UTF-8, with a header and one row per test")
}

fn refused(row: usize, column: &str, reason: String) -> IdentifyError {
    IdentifyError::Targets {
        row,
        column: column.to_owned(),
        reason,
    }
}

/// One row, with the header that names its cells.
struct TargetCells<'a> {
    header: &'a csv::StringRecord,
    record: &'a csv::StringRecord,
    row: usize,
}

impl TargetCells<'_> {
    /// The cell of a column; empty where the table has no such column.
    fn text(&self, column: &str) -> &str {
        let place = self.header.iter().position(|h| h == column);
        place.and_then(|i| self.record.get(i)).unwrap_or("")
    }

    /// The finite number of a column, refused below `least`.
    fn number(&self, column: &str, least: f64) -> Result<f64, IdentifyError> {
        let text = self.text(column);
        let wanted = match least {
            f64::MIN => "a finite number".to_owned(),
            f64::MIN_POSITIVE => "a number above 0".to_owned(),
            least => format!("a number of at least {least}"),
        };
        text.parse::<f64>()
            .ok()
            .filter(|value| value.is_finite() && *value >= least)
            .ok_or_else(|| {
                let reason = format!("\"{text}\" is not {wanted}: correct the cell");
                refused(self.row, column, reason)
            })
    }

    fn target(&self) -> Result<LoopTarget, IdentifyError> {
        let peak_force_n = self.number("peak_force_n", f64::MIN_POSITIVE)?;
        Ok(LoopTarget {
            motion: self.motion(peak_force_n)?,
            measured: Aggregate {
                peak_force_n,
                loop_energy_j: self.number("loop_energy_j", 0.0)?,
            },
        })
    }

    fn motion(&self, peak_force_n: f64) -> Result<TargetMotion, IdentifyError> {
        match self.text("motion") {
            "force-ramp" => Ok(TargetMotion::ForceRamp {
                force_n: peak_force_n,
                duration_s: self.number("duration_s", 1e-3)?,
            }),
            "ramp" => Ok(TargetMotion::Ramp {
                stroke_mm: self.number("stroke_mm", 1e-6)?,
                duration_s: self.number("duration_s", 1e-3)?,
            }),
            "sine" => Ok(TargetMotion::Sine {
                stroke_mm: self.number("stroke_mm", 1e-6)?,
                frequency_hz: self.number("frequency_hz", 1e-6)?,
                valley_mm: self.number("valley_mm", f64::MIN)?,
            }),
            other => {
                let reason = format!("unknown motion \"{other}\": use force-ramp, ramp or sine");
                Err(refused(self.row, "motion", reason))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_rows_are_named() {
        let head = "profile,motion,stroke_mm,frequency_hz,valley_mm,duration_s,peak_force_n,loop_energy_j\n";
        for (rows, row, column) in [
            ("a,sine,6,1,2,,1,1\nb,sine,6,1,2,,NaN,1\n", 3, "peak_force_n"),
            ("a,wobble,6,1,2,,1,1\n", 2, "motion"),
            ("a,sine,,1,2,,1,1\n", 2, "stroke_mm"),
            ("a,sine,6,1,2,,1,-3\n", 2, "loop_energy_j"),
        ] {
            let error = read_targets(format!("{head}{rows}").as_bytes()).expect_err("bad");
            let IdentifyError::Targets {
                row: at,
                column: named,
                ..
            } = &error
            else {
                panic!("{error}");
            };
            assert_eq!((*at, named.as_str()), (row, column), "{error}");
        }
        assert!(read_targets("profile,motion\n".as_bytes()).is_err());
    }
}
