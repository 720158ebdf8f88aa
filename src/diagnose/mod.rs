//! Says which physics a model lacks, and checks the answer on cycles that no parameter was fitted to.
//!
//! The data pass through these parts in this order:
//!
//! | part | what it does |
//! |---|---|
//! | `samples` | the usable samples: spikes, gaps, clipping, hum, signs, each with a `note` (`spikes`, `gaps`, `clipping`, `vibration`, `polarity`) |
//! | `condition` | turns them into tracks: reversals, bins, masks, splits (`smoothing`, `turning_points`, `travel`, `thinning`) |
//! | `baseline` | the model with the physics that is known, and the candidates |
//! | `data`, `structure` | all tracks end to end; one set of effects fitted to them; `mains_hum` is removed from them |
//! | `coloured_noise`, `file_offsets`, `force_zero`, `repeats` | after the first fit: slow noise, offsets of single recordings, a wrong zero, repeats that differ |
//! | `surrogate` | replaces a slow model during the search (`surrogate_plant`) |
//! | `context` | setup, data and threads, and the fits of single sets (`fit`, with the score test of `score`) |
//! | `friction_law` | generalises the baseline's friction law before any effect is called missing |
//! | `search` | beam search over sets of effects |
//! | `backward_elimination` | the set that is chosen: largest penalised gain, then effects that bring too little are removed |
//! | `second_search` | a search in which the shape of the friction law is in doubt (`discrepancy`) |
//! | `simplest_form` | shapes of laws that the recordings do not ask for go back to their neutral values |
//! | `lack_of_fit` | what no candidate explains (`near_replicates`) |
//! | `law` | a law read off the recordings where no candidate explains them |
//! | `two_sided` | the model of a device that pushes and pulls, where that is better than a spring |
//! | `location` | where on the loop model and recordings differ (`binning`) |
//! | `alternatives`, `intervals` | what could replace a finding; confidence intervals |
//! | `next_test` | the test that separates a finding from its alternatives (`test_profiles`) |
//! | `yardsticks` | the errors of simple models on the same points (`course`) |
//! | `verdict`, `tables` | the [`Diagnosis`] |
//!
//! `aggregates` does the same for tables of peak force and loop energy. Files, configs and pages are left to others.

pub(crate) mod aggregates;
mod alternatives;
#[cfg(test)]
mod any_input_tests;
mod backward_elimination;
mod baseline;
mod binning;
mod clipping;
mod coloured_noise;
mod condition;
mod context;
pub(crate) mod course;
mod data;
pub(crate) mod diagnosis;
mod discrepancy;
mod error;
mod expansions;
mod file_offsets;
mod fit;
mod force_zero;
mod friction_law;
mod gaps;
mod general_law;
mod intervals;
mod lack_of_fit;
mod law;
pub(crate) mod left_out;
mod likelihood;
mod location;
mod look_alikes;
mod mains_hum;
mod near_replicates;
mod next_test;
mod node;
pub(crate) mod note;
mod on_the_model;
mod options;
mod polarity;
mod repeats;
mod samples;
mod score;
mod search;
mod second_search;
mod simplest_form;
mod smoothing;
mod spikes;
mod splits;
mod structure;
mod surrogate;
mod surrogate_plant;
mod tables;
mod test_profiles;
mod thinning;
mod track;
mod travel;
mod turning_points;
mod two_sided;
mod varying_coefficient;
mod verdict;
mod vibration;
pub(crate) mod yardsticks;

pub use baseline::Baseline;
pub(crate) use course::Split;
pub use diagnosis::{Diagnosis, Finding, Verdict};
pub(crate) use error::DiagnoseError;
pub use options::DiagnoseOptions;

use crate::recording::Recording;
use baseline::Setup;
use context::RunSettings;
use data::Data;
use error::BaselineError;
use friction_law::SearchStart;
use node::Node;
use search::SearchResult;
use second_search::DoubtedSearch;
use structure::ModelStructure;

/// Diagnoses recordings of one specimen. `progress` gets the share done, 0 to 1, and the current step.
pub fn diagnose(
    recordings: &[Recording],
    baseline: &Baseline,
    options: &DiagnoseOptions,
    progress: &mut dyn FnMut(f64, &str),
) -> Result<Diagnosis, DiagnoseError> {
    if recordings.is_empty() {
        return Err(DiagnoseError::NoRecording);
    }
    let mut setup = Setup::new(baseline)?;
    progress(0.0, "conditioning the recordings");
    let input = conditioned(recordings, options)?;
    progress(0.05, "refitting the baseline");
    let (data, run, first) = fitted_input(&mut setup, input, recordings, options)?;
    let context = run.context(&setup, &data);
    let nominal = context
        .structure(setup.extras.clone())
        .residuals(&context.start());
    let mut start = friction_law::search_start(&context, &first).ok_or(DiagnoseError::OutOfDomain)?;
    if start.generalised {
        setup.extras.clone_from(&start.base.attached);
    }
    let context = run.context(&setup, &data);
    let mut search = search::search(&context, start.base.clone(), &start.seeds, &mut |share, step| {
        progress(0.15 + 0.6 * share, step);
    });
    let chosen = search.chosen;
    simplest_form::simplify(&context, &mut search, chosen);
    if setup.model.slow {
        progress(0.75, "refitting the best sets on the model itself");
        let fits = (&mut start.refitted, &start.base);
        search = on_the_model::confirm(&mut setup, &data, &run, fits, search);
    }
    let start = (&start, nominal);
    let diagnosis = concluded(&run, &setup, &data, start, search, progress);
    progress(1.0, "done");
    Ok(diagnosis)
}

/// Searches a second time, and judges the second search if it explains the recordings, else the first.
fn concluded(
    run: &RunSettings,
    setup: &Setup,
    data: &Data,
    (start, nominal): (&SearchStart, Option<Vec<f64>>),
    search: SearchResult,
    progress: &mut dyn FnMut(f64, &str),
) -> Diagnosis {
    let second = second_search::search_again(run, setup, data, start, &search, &mut |share, step| {
        progress(0.75 + 0.05 * share, step);
    });
    progress(0.8, "checking alternatives and planning the next test");
    let plain = run.context(setup, data);
    let base = search.nodes[0].clone();
    let known = verdict::Known {
        plain: &plain,
        refitted: &start.refitted,
        base: &base,
        nominal,
    };
    // Where the first search explains the recordings, the second must not need more effects.
    let names = |search: &SearchResult| search.nodes[search.chosen].attached.len();
    let explains = |doubted: &DoubtedSearch| {
        verdict::is_explained(&run.context(setup, &doubted.data), &doubted.search, &base)
            && (names(&doubted.search) <= names(&search) || !verdict::is_explained(&plain, &search, &base))
    };
    match second.filter(explains) {
        Some(doubted) => verdict::conclude(&run.context(setup, &doubted.data), doubted.search, known),
        None => verdict::conclude(&plain, search, known),
    }
}

/// The points of the recordings, with what every step of the search needs.
fn conditioned(
    recordings: &[Recording],
    options: &DiagnoseOptions,
) -> Result<(Data, RunSettings), DiagnoseError> {
    let mut tracks = condition::condition(recordings, options.points)?;
    splits::assign_splits(&mut tracks);
    let data = Data::new(tracks);
    let run = RunSettings::new(&data, options)?;
    Ok((data, run))
}

/// The fitted baseline, after what the instruments added was taken out: offsets of single recordings, a wrong zero of the force.
fn fitted_input(
    setup: &mut Setup,
    (mut data, mut run): (Data, RunSettings),
    recordings: &[Recording],
    options: &DiagnoseOptions,
) -> Result<(Data, RunSettings, Node), DiagnoseError> {
    let mut first = first_fit(setup, &mut data, &run)?;
    let mut shifted = Vec::new();
    let zero_mm = file_offsets::common_zero_mm(&run, setup, &data, &first);
    if let Some(zero_mm) = zero_mm {
        shifted = file_offsets::without_zero(recordings, zero_mm);
        (data, run) = conditioned(&shifted, options)?;
        first = first_fit(setup, &mut data, &run)?;
    }
    let recordings = if zero_mm.is_some() { &shifted } else { recordings };
    let structure = ModelStructure::new(setup, &data, first.attached.clone());
    let found = file_offsets::find(&structure, &first)
        .filter(|found| !file_offsets::physics_suffices(&run.context(setup, &data), &first, found));
    if let Some(mut found) = found {
        for _ in 0..2 {
            let corrected = file_offsets::corrected(recordings, &found.offsets);
            (data, run) = conditioned(&corrected, options)?;
            first = first_fit(setup, &mut data, &run)?;
            let structure = ModelStructure::new(setup, &data, first.attached.clone());
            file_offsets::refine(&structure, &first, &mut found);
        }
        for (recording, offset) in recordings.iter().zip(&found.offsets) {
            data.add_notes(file_offsets::notes(&recording.name, offset));
        }
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
