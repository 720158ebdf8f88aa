//! Whether the two sensors can be right: readings that jump, stand still, are too noisy, or move the wrong way. It marks samples
//! and finds what the firmware does not look for.

use super::Action;
use super::window::Burst;
use crate::control::channel::Reading;
use crate::control::physical_limits::PhysicalLimits;
use crate::detector;
use crate::protocol::tick::TICK_S;
use crate::recording::Flags;
use crate::units::{Command, Mode, NS_PER_MS};

/// A force that changes by more than this share of its limits in one sample has jumped (fault X4): a motion would cross the
/// whole range in 20 ms.
const FORCE_JUMP: f64 = 0.05;
/// Samples in a row that may be a spike. More are a new level, such as after a break.
const SPIKE_SAMPLES: u32 = 2;
/// This many spikes within [`SPIKE_WINDOW_NS`] are an abort.
const SPIKES: usize = 3;
const SPIKE_WINDOW_NS: u64 = 100 * NS_PER_MS;
/// Equal counts in a row that are no chance (fault X3).
const EQUAL_SAMPLES: u32 = 20;
/// Travel in which a channel with equal counts must have changed, mm.
const STUCK_TRAVEL_MM: f64 = 0.5;
/// Samples over which the noise is measured (fault X7): 1 s.
const NOISE_SAMPLES: u32 = 1000;
/// Motion against the command that shows an inverted LVDT, mm (fault X6): above noise and backlash, far below a runaway.
const AGAINST_MM: f64 = 0.25;
/// Force against the command or the displacement that shows an inverted load cell, N.
const AGAINST_N: f64 = 25.0;
/// The directions are proven once both channels have moved the same way by this much, mm and N.
const PROVEN: [f64; 2] = [0.5, 25.0];

/// One sample with all that it is judged by.
pub(crate) struct JudgedSample<'a> {
    /// The reading in N and mm.
    pub reading: &'a Reading,
    /// Counts of load cell and LVDT.
    pub counts: [i32; 2],
    /// Samples missing before this one.
    pub lost: u64,
    /// The command of this tick; none outside of a profile.
    pub command: Option<Command>,
    /// Limits of the bench.
    pub limits: &'a PhysicalLimits,
    /// Largest standard deviation of the noise, N and mm.
    pub noise_max: [f64; 2],
}

/// What is known of both sensors.
#[derive(Debug, Clone, Default)]
pub(super) struct PlausibilityWatch {
    jumps: [JumpWatch; 2],
    spikes: Burst<SPIKES>,
    stuck: [StuckWatch; 2],
    noise: [NoiseWatch; 2],
    direction: DirectionWatch,
    /// A noise that was told in this run.
    noise_told: bool,
}

impl PlausibilityWatch {
    /// Takes a sample. Returns the flags that it gets and what is wrong.
    pub(super) fn take(&mut self, now_ns: u64, judged: &JudgedSample) -> (Flags, Option<Action>) {
        let mut flags = Flags::empty();
        let spiked = self.jumped(now_ns, judged, &mut flags);
        let stuck = self.stuck(judged, &mut flags);
        let usable = !(judged.reading.flags | flags).intersects(Flags::UNUSABLE);
        let turned = match judged.command.filter(|_| usable) {
            Some(command) => self.direction.take(judged.reading, command),
            None => None,
        };
        let noisy = self.noisy(judged, usable && judged.lost == 0);
        (flags, turned.or(stuck).or(spiked).or(noisy))
    }

    fn jumped(&mut self, now_ns: u64, judged: &JudgedSample, flags: &mut Flags) -> Option<Action> {
        if !detector::acts("X4") {
            return None;
        }
        let limits = judged.limits;
        let largest = [
            FORCE_JUMP * (limits.force_max_n - limits.force_min_n),
            limits.velocity_max_mm_s * TICK_S,
        ];
        let values = [judged.reading.force_n, judged.reading.displacement_mm];
        let invalid = [Flags::FORCE_INVALID, Flags::DISPLACEMENT_INVALID];
        let mut found = None;
        for (k, name) in ["load cell", "LVDT"].into_iter().enumerate() {
            let value = (!judged.reading.flags.contains(invalid[k])).then_some(values[k]);
            let (is_jump, is_spike) = self.jumps[k].take(value, judged.lost, largest[k]);
            if is_jump {
                flags.insert(Flags::SPIKE);
            }
            if is_spike && self.spikes.hit(now_ns, SPIKE_WINDOW_NS) {
                found = Some(Action::Abort(format!(
                    "{SPIKES} spikes within 100 ms, the last one of the {name}: check its cable, shield and connectors"
                )));
            }
        }
        found
    }

    fn stuck(&mut self, judged: &JudgedSample, flags: &mut Flags) -> Option<Action> {
        let (force_n, x_mm) = (judged.reading.force_n, judged.reading.displacement_mm);
        // Without load there may be no contact, and a force of zero that stays is right.
        let is_loaded = force_n.abs() > judged.limits.unloaded_force_n;
        let force = self.stuck[0].take(judged.counts[0], is_loaded.then_some(x_mm));
        let asked_mm = match judged.command {
            Some(Command::Displacement(mm)) => Some(mm),
            _ => None,
        };
        let displacement = self.stuck[1].take(judged.counts[1], asked_mm);
        if (force || displacement) && detector::acts("X3 daemon") {
            flags.insert(Flags::STUCK);
        }
        // The firmware answers for the LVDT, which it needs for its loop.
        (force && detector::acts("X3 daemon")).then(|| {
            Action::Abort(format!(
                "the load cell has read {force_n:.1} N for {EQUAL_SAMPLES} samples and more while the piston moved by {STUCK_TRAVEL_MM} mm: check the load cell and its amplifier"
            ))
        })
    }

    fn noisy(&mut self, judged: &JudgedSample, usable: bool) -> Option<Action> {
        let values = [judged.reading.force_n, judged.reading.displacement_mm];
        let mut found = None;
        for (k, (name, unit)) in [("load cell", "N"), ("LVDT", "mm")].into_iter().enumerate() {
            let sigma = self.noise[k].take(usable.then_some(values[k]));
            let limit = judged.noise_max[k];
            if let Some(sigma) =
                sigma.filter(|sigma| *sigma > limit && !self.noise_told && detector::acts("X7"))
            {
                self.noise_told = true;
                found = Some(Action::Tell(format!(
                    "the noise of the {name} is {sigma:.4} {unit} (limit {limit:.4} {unit}, five times the noise in its calibration): check cable and shield, the run is marked"
                )));
            }
        }
        found
    }
}

/// Finds values that jump away, and those that come back.
#[derive(Debug, Clone, Copy, Default)]
struct JumpWatch {
    /// The newest value that is no jump.
    level: Option<f64>,
    /// Samples in a row that were off this level.
    off: u32,
}

impl JumpWatch {
    /// Takes a value after `lost` missing ones. Returns whether it is a jump, and whether it ended a spike.
    fn take(&mut self, value: Option<f64>, lost: u64, largest: f64) -> (bool, bool) {
        let Some(value) = value else {
            *self = JumpWatch::default();
            return (false, false);
        };
        let samples = (u64::from(self.off) + lost + 1) as f64;
        let is_jump = self
            .level
            .is_some_and(|level| (value - level).abs() > largest * samples);
        if is_jump && self.off < SPIKE_SAMPLES {
            self.off += 1;
            return (true, false);
        }
        let is_spike = self.off > 0 && !is_jump;
        *self = JumpWatch {
            level: Some(value),
            off: 0,
        };
        (false, is_spike)
    }
}

/// Finds counts that no longer change while something else does.
#[derive(Debug, Clone, Copy, Default)]
struct StuckWatch {
    counts: Option<i32>,
    equal: u32,
    /// Where the other channel was when the counts last changed.
    from_mm: Option<f64>,
}

impl StuckWatch {
    /// Takes the counts, and where the piston is or must be; `None` where equal counts are possible.
    fn take(&mut self, counts: i32, at_mm: Option<f64>) -> bool {
        let (true, Some(at_mm)) = (self.counts == Some(counts), at_mm) else {
            *self = StuckWatch {
                counts: Some(counts),
                equal: 0,
                from_mm: at_mm,
            };
            return false;
        };
        self.equal = self.equal.saturating_add(1);
        let travel_mm = (at_mm - *self.from_mm.get_or_insert(at_mm)).abs();
        self.equal >= EQUAL_SAMPLES && travel_mm > STUCK_TRAVEL_MM
    }
}

/// Measures the noise of a channel in motion: a second difference leaves out the motion.
#[derive(Debug, Clone, Copy, Default)]
struct NoiseWatch {
    before: [Option<f64>; 2],
    sum: f64,
    count: u32,
}

impl NoiseWatch {
    /// Takes a value; `None` where it cannot be used. Returns the standard deviation once a second.
    fn take(&mut self, value: Option<f64>) -> Option<f64> {
        let before = self.before;
        self.before = [value, before[0]];
        let (Some(value), [Some(last), Some(older)]) = (value, before) else {
            return None;
        };
        // The variance of a - 2 b + c of independent values is six times theirs.
        self.sum += (value - 2.0 * last + older).powi(2) / 6.0;
        self.count += 1;
        (self.count >= NOISE_SAMPLES).then(|| {
            let sigma = (self.sum / f64::from(self.count)).sqrt();
            (self.sum, self.count) = (0.0, 0);
            sigma
        })
    }
}

/// Whether force and displacement go the way of the command, at the begin of a run. It ends once that is proven.
#[derive(Debug, Clone, Copy, Default)]
struct DirectionWatch {
    /// Force, displacement and command at the begin.
    from: Option<(f64, f64, Command)>,
    proven: bool,
}

impl DirectionWatch {
    fn take(&mut self, reading: &Reading, command: Command) -> Option<Action> {
        let (force_n, x_mm) = (reading.force_n, reading.displacement_mm);
        let (from_n, from_mm, from) = *self.from.get_or_insert((force_n, x_mm, command));
        if self.proven || from.mode() != command.mode() || !detector::acts("X6") {
            return None;
        }
        let (force, travel) = (force_n - from_n, x_mm - from_mm);
        let asked = (command.value() - from.value()).signum();
        let against = match command.mode() {
            Mode::Displacement if travel * asked < -AGAINST_MM => Some("the LVDT moves against the command"),
            Mode::Force if force * asked < -AGAINST_N => Some("the load cell moves against the command"),
            _ if travel * force < 0.0 && travel.abs() > AGAINST_MM && force.abs() > AGAINST_N => {
                Some("force and displacement move in opposite directions")
            }
            _ => None,
        };
        self.proven = travel * force > 0.0 && travel.abs() >= PROVEN[0] && force.abs() >= PROVEN[1];
        against.map(|what| {
            Action::Abort(format!(
                "{what} ({travel:+.2} mm, {force:+.0} N since the begin): check the sign of the scale and the wiring of both sensors"
            ))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spike_comes_back_and_a_new_level_stays() {
        let mut watch = JumpWatch::default();
        let mut take = |value: f64| watch.take(Some(value), 0, 10.0);
        assert_eq!([take(1.0), take(2.0)], [(false, false); 2]);
        assert_eq!([take(500.0), take(3.0)], [(true, false), (false, true)]);
        assert_eq!([take(500.0), take(501.0)], [(true, false); 2]);
        assert_eq!(
            [take(502.0), take(503.0)],
            [(false, false); 2],
            "a break is no spike"
        );
        assert_eq!(
            watch.take(Some(540.0), 4, 10.0),
            (false, false),
            "after four lost samples"
        );
    }

    #[test]
    fn noise_is_measured_beside_a_motion() {
        let mut watch = NoiseWatch::default();
        let value =
            |k: u32| 15.0 * (f64::from(k) * 0.0063).sin() + if k.is_multiple_of(2) { 0.01 } else { -0.01 };
        let sigma = (0..2000)
            .find_map(|k| watch.take(Some(value(k))))
            .expect("after a second");
        // Alternating noise has a second difference of 4 a: sqrt(16 / 6) a = 0.0163; the motion adds 0.0002.
        assert!((sigma - 0.0163).abs() < 0.0005, "{sigma}");
    }
}
