//! Yardsticks: models of hysteresis that know nothing of springs. They are fitted to the points that the baseline is fitted to and
//! judged on the points that no parameter saw. A model of a spring that predicts these points worse than a yardstick has the wrong
//! form.
//!
//! | part | what it does |
//! |---|---|
//! | `terms` | least squares for forces that are sums of terms, some with a strength that is not negative |
//! | `bouc_wen`, `cubic`, `maxwell_slip` | one yardstick each |
//!
//! A new yardstick is one file and one line in [`YARDSTICKS`].

mod bouc_wen;
mod cubic;
pub(super) mod maxwell_slip;
mod terms;

use super::left_out::nrmse_leftout;
use crate::diagnose::course::Course;
use crate::diagnose::diagnosis::YardstickError;

/// A fitted yardstick: its force in N at every point of a course.
pub(crate) type FittedYardstick = Box<dyn Fn(&Course) -> Vec<f64>>;

/// One entry of [`YARDSTICKS`].
pub(crate) struct Yardstick {
    /// Name in `diagnosis.json` and for people.
    pub name: &'static str,
    /// Fits to the points of the courses that are fitted, with this many threads; `None` where they do not determine it.
    pub fit: fn(&[Course], usize) -> Option<FittedYardstick>,
}

/// All yardsticks, the simplest first.
pub(crate) static YARDSTICKS: &[Yardstick] =
    &[cubic::YARDSTICK, bouc_wen::YARDSTICK, maxwell_slip::YARDSTICK];

/// Errors of all yardsticks on the points that errors are reported on.
pub(in crate::diagnose) fn errors(courses: &[Course], threads: usize) -> Vec<YardstickError> {
    let error = |yardstick: &Yardstick| {
        let fitted = (yardstick.fit)(courses, threads)?;
        Some(YardstickError {
            name: yardstick.name.to_owned(),
            nrmse_leftout: nrmse_leftout(courses, fitted)?,
        })
    };
    YARDSTICKS.iter().filter_map(error).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::course::Split;
    use crate::model::Motion;

    /// Eight cycles of a triangle of falling amplitude, 200 points each; the force is a function of displacement, travel since the
    /// reversal, direction and speed. Of four cycles two are fitted, one is reported on.
    fn course(force_n: impl Fn(f64, f64, f64, f64) -> f64) -> Course {
        let mut course = Course {
            name: "made".to_owned(),
            sample_hz: 100.0,
            time_s: Vec::new(),
            displacement_mm: Vec::new(),
            direction: Vec::new(),
            motion: Vec::new(),
            force_n: Vec::new(),
            split: Vec::new(),
        };
        for i in 0..1600 {
            let (cycle, phase) = (i / 200, i % 200);
            let (direction, back) = if phase < 100 { (1.0, 0) } else { (-1.0, 100) };
            let stroke_mm = 12.0;
            let since_mm = stroke_mm * f64::from(phase - back + 1) / 100.0;
            let x = if direction > 0.0 {
                since_mm
            } else {
                stroke_mm - since_mm
            };
            let speed = direction * f64::from(1 + cycle % 3);
            course.time_s.push(0.01 * f64::from(i));
            course.displacement_mm.push(x);
            course.direction.push(direction);
            course.motion.push(Motion {
                velocity_mm_s: speed,
                acceleration_mm_s2: 0.0,
                reach_mm: [0.0, stroke_mm],
            });
            course.force_n.push(force_n(x, since_mm, direction, speed));
            // The first cycle starts from another state than the others.
            course.split.push((cycle > 0).then_some(match cycle % 4 {
                1 => Split::Select,
                3 => Split::Report,
                _ => Split::Fit,
            }));
        }
        course
    }

    fn error_of(name: &str, course: Course) -> f64 {
        let errors = errors(&[course], 1);
        assert_eq!(errors.len(), YARDSTICKS.len());
        let found = errors.iter().find(|e| e.name.starts_with(name));
        found.expect("listed").nrmse_leftout
    }

    #[test]
    fn a_cubic_spring_with_coulomb_friction_is_met_exactly() {
        let force = |x: f64, _, direction: f64, v: f64| {
            50.0 + 80.0 * x - 3.0 * x * x + 0.2 * x.powi(3) + 25.0 * direction + 2.0 * v
        };
        assert!(error_of("cubic", course(force)) < 1e-9);
    }

    /// With n = 1 and b = 0.5 the state returns along a straight line until it is zero, then along an exponential.
    #[test]
    fn a_bouc_wen_loop_is_met() {
        let length_mm = 0.8;
        let force = move |x: f64, since_mm: f64, direction: f64, v: f64| {
            let lengths = since_mm / length_mm;
            let after = if lengths < 1.0 {
                lengths - 1.0
            } else {
                1.0 - (1.0 - lengths).exp()
            };
            20.0 + 60.0 * x + 40.0 * direction * after + 1.5 * v
        };
        // Heun's steps of 0.15 lengths are exact to a few thousandths of the friction.
        assert!(error_of("Bouc-Wen", course(force)) < 5e-4);
    }

    /// Two sliders by Masing's rule: after a reversal each moves by up to twice its strength over twice its length.
    #[test]
    fn sliders_between_the_lengths_of_the_elements_are_met_closely() {
        let slider = |since_mm: f64, length_mm: f64| (since_mm / length_mm - 1.0).min(1.0);
        let force = move |x: f64, since_mm: f64, direction: f64, _| {
            30.0 + 70.0 * x + direction * (20.0 * slider(since_mm, 0.3) + 30.0 * slider(since_mm, 2.0))
        };
        assert!(error_of("ten Maxwell-slip", course(force)) < 3e-3);
    }

    /// A measured damper was fitted with a rate below zero and a large force of the longest element, which hardly slid: they cancelled on
    /// that stroke, and on a longer one the force was wrong by twice its range (docs/real-data.md).
    #[test]
    fn the_spring_of_the_device_has_no_negative_rate() {
        let force = |x: f64, since_mm: f64, direction: f64, _| {
            300.0 * direction * (1.0 - 2.0 * (-since_mm / 1.5).exp()) - 10.0 * x
        };
        let device = maxwell_slip::device(&[course(force)]).expect("fitted");
        assert_eq!(device.strengths[1], 0.0, "{:?}", device.strengths);
    }

    #[test]
    fn what_is_reported_on_takes_no_part_in_the_fit() {
        let force = |x: f64, since_mm: f64, direction: f64, v: f64| {
            60.0 * x + 40.0 * direction * (1.0 - (-since_mm).exp()) + v
        };
        let sound = course(force);
        let mut changed = sound.clone();
        for i in sound.points(Split::Report).chain(sound.points(Split::Select)) {
            changed.force_n[i] += 1e4;
        }
        for yardstick in YARDSTICKS {
            let fitted =
                |course: &Course| (yardstick.fit)(std::slice::from_ref(course), 1).expect("fitted")(&sound);
            assert_eq!(fitted(&sound), fitted(&changed), "{}", yardstick.name);
        }
    }
}
