//! A motion given by samples, such as the commands of a bench.
//!
//! Between samples it is a monotonic cubic (F. N. Fritsch and R. E. Carlson 1980, with the harmonic mean of J. Butland), so
//! that only samples can be turning points.

/// A smooth displacement over time, constant before the first sample and after the last.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Path {
    time_s: Vec<f64>,
    displacement_mm: Vec<f64>,
    /// Speed at each sample, mm/s.
    speed_mm_s: Vec<f64>,
}

impl Path {
    /// A path through `points`: time in s, strictly rising, and displacement in mm.
    pub(crate) fn new(points: &[[f64; 2]]) -> Path {
        let (time_s, displacement_mm): (Vec<f64>, Vec<f64>) = points.iter().map(|p| (p[0], p[1])).unzip();
        let chord = |k: usize| {
            let [a, b] = [points[k], points[k + 1]];
            (b[1] - a[1]) / (b[0] - a[0])
        };
        let last = points.len().saturating_sub(1);
        let speed_mm_s = (0..points.len())
            .map(|k| {
                if k == 0 || k == last {
                    return 0.0;
                }
                let (before, after) = (chord(k - 1), chord(k));
                if before * after > 0.0 {
                    2.0 * before * after / (before + after)
                } else {
                    0.0
                }
            })
            .collect();
        Path {
            time_s,
            displacement_mm,
            speed_mm_s,
        }
    }

    /// Time of the last sample, s.
    pub(crate) fn duration_s(&self) -> f64 {
        self.time_s.last().copied().unwrap_or(0.0)
    }

    /// Number of turning points.
    pub(crate) fn turns(&self) -> usize {
        let mut directions: Vec<bool> = self
            .displacement_mm
            .windows(2)
            .filter(|w| w[1] != w[0])
            .map(|w| w[1] > w[0])
            .collect();
        directions.dedup();
        directions.len().saturating_sub(1)
    }

    /// Displacement in mm at a time in s.
    pub(crate) fn at_mm(&self, time_s: f64) -> f64 {
        let after = self.time_s.partition_point(|t| *t <= time_s);
        let (Some(k), true) = (after.checked_sub(1), after < self.time_s.len()) else {
            let end = if after == 0 {
                self.displacement_mm.first()
            } else {
                self.displacement_mm.last()
            };
            return end.copied().unwrap_or(0.0);
        };
        let step_s = self.time_s[k + 1] - self.time_s[k];
        let u = (time_s - self.time_s[k]) / step_s;
        let v = 1.0 - u;
        let [from, to] = [self.displacement_mm[k], self.displacement_mm[k + 1]];
        let [out, into] = [self.speed_mm_s[k], self.speed_mm_s[k + 1]].map(|s| s * step_s);
        v * v * (from * (1.0 + 2.0 * u) + out * u) + u * u * (to * (1.0 + 2.0 * v) - into * v)
    }
}

#[cfg(test)]
mod tests {
    use super::Path;

    #[test]
    fn a_path_passes_its_samples_and_has_no_other_turning_points() {
        let points = [[0.0, 0.0], [1.0, 2.0], [2.0, 2.0], [3.0, 5.0], [4.0, 1.0]];
        let path = Path::new(&points);
        assert!(points.iter().all(|p| path.at_mm(p[0]) == p[1]));
        assert_eq!((path.duration_s(), path.turns()), (4.0, 1));
        assert_eq!(
            (path.at_mm(-1.0), path.at_mm(9.0), path.at_mm(1.5)),
            (0.0, 1.0, 2.0)
        );
        let fine: Vec<f64> = (0..=400).map(|k| path.at_mm(0.01 * f64::from(k))).collect();
        assert!(fine[..=300].windows(2).all(|w| w[1] > w[0] - 1e-12));
        assert!(fine[300..].windows(2).all(|w| w[1] < w[0] + 1e-12));
    }

    #[test]
    fn a_finely_sampled_sine_is_that_sine() {
        let wave = |t: f64| 5.0 - 5.0 * (2.0 * t).cos();
        let points: Vec<[f64; 2]> = (0..=3000)
            .map(|k| 1e-3 * f64::from(k))
            .map(|t| [t, wave(t)])
            .collect();
        let path = Path::new(&points);
        // The error is of second order in the step: (2e-3)^2 times 5 mm.
        for k in 0..2999 {
            let t = 1e-3 * (f64::from(k) + 0.37);
            assert!((path.at_mm(t) - wave(t)).abs() < 2e-5, "{t}");
        }
    }
}
