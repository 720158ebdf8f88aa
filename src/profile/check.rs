//! Holds a profile against limits before anything moves: every level and speed that it asks for, by playing it through.
//! What the specimen answers (the force of a displacement profile) is a model's business: see `twin::dry_run`.

use super::{Player, Profile, ProfileError};
use crate::units::Command;

/// Limits of a bench as far as a profile by itself can break them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ProfileLimits {
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
pub(crate) const ACCELERATION_WINDOW_S: f64 = 0.02;

/// A limit that the profile would break: its worst value and when.
#[derive(Debug, Clone, PartialEq, serde::Serialize, thiserror::Error)]
#[error(
    "profile {profile} reaches {:.3} at {:.3} s (segment {}), beyond {} = {}: change the profile, or the limit if rig and \
     specimen allow it",
    worst.value, worst.time_s, worst.segment, worst.name, worst.limit
)]
pub(crate) struct Violation {
    /// The profile.
    pub profile: String,
    /// The limit and the value.
    pub worst: Extreme,
}

/// The worst value that one limit has seen.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct Extreme {
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
    /// +1 where more is worse, -1 where less is.
    #[serde(skip)]
    sign: f64,
}

impl Extreme {
    fn new(name: &'static str, limit: f64, sign: f64) -> Self {
        Extreme {
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

    /// What is left to the limit, in percent of it; negative beyond it.
    pub(crate) fn margin_percent(&self) -> f64 {
        self.sign * (self.limit - self.value) / self.limit.abs() * 100.0
    }

    /// A value at the limit is allowed, one beyond it is not.
    pub(crate) fn is_broken(&self) -> bool {
        self.value * self.sign > self.limit * self.sign
    }
}

/// Follows force and displacement, commanded or predicted, against the limits.
#[derive(Debug, Clone)]
pub(crate) struct LimitWatch {
    force: [Extreme; 2],
    displacement: [Extreme; 2],
    speed: Extreme,
    acceleration: Extreme,
    sample_rate_hz: f64,
    /// Speeds of the newest window, oldest at `tick % len`.
    speeds: Vec<f64>,
    tick: usize,
    before_mm: f64,
}

impl LimitWatch {
    /// From a rig at rest at `start_mm`.
    pub(crate) fn new(limits: &ProfileLimits, start_mm: f64, sample_rate_hz: f64) -> Self {
        let window = ((ACCELERATION_WINDOW_S * sample_rate_hz).round() as usize).max(1);
        LimitWatch {
            force: [
                Extreme::new("force_min_n", limits.force_min_n, -1.0),
                Extreme::new("force_max_n", limits.force_max_n, 1.0),
            ],
            displacement: [
                Extreme::new("displacement_min_mm", limits.displacement_min_mm, -1.0),
                Extreme::new("displacement_max_mm", limits.displacement_max_mm, 1.0),
            ],
            speed: Extreme::new("velocity_max_mm_s", limits.velocity_max_mm_s, 1.0),
            acceleration: Extreme::new("acceleration_max_mm_s2", limits.acceleration_max_mm_s2, 1.0),
            sample_rate_hz,
            speeds: vec![0.0; window],
            tick: 0,
            before_mm: start_mm,
        }
    }

    /// One tick; what is not known is left out.
    pub(crate) fn see(&mut self, segment: u32, force_n: Option<f64>, displacement_mm: Option<f64>) {
        let at = self.tick % self.speeds.len();
        self.tick += 1;
        let time_s = self.tick as f64 / self.sample_rate_hz;
        if let Some(force_n) = force_n {
            self.force
                .iter_mut()
                .for_each(|e| e.see(force_n, time_s, segment));
        }
        if let Some(now_mm) = displacement_mm {
            self.displacement
                .iter_mut()
                .for_each(|e| e.see(now_mm, time_s, segment));
            let velocity = (now_mm - self.before_mm) * self.sample_rate_hz;
            let old = std::mem::replace(&mut self.speeds[at], velocity);
            let window_s = self.speeds.len() as f64 / self.sample_rate_hz;
            self.speed.see(velocity.abs(), time_s, segment);
            self.acceleration
                .see((velocity - old).abs() / window_s, time_s, segment);
            self.before_mm = now_mm;
        }
    }

    /// The worst of every quantity that was seen.
    pub(crate) fn extremes(&self) -> Vec<Extreme> {
        let all = self
            .force
            .iter()
            .chain(&self.displacement)
            .chain([&self.speed, &self.acceleration]);
        all.filter(|e| e.segment > 0).copied().collect()
    }

    /// Those beyond their limit.
    pub(crate) fn violations(&self, profile: &str) -> Vec<Violation> {
        let broken = self.extremes().into_iter().filter(Extreme::is_broken);
        broken
            .map(|worst| Violation {
                profile: profile.to_owned(),
                worst,
            })
            .collect()
    }
}

/// Every limit that the profile's own commands break when it starts at `start_level`; empty when it keeps them all.
pub(crate) fn violations(
    profile: &Profile,
    limits: &ProfileLimits,
    start_level: f64,
    sample_rate_hz: f64,
) -> Result<Vec<Violation>, ProfileError> {
    let mut player = Player::new(profile, start_level, sample_rate_hz)?;
    let mut watch = LimitWatch::new(limits, start_level, sample_rate_hz);
    while let Some(slot) = player.next() {
        match slot.command {
            // Displacement and speed of a force profile are the specimen's answer.
            Command::Force(n) => watch.see(slot.segment, Some(n), None),
            Command::Displacement(mm) => watch.see(slot.segment, None, Some(mm)),
        }
    }
    Ok(watch.violations(&profile.name))
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
        let names: Vec<_> = found.iter().map(|v| v.worst.name).collect();
        let all = [
            "displacement_min_mm",
            "displacement_max_mm",
            "velocity_max_mm_s",
            "acceleration_max_mm_s2",
        ];
        assert_eq!(names, all);
        assert!((found[1].worst.value - 42.0).abs() < 1e-9);
        // A omega = 345.6 mm/s; a taper may add a little near its end.
        assert!((found[2].worst.value - 345.6).abs() < 2.0, "{}", found[2]);
    }
}
