//! An effect of twice the detection limit, concealed in the mock rig, raises the twin's alarm within three cycles.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::support::bench::{concealing, mock, play, shipped_profiles};
use crate::config::Bench;
use crate::recording::EventKind;
use crate::truth::limit::VisibilityMeter;
use crate::truth::{Form, Hidden, Programme, TruthSpecimen, World, catalogue};

/// Strength in detection limits of three cycles (docs/blind.md).
const STRENGTH: f64 = 2.0;
/// Counted cycles within which the twin must report.
const CYCLES: u32 = 3;
/// Effects of the catalogue whose parameters in the mock rig follow from their size. Two are left out, because at this strength no
/// twin can see them: a gap of 6 um, less than the play in front of the twin, and a limit that clips for 15 ms on each side of a peak.
const CODES: [&str; 9] = [
    "channel_delay",
    "coulomb_friction",
    "inertia",
    "lift_off",
    "progressive_stiffness",
    "relaxation",
    "sensor_drift",
    "series_compliance",
    "viscous_damping",
];
/// The shipped profile that moves the specimen most, and its sine.
const PROFILE: &str = "sine-15mm-1hz";
const SINE: Programme = Programme::Sine {
    mean_mm: 20.0,
    amplitude_mm: 15.0,
    frequency_hz: 1.0,
    cycles: 3.0,
};
const SAMPLES_PER_S: u32 = 200;

/// The specimen of the mock bench in the formulation of the blind test.
fn specimen(bench: &Bench) -> TruthSpecimen {
    let value = |name: &str| bench.specimen.model.parameters[name];
    TruthSpecimen {
        preload_n: value("preload_n"),
        rate_n_per_mm: value("rate_n_per_mm"),
        friction_ratio: value("friction_ratio"),
        presliding_mm: value("presliding_mm"),
        power: 1.0,
        form: Form::Gradual,
        bushing_n: 0.0,
        range_n: value("rate_n_per_mm") * 35.0,
        world: World::Own,
        build: 0.0,
    }
}

/// The effect at [`STRENGTH`] in three cycles of [`SINE`].
fn sized(bench: &Bench, code: &'static str) -> (TruthSpecimen, Hidden) {
    let specimen = specimen(bench);
    let physics = catalogue::find(code).expect("listed");
    let noise = bench.noise();
    let sigma_n = noise
        .force_n
        .hypot(specimen.rate_n_per_mm * noise.displacement_mm);
    let count = (SINE.duration_s() * f64::from(SAMPLES_PER_S)) as u32;
    let times_s = (0..count)
        .map(|k| f64::from(k) / f64::from(SAMPLES_PER_S))
        .collect();
    let programme = [(SINE, times_s)];
    let unit = physics.draw(&mut ChaCha8Rng::seed_from_u64(1), &specimen);
    let meter = VisibilityMeter::new(&specimen, &programme, sigma_n);
    let hidden = meter.sized(physics, &unit, STRENGTH).expect("a plausible size");
    (specimen, hidden)
}

/// Counted cycle in which the twin reports the effect, 0 before the first; `None` without a report.
fn reported_in_cycle(code: &'static str) -> Option<u32> {
    let (specimen, hidden) = sized(&mock(), code);
    let parameters = hidden.parameters(specimen.top_n());
    let bench = concealing(code, &parameters);
    let profiles = shipped_profiles();
    let (_, profile) = profiles
        .iter()
        .find(|(name, _)| name == PROFILE)
        .expect("shipped");
    let (memory, _) = play(&bench, profile, None);
    let report = memory
        .events
        .iter()
        .find(|e| e.kind == EventKind::ModelMismatch)?;
    println!("{code} {parameters:?}: {:.3} s, {}", report.time_s, report.text);
    let sample = memory.samples.iter().find(|s| s.tick == report.tick);
    sample.map(|s| s.cycle)
}

#[test]
fn an_effect_of_strength_2_is_reported_within_three_cycles() {
    let missed: Vec<_> = CODES
        .into_iter()
        .map(|code| (code, reported_in_cycle(code)))
        .filter(|(_, cycle)| cycle.is_none_or(|c| c > CYCLES))
        .collect();
    assert!(missed.is_empty(), "code and cycle of the report: {missed:?}");
}
