//! Tests that a bench can run: slow and fast, at low and high load, with holds, nests of small reversals and sharp corners.
//! Each is a profile file; its motion is what `profile::Player` makes of it, so that what is simulated is what is run.

use crate::model::Motion;
use crate::profile::{Player, Profile, ProfileLimits, check};

/// Commands a second of a simulated bench.
const COMMANDS_HZ: f64 = 1000.0;
/// Samples that a cycle needs.
const SAMPLES_A_CYCLE: f64 = 20.0;
/// Share of the bench's limits that is used: a servo overshoots.
const MARGIN: f64 = 0.6;
/// Farthest beyond what was recorded, as a share of the travel: what bends goes on, what is a knee does not.
const BEYOND: f64 = 0.25;
/// Points after a turn lie this share of the way since then apart, and no closer than this share of the whole travel.
const COARSENING: f64 = 0.04;
const FINEST: f64 = 1.0 / 600.0;
/// Time of the ramps before and after a wave, about, and most cycles of one.
const RAMPS_S: f64 = 12.0;
const LONGEST_CYCLES: f64 = 60.0;
/// Points in time at least.
const POINTS: f64 = 400.0;

/// What a test may use.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reach {
    pub displacement_mm: [f64; 2],
    /// Largest displacement of a test that goes beyond what was recorded.
    pub beyond_mm: f64,
    pub speed_mm_s: f64,
    pub acceleration_mm_s2: f64,
    pub sample_hz: f64,
    /// Samples that a recording is judged by without thinning.
    pub samples: f64,
}

impl Reach {
    /// What the recordings covered and a little beyond it, as fast as `limits` allow; where there are none, as fast as was recorded.
    pub(super) fn new(
        displacement_mm: [f64; 2],
        recorded_mm_s: f64,
        [sample_hz, samples]: [f64; 2],
        limits: Option<&ProfileLimits>,
    ) -> Reach {
        let [low, high] = [displacement_mm[0].max(0.0), displacement_mm[1]];
        let (speed_mm_s, acceleration_mm_s2) = match limits {
            Some(l) => (MARGIN * l.velocity_max_mm_s, MARGIN * l.acceleration_max_mm_s2),
            None => (0.9 * recorded_mm_s, f64::INFINITY),
        };
        Reach {
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

/// A test.
pub(super) struct Trial {
    pub name: String,
    segments: Vec<String>,
}

/// A point of a test's motion.
pub(super) struct Point {
    pub time_s: f64,
    pub displacement_mm: f64,
    pub motion: Motion,
}

/// A test as it will be recorded.
pub(super) struct Course {
    pub points: Vec<Point>,
    /// Points at which the motion turns.
    pub turns: Vec<usize>,
    pub duration_s: f64,
    /// Whole cycles between turns.
    pub cycles: f64,
}

impl Trial {
    /// Profile file's text.
    pub(super) fn toml(&self, description: &str) -> String {
        format!(
            "name = \"next-test-{}\"\ndescription = {}\ncontrol = \"displacement\"\n\n[[block]]\nrepeat = 1\n{}",
            self.name,
            toml::Value::String(description.to_owned()),
            self.segments.concat()
        )
    }

    /// Its motion from rest at zero; none where the limits do not let it.
    pub(super) fn course(&self, reach: &Reach, limits: Option<&ProfileLimits>) -> Option<Course> {
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
        Some(thinned(&x, reach))
    }
}

/// A motion of one point a command, with as many as tell its shape.
fn thinned(x: &[f64], reach: &Reach) -> Course {
    let last = x.len() - 1;
    let dt_s = 1.0 / COMMANDS_HZ;
    let duration_s = last as f64 * dt_s;
    // A turn where the way back begins: of a hold the end.
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
    let finest_s = 1.0 / reach.sample_hz;
    let longest_s = duration_s / POINTS;
    let (mut points, mut half): (Vec<Point>, usize) = (Vec::new(), 0);
    let mut turned = Vec::new();
    for k in 0..=last {
        let turn = turns.get(half) == Some(&k);
        let (from, since_s) = points.last().map_or((x[0], f64::INFINITY), |p| {
            (p.displacement_mm, k as f64 * dt_s - p.time_s)
        });
        let turned_mm = half.checked_sub(1).map_or(x[0], |h| x[turns[h]]);
        let resolution_mm = (FINEST * reach.travel_mm()).max(COARSENING * (x[k] - turned_mm).abs());
        let due = since_s >= finest_s && ((x[k] - from).abs() >= resolution_mm || since_s >= longest_s);
        if due || turn || k == last {
            let at = |k: usize| x[k.min(last)];
            let (before, after) = (at(k.saturating_sub(1)), at(k + 1));
            let next_mm = turns.get(half).map_or(x[last], |&t| x[t]);
            points.push(Point {
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
    Course {
        points,
        turns: turned,
        duration_s,
        cycles: 0.5 * (turns.len() + 1) as f64,
    }
}

/// The tests that the reach allows.
pub(super) fn trials(reach: &Reach) -> Vec<Trial> {
    let [low, _] = reach.displacement_mm;
    let travel = reach.travel_mm();
    let at = |share: f64| low + share * travel;
    let ramp = |to_mm: f64, duration_s: f64| {
        let duration_s = duration_s.max(2.0 * travel / reach.speed_mm_s);
        format!("\n[[block.segment]]\nkind = \"ramp\"\nto_mm = {to_mm:.3}\nduration_s = {duration_s:.2}\n")
    };
    let hold =
        |duration_s: f64| format!("\n[[block.segment]]\nkind = \"hold\"\nduration_s = {duration_s:.2}\n");
    let waves = |kind: &str, mean: f64, amplitude_mm: f64, frequency_hz: f64, cycles: u32| {
        vec![
            ramp(at(mean), 5.0),
            format!(
                "\n[[block.segment]]\nkind = \"{kind}\"\nmean_mm = {:.3}\namplitude_mm = {amplitude_mm:.3}\n\
                 frequency_hz = {frequency_hz:.3}\ncycles = {cycles}\n",
                at(mean)
            ),
            ramp(at(0.02), 5.0),
        ]
    };
    let room_mm = |mean: f64| (mean.min(1.0 - mean) - 0.02) * travel;
    let nests = |mean: f64| {
        let mut segments = vec![ramp(at(mean), 5.0)];
        for size in [0.2, 0.5, 1.0, 2.0, 4.0] {
            let size = f64::min(size, 0.3 * travel);
            let duration_s = (2.0 * size).max(0.5);
            for _ in 0..2 {
                for to_mm in [at(mean) - size, at(mean)] {
                    segments.push(format!(
                        "\n[[block.segment]]\nkind = \"ramp\"\nto_mm = {to_mm:.3}\nduration_s = {duration_s:.2}\n"
                    ));
                }
            }
        }
        segments.push(ramp(at(0.02), 5.0));
        segments
    };
    let up_and_down = |branch_s: f64| vec![ramp(at(0.98), branch_s), ramp(at(0.02), branch_s)];
    let beyond = |branch_s: f64| vec![ramp(reach.beyond_mm, branch_s), ramp(at(0.02), branch_s)];
    let holds = |first: f64, second: f64| {
        vec![
            ramp(at(first), 5.0),
            hold(60.0),
            ramp(at(second), 5.0),
            hold(60.0),
            ramp(at(0.02), 5.0),
        ]
    };
    let mut list: Vec<(String, Vec<String>)> = vec![
        ("ramp-2-s".to_owned(), up_and_down(2.0)),
        ("ramp-20-s".to_owned(), up_and_down(20.0)),
        ("ramp-120-s".to_owned(), up_and_down(60.0)),
        ("ramp-20-s-beyond".to_owned(), beyond(20.0)),
        ("ramp-120-s-beyond".to_owned(), beyond(60.0)),
        ("holds-high-and-middle".to_owned(), holds(0.9, 0.3)),
        ("holds-high-and-low".to_owned(), holds(0.95, 0.05)),
        ("nests-high".to_owned(), nests(0.85)),
        ("nests-low".to_owned(), nests(0.35)),
        (
            "sine-60-cycles".to_owned(),
            waves("sine", 0.5, within(reach, room_mm(0.5), 1.0), 1.0, 60),
        ),
    ];
    for (load, mean) in [("low", 0.25), ("middle", 0.5), ("high", 0.8)] {
        for frequency_hz in [0.1, 0.5, 1.0, 2.0, 5.0, 8.0] {
            if frequency_hz * SAMPLES_A_CYCLE > reach.sample_hz {
                continue;
            }
            let amplitude_mm = within(reach, room_mm(mean), frequency_hz);
            let cycles = if frequency_hz < 0.5 { 4 } else { 12 };
            list.push((
                format!("sine-{load}-{frequency_hz}-hz"),
                waves("sine", mean, amplitude_mm, frequency_hz, cycles),
            ));
            // A slow logger sees little of a cycle: as many as it is judged by.
            let wave_s = reach.samples / reach.sample_hz - RAMPS_S;
            let long = (frequency_hz * wave_s).min(LONGEST_CYCLES) as u32;
            if long >= 2 * cycles {
                list.push((
                    format!("sine-{load}-{frequency_hz}-hz-{long}-cycles"),
                    waves("sine", mean, amplitude_mm, frequency_hz, long),
                ));
            }
        }
        // Corners as sharp as the oil lets them be: both directions of full speed within the window of the check.
        let corner_mm_s = 0.5 * reach.acceleration_mm_s2 * check::ACCELERATION_WINDOW_S;
        // The taper rises while the wave does: up to an eighth is added.
        let speed_mm_s = (reach.speed_mm_s / 1.15).min(corner_mm_s);
        for (size, share) in [("short", 0.05), ("long", 0.15)] {
            let amplitude_mm = (share * travel).min(room_mm(mean));
            let frequency_hz = (0.25 * speed_mm_s / amplitude_mm).min(reach.sample_hz / SAMPLES_A_CYCLE);
            list.push((
                format!("triangle-{load}-{size}"),
                waves("triangle", mean, amplitude_mm, frequency_hz, 12),
            ));
        }
    }
    list.into_iter()
        .map(|(name, segments)| Trial { name, segments })
        .collect()
}

/// Amplitude of a sine that keeps room, speed and acceleration.
fn within(reach: &Reach, room_mm: f64, frequency_hz: f64) -> f64 {
    let w = std::f64::consts::TAU * frequency_hz;
    room_mm
        .min(reach.speed_mm_s / w)
        .min(reach.acceleration_mm_s2 / (w * w))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: ProfileLimits = ProfileLimits {
        force_min_n: -200.0,
        force_max_n: 3200.0,
        displacement_min_mm: -5.0,
        displacement_max_mm: 45.0,
        velocity_max_mm_s: 150.0,
        acceleration_max_mm_s2: 3000.0,
    };

    #[test]
    fn every_test_is_a_profile_within_what_is_allowed() {
        for limits in [Some(&LIMITS), None] {
            let reach = Reach::new([-0.01, 24.0], 40.0, [500.0, 3000.0], limits);
            let list = trials(&reach);
            assert!(list.len() > 20);
            for trial in &list {
                let course = trial
                    .course(&reach, limits)
                    .unwrap_or_else(|| panic!("{}", trial.name));
                assert!(
                    course.points.windows(2).all(|w| w[1].time_s > w[0].time_s),
                    "{}",
                    trial.name
                );
                for p in &course.points {
                    assert!(
                        (-1e-9..=reach.beyond_mm).contains(&p.displacement_mm),
                        "{}",
                        trial.name
                    );
                    let [low, high] = p.motion.reach_mm;
                    assert!(
                        low <= p.displacement_mm && p.displacement_mm <= high,
                        "{}",
                        trial.name
                    );
                }
                let top = course
                    .points
                    .iter()
                    .map(|p| p.motion.velocity_mm_s.abs())
                    .fold(0.0, f64::max);
                assert!(top <= 1.01 * reach.speed_mm_s, "{}: {top} mm/s", trial.name);
            }
        }
    }

    #[test]
    fn what_a_bench_does_not_allow_is_no_test() {
        let low = ProfileLimits {
            displacement_max_mm: 10.0,
            ..LIMITS
        };
        let reach = Reach::new([0.0, 24.0], 40.0, [500.0, 3000.0], Some(&low));
        let allowed = trials(&reach)
            .iter()
            .filter(|t| t.course(&reach, Some(&low)).is_some())
            .count();
        assert!(allowed > 0 && allowed < trials(&reach).len(), "{allowed}");
    }

    #[test]
    fn a_slow_logger_is_given_more_cycles_and_none_that_it_is_not_judged_by() {
        let samples = |sample_hz: f64| {
            let reach = Reach::new([0.0, 24.0], 40.0, [sample_hz, 3000.0], Some(&LIMITS));
            let long: Vec<f64> = trials(&reach)
                .iter()
                .filter(|t| t.name.ends_with("-hz-60-cycles"))
                .map(|t| {
                    let course = t.course(&reach, Some(&LIMITS)).expect("within the limits");
                    assert!(course.cycles >= 60.0, "{}", t.name);
                    course.duration_s * sample_hz
                })
                .collect();
            long
        };
        let slow = samples(50.0);
        assert!(!slow.is_empty() && slow.iter().all(|n| *n < 3000.0), "{slow:?}");
        assert!(
            samples(1000.0).is_empty(),
            "12 cycles are all that it can be judged by"
        );
    }

    #[test]
    fn a_slow_logger_is_asked_for_no_fast_test() {
        let reach = Reach::new([0.0, 24.0], 40.0, [20.0, 3000.0], Some(&LIMITS));
        assert!(
            trials(&reach)
                .iter()
                .all(|t| !t.name.contains("sine-high-2") && !t.name.contains("-8-hz"))
        );
    }
}
