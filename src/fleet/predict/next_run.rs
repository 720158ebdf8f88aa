//! The run that is asked about: which specimen on which bench, when, and at which age.

use std::collections::BTreeSet;

use jiff::Timestamp;

use crate::fleet::estimate::EstimateRow;

/// Fewest runs of a family from which anything is predicted.
pub(super) const FEWEST_RUNS: usize = 4;

/// A run that has not begun.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct NextRun {
    pub specimen: String,
    pub family: String,
    /// Empty if it is not known.
    pub batch: String,
    pub bench: String,
    pub started_utc: Timestamp,
    /// Load cycles that the specimen will have seen.
    pub age_cycles: f64,
}

/// What is said about the next run; the table adds the rest.
#[derive(Debug, Clone, Default)]
pub(crate) struct NextRunWords {
    pub specimen: String,
    /// Family and batch of a specimen that is not in the table.
    pub family: Option<String>,
    pub batch: Option<String>,
    pub bench: String,
    /// Without it the run begins when the last run of the table did.
    pub started_utc: Option<Timestamp>,
    /// Without it the specimen ages as it did from its last run but one to its last.
    pub age_cycles: Option<f64>,
}

/// Why nothing can be predicted.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PredictError {
    /// The table has no rows.
    #[error("the table has no rows: nothing can be predicted from it")]
    NoRows,
    /// The specimen is not in the table, and nobody said what it is.
    #[error("specimen {specimen} is not in the table: name its family with --family ({known})")]
    UnknownSpecimen {
        specimen: String,
        /// The families of the table.
        known: String,
    },
    /// The family has no runs.
    #[error(
        "family {family} is not in the table, which has {known}: correct the name, or test some of its specimens first"
    )]
    UnknownFamily {
        family: String,
        /// The families of the table.
        known: String,
    },
    /// The table says another family than the command.
    #[error(
        "specimen {specimen} is of family {is} in the table, not of {said}: leave --family out, or correct the table"
    )]
    OtherFamily {
        specimen: String,
        is: String,
        said: String,
    },
    /// No quantity has enough runs.
    #[error(
        "the table has fewer than {FEWEST_RUNS} runs of family {family}: test some more of its specimens first"
    )]
    TooFewRuns { family: String },
    /// No parameter of the model could be predicted.
    #[error("the table has no parameter of model {model}: give the model of its estimates with --baseline")]
    NoParameter { model: &'static str },
    #[error(transparent)]
    Model(#[from] crate::model::BuildError),
    #[error(transparent)]
    Profile(#[from] crate::profile::ProfileError),
    /// The profile does not move the specimen.
    #[error("profile {profile} has no motion whose values could be predicted: add a ramp or cycles")]
    NoMotion { profile: String },
}

impl NextRun {
    /// Completes what was said from the table.
    pub(crate) fn of(said: &NextRunWords, rows: &[EstimateRow]) -> Result<NextRun, PredictError> {
        let last = rows
            .iter()
            .map(|row| row.started_utc)
            .max()
            .ok_or(PredictError::NoRows)?;
        let families: BTreeSet<&str> = rows.iter().map(|row| row.family.as_str()).collect();
        let known = || families.iter().copied().collect::<Vec<_>>().join(", ");
        let own: Vec<&EstimateRow> = rows.iter().filter(|row| row.specimen == said.specimen).collect();
        let family = match (own.first(), &said.family) {
            (Some(row), Some(family)) if row.family != *family => {
                return Err(PredictError::OtherFamily {
                    specimen: said.specimen.clone(),
                    is: row.family.clone(),
                    said: family.clone(),
                });
            }
            (Some(row), _) => row.family.clone(),
            (None, Some(family)) if families.contains(family.as_str()) => family.clone(),
            (None, Some(family)) => {
                return Err(PredictError::UnknownFamily {
                    family: family.clone(),
                    known: known(),
                });
            }
            (None, None) => {
                return Err(PredictError::UnknownSpecimen {
                    specimen: said.specimen.clone(),
                    known: known(),
                });
            }
        };
        let batch = own.first().map(|row| row.batch.clone()).or(said.batch.clone());
        Ok(NextRun {
            specimen: said.specimen.clone(),
            family,
            batch: batch.unwrap_or_default(),
            bench: said.bench.clone(),
            started_utc: said.started_utc.unwrap_or(last),
            age_cycles: said.age_cycles.unwrap_or_else(|| next_age(&own)),
        })
    }
}

/// The last age of a specimen and the step before it once more; 0 for a specimen without runs.
fn next_age(own: &[&EstimateRow]) -> f64 {
    let mut ages: Vec<f64> = own.iter().map(|row| row.age_cycles).collect();
    ages.sort_by(f64::total_cmp);
    ages.dedup();
    match ages[..] {
        [.., before, last] => 2.0 * last - before,
        [last] => last,
        [] => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::estimate::read_estimates;

    fn rows() -> Vec<EstimateRow> {
        let text = "run_id,specimen,family,batch,bench,operator,started_utc,age_cycles,quantity,unit,estimate,std_error,scale\n\
                    r1,S1,F1,m1,B1,,2026-01-01,0,rate_n_per_mm,N/mm,80,0.1,relative\n\
                    r2,S1,F1,m1,B1,,2026-01-05,1200,rate_n_per_mm,N/mm,80,0.1,relative\n";
        read_estimates("t.csv", text.as_bytes()).expect("a table")
    }

    fn said(specimen: &str, family: Option<&str>) -> NextRunWords {
        NextRunWords {
            specimen: specimen.to_owned(),
            family: family.map(str::to_owned),
            bench: "B1".to_owned(),
            ..NextRunWords::default()
        }
    }

    #[test]
    fn the_table_completes_what_was_not_said() {
        let next = NextRun::of(&said("S1", None), &rows()).expect("known");
        assert_eq!(
            (next.family.as_str(), next.batch.as_str(), next.age_cycles),
            ("F1", "m1", 2400.0)
        );
        assert_eq!(next.started_utc, rows()[1].started_utc);
        let unseen = NextRun::of(&said("S9", Some("F1")), &rows()).expect("a known family");
        assert_eq!((unseen.batch.as_str(), unseen.age_cycles), ("", 0.0));
    }

    #[test]
    fn a_specimen_that_nobody_knows_is_refused_with_what_to_do() {
        let refused = |specimen, family| {
            NextRun::of(&said(specimen, family), &rows())
                .expect_err("refused")
                .to_string()
        };
        assert_eq!(
            refused("S9", None),
            "specimen S9 is not in the table: name its family with --family (F1)"
        );
        assert!(refused("S9", Some("F7")).contains("family F7 is not in the table, which has F1"));
        assert!(refused("S1", Some("F7")).contains("is of family F1 in the table, not of F7"));
        let few = PredictError::TooFewRuns {
            family: "F1".to_owned(),
        };
        assert!(
            few.to_string()
                .starts_with("the table has fewer than 4 runs of family F1:")
        );
        assert!(matches!(
            NextRun::of(&said("S1", None), &[]),
            Err(PredictError::NoRows)
        ));
    }
}
