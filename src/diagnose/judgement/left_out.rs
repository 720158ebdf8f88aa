//! Errors on points that no parameter was fitted to, on the courses of the recordings.

use crate::diagnose::conditioning::{Track, range, tracks};
use crate::diagnose::course::{Course, Split};
use crate::diagnose::error::ConditionError;
use crate::diagnose::fitting::Data;
use crate::recording::Recording;

/// All tracks as courses.
pub(in crate::diagnose) fn courses(data: &Data) -> Vec<Course> {
    let mut from = 0;
    let course = |(track, &length): (&Track, &usize)| {
        let points = from..from + length;
        from += length;
        Course {
            name: track.name.clone(),
            sample_hz: track.sample_hz,
            time_s: track.time_s.clone(),
            displacement_mm: track.displacement_mm.clone(),
            direction: track.direction.clone(),
            motion: track.motion.clone(),
            force_n: data.force_n[points.clone()].to_vec(),
            split: points
                .map(|i| (data.weight[i] > 0.0).then_some(data.split[i]))
                .collect(),
        }
    };
    data.tracks.iter().zip(&data.lengths).map(course).collect()
}

/// Courses of recordings that nothing is fitted to: each into about `budget` points at most, and every point that is not masked
/// is reported on.
pub(crate) fn left_out(recordings: &[Recording], budget: usize) -> Result<Vec<Course>, ConditionError> {
    let mut tracks = tracks(recordings, budget)?;
    for track in &mut tracks {
        track.split.fill(Split::Report);
    }
    Ok(courses(&Data::new(tracks)))
}

/// NRMSE on the points that errors are reported on, over all courses together; `None` where there is no such point. `model_n`
/// gives the force at every point of a course.
pub(crate) fn nrmse_leftout(courses: &[Course], mut model_n: impl FnMut(&Course) -> Vec<f64>) -> Option<f64> {
    let measured: Vec<f64> = courses.iter().flat_map(|c| c.force_n.iter().copied()).collect();
    let (mut sum, mut count) = (0.0, 0.0);
    for course in courses {
        let model_n = model_n(course);
        for i in course.points(Split::Report) {
            sum += (course.force_n[i] - model_n[i]).powi(2);
            count += 1.0;
        }
    }
    (count > 0.0).then(|| (sum / count).sqrt() / range(&measured))
}
