//! The detection limit of an effect in a case: the unit of strength.
//!
//! ```text
//! s  = F(with) - F(without), at every sample          s' = s - J (J'WJ)^-1 J'W s
//! level = sqrt(s' W s'),  W = n_r / N_r / sigma^2     detection limit: level = MULTIPLE
//! ```
//! J: derivatives of the force by the parameters that the baseline may refit (preload, rate, friction, its travel and shape).
//! The N_r samples of recording r count as n_r effective samples, at most [`SAMPLES_PER_BRANCH`] for each branch, because
//! neighbouring samples of a residual are not independent. sigma: noise of the force and of displacement times rate, N.
//! At the limit, the part of the effect that no refit can absorb has an RMS of [`MULTIPLE`] times sigma / sqrt(n).

use super::catalogue::Physics;
use super::{Form, Hidden, Programme, TruthSpecimen};

/// Number of standard deviations of a detection. Noise alone exceeds it with a probability of 1 in 3 million.
pub(crate) const MULTIPLE: f64 = 5.0;
/// Largest number of effective samples of a branch: 50 cycles count as 500, the upper end of a pilot test on this bench.
pub(crate) const SAMPLES_PER_BRANCH: f64 = 5.0;
/// Relative precision of the level of a sized effect.
const PRECISION: f64 = 0.02;

/// Measures how visible effects are in the recordings of one specimen.
pub(crate) struct VisibilityMeter<'a> {
    specimen: &'a TruthSpecimen,
    programme: &'a [(Programme, Vec<f64>)],
    /// Square root of the weight of each sample.
    weight: Vec<f64>,
    /// Orthonormal basis of the force changes that a refit absorbs.
    basis: Vec<Vec<f64>>,
    /// Weighted force without an effect.
    plain: Vec<f64>,
}

impl<'a> VisibilityMeter<'a> {
    /// `programme` has the motions and their sampling times in s; `sigma_n` is the noise in N.
    pub(crate) fn new(
        specimen: &'a TruthSpecimen,
        programme: &'a [(Programme, Vec<f64>)],
        sigma_n: f64,
    ) -> VisibilityMeter<'a> {
        let weight = programme
            .iter()
            .flat_map(|(motion, times)| {
                let effective = (SAMPLES_PER_BRANCH * motion.branches()).min(times.len() as f64);
                std::iter::repeat_n((effective / times.len() as f64).sqrt() / sigma_n, times.len())
            })
            .collect();
        let mut meter = VisibilityMeter {
            specimen,
            programme,
            weight,
            basis: Vec::new(),
            plain: Vec::new(),
        };
        meter.plain = meter.forces(specimen, &[]);
        for (moved, step) in variations(specimen) {
            let changed: Vec<f64> = meter
                .forces(&moved, &[])
                .iter()
                .zip(&meter.plain)
                .map(|(a, b)| (a - b) / step)
                .collect();
            meter.absorb(changed);
        }
        meter
    }

    /// Weighted forces at all samples.
    fn forces(&self, specimen: &TruthSpecimen, hidden: &[Hidden]) -> Vec<f64> {
        self.programme
            .iter()
            .flat_map(|(motion, times)| specimen.forces_to_explain(hidden, motion, times))
            .zip(&self.weight)
            .map(|(f, w)| f * w)
            .collect()
    }

    /// Adds a direction to the basis, unless the basis has it already.
    fn absorb(&mut self, mut direction: Vec<f64>) {
        let before = norm(&direction);
        self.remove_absorbed(&mut direction);
        let size = norm(&direction);
        if size > 1e-6 * before {
            direction.iter_mut().for_each(|v| *v /= size);
            self.basis.push(direction);
        }
    }

    fn remove_absorbed(&self, v: &mut [f64]) {
        // The second pass removes the rounding errors of the first.
        for _ in 0..2 {
            for b in &self.basis {
                let along: f64 = b.iter().zip(v.iter()).map(|(b, v)| b * v).sum();
                v.iter_mut().zip(b).for_each(|(v, b)| *v -= along * b);
            }
        }
    }

    /// Weighted change of the force by the effect that no refit absorbs, in standard deviations of effective samples.
    pub(crate) fn signature(&self, hidden: &Hidden) -> Vec<f64> {
        let with = self.forces(self.specimen, std::slice::from_ref(hidden));
        let mut change: Vec<f64> = with.iter().zip(&self.plain).map(|(a, b)| a - b).collect();
        self.remove_absorbed(&mut change);
        change
    }

    /// Length of [`VisibilityMeter::signature`].
    pub(crate) fn level(&self, hidden: &Hidden) -> f64 {
        norm(&self.signature(hidden))
    }

    /// The effect scaled to a strength in detection limits; `None` if this needs a size that is not plausible.
    pub(crate) fn sized(&self, physics: &Physics, unit: &Hidden, strength: f64) -> Option<Hidden> {
        let largest = (physics.largest)(self.specimen);
        let sign = unit.size.signum();
        let wanted = strength * MULTIPLE;
        let at = |size: f64| Hidden {
            size: sign * size,
            ..*unit
        };
        let mut size = 0.03 * largest;
        for _ in 0..14 {
            let level = self.level(&at(size));
            let ratio = wanted / level.max(1e-9);
            if (ratio - 1.0).abs() < PRECISION {
                return Some(at(size));
            }
            if size >= largest && ratio > 1.0 {
                return None;
            }
            size = (size * ratio.clamp(0.02, 30.0)).min(largest);
        }
        None
    }

    /// Cosine between the signatures of two effects.
    pub(crate) fn cosine(&self, a: &Hidden, b: &Hidden) -> f64 {
        let (a, b) = (self.signature(a), self.signature(b));
        let dot: f64 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
        dot / (norm(&a) * norm(&b)).max(1e-12)
    }
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// The specimen with one parameter changed, and the change, for each parameter that the baseline may refit.
fn variations(specimen: &TruthSpecimen) -> Vec<(TruthSpecimen, f64)> {
    let s = specimen;
    let mut variations = vec![
        (
            TruthSpecimen {
                preload_n: s.preload_n + 1.0,
                ..s.clone()
            },
            1.0,
        ),
        (
            TruthSpecimen {
                rate_n_per_mm: s.rate_n_per_mm + 0.1,
                ..s.clone()
            },
            0.1,
        ),
    ];
    if s.bushing_n > 0.0 {
        variations.push((
            TruthSpecimen {
                bushing_n: s.bushing_n + 1.0,
                ..s.clone()
            },
            1.0,
        ));
        return variations;
    }
    variations.push((
        TruthSpecimen {
            friction_ratio: s.friction_ratio + 0.005,
            ..s.clone()
        },
        0.005,
    ));
    if s.form == Form::Gradual {
        let step = 0.05 * s.presliding_mm;
        variations.push((
            TruthSpecimen {
                presliding_mm: s.presliding_mm + step,
                ..s.clone()
            },
            step,
        ));
        variations.push((
            TruthSpecimen {
                power: s.power + 0.05,
                ..s.clone()
            },
            0.05,
        ));
    }
    variations
}

#[cfg(test)]
mod tests {
    use super::super::catalogue::find;
    use super::super::specimen::tests::{plain, programme};
    use super::*;

    fn unit(code: &'static str) -> (&'static Physics, Hidden) {
        let size = if code == "sensor_saturation" { 0.02 } else { 0.1 };
        (
            find(code).expect("listed"),
            Hidden {
                code,
                size,
                place: 10.0,
                width: 2.0,
                law: None,
            },
        )
    }

    #[test]
    fn twice_the_size_is_twice_the_level_where_the_effect_is_linear() {
        let (specimen, programme) = (plain(), programme());
        let meter = VisibilityMeter::new(&specimen, &programme, 1.0);
        for code in [
            "viscous_damping",
            "inertia",
            "coulomb_friction",
            "relaxation",
            "sensor_drift",
            "ripple",
        ] {
            let one = unit(code).1;
            let two = Hidden {
                size: 2.0 * one.size,
                ..one
            };
            let ratio = meter.level(&two) / meter.level(&one);
            // These effects are linear in the force, so the error is rounding only.
            assert!((ratio - 2.0).abs() < 1e-6, "{code}: {ratio}");
        }
    }

    #[test]
    fn twice_the_noise_is_twice_the_limit() {
        let (specimen, programme) = (plain(), programme());
        let (physics, unit) = unit("viscous_damping");
        let size = |sigma: f64| {
            VisibilityMeter::new(&specimen, &programme, sigma)
                .sized(physics, &unit, 1.0)
                .expect("testable")
                .size
        };
        assert!((size(2.0) / size(1.0) - 2.0).abs() < 3.0 * PRECISION);
    }

    #[test]
    fn a_change_that_a_refit_absorbs_has_no_level() {
        let (specimen, programme) = (plain(), programme());
        let meter = VisibilityMeter::new(&specimen, &programme, 1.0);
        // A higher rate over the whole travel is a parameter of the baseline, so a refit absorbs it.
        let everywhere = Hidden {
            code: "progressive_stiffness",
            size: 1.0,
            place: -0.01,
            width: 0.0,
            law: None,
        };
        let knee = Hidden {
            place: 12.0,
            ..everywhere
        };
        assert!(meter.level(&everywhere) < 1e-3 * meter.level(&knee));
    }

    #[test]
    fn delay_and_damping_have_nearly_the_same_signature() {
        let (specimen, programme) = (plain(), programme());
        let meter = VisibilityMeter::new(&specimen, &programme, 1.0);
        let delay = Hidden {
            code: "channel_delay",
            size: 1.0,
            place: 0.0,
            width: 0.0,
            law: None,
        };
        let damping = Hidden {
            code: "viscous_damping",
            size: 0.1,
            ..delay
        };
        // A delay also shifts the reversal of the friction, so the cosine is below 1 (0.98 in a pilot test).
        assert!(
            meter.cosine(&delay, &damping).abs() > 0.9,
            "{}",
            meter.cosine(&delay, &damping)
        );
    }
}
