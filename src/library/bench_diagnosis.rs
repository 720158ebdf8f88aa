//! A diagnosis on a bench, as `leafbench diagnose` does it: with the bench's model, limits and known physics, errors on the
//! recordings left out, and the proof of the improved model.

use super::CallFailure;
use crate::cli::bench_diagnosis as steps;
use crate::config::Bench;
use crate::diagnose::{DiagnoseOptions, Diagnosis};
use crate::recording::Recording;

/// What a diagnosis starts from.
#[derive(Debug, Clone, Copy)]
pub struct DiagnoseOrder<'a> {
    /// Its model, limits and known physics are used.
    pub bench: &'a Bench,
    /// Name of the model to start from; `None`: the bench's.
    pub baseline: Option<&'a str>,
    /// Codes of the physics that the baseline has already; `None`: the bench's list and the model's own.
    pub known: Option<&'a [String]>,
}

/// A diagnosis with the bench file that it leaves.
#[derive(Debug, Clone, PartialEq)]
pub struct BenchDiagnosis {
    /// The fields of `diagnosis.json` (docs/formats.md).
    pub diagnosis: Diagnosis,
    /// Text of `improved.toml`; `None` where the improved model is no better than the refitted baseline.
    pub improved_toml: Option<String>,
}

/// Diagnoses recordings of one specimen. Those in `left_out` are only predicted. `progress` gets the share done, 0 to 1, and the
/// current step.
pub fn diagnose_on_bench(
    recordings: &[Recording],
    left_out: &[Recording],
    order: DiagnoseOrder<'_>,
    options: DiagnoseOptions,
    progress: &mut dyn FnMut(f64, &str),
) -> Result<BenchDiagnosis, CallFailure> {
    for recording in recordings.iter().chain(left_out) {
        recording.check()?;
        steps::in_mm_and_n(recording)?;
    }
    let baseline = steps::baseline_for(&order.bench.model, order.baseline, order.known)?;
    let options = options.within(order.bench.profile_limits());
    let (diagnosis, improved_toml) =
        steps::diagnosed(order.bench, &baseline, &options, (recordings, left_out), progress)?;
    Ok(BenchDiagnosis {
        diagnosis,
        improved_toml,
    })
}

#[cfg(test)]
mod tests {
    use super::super::FailureKind;
    use super::*;
    use crate::cancel::CancelFlag;

    /// Three slow cycles of a spring with dry friction.
    fn recording() -> Recording {
        let phase = |i: u32| f64::from(i) * 0.01;
        let x_mm = |i: u32| 5.0 - 5.0 * phase(i).cos();
        Recording {
            name: "a".to_owned(),
            time_s: (0..1900).map(|i| f64::from(i) * 0.01).collect(),
            displacement_mm: (0..1900).map(x_mm).collect(),
            force_n: (0..1900)
                .map(|i| 70.0 * x_mm(i) * (1.0 + 0.1 * phase(i).sin().signum()))
                .collect(),
            ..Recording::default()
        }
    }

    #[test]
    fn a_cancelled_diagnosis_ends_with_its_error_and_a_column_in_kilonewtons_is_refused() {
        let bench = Bench::shipped().expect("built in");
        let order = DiagnoseOrder {
            bench: &bench,
            baseline: None,
            known: None,
        };
        let flag = CancelFlag::default();
        let options = DiagnoseOptions {
            cancel: flag.clone(),
            ..DiagnoseOptions::default()
        };
        let mut kilonewtons = recording();
        kilonewtons.force_n.iter_mut().for_each(|f| *f *= 1e-3);
        let refused = diagnose_on_bench(&[kilonewtons], &[], order, options.clone(), &mut |_, _| {});
        assert!(refused.expect_err("wrong unit").text.contains("kilonewtons"));
        let cancelled = diagnose_on_bench(&[recording()], &[], order, options, &mut |share, _| {
            if share > 0.0 {
                flag.cancel();
            }
        });
        assert_eq!(cancelled.expect_err("cancelled").kind, FailureKind::Cancelled);
    }
}
