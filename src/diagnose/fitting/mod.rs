//! Second room: the baseline is fitted to the tracks, and what the instruments added to them is taken out by what the fit leaves.
//!
//! | file | what it does |
//! |---|---|
//! | `baseline` | the model with the physics that is known, and the candidates |
//! | `data`, `discrepancy` | all tracks end to end, with weights; by what the model may deviate along them |
//! | `path_terms` | the terms of the discrepancy for every force that follows from the path |
//! | `coarse` | fewer points of the same tracks, to screen sets on |
//! | `structure` | one set of effects against the data |
//! | `surrogate`, `surrogate_plant` | replaces a slow model along the recordings |
//! | `node`, `fit`, `score` | a fitted set; how sets are fitted; the score test of a candidate |
//! | `likelihood` | gains in log-likelihood, and what an effect costs |
//! | `context` | setup, data and threads, and the fits of single sets |
//! | `expansions` | runs the slow model to make its surrogate |
//! | `general_law` | the general friction law in place of the baseline's own |
//! | `mains_hum`, `coloured_noise` | after the first fit: hum and slow noise |
//! | `file_offsets`, `force_zero`, `repeats` | offsets of single recordings, a wrong zero, repeats that differ |

mod baseline;
mod coarse;
mod coloured_noise;
mod context;
mod data;
mod discrepancy;
mod expansions;
mod file_offsets;
mod fit;
mod force_zero;
mod general_law;
mod likelihood;
mod mains_hum;
mod node;
mod path_terms;
mod repeats;
mod score;
mod structure;
mod surrogate;
mod surrogate_plant;

pub use baseline::Baseline;
pub(in crate::diagnose) use baseline::{Attached, Setup, build};
pub(in crate::diagnose) use context::{FitContext, RunSettings};
#[cfg(test)]
pub(in crate::diagnose) use data::tests::{case, sampled};
pub(in crate::diagnose) use data::{Data, LINEARITY, STEEPEST};
pub(in crate::diagnose) use discrepancy::{Discrepancy, Doubt, ShapeShares};
pub(in crate::diagnose) use expansions::expand;
pub(in crate::diagnose) use fit::{converge, profile_interval, refine};
pub(in crate::diagnose) use general_law::{generalise, with_general_law};
pub(in crate::diagnose) use likelihood::{LikelihoodScale, PARAMETER_PENALTY, PENALTY};
pub(in crate::diagnose) use node::{Key, Node};
pub(in crate::diagnose) use score::{Tangent, insert_group};
pub(in crate::diagnose) use structure::ModelStructure;

use file_offsets::{FoundBy, OffsetFit};

use crate::diagnose::conditioning::{Track, tracks};
use crate::diagnose::error::{BaselineError, DiagnoseError};
use crate::diagnose::options::DiagnoseOptions;
use crate::model::equivalent;
use crate::recording::Recording;

/// The points of all tracks, with what every fit needs.
pub(in crate::diagnose) fn input(
    tracks: Vec<Track>,
    options: &DiagnoseOptions,
) -> Result<(Data, RunSettings), DiagnoseError> {
    let data = Data::new(tracks);
    let run = RunSettings::new(&data, options)?;
    Ok((data, run))
}

/// The fitted baseline, after what the instruments added was taken out: offsets of single recordings, a wrong zero of the force.
pub(in crate::diagnose) fn fitted_input(
    setup: &mut Setup,
    (mut data, mut run): (Data, RunSettings),
    recordings: &[Recording],
    options: &DiagnoseOptions,
) -> Result<(Data, RunSettings, Node), DiagnoseError> {
    let points = options.points_of_each(recordings.len());
    let again = |corrected: &[Recording]| input(tracks(corrected, points)?, options);
    let mut first = first_fit(setup, &mut data, &run)?;
    let mut shifted = Vec::new();
    let zero_mm = file_offsets::common_zero_mm(&run, setup, &data, &first);
    if let Some(zero_mm) = zero_mm {
        shifted = file_offsets::without_zero(recordings, zero_mm);
        (data, run) = again(&shifted)?;
        first = first_fit(setup, &mut data, &run)?;
    }
    let recordings = if zero_mm.is_some() { &shifted } else { recordings };
    let found = file_offsets::offsets_of_recordings(&run, setup, &data, &first)
        .or_else(|| zeros_under_a_slow_model(setup, &data, &run));
    if let Some((mut found, found_by)) = found {
        for _ in 0..2 {
            let corrected = file_offsets::corrected(recordings, &found.offsets);
            (data, run) = again(&corrected)?;
            first = first_fit(setup, &mut data, &run)?;
            if !found_by.refine(&run.context(setup, &data), &first, &mut found) {
                break;
            }
        }
        file_offsets::add_notes(&mut data, recordings, &found);
    }
    if let Some(zero_mm) = zero_mm {
        let notes = recordings
            .iter()
            .map(|r| file_offsets::common_zero_note(&r.name, zero_mm));
        data.add_notes(notes.collect());
    }
    let structure = ModelStructure::new(setup, &data, first.attached.clone());
    if let Some((sigma_n, notes)) = force_zero::check(&structure, &first) {
        data.zero_sigma_n = sigma_n;
        data.add_notes(notes);
    }
    let notes = repeats::disagreements(&data);
    data.add_notes(notes);
    Ok((data, run, first))
}

/// Zeros of single recordings that are seen in their mean curves, with a fast model in place of a slow one. How the recordings differ from
/// each other does not depend on the model.
fn zeros_under_a_slow_model(setup: &Setup, data: &Data, run: &RunSettings) -> Option<(OffsetFit, FoundBy)> {
    if !setup.model.slow || !file_offsets::mean_curves_disagree(data) {
        return None;
    }
    let mut fast = Setup::new(&Baseline::of(&equivalent::MODEL)).ok()?;
    fast.cancel = setup.cancel.clone();
    let mut data = data.clone();
    let first = first_fit(&mut fast, &mut data, run).ok()?;
    let zeros = file_offsets::seen_in_mean_curves(run, &fast, &data, &first)?;
    Some((zeros, FoundBy::MeanCurves))
}

/// Fits the baseline, then removes mains hum and sets the weights by what the fit leaves.
fn first_fit(setup: &mut Setup, data: &mut Data, run: &RunSettings) -> Result<Node, DiagnoseError> {
    if setup.model.slow {
        expansions::fit_surrogate(setup, data, run).ok_or(DiagnoseError::OutOfDomain)?;
    }
    let mut first = run
        .context(setup, data)
        .baseline()
        .ok_or(DiagnoseError::OutOfDomain)?;
    let mut model_n = vec![0.0; data.len()];
    ModelStructure::new(setup, data, first.attached.clone())
        .predict(&first.values, &mut model_n)
        .map_err(BaselineError::from)?;
    data.remove_hum(&mut first.residuals, &model_n);
    data.set_weights(&mut first.residuals, &model_n);
    coloured_noise::raise_noise(data, &mut first.residuals);
    if setup.model.slow {
        let error_n = expansions::discretisation_error_n(&run.context(setup, data), &first.values);
        data.add_model_error(&error_n.ok_or(DiagnoseError::OutOfDomain)?);
    }
    Ok(first)
}
