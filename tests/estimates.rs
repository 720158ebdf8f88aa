//! One-step amplitudes on recordings of `truth`: without an effect they scatter about zero by their standard errors, and a fault of a
//! bench is found in its size.

use crate::cli::lab::PlayedTest;
use crate::diagnose::{Baseline, DiagnoseOptions, Estimates, estimate};
use crate::recording::Recording;
use crate::truth::{Case, Family, Lab, LabRequest, World};

fn estimates(recordings: &[Recording]) -> Estimates {
    let baseline = Baseline::of(crate::model::find("equivalent").expect("listed"));
    estimate(recordings, &baseline, &DiagnoseOptions::default()).expect("estimated")
}

/// Amplitudes in standard errors of all effects that could be tested, in the first cases of a world that hide nothing.
fn deviations(world: World, seed: u64, cases: usize) -> Vec<f64> {
    let numbers = (0..).filter(|number| Family::of(world, *number) == Family::None);
    let estimated = numbers.take(cases).map(|number| {
        let case = Case::draw(world, seed, number, None);
        assert!(case.label.hidden.is_empty());
        estimates(&case.recordings)
    });
    let effects = estimated.flat_map(|e| e.effects).filter(|e| e.testable);
    effects
        .map(|e| e.amplitude / e.std_error.expect("testable"))
        .collect()
}

/// About 80 amplitudes: their RMS is 1 +- 0.08 if the standard errors are right. They are somewhat too large on purpose, because
/// each is the largest of three.
#[test]
fn amplitudes_of_absent_effects_scatter_by_their_standard_errors() {
    for world in [World::Own, World::PrandtlIshlinskii] {
        let deviations = deviations(world, 4711, 6);
        assert!(deviations.len() > 50, "{world:?}: {}", deviations.len());
        let squares: f64 = deviations.iter().map(|z| z * z).sum();
        let rms = (squares / deviations.len() as f64).sqrt();
        assert!((0.5..1.3).contains(&rms), "{world:?}: {rms}");
    }
}

#[test]
fn the_lag_of_a_bench_is_estimated_in_its_size_and_no_other_bench_has_one() {
    let lab = Lab::draw(&LabRequest {
        seed: 8,
        specimens: 8,
        runs: 24,
        nothing: false,
    });
    for bench in 0..lab.benches.len() {
        let number = lab
            .runs
            .iter()
            .position(|run| run.bench == bench)
            .expect("tested");
        let family = &lab.families[lab.specimens[lab.runs[number].specimen].family_index];
        let played = PlayedTest::new(&family.name, family.top_mm).expect("played");
        let recording = lab.record(number, &played.test);
        let found = estimates(&[recording]);
        let delay = found
            .effects
            .iter()
            .find(|e| e.code == "channel_delay")
            .expect("in the library");
        assert_eq!(
            (delay.parameter.as_str(), delay.unit.as_str()),
            ("delay_ms", "ms")
        );
        let true_ms = 1e3 * lab.benches[bench].force_lag_s;
        // A Gauss-Newton step over 3 ms is off by a few per cent.
        assert!(
            (delay.amplitude - true_ms).abs() < 0.1 * true_ms + 0.15,
            "{delay:?}"
        );
    }
}
