//! Gains in log-likelihood of effective samples, and what an effect costs in the same unit.

use super::data::Data;
use crate::identify::confidence::correlation_time;

/// Penalty per effect in log-likelihood. For one parameter it is a likelihood ratio of 16, which chance exceeds once in 16 000.
pub(in crate::diagnose) const PENALTY: f64 = 8.0;
/// Penalty of each further parameter of an effect, so that chance exceeds it as rarely as that of one parameter.
pub(in crate::diagnose) const PARAMETER_PENALTY: f64 = 1.3;

/// Turns a fall of the sum of squares into log-likelihood of effective samples: neighbouring residuals are correlated, and they
/// are larger than the white noise. Both make a gain smaller than independent samples of pure noise would.
#[derive(Debug, Clone, Copy)]
pub(in crate::diagnose) struct LikelihoodScale {
    /// Variance of the residuals of the best set, in variances of the white noise; at least 1.
    pub variance: f64,
    /// Correlation time in samples.
    pub correlation_time: f64,
}

impl LikelihoodScale {
    pub(in crate::diagnose) fn of(data: &Data, residuals: &[f64]) -> LikelihoodScale {
        let counted = data.weight.iter().filter(|w| **w > 0.0).count().max(1);
        let variance = residuals.iter().map(|r| r * r).sum::<f64>() / counted as f64;
        LikelihoodScale {
            variance: variance.max(1.0),
            correlation_time: correlation_time(residuals, &data.lengths),
        }
    }

    /// Gain in log-likelihood of effective samples where the sum of squares falls by `fall`.
    pub(in crate::diagnose) fn gain(&self, fall: f64) -> f64 {
        0.5 * fall / (self.variance * self.correlation_time)
    }
}
