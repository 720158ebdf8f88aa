//! Holds a profile against limits before anything moves: every level and speed that it asks for, by playing it through.
//! What the specimen answers (the force of a displacement profile) is a model's business: see `twin::dry_run`.

use super::{Player, Profile, ProfileError};
use crate::units::Mode;

/// Limits of a bench as far as a profile by itself can break them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProfileLimits {
    /// Lowest force.
    pub force_min_n: f64,
    /// Highest force.
    pub force_max_n: f64,
    /// Lowest displacement.
    pub displacement_min_mm: f64,
    /// Highest displacement.
    pub displacement_max_mm: f64,
    /// Highest speed.
    pub velocity_max_mm_s: f64,
    /// Highest mean acceleration over [`ACCELERATION_WINDOW_S`].
    pub acceleration_max_mm_s2: f64,
}

/// Corners of ramps have no acceleration of their own; the oil rounds them over about this time.
pub const ACCELERATION_WINDOW_S: f64 = 0.02;

/// A limit that the profile would break: its worst value and when.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "profile {profile} asks for {name} {value:.3} at {time_s:.3} s (segment {segment}), beyond the limit {limit}: \
     change the profile, or the limit if rig and specimen allow it"
)]
pub struct Violation {
    /// The profile.
    pub profile: String,
    /// Limit's key, as in the bench config.
    pub name: &'static str,
    /// Worst value.
    pub value: f64,
    /// The limit.
    pub limit: f64,
    /// Time in the profile.
    pub time_s: f64,
    /// Expanded segment.
    pub segment: u32,
}

/// The worst value of one quantity so far.
#[derive(Clone, Copy)]
struct Worst {
    name: &'static str,
    limit: f64,
    /// +1 where more is worse, -1 where less is.
    sign: f64,
    value: f64,
    time_s: f64,
    segment: u32,
}

impl Worst {
    fn new(name: &'static str, limit: f64, sign: f64) -> Self {
        Worst {
            name,
            limit,
            sign,
            value: -sign * f64::INFINITY,
            time_s: 0.0,
            segment: 0,
        }
    }

    fn see(&mut self, value: f64, time_s: f64, segment: u32) {
        if value * self.sign > self.value * self.sign {
            (self.value, self.time_s, self.segment) = (value, time_s, segment);
        }
    }
}

/// Every limit that the profile breaks when it starts at `start_level`, with its worst value; empty when it keeps them all.
/// A command at the limit is allowed.
pub fn violations(
    profile: &Profile,
    limits: &ProfileLimits,
    start_level: f64,
    sample_rate_hz: f64,
) -> Result<Vec<Violation>, ProfileError> {
    let mut player = Player::new(profile, start_level, sample_rate_hz)?;
    let (low, high) = match profile.mode {
        Mode::Force => (
            ("force_min_n", limits.force_min_n),
            ("force_max_n", limits.force_max_n),
        ),
        Mode::Displacement => (
            ("displacement_min_mm", limits.displacement_min_mm),
            ("displacement_max_mm", limits.displacement_max_mm),
        ),
    };
    let mut lowest = Worst::new(low.0, low.1, -1.0);
    let mut highest = Worst::new(high.0, high.1, 1.0);
    let mut speed = Worst::new("velocity_max_mm_s", limits.velocity_max_mm_s, 1.0);
    let mut acceleration = Worst::new("acceleration_max_mm_s2", limits.acceleration_max_mm_s2, 1.0);
    let window = ((ACCELERATION_WINDOW_S * sample_rate_hz).round() as usize).max(1);
    let mut speeds = vec![0.0; window];
    let mut before = start_level;
    let mut tick = 0usize;
    while let Some(slot) = player.next() {
        let value = slot.command.value();
        let time_s = (tick + 1) as f64 / sample_rate_hz;
        lowest.see(value, time_s, slot.segment);
        highest.see(value, time_s, slot.segment);
        let velocity = (value - before) * sample_rate_hz;
        let old = std::mem::replace(&mut speeds[tick % window], velocity);
        speed.see(velocity.abs(), time_s, slot.segment);
        acceleration.see(
            (velocity - old).abs() / (window as f64 / sample_rate_hz),
            time_s,
            slot.segment,
        );
        before = value;
        tick += 1;
    }
    // Speeds of a force profile are the specimen's answer.
    let moving: &[Worst] = if profile.mode == Mode::Displacement {
        &[speed, acceleration]
    } else {
        &[]
    };
    let broken = [lowest, highest].into_iter().chain(moving.iter().copied());
    Ok(broken
        .filter(|w| w.value * w.sign > w.limit * w.sign)
        .map(|w| Violation {
            profile: profile.name.clone(),
            name: w.name,
            value: w.value,
            limit: w.limit,
            time_s: w.time_s,
            segment: w.segment,
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: ProfileLimits = ProfileLimits {
        force_min_n: -100.0,
        force_max_n: 3000.0,
        displacement_min_mm: -1.0,
        displacement_max_mm: 40.0,
        velocity_max_mm_s: 120.0,
        acceleration_max_mm_s2: 2000.0,
    };

    fn sine(amplitude_mm: f64, frequency_hz: f64) -> Profile {
        let text = format!(
            "name = \"s\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 20\n\
             duration_s = 4\n[[block.segment]]\nkind = \"sine\"\nmean_mm = 20\namplitude_mm = {amplitude_mm}\n\
             frequency_hz = {frequency_hz}\ncycles = 3\n"
        );
        Profile::from_toml(&text, "s").unwrap()
    }

    #[test]
    fn the_fastest_sine_of_the_bench_is_allowed() {
        assert_eq!(violations(&sine(6.0, 2.5), &LIMITS, 0.0, 1000.0), Ok(vec![]));
    }

    #[test]
    fn every_limit_is_named_with_its_worst_value() {
        let found = violations(&sine(22.0, 2.5), &LIMITS, 0.0, 1000.0).unwrap();
        let names: Vec<_> = found.iter().map(|v| v.name).collect();
        let all = [
            "displacement_min_mm",
            "displacement_max_mm",
            "velocity_max_mm_s",
            "acceleration_max_mm_s2",
        ];
        assert_eq!(names, all);
        assert!((found[1].value - 42.0).abs() < 1e-9);
        // A omega = 345.6 mm/s; a taper may add a little near its end.
        assert!((found[2].value - 345.6).abs() < 2.0, "{}", found[2]);
    }
}
