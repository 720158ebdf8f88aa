//! Control against the mock rig in virtual time: whole runs, and what happens when something goes wrong.

use crate::control::channel::Channels;
use crate::control::detectors::DetectorLimits;
use crate::control::physical_limits::PhysicalLimits;
use crate::control::run::RunOrder;
use crate::control::{Phase, Refusal, Rig, RigConfig};
use crate::link::{Link, loopback};
use crate::mockrig::{MockRig, MockRigConfig};
use crate::model;
use crate::profile::{Block, CycleSegment, Level, Profile, Segment, Wave};
use crate::protocol::message::RigState;
use crate::recording::memory::Memory;
use crate::recording::{ChannelScale, Ending, EventKind, FirmwareIdentity, Flags, Header};
use crate::units::Mode;

const MS: u64 = 1_000_000;

struct Bench {
    rig: Rig,
    mock: MockRig,
    host: Link,
    far: Link,
    now_ns: u64,
    memory: Memory,
    /// Frames of the host that reach the rig.
    host_alive: bool,
}

impl Bench {
    fn new() -> Self {
        Bench::with(&MockRigConfig::default())
    }

    fn with(mock: &MockRigConfig) -> Self {
        let plain = |scale_per_count| ChannelScale {
            scale_per_count,
            offset: 0.0,
            tare: 0.0,
        };
        let rig = Rig::new(RigConfig {
            node: 1,
            session: 7,
            channels: Channels {
                force: plain(0.1),
                displacement: plain(0.0005),
            },
            limits: PhysicalLimits::EXAMPLE,
            calibration_hash: 0,
            queue_lead_ms: 100,
            commands_per_poll: 3,
            ack_timeout_ms: 20,
            detectors: DetectorLimits::default(),
            tare_limit_n: 200.0,
            tare_limit_mm: 5.0,
            still_sigma_n: 3.0,
            still_sigma_mm: 0.02,
        });
        let equivalent = model::find("equivalent").expect("is in the list");
        let plant = equivalent
            .plant(&equivalent.start_values(), &toml::Table::new())
            .expect("starts are within bounds");
        let mock = MockRig::new(mock, plant).expect("a possible rig");
        let (host, far) = loopback::pair();
        Bench {
            rig,
            mock,
            host,
            far,
            now_ns: 0,
            memory: Memory::default(),
            host_alive: true,
        }
    }

    fn tick(&mut self) {
        self.now_ns += MS;
        self.mock.tick(&mut self.far);
        if self.host_alive {
            self.rig.poll(self.now_ns, &mut self.host, &mut self.memory);
        }
    }

    fn ticks(&mut self, ms: u64) {
        for _ in 0..ms {
            self.tick();
        }
    }

    fn until(&mut self, phase: Phase, limit_ms: u64) {
        for _ in 0..limit_ms {
            if self.rig.phase() == phase {
                return;
            }
            self.tick();
        }
        panic!("not {phase:?} after {limit_ms} ms: {:#?}", self.rig.status());
    }

    fn start(&mut self, profile: Profile) {
        self.until(Phase::Ready, 2_000);
        self.ticks(600);
        self.rig.start(order(profile)).expect("the rig is ready");
        self.until(Phase::Running, 1_000);
    }
}

fn order(profile: Profile) -> RunOrder {
    RunOrder {
        header: Header {
            run_id: "test".into(),
            started_utc: "2026-01-01T00:00:00Z".into(),
            specimen: "equivalent".into(),
            operator: String::new(),
            profile_name: profile.name.clone(),
            profile_toml: String::new(),
            bench_toml: String::new(),
            bench_sha256: String::new(),
            firmware: FirmwareIdentity::default(),
            program_version: "test".into(),
            sample_rate_hz: 1000.0,
            force_channel: ChannelScale {
                scale_per_count: 0.1,
                offset: 0.0,
                tare: 0.0,
            },
            displacement_channel: ChannelScale {
                scale_per_count: 0.0005,
                offset: 0.0,
                tare: 0.0,
            },
            twin: String::new(),
            first_cycle: 1,
            resumes_run: String::new(),
            cycles_planned: 0,
            duration_planned_s: 0.0,
            remarks: Vec::new(),
        },
        profile,
        first_cycle: 1,
    }
}

fn profile(mode: Mode, segments: Vec<Segment>) -> Profile {
    Profile {
        name: "test".into(),
        description: String::new(),
        mode,
        blocks: vec![Block { repeat: 1, segments }],
    }
}

fn static_ramp() -> Profile {
    let ramp = |to| Segment::Ramp {
        to: Level::Absolute(to),
        duration_s: 60.0,
    };
    profile(Mode::Force, vec![ramp(2000.0), ramp(0.0)])
}

fn sine(amplitude: f64, frequency_hz: f64, cycles: u32) -> Profile {
    profile(
        Mode::Displacement,
        vec![
            Segment::Ramp {
                to: Level::Absolute(18.0),
                duration_s: 4.0,
            },
            Segment::Cycles(CycleSegment {
                wave: Wave::Sine,
                mean: Level::Absolute(18.0),
                amplitude,
                frequency_hz,
                cycles,
                taper_cycles: 3,
                correct: true,
            }),
            Segment::Ramp {
                to: Level::Absolute(0.0),
                duration_s: 4.0,
            },
        ],
    )
}

#[test]
fn the_static_ramp_has_a_sample_a_millisecond_and_its_exact_peak() {
    let mut bench = Bench::new();
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
        let mut bench = Bench::new();
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
    let mut bench = Bench::new();
    bench.start(static_ramp());
    bench.ticks(20_000);
    bench.host_alive = false;
    assert_eq!(bench.mock.state(), RigState::Running);
    bench.ticks(45);
    assert_eq!(bench.mock.state(), RigState::Running, "the lease is 50 ms");
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
    let mut bench = Bench::new();
    bench.start(sine(10.0, 1.0, 50));
    bench.ticks(9_300);
    bench
        .rig
        .stop("stopped by the operator", bench.now_ns, &mut bench.host);
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
    let mut bench = Bench::new();
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
    let mut bench = Bench::with(&config);
    bench.until(Phase::Ready, 2_000);
    bench.ticks(600);
    let read = |bench: &Bench| {
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
    let mut bench = Bench::new();
    bench.start(static_ramp());
    bench.ticks(5_000);
    bench.mock.tick(&mut bench.far);
    while bench.host.receive().is_some() {}
    bench.now_ns += MS;
    bench.ticks(5_000);
    let m = &bench.memory;
    assert_eq!(m.events.iter().filter(|e| e.kind == EventKind::Gap).count(), 1);
    let gap = m
        .samples
        .iter()
        .position(|s| s.flags.contains(Flags::AFTER_GAP))
        .expect("a sample is flagged");
    assert_eq!(m.samples[gap].tick - m.samples[gap - 1].tick, 2);
    bench
        .rig
        .stop("enough", bench.now_ns, &mut bench.host);
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
        let mut bench = Bench::new();
        bench.start(sine(6.0, 2.5, 3));
        bench.until(Phase::Ready, 30_000);
        bench.memory.samples
    };
    assert_eq!(run(), run());
}
