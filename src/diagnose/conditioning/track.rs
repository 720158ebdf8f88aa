//! A conditioned recording, as every later part reads it.

use crate::diagnose::course::Split;
use crate::diagnose::note::Note;
use crate::model::Motion;

/// A conditioned recording: columns of equal length, one row per point.
#[derive(Debug, Clone)]
pub(in crate::diagnose) struct Track {
    /// Name of the recording.
    pub name: String,
    /// Time in s from the recording's first sample.
    pub time_s: Vec<f64>,
    /// Displacement in mm, monotone between reversals.
    pub displacement_mm: Vec<f64>,
    /// Force in N, mean of the samples in the bin.
    pub force_n: Vec<f64>,
    /// 1 / standard deviation in 1/N; 0 where masked.
    pub weight: Vec<f64>,
    /// Direction of travel: 1 loading, -1 unloading.
    pub direction: Vec<f64>,
    /// Travel since the last reversal in mm.
    pub since_reversal_mm: Vec<f64>,
    /// Speed, acceleration and the turning points on both sides, computed from samples before and after the point.
    pub motion: Vec<Motion>,
    /// Error of the last turning point in mm.
    pub turn_error_mm: Vec<f64>,
    /// Motion against the direction of travel that is too small for a reversal of its own, in mm above the noise: a servo at rest.
    pub hidden_mm: Vec<f64>,
    /// Duration of the bin in s.
    pub width_s: Vec<f64>,
    /// Cycle, from 1.
    pub cycle: Vec<u32>,
    /// What the point is used for.
    pub split: Vec<Split>,
    /// Frequency of the motion in Hz; 0 if there are fewer than two reversals.
    pub frequency_hz: f64,
    /// Sampling rate of the recording in Hz.
    pub sample_hz: f64,
    /// Noise of one force sample in N, from the signal itself.
    pub noise_n: f64,
    /// Noise of one displacement sample in mm.
    pub noise_mm: f64,
    /// Amplitude in mm of hum or vibration on the displacement channel: after a reversal, friction that is shaken answers like play.
    pub vibration_mm: f64,
    /// Number of cycles.
    pub cycles: u32,
    /// What was masked or noticed, one sentence each.
    pub remarks: Vec<String>,
    /// What is imperfect about the recording.
    pub notes: Vec<Note>,
}

impl Track {
    pub(in crate::diagnose) fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Some of its points, in order.
    pub(in crate::diagnose) fn picked(&self, points: &[usize]) -> Track {
        fn pick<T: Copy>(of: &[T], points: &[usize]) -> Vec<T> {
            points.iter().map(|&i| of[i]).collect()
        }
        Track {
            name: self.name.clone(),
            time_s: pick(&self.time_s, points),
            displacement_mm: pick(&self.displacement_mm, points),
            force_n: pick(&self.force_n, points),
            weight: pick(&self.weight, points),
            direction: pick(&self.direction, points),
            since_reversal_mm: pick(&self.since_reversal_mm, points),
            motion: pick(&self.motion, points),
            turn_error_mm: pick(&self.turn_error_mm, points),
            hidden_mm: pick(&self.hidden_mm, points),
            width_s: pick(&self.width_s, points),
            cycle: pick(&self.cycle, points),
            split: pick(&self.split, points),
            remarks: Vec::new(),
            notes: Vec::new(),
            ..*self
        }
    }

    /// Largest speed in mm/s.
    pub(in crate::diagnose) fn top_speed_mm_s(&self) -> f64 {
        let speeds = self.motion.iter().map(|m| m.velocity_mm_s.abs());
        speeds.fold(0.0, f64::max)
    }

    /// Index of the first point after each reversal.
    pub(in crate::diagnose) fn turns(&self) -> impl Iterator<Item = usize> {
        (1..self.len()).filter(|&i| self.direction[i] != self.direction[i - 1])
    }

    /// True for the last point before a reversal and the first after it: a model that remembers where it turned is led there.
    pub(in crate::diagnose) fn is_at_reversal(&self, i: usize) -> bool {
        let turns = |from: usize| {
            let directions = (self.direction.get(from), self.direction.get(from + 1));
            matches!(directions, (Some(a), Some(b)) if a != b)
        };
        turns(i) || (i > 0 && turns(i - 1))
    }

    /// Time since the point before, in s.
    pub(in crate::diagnose) fn dt_s(&self, i: usize) -> f64 {
        if i == 0 {
            0.0
        } else {
            self.time_s[i] - self.time_s[i - 1]
        }
    }
}
