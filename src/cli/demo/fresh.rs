//! The judgement of the improved model: a motion that nothing was fitted to, with three twins.

use serde::Serialize;

use super::played::{Played, curve, percent};
use crate::config::Bench;
use crate::recording::Sample;
use crate::recording::metrics::{Range, loop_energy_j, secant_rate_n_per_mm};
use crate::report::story::{StoryPicture, StoryStep, StoryTable, loop_picture, residual_picture};
use crate::report::svg::{Ink, PlotCurve};

/// The twin on a motion that was not used for the diagnosis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct FreshErrors {
    profile: String,
    before: FollowErrors,
    /// `None` if the diagnosis wrote no improved model.
    after: Option<FollowErrors>,
    /// A twin that is told the truth: no model can follow this rig better.
    truth: FollowErrors,
    /// NRMSE that the noise of the sensors alone gives.
    noise_nrmse: f64,
}

/// Errors of a twin on one run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct FollowErrors {
    nrmse: Option<f64>,
    /// Largest force of the twin over that of the measurement, less 1.
    peak_force_error: f64,
    /// The same for the loop energy of the settled cycle.
    loop_energy_error: f64,
}

/// The same fresh motion with the unchanged and with the improved twin.
pub(super) struct Fresh {
    before: Played,
    after: Option<Played>,
    /// Standard deviation of measured minus model that the noise of the sensors alone gives, N.
    noise_n: f64,
    pub errors: FreshErrors,
}

impl Fresh {
    /// `truth` has the twin that is told what is concealed; `None` for `after` if there is no improved model.
    pub(super) fn new(before: Played, after: Option<Played>, truth: &Played, bench: &Bench) -> Fresh {
        let [displacement_mm, force_n] = ranges(&before.samples);
        let noise = bench.noise();
        let rate = secant_rate_n_per_mm(displacement_mm, force_n).unwrap_or(0.0);
        let noise_n = noise.force_n.hypot(rate * noise.displacement_mm);
        let errors = FreshErrors {
            profile: before.profile.name.clone(),
            before: FollowErrors::of(&before),
            after: after.as_ref().map(FollowErrors::of),
            truth: FollowErrors::of(truth),
            noise_nrmse: noise_n / force_n.span(),
        };
        Fresh {
            before,
            after,
            noise_n,
            errors,
        }
    }
}

/// Ranges of displacement in mm and force in N.
fn ranges(samples: &[Sample]) -> [Range; 2] {
    let range = |value: fn(&Sample) -> f64| {
        let values: Vec<f64> = samples.iter().map(value).collect();
        Range::of(&values).unwrap_or(Range {
            peak: 0.0,
            valley: 0.0,
        })
    };
    [range(|s| s.displacement_mm), range(|s| s.force_n)]
}

impl FollowErrors {
    fn of(run: &Played) -> FollowErrors {
        let cycle = run.settled_cycle();
        let displacement: Vec<f64> = cycle.iter().map(|s| s.displacement_mm).collect();
        let measured: Vec<f64> = cycle.iter().map(|s| s.force_n).collect();
        let twin: Vec<f64> = cycle.iter().map(|s| s.twin_force_n.unwrap_or(f64::NAN)).collect();
        let peak = |force: &[f64]| force.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let energy = |force: &[f64]| loop_energy_j(&displacement, force);
        FollowErrors {
            nrmse: run.twin_nrmse,
            peak_force_error: peak(&twin) / peak(&measured) - 1.0,
            loop_energy_error: energy(&twin) / energy(&measured) - 1.0,
        }
    }
}

/// The last step of the story. `improved` is the path of the improved model's file, as the page links to it.
pub(super) fn fresh_step(fresh: &Fresh, improved: &str) -> StoryStep {
    let errors = &fresh.errors;
    let (before, noise) = (percent(errors.before.nrmse), percent(Some(errors.noise_nrmse)));
    let (text, conclusion) = match &errors.after {
        Some(after) => (
            format!(
                "{improved} was loaded into the twin, and the mock rig ran {}: a motion that nothing was fitted to.",
                errors.profile
            ),
            format!(
                "Error of the twin, as a share of the force range: {before} before, {} after. A twin that is told the truth has \
                 {}; the noise of the sensors alone is {noise}.",
                percent(after.nrmse),
                percent(errors.truth.nrmse)
            ),
        ),
        None => (
            format!(
                "The mock rig ran {}: a motion that nothing was fitted to.",
                errors.profile
            ),
            format!(
                "The diagnosis wrote no improved model, so the twin stays as it was: error {before}, noise {noise}."
            ),
        ),
    };
    StoryStep {
        title: "Before and after, on a new recording".to_owned(),
        text: vec![text],
        pictures: fresh_pictures(fresh),
        table: Some(errors_table(errors)),
        conclusion,
        files: Vec::new(),
    }
}

/// One settled cycle: the loop with both twins, and the residuals of both against the noise.
fn fresh_pictures(fresh: &Fresh) -> Vec<StoryPicture> {
    let before = fresh.before.settled_cycle();
    let after = fresh.after.as_ref().map(Played::settled_cycle);
    let line = |samples: &[Sample], ink, force_n: fn(&Sample) -> Option<f64>| PlotCurve {
        name: String::new(),
        points: curve(samples, force_n),
        ink,
    };
    let mut loops = vec![
        line(before, Ink::Measured, |s| Some(s.force_n)),
        line(before, Ink::Twin, |s| s.twin_force_n),
    ];
    let residual = |s: &Sample| Some(s.force_n - s.twin_force_n?);
    let mut residuals = vec![line(before, Ink::Twin, residual)];
    let mut legend = vec![("unchanged twin", Ink::Twin)];
    if let Some(after) = after {
        loops.push(line(after, Ink::Improved, |s| s.twin_force_n));
        residuals.push(line(after, Ink::Improved, residual));
        legend.push(("improved twin", Ink::Improved));
    }
    let one_cycle = format!("one cycle of {}", fresh.errors.profile);
    let measured = [&[("measured", Ink::Measured)], legend.as_slice()].concat();
    vec![
        loop_picture(&loops, &measured, &one_cycle),
        residual_picture(
            &residuals,
            fresh.noise_n,
            &legend,
            "grey: two standard deviations of the noise",
        ),
    ]
}

fn errors_table(errors: &FreshErrors) -> StoryTable {
    let signed = |v: f64| format!("{:+.2} %", 100.0 * v);
    let none = || "\u{2013}".to_owned();
    let row = |name: &str, cell: &dyn Fn(&FollowErrors) -> String| {
        let after = errors.after.as_ref().map_or_else(none, cell);
        vec![name.to_owned(), cell(&errors.before), after, cell(&errors.truth)]
    };
    StoryTable {
        head: vec!["error of the twin", "unchanged", "improved", "told the truth"],
        rows: vec![
            row("RMS, share of the force range", &|e| percent(e.nrmse)),
            row("peak force of a cycle", &|e| signed(e.peak_force_error)),
            row("energy of its loop", &|e| signed(e.loop_energy_error)),
        ],
    }
}
