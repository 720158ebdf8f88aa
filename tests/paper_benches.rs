//! The papers' springs as specimens of the mock rig: whole runs in virtual time, the leaf pack solved every millisecond.

use std::path::Path;

use crate::cli::virtual_bench::VirtualBench;
use crate::config::Bench;
use crate::control::run::RunOrder;
use crate::daemon::header::{self, Planned};
use crate::profile::{Player, Profile};
use crate::recording::{Ending, Event, Header, Outcome, Recorder, Sample};

/// Keeps the samples of a run.
#[derive(Default)]
struct Kept {
    samples: Vec<Sample>,
}

impl Recorder for Kept {
    fn begin(&mut self, _: &Header) {}
    fn sample(&mut self, sample: &Sample) {
        self.samples.push(*sample);
    }
    fn event(&mut self, _: &Event) {}
    fn end(&mut self, _: &Outcome) {}
}

/// Runs a profile's text on a shipped bench; returns the samples of its segments.
fn play(bench: &str, profile: &str) -> (Outcome, Vec<Sample>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("bench-configs/benches/{bench}.toml"));
    let bench = Bench::load(&path).expect("shipped");
    let parsed = Profile::from_toml(profile, "test").expect("a profile");
    let player = Player::new(&parsed, 0.0, 1000.0).expect("plays");
    let planned = Planned {
        cycles: player.total_cycles(),
        duration_s: player.duration_s(),
    };
    let now = "2026-01-01T00:00:00Z".parse().expect("a time");
    let header = header::new(
        "test".to_owned(),
        now,
        &bench,
        &parsed,
        profile.to_owned(),
        planned,
    );
    let order = RunOrder {
        header,
        profile: parsed,
        first_cycle: 1,
    };
    let mut kept = Kept::default();
    let outcome = VirtualBench::new(&bench, None)
        .and_then(|mut b| b.play(order, &mut kept, |_| {}))
        .expect("runs");
    kept.samples.retain(|s| s.segment > 0);
    (outcome, kept.samples)
}

fn peak_n(samples: &[Sample]) -> f64 {
    samples.iter().fold(0.0, |m, s| s.force_n.max(m))
}

fn loop_j(samples: &[Sample]) -> f64 {
    samples
        .windows(2)
        .map(|w| 0.5e-3 * (w[0].force_n + w[1].force_n) * (w[1].displacement_mm - w[0].displacement_mm))
        .sum()
}

const RAMP: &str = include_str!("../bench-configs/profiles/static-ramp-12s.toml");

#[test]
fn the_static_ramp_runs_on_every_paper_bench() {
    for (bench, least_j) in [("samurai-rail", 4.0), ("samurai-shackle", 6.0), ("chula", 5.0)] {
        let (outcome, samples) = play(bench, RAMP);
        let (peak, energy) = (peak_n(&samples), loop_j(&samples));
        assert_eq!(outcome.ending, Ending::Completed, "{bench}: {}", outcome.cause);
        // The command is 2 kN; the servo's overshoot and the cell's noise are below 1 %.
        assert!((peak / 2000.0 - 1.0).abs() < 0.01, "{bench}: {peak} N");
        assert!(energy > least_j, "{bench}: {energy} J: friction is missing");
    }
}

#[test]
fn a_sine_runs_on_the_leaf_pack() {
    let sine = "name = \"test\"\ndescription = \"The first paper's smallest row, stroke 6 mm.\"\ncontrol = \"displacement\"\n\
                [[block]]\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 4.6\nduration_s = 2.0\n\
                [[block.segment]]\nkind = \"sine\"\nmean_mm = 4.6\namplitude_mm = 3.0\nfrequency_hz = 1.0\ncycles = 4\n\
                [[block.segment]]\nkind = \"ramp\"\nto_mm = 0.0\nduration_s = 2.0\n";
    let (outcome, samples) = play("samurai-rail", sine);
    assert_eq!(outcome.ending, Ending::Completed);
    let third: Vec<Sample> = samples.into_iter().filter(|s| s.cycle == 3).collect();
    let (peak, energy) = (peak_n(&third), loop_j(&third));
    // The specimen file states 4 % and 20 %; the lag of the servo adds to the stroke.
    assert!((peak / 688.0 - 1.0).abs() < 0.06, "peak {peak:.1} N");
    assert!((energy / 0.6651 - 1.0).abs() < 0.3, "loop {energy:.3} J");
}
