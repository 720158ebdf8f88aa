//! The diagnosis of one run as rows for the archive.

use super::estimate::EstimateScale;
use crate::archive::{DiagnosedRun, DiagnosisRow, Estimated};
use crate::diagnose::{Baseline, DiagnoseOptions, Diagnosis, Estimates, FORCE_AT_ZERO, diagnose, estimate};
use crate::model::Model;
use crate::recording::Recording;

/// Kind of a row: a parameter of the model.
pub(crate) const PARAMETER: &str = "parameter";
/// Kind of a row: an effect that the model may lack.
pub(crate) const EFFECT: &str = "effect";
/// Verdict of a run that could not be diagnosed.
pub(crate) const FAILED: &str = "failed";
/// Verdict of a run with estimates only: nobody searched for missing effects.
const ESTIMATED: &str = "estimated";

/// How thoroughly a run is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Depth {
    /// Parameters and the size of every effect. Pooling needs no more.
    Estimates,
    /// The same, and the search that names missing effects in this run alone.
    Diagnosis,
}

/// Diagnoses one run. A recording that cannot be diagnosed gives a row that says why, so that nobody tries again and again. One thread,
/// and the same bits wherever it runs.
pub(crate) fn diagnose_run(recording: Recording, model: &'static Model, depth: Depth) -> DiagnosedRun {
    let options = DiagnoseOptions {
        threads: 1,
        ..DiagnoseOptions::default()
    };
    let baseline = Baseline::of(model);
    let run_id = recording.name.clone();
    let recordings = [recording];
    let looked_at = estimate(&recordings, &baseline, &options).and_then(|estimates| {
        let diagnosis = match depth {
            Depth::Estimates => None,
            Depth::Diagnosis => Some(diagnose(&recordings, &baseline, &options, &mut |_, _| {})?),
        };
        Ok((estimates, diagnosis))
    });
    let (verdict, message, rows) = match looked_at {
        Ok((estimates, diagnosis)) => {
            let verdict = diagnosis.as_ref().map_or_else(|| ESTIMATED.to_owned(), verdict);
            (
                verdict,
                String::new(),
                rows(model, &estimates, diagnosis.as_ref()),
            )
        }
        Err(error) => (FAILED.to_owned(), with_causes(&error), Vec::new()),
    };
    DiagnosedRun {
        run_id,
        model: model.name.to_owned(),
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        verdict,
        message,
        rows,
    }
}

/// The word of diagnosis.json.
fn verdict(diagnosis: &Diagnosis) -> String {
    let word = serde_json::to_value(diagnosis.verdict).ok();
    word.and_then(|word| word.as_str().map(str::to_owned))
        .unwrap_or_default()
}

fn with_causes(error: &dyn std::error::Error) -> String {
    std::iter::successors(Some(error), |e| e.source())
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join(": ")
}

fn rows(model: &Model, estimates: &Estimates, diagnosis: Option<&Diagnosis>) -> Vec<DiagnosisRow> {
    let parameters = estimates.baseline.iter().map(|parameter| DiagnosisRow {
        kind: PARAMETER.to_owned(),
        quantity: parameter.name.clone(),
        unit: unit(&parameter.unit),
        scale: scale(model, &parameter.name).word().to_owned(),
        estimate: Some(parameter.value),
        std_error: parameter.std_error,
        form_error: parameter.form_error,
        testable: true,
        named: None,
    });
    let effects = estimates.effects.iter().map(|effect| DiagnosisRow {
        kind: EFFECT.to_owned(),
        quantity: effect.code.clone(),
        unit: unit(&effect.unit),
        scale: EstimateScale::Absolute.word().to_owned(),
        estimate: Some(effect.amplitude),
        std_error: effect.std_error,
        form_error: effect.form_error,
        testable: effect.testable,
        named: diagnosis.and_then(|diagnosis| named(diagnosis, &effect.code)),
    });
    let listed: Vec<DiagnosisRow> = parameters.chain(effects).collect();
    // What is named and in no list of effects, such as `unknown`.
    let others = diagnosis.iter().flat_map(|diagnosis| {
        let other = diagnosis
            .effects
            .iter()
            .filter(|found| listed.iter().all(|row| row.quantity != found.code));
        other.map(|found| DiagnosisRow {
            kind: EFFECT.to_owned(),
            quantity: found.code.clone(),
            unit: unit(""),
            scale: EstimateScale::Absolute.word().to_owned(),
            named: named(diagnosis, &found.code),
            ..DiagnosisRow::default()
        })
    });
    let others: Vec<DiagnosisRow> = others.collect();
    listed.into_iter().chain(others).collect()
}

/// What the diagnosis says of an effect, if it names it.
fn named(diagnosis: &Diagnosis, code: &str) -> Option<Estimated> {
    let found = diagnosis.effects.iter().find(|found| found.code == code)?;
    let first = found.parameters.first();
    Some(Estimated {
        confidence: found.confidence,
        parameter: first.map(|value| value.name.clone()).unwrap_or_default(),
        value: first.map_or(f64::NAN, |value| value.value),
        ci95: first.and_then(|value| value.ci95),
    })
}

fn unit(unit: &str) -> String {
    if unit.is_empty() { "1" } else { unit }.to_owned()
}

/// A parameter that cannot be negative is pooled as its logarithm, in every run alike.
fn scale(model: &Model, parameter: &str) -> EstimateScale {
    let mut parameters = model.parameters.iter();
    // A preload cannot be negative, and the zero of a channel is small beside it.
    if parameter == FORCE_AT_ZERO {
        return EstimateScale::Relative;
    }
    match parameters.any(|p| p.name == parameter && p.bounds[0] >= 0.0) {
        true => EstimateScale::Relative,
        false => EstimateScale::Absolute,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model;

    /// A linear spring with friction that is known, and noise of a fixed pattern.
    fn recording(samples: usize) -> Recording {
        let phase = |i: usize| std::f64::consts::TAU * 0.25 * i as f64 * 0.004;
        let x = |i: usize| 5.0 - 5.0 * phase(i).cos();
        let noise = |i: usize| 0.2 * ((i * 7919 % 101) as f64 / 50.0 - 1.0);
        Recording {
            name: "run-1".to_owned(),
            time_s: (0..samples).map(|i| i as f64 * 0.004).collect(),
            displacement_mm: (0..samples).map(x).collect(),
            force_n: (0..samples)
                .map(|i| 70.0 * x(i) * (1.0 + 0.1 * phase(i).sin().signum()) + noise(i))
                .collect(),
            ..Recording::default()
        }
    }

    #[test]
    fn a_run_gives_a_row_for_each_parameter_and_each_effect() {
        let model = model::find("equivalent").unwrap();
        let diagnosed = diagnose_run(recording(3000), model, Depth::Estimates);
        assert_eq!(
            (diagnosed.verdict.as_str(), diagnosed.run_id.as_str()),
            (ESTIMATED, "run-1")
        );
        let rate = diagnosed
            .rows
            .iter()
            .find(|row| row.quantity == "rate_n_per_mm")
            .unwrap();
        assert!((rate.estimate.unwrap() - 70.0).abs() < 0.5, "{rate:?}");
        assert_eq!((rate.kind.as_str(), rate.scale.as_str()), (PARAMETER, "relative"));
        let effects = diagnosed.rows.iter().filter(|row| row.kind == EFFECT);
        assert!(effects.clone().count() > 10);
        assert!(effects.clone().all(|row| row.named.is_none()));
        assert_eq!(diagnose_run(recording(3000), model, Depth::Estimates), diagnosed);
    }

    #[test]
    fn a_run_that_cannot_be_diagnosed_says_why() {
        let model = model::find("equivalent").unwrap();
        let diagnosed = diagnose_run(recording(3), model, Depth::Diagnosis);
        assert_eq!((diagnosed.verdict.as_str(), diagnosed.rows.len()), (FAILED, 0));
        assert!(!diagnosed.message.is_empty());
    }
}
