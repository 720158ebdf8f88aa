//! Numbers that a loop or a model's fit is judged by. Where the cycles are is in `cycles`.

use crate::units::joules_from_nmm;

/// Root mean square of (measured - model) over the measured range (max - min), as contracts.md defines it.
/// `None` where the lengths differ, there is no sample, or the measured force does not vary.
pub(crate) fn nrmse(measured_n: &[f64], model_n: &[f64]) -> Option<f64> {
    let mut meter = NrmseMeter::default();
    if measured_n.len() != model_n.len() {
        return None;
    }
    for (&measured, &model) in measured_n.iter().zip(model_n) {
        meter.add(measured, model);
    }
    meter.value()
}

/// [`nrmse`] sample by sample, for a twin beside a live run.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct NrmseMeter {
    count: u64,
    sum_of_squares: f64,
    measured: Option<Range>,
}

impl NrmseMeter {
    /// Takes one pair.
    pub(crate) fn add(&mut self, measured_n: f64, model_n: f64) {
        self.count += 1;
        self.sum_of_squares += (measured_n - model_n).powi(2);
        self.measured = Some(Range::including(self.measured, measured_n));
    }

    /// The value so far.
    pub(crate) fn value(&self) -> Option<f64> {
        let span = self.measured?.span();
        (span > 0.0).then(|| (self.sum_of_squares / self.count as f64).sqrt() / span)
    }
}

/// Energy in J that one closed loop dissipates: the integral of F dx by trapezoids, closed from the last sample to the first.
/// Positive where the specimen takes energy up. Zero for fewer than three samples.
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
    /// Takes the next point of the loop, mm and N.
    pub(crate) fn add(&mut self, displacement_mm: f64, force_n: f64) {
        let point = (displacement_mm, force_n);
        match self.first {
            None => self.first = Some(point),
            Some(_) => self.energy_nmm += trapezoid_nmm(self.last, point),
        }
        self.last = point;
    }

    /// Energy of the loop closed from here to its first point.
    pub(crate) fn energy_j(&self) -> f64 {
        let closing = self.first.map_or(0.0, |first| trapezoid_nmm(self.last, first));
        joules_from_nmm(self.energy_nmm + closing)
    }
}

fn trapezoid_nmm(from: (f64, f64), to: (f64, f64)) -> f64 {
    (to.0 - from.0) * (to.1 + from.1) / 2.0
}

/// Lowest and highest of a signal.
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

    /// Of a whole signal; `None` where it is empty.
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

    /// Level midway between peak and valley.
    pub(crate) fn mean(&self) -> f64 {
        (self.peak + self.valley) / 2.0
    }
}

/// Spring rate in N/mm from valley to peak, over the whole of a loop; `None` where nothing moved.
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
            "the other way round gives the energy back"
        );
    }

    #[test]
    fn nrmse_is_rms_over_range() {
        let measured = [0.0, 10.0, 0.0, -10.0];
        let model = [1.0, 9.0, -1.0, -9.0];
        assert_eq!(nrmse(&measured, &model), Some(1.0 / 20.0));
        assert_eq!(nrmse(&measured, &model[..3]), None);
        assert_eq!(nrmse(&[5.0, 5.0], &[5.0, 5.0]), None, "no range to compare with");
        assert_eq!(nrmse(&[], &[]), None);
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
