//! Published tables as input: rows of peak force and loop energy, optimised parameters, or the points of one loop.

use std::io::Read;

use crate::identify::targets::TargetMotion;
use crate::model::leaf_pack;
use crate::papers::first::Two;

/// A ramp of which no duration is told takes as long as the first paper's static test.
const RAMP_S: f64 = crate::papers::first::STATIC_S;
/// Names that tables use for the leaf pack's parameters.
const ALIASES: [(&str, &str); 2] = [
    ("friction_coefficient", "interleaf_mu"),
    ("thickness_correction_mm", "thickness_correction_mm"),
];

/// One test: what was measured, and what a model gave where the table says it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TableRow {
    /// Mounting; rows of one mounting are compared with one another.
    pub mount: String,
    /// In words.
    pub name: String,
    /// Amplitude or stroke as printed, mm; none for a test up to a force.
    pub stroke_mm: Option<f64>,
    /// Cycles a second.
    pub frequency_hz: f64,
    /// The motion, where the table tells all of it.
    pub motion: Option<TargetMotion>,
    /// Measured.
    pub measured: Two,
    /// The model's.
    pub model: Option<Two>,
}

/// An optimum that somebody reported.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Fitted {
    /// Mounting.
    pub mount: String,
    /// The leaf pack's names and the values reported.
    pub parameters: Vec<(&'static str, f64)>,
    /// What it reaches.
    pub reach: Two,
}

/// Points of one loop, in order.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Points {
    /// On the way up: mm and N.
    pub loading: Vec<(f64, f64)>,
    /// On the way down.
    pub unloading: Vec<(f64, f64)>,
}

/// What the files hold.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct TargetsTable {
    /// Tests.
    pub rows: Vec<TableRow>,
    /// Reported optima.
    pub fitted: Vec<Fitted>,
    /// One loop's points.
    pub points: Points,
    /// What was left out, and why.
    pub remarks: Vec<String>,
}

/// Where a table cannot be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{name}, row {row}, column {column}: {reason}")]
pub(crate) struct TableError {
    /// The file.
    pub name: String,
    /// Line of the file, the header being 1.
    pub row: usize,
    /// Column.
    pub column: String,
    /// What is wrong and what to do.
    pub reason: String,
}

/// Reads files one after the other; rows of measurement and model find each other at the end.
#[derive(Default)]
pub(crate) struct TableReader {
    table: TargetsTable,
    /// Rows said to be simulated.
    simulated: Vec<TableRow>,
}

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
                format!("\"{text}\" is not a finite number: enter one, with a point"),
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
            format!("{value} is not above zero: correct or remove the row"),
        ))
    }

    /// The first of several columns that the header has, with its factor.
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

const PEAK: [(&str, f64); 4] = [
    ("peak_force_n", 1.0),
    ("fmax_n", 1.0),
    ("peak_force_kn", 1e3),
    ("fmax_kn", 1e3),
];
const ENERGY: [(&str, f64); 1] = [("loop_energy_j", 1.0)];

impl TableReader {
    /// Adds one file. A file with neither rows nor points is remarked on.
    pub(crate) fn read(&mut self, reader: impl Read, name: &str) -> Result<(), TableError> {
        let mut csv = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(reader);
        let broken = |row: usize, error: csv::Error| TableError {
            name: name.to_owned(),
            row,
            column: "any".to_owned(),
            reason: format!("{error}: save the table as CSV in UTF-8, a header and one row a test"),
        };
        let header = csv.headers().map_err(|e| broken(1, e))?.clone();
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
                "{name}, row 1, column {wanted}: the column is missing, the file was left out (a table of tests has peak_force_n or \
                 fmax_kn and loop_energy_j, one of points branch, displacement_mm and force_n: name the columns so)"
            ));
            return Ok(());
        }
        let optimum = ALIASES
            .iter()
            .any(|(alias, _)| header.iter().any(|h| h == *alias));
        for (index, record) in csv.records().enumerate() {
            let row = index + 2;
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
                "{}, row {}, column displacement_mm: no deflection is given, the point is left out",
                cells.name, cells.row
            ));
            return Ok(());
        }
        let point = (cells.number("displacement_mm")?, cells.number("force_n")?);
        match cells.text("branch") {
            "load" | "loading" => self.table.points.loading.push(point),
            "unload" | "unloading" => self.table.points.unloading.push(point),
            other => {
                let reason = format!("\"{other}\" is no branch: use load or unload");
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
            reach: Two {
                peak_n: cells.needed(&PEAK)?,
                loop_j: cells.needed(&ENERGY)?,
            },
        });
        Ok(())
    }

    fn row(&mut self, cells: &Cells<'_>) -> Result<(), TableError> {
        let measured = Two {
            peak_n: cells.needed(&PEAK)?,
            loop_j: cells.needed(&ENERGY)?,
        };
        let stroke_mm = cells.one_of(&[("stroke_mm", 1.0), ("amplitude_mm", 1.0)])?;
        let frequency = cells.one_of(&[("frequency_hz", 1.0)])?;
        let duration_s = cells.one_of(&[("duration_s", 1.0)])?.unwrap_or(RAMP_S);
        let frequency_hz = frequency.unwrap_or(1.0 / duration_s);
        let valley_mm = match cells.text("valley_mm") {
            "" => None,
            _ => Some(cells.number("valley_mm")?),
        };
        let motion = match (cells.text("motion"), stroke_mm, frequency, valley_mm) {
            ("", _, _, _) => None,
            ("force-ramp", _, _, _) => Some(TargetMotion::ForceRamp {
                force_n: measured.peak_n,
                duration_s,
            }),
            ("ramp", Some(stroke_mm), _, _) => Some(TargetMotion::Ramp {
                stroke_mm,
                duration_s,
            }),
            ("sine", Some(stroke_mm), Some(frequency_hz), Some(valley_mm)) => Some(TargetMotion::Sine {
                stroke_mm,
                frequency_hz,
                valley_mm,
            }),
            ("ramp" | "sine", _, _, _) => {
                let reason =
                    "a sine needs stroke_mm, frequency_hz and valley_mm, a ramp stroke_mm: enter them"
                        .to_owned();
                return Err(cells.refused("stroke_mm", reason));
            }
            (other, _, _, _) => {
                let reason = format!("\"{other}\" is no motion: use force-ramp, ramp or sine");
                return Err(cells.refused("motion", reason));
            }
        };
        let name = match (cells.text("profile"), stroke_mm, frequency) {
            ("", Some(mm), Some(hz)) => format!("{mm} mm, {hz} Hz"),
            ("", Some(mm), None) => format!("{mm} mm, slow"),
            ("", None, _) => "static".to_owned(),
            (profile, _, _) => profile.to_owned(),
        };
        let row = TableRow {
            mount: mount(cells),
            name,
            stroke_mm,
            frequency_hz,
            motion,
            measured,
            model: None,
        };
        match cells.text("source") {
            "" | "experiment" | "measured" | "measurement" => self.table.rows.push(row),
            "simulation" | "simulated" | "model" => self.simulated.push(row),
            other => {
                let reason = format!("\"{other}\" is no source: use experiment or simulation");
                return Err(cells.refused("source", reason));
            }
        }
        Ok(())
    }

    /// All of it, the model's rows beside the measured ones.
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

fn mount(cells: &Cells<'_>) -> String {
    match cells.text("mount") {
        "" => "the specimen".to_owned(),
        text => text.replace('_', " "),
    }
}

/// What is believed of a parameter of the leaf pack.
pub(super) fn belief(name: &str) -> Option<[f64; 2]> {
    let parameter = leaf_pack::MODEL.parameters.iter().find(|p| p.name == name);
    parameter.map(|p| p.belief)
}
