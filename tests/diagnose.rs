//! The diagnosis on cases of `truth` with chosen effects: hidden effects are named, absent effects are not, and physics that
//! the library does not have is reported as unknown. Random cases are in `blind.rs`.

use crate::diagnose::{Baseline, DiagnoseOptions, Diagnosis, Verdict, diagnose};
use crate::truth::{Case, Family};

/// Strength, in detection limits, at which an effect changes the force by about twice the noise.
const CLEAR: f64 = 10.0;

fn judge(case: &Case) -> Diagnosis {
    let options = DiagnoseOptions::default();
    diagnose(&case.recordings, &equivalent(), &options, &mut |_, _| {}).expect("diagnosed")
}

fn equivalent() -> Baseline {
    Baseline::of(crate::model::find("equivalent").expect("listed"))
}

fn codes(diagnosis: &Diagnosis) -> Vec<&str> {
    let mut codes: Vec<&str> = diagnosis.effects.iter().map(|e| e.code.as_str()).collect();
    codes.sort_unstable();
    codes
}

#[test]
fn nothing_hidden_nothing_named() {
    for seed in [1, 2] {
        let case = Case::hiding(Family::None, &[], seed, 0.0).expect("nothing hidden needs no size");
        let diagnosis = judge(&case);
        assert_eq!(
            diagnosis.verdict,
            Verdict::Adequate,
            "seed {seed}: {}",
            diagnosis.summary
        );
    }
}

#[test]
fn single_effects_are_named_and_the_fit_improves_to_the_noise() {
    for code in [
        "coulomb_friction",
        "progressive_stiffness",
        "sensor_drift",
        "backlash",
    ] {
        let diagnosis = judge(&Case::single(code, 11, CLEAR).expect("visible"));
        assert_eq!(codes(&diagnosis), [code], "{}", diagnosis.summary);
        let fit = &diagnosis.fit;
        assert!(
            fit.improved.nrmse_heldout < 0.6 * fit.baseline.nrmse_heldout,
            "{code}: {fit:?}"
        );
        assert!(
            fit.improved.nrmse_heldout < 1.6 * fit.noise_floor_nrmse,
            "{code}: {fit:?}"
        );
        let mut plant = diagnosis
            .improved
            .plant()
            .expect("the improved model can be built");
        assert!(plant.step(3.0, 0.1).is_finite());
    }
}

#[test]
fn two_effects_are_found_as_two() {
    let pair = ["coulomb_friction", "sensor_drift"];
    let case = Case::hiding(Family::Pair, &pair, 21, CLEAR).expect("visible");
    let diagnosis = judge(&case);
    assert_eq!(
        codes(&diagnosis),
        pair,
        "{}; best candidates: {:?}",
        diagnosis.summary,
        diagnosis.candidates.iter().take(14).collect::<Vec<_>>()
    );
}

#[test]
fn what_no_library_has_is_unknown_and_located() {
    let case = Case::hiding(Family::Outside, &["local_friction"], 31, CLEAR).expect("visible");
    let diagnosis = judge(&case);
    assert_eq!(diagnosis.verdict, Verdict::Unexplained, "{}", diagnosis.summary);
    assert!(diagnosis.effects.is_empty());
    let place = diagnosis
        .location
        .iter()
        .find(|l| l.axis == crate::effect::Axis::DisplacementMm)
        .expect("located along the displacement");
    let (_, low, high) = case.label.hidden[0]
        .interval(case.label.top[0])
        .expect("a local friction has an interval");
    let both = (place.to.min(high) - place.from.max(low)).max(0.0);
    assert!(
        both / (place.to.max(high) - place.from.min(low)) > 0.5,
        "{place:?} for {low} to {high}"
    );
}

#[test]
fn a_look_alike_is_reported_with_the_test_that_would_tell() {
    let case = Case::hiding(Family::Confounded, &["viscous_damping"], 41, 2.0).expect("visible");
    let diagnosis = judge(&case);
    let named: Vec<&str> = codes(&diagnosis)
        .into_iter()
        .chain(diagnosis.alternatives.iter().map(|a| a.code.as_str()))
        .collect();
    assert!(named.contains(&"viscous_damping"), "{}", diagnosis.summary);
    assert!(!diagnosis.alternatives.is_empty(), "{}", diagnosis.summary);
    assert!(
        diagnosis
            .alternatives
            .iter()
            .all(|a| !a.why.is_empty() && !a.test.is_empty())
    );
}

#[test]
fn same_input_same_diagnosis_whatever_the_cores() {
    let case = Case::single("coulomb_friction", 51, 3.0).expect("visible");
    let run = |threads| {
        let options = DiagnoseOptions {
            points: 600,
            threads,
            ..DiagnoseOptions::default()
        };
        let diagnosis =
            diagnose(&case.recordings, &equivalent(), &options, &mut |_, _| {}).expect("diagnosed");
        serde_json::to_string(&diagnosis).expect("serialises")
    };
    assert_eq!(run(1), run(2));
}
