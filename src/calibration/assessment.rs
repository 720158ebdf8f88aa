//! What a calibration says about a sensor: errors of the corrected indication, repeatability, reversibility, zero, resolution, the
//! class that they allow, and the expanded uncertainty.

use serde::Serialize;

use super::class::{AccuracyClass, Criterion, Standard};
use super::fit::PolynomialFit;
use super::points::CalibrationPoint;

/// What is known of the sensor besides its points, N or mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SensorFigures {
    /// Value of one count.
    pub per_count: f64,
    /// Standard deviation of one sample.
    pub noise: f64,
    /// Standard deviation of a mean that was taken as a point.
    pub noise_of_mean: f64,
    /// Expanded uncertainty (k = 2) of the reference instrument, percent of its value.
    pub reference_percent: f64,
}

impl SensorFigures {
    /// Resolution: one count, and half of the range in which the reading fluctuates.
    pub(crate) fn resolution(&self) -> f64 {
        self.per_count + 2.0 * self.noise
    }
}

/// Errors at one level of one series. Relative errors are in percent of the reference.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct LevelErrors {
    pub series: u32,
    /// Value of the reference, N or mm.
    pub reference: f64,
    /// Corrected indication minus reference on the way up, N or mm.
    pub up_error: f64,
    pub up_error_percent: f64,
    /// The same on the way down, against the reference there.
    pub down_error: Option<f64>,
    /// Way down minus way up, both as errors.
    pub reversibility_percent: Option<f64>,
}

/// The worst value of a criterion, and the class that it allows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct CriterionResult {
    pub criterion: Criterion,
    /// Percent of the reference (zero: of the range) where it is worst.
    pub worst_percent: f64,
    /// The same in N or mm.
    pub worst: f64,
    /// Best class whose limit holds at each level; `None` if none does.
    pub class: Option<&'static str>,
}

/// The result of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Assessment {
    pub standard: &'static str,
    /// Best class that all criteria allow; `None` if there is none.
    pub class: Option<&'static str>,
    /// Series that were measured.
    pub series: u32,
    /// Series that the standard asks for.
    pub series_asked: u32,
    /// Least and greatest reference, N or mm: the class holds in between.
    pub range: [f64; 2],
    pub levels: Vec<LevelErrors>,
    pub criteria: Vec<CriterionResult>,
    /// Expanded uncertainty (k = 2), N or mm, at the greatest reference.
    pub expanded_uncertainty: f64,
}

impl Assessment {
    /// The class as certificates and files name it: never more than was measured.
    pub(crate) fn class_text(&self) -> String {
        match self.class {
            None => format!("no class of {}", self.standard),
            Some(class) if self.series >= self.series_asked => format!("{} class {class}", self.standard),
            Some(class) => format!(
                "{} class {class}, of {} series in place of {}",
                self.standard, self.series, self.series_asked
            ),
        }
    }
}

/// Values of one criterion: reference and magnitude, N or mm.
type CriterionValues = (Criterion, Vec<(f64, f64)>);

/// Assesses points with the polynomial that corrects them. `None` without a level above zero.
pub(crate) fn assess(
    points: &[CalibrationPoint],
    fit: &PolynomialFit,
    figures: &SensorFigures,
    standard: &Standard,
) -> Option<Assessment> {
    let greatest = points.iter().map(|p| p.reference.abs()).fold(0.0, f64::max);
    let levels: Vec<LevelErrors> = points
        .iter()
        .filter(|point| !point.is_zero(greatest))
        .map(|point| level(point, zero_of(point.series, points, greatest), fit))
        .collect();
    let size = |level: &LevelErrors| level.reference.abs();
    let least = levels.iter().map(size).fold(f64::INFINITY, f64::min);
    if levels.is_empty() {
        return None;
    }
    let series = levels.iter().map(|level| level.series).max().unwrap_or(1);
    let found = found(points, &levels, fit, figures, greatest, series);
    let criteria: Vec<CriterionResult> = found
        .iter()
        .filter(|(criterion, values)| {
            let limited = standard.classes.iter().any(|c| c.allowed(*criterion).is_some());
            limited && !values.is_empty()
        })
        .map(|found| judged(found, standard))
        .collect();
    let allowed_by_all = |class: &&AccuracyClass| {
        let holds = |(criterion, values): &CriterionValues| holds(class, *criterion, values);
        found.iter().all(holds)
    };
    let class = standard.classes.iter().find(allowed_by_all);
    Some(Assessment {
        standard: standard.name,
        class: class.map(|c| c.name),
        series,
        series_asked: standard.series,
        range: [least, greatest],
        expanded_uncertainty: expanded_uncertainty(&levels, fit, figures, greatest),
        levels,
        criteria,
    })
}

/// Errors of a point; the zero of its series is the zero of the indication, as after a tare.
fn level(point: &CalibrationPoint, zero: Option<&CalibrationPoint>, fit: &PolynomialFit) -> LevelErrors {
    let zero = zero.map_or(0.0, |zero| fit.value(zero.up) - zero.reference);
    let error = |reading: f64, reference: f64| fit.value(reading) - zero - reference;
    let up_error = error(point.up, point.reference);
    let down_error = point.down.map(|down| error(down, point.reference_down()));
    let percent = |value: f64| 100.0 * value / point.reference.abs();
    LevelErrors {
        series: point.series,
        reference: point.reference,
        up_error,
        up_error_percent: percent(up_error),
        down_error,
        reversibility_percent: down_error.map(|down| percent(down - up_error)),
    }
}

fn zero_of(series: u32, points: &[CalibrationPoint], greatest: f64) -> Option<&CalibrationPoint> {
    points.iter().find(|p| p.series == series && p.is_zero(greatest))
}

fn found(
    points: &[CalibrationPoint],
    levels: &[LevelErrors],
    fit: &PolynomialFit,
    figures: &SensorFigures,
    greatest: f64,
    series: u32,
) -> Vec<CriterionValues> {
    let each = |value: &dyn Fn(&LevelErrors) -> Option<f64>| -> Vec<(f64, f64)> {
        let values = levels.iter().filter_map(|l| Some((l.reference, value(l)?.abs())));
        values.collect()
    };
    let mut indication = each(&|l| Some(l.up_error));
    indication.extend(each(&|l| l.down_error));
    let zeros = (1..=series).filter_map(|series| {
        let zero = zero_of(series, points, greatest)?;
        let moved = zero.reference_down() - zero.reference;
        Some((
            greatest,
            (fit.value(zero.down?) - fit.value(zero.up) - moved).abs(),
        ))
    });
    vec![
        (Criterion::Indication, indication),
        (Criterion::Repeatability, repeatability(levels, series)),
        (
            Criterion::Reversibility,
            each(&|l| l.down_error.map(|down| down - l.up_error)),
        ),
        (Criterion::Zero, zeros.collect()),
        (Criterion::Resolution, each(&|_| Some(figures.resolution()))),
    ]
}

/// Range of the errors of all series at each level, by the order of the levels; empty for one series.
fn repeatability(levels: &[LevelErrors], series: u32) -> Vec<(f64, f64)> {
    if series < 2 {
        return Vec::new();
    }
    let of = |series| levels.iter().filter(move |l| l.series == series);
    let ranges = of(1).enumerate().map(|(place, first)| {
        let errors = (1..=series).filter_map(|s| Some(of(s).nth(place)?.up_error));
        let (low, high) = errors.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), e| {
            (low.min(e), high.max(e))
        });
        (first.reference, high - low)
    });
    ranges.collect()
}

fn holds(class: &AccuracyClass, criterion: Criterion, values: &[(f64, f64)]) -> bool {
    class.allowed(criterion).is_none_or(|allowed| {
        let within = |(reference, value): &(f64, f64)| *value <= allowed.at(*reference);
        values.iter().all(within)
    })
}

fn judged((criterion, values): &CriterionValues, standard: &Standard) -> CriterionResult {
    let share = |(reference, value): &(f64, f64)| value / reference.abs();
    let worst = values.iter().max_by(|a, b| share(a).total_cmp(&share(b)));
    let class = standard
        .classes
        .iter()
        .find(|class| holds(class, *criterion, values));
    CriterionResult {
        criterion: *criterion,
        worst_percent: worst.map_or(0.0, |worst| 100.0 * share(worst)),
        worst: worst.map_or(0.0, |(_, value)| *value),
        class: class.map(|c| c.name),
    }
}

/// Reference, scatter of the means, rounding to counts, reversibility and what the polynomial leaves, as independent parts (k = 2).
fn expanded_uncertainty(
    levels: &[LevelErrors],
    fit: &PolynomialFit,
    figures: &SensorFigures,
    greatest: f64,
) -> f64 {
    let half_loop = |l: &LevelErrors| l.down_error.map_or(0.0, |down| 0.5 * (down - l.up_error).abs());
    let half_loop = levels.iter().map(half_loop).fold(0.0, f64::max);
    let parts = [
        0.5 * 0.01 * figures.reference_percent * greatest,
        figures.noise_of_mean,
        figures.per_count / 12f64.sqrt(),
        half_loop / 3f64.sqrt(),
        fit.sigma,
    ];
    2.0 * parts.iter().map(|part| part * part).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::class::standard;
    use crate::calibration::fit::fit;
    use crate::calibration::points::CalibratedChannel;

    const FIGURES: SensorFigures = SensorFigures {
        per_count: 0.1,
        noise: 0.1,
        noise_of_mean: 0.005,
        reference_percent: 0.1,
    };

    /// A perfect sensor, except for what is added to some readings.
    fn points(add_up: [f64; 6], add_down: [f64; 5]) -> Vec<CalibrationPoint> {
        (0..6usize)
            .map(|k| CalibrationPoint {
                series: 1,
                reference: 400.0 * k as f64,
                up: 400.0 * k as f64 + add_up[k],
                down: add_down.get(k).map(|add| 400.0 * k as f64 + add),
                down_reference: None,
            })
            .collect()
    }

    fn assessed(points: &[CalibrationPoint]) -> Assessment {
        // The identity, so that the errors are those that were added.
        let mut line = fit(&[(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)], 1).expect("a line");
        line.sigma = 0.0;
        assess(points, &line, &FIGURES, standard(CalibratedChannel::Force)).expect("levels")
    }

    #[test]
    fn each_criterion_decides_the_class_at_its_limit() {
        for (up, down, criterion, class) in [
            // 0.5 % of 400 N.
            (
                [0.0, 1.99, 0.0, 0.0, 0.0, 0.0],
                [0.0, 1.99, 0.0, 0.0, 0.0],
                Criterion::Indication,
                "0.5",
            ),
            (
                [0.0, 2.01, 0.0, 0.0, 0.0, 0.0],
                [0.0, 2.01, 0.0, 0.0, 0.0],
                Criterion::Indication,
                "1",
            ),
            // 1.5 % of 400 N between the ways, 0.75 % each.
            (
                [0.0, -3.01, 0.0, 0.0, 0.0, 0.0],
                [0.0, 3.01, 0.0, 0.0, 0.0],
                Criterion::Reversibility,
                "2",
            ),
            // 0.1 % of 2000 N.
            ([0.0; 6], [2.01, 0.0, 0.0, 0.0, 0.0], Criterion::Zero, "2"),
        ] {
            let assessment = assessed(&points(up, down));
            let decided = assessment
                .criteria
                .iter()
                .find(|c| c.criterion == criterion)
                .expect("judged");
            assert_eq!(
                (decided.class, assessment.class),
                (Some(class), Some(class)),
                "{assessment:?}"
            );
        }
    }

    #[test]
    fn a_noisy_reading_has_a_coarse_resolution_and_one_series_says_so() {
        let noisy = SensorFigures {
            noise: 5.0,
            ..FIGURES
        };
        let line = fit(&[(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)], 1).expect("a line");
        let iso = standard(CalibratedChannel::Force);
        let assessment = assess(&points([0.0; 6], [0.0; 5]), &line, &noisy, iso).expect("levels");
        // 10.1 N of 400 N.
        assert_eq!(assessment.class, None);
        assert_eq!(assessment.class_text(), "no class of ISO 7500-1");
        let quiet = assessed(&points([0.0; 6], [0.0; 5]));
        assert_eq!(
            quiet.class_text(),
            "ISO 7500-1 class 0.5, of 1 series in place of 3"
        );
        assert!(
            quiet
                .criteria
                .iter()
                .all(|c| c.criterion != Criterion::Repeatability)
        );
        // The reference alone: 0.1 % of 2000 N.
        assert!(
            (quiet.expanded_uncertainty - 2.0).abs() < 0.01,
            "{}",
            quiet.expanded_uncertainty
        );
    }

    #[test]
    fn series_that_differ_are_not_repeatable() {
        let mut three = points([0.0; 6], [0.0; 5]);
        for series in [2, 3] {
            let more = points([0.0, 0.0, 4.0 * f64::from(series), 0.0, 0.0, 0.0], [0.0; 5]);
            three.extend(more.into_iter().map(|p| CalibrationPoint { series, ..p }));
        }
        let assessment = assessed(&three);
        let repeatability = &assessment.criteria[1];
        assert_eq!(repeatability.criterion, Criterion::Repeatability);
        // 12 N of 800 N.
        assert!((repeatability.worst_percent - 1.5).abs() < 1e-9);
        assert_eq!(
            (repeatability.class, assessment.class_text().as_str()),
            (Some("2"), "ISO 7500-1 class 2")
        );
    }

    #[test]
    fn a_zero_that_is_not_quite_zero_is_no_level() {
        let mut points = points([0.0; 6], [0.0; 5]);
        (points[0].reference, points[0].up, points[0].down) = (0.5, 0.5, Some(0.7));
        points[0].down_reference = Some(0.6);
        let assessment = assessed(&points);
        assert_eq!(assessment.levels.len(), 5);
        assert_eq!(assessment.range, [400.0, 2000.0]);
        let zero = assessment
            .criteria
            .iter()
            .find(|c| c.criterion == Criterion::Zero)
            .expect("judged");
        assert!((zero.worst - 0.1).abs() < 1e-9, "{zero:?}");
    }

    #[test]
    fn the_zero_of_a_series_is_taken_off() {
        let shifted = points([7.0; 6], [7.0; 5]);
        assert!(assessed(&shifted).levels.iter().all(|l| l.up_error.abs() < 1e-9));
    }
}
