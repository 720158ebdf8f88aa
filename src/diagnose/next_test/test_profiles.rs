//! The tests that a bench can run: slow and fast, at low and high load, with holds, nests of small loops and sharp corners.
//!
//! Each is a profile file. Its motion comes from `profile::Player`, so the simulation is of the motion that the bench makes.

use crate::model::Motion;
use crate::profile::{Player, Profile, ProfileLimits, check};

/// Command rate of a simulated bench.
const COMMANDS_HZ: f64 = 1000.0;
/// Fewest samples per cycle.
const SAMPLES_PER_CYCLE: f64 = 20.0;
/// Share of the bench's limits on speed and acceleration that is used, because a servo overshoots.
const MARGIN: f64 = 0.6;
/// Largest share of the recorded speed for a bench without limits.
const RECORDED_SPEED: f64 = 0.9;
/// Farthest travel beyond the recorded one, as a share of it: a smooth nonlinearity continues there, a knee does not.
const BEYOND: f64 = 0.25;
/// Distance of points: this share of the travel since the reversal, but at least this share of the whole travel.
const COARSENING: f64 = 0.04;
const FINEST: f64 = 1.0 / 600.0;
/// Approximate time of the ramps before and after a wave, and largest number of cycles.
const RAMPS_S: f64 = 12.0;
const MOST_CYCLES: f64 = 60.0;
/// Fewest points of a motion, evenly in time.
const POINTS: f64 = 400.0;
/// Frequencies of the sines, and sizes of the nested loops.
const SINES_HZ: [f64; 6] = [0.1, 0.5, 1.0, 2.0, 5.0, 8.0];
const NESTS_MM: [f64; 5] = [0.2, 0.5, 1.0, 2.0, 4.0];
/// Frequencies of the same loop at three speeds, as shares of the largest: a third each, so that law and power of a speed show.
const SPEEDS: [f64; 3] = [1.0, 1.0 / 3.0, 1.0 / 9.0];
/// Distance from the ends of the travel, as a share of it.
const END: f64 = 0.02;
/// Factor by which the taper of a wave raises its speed: up to an eighth is added while the amplitude rises.
const TAPER: f64 = 1.15;

/// Limits of a test.
#[derive(Debug, Clone, Copy)]
pub(super) struct TestRange {
    /// Recorded displacements from 0 upwards.
    pub displacement_mm: [f64; 2],
    /// Largest displacement of a test that goes beyond the recorded travel.
    pub beyond_mm: f64,
    pub speed_mm_s: f64,
    pub acceleration_mm_s2: f64,
    pub sample_hz: f64,
    /// Number of samples up to which a recording is not thinned.
    pub samples: f64,
}

impl TestRange {
    /// The recorded travel and a little beyond it, as fast as `limits` allow; without limits, as far and as fast as recorded.
    pub(super) fn new(
        displacement_mm: [f64; 2],
        recorded_mm_s: f64,
        [sample_hz, samples]: [f64; 2],
        limits: Option<&ProfileLimits>,
    ) -> TestRange {
        let [low, high] = [displacement_mm[0].max(0.0), displacement_mm[1]];
        let (speed_mm_s, acceleration_mm_s2) = match limits {
            Some(l) => (MARGIN * l.velocity_max_mm_s, MARGIN * l.acceleration_max_mm_s2),
            None => (RECORDED_SPEED * recorded_mm_s, f64::INFINITY),
        };
        TestRange {
            displacement_mm: [low, high],
            beyond_mm: limits.map_or(high, |l| {
                (high + BEYOND * (high - low)).min(l.displacement_max_mm)
            }),
            speed_mm_s: speed_mm_s.max(1.0),
            acceleration_mm_s2,
            sample_hz,
            samples,
        }
    }

    fn travel_mm(&self) -> f64 {
        self.displacement_mm[1] - self.displacement_mm[0]
    }
}

/// A profile file in parts.
pub(super) struct TestProfile {
    pub name: String,
    segments: Vec<String>,
}

/// A point of a [`TestMotion`].
pub(super) struct TestPoint {
    pub time_s: f64,
    pub displacement_mm: f64,
    pub motion: Motion,
}

/// The motion of a test as it will be recorded.
pub(super) struct TestMotion {
    pub points: Vec<TestPoint>,
    /// Indices of the points at which the motion turns.
    pub turns: Vec<usize>,
    pub duration_s: f64,
    /// Number of cycles, by the reversals.
    pub cycles: f64,
}

impl TestProfile {
    /// Text of the profile file.
    pub(super) fn toml(&self, description: &str) -> String {
        format!(
            "name = \"next-test-{}\"\ndescription = {}\ncontrol = \"displacement\"\n\n[[block]]\nrepeat = 1\n{}",
            self.name,
            toml::Value::String(description.to_owned()),
            self.segments.concat()
        )
    }

    /// Its motion from rest at zero; `None` if it exceeds the limits.
    pub(super) fn motion(&self, range: &TestRange, limits: Option<&ProfileLimits>) -> Option<TestMotion> {
        let profile = Profile::from_toml(&self.toml(""), &self.name).ok()?;
        let refused = |l| check::violations(&profile, l, 0.0, COMMANDS_HZ).map_or(true, |v| !v.is_empty());
        if limits.is_some_and(refused) {
            return None;
        }
        let mut player = Player::new(&profile, 0.0, COMMANDS_HZ).ok()?;
        let mut x = vec![0.0];
        while let Some(slot) = player.next() {
            x.push(slot.command.value());
        }
        Some(thinned(&x, range))
    }
}

/// Thins a motion with one displacement per command: points are dense after reversals.
fn thinned(x: &[f64], range: &TestRange) -> TestMotion {
    let last = x.len() - 1;
    let dt_s = 1.0 / COMMANDS_HZ;
    let duration_s = last as f64 * dt_s;
    // A reversal is where the motion back begins: at the end of a hold.
    let mut turns: Vec<usize> = Vec::new();
    let mut heading = 0.0;
    for k in 0..last {
        let step = x[k + 1] - x[k];
        if step * heading < 0.0 {
            turns.push(k);
        }
        if step != 0.0 {
            heading = step.signum();
        }
    }
    let finest_s = 1.0 / range.sample_hz;
    let longest_s = duration_s / POINTS;
    let (mut points, mut half): (Vec<TestPoint>, usize) = (Vec::new(), 0);
    let mut turned = Vec::new();
    for k in 0..=last {
        let turn = turns.get(half) == Some(&k);
        let (from, since_s) = points.last().map_or((x[0], f64::INFINITY), |p| {
            (p.displacement_mm, k as f64 * dt_s - p.time_s)
        });
        let turned_mm = half.checked_sub(1).map_or(x[0], |h| x[turns[h]]);
        let resolution_mm = (FINEST * range.travel_mm()).max(COARSENING * (x[k] - turned_mm).abs());
        let due = since_s >= finest_s && ((x[k] - from).abs() >= resolution_mm || since_s >= longest_s);
        if due || turn || k == last {
            let at = |k: usize| x[k.min(last)];
            let (before, after) = (at(k.saturating_sub(1)), at(k + 1));
            let next_mm = turns.get(half).map_or(x[last], |&t| x[t]);
            points.push(TestPoint {
                time_s: k as f64 * dt_s,
                displacement_mm: x[k],
                motion: Motion {
                    velocity_mm_s: 0.5 * (after - before) / dt_s,
                    acceleration_mm_s2: (after - 2.0 * x[k] + before) / (dt_s * dt_s),
                    reach_mm: [turned_mm.min(next_mm), turned_mm.max(next_mm)],
                },
            });
        }
        if turn {
            turned.push(points.len() - 1);
            half += 1;
        }
    }
    TestMotion {
        points,
        turns: turned,
        duration_s,
        cycles: 0.5 * (turns.len() + 1) as f64,
    }
}

/// All tests within a range: ramps, holds, nests of small loops, and sines and triangles at three loads.
pub(super) fn test_profiles(range: &TestRange) -> Vec<TestProfile> {
    let s = Segments::new(range);
    let room_mm = s.room_mm(0.5);
    let mut list: Vec<(String, Vec<String>)> = vec![
        ("ramp-2-s".to_owned(), s.up_and_down(2.0)),
        ("ramp-20-s".to_owned(), s.up_and_down(20.0)),
        ("ramp-120-s".to_owned(), s.up_and_down(60.0)),
        ("ramp-20-s-beyond".to_owned(), s.beyond(20.0)),
        ("ramp-120-s-beyond".to_owned(), s.beyond(60.0)),
        ("holds-high-and-middle".to_owned(), s.holds(0.9, 0.3)),
        ("holds-high-and-low".to_owned(), s.holds(0.95, 0.05)),
        ("nests-high".to_owned(), s.nests(0.85)),
        ("nests-low".to_owned(), s.nests(0.35)),
        (
            "sine-60-cycles".to_owned(),
            s.waves("sine", 0.5, sine_amplitude_mm(range, room_mm, 1.0), 1.0, 60),
        ),
    ];
    for (load, mean) in [("low", 0.25), ("middle", 0.5), ("high", 0.8)] {
        for frequency_hz in SINES_HZ {
            list.extend(sines(range, &s, load, mean, frequency_hz));
        }
        list.extend(triangles(range, &s, load, mean));
    }
    list.into_iter()
        .map(|(name, segments)| TestProfile { name, segments })
        .collect()
}

/// A slow ramp that is repeated, so that cycles of it can be held out.
pub(super) fn repeated_ramp(range: &TestRange) -> TestProfile {
    let s = Segments::new(range);
    TestProfile {
        name: "ramp-60-s-four-times".to_owned(),
        segments: vec![s.up_and_down(30.0).concat(); 4],
    }
}

/// Tests that vary one axis against another: the same loop at three speeds, loops of two sizes at three loads, a loop before and after a
/// rest.
pub(super) fn axis_profiles(range: &TestRange) -> Vec<TestProfile> {
    let s = Segments::new(range);
    let fastest_hz = |amplitude_mm: f64| {
        let by_speed = range.speed_mm_s / amplitude_mm;
        let by_acceleration = (range.acceleration_mm_s2 / amplitude_mm).sqrt();
        let hz = by_speed.min(by_acceleration) / std::f64::consts::TAU;
        (hz.min(range.sample_hz / SAMPLES_PER_CYCLE) / TAPER).max(0.1)
    };
    let room_mm = s.room_mm(0.5);
    let hz = fastest_hz(room_mm);
    let sine =
        |mean: f64, amplitude_mm: f64, hz: f64, cycles| s.waves("sine", mean, amplitude_mm, hz, cycles);
    let speeds = SPEEDS.map(|share| sine(0.5, room_mm, share * hz, 4));
    let sizes = [0.25, 0.5, 0.8].map(|mean| {
        let amplitude_mm = s.room_mm(mean);
        [1.0, 0.4]
            .map(|size| sine(mean, size * amplitude_mm, hz, 4))
            .concat()
    });
    let rest = "\n[[block.segment]]\nkind = \"hold\"\nduration_s = 60.00\n".to_owned();
    let rested = [sine(0.5, room_mm, hz, 10), vec![rest], sine(0.5, room_mm, hz, 10)];
    [
        ("same-loop-at-three-speeds", speeds.concat()),
        ("two-sizes-at-three-loads", sizes.concat()),
        ("same-loop-after-a-rest", rested.concat()),
    ]
    .map(|(name, segments)| TestProfile {
        name: name.to_owned(),
        segments,
    })
    .into()
}

/// A sine of few cycles at one load, and for a slow logger one of more cycles; none that is too fast for the sampling.
fn sines(
    range: &TestRange,
    s: &Segments<'_>,
    load: &str,
    mean: f64,
    frequency_hz: f64,
) -> Vec<(String, Vec<String>)> {
    if frequency_hz * SAMPLES_PER_CYCLE > range.sample_hz {
        return Vec::new();
    }
    let amplitude_mm = sine_amplitude_mm(range, s.room_mm(mean), frequency_hz);
    let cycles = if frequency_hz < 0.5 { 4 } else { 12 };
    let mut list = vec![(
        format!("sine-{load}-{frequency_hz}-hz"),
        s.waves("sine", mean, amplitude_mm, frequency_hz, cycles),
    )];
    // A slow logger records few samples per cycle: as many cycles as can be compared without thinning.
    let wave_s = range.samples / range.sample_hz - RAMPS_S;
    let long = (frequency_hz * wave_s).min(MOST_CYCLES) as u32;
    if long >= 2 * cycles {
        list.push((
            format!("sine-{load}-{frequency_hz}-hz-{long}-cycles"),
            s.waves("sine", mean, amplitude_mm, frequency_hz, long),
        ));
    }
    list
}

/// Triangles of two sizes at one load, with corners as sharp as the actuator allows.
fn triangles(range: &TestRange, s: &Segments<'_>, load: &str, mean: f64) -> Vec<(String, Vec<String>)> {
    // At a corner the speed changes from full in one direction to full in the other within the window of the check.
    let corner_mm_s = 0.5 * range.acceleration_mm_s2 * check::ACCELERATION_WINDOW_S;
    let speed_mm_s = (range.speed_mm_s / TAPER).min(corner_mm_s);
    let triangle = |(size, share): (&str, f64)| {
        let amplitude_mm = (share * range.travel_mm()).min(s.room_mm(mean));
        let frequency_hz = (0.25 * speed_mm_s / amplitude_mm).min(range.sample_hz / SAMPLES_PER_CYCLE);
        let waves = s.waves("triangle", mean, amplitude_mm, frequency_hz, 12);
        (format!("triangle-{load}-{size}"), waves)
    };
    [("short", 0.05), ("long", 0.15)].map(triangle).into()
}

/// Writes the segments of profile files. Displacements are shares of the recorded travel, 0 to 1.
struct Segments<'r> {
    range: &'r TestRange,
}

impl<'r> Segments<'r> {
    fn new(range: &'r TestRange) -> Segments<'r> {
        Segments { range }
    }

    /// Displacement in mm at a share of the travel.
    fn at(&self, share: f64) -> f64 {
        self.range.displacement_mm[0] + share * self.range.travel_mm()
    }

    /// Largest amplitude in mm about a mean, with a margin to the ends of the travel.
    fn room_mm(&self, mean: f64) -> f64 {
        (mean.min(1.0 - mean) - END) * self.range.travel_mm()
    }

    /// A ramp that is at most half as fast as the range allows.
    fn ramp(&self, to_mm: f64, duration_s: f64) -> String {
        ramp_segment(
            to_mm,
            duration_s.max(2.0 * self.range.travel_mm() / self.range.speed_mm_s),
        )
    }

    fn up_and_down(&self, branch_s: f64) -> Vec<String> {
        vec![
            self.ramp(self.at(1.0 - END), branch_s),
            self.ramp(self.at(END), branch_s),
        ]
    }

    /// The same as far as the range allows beyond the recorded travel.
    fn beyond(&self, branch_s: f64) -> Vec<String> {
        vec![
            self.ramp(self.range.beyond_mm, branch_s),
            self.ramp(self.at(END), branch_s),
        ]
    }

    /// Two holds of 60 s, the second after unloading to it.
    fn holds(&self, first: f64, second: f64) -> Vec<String> {
        let hold = "\n[[block.segment]]\nkind = \"hold\"\nduration_s = 60.00\n";
        vec![
            self.ramp(self.at(first), 5.0),
            hold.to_owned(),
            self.ramp(self.at(second), 5.0),
            hold.to_owned(),
            self.ramp(self.at(END), 5.0),
        ]
    }

    /// Nests of small loops below a displacement, each size twice.
    fn nests(&self, mean: f64) -> Vec<String> {
        let mut segments = vec![self.ramp(self.at(mean), 5.0)];
        for size_mm in NESTS_MM {
            let size_mm = f64::min(size_mm, 0.3 * self.range.travel_mm());
            let duration_s = (2.0 * size_mm).max(0.5);
            for _ in 0..2 {
                for to_mm in [self.at(mean) - size_mm, self.at(mean)] {
                    segments.push(ramp_segment(to_mm, duration_s));
                }
            }
        }
        segments.push(self.ramp(self.at(END), 5.0));
        segments
    }

    /// Periodic waves between two ramps.
    fn waves(&self, kind: &str, mean: f64, amplitude_mm: f64, frequency_hz: f64, cycles: u32) -> Vec<String> {
        vec![
            self.ramp(self.at(mean), 5.0),
            format!(
                "\n[[block.segment]]\nkind = \"{kind}\"\nmean_mm = {:.3}\namplitude_mm = {amplitude_mm:.3}\n\
                 frequency_hz = {frequency_hz:.3}\ncycles = {cycles}\n",
                self.at(mean)
            ),
            self.ramp(self.at(END), 5.0),
        ]
    }
}

fn ramp_segment(to_mm: f64, duration_s: f64) -> String {
    format!("\n[[block.segment]]\nkind = \"ramp\"\nto_mm = {to_mm:.3}\nduration_s = {duration_s:.2}\n")
}

/// Largest amplitude in mm of a sine within the room, the speed and the acceleration.
fn sine_amplitude_mm(range: &TestRange, room_mm: f64, frequency_hz: f64) -> f64 {
    let w = std::f64::consts::TAU * frequency_hz;
    room_mm
        .min(range.speed_mm_s / w)
        .min(range.acceleration_mm_s2 / (w * w))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: ProfileLimits = ProfileLimits::EXAMPLE;

    #[test]
    fn every_test_is_a_profile_within_the_limits() {
        for limits in [Some(&LIMITS), None] {
            let range = TestRange::new([-0.01, 24.0], 40.0, [500.0, 3000.0], limits);
            let mut list = test_profiles(&range);
            list.extend(axis_profiles(&range));
            list.push(repeated_ramp(&range));
            assert!(list.len() > 20);
            for test in &list {
                let motion = test
                    .motion(&range, limits)
                    .unwrap_or_else(|| panic!("{}", test.name));
                assert!(
                    motion.points.windows(2).all(|w| w[1].time_s > w[0].time_s),
                    "{}",
                    test.name
                );
                for p in &motion.points {
                    assert!(
                        (-1e-9..=range.beyond_mm).contains(&p.displacement_mm),
                        "{}",
                        test.name
                    );
                    let [low, high] = p.motion.reach_mm;
                    assert!(
                        low <= p.displacement_mm && p.displacement_mm <= high,
                        "{}",
                        test.name
                    );
                }
                let top = motion
                    .points
                    .iter()
                    .map(|p| p.motion.velocity_mm_s.abs())
                    .fold(0.0, f64::max);
                assert!(top <= 1.01 * range.speed_mm_s, "{}: {top} mm/s", test.name);
            }
        }
    }

    #[test]
    fn a_test_beyond_the_limits_is_left_out() {
        let low = ProfileLimits {
            displacement_max_mm: 10.0,
            ..LIMITS
        };
        let range = TestRange::new([0.0, 24.0], 40.0, [500.0, 3000.0], Some(&low));
        let allowed = test_profiles(&range)
            .iter()
            .filter(|t| t.motion(&range, Some(&low)).is_some())
            .count();
        assert!(allowed > 0 && allowed < test_profiles(&range).len(), "{allowed}");
    }

    #[test]
    fn a_slow_logger_gets_more_cycles_without_thinning() {
        let samples = |sample_hz: f64| {
            let range = TestRange::new([0.0, 24.0], 40.0, [sample_hz, 3000.0], Some(&LIMITS));
            let long: Vec<f64> = test_profiles(&range)
                .iter()
                .filter(|t| t.name.ends_with("-hz-60-cycles"))
                .map(|t| {
                    let motion = t.motion(&range, Some(&LIMITS)).expect("within the limits");
                    assert!(motion.cycles >= 60.0, "{}", t.name);
                    motion.duration_s * sample_hz
                })
                .collect();
            long
        };
        let slow = samples(50.0);
        assert!(!slow.is_empty() && slow.iter().all(|n| *n < 3000.0), "{slow:?}");
        assert!(
            samples(1000.0).is_empty(),
            "12 cycles are the most that are not thinned"
        );
    }

    #[test]
    fn a_slow_logger_gets_no_fast_test() {
        let fast = |sample_hz: f64| {
            let range = TestRange::new([0.0, 24.0], 40.0, [sample_hz, 3000.0], Some(&LIMITS));
            let tests = test_profiles(&range);
            let is_fast = |name: &str| name.contains("sine-high-2") || name.contains("-8-hz");
            (tests.len(), tests.iter().filter(|t| is_fast(&t.name)).count())
        };
        let ((slow_all, slow_fast), (_, quick_fast)) = (fast(20.0), fast(1000.0));
        assert!(slow_all > 0 && slow_fast == 0, "{slow_fast} of {slow_all}");
        assert!(quick_fast > 0, "a logger of 1 kHz gets them");
    }
}
