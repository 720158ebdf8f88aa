//! A calibration under way: its settings, its steps, and the points so far, in a file beside the result. So it can be interrupted at
//! any point and continued by the same command.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::super::CliError;
use crate::calibration::{CalibratedChannel, CalibrationPoint};
use crate::recording::atomic_file;
use crate::regular_file::{self, WRITTEN_MAX_BYTES};

/// A place at which the reference and the sensor are read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Step {
    /// Number of the series, from 1.
    pub series: u32,
    /// Value to which the reference is brought, approximately, N or mm.
    pub level: f64,
    pub down: bool,
}

/// What was read at a step, N or mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Taken {
    pub series: u32,
    pub down: bool,
    /// Value of the reference instrument.
    pub reference: f64,
    /// Mean of the uncorrected reading.
    pub reading: f64,
    /// Standard deviation of one sample; 0 where it is not known.
    pub scatter: f64,
}

/// Everything that a later start of the command must find again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CalibrationSession {
    pub channel: CalibratedChannel,
    pub certificate: String,
    pub serial: String,
    pub greatest: f64,
    pub levels: u32,
    pub series: u32,
    #[serde(default)]
    pub taken: Vec<Taken>,
}

/// Where the session of a result is kept.
pub(super) fn path_of(out: &Path) -> PathBuf {
    let mut name = out.as_os_str().to_owned();
    name.push(".part");
    name.into()
}

impl CalibrationSession {
    /// The steps: zero, up to the greatest value, down again, zero, for each series.
    pub(super) fn steps(&self) -> Vec<Step> {
        let level = |k: u32| self.greatest * f64::from(k) / f64::from(self.levels);
        let one = |series| {
            let up = (0..=self.levels).map(move |k| (k, false));
            let down = (0..self.levels).rev().map(move |k| (k, true));
            up.chain(down).map(move |(k, down)| Step {
                series,
                level: level(k),
                down,
            })
        };
        (1..=self.series).flat_map(one).collect()
    }

    /// The session that was interrupted, if it has the same settings; refused if it has others.
    pub(super) fn continued(self, path: &Path) -> Result<CalibrationSession, CliError> {
        if !path.exists() {
            return Ok(self);
        }
        let unusable = |why: String| {
            CliError::Input(format!(
                "{} has an interrupted calibration that cannot be continued ({why}): begin again with --restart, or name another \
                 file with --out",
                path.display()
            ))
        };
        let text = regular_file::read_text(path, WRITTEN_MAX_BYTES).map_err(|e| unusable(e.to_string()))?;
        let found: CalibrationSession =
            toml::from_str(&text).map_err(|e| unusable(e.message().to_owned()))?;
        let settings = |session: &CalibrationSession| CalibrationSession {
            taken: Vec::new(),
            ..session.clone()
        };
        match settings(&found) == self {
            true => Ok(found),
            false => Err(unusable("it has other settings".to_owned())),
        }
    }

    /// Writes the session, whole or not at all.
    pub(super) fn keep(&self, path: &Path) -> Result<(), CliError> {
        let text = toml::to_string(self).map_err(|e| CliError::Internal(e.to_string()))?;
        atomic_file::write(path, |file| file.write_all(text.as_bytes()))
            .map_err(CliError::file(path, "writing"))
    }

    /// The points: in each series the readings of the way down beside those of the way up, in the order of their references. The
    /// highest level has no way down.
    pub(super) fn points(&self) -> Vec<CalibrationPoint> {
        (1..=self.series_taken())
            .flat_map(|series| self.points_of(series))
            .collect()
    }

    fn series_taken(&self) -> u32 {
        self.taken.iter().map(|t| t.series).max().unwrap_or(0)
    }

    fn points_of(&self, series: u32) -> Vec<CalibrationPoint> {
        let way = |down: bool| {
            let mut way: Vec<&Taken> = self
                .taken
                .iter()
                .filter(|t| t.series == series && t.down == down)
                .collect();
            way.sort_by(|a, b| a.reference.total_cmp(&b.reference));
            way
        };
        let mut down = way(true).into_iter();
        let up = way(false).into_iter();
        up.map(|up| {
            let down = down.next();
            CalibrationPoint {
                series,
                reference: up.reference,
                up: up.reading,
                down: down.map(|down| down.reading),
                down_reference: down.map(|down| down.reference).filter(|r| *r != up.reference),
            }
        })
        .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn session() -> CalibrationSession {
        CalibrationSession {
            channel: CalibratedChannel::Force,
            certificate: "C".to_owned(),
            serial: "1".to_owned(),
            greatest: 2000.0,
            levels: 5,
            series: 1,
            taken: Vec::new(),
        }
    }

    #[test]
    fn five_levels_up_and_down_begin_and_end_at_zero() {
        let steps = session().steps();
        let levels: Vec<f64> = steps.iter().map(|s| s.level).collect();
        assert_eq!(
            levels,
            [
                0.0, 400.0, 800.0, 1200.0, 1600.0, 2000.0, 1600.0, 1200.0, 800.0, 400.0, 0.0
            ]
        );
        assert_eq!(steps.iter().filter(|s| s.down).count(), 5);
        assert_eq!(
            CalibrationSession {
                series: 3,
                ..session()
            }
            .steps()
            .len(),
            33
        );
    }

    #[test]
    fn the_way_down_belongs_to_the_level_of_its_series() {
        let mut session = CalibrationSession {
            series: 2,
            ..session()
        };
        for (series, down, reference) in [
            (1, false, 0.0),
            (1, false, 400.0),
            (1, false, 2000.0),
            (2, false, 410.0),
            (1, true, 405.0),
            (1, true, 0.0),
        ] {
            session.taken.push(Taken {
                series,
                down,
                reference,
                reading: 1.01 * reference,
                scatter: 0.0,
            });
        }
        let points = session.points();
        assert_eq!(
            (points[1].down, points[1].down_reference),
            (Some(1.01 * 405.0), Some(405.0))
        );
        assert_eq!((points[0].down, points[0].down_reference), (Some(0.0), None));
        assert_eq!((points[2].down, points[3].down), (None, None));
    }

    #[test]
    fn an_interrupted_session_is_continued_and_another_is_not_mixed_with_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = path_of(&folder.path().join("cell.toml"));
        assert!(path.ends_with("cell.toml.part"));
        let mut begun = session().continued(&path).expect("nothing there");
        begun.taken.push(Taken {
            series: 1,
            down: false,
            reference: 0.0,
            reading: 0.1,
            scatter: 0.5,
        });
        begun.keep(&path).expect("written");
        assert_eq!(session().continued(&path).expect("the same"), begun);
        let other = CalibrationSession {
            certificate: "D".to_owned(),
            ..session()
        };
        let refused = other.continued(&path).expect_err("another").to_string();
        assert!(
            refused.contains("other settings") && refused.contains("--restart"),
            "{refused}"
        );
    }
}
