//! The points of a calibration from a CSV file: the values of the reference, with or without the readings of the sensor.

use std::path::Path;

use super::super::CliError;
use super::session::{Step, Taken};
use crate::calibration::CalibratedChannel;
use crate::regular_file::{self, WRITTEN_MAX_BYTES};

/// One row of the file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PointRow {
    pub series: u32,
    pub down: bool,
    pub reference: f64,
    /// `None`: it is read from the sensor.
    pub reading: Option<f64>,
}

impl PointRow {
    /// The row as a point that was taken; `None` without a reading.
    pub(super) fn taken(&self) -> Option<Taken> {
        Some(Taken {
            series: self.series,
            down: self.down,
            reference: self.reference,
            reading: self.reading?,
            scatter: 0.0,
        })
    }
}

/// Reads the file. Columns: `direction` (up or down), `reference_UNIT`, and where wanted `reading_UNIT` and `series`.
pub(super) fn read(path: &Path, channel: CalibratedChannel) -> Result<Vec<PointRow>, CliError> {
    let refused = |why: String| CliError::Input(format!("{}: {why}", path.display()));
    let text = regular_file::read_text(path, WRITTEN_MAX_BYTES).map_err(|e| {
        refused(format!(
            "cannot be read ({e}): check the path and the permissions"
        ))
    })?;
    parse(&text, channel).map_err(refused)
}

fn parse(text: &str, channel: CalibratedChannel) -> Result<Vec<PointRow>, String> {
    let mut table = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let header = table.headers().map_err(|e| e.to_string())?.clone();
    let [reference, reading] = ["reference", "reading"].map(|name| format!("{name}_{}", channel.suffix()));
    let column = |name: &str| header.iter().position(|h| h == name);
    let needed =
        |name: &str| column(name).ok_or_else(|| format!("row 1: there is no column {name}: name it so"));
    let (direction, reference_at) = (needed("direction")?, needed(&reference)?);
    let (reading_at, series_at) = (column(&reading), column("series"));
    let mut rows = Vec::new();
    for (n, row) in table.records().enumerate() {
        let line = n + 2;
        let row = row.map_err(|e| format!("row {line}: {e}"))?;
        let number = |at: usize, name: &str| -> Result<f64, String> {
            let cell = row.get(at).unwrap_or_default();
            let number = cell.parse().ok().filter(|number: &f64| number.is_finite());
            number.ok_or_else(|| {
                format!("row {line}, {name}: \"{cell}\" is not a number: write it with a point")
            })
        };
        let down = match row.get(direction) {
            Some("up") => false,
            Some("down") => true,
            other => {
                let other = other.unwrap_or_default();
                return Err(format!(
                    "row {line}, direction: \"{other}\" is neither up nor down: write one of them"
                ));
            }
        };
        rows.push(PointRow {
            series: series_at.map_or(Ok(1.0), |at| number(at, "series"))? as u32,
            down,
            reference: number(reference_at, &reference)?,
            reading: reading_at.map(|at| number(at, &reading)).transpose()?,
        });
    }
    Ok(rows)
}

/// The rows as values of the reference for the steps of a session; refused if they are others.
pub(super) fn of_steps(rows: &[PointRow], steps: &[Step]) -> Result<Vec<f64>, CliError> {
    let same = rows.len() == steps.len()
        && rows
            .iter()
            .zip(steps)
            .all(|(row, step)| row.down == step.down && row.series == step.series);
    if same {
        return Ok(rows.iter().map(|row| row.reference).collect());
    }
    Err(CliError::Input(format!(
        "the points have {} rows, and the calibration has {} steps (zero, up, down, zero for each series): write one row for each \
         step, or set --levels and --series",
        rows.len(),
        steps.len()
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_have_a_way_a_reference_and_perhaps_a_reading() {
        let text = "reference_n, direction, reading_n\n0,up,0.1\n400.5,down,-1e2\n";
        let rows = parse(text, CalibratedChannel::Force).expect("a table");
        assert_eq!(
            (rows[1].down, rows[1].reference, rows[1].reading),
            (true, 400.5, Some(-100.0))
        );
        let rows = parse("direction,reference_mm\nup,1\n", CalibratedChannel::Displacement).expect("a table");
        assert_eq!((rows[0].series, rows[0].reading), (1, None));
    }

    #[test]
    fn an_error_names_row_and_column() {
        for (text, wanted) in [
            ("direction,reference_mm\nup,1\n", "no column reference_n"),
            ("direction,reference_n\nup,high\n", "row 2, reference_n: \"high\""),
            (
                "direction,reference_n\nup,1\nleft,1\n",
                "row 3, direction: \"left\"",
            ),
        ] {
            let error = parse(text, CalibratedChannel::Force).expect_err(text);
            assert!(error.contains(wanted), "{error}");
        }
    }
}
