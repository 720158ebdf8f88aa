//! Who a run belongs to: the table of specimens, and the estimates of an archive as rows for pooling.

use std::collections::BTreeMap;

use jiff::Timestamp;

use super::diagnosed::{EFFECT, FAILED};
use super::estimate::{EstimateRow, EstimateScale};
use crate::archive::{ArchivedRun, DiagnosedRun, DiagnosisRow};

/// Why a table of specimens cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum MembersError {
    /// A row that is no row of such a table.
    #[error("{table}: the table of specimens cannot be read: it needs the columns specimen,family,batch")]
    Table {
        /// Name of the table.
        table: String,
        source: csv::Error,
    },
    /// A specimen with two rows.
    #[error("{table}: specimen {specimen} has two rows: remove one of them")]
    Twice {
        /// Name of the table.
        table: String,
        specimen: String,
    },
}

/// A specimen and what it belongs to.
#[derive(Debug, Clone, PartialEq, Eq, serde::Deserialize)]
pub(crate) struct Member {
    pub specimen: String,
    /// Specimens of one drawing.
    pub family: String,
    /// Specimens of a family that were made together; empty if it is not known.
    #[serde(default)]
    pub batch: String,
}

/// The specimens of a laboratory by name.
#[derive(Debug, Clone, Default)]
pub(crate) struct Members {
    by_name: BTreeMap<String, Member>,
}

impl Members {
    /// Reads a CSV with the columns `specimen`, `family` and, if it is known, `batch`. `table` is its name, for messages.
    pub(crate) fn read(table: &str, source: impl std::io::Read) -> Result<Members, MembersError> {
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(source);
        let mut members = Members::default();
        for row in reader.deserialize() {
            let row: Member = row.map_err(|source| MembersError::Table {
                table: table.to_owned(),
                source,
            })?;
            if let Some(twice) = members.by_name.insert(row.specimen.clone(), row) {
                return Err(MembersError::Twice {
                    table: table.to_owned(),
                    specimen: twice.specimen,
                });
            }
        }
        Ok(members)
    }

    /// The specimen of this name.
    pub(crate) fn of(&self, specimen: &str) -> Option<&Member> {
        self.by_name.get(specimen)
    }
}

/// The rows for pooling, and what was left out, one sentence each.
#[derive(Debug, Clone, Default)]
pub(crate) struct ArchivedEstimates {
    pub rows: Vec<EstimateRow>,
    pub left_out: Vec<String>,
}

/// A run with what it belongs to and its age.
#[derive(Debug, Clone)]
pub(crate) struct PlacedRun {
    pub run_id: String,
    pub member: Member,
    pub bench: String,
    pub operator: String,
    pub started_utc: Timestamp,
    /// Counted cycles of the earlier runs of the specimen.
    pub age_cycles: f64,
}

/// The places of all runs of a laboratory, which are given by start; an error is the reason why a run cannot be pooled. Also a run that
/// cannot be pooled has aged its specimen. Without members all specimens are one family.
pub(crate) fn placed_runs(runs: &[ArchivedRun], members: Option<&Members>) -> Vec<Result<PlacedRun, String>> {
    let mut ages: BTreeMap<&str, i64> = BTreeMap::new();
    let placed = runs.iter().map(|run| {
        let age = ages.entry(&run.specimen).or_default();
        let age_cycles = *age as f64;
        *age += run.cycles_completed;
        placed_run(run, age_cycles, members)
    });
    placed.collect()
}

fn placed_run(run: &ArchivedRun, age_cycles: f64, members: Option<&Members>) -> Result<PlacedRun, String> {
    let member = match members {
        None => Some(Member {
            specimen: run.specimen.clone(),
            family: "all".to_owned(),
            batch: String::new(),
        }),
        Some(members) => members.of(&run.specimen).cloned(),
    };
    let unknown = || {
        let specimen = &run.specimen;
        format!("specimen \"{specimen}\" is not in the table of specimens: add a row")
    };
    let started_utc = run.started_utc.parse();
    if run.bench.is_empty() {
        return Err("its bench has no name".to_owned());
    }
    Ok(PlacedRun {
        run_id: run.run_id.clone(),
        member: member.ok_or_else(unknown)?,
        bench: run.bench.clone(),
        operator: run.operator.clone(),
        started_utc: started_utc.map_err(|_| "its run file has no time of start".to_owned())?,
        age_cycles,
    })
}

impl PlacedRun {
    /// The quantities of its diagnosis that can be pooled. An error is the reason why it could not be diagnosed.
    pub(crate) fn rows(&self, diagnosed: &DiagnosedRun) -> Result<Vec<EstimateRow>, String> {
        if diagnosed.verdict == FAILED {
            return Err(format!("it could not be diagnosed: {}", diagnosed.message));
        }
        let rows = diagnosed.rows.iter().filter_map(|row| {
            let (scale, estimate, std_error) = usable(row)?;
            Some(EstimateRow {
                run_id: self.run_id.clone(),
                specimen: self.member.specimen.clone(),
                family: self.member.family.clone(),
                batch: self.member.batch.clone(),
                bench: self.bench.clone(),
                operator: self.operator.clone(),
                started_utc: self.started_utc,
                age_cycles: self.age_cycles,
                quantity: row.quantity.clone(),
                unit: row.unit.clone(),
                estimate,
                std_error,
                form_error: row.form_error.unwrap_or(0.0),
                scale,
            })
        });
        Ok(rows.collect())
    }
}

/// The estimates of an archive. `runs` are all its runs by start.
pub(crate) fn archived_estimates(
    runs: &[ArchivedRun],
    diagnosed: &[DiagnosedRun],
    members: Option<&Members>,
) -> ArchivedEstimates {
    let diagnosed: BTreeMap<&str, &DiagnosedRun> =
        diagnosed.iter().map(|run| (run.run_id.as_str(), run)).collect();
    let mut found = ArchivedEstimates::default();
    for (run, placed) in runs.iter().zip(placed_runs(runs, members)) {
        let of_run = diagnosed.get(run.run_id.as_str());
        let of_run =
            of_run.ok_or_else(|| "it is not diagnosed yet: give `leafbench fleet diagnose`".to_owned());
        match of_run.and_then(|diagnosed| placed?.rows(diagnosed)) {
            Ok(rows) => found.rows.extend(rows),
            Err(reason) => found.left_out.push(format!("run {}: {reason}", run.run_id)),
        }
    }
    found
}

/// Scale, estimate and standard error of a row that can be pooled. A parameter at a bound and an effect that the model imitates cannot.
fn usable(row: &DiagnosisRow) -> Option<(EstimateScale, f64, f64)> {
    let scale = EstimateScale::of_word(&row.scale)?;
    let (estimate, std_error) = row.estimate.zip(row.std_error)?;
    let testable = row.kind != EFFECT || row.testable;
    let positive = scale == EstimateScale::Absolute || estimate > 0.0;
    let usable = testable && positive && estimate.is_finite() && std_error.is_finite() && std_error > 0.0;
    usable.then_some((scale, estimate, std_error))
}

#[cfg(test)]
mod tests {
    use super::super::diagnosed::PARAMETER;
    use super::*;

    fn run(run_id: &str, specimen: &str, day: u32) -> ArchivedRun {
        ArchivedRun {
            run_id: run_id.to_owned(),
            specimen: specimen.to_owned(),
            bench: "B1".to_owned(),
            operator: String::new(),
            started_utc: format!("2026-01-{day:02}T10:00:00Z"),
            cycles_completed: 50,
        }
    }

    fn diagnosed(run_id: &str) -> DiagnosedRun {
        let row = |kind: &str, quantity: &str, std_error| DiagnosisRow {
            kind: kind.to_owned(),
            quantity: quantity.to_owned(),
            unit: "1".to_owned(),
            scale: "absolute".to_owned(),
            estimate: Some(0.1),
            std_error,
            form_error: None,
            testable: quantity != "lift_off",
            named: None,
        };
        DiagnosedRun {
            run_id: run_id.to_owned(),
            verdict: "adequate".to_owned(),
            rows: vec![
                row(PARAMETER, "friction_ratio", Some(0.01)),
                row(PARAMETER, "preload_n", None),
                row(EFFECT, "backlash", Some(0.01)),
                row(EFFECT, "lift_off", Some(0.01)),
            ],
            ..DiagnosedRun::default()
        }
    }

    #[test]
    fn what_can_be_pooled_becomes_rows_and_the_rest_is_named() {
        let table = "specimen, family, batch\np1, F1, b\np2, F2,\n";
        let members = Members::read("specimens.csv", table.as_bytes()).unwrap();
        let runs = [
            run("a", "p1", 1),
            run("b", "p1", 2),
            run("c", "p2", 3),
            run("d", "p3", 4),
            run("e", "p1", 5),
        ];
        let failed = DiagnosedRun {
            verdict: FAILED.to_owned(),
            message: "too short".to_owned(),
            ..diagnosed("c")
        };
        let done = [diagnosed("a"), diagnosed("b"), failed, diagnosed("d")];
        let found = archived_estimates(&runs, &done, Some(&members));
        let rows: Vec<_> = found
            .rows
            .iter()
            .map(|r| (r.run_id.as_str(), r.quantity.as_str(), r.age_cycles))
            .collect();
        assert_eq!(
            rows,
            [
                ("a", "friction_ratio", 0.0),
                ("a", "backlash", 0.0),
                ("b", "friction_ratio", 50.0),
                ("b", "backlash", 50.0)
            ]
        );
        assert_eq!(
            (found.rows[0].family.as_str(), found.rows[0].batch.as_str()),
            ("F1", "b")
        );
        let words = ["too short", "\"p3\" is not in the table", "not diagnosed yet"];
        assert_eq!(found.left_out.len(), 3);
        for (sentence, word) in found.left_out.iter().zip(words) {
            assert!(sentence.contains(word), "{sentence}");
        }
        // Without a table all are one family.
        assert_eq!(archived_estimates(&runs, &done, None).rows.len(), 6);
    }

    #[test]
    fn a_table_of_specimens_that_is_none_is_refused_in_words() {
        let read = |text: &str| Members::read("s.csv", text.as_bytes()).unwrap_err().to_string();
        assert!(read("name\nx\n").contains("specimen,family,batch"));
        assert!(read("specimen,family,batch\nx,F,\nx,G,\n").contains("two rows"));
    }
}
