//! The files that a diagnosis leaves in a folder.

use std::io::Write;
use std::path::Path;

use crate::cli::CliError;
use crate::config::Bench;
use crate::diagnose::Baseline;
use crate::diagnose::diagnosis::Diagnosis;
use crate::recording::{Recording, atomic_file};
use crate::report::diagnosis::{Context, page};

/// The diagnosis for scripts; docs/formats.md describes it.
pub(super) const DIAGNOSIS: &str = "diagnosis.json";
/// The diagnosis as a page.
pub(crate) const REPORT: &str = "report.html";
/// The bench with the improved model.
pub(crate) const IMPROVED: &str = "improved.toml";
/// The profile of the next test.
pub(super) const NEXT_TEST: &str = "next-test.toml";

/// A file by name with its text; without a text the folder must not have it.
pub(super) type NamedFile = (String, Option<String>);

/// All files of a diagnosis of recordings. `improved` is the text of the bench with the improved model, if there is to be one.
pub(super) fn of_diagnosis(
    diagnosis: &Diagnosis,
    improved: Option<String>,
    bench: &Bench,
    baseline: &Baseline,
    recordings: &[Recording],
) -> Result<Vec<NamedFile>, CliError> {
    let context = Context {
        specimen: &bench.specimen.name,
        baseline: baseline.model.name,
        recordings: recordings.iter().map(|r| r.name.clone()).collect(),
    };
    let next_test = diagnosis.next_test.as_ref();
    Ok(vec![
        (DIAGNOSIS.to_owned(), Some(json(diagnosis)?)),
        (REPORT.to_owned(), Some(page(diagnosis, &context))),
        (IMPROVED.to_owned(), improved),
        (
            NEXT_TEST.to_owned(),
            next_test.map(|next| next.profile_toml.clone()),
        ),
    ])
}

pub(super) fn json(value: &impl serde::Serialize) -> Result<String, CliError> {
    serde_json::to_string_pretty(value).map_err(|e| CliError::Internal(e.to_string()))
}

/// Writes the files into the folder, and removes those that an earlier diagnosis left and this one does not have.
pub(super) fn write(folder: &Path, files: &[NamedFile]) -> Result<(), CliError> {
    atomic_file::create_private_folder(folder).map_err(CliError::file(folder, "creating the folder"))?;
    for (name, text) in files {
        let path = folder.join(name);
        match text {
            Some(text) => atomic_file::write(&path, |file| file.write_all(text.as_bytes()))
                .map_err(CliError::file(&path, "writing"))?,
            None => remove(&path)?,
        }
    }
    Ok(())
}

fn remove(path: &Path) -> Result<(), CliError> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(CliError::file(path, "removing the earlier file")(error))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_a_later_diagnosis_does_not_have_is_removed() {
        let folder = tempfile::tempdir().expect("a folder");
        let next_test = |text: Option<&str>| [(NEXT_TEST.to_owned(), text.map(str::to_owned))];
        let path = folder.path().join(NEXT_TEST);
        write(folder.path(), &next_test(None)).expect("nothing to remove");
        write(folder.path(), &next_test(Some("profile"))).expect("written");
        assert_eq!(std::fs::read_to_string(&path).expect("there"), "profile");
        write(folder.path(), &next_test(None)).expect("removed");
        assert!(!path.exists());
    }
}
