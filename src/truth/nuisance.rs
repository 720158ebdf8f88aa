//! Imperfect instruments: what a laboratory's recordings have although no physics is missing.

use std::f64::consts::TAU;

use rand_chacha::ChaCha8Rng;

use super::{between, normal, one_of};
use crate::recording::Recording;

/// Coloured noise and spikes are this many times the noise of the load cell.
const COLOURED: f64 = 3.0;
/// Share of the samples that are spikes.
const SPIKES: f64 = 0.002;
/// Wrong tare of the load cell, N.
const TARE_N: f64 = 150.0;
/// Largest zero of the LVDT in a file, mm.
const ZERO_MM: f64 = 0.5;
/// Largest skew between the channels in a file, s.
const SKEW_S: f64 = 3e-3;

/// Kind of imperfection. It is one for all recordings of a case.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Imperfection {
    /// Noise whose power falls with the frequency.
    FlickerNoise,
    /// Noise in which each sample remembers the one before (autoregressive of first order).
    CorrelatedNoise,
    /// A vibration of the LVDT.
    Vibration,
    Spikes,
    /// Rows that are missing.
    Gaps,
    /// The recording starts in the middle of a cycle, so the state of the friction is unknown.
    MidCycle,
    /// A wrong tare of the load cell, the same in all recordings.
    Tare,
    /// Another zero of the LVDT in each recording.
    DisplacementZero,
    /// Another skew between the channels in each recording.
    Skew,
    /// One channel has the wrong sign.
    Polarity,
}

use Imperfection::{
    CorrelatedNoise, DisplacementZero, FlickerNoise, Gaps, MidCycle, Polarity, Skew, Spikes, Tare, Vibration,
};

/// All imperfections, in the order of the declaration.
const IMPERFECTIONS: [Imperfection; 10] = [
    FlickerNoise,
    CorrelatedNoise,
    Vibration,
    Spikes,
    Gaps,
    MidCycle,
    Tare,
    DisplacementZero,
    Skew,
    Polarity,
];

/// Names of all imperfections.
#[cfg(test)]
pub(crate) fn imperfections() -> impl Iterator<Item = &'static str> {
    IMPERFECTIONS
        .into_iter()
        .map(|kind| Nuisance { kind, size: 0.0 }.name())
}

/// The imperfection of one case.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Nuisance {
    kind: Imperfection,
    /// Random number from -1 to 1 that sets its sign, its place or its frequency.
    size: f64,
}

impl Nuisance {
    pub(super) fn draw(random: &mut ChaCha8Rng) -> Nuisance {
        Nuisance {
            kind: one_of(random, &IMPERFECTIONS),
            size: between(random, -1.0, 1.0),
        }
    }

    /// One that a technician may overlook: noise, vibration or spikes.
    pub(super) fn mild(random: &mut ChaCha8Rng) -> Nuisance {
        Nuisance {
            kind: one_of(random, &[FlickerNoise, CorrelatedNoise, Vibration, Spikes]),
            size: between(random, -1.0, 1.0),
        }
    }

    /// Name for the label of the case.
    pub(super) fn name(self) -> &'static str {
        match self.kind {
            FlickerNoise => "flicker_noise",
            CorrelatedNoise => "correlated_noise",
            Vibration => "vibration",
            Spikes => "spikes",
            Gaps => "gaps",
            MidCycle => "start_in_mid_cycle",
            Tare => "tare",
            DisplacementZero => "displacement_zero",
            Skew => "skew",
            Polarity => "polarity",
        }
    }

    /// Codes of physics that it is not wrong to name.
    pub(super) fn also(self) -> &'static [&'static str] {
        match self.kind {
            Skew => &["channel_delay"],
            _ => &[],
        }
    }

    /// Delay in s of the force channel of one recording.
    pub(super) fn skew_s(self, random: &mut ChaCha8Rng) -> f64 {
        match self.kind {
            Skew => between(random, -SKEW_S, SKEW_S),
            _ => 0.0,
        }
    }

    /// Spoils one recording. `noise_n` is the noise of the load cell; `cyclic` is false for a ramp.
    pub(super) fn spoil(self, random: &mut ChaCha8Rng, r: &mut Recording, noise_n: f64, cyclic: bool) {
        match self.kind {
            FlickerNoise => {
                let constants = [1.0, 4.0, 16.0, 64.0, 256.0, 1024.0];
                let share = COLOURED * noise_n / (constants.len() as f64).sqrt();
                for constant in constants {
                    add_correlated(random, &mut r.force_n, share, constant);
                }
            }
            CorrelatedNoise => {
                let samples = 4.0 * 8f64.powf(self.size.abs());
                add_correlated(random, &mut r.force_n, COLOURED * noise_n, samples);
            }
            Vibration => vibrate(random, r, 0.005 + 0.015 * self.size.abs()),
            Spikes => add_spikes(random, r),
            Gaps => remove_rows(random, r),
            MidCycle if cyclic => {
                let from = (between(random, 0.2, 0.5) * r.len() as f64) as usize;
                let start_s = r.time_s[from];
                keep(r, |k| k >= from);
                r.time_s.iter_mut().for_each(|t| *t -= start_s);
            }
            Tare => r
                .force_n
                .iter_mut()
                .for_each(|f| *f += TARE_N * self.size.signum()),
            DisplacementZero => {
                let zero_mm = between(random, -ZERO_MM, ZERO_MM);
                r.displacement_mm.iter_mut().for_each(|x| *x += zero_mm);
            }
            Polarity => {
                let channel = if self.size > 0.0 {
                    &mut r.force_n
                } else {
                    &mut r.displacement_mm
                };
                channel.iter_mut().for_each(|v| *v = -*v);
            }
            MidCycle | Skew => {}
        }
    }
}

/// Adds a sine between 12 and 45 Hz to the displacement.
fn vibrate(random: &mut ChaCha8Rng, r: &mut Recording, amplitude_mm: f64) {
    let hz = between(random, 12.0, 45.0);
    let phase = between(random, 0.0, TAU);
    for (x, t) in r.displacement_mm.iter_mut().zip(&r.time_s) {
        *x += amplitude_mm * (TAU * hz * t + phase).sin();
    }
}

/// Adds spikes of 5 to 50 % of the largest value, two of three to the force.
fn add_spikes(random: &mut ChaCha8Rng, r: &mut Recording) {
    let count = r.len();
    let largest = |channel: &[f64]| channel.iter().copied().fold(0.0, f64::max);
    let [force_n, displacement_mm] = [largest(&r.force_n), largest(&r.displacement_mm)];
    for _ in 0..((SPIKES * count as f64).ceil() as usize) {
        let k = (between(random, 0.0, count as f64) as usize).min(count - 1);
        let height = one_of(random, &[-1.0, 1.0]) * between(random, 0.05, 0.5);
        if one_of(random, &[true, true, false]) {
            r.force_n[k] += height * force_n;
        } else {
            r.displacement_mm[k] += height * displacement_mm;
        }
    }
}

/// Removes the rows of two gaps of 0.5 to 4 % of the recording.
fn remove_rows(random: &mut ChaCha8Rng, r: &mut Recording) {
    let count = r.len() as f64;
    let gaps = [0, 1].map(|_| {
        let from = between(random, 0.05, 0.9);
        [from, from + between(random, 0.005, 0.04)]
    });
    keep(r, |k| {
        let share = k as f64 / count;
        gaps.iter().all(|[from, to]| share < *from || share > *to)
    });
}

/// Adds noise with a standard deviation and a correlation over a number of samples.
fn add_correlated(random: &mut ChaCha8Rng, values: &mut [f64], deviation: f64, samples: f64) {
    let kept = (-1.0 / samples).exp();
    let fresh = (1.0 - kept * kept).sqrt();
    let mut noise = normal(random);
    for value in values {
        noise = kept * noise + fresh * normal(random);
        *value += deviation * noise;
    }
}

/// Keeps the samples of some positions.
fn keep(r: &mut Recording, wanted: impl Fn(usize) -> bool) {
    for channel in [&mut r.time_s, &mut r.displacement_mm, &mut r.force_n] {
        let mut k = 0;
        channel.retain(|_| {
            k += 1;
            wanted(k - 1)
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn recording() -> Recording {
        let steps = || (0..2000).map(f64::from);
        Recording {
            time_s: steps().map(|k| 0.01 * k).collect(),
            displacement_mm: steps().map(|k| 10.0 + 5.0 * (0.05 * k).sin()).collect(),
            force_n: steps().map(|k| 900.0 + 400.0 * (0.05 * k).sin()).collect(),
            ..Recording::default()
        }
    }

    #[test]
    fn every_imperfection_but_the_skew_changes_the_rows_and_keeps_them_valid() {
        for kind in IMPERFECTIONS {
            let mut random = ChaCha8Rng::seed_from_u64(1);
            let nuisance = Nuisance { kind, size: 0.4 };
            let mut r = recording();
            nuisance.spoil(&mut random, &mut r, 2.0, true);
            let name = nuisance.name();
            assert_eq!(r != recording(), kind != Skew, "{name}");
            assert_eq!(
                (r.force_n.len(), r.displacement_mm.len()),
                (r.len(), r.len()),
                "{name}"
            );
            assert!(
                r.time_s[0] >= 0.0 && r.time_s.windows(2).all(|w| w[1] > w[0]),
                "{name}"
            );
            let skew_s = nuisance.skew_s(&mut random);
            assert_eq!(skew_s != 0.0, kind == Skew, "{name}");
        }
    }

    #[test]
    fn coloured_noise_has_its_deviation() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let mut values = vec![0.0; 40_000];
        add_correlated(&mut random, &mut values, 5.0, 10.0);
        let n = values.len() as f64;
        let rms = (values.iter().map(|v| v * v).sum::<f64>() / n).sqrt();
        // 40000 samples with a correlation over 10 count as about 2000: 1.6 %; the tolerance is four of them.
        assert!((rms / 5.0 - 1.0).abs() < 0.065, "{rms}");
        let beside: f64 = values.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / n / (rms * rms);
        assert!((beside - (-0.1f64).exp()).abs() < 0.03, "{beside}");
    }
}
