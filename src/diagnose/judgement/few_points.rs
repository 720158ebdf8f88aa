//! Few points that a set misses by far, while it fits all others.

use crate::diagnose::fitting::{Data, Node};

/// A residual counts on reporting cycles as this many standard deviations at most: one bad point is no change of the specimen.
pub(super) const OUTLIER: f64 = 5.0;
/// Points beyond [`OUTLIER`] are told where they have this share of the sum of squares.
const TOLD_SHARE: f64 = 0.2;

/// Points that are missed by far.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FewPoints {
    count: usize,
    /// Largest difference, N.
    most_n: f64,
    /// Where it is: recording, and time in it in s.
    recording: String,
    at_s: f64,
}

impl FewPoints {
    /// `None` where these points have less than [`TOLD_SHARE`] of the sum of squares.
    pub(super) fn of(data: &Data, node: &Node) -> Option<FewPoints> {
        let (count, worst) = missed_by_far(&node.residuals)?;
        let mut first = 0;
        for track in &data.tracks {
            if worst < first + track.len() {
                return Some(FewPoints {
                    count,
                    most_n: (node.residuals[worst] / data.weight[worst]).abs(),
                    recording: track.name.clone(),
                    at_s: track.time_s[worst - first],
                });
            }
            first += track.len();
        }
        None
    }

    pub(super) fn in_words(&self) -> String {
        let points_fit = if self.count == 1 {
            "point fits"
        } else {
            "points fit"
        };
        format!(
            " {} {points_fit} badly, by up to {:.1} N at {:.2} s of {}: a small reversal that the friction law does not follow, or something \
             that happened once. Look there in the report.",
            self.count, self.most_n, self.at_s, self.recording
        )
    }
}

/// Number of the points beyond [`OUTLIER`] and the worst of them.
fn missed_by_far(residuals: &[f64]) -> Option<(usize, usize)> {
    let beyond = || residuals.iter().enumerate().filter(|(_, r)| r.abs() > OUTLIER);
    let (worst, _) = beyond().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
    let square = |r: &f64| r * r;
    let of_beyond: f64 = beyond().map(|(_, r)| square(r)).sum();
    let of_all: f64 = residuals.iter().map(square).sum();
    (of_beyond > TOLD_SHARE * of_all).then(|| (beyond().count(), worst))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_told_where_they_have_a_fifth_of_the_sum_of_squares() {
        let mut residuals = vec![1.0; 200];
        assert_eq!(missed_by_far(&residuals), None);
        residuals[7] = -6.0;
        assert_eq!(missed_by_far(&residuals), None, "36 of 235");
        (residuals[30], residuals[31]) = (9.0, 4.9);
        assert_eq!(missed_by_far(&residuals), Some((2, 30)));
    }

    #[test]
    fn one_point_is_no_points() {
        let mut few = FewPoints {
            count: 1,
            most_n: 76.84,
            recording: "a.csv".to_owned(),
            at_s: 12.956,
        };
        assert!(
            few.in_words()
                .starts_with(" 1 point fits badly, by up to 76.8 N at 12.96 s of a.csv: ")
        );
        few.count = 3;
        assert!(few.in_words().starts_with(" 3 points fit badly, "));
    }
}
