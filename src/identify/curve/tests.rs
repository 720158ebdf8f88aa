use super::*;
use crate::model;

/// A sine recording of an equivalent spring: `cycles` from its mean, four steps per sample. `rest` starts it from rest.
fn recording(values: &[f64], cycles: usize, rest: bool) -> Recording {
    let mut plant = model::find("equivalent")
        .and_then(|m| m.plant(values, &toml::Table::new()))
        .expect("within bounds");
    let mut recording = Recording {
        name: "sine".to_owned(),
        ..Recording::default()
    };
    let x = |t: f64| 6.0 + 4.0 * (std::f64::consts::TAU * t).sin();
    if !rest {
        for i in 0..4000 {
            plant.step(x(f64::from(i) / 4000.0), 0.25e-3);
        }
    }
    for i in 0..cycles * 4000 {
        let t = i as f64 / 4000.0;
        let force_n = plant.step(x(t), 0.25e-3);
        if i % 4 == 0 {
            recording.time_s.push(t);
            recording.displacement_mm.push(x(t));
            recording.force_n.push(force_n);
        }
    }
    recording
}

const TRUTH: [f64; 4] = [60.0, 85.0, 0.14, 0.3];

fn problem(recording: Recording, initial: Initial) -> CurveProblem<'static> {
    static NOTHING: std::sync::OnceLock<toml::Table> = std::sync::OnceLock::new();
    let model = model::find("equivalent").expect("listed");
    let structure = NOTHING.get_or_init(toml::Table::new);
    CurveProblem::of_model(model, structure, &[recording], initial).expect("long enough")
}

fn worst(problem: &CurveProblem<'_>) -> f64 {
    let mut out = vec![0.0; problem.count()];
    problem.evaluate(&TRUTH, &mut out).expect("within bounds");
    out.iter().fold(0.0, |m, r| m.max(r.abs()))
}

#[test]
fn initial_state_is_made_by_replaying_or_left_out() {
    // The equivalent spring is exact at any step. With 0.3 mm of presliding, the state before a 4 mm stroke counts exp(-13)
    // after it, and nothing after a cycle.
    let from_rest = worst(&problem(recording(&TRUTH, 3, false), Initial::FromRest));
    assert!(
        from_rest < 1e-6,
        "loading from below ends in full friction: {from_rest}"
    );
    let late = |initial| {
        // Starts on the unloading branch, a quarter cycle after the peak.
        let mut r = recording(&TRUTH, 3, false);
        for column in [&mut r.time_s, &mut r.displacement_mm, &mut r.force_n] {
            column.drain(..500);
        }
        worst(&problem(r, initial))
    };
    assert!(late(Initial::FromRest) > 0.01);
    assert!(late(Initial::ReplayFirstCycle) < 1e-6);
    assert!(late(Initial::Unknown) < 1e-6);
}

#[test]
fn flagged_samples_are_not_compared() {
    let mut measured = recording(&TRUTH, 2, false);
    measured.force_n[700] = 1e6;
    let mut flags = vec![0; measured.len()];
    flags[700] = Flags::SPIKE.bits();
    measured.flags = Some(flags);
    assert_eq!(problem(measured, Initial::ReplayFirstCycle).count(), 1999);
}

#[test]
fn unusable_recordings_are_refused_by_name() {
    let model = model::find("equivalent").expect("listed");
    let mut broken = recording(&TRUTH, 1, true);
    broken.force_n[3] = f64::NAN;
    let nothing = toml::Table::new();
    let error = CurveProblem::of_model(model, &nothing, &[broken], Initial::FromRest)
        .err()
        .expect("not a number");
    assert!(error.to_string().contains("sine"), "{error}");
}
