//! The steps of a diagnosis on a bench that the command and the library share: check of the units, baseline, diagnosis with the
//! recordings left out and the proof of the improved model.

use super::{leave_out, proof};
use crate::cli::CliError;
use crate::config::{Bench, ModelConfig};
use crate::diagnose::diagnosis::Diagnosis;
use crate::diagnose::{Baseline, DiagnoseOptions, diagnose};
use crate::model;
use crate::recording::Recording;

/// Range of the secant rates of springs in N/mm; a rate a thousandfold outside it comes from a wrong unit.
const SPRINGS_N_PER_MM: [f64; 2] = [0.2, 10_000.0];
/// Ranges that a test exceeds in the right units: displacement in mm, and force in N.
const LEAST_RANGE: [f64; 2] = [0.2, 20.0];

/// Refuses columns whose values are metres or kilonewtons under a header that says mm and N.
pub(crate) fn in_mm_and_n(recording: &Recording) -> Result<(), CliError> {
    let range = |values: &[f64]| {
        let (low, high) = values
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
                (l.min(*v), h.max(*v))
            });
        high - low
    };
    let (mm, n) = (range(&recording.displacement_mm), range(&recording.force_n));
    let (column, values, unit, wanted) = match n / mm {
        rate if rate > SPRINGS_N_PER_MM[1] && mm < LEAST_RANGE[0] && n > LEAST_RANGE[1] => {
            ("displacement_mm", &recording.displacement_mm, "metres", "mm")
        }
        rate if rate < SPRINGS_N_PER_MM[0] && n < LEAST_RANGE[1] && mm > LEAST_RANGE[0] => {
            ("force_n", &recording.force_n, "kilonewtons", "N")
        }
        _ => return Ok(()),
    };
    let most = values
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    let (index, value) = most.map_or((0, f64::NAN), |(i, v)| (i, *v));
    // The header is row 1.
    Err(CliError::Input(format!(
        "{}, row {}, column {column}: the values look like {unit}: the largest is {value}, and no spring's force moves by {n:.3} N \
         over {mm:.3} mm: convert the column to {wanted}",
        recording.name,
        index + 2
    )))
}

/// What a diagnosis starts from: the model of a bench or the one called `name`; its known physics or the codes in `known`.
pub(crate) fn baseline_for(
    config: &ModelConfig,
    name: Option<&str>,
    known: Option<&[String]>,
) -> Result<Baseline, CliError> {
    let mut baseline = match name {
        Some(name) if name != config.name => Baseline::of(model::find(name)?),
        _ => baseline_of(config)?,
    };
    baseline.known = match known {
        Some(codes) => {
            let codes = codes.iter().map(|code| code.trim().to_owned());
            Some(codes.filter(|code| !code.is_empty()).collect())
        }
        None => known_of_bench(&baseline, config),
    };
    Ok(baseline)
}

/// A bench's model with its structure and its values; which physics is known is left open.
fn baseline_of(config: &ModelConfig) -> Result<Baseline, CliError> {
    Ok(Baseline {
        structure: config.structure.clone(),
        start: Some(config.values()?),
        ..Baseline::of(model::find(&config.name)?)
    })
}

/// The baseline model's own physics with what the bench config adds to it; none where it adds nothing.
fn known_of_bench(baseline: &Baseline, config: &ModelConfig) -> Option<Vec<String>> {
    let effects = config.effects.iter().map(|e| e.code.clone());
    let added: Vec<String> = config.known.iter().cloned().chain(effects).collect();
    if added.is_empty() {
        return None;
    }
    let own = baseline.model.physics.iter().map(|code| (*code).to_owned());
    let mut codes: Vec<String> = own.chain(added).collect();
    codes.sort_unstable();
    codes.dedup();
    Some(codes)
}

/// Diagnoses recordings, predicts those left out, and proves the improved model. Also returns the text of `improved.toml`, if it is
/// to be written. `given` has the recordings, and those that are only predicted.
pub(crate) fn diagnosed(
    bench: &Bench,
    baseline: &Baseline,
    options: &DiagnoseOptions,
    given: (&[Recording], &[Recording]),
    progress: &mut dyn FnMut(f64, &str),
) -> Result<(Diagnosis, Option<String>), CliError> {
    let (recordings, left_out) = given;
    let courses = leave_out::courses(left_out)?;
    let mut diagnosis = diagnose(recordings, baseline, options, progress)?;
    diagnosis.left_out = leave_out::errors(&diagnosis, bench, &courses);
    let improved = proof::prove(&mut diagnosis, bench, recordings, (left_out, &courses));
    Ok((diagnosis, improved))
}
