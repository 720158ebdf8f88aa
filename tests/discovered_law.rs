//! Forces that nobody has a formula for, end to end: concealed in the mock rig as a table, recorded through the whole chain, read off
//! the recordings, put into the twin, and proven on a profile that was not recorded before.

use super::support::bench::{mock, play, sine, twin_nrmse};
use crate::cli::diagnose::improved_bench;
use crate::config::Bench;
use crate::diagnose::{Baseline, DiagnoseOptions, Diagnosis, Verdict, diagnose};
use crate::effect::Axis;
use crate::effect::law::ForceLaw;
use crate::model;
use crate::recording::csv;

/// A table over the displacement, 0 to 45 mm.
fn over_displacement(opposes_motion: bool, force: impl Fn(f64) -> f64) -> ForceLaw {
    let at: Vec<f64> = (0..=180).map(|k| 0.25 * f64::from(k)).collect();
    ForceLaw {
        axis: Axis::DisplacementMm,
        opposes_motion,
        per_load: false,
        force: at.iter().map(|x| force(*x)).collect(),
        at,
    }
}

fn diagnosed(bench: &Bench) -> Diagnosis {
    let folder = tempfile::tempdir().expect("a folder");
    let profiles = [sine("wide", 26.0, 0.5, 6), sine("narrow", 12.0, 1.5, 8)];
    let recordings: Vec<_> = profiles
        .iter()
        .map(|profile| {
            let (_, csv) = play(bench, profile, Some(folder.path()));
            csv::read_file(&csv.expect("exported")).expect("a recording")
        })
        .collect();
    let mut baseline = Baseline::of(model::find(&bench.model.name).expect("listed"));
    baseline.start = Some(bench.model.values().expect("sound"));
    diagnose(
        &recordings,
        &baseline,
        &DiagnoseOptions::default(),
        &mut |_, _| {},
    )
    .expect("diagnosed")
}

/// The law is read off, on its axis and branches, and the twin with it follows a new profile to the noise.
fn is_discovered(law: ForceLaw) {
    let mut bench = mock();
    bench.specimen.model.law = Some(law.clone());
    let found = diagnosed(&bench);
    assert_eq!(found.verdict, Verdict::Unexplained, "{}", found.summary);
    let discovered = found.law.as_ref().expect("modelled");
    assert_eq!(
        (discovered.law.axis, discovered.law.opposes_motion),
        (law.axis, law.opposes_motion),
        "{}",
        discovered.statement
    );
    println!(
        "{}; explained {:.3}",
        discovered.statement, discovered.explained_share
    );
    let new = sine("new", 20.0, 0.8, 5);
    let (before, _) = play(&bench, &new, None);
    let mut improved = improved_bench(&bench, &found.improved);
    improved.specimen = bench.specimen.clone();
    let (after, _) = play(&improved, &new, None);
    let mut told = bench.clone();
    told.model = bench.specimen.model.clone();
    let (truth, _) = play(&told, &new, None);
    let [before, after, truth] = [before, after, truth].map(|run| twin_nrmse(&run.samples));
    println!(
        "twin on a new profile: {before:.5} before, {after:.5} with the law, {truth:.5} if it were told"
    );
    assert!(
        after < 2.0 * truth && after < 0.3 * before,
        "{before}, {after}, {truth}"
    );
}

#[test]
fn a_ripple_over_the_displacement_is_discovered() {
    is_discovered(over_displacement(false, |x| {
        15.0 * (std::f64::consts::TAU * x / 7.0).sin()
    }));
}

#[test]
fn a_magnet_that_catches_at_one_place_is_discovered() {
    is_discovered(over_displacement(false, |x| {
        let u = (x - 15.0) / 2.5;
        -60.0 * u * (-u * u).exp()
    }));
}

#[test]
fn friction_that_bites_at_one_place_is_discovered() {
    is_discovered(over_displacement(true, |x| {
        30.0 * (-((x - 16.0) / 3.0).powi(2)).exp()
    }));
}
