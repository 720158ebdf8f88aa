//! Diagnosis of a leaf pack: the specimen on the mock rig and the baseline are leaf packs. A surrogate replaces the pack while
//! candidates are compared.
//!
//! The full case has five recordings of about 3000 samples and takes minutes:
//! `cargo test --release --lib diagnose_leaf_pack -- --ignored`.

use std::path::Path;
use std::time::Instant;

use super::support::bench::{play, sine};
use crate::config::{Bench, EffectConfig};
use crate::diagnose::{Baseline, DiagnoseOptions, Diagnosis, Verdict, diagnose};
use crate::model::Plant;
use crate::recording::Recording;

/// Largest duration in s of a diagnosis of five recordings of 3000 samples on two cores.
const AT_MOST_S: f64 = 60.0;

/// The spring of Kadziela et al. without shackle. The mock rig updates its force in every step of the hydraulics, because
/// once a millisecond would be a channel delay of half a millisecond, and the diagnosis would name it.
fn rail() -> Bench {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/benches/samurai-rail.toml");
    let mut bench = Bench::load(&path).expect("shipped");
    bench.mock_rig.insert("plant_steps_per_ms".to_owned(), 5.into());
    bench
}

/// Records a run on the mock rig and keeps about `samples` samples.
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

/// A profile of three ramps up and down.
fn ramps(to_mm: f64, duration_s: f64) -> String {
    let ramp = |to_mm: f64| {
        format!("[[block.segment]]\nkind = \"ramp\"\nto_mm = {to_mm:?}\nduration_s = {duration_s:?}\n")
    };
    let (up, down) = (ramp(to_mm), ramp(1.0));
    format!("name = \"ramps\"\ncontrol = \"displacement\"\n[[block]]\nrepeat = 3\n{up}{down}")
}

/// Differences between the specimen and the bench file.
struct Truth {
    /// Code of an effect that the bench file does not have; empty for none.
    code: &'static str,
    /// Parameters of that effect.
    effect: &'static [(&'static str, f64)],
    /// Parameters of the pack that differ.
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

/// Records the real specimen and diagnoses it with the baseline of the bench file. Also returns the duration in s.
fn judge(
    bench: &Bench,
    truth: &Truth,
    profiles: &[String],
    samples: usize,
) -> (Diagnosis, Vec<Recording>, f64) {
    let mut real = bench.clone();
    truth.conceal(&mut real);
    let recordings: Vec<Recording> = profiles.iter().map(|p| recorded(&real, p, samples)).collect();
    let (diagnosis, took_s) = diagnosed(bench, &recordings);
    (diagnosis, recordings, took_s)
}

/// Diagnoses recordings with the baseline of the bench file. Also returns the duration in s.
fn diagnosed(bench: &Bench, recordings: &[Recording]) -> (Diagnosis, f64) {
    let mut baseline = Baseline::of(crate::model::find("leaf-pack").expect("listed"));
    baseline.structure = bench.model.structure.clone();
    baseline.start = Some(bench.model.values().expect("shipped"));
    let begun = Instant::now();
    let diagnosis =
        diagnose(recordings, &baseline, &DiagnoseOptions::default(), &mut |_, _| {}).expect("diagnosed");
    (diagnosis, begun.elapsed().as_secs_f64())
}

fn codes(diagnosis: &Diagnosis) -> Vec<&str> {
    diagnosis.effects.iter().map(|e| e.code.as_str()).collect()
}

/// Asserts that the held-out error is not much above the noise floor.
fn explained(diagnosis: &Diagnosis) {
    let fit = &diagnosis.fit;
    assert!(
        fit.improved.nrmse_heldout < 1.15 * fit.noise_floor_nrmse,
        "{fit:?}"
    );
}

/// NRMSE of a plant that is stepped over a recording with its noisy displacement.
fn nrmse(mut plant: Box<dyn Plant>, zero_n: f64, recording: &Recording) -> f64 {
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

/// A pack with wrong parameters and no missing effect.
const WRONG: Truth = Truth {
    code: "",
    effect: &[],
    pack: &[("interleaf_mu", 0.22), ("clamp_length_mm", 92.0)],
};
/// An effect that adds a force.
const DAMPED: Truth = Truth {
    code: "viscous_damping",
    effect: &[("damping_n_s_per_mm", 0.3)],
    pack: &[],
};
/// An effect that shifts the displacement.
const LAGGING: Truth = Truth {
    code: "channel_delay",
    effect: &[("delay_ms", 2.0)],
    pack: &[],
};

/// The bench with a coarser pack, and two short profiles.
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
    // A parameter that the recordings cannot identify is held, and the diagnosis says so.
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
    // The improved model is the pack itself and not its surrogate.
    let improved = diagnosis
        .improved
        .plant()
        .expect("the improved model can be built");
    let improved = nrmse(improved, diagnosis.improved.force_zero_n, &recordings[0]);
    let model = crate::model::find("leaf-pack").expect("listed");
    let wrong = model.plant(&bench.model.values().expect("shipped"), &bench.model.structure);
    let wrong = nrmse(wrong.expect("shipped"), 0.0, &recordings[0]);
    assert!(improved < 0.5 * wrong, "{improved} of {wrong}");
}

#[test]
fn the_missing_effect_of_a_pack_is_named() {
    let (bench, profiles) = small();
    for truth in [&DAMPED, &LAGGING] {
        let (diagnosis, _, _) = judge(&bench, truth, &profiles, 700);
        assert_eq!(codes(&diagnosis), [truth.code], "{}", diagnosis.summary);
        let found = &diagnosis.effects[0].parameters[0];
        assert!((found.value / truth.effect[0].1 - 1.0).abs() < 0.07, "{found:?}");
        explained(&diagnosis);
    }
}

/// What differs between recordings is seen without a model, so a slow one does not hide it.
#[test]
fn an_lvdt_zero_of_each_recording_of_a_pack_is_taken_out() {
    const ZEROS_MM: [f64; 3] = [0.0, 0.4, -0.25];
    let (bench, [_, fast]) = small();
    let profiles = [ramps(22.0, 2.0), fast, sine("slow", 10.0, 1.0, 6)];
    let mut recordings: Vec<Recording> = profiles.iter().map(|p| recorded(&bench, p, 900)).collect();
    for ((recording, zero_mm), name) in recordings.iter_mut().zip(ZEROS_MM).zip(["ramps", "fast", "slow"]) {
        recording.name = name.to_owned();
        recording.displacement_mm.iter_mut().for_each(|x| *x += zero_mm);
    }
    let (diagnosis, _) = diagnosed(&bench, &recordings);
    assert_eq!(diagnosis.verdict, Verdict::Adequate, "{}", diagnosis.summary);
    let taken_out_mm = |name: &str| {
        let mut of_recording = diagnosis.notes.iter().filter(|n| n.recording == name);
        of_recording
            .find(|n| n.kind.word() == "zero")
            .map_or(0.0, |n| n.size.value)
    };
    let found_mm = ["ramps", "fast", "slow"].map(taken_out_mm);
    for (found, truth) in found_mm.iter().zip(ZEROS_MM) {
        assert!((found - found_mm[0] - truth).abs() < 0.03, "{found_mm:?}");
    }
}

#[test]
#[ignore = "takes minutes"]
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
