//! Concealed effects are found, absent ones are not named, strangers are called unknown. The truth is in `support/truth.rs`,
//! which shares no code with the library.

use super::support::truth;
use crate::diagnose::{Baseline, DiagnoseOptions, Diagnosis, Verdict, diagnose};
use crate::recording::Recording;

fn recordings(codes: &[&'static str], strength: f64, seed: u64) -> Vec<Recording> {
    let mut random = truth::seeded(seed);
    let mut bench = truth::Bench::drawn(&mut random);
    if codes.contains(&"lift_off") {
        bench.preload_n = 0.0;
    }
    let hidden: Vec<_> = codes
        .iter()
        .map(|c| bench.effect(c, strength, &mut random))
        .collect();
    bench.record(&hidden, &mut random)
}

fn judge(recordings: &[Recording]) -> Diagnosis {
    let baseline = Baseline::of(crate::model::find("equivalent").expect("listed"));
    let options = DiagnoseOptions::default();
    diagnose(recordings, &baseline, &options, &mut |_, _| {}).expect("diagnosed")
}

fn codes(diagnosis: &Diagnosis) -> Vec<&str> {
    let mut codes: Vec<&str> = diagnosis.effects.iter().map(|e| e.code.as_str()).collect();
    codes.sort_unstable();
    codes
}

#[test]
fn nothing_hidden_nothing_named() {
    for seed in [1, 2] {
        let diagnosis = judge(&recordings(&[], 0.0, seed));
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
        let diagnosis = judge(&recordings(&[code], 5.0, 11));
        assert_eq!(codes(&diagnosis), [code], "{}", diagnosis.summary);
        let fit = &diagnosis.fit;
        assert!(
            fit.improved.nrmse_heldout < 0.6 * fit.baseline.nrmse_heldout,
            "{code}"
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
    let diagnosis = judge(&recordings(&["coulomb_friction", "sensor_drift"], 5.0, 21));
    for row in diagnosis.candidates.iter().take(14) {
        println!(
            "{:.1} {:.1} {:?} {}",
            row.gain, row.gain_heldout, row.codes, row.chosen
        );
    }
    assert_eq!(
        codes(&diagnosis),
        ["coulomb_friction", "sensor_drift"],
        "{}",
        diagnosis.summary
    );
}

#[test]
fn what_no_library_has_is_unknown_and_located() {
    let mut random = truth::seeded(31);
    let bench = truth::Bench::drawn(&mut random);
    let hidden = bench.effect("local_friction", 5.0, &mut random);
    let diagnosis = judge(&bench.record(&[hidden], &mut random));
    assert_eq!(diagnosis.verdict, Verdict::Unexplained, "{}", diagnosis.summary);
    assert!(diagnosis.effects.is_empty());
    let place = diagnosis
        .location
        .iter()
        .find(|l| l.axis == crate::effect::Axis::DisplacementMm)
        .expect("located along the displacement");
    let (low, high) = (hidden.place - 1.5, hidden.place + 1.5);
    let both = (place.to.min(high) - place.from.max(low)).max(0.0);
    assert!(
        both / (place.to.max(high) - place.from.min(low)) > 0.5,
        "{place:?}"
    );
}

#[test]
fn a_look_alike_is_reported_with_the_test_that_would_tell() {
    let diagnosis = judge(&recordings(&["viscous_damping"], 2.0, 41));
    let named: Vec<&str> = codes(&diagnosis)
        .into_iter()
        .chain(diagnosis.alternatives.iter().map(|a| a.code.as_str()))
        .collect();
    assert!(named.contains(&"viscous_damping"), "{}", diagnosis.summary);
    assert!(
        diagnosis
            .alternatives
            .iter()
            .all(|a| !a.why.is_empty() && !a.test.is_empty())
    );
}

#[test]
fn same_input_same_diagnosis_whatever_the_cores() {
    let recordings = recordings(&["coulomb_friction"], 3.0, 51);
    let baseline = Baseline::of(crate::model::find("equivalent").expect("listed"));
    let run = |threads| {
        let options = DiagnoseOptions {
            points: 600,
            threads,
            ..DiagnoseOptions::default()
        };
        let diagnosis = diagnose(&recordings, &baseline, &options, &mut |_, _| {}).expect("diagnosed");
        serde_json::to_string(&diagnosis).expect("serialises")
    };
    assert_eq!(run(1), run(2));
}
