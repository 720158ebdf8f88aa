//! Control against the mock rig in virtual time: whole runs.

use super::support::virtual_rig::{VirtualRig, order, sine, static_ramp};
use crate::control::{Phase, Refusal};
use crate::mockrig::MockRigConfig;
use crate::protocol::message::RigState;
use crate::recording::{Ending, EventKind, Flags};

#[test]
fn the_static_ramp_has_a_sample_a_millisecond_and_its_exact_peak() {
    let mut bench = VirtualRig::new();
    bench.start(static_ramp());
    bench.until(Phase::Ready, 150_000);
    let m = &bench.memory;
    let outcome = m.outcome.as_ref().expect("the run ended");
    assert_eq!(
        (outcome.ending, outcome.lost),
        (Ending::Completed, 0),
        "{}",
        outcome.cause
    );
    assert_eq!(m.samples.len(), 120_001, "0 s to 120 s, both included");
    assert!(m.samples.windows(2).all(|w| w[1].tick == w[0].tick + 1));
    let peak = m.samples.iter().map(|s| s.force_n).fold(f64::MIN, f64::max);
    assert!((peak - 2000.0).abs() < 5.0, "peak {peak}");
    let top = &m.samples[60_000];
    assert_eq!(
        top.command.map(|c| c.value()),
        Some(2000.0),
        "the end level is exact"
    );
    assert!(m.samples.iter().all(|s| s.flags == Flags::default()));
}

#[test]
fn amplitude_and_mean_are_within_one_percent_by_the_fifth_counted_cycle() {
    for (amplitude, frequency_hz) in [(6.0, 1.0), (10.0, 1.0), (15.0, 1.0), (6.0, 2.5)] {
        let mut bench = VirtualRig::new();
        bench.start(sine(amplitude, frequency_hz, 12));
        bench.until(Phase::Ready, 60_000);
        let m = &bench.memory;
        let outcome = m.outcome.as_ref().expect("the run ended");
        assert_eq!(outcome.ending, Ending::Completed, "{}", outcome.cause);
        assert_eq!(outcome.cycles_completed, 12);
        for cycle in 5..=12 {
            let of = |pick: fn(f64, f64) -> f64, start| {
                m.samples
                    .iter()
                    .filter(|s| s.cycle == cycle)
                    .map(|s| s.displacement_mm)
                    .fold(start, pick)
            };
            let (peak, valley) = (of(f64::max, f64::MIN), of(f64::min, f64::MAX));
            let (a, mean) = (0.5 * (peak - valley), 0.5 * (peak + valley));
            assert!(
                (a / amplitude - 1.0).abs() < 0.01 && (mean / 18.0 - 1.0).abs() < 0.01,
                "{amplitude} mm {frequency_hz} Hz cycle {cycle}: amplitude {a:.4}, mean {mean:.4}"
            );
        }
    }
}

#[test]
fn a_dead_host_leaves_a_rig_that_unloads_within_its_lease() {
    let mut bench = VirtualRig::new();
    bench.start(static_ramp());
    bench.ticks(20_000);
    bench.host_alive = false;
    assert_eq!(bench.mock.state(), RigState::Running);
    bench.ticks(39);
    assert_eq!(
        bench.mock.state(),
        RigState::Running,
        "the lease is 50 ms, and the newest at most 10 ms old"
    );
    bench.ticks(15);
    assert_eq!(bench.mock.state(), RigState::Unload);
    bench.ticks(10_000);
    assert_eq!(bench.mock.state(), RigState::Tripped);
    bench.host_alive = true;
    bench.ticks(3_000);
    assert_eq!(bench.rig.phase(), Phase::Interlocked, "{:#?}", bench.rig.status());
    assert!(matches!(
        bench.rig.start(order(static_ramp())),
        Err(Refusal::Interlocked(_))
    ));
    bench.rig.reset().expect("the cause is gone");
    bench.until(Phase::Ready, 1_000);
    bench.ticks(2_000);
    assert_eq!(bench.mock.state(), RigState::Off, "a reset never resumes motion");
}

#[test]
fn a_stop_unloads_and_keeps_the_data() {
    let mut bench = VirtualRig::new();
    bench.start(sine(10.0, 1.0, 50));
    bench.ticks(9_300);
    bench.stop();
    bench.until(Phase::Ready, 10_000);
    let m = &bench.memory;
    let outcome = m.outcome.as_ref().expect("the run ended");
    assert_eq!(outcome.ending, Ending::Stopped);
    assert_eq!(outcome.samples as usize, m.samples.len());
    let last = m.samples.last().expect("there are samples");
    assert!(
        last.force_n.abs() < 30.0 && last.flags.contains(Flags::NOT_PROFILE),
        "{last:?}"
    );
    // A ramp, not a step: never faster than the sine itself (63 mm/s) by more than half.
    let fastest = m
        .samples
        .windows(11)
        .map(|w| (w[10].displacement_mm - w[0].displacement_mm).abs() / 0.010)
        .fold(0.0, f64::max);
    assert!(fastest < 95.0, "{fastest} mm/s");
}

#[test]
fn hold_and_resume_finish_all_cycles() {
    let mut bench = VirtualRig::new();
    bench.start(sine(6.0, 1.0, 6));
    bench.ticks(9_700);
    bench.rig.hold().expect("a run is under way");
    bench.until(Phase::Held, 200);
    bench.ticks(2_000);
    bench.rig.resume().expect("the run is held");
    bench.until(Phase::Running, 200);
    bench.until(Phase::Ready, 60_000);
    let m = &bench.memory;
    let outcome = m.outcome.as_ref().expect("the run ended");
    assert_eq!(
        (outcome.ending, outcome.cycles_completed),
        (Ending::Completed, 6),
        "{}",
        outcome.cause
    );
    for cycle in 1..=6 {
        let counted = m
            .samples
            .iter()
            .filter(|s| s.cycle == cycle && !s.flags.contains(Flags::NOT_PROFILE))
            .count();
        assert!(counted >= 1000, "cycle {cycle} has {counted} samples");
    }
}

#[test]
fn tare_takes_the_still_mean_and_is_refused_in_motion() {
    // Zero errors of 50 N and 0.2 mm.
    let mut config = MockRigConfig::default();
    (config.load_cell.zero_counts, config.lvdt.zero_counts) = (500.0, 400.0);
    let mut bench = VirtualRig::with(&config);
    bench.until(Phase::Ready, 2_000);
    bench.ticks(600);
    let read = |bench: &VirtualRig| {
        let status = bench.rig.status();
        let force_n = status.force_n.expect("samples flow");
        [force_n, status.displacement_mm.expect("samples flow")]
    };
    let [force_n, mm] = read(&bench);
    assert!(
        (force_n - 50.0).abs() < 3.0 && (mm - 0.2).abs() < 0.02,
        "{force_n} N, {mm} mm"
    );
    let report = bench.rig.tare().expect("the rig is still");
    assert!(
        (report.force_new_n - report.force_old_n - 50.0).abs() < 0.5,
        "{report:?}"
    );
    bench.ticks(600);
    let [force_n, mm] = read(&bench);
    assert!(
        force_n.abs() < 3.0 && mm.abs() < 0.02,
        "{report:?}: {force_n} N, {mm} mm"
    );
    bench.rig.start(order(static_ramp())).expect("ready");
    bench.until(Phase::Running, 1_000);
    assert!(matches!(bench.rig.tare(), Err(Refusal::Phase { .. })));
}

#[test]
fn lost_samples_are_a_gap_in_the_record_and_close_the_account() {
    let mut bench = VirtualRig::new();
    bench.start(static_ramp());
    bench.ticks(5_000);
    bench.to_host = Box::new(|_| None);
    bench.tick();
    bench.to_host = Box::new(Some);
    bench.ticks(5_000);
    let m = &bench.memory;
    assert_eq!(m.events.iter().filter(|e| e.kind == EventKind::Gap).count(), 1);
    let gap = m
        .samples
        .iter()
        .position(|s| s.flags.contains(Flags::AFTER_GAP))
        .expect("a sample is flagged");
    assert_eq!(m.samples[gap].tick - m.samples[gap - 1].tick, 2);
    bench.rig.stop("enough", bench.now_ns, &mut bench.host);
    bench.until(Phase::Ready, 20_000);
    let m = &bench.memory;
    let outcome = m.outcome.as_ref().expect("the run ended");
    let span = m.samples.last().expect("samples").tick - m.samples[0].tick + 1;
    assert_eq!(
        outcome.samples + outcome.lost,
        span,
        "sent = stored + counted as lost"
    );
    assert_eq!(outcome.lost, 1);
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let run = || {
        let mut bench = VirtualRig::new();
        bench.start(sine(6.0, 2.5, 3));
        bench.until(Phase::Ready, 30_000);
        bench.memory.samples
    };
    assert_eq!(run(), run());
}
