//! Reads published tables: tests with peak force and loop energy, reported optima, or the points of one loop.

use std::io::Read;

use crate::identify::targets::{Aggregate, SLOW_RAMP_S, TargetMotion};
use crate::model::leaf_pack;

/// Row number of the header.
const HEADER_ROW: usize = 1;
/// Names of the leaf pack's parameters in tables, and in the model.
const ALIASES: [(&str, &str); 2] = [
    ("friction_coefficient", "interleaf_mu"),
    ("thickness_correction_mm", "thickness_correction_mm"),
];

/// One test: its measured figures, and those of a model where the table has them.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TableRow {
    /// Mounting; only tests of the same mounting are compared with one another.
    pub mount: String,
    /// Name of the test.
    pub name: String,
    /// Amplitude or stroke as printed, mm; `None` for a test up to a force.
    pub stroke_mm: Option<f64>,
    /// Cycles per second.
    pub frequency_hz: f64,
    /// Motion, where the table gives all of it.
    pub motion: Option<TargetMotion>,
    /// Measured peak force and loop energy.
    pub measured: Aggregate,
    /// Figures of the model.
    pub model: Option<Aggregate>,
}

/// Names of the mountings, in the order of the tests.
pub(super) fn mounts(rows: &[TableRow]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for row in rows {
        if !names.contains(&row.mount.as_str()) {
            names.push(&row.mount);
        }
    }
    names
}

/// A reported optimum.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Fitted {
    /// Mounting of the tests that it was fitted to.
    pub mount: String,
    /// The leaf pack's names and the reported values.
    pub parameters: Vec<(&'static str, f64)>,
    /// Figures that it reaches.
    pub reach: Aggregate,
}

/// Points of one loop, in order.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Points {
    /// Loading branch: displacement in mm, force in N.
    pub loading: Vec<(f64, f64)>,
    /// Unloading branch: displacement in mm, force in N.
    pub unloading: Vec<(f64, f64)>,
}

/// Contents of the files.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct TargetsTable {
    /// Measured tests, by mounting.
    pub rows: Vec<TableRow>,
    /// Reported optima, in the order of the files.
    pub fitted: Vec<Fitted>,
    /// Points of one loop.
    pub points: Points,
    /// What was left out of the files, and why.
    pub remarks: Vec<String>,
}

/// Why and where a table cannot be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{name}, row {row}, column {column}: {reason}")]
pub(crate) struct TableError {
    /// Name of the file.
    pub name: String,
    /// Row of the file; the header is row 1.
    pub row: usize,
    /// Name of the column.
    pub column: String,
    /// What is wrong and what to do.
    pub reason: String,
}

/// Reads files one after the other. [`TableReader::finish`] puts the rows of the model beside the measured ones.
#[derive(Default)]
pub(crate) struct TableReader {
    table: TargetsTable,
    /// Rows of a model.
    simulated: Vec<TableRow>,
}

/// One row, with the header that names its cells.
struct Cells<'a> {
    name: &'a str,
    header: &'a csv::StringRecord,
    record: &'a csv::StringRecord,
    row: usize,
}

impl<'a> Cells<'a> {
    fn text(&self, column: &str) -> &'a str {
        let place = self.header.iter().position(|h| h == column);
        place.and_then(|i| self.record.get(i)).unwrap_or("")
    }

    fn refused(&self, column: &str, reason: String) -> TableError {
        TableError {
            name: self.name.to_owned(),
            row: self.row,
            column: column.to_owned(),
            reason,
        }
    }

    fn number(&self, column: &str) -> Result<f64, TableError> {
        let text = self.text(column);
        text.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| {
            self.refused(
                column,
                format!("\"{text}\" is not a finite number: enter a number with a decimal point"),
            )
        })
    }

    fn positive(&self, column: &str) -> Result<f64, TableError> {
        let value = self.number(column)?;
        if value > 0.0 {
            return Ok(value);
        }
        Err(self.refused(
            column,
            format!("{value} is not above 0: correct or remove the row"),
        ))
    }

    /// The first column that has a value, times its factor.
    fn one_of(&self, columns: &[(&str, f64)]) -> Result<Option<f64>, TableError> {
        for (column, factor) in columns {
            if !self.text(column).is_empty() {
                return Ok(Some(factor * self.positive(column)?));
            }
        }
        Ok(None)
    }

    fn needed(&self, columns: &[(&str, f64)]) -> Result<f64, TableError> {
        self.one_of(columns)?.ok_or_else(|| {
            self.refused(
                columns[0].0,
                "the cell is empty: enter the value or remove the row".to_owned(),
            )
        })
    }
}

/// Columns of a peak force, with their units in N.
const PEAK: [(&str, f64); 4] = [
    ("peak_force_n", 1.0),
    ("fmax_n", 1.0),
    ("peak_force_kn", 1e3),
    ("fmax_kn", 1e3),
];
const ENERGY: [(&str, f64); 1] = [("loop_energy_j", 1.0)];

impl TableReader {
    /// Adds one file. A file with neither tests nor points is left out with a remark.
    pub(crate) fn read(&mut self, reader: impl Read, name: &str) -> Result<(), TableError> {
        let mut csv = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(reader);
        let broken = |row: usize, error: csv::Error| TableError {
            name: name.to_owned(),
            row,
            column: "any".to_owned(),
            reason: format!("{error}: save the table as CSV in UTF-8, with a header and one row per test"),
        };
        let header = csv.headers().map_err(|e| broken(HEADER_ROW, e))?.clone();
        let has = |wanted: &[(&str, f64)]| wanted.iter().any(|(w, _)| header.iter().any(|h| h == *w));
        let rows = has(&PEAK) && has(&ENERGY);
        let points = has(&[("displacement_mm", 1.0)]) && has(&[("force_n", 1.0)]) && has(&[("branch", 1.0)]);
        if !rows && !points {
            let wanted = if has(&PEAK) {
                "loop_energy_j"
            } else {
                "peak_force_n"
            };
            self.table.remarks.push(format!(
                "{name}, row {HEADER_ROW}, column {wanted}: the column is missing, the file is left out. Name the columns \
                 peak_force_n (or fmax_kn) and loop_energy_j for tests, or branch, displacement_mm and force_n for points of a loop"
            ));
            return Ok(());
        }
        let optimum = ALIASES
            .iter()
            .any(|(alias, _)| header.iter().any(|h| h == *alias));
        for (index, record) in csv.records().enumerate() {
            let row = HEADER_ROW + 1 + index;
            let record = record.map_err(|e| broken(row, e))?;
            let cells = Cells {
                name,
                header: &header,
                record: &record,
                row,
            };
            if points {
                self.point(&cells)?;
            } else if optimum {
                self.optimum(&cells)?;
            } else {
                self.row(&cells)?;
            }
        }
        Ok(())
    }

    fn point(&mut self, cells: &Cells<'_>) -> Result<(), TableError> {
        if cells.text("displacement_mm").is_empty() {
            self.table.remarks.push(format!(
                "{}, row {}, column displacement_mm: the cell is empty, the point is left out",
                cells.name, cells.row
            ));
            return Ok(());
        }
        let point = (cells.number("displacement_mm")?, cells.number("force_n")?);
        match cells.text("branch") {
            "load" | "loading" => self.table.points.loading.push(point),
            "unload" | "unloading" => self.table.points.unloading.push(point),
            other => {
                let reason = format!("unknown branch \"{other}\": use load or unload");
                return Err(cells.refused("branch", reason));
            }
        }
        Ok(())
    }

    fn optimum(&mut self, cells: &Cells<'_>) -> Result<(), TableError> {
        let mut parameters = Vec::new();
        for (alias, name) in ALIASES {
            if !cells.text(alias).is_empty() {
                parameters.push((name, cells.number(alias)?));
            }
        }
        self.table.fitted.push(Fitted {
            mount: mount(cells),
            parameters,
            reach: Aggregate {
                peak_force_n: cells.needed(&PEAK)?,
                loop_energy_j: cells.needed(&ENERGY)?,
            },
        });
        Ok(())
    }

    fn row(&mut self, cells: &Cells<'_>) -> Result<(), TableError> {
        let measured = Aggregate {
            peak_force_n: cells.needed(&PEAK)?,
            loop_energy_j: cells.needed(&ENERGY)?,
        };
        let stroke_mm = cells.one_of(&[("stroke_mm", 1.0), ("amplitude_mm", 1.0)])?;
        let frequency_hz = cells.one_of(&[("frequency_hz", 1.0)])?;
        let duration_s = cells.one_of(&[("duration_s", 1.0)])?.unwrap_or(SLOW_RAMP_S);
        let row = TableRow {
            mount: mount(cells),
            name: test_name(cells.text("profile"), stroke_mm, frequency_hz),
            stroke_mm,
            frequency_hz: frequency_hz.unwrap_or(1.0 / duration_s),
            motion: motion(cells, measured.peak_force_n, stroke_mm, frequency_hz, duration_s)?,
            measured,
            model: None,
        };
        match cells.text("source") {
            "" | "experiment" | "measured" | "measurement" => self.table.rows.push(row),
            "simulation" | "simulated" | "model" => self.simulated.push(row),
            other => {
                let reason = format!("unknown source \"{other}\": use experiment or simulation");
                return Err(cells.refused("source", reason));
            }
        }
        Ok(())
    }

    /// The contents of all files, with the rows of the model beside the measured ones.
    pub(crate) fn finish(mut self) -> TargetsTable {
        for row in &mut self.table.rows {
            let same = |s: &&TableRow| {
                s.mount == row.mount && s.stroke_mm == row.stroke_mm && s.frequency_hz == row.frequency_hz
            };
            row.model = self.simulated.iter().find(same).map(|s| s.measured);
        }
        let mut mounts: Vec<String> = Vec::new();
        for row in &self.table.rows {
            if !mounts.contains(&row.mount) {
                mounts.push(row.mount.clone());
            }
        }
        self.table
            .rows
            .sort_by_key(|r| mounts.iter().position(|m| *m == r.mount));
        self.table
    }
}

/// The name of a test: as given, or from stroke and frequency.
fn test_name(profile: &str, stroke_mm: Option<f64>, frequency_hz: Option<f64>) -> String {
    match (profile, stroke_mm, frequency_hz) {
        ("", Some(mm), Some(hz)) => format!("{mm} mm, {hz} Hz"),
        ("", Some(mm), None) => format!("{mm} mm, slow"),
        ("", None, _) => "static".to_owned(),
        (profile, _, _) => profile.to_owned(),
    }
}

/// The motion of a test, where the table has the column.
fn motion(
    cells: &Cells<'_>,
    force_n: f64,
    stroke_mm: Option<f64>,
    frequency_hz: Option<f64>,
    duration_s: f64,
) -> Result<Option<TargetMotion>, TableError> {
    let valley_mm = match cells.text("valley_mm") {
        "" => None,
        _ => Some(cells.number("valley_mm")?),
    };
    let missing = |column: &str, what: &str| {
        let reason = format!("the cell is empty, and {what} needs it: enter the value");
        cells.refused(column, reason)
    };
    let motion = match cells.text("motion") {
        "" => return Ok(None),
        "force-ramp" => TargetMotion::ForceRamp { force_n, duration_s },
        "ramp" => TargetMotion::Ramp {
            stroke_mm: stroke_mm.ok_or_else(|| missing("stroke_mm", "a ramp"))?,
            duration_s,
        },
        "sine" => TargetMotion::Sine {
            stroke_mm: stroke_mm.ok_or_else(|| missing("stroke_mm", "a sine"))?,
            frequency_hz: frequency_hz.ok_or_else(|| missing("frequency_hz", "a sine"))?,
            valley_mm: valley_mm.ok_or_else(|| missing("valley_mm", "a sine"))?,
        },
        other => {
            let reason = format!("unknown motion \"{other}\": use force-ramp, ramp or sine");
            return Err(cells.refused("motion", reason));
        }
    };
    Ok(Some(motion))
}

fn mount(cells: &Cells<'_>) -> String {
    match cells.text("mount") {
        "" => "the specimen".to_owned(),
        text => text.replace('_', " "),
    }
}

/// Believed range of a parameter of the leaf-pack model.
pub(super) fn belief(name: &str) -> Option<[f64; 2]> {
    let parameter = leaf_pack::MODEL.parameters.iter().find(|p| p.name == name);
    parameter.map(|p| p.belief)
}
