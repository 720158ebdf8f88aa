//! A recording as any plant is driven over it: its motion without noise, the measured force, and what each point is used for.
//! It outlives the diagnosis, so that yardsticks and the written model are compared on exactly the same points.

use crate::model::{Motion, Plant};
use crate::recording::{Flags, Recording};

/// What a point is used for. No parameter is ever fitted to `Select` or `Report`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Split {
    /// Parameters are fitted to these points.
    Fit,
    /// Sets of effects are compared on these points.
    Select,
    /// Errors on held-out data are computed on these points.
    Report,
}

/// A conditioned recording: columns of equal length, one row per point.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Course {
    /// Name of the recording.
    pub name: String,
    /// Sampling rate of the recording in Hz.
    pub sample_hz: f64,
    /// Time in s from the recording's first sample.
    pub time_s: Vec<f64>,
    /// Displacement in mm, monotone between reversals.
    pub displacement_mm: Vec<f64>,
    /// Direction of travel: 1 loading, -1 unloading.
    pub direction: Vec<f64>,
    /// Speed, acceleration and turning points.
    pub motion: Vec<Motion>,
    /// Measured force in N.
    pub force_n: Vec<f64>,
    /// What the force of the point is used for; `None` where it is masked.
    pub split: Vec<Option<Split>>,
}

impl Course {
    /// Indices of the points with one use.
    pub(crate) fn points(&self, split: Split) -> impl Iterator<Item = usize> {
        let used = self.split.iter().enumerate();
        used.filter(move |(_, s)| **s == Some(split)).map(|(i, _)| i)
    }

    /// Force of a plant in N at every point. The plant is stepped at the sampling rate of the recording, as a twin steps it, and
    /// not from point to point as in a fit.
    pub(crate) fn simulated_n(&self, plant: &mut dyn Plant) -> Vec<f64> {
        plant.reset();
        let mut force_n = Vec::with_capacity(self.time_s.len());
        for i in 0..self.time_s.len() {
            let before = i.saturating_sub(1);
            let dt_s = self.time_s[i] - self.time_s[before];
            let steps = (dt_s * self.sample_hz).round().max(1.0);
            let mut force = 0.0;
            for k in 1..=steps as usize {
                let share = k as f64 / steps;
                let between = |from: f64, to: f64| from + share * (to - from);
                let (from, to) = (&self.motion[before], &self.motion[i]);
                plant.told(&Motion {
                    velocity_mm_s: between(from.velocity_mm_s, to.velocity_mm_s),
                    acceleration_mm_s2: between(from.acceleration_mm_s2, to.acceleration_mm_s2),
                    reach_mm: to.reach_mm,
                });
                let displacement_mm = between(self.displacement_mm[before], self.displacement_mm[i]);
                force = plant.step(displacement_mm, dt_s / steps);
            }
            force_n.push(force);
        }
        force_n
    }
}

impl Course {
    /// Force of a plant in N at every point, stepped over the recording's own samples with all their noise, as a twin beside a run
    /// sees them. A point gets the mean over the samples that are nearest to it.
    pub(crate) fn replayed_n(&self, recording: &Recording, plant: &mut dyn Plant) -> Vec<f64> {
        let unusable = |i: usize| {
            let flags = recording.flags.as_ref().and_then(|f| f.get(i));
            flags.is_some_and(|f| Flags::from_bits_retain(*f).intersects(Flags::UNUSABLE))
        };
        plant.reset();
        let mut samples = Vec::with_capacity(recording.len());
        let mut start_and_last_s = None;
        for i in (0..recording.len()).filter(|i| !unusable(*i)) {
            let time_s = recording.time_s[i];
            let (start_s, last_s) = start_and_last_s.unwrap_or((time_s, time_s));
            let force_n = plant.step(recording.displacement_mm[i], time_s - last_s);
            samples.push((time_s - start_s, force_n));
            start_and_last_s = Some((start_s, time_s));
        }
        let middle = |k: usize| 0.5 * (self.time_s[k] + self.time_s[k + 1]);
        let mut from = 0;
        let mean = |k: usize| {
            let nearest = |(time_s, _): &(f64, f64)| k + 1 == self.time_s.len() || *time_s < middle(k);
            let to = from + samples[from..].partition_point(nearest);
            // A turning point between two samples may have none of its own: it gets the one before.
            let of_point = &samples[from.min(to.saturating_sub(1))..to];
            from = to;
            of_point.iter().map(|(_, n)| n).sum::<f64>() / of_point.len().max(1) as f64
        };
        (0..self.time_s.len()).map(mean).collect()
    }
}
