//! Numbers that describe a loop or the fit of a model: energy, range, secant rate, NRMSE. `cycles` finds the cycles.

use crate::units::joules_from_nmm;

/// NRMSE sample by sample: root mean square of (measured - model) over the measured range (max - min), see docs/formats.md.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct NrmseMeter {
    count: u64,
    sum_of_squares: f64,
    measured: Option<Range>,
}

impl NrmseMeter {
    /// Adds one pair of forces in N.
    pub(crate) fn add(&mut self, measured_n: f64, model_n: f64) {
        self.count += 1;
        self.sum_of_squares += (measured_n - model_n).powi(2);
        self.measured = Some(Range::including(self.measured, measured_n));
    }

    /// NRMSE of all pairs so far; `None` without a pair or where the measured force does not vary.
    pub(crate) fn value(&self) -> Option<f64> {
        let span = self.measured?.span();
        (span > 0.0).then(|| (self.sum_of_squares / self.count as f64).sqrt() / span)
    }
}

/// Energy in J that one loop dissipates: the integral of F dx by trapezoids, closed from the last sample to the first.
/// Positive if the specimen dissipates energy. Zero for fewer than three samples.
pub(crate) fn loop_energy_j(displacement_mm: &[f64], force_n: &[f64]) -> f64 {
    let mut integral = LoopIntegral::default();
    for (&x, &f) in displacement_mm.iter().zip(force_n) {
        integral.add(x, f);
    }
    integral.energy_j()
}

/// [`loop_energy_j`] sample by sample.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LoopIntegral {
    first: Option<(f64, f64)>,
    last: (f64, f64),
    energy_nmm: f64,
}

impl LoopIntegral {
    /// Adds the next point of the loop, mm and N.
    pub(crate) fn add(&mut self, displacement_mm: f64, force_n: f64) {
        let point = (displacement_mm, force_n);
        match self.first {
            None => self.first = Some(point),
            Some(_) => self.energy_nmm += trapezoid_nmm(self.last, point),
        }
        self.last = point;
    }

    /// Energy in J of the loop, closed from the last point to the first.
    pub(crate) fn energy_j(&self) -> f64 {
        let closing = self.first.map_or(0.0, |first| trapezoid_nmm(self.last, first));
        joules_from_nmm(self.energy_nmm + closing)
    }
}

fn trapezoid_nmm(from: (f64, f64), to: (f64, f64)) -> f64 {
    (to.0 - from.0) * (to.1 + from.1) / 2.0
}

/// Lowest and highest value of a signal.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct Range {
    /// Highest value: the peak.
    pub peak: f64,
    /// Lowest value: the valley.
    pub valley: f64,
}

impl Range {
    /// `range` widened to hold `value`.
    pub(crate) fn including(range: Option<Range>, value: f64) -> Range {
        match range {
            None => Range {
                peak: value,
                valley: value,
            },
            Some(range) => Range {
                peak: range.peak.max(value),
                valley: range.valley.min(value),
            },
        }
    }

    /// The range of a whole signal; `None` if it is empty.
    pub(crate) fn of(values: &[f64]) -> Option<Range> {
        values
            .iter()
            .fold(None, |range, &value| Some(Range::including(range, value)))
    }

    /// Peak minus valley.
    pub(crate) fn span(&self) -> f64 {
        self.peak - self.valley
    }

    /// Half of peak minus valley.
    pub(crate) fn amplitude(&self) -> f64 {
        self.span() / 2.0
    }

    /// Half of peak plus valley.
    pub(crate) fn mean(&self) -> f64 {
        (self.peak + self.valley) / 2.0
    }
}

/// Spring rate in N/mm from valley to peak, over a whole loop; `None` where nothing moved.
pub(crate) fn secant_rate_n_per_mm(displacement_mm: Range, force_n: Range) -> Option<f64> {
    (displacement_mm.span() > 0.0).then(|| force_n.span() / displacement_mm.span())
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use super::*;

    /// x = a sin, F = k x + b cos is an ellipse that encloses pi a b.
    #[test]
    fn the_energy_of_an_ellipse_is_its_area() {
        let (a_mm, b_n, k) = (6.0, 120.0, 57.7);
        let phase = |i: u32| TAU * f64::from(i) / 1000.0;
        let x: Vec<f64> = (0..1000).map(|i| a_mm * phase(i).sin()).collect();
        let f: Vec<f64> = (0..1000)
            .map(|i| k * a_mm * phase(i).sin() + b_n * phase(i).cos() + 400.0)
            .collect();
        let exact_j = PI * a_mm * b_n * 1e-3;
        // A polygon of n corners in an ellipse has sin(2 pi/n)/(2 pi/n) of its area: 6.6e-6 less at 1000.
        let energy_j = loop_energy_j(&x, &f);
        assert!(
            (energy_j / exact_j - 1.0).abs() < 7e-6,
            "{energy_j} J, exact {exact_j} J"
        );
        let backwards = loop_energy_j(
            &x.iter().rev().copied().collect::<Vec<_>>(),
            &f.iter().rev().copied().collect::<Vec<_>>(),
        );
        assert!(
            (backwards + energy_j).abs() < 1e-9 * exact_j,
            "the loop run backwards returns the energy"
        );
    }

    #[test]
    fn nrmse_is_rms_over_range() {
        let nrmse = |pairs: &[(f64, f64)]| {
            let mut meter = NrmseMeter::default();
            pairs
                .iter()
                .for_each(|&(measured, model)| meter.add(measured, model));
            meter.value()
        };
        assert_eq!(
            nrmse(&[(0.0, 1.0), (10.0, 9.0), (0.0, -1.0), (-10.0, -9.0)]),
            Some(1.0 / 20.0)
        );
        assert_eq!(
            nrmse(&[(5.0, 5.0), (5.0, 5.0)]),
            None,
            "the measured force does not vary"
        );
        assert_eq!(nrmse(&[]), None);
    }

    #[test]
    fn the_secant_rate_goes_from_valley_to_peak() {
        let x = Range::of(&[-6.0, 0.0, 6.0]).unwrap();
        let f = Range::of(&[-300.0, 20.0, 360.0]).unwrap();
        assert_eq!(secant_rate_n_per_mm(x, f), Some(55.0));
        assert_eq!((f.amplitude(), f.mean()), (330.0, 30.0));
        assert_eq!(secant_rate_n_per_mm(Range::of(&[1.0]).unwrap(), f), None);
    }
}
