//! Diagnosis from a leaf pack: the specimen on the mock rig is a whole pack, so is the baseline, and a surrogate stands for it
//! while candidates are compared.
//!
//! The full case, five recordings of some 3000 samples, prints its times:
//! `cargo test --release --lib diagnose_leaf_pack -- --ignored --nocapture`.

use std::path::Path;
use std::time::Instant;

use super::support::bench::{play, sine};
use crate::config::{Bench, EffectConfig};
use crate::diagnose::{Baseline, DiagnoseOptions, Diagnosis, Verdict, diagnose};
use crate::model::Plant;
use crate::recording::Recording;

/// Seconds for five recordings of 3000 samples on two cores.
const AT_MOST_S: f64 = 60.0;

/// The first paper's spring on the rail, its force followed with every step of the hydraulics: once a millisecond would be a
/// lag of half of that, and rightly be named.
fn rail() -> Bench {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/benches/samurai-rail.toml");
    let mut bench = Bench::load(&path).expect("shipped");
    bench.mock_rig.insert("plant_steps_per_ms".to_owned(), 5.into());
    bench
}

/// A run on the mock rig, thinned to `samples`.
fn recorded(bench: &Bench, profile_toml: &str, samples: usize) -> Recording {
    let (memory, _) = play(bench, profile_toml, None);
    let kept: Vec<_> = memory.samples.iter().filter(|s| s.segment > 0).collect();
    let mut recording = Recording::default();
    for sample in kept.iter().step_by(kept.len().div_ceil(samples)) {
        recording.time_s.push(sample.time_s);
        recording.displacement_mm.push(sample.displacement_mm);
        recording.force_n.push(sample.force_n);
    }
    recording
}

/// Up and down three times.
fn ramps(to_mm: f64, duration_s: f64) -> String {
    let ramp = |to_mm: f64| {
        format!("[[block.segment]]\nkind = \"ramp\"\nto_mm = {to_mm:?}\nduration_s = {duration_s:?}\n")
    };
    let (up, down) = (ramp(to_mm), ramp(1.0));
    format!("name = \"ramps\"\ncontrol = \"displacement\"\n[[block]]\nrepeat = 3\n{up}{down}")
}

/// A specimen that differs from what the bench's file says of it.
struct Truth {
    code: &'static str,
    effect: &'static [(&'static str, f64)],
    pack: &'static [(&'static str, f64)],
}

impl Truth {
    fn conceal(&self, bench: &mut Bench) {
        let owned = |list: &[(&str, f64)]| {
            list.iter()
                .map(|(n, v)| ((*n).to_owned(), *v))
                .collect::<Vec<_>>()
        };
        bench.specimen.model.parameters.extend(owned(self.pack));
        if !self.code.is_empty() {
            bench.specimen.model.effects.push(EffectConfig {
                code: self.code.to_owned(),
                parameters: owned(self.effect).into_iter().collect(),
            });
        }
    }
}

/// Diagnoses from what the bench's file says of the specimen; the recordings are of what it is.
fn judge(
    bench: &Bench,
    truth: &Truth,
    profiles: &[String],
    samples: usize,
) -> (Diagnosis, Vec<Recording>, f64) {
    let mut real = bench.clone();
    truth.conceal(&mut real);
    let recordings: Vec<Recording> = profiles.iter().map(|p| recorded(&real, p, samples)).collect();
    let mut baseline = Baseline::of(crate::model::find("leaf-pack").expect("listed"));
    baseline.structure = bench.model.structure.clone();
    baseline.start = Some(bench.model.values().expect("shipped"));
    let begun = Instant::now();
    let diagnosis = diagnose(
        &recordings,
        &baseline,
        &DiagnoseOptions::default(),
        &mut |_, _| {},
    )
    .expect("diagnosed");
    let took_s = begun.elapsed().as_secs_f64();
    let points: Vec<usize> = recordings.iter().map(Recording::len).collect();
    println!(
        "{:?} of {points:?} samples: {took_s:.1} s, {}",
        truth.code, diagnosis.summary
    );
    (diagnosis, recordings, took_s)
}

fn codes(diagnosis: &Diagnosis) -> Vec<&str> {
    diagnosis.effects.iter().map(|e| e.code.as_str()).collect()
}

/// Down to what the recordings, and the model's steps over them, leave open.
fn explained(diagnosis: &Diagnosis) {
    let fit = &diagnosis.fit;
    assert!(
        fit.improved.nrmse_heldout < 1.15 * fit.noise_floor_nrmse,
        "{fit:?}"
    );
}

/// Error of a plant run by itself over a recording, every noisy displacement as it is.
fn alone(mut plant: Box<dyn Plant>, zero_n: f64, recording: &Recording) -> f64 {
    let (mut squares, mut before_s) = (0.0, 0.0);
    for i in 0..recording.len() {
        let dt_s = (recording.time_s[i] - before_s).max(1e-6);
        let model_n = plant.step(recording.displacement_mm[i], dt_s) + zero_n;
        squares += (recording.force_n[i] - model_n).powi(2);
        before_s = recording.time_s[i];
    }
    let most_n = recording.force_n.iter().copied().fold(0.0, f64::max);
    (squares / recording.len() as f64).sqrt() / most_n
}

const WRONG: Truth = Truth {
    code: "",
    effect: &[],
    pack: &[("interleaf_mu", 0.22), ("clamp_length_mm", 92.0)],
};
/// One that adds a force, one that shifts the displacement.
const DAMPED: Truth = Truth {
    code: "viscous_damping",
    effect: &[("damping_n_s_per_mm", 0.3)],
    pack: &[],
};
const LAGGING: Truth = Truth {
    code: "channel_delay",
    effect: &[("delay_ms", 2.0)],
    pack: &[],
};

fn small() -> (Bench, [String; 2]) {
    let mut bench = rail();
    for model in [&mut bench.model, &mut bench.specimen.model] {
        model.structure.insert("segments".to_owned(), 32.into());
    }
    (bench, [ramps(14.0, 2.0), sine("sine", 6.0, 2.5, 8)])
}

#[test]
fn a_pack_whose_parameters_are_wrong_is_refitted_and_nothing_is_named() {
    let (bench, profiles) = small();
    let (diagnosis, recordings, _) = judge(&bench, &WRONG, &profiles, 700);
    assert_eq!(diagnosis.verdict, Verdict::Adequate, "{}", diagnosis.summary);
    for (name, truth) in WRONG.pack {
        let found = diagnosis.baseline_parameters.iter().find(|p| p.name == *name);
        let found = found.expect("listed");
        assert!((found.value / truth - 1.0).abs() < 0.1, "{found:?} for {truth}");
    }
    let nominal = diagnosis.fit.ladder[0].errors;
    assert!(nominal.nrmse_heldout > 5.0 * diagnosis.fit.improved.nrmse_heldout);
    // What the recordings say nothing of is held, and that is said.
    let held = |name: &str| {
        diagnosis
            .alarms
            .iter()
            .any(|a| a.contains(name) && a.contains("held"))
    };
    assert!(
        held("shackle_angle_rad") && !held("clamp_length_mm"),
        "{:?}",
        diagnosis.alarms
    );
    explained(&diagnosis);
    // The pack itself, not its surrogate, is what is written to the improved model.
    let improved = diagnosis
        .improved
        .plant()
        .expect("the improved model can be built");
    let improved = alone(improved, diagnosis.improved.force_zero_n, &recordings[0]);
    let model = crate::model::find("leaf-pack").expect("listed");
    let wrong = model.plant(&bench.model.values().expect("shipped"), &bench.model.structure);
    let wrong = alone(wrong.expect("shipped"), 0.0, &recordings[0]);
    println!(
        "  by itself: wrong {:.3} %, improved {:.3} %",
        100.0 * wrong,
        100.0 * improved
    );
    assert!(improved < 0.5 * wrong, "{improved} of {wrong}");
}

#[test]
fn what_a_pack_lacks_is_named() {
    let (bench, profiles) = small();
    for truth in [&DAMPED, &LAGGING] {
        let (diagnosis, _, _) = judge(&bench, truth, &profiles, 700);
        assert_eq!(codes(&diagnosis), [truth.code], "{}", diagnosis.summary);
        let found = &diagnosis.effects[0].parameters[0];
        assert!((found.value / truth.effect[0].1 - 1.0).abs() < 0.07, "{found:?}");
        explained(&diagnosis);
    }
}

#[test]
#[ignore = "minutes; prints the times of the full case"]
fn five_recordings_within_a_minute() {
    let bench = rail();
    let profiles = [
        ramps(22.0, 5.0),
        sine("sine-15-1", 15.0, 1.0, 12),
        sine("sine-6-2.5", 6.0, 2.5, 20),
        sine("sine-10-1", 10.0, 1.0, 12),
        sine("sine-6-1", 6.0, 1.0, 12),
    ];
    let truth = |code, effect| Truth {
        code,
        effect,
        pack: &[],
    };
    let cases = [
        truth("", &[]),
        WRONG,
        DAMPED,
        LAGGING,
        truth("sensor_drift", &[("drift_n_per_min", 10.0)]),
        truth(
            "relaxation",
            &[("arm_rate_n_per_mm", 2.0), ("time_constant_s", 1.5)],
        ),
        truth("backlash", &[("gap_mm", 0.05)]),
        truth(
            "stribeck",
            &[("extra_ratio", 0.02), ("fading_velocity_mm_s", 8.0)],
        ),
    ];
    let mut slow = Vec::new();
    for case in &cases {
        let (diagnosis, _, took_s) = judge(&bench, case, &profiles, 3000);
        let wanted: Vec<&str> = [case.code].into_iter().filter(|c| !c.is_empty()).collect();
        assert_eq!(codes(&diagnosis), wanted, "{}", diagnosis.summary);
        explained(&diagnosis);
        if took_s > AT_MOST_S {
            slow.push((case.code, took_s));
        }
    }
    assert!(slow.is_empty(), "slower than {AT_MOST_S} s: {slow:?}");
}
