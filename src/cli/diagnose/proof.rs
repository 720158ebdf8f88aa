//! The improved model is written, read back and simulated before anything is said about it. A model that predicts the points left
//! out worse than the refitted baseline is not written.

use super::{files, improved_bench};
use crate::config::Bench;
use crate::diagnose::course::Course;
use crate::diagnose::diagnosis::{Diagnosis, ImprovedModel, Proof, is_worse};
use crate::diagnose::{Split, nrmse_leftout};
use crate::model::Plant;
use crate::recording::Recording;

/// Sets the proof of a diagnosis and returns the text of `improved.toml`, if it is to be written. The models are judged on
/// recordings that nothing was fitted to, or where there are none on the reporting points of the diagnosis itself.
pub(super) fn prove(
    diagnosis: &mut Diagnosis,
    bench: &Bench,
    recordings: &[Recording],
    left_out: (&[Recording], &[Course]),
) -> Option<String> {
    let own = left_out.1.is_empty();
    let (recordings, courses) = match own {
        true => (recordings, &diagnosis.courses[..]),
        false => left_out,
    };
    let text = text_of(bench, &diagnosis.improved);
    let improved = simulated_nrmse(&text, courses);
    let baseline = simulated_nrmse(&text_of(bench, &diagnosis.refitted), courses);
    let twin_nrmse = twin_nrmse(&text, recordings, courses);
    let fitted = own.then_some(diagnosis.fit.improved.nrmse_heldout);
    let (written, words) = judged(&improved, &baseline, fitted);
    let proof = Proof {
        left_out: left_out_words(courses, own),
        simulated_nrmse: improved.ok(),
        twin_nrmse,
        baseline_nrmse: baseline.ok(),
        written,
        words,
    };
    diagnosis.proof = Some(proof);
    written.then_some(text)
}

/// Text of a bench file with a model.
pub(super) fn text_of(bench: &Bench, model: &ImprovedModel) -> String {
    improved_bench(bench, model).to_toml()
}

/// The plant of a bench file, built as `leafbench simulate` builds it; or why the file is refused.
pub(super) fn plant_of(text: &str) -> Result<Box<dyn Plant>, String> {
    let bench = Bench::parse(text, files::IMPROVED).map_err(|e| e.to_string())?;
    bench.model.plant().map_err(|e| e.to_string())
}

fn simulated_nrmse(text: &str, courses: &[Course]) -> Result<f64, String> {
    let mut plant = plant_of(text)?;
    nrmse_leftout(courses, |course| course.simulated_n(plant.as_mut()))
        .filter(|error| error.is_finite())
        .ok_or_else(|| "it gives no finite force on the points left out".to_owned())
}

fn twin_nrmse(text: &str, recordings: &[Recording], courses: &[Course]) -> Option<f64> {
    let mut plant = plant_of(text).ok()?;
    let mut recordings = recordings.iter();
    let replayed_n = |course: &Course| match recordings.next() {
        Some(recording) => course.replayed_n(recording, plant.as_mut()),
        None => vec![f64::NAN; course.time_s.len()],
    };
    nrmse_leftout(courses, replayed_n).filter(|error| error.is_finite())
}

/// Whether the improved model is written, and what is to be said. `fitted` is the error that the fit has on the same points.
fn judged(
    improved: &Result<f64, String>,
    baseline: &Result<f64, String>,
    fitted: Option<f64>,
) -> (bool, String) {
    let percent = |share: f64| format!("{:.3} %", 100.0 * share);
    match (improved, baseline, fitted) {
        (Err(why), ..) => (false, format!("{} is not written: {why}", files::IMPROVED)),
        (Ok(after), Ok(before), _) if is_worse(*after, *before) => (
            false,
            format!(
                "{} is not written: simulated on the points left out, it is worse than the refitted baseline, {} against {}",
                files::IMPROVED,
                percent(*after),
                percent(*before)
            ),
        ),
        (Ok(after), _, Some(fitted)) if is_worse(*after, fitted) || is_worse(fitted, *after) => (
            true,
            format!(
                "{} simulated at the sampling rate has an error of {} on the points left out, not {} as in the fit: use the first figure",
                files::IMPROVED,
                percent(*after),
                percent(fitted)
            ),
        ),
        (Ok(after), ..) => (
            true,
            format!(
                "{} was read back and simulated on the points left out: error {}",
                files::IMPROVED,
                percent(*after)
            ),
        ),
    }
}

/// Which points were left out, in words.
fn left_out_words(courses: &[Course], own: bool) -> String {
    let whole: Vec<&str> = courses
        .iter()
        .filter(|c| {
            c.points(Split::Report).next().is_some() && (!own || c.points(Split::Fit).next().is_none())
        })
        .map(|c| c.name.as_str())
        .collect();
    let points: usize = courses.iter().map(|c| c.points(Split::Report).count()).sum();
    if whole.is_empty() {
        let parts = courses
            .iter()
            .filter(|c| c.points(Split::Report).next().is_some());
        format!("parts of {} recordings, {points} points", parts.count())
    } else {
        format!("whole recordings, {points} points: {}", whole.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_that_is_worse_than_the_baseline_is_not_written() {
        for (improved, written) in [(0.010, true), (0.0201, true), (0.021, false)] {
            let (is_written, words) = judged(&Ok(improved), &Ok(0.020), Some(improved));
            assert_eq!(is_written, written, "{words}");
            assert_eq!(words.contains("is not written"), !written, "{words}");
        }
    }

    #[test]
    fn a_file_that_is_refused_is_not_written_and_the_reason_is_said() {
        let (written, words) = judged(&Err("rate_n_per_mm is outside".to_owned()), &Ok(0.02), Some(0.01));
        assert!(!written && words.contains("rate_n_per_mm is outside"), "{words}");
    }

    #[test]
    fn a_simulation_that_differs_from_the_fit_is_said() {
        let words = |fitted: f64| judged(&Ok(0.0100), &Ok(0.02), Some(fitted)).1;
        assert!(words(0.0095).contains("use the first figure"));
        assert!(!words(0.0099).contains("use the first figure"));
    }

    #[test]
    fn the_zero_of_the_force_channel_is_written_and_read_back() {
        let bench = Bench::shipped().expect("built in");
        let mut model = ImprovedModel {
            law: None,
            model: "equivalent".to_owned(),
            parameters: vec![("rate_n_per_mm".to_owned(), 70.0)],
            structure: toml::Table::new(),
            effects: Vec::new(),
            force_zero_n: -12.5,
        };
        let mut plant = plant_of(&text_of(&bench, &model)).expect("a sound file");
        let with_n = plant.step(5.0, 0.1);
        model.force_zero_n = 0.0;
        let mut plant = plant_of(&text_of(&bench, &model)).expect("a sound file");
        assert!((plant.step(5.0, 0.1) - with_n - 12.5).abs() < 1e-9);
    }
}
