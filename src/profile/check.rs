//! Checks a profile against limits before anything moves, by playing it to its end and looking at every level and speed.
//! The force of a displacement profile comes from a model: see `twin::dry_run`.

use super::{Player, Profile, ProfileError};
use crate::units::Command;

/// The limits of a bench that a profile can break.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ProfileLimits {
    /// Lower force limit in N.
    pub force_min_n: f64,
    /// Upper force limit in N.
    pub force_max_n: f64,
    /// Lower displacement limit in mm.
    pub displacement_min_mm: f64,
    /// Upper displacement limit in mm.
    pub displacement_max_mm: f64,
    /// Largest speed in mm/s.
    pub velocity_max_mm_s: f64,
    /// Largest mean acceleration over [`ACCELERATION_WINDOW_S`] in mm/s2.
    pub acceleration_max_mm_s2: f64,
}

#[cfg(test)]
impl ProfileLimits {
    /// Limits of a bench of 3200 N and 45 mm.
    pub(crate) const EXAMPLE: ProfileLimits = ProfileLimits {
        force_min_n: -200.0,
        force_max_n: 3200.0,
        displacement_min_mm: -5.0,
        displacement_max_mm: 45.0,
        velocity_max_mm_s: 150.0,
        acceleration_max_mm_s2: 3000.0,
    };
}

/// Time in s over which the acceleration is averaged. The corner of a ramp has no finite acceleration by itself; the oil
/// rounds it over about this time.
pub(crate) const ACCELERATION_WINDOW_S: f64 = 0.02;

/// A limit that the profile would break, with its worst value and the time of it.
#[derive(Debug, Clone, PartialEq, serde::Serialize, thiserror::Error)]
#[error(
    "profile {profile} reaches {:.3} {} at {:.3} s (segment {}), beyond {} = {} {}: change the profile, or the limit if rig \
     and specimen allow it",
    worst.value, worst.unit(), worst.time_s, worst.segment, worst.name, worst.limit, worst.unit()
)]
pub(crate) struct Violation {
    /// Name of the profile.
    pub profile: String,
    pub worst: Extreme,
}

/// The worst value compared with one limit.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct Extreme {
    /// Key of the limit in the bench file.
    pub name: &'static str,
    /// The worst value, in the unit of the limit.
    pub value: f64,
    pub limit: f64,
    /// Time of the worst value from the start of the profile, in s.
    pub time_s: f64,
    /// Segment of the worst value, from 1, repeats written out.
    pub segment: u32,
    /// +1 for an upper limit, -1 for a lower limit.
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

    /// Unit of the limit, from the ending of its key.
    pub(crate) fn unit(&self) -> &'static str {
        unit_of(self.name)
    }

    /// Distance to the limit in percent of the limit; negative beyond it.
    pub(crate) fn margin_percent(&self) -> f64 {
        self.sign * (self.limit - self.value) / self.limit.abs() * 100.0
    }

    /// True beyond the limit. A value at the limit is allowed.
    pub(crate) fn is_broken(&self) -> bool {
        self.value * self.sign > self.limit * self.sign
    }
}

/// Unit of a dimensioned key, from its ending.
pub(crate) fn unit_of(key: &str) -> &'static str {
    match key {
        key if key.ends_with("_mm_s2") => "mm/s\u{b2}",
        key if key.ends_with("_mm_s") => "mm/s",
        key if key.ends_with("_mm") => "mm",
        key if key.ends_with("_n") => "N",
        _ => "",
    }
}

/// Compares force and displacement, commanded or predicted, with the limits.
#[derive(Debug, Clone)]
pub(crate) struct LimitWatch {
    force: [Extreme; 2],
    displacement: [Extreme; 2],
    speed: Extreme,
    acceleration: Extreme,
    sample_rate_hz: f64,
    /// Speeds of the last window in mm/s, the oldest at `tick % len`.
    speeds: Vec<f64>,
    tick: usize,
    before_mm: f64,
}

impl LimitWatch {
    /// For a rig at rest at `start_mm`.
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

    /// Compares one tick. A quantity that is not known is not compared.
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

    /// The worst value of every quantity that was compared.
    pub(crate) fn extremes(&self) -> Vec<Extreme> {
        let all = self
            .force
            .iter()
            .chain(&self.displacement)
            .chain([&self.speed, &self.acceleration]);
        all.filter(|e| e.segment > 0).copied().collect()
    }

    /// The extremes beyond their limit.
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

/// Every limit that the commands of the profile break if it starts at `start_level`; empty if they break none.
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
            // Displacement and speed of a force profile depend on the specimen.
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
        // A omega = 345.6 mm/s; a taper adds a little near its end.
        assert!((found[2].worst.value - 345.6).abs() < 2.0, "{}", found[2]);
    }
}
