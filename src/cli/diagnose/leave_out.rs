//! `leafbench diagnose --leave-out`: recordings that nothing is fitted to and nothing is chosen by. They are only predicted.

use std::path::Path;

use super::proof::{plant_of, text_of};
use crate::cli::CliError;
use crate::config::Bench;
use crate::diagnose::course::Course;
use crate::diagnose::diagnosis::{Diagnosis, ImprovedModel, LeftOutRecording, YardstickError};
use crate::diagnose::{DiagnoseError, DiagnoseOptions, YARDSTICKS, left_out, nrmse_leftout};
use crate::recording::Recording;

/// Takes the named recordings away from `recordings` and returns them.
pub(super) fn take(recordings: &mut Vec<Recording>, names: &[String]) -> Result<Vec<Recording>, CliError> {
    for name in names {
        if !recordings.iter().any(|r| is_called(r, name)) {
            let known: Vec<&str> = recordings.iter().map(|r| r.name.as_str()).collect();
            return Err(CliError::Input(format!(
                "--leave-out {name}: no recording has this name: use one of {}",
                known.join(", ")
            )));
        }
    }
    let (left_out, kept) = std::mem::take(recordings)
        .into_iter()
        .partition(|r| names.iter().any(|name| is_called(r, name)));
    *recordings = kept;
    if recordings.is_empty() {
        return Err(CliError::Input(
            "--leave-out names every recording, and none is left to fit: name fewer".to_owned(),
        ));
    }
    Ok(left_out)
}

/// True for the path of a recording, its file name, or its file name without the extension.
fn is_called(recording: &Recording, name: &str) -> bool {
    let path = Path::new(&recording.name);
    let parts = [path.file_name(), path.file_stem()];
    recording.name == name || parts.into_iter().flatten().any(|part| part == name)
}

/// Conditions recordings that are left out.
pub(super) fn courses(recordings: &[Recording]) -> Result<Vec<Course>, CliError> {
    let conditioned = left_out(recordings, DiagnoseOptions::default().points);
    Ok(conditioned.map_err(DiagnoseError::from)?)
}

/// Errors of baseline, improved model and yardsticks on each recording left out.
pub(super) fn errors(diagnosis: &Diagnosis, bench: &Bench, left_out: &[Course]) -> Vec<LeftOutRecording> {
    let fitted: Vec<_> = YARDSTICKS
        .iter()
        .filter_map(|y| Some((y.name, (y.fit)(&diagnosis.courses, 0)?)))
        .collect();
    let predicted = |model: &ImprovedModel, course: &Course| {
        let mut plant = plant_of(&text_of(bench, model)).ok()?;
        nrmse_leftout(std::slice::from_ref(course), |c| c.simulated_n(plant.as_mut()))
    };
    let of_yardsticks = |course: &Course| {
        let error = |(name, model_n): &(&str, _)| {
            Some(YardstickError {
                name: (*name).to_owned(),
                nrmse_leftout: nrmse_leftout(std::slice::from_ref(course), model_n)?,
            })
        };
        fitted.iter().filter_map(error).collect()
    };
    let errors = left_out.iter().map(|course| LeftOutRecording {
        recording: course.name.clone(),
        baseline: predicted(&diagnosis.refitted, course),
        improved: predicted(&diagnosis.improved, course),
        yardsticks: of_yardsticks(course),
    });
    errors.collect()
}

/// The errors as a table for the terminal.
pub(super) fn table(rows: &[LeftOutRecording]) -> Vec<String> {
    let Some(first) = rows.first() else {
        return Vec::new();
    };
    let percent = |error: Option<f64>| error.map_or("-".to_owned(), |e| format!("{:.2} %", 100.0 * e));
    let name = |recording: &str| {
        let file = Path::new(recording).file_name();
        file.map_or(recording.to_owned(), |f| f.to_string_lossy().into_owned())
    };
    let mut head = vec!["baseline".to_owned(), "improved".to_owned()];
    head.extend(first.yardsticks.iter().map(|y| y.name.clone()));
    let mut lines = vec![format!("  recordings left out, error of {}:", head.join(" | "))];
    for row in rows {
        let mut cells = vec![percent(row.baseline), percent(row.improved)];
        cells.extend(row.yardsticks.iter().map(|y| percent(Some(y.nrmse_leftout))));
        lines.push(format!("    {}: {}", name(&row.recording), cells.join(" | ")));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(names: &[&str]) -> Vec<Recording> {
        let recording = |name: &&str| Recording {
            name: (*name).to_owned(),
            ..Recording::default()
        };
        names.iter().map(recording).collect()
    }

    #[test]
    fn a_recording_is_taken_by_path_file_name_or_stem() {
        for name in ["runs/a.csv", "a.csv", "a"] {
            let mut recordings = named(&["runs/a.csv", "runs/b.csv"]);
            let taken = take(&mut recordings, &[name.to_owned()]).expect("there");
            assert_eq!((taken[0].name.as_str(), recordings.len()), ("runs/a.csv", 1));
        }
    }

    #[test]
    fn a_name_that_no_recording_has_and_names_of_all_are_refused() {
        let refused = |names: &[&str]| {
            let names: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
            let error = take(&mut named(&["a.csv", "b.csv"]), &names).expect_err("refused");
            error.to_string()
        };
        assert!(refused(&["c"]).contains("use one of a.csv, b.csv"));
        assert!(refused(&["a", "b"]).contains("none is left to fit"));
    }
}
