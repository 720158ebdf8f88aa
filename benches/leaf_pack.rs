//! Speed of the leaf pack: 1 kHz steps, static loop, cost by number of segments, and the slowest steps of a minute.
//!
//! Times are processor times of the thread, so that other programs do not count. The duty is that of the peer programs in
//! `benches/peers`: Table 1 geometry, clamp 100 mm, interleaf mu 0.3, no other friction.

use std::hint::black_box;
use std::time::{Duration, Instant};

use crate::model::Plant;
use crate::model::leaf_pack::{Dynamics, LeafPack, Mounting, PackStructure, Values, graded_path};
use criterion::measurement::{Measurement, ValueFormatter, WallTime};
use criterion::{BenchmarkId, Criterion};
use nix::time::{ClockId, clock_gettime};

fn seconds(clock: ClockId) -> f64 {
    let t = clock_gettime(clock).expect("Linux has this clock");
    t.tv_sec() as f64 + 1e-9 * t.tv_nsec() as f64
}

/// Processor time of this thread, s.
fn own_time_s() -> f64 {
    seconds(ClockId::CLOCK_THREAD_CPUTIME_ID)
}

/// Processor time of the thread as a measurement for criterion.
pub struct OwnTime;

impl Measurement for OwnTime {
    type Intermediate = f64;
    type Value = Duration;
    fn start(&self) -> f64 {
        own_time_s()
    }
    fn end(&self, start_s: f64) -> Duration {
        Duration::from_secs_f64((own_time_s() - start_s).max(0.0))
    }
    fn add(&self, a: &Duration, b: &Duration) -> Duration {
        *a + *b
    }
    fn zero(&self) -> Duration {
        Duration::ZERO
    }
    fn to_f64(&self, value: &Duration) -> f64 {
        value.as_nanos() as f64
    }
    fn formatter(&self) -> &dyn ValueFormatter {
        WallTime.formatter()
    }
}

fn values() -> Values {
    Values {
        interleaf_mu: 0.3,
        shackle_angle_rad: 20f64.to_radians(),
        ..Values::frictionless()
    }
}

fn pack(structure: &PackStructure) -> LeafPack {
    LeafPack::new(structure, &values()).expect("valid pack")
}

/// Displacement in mm at the `k`-th millisecond of a sine from 2 to 8 mm.
fn sine(frequency_hz: f64, k: u64) -> f64 {
    5.0 - 3.0 * (frequency_hz * k as f64 * 1e-3 * std::f64::consts::TAU).cos()
}

fn variants() -> Vec<(&'static str, PackStructure)> {
    let base = PackStructure::default();
    let shackle = PackStructure {
        mounting: Mounting::Shackle,
        ..base.clone()
    };
    vec![
        ("rail", base.clone()),
        (
            "rail both sides",
            PackStructure {
                mirror: false,
                ..base.clone()
            },
        ),
        ("shackle", shackle.clone()),
        (
            "rail dynamics",
            PackStructure {
                dynamics: Dynamics::Full,
                ..base
            },
        ),
        (
            "shackle dynamics",
            PackStructure {
                dynamics: Dynamics::Full,
                ..shackle
            },
        ),
    ]
}

pub fn step(c: &mut Criterion<OwnTime>) {
    let mut group = c.benchmark_group("leaf pack, 1 kHz step of the 1 Hz sine");
    for (name, structure) in variants() {
        let mut p = pack(&structure);
        let mut k = 0;
        group.bench_function(name, |b| {
            b.iter(|| {
                k += 1;
                black_box(p.step(sine(1.0, k), 1e-3))
            });
        });
    }
    group.finish();
    let mut group = c.benchmark_group("leaf pack, step over segments");
    for segments in [22, 44, 84, 172, 344, 688] {
        let mut p = pack(&PackStructure {
            segments,
            ..PackStructure::default()
        });
        let mut k = 0;
        group.bench_function(BenchmarkId::from_parameter(p.segments()), |b| {
            b.iter(|| {
                k += 1;
                black_box(p.step(sine(1.0, k), 1e-3))
            });
        });
    }
    group.finish();
}

pub fn static_row(c: &mut Criterion<OwnTime>) {
    let path = graded_path(&[0.0, 26.0, 0.0], 1.0);
    let mut group = c.benchmark_group("leaf pack, static loop with assembly");
    for (name, structure) in variants().into_iter().take(3) {
        group.bench_function(name, |b| {
            b.iter(|| black_box(pack(&structure).static_path(&path, 120.0)));
        });
    }
    group.finish();
}

/// The duty of the peer programs: 2.5 s of the 1 Hz sine. Prints the median of five real-time factors.
pub fn duty(_: &mut Criterion<OwnTime>) {
    for (name, structure) in variants() {
        let mut took_s: Vec<f64> = (0..5)
            .map(|_| {
                let mut p = pack(&structure);
                p.step(sine(1.0, 0), 1.0);
                let start = own_time_s();
                for k in 0..2500 {
                    black_box(p.step(sine(1.0, k), 1e-3));
                }
                own_time_s() - start
            })
            .collect();
        took_s.sort_by(f64::total_cmp);
        println!("{name}, 2.5 s at 1 Hz: real-time factor {:.1}", 2.5 / took_s[2]);
    }
}

/// Prints the slowest steps over 60 s of the 2.5 Hz sine, because a mean hides them.
pub fn tail(_: &mut Criterion<OwnTime>) {
    for (name, structure) in variants() {
        let mut p = pack(&structure);
        let mut took_us: Vec<f64> = (0..60_000)
            .map(|k| {
                let start = own_time_s();
                black_box(p.step(sine(2.5, k), 1e-3));
                (own_time_s() - start) * 1e6
            })
            .collect();
        let total_s = took_us.iter().sum::<f64>() * 1e-6;
        took_us.sort_by(f64::total_cmp);
        println!(
            "{name}, 60 s at 2.5 Hz: p50 {:.1} p99 {:.1} p99.9 {:.1} max {:.1} us, real-time factor {:.1}, not converged {}",
            took_us[30_000],
            took_us[59_400],
            took_us[59_940],
            took_us[59_999],
            60.0 / total_s,
            p.unconverged()
        );
    }
}

/// The number of evaluations in the first paper: 300 static loops with different values, on two threads. Prints the time.
pub fn evolution(_: &mut Criterion<OwnTime>) {
    let path = graded_path(&[0.0, 26.0, 0.0], 1.0);
    let start = Instant::now();
    let own_s = seconds(ClockId::CLOCK_PROCESS_CPUTIME_ID);
    std::thread::scope(|scope| {
        for half in 0..2 {
            let path = &path;
            scope.spawn(move || {
                for k in 0..150 {
                    let share = f64::from(2 * k + half) / 300.0;
                    let v = Values {
                        interleaf_mu: share,
                        thickness_correction_mm: 0.37 * (share - 0.5),
                        ..values()
                    };
                    let mut p = LeafPack::new(&PackStructure::default(), &v).expect("valid pack");
                    black_box(p.static_path(path, 120.0));
                }
            });
        }
    });
    let wall_s = start.elapsed().as_secs_f64();
    let own_s = seconds(ClockId::CLOCK_PROCESS_CPUTIME_ID) - own_s;
    println!(
        "300 static loops with assembly on 2 threads: {wall_s:.2} s, {own_s:.2} s of processor time in all"
    );
}
