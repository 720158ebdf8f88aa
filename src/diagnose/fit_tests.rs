//! Fits of the search end near their minimum, on loops whose friction and curve the baseline does not have.

use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::fitting::{fitted_input, input, with_general_law};
use super::*;

/// Number of drawn specimens, and of further fits after the first.
const SPECIMENS: u64 = 6;
const FURTHER_FITS: usize = 4;
/// A sum of squares that is this far above its minimum changes a decision between two names.
const FAR: f64 = 10.0;
/// An effect that explains nothing leaves the sum of squares as it was, within this share. Without the smaller starts, 4 fits ended 40 % to
/// 600 times above; with them, the worst is 1 % above.
const SAME: f64 = 0.05;

/// A curved spring with friction after Bouc and Wen (the drag approaches its limit with a power of what is left) under four sines.
fn recordings(seed: u64) -> Vec<Recording> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut between = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
    let (rate, curve, ratio) = (between(60.0, 90.0), between(0.0, 0.4), between(0.04, 0.1));
    let (settling_mm, power) = (between(0.3, 1.5), between(0.7, 2.0));
    let motions = [
        (20.0, 15.0, 0.2),
        (15.0, 5.0, 1.0),
        (25.0, 5.0, 3.0),
        (20.0, 12.0, 0.5),
    ];
    let mut recordings = Vec::new();
    for (k, (mean_mm, amplitude_mm, hz)) in motions.into_iter().enumerate() {
        let mut recording = Recording {
            name: format!("sine-{k}.csv"),
            ..Recording::default()
        };
        let (mut drag, mut before_mm) = (0.0f64, 0.0);
        for i in 0..1500 {
            let time_s = 8.0 / hz * f64::from(i) / 1500.0;
            let ramp = (hz * time_s).min(1.0);
            let x_mm = ramp * (mean_mm - amplitude_mm * (TAU * hz * time_s).cos());
            let part_mm = (x_mm - before_mm) / 20.0;
            for _ in 0..20 {
                let left = (1.0 - part_mm.signum() * drag).clamp(0.0, 2.0);
                drag += part_mm / settling_mm * left.powf(power);
                drag = drag.clamp(-1.0, 1.0);
            }
            before_mm = x_mm;
            let spring_n = 100.0 + rate * x_mm + curve * x_mm * x_mm;
            recording.time_s.push(time_s);
            recording.displacement_mm.push(x_mm);
            recording
                .force_n
                .push(spring_n * (1.0 + ratio * drag) + between(-3.0, 3.0));
        }
        recordings.push(recording);
    }
    recordings
}

/// How far the fits of one candidate end above what they could reach, in sum of squares.
/// The further fits take the same slopes, so this does not show slopes that are wrong: for that, compare with fits that have others.
struct CandidateFit {
    code: &'static str,
    /// First fit: above that of the set without the candidate, as a share of it.
    above_parent: f64,
    /// Converged fit: above what further fits reach.
    above_minimum: f64,
}

/// The fits of one specimen's candidates.
fn candidate_fits(seed: u64) -> Vec<CandidateFit> {
    let recordings = recordings(seed);
    let options = DiagnoseOptions::default();
    let baseline = Baseline::of(crate::model::find("equivalent").expect("listed"));
    let mut setup = Setup::new(&baseline).expect("valid");
    let points = options.points_of_each(recordings.len());
    let tracks = conditioning::tracks(&recordings, points).expect("conditioned");
    let input = input(tracks, &options).expect("threads");
    let (data, run, fitted) = fitted_input(&mut setup, input, &recordings, &options).expect("fitted");
    let searches = search::searches(&run, &mut setup, &data, &fitted, &mut |_, _| {}).expect("finite");
    let context = run.context(&setup, &data);
    let parent = context.converged(&searches.first.nodes[0]).expect("finite");
    let children = context.children(std::slice::from_ref(&parent), &[], usize::MAX);
    let fits = children.iter();
    fits.filter_map(|child| {
        let (first, _) = context.converged(child)?;
        let further = (0..FURTHER_FITS).try_fold(first.clone(), |node, _| {
            context.converged(&node).map(|(node, _)| node)
        })?;
        Some(CandidateFit {
            code: child.attached.last()?.effect.code,
            above_parent: child.fit / parent.0.fit - 1.0,
            above_minimum: first.fit - further.fit,
        })
    })
    .collect()
}

/// Bristles whose motion shakes, in a case that was looked at. Without its bends the law that forgets reversals is further off than the
/// baseline's own. The fit went back to that and ended at 330 000, with a law of size zero. It still ends far from the noise.
#[test]
fn a_law_that_needs_its_bends_leaves_the_baseline_s_own() {
    let case = crate::truth::Case::draw(crate::truth::World::Lugre, 821_968_164, 2, None);
    let options = DiagnoseOptions::default();
    let baseline = Baseline::of(crate::model::find("equivalent").expect("listed"));
    let mut setup = Setup::new(&baseline).expect("valid");
    let points = options.points_of_each(case.recordings.len());
    let tracks = conditioning::tracks(&case.recordings, points).expect("conditioned");
    let input = input(tracks, &options).expect("threads");
    let (data, run, fitted) = fitted_input(&mut setup, input, &case.recordings, &options).expect("fitted");
    setup.form = setup.forms.last().cloned();
    let context = run.context(&setup, &data);
    let general = with_general_law(&context, &fitted).expect("likelier than the baseline's own law");
    assert!(
        general.cost() < 0.5 * fitted.cost(),
        "{} of {}",
        general.cost(),
        fitted.cost()
    );
    let own = general.values[setup.model.friction_ratio.expect("a friction of its own")];
    let of_law = general.values[setup.model.parameters.len()];
    assert!(own < 0.1 * of_law, "{own} beside {of_law}");
}

#[test]
fn fits_of_candidates_end_near_their_minimum() {
    let specimens = (0..SPECIMENS).map(|k| 9100 + k);
    let fits: Vec<CandidateFit> = specimens.flat_map(candidate_fits).collect();
    assert!(fits.len() >= 40, "{} fits", fits.len());
    let far = fits.iter().filter(|fit| fit.above_minimum > FAR).count();
    // 1 of 60; 7 of 59 where a round keeps the damping that a failed step has left.
    assert!(
        20 * far <= fits.len(),
        "{far} of {} fits end far above their minimum",
        fits.len()
    );
    for fit in &fits {
        let above = fit.above_parent;
        assert!(above < SAME, "{} ends {above} above the set without it", fit.code);
    }
}
