//! The files that a diagnosis leaves in a folder.

use std::io::Write;
use std::path::Path;

use crate::cli::CliError;
use crate::diagnose::diagnosis::Diagnosis;
use crate::recording::atomic_file;
use crate::report::diagnosis::{Context, page};
use crate::report::diagnosis_files::{FIGURE_NAMES, figure_files};

/// The diagnosis for scripts; docs/formats.md describes it.
pub(super) const DIAGNOSIS: &str = "diagnosis.json";
/// The diagnosis as a page.
pub(crate) const REPORT: &str = "report.html";
/// The bench with the improved model.
pub(crate) const IMPROVED: &str = "improved.toml";
/// The rounds of `--run-next`, for scripts.
pub(super) const ROUNDS: &str = "rounds.json";
/// The profile of the next test.
pub(super) const NEXT_TEST: &str = "next-test.toml";

/// Folder of the plots and the numbers behind them.
const FIGURES: &str = "figures";

/// A file by name with its text; without a text the folder must not have it.
pub(super) type NamedFile = (String, Option<String>);

/// All files of a diagnosis of recordings. `improved` is the text of the bench with the improved model, if there is to be one.
pub(super) fn of_diagnosis(
    diagnosis: &Diagnosis,
    improved: Option<String>,
    context: &Context<'_>,
) -> Result<Vec<NamedFile>, CliError> {
    let next_test = diagnosis.next_test.as_ref();
    let figures = figure_files(diagnosis).into_iter();
    let mut files = vec![
        (DIAGNOSIS.to_owned(), Some(json(diagnosis)?)),
        (REPORT.to_owned(), Some(page(diagnosis, context))),
        (IMPROVED.to_owned(), improved),
        (
            NEXT_TEST.to_owned(),
            next_test.map(|next| next.profile_toml.clone()),
        ),
    ];
    files.extend(figures.map(|(name, text)| (format!("{FIGURES}/{name}"), Some(text))));
    Ok(files)
}

pub(super) fn json(value: &impl serde::Serialize) -> Result<String, CliError> {
    serde_json::to_string_pretty(value).map_err(|e| CliError::Internal(e.to_string()))
}

/// Refuses a folder that cannot be written, or in which the diagnosis would replace one of the files that it reads. Nothing is
/// left behind.
pub(super) fn check_folder(folder: &Path, read: &[&Path]) -> Result<(), CliError> {
    let clash = read.iter().find(|path| would_replace(folder, path));
    if let Some(path) = clash {
        return Err(CliError::Input(format!(
            "{} is read by this diagnosis, and --out {} would replace it: name another folder with --out",
            path.display(),
            folder.display()
        )));
    }
    let missing: Vec<&Path> = folder
        .ancestors()
        .take_while(|path| !path.as_os_str().is_empty() && !path.exists())
        .collect();
    let tried = try_to_write(folder);
    for made in missing {
        let _ = std::fs::remove_dir(made);
    }
    tried.map_err(CliError::file(folder, "writing to the folder of --out"))
}

/// Makes the folder if it is missing, and a file in it, which is removed again.
fn try_to_write(folder: &Path) -> std::io::Result<()> {
    atomic_file::create_private_folder(folder)?;
    let probe = folder.join(format!(".leafbench-{}.tmp", std::process::id()));
    let made = atomic_file::create_private(&probe);
    let _ = std::fs::remove_file(&probe);
    made.map(drop)
}

/// True if a diagnosis into the folder writes a file of this path.
fn would_replace(folder: &Path, path: &Path) -> bool {
    let (Ok(folder), Ok(path)) = (folder.canonicalize(), path.canonicalize()) else {
        return false;
    };
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let written = [DIAGNOSIS, REPORT, IMPROVED, NEXT_TEST, ROUNDS].contains(&name.as_ref());
    let of_a_round = name.starts_with("round-") && name.ends_with("-recording.csv");
    let here = path.parent() == Some(&folder) && (written || of_a_round);
    here || (path.parent() == Some(&folder.join(FIGURES)) && is_figure(&name))
}

/// True for the name of a file that a diagnosis writes into the folder of figures.
fn is_figure(name: &str) -> bool {
    let kind = name.ends_with(".svg") || name.ends_with(".csv");
    kind && FIGURE_NAMES.iter().any(|start| name.starts_with(start))
}

/// Removes the figures that an earlier diagnosis left and this one does not have.
fn remove_other_figures(folder: &Path, files: &[NamedFile]) -> Result<(), CliError> {
    let Ok(there) = std::fs::read_dir(folder.join(FIGURES)) else {
        return Ok(());
    };
    for entry in there.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let kept = files.iter().any(|(file, _)| *file == format!("{FIGURES}/{name}"));
        if is_figure(&name) && !kept {
            remove(&entry.path())?;
        }
    }
    Ok(())
}

/// Writes the files into the folder, and removes those that an earlier diagnosis left and this one does not have.
pub(super) fn write(folder: &Path, files: &[NamedFile]) -> Result<(), CliError> {
    atomic_file::create_private_folder(folder).map_err(CliError::file(folder, "creating the folder"))?;
    remove_other_figures(folder, files)?;
    for (name, text) in files {
        let path = folder.join(name);
        if let Some(parent) = path.parent().filter(|_| text.is_some()) {
            atomic_file::create_private_folder(parent)
                .map_err(CliError::file(parent, "creating the folder"))?;
        }
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
    fn a_folder_that_cannot_be_written_or_has_what_is_read_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path();
        let new = folder.join("a/b");
        check_folder(&new, &[]).expect("it can be made");
        assert!(!folder.join("a").exists(), "nothing is left behind");
        let file = folder.join("file");
        std::fs::write(&file, "x").expect("written");
        for impossible in [&file, &file.join("below")] {
            let refused = check_folder(impossible, &[]).expect_err("a file").to_string();
            assert!(
                refused.contains("writing to the folder of --out failed"),
                "{refused}"
            );
        }
        for name in [IMPROVED, "round-1-recording.csv"] {
            let read = folder.join(name);
            std::fs::write(&read, "x").expect("written");
            let refused = check_folder(folder, &[&read])
                .expect_err("it is read")
                .to_string();
            assert!(refused.contains("name another folder with --out"), "{refused}");
            assert_eq!(std::fs::read_to_string(&read).expect("there"), "x");
        }
        let beside = folder.join("loop.csv");
        std::fs::write(&beside, "x").expect("written");
        check_folder(folder, &[&beside]).expect("it is not replaced");
    }

    #[test]
    fn figures_of_an_earlier_diagnosis_are_removed_and_a_recording_among_them_is_not_replaced() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path();
        let files = |n: usize| -> Vec<NamedFile> {
            let figure = |i: usize| (format!("{FIGURES}/loop-{}.csv", i + 1), Some("x".to_owned()));
            (0..n).map(figure).collect()
        };
        write(folder, &files(2)).expect("written");
        let own = folder.join(FIGURES).join("own.csv");
        std::fs::write(&own, "x").expect("written");
        write(folder, &files(1)).expect("written");
        let figures = folder.join(FIGURES);
        assert!(figures.join("loop-1.csv").exists() && !figures.join("loop-2.csv").exists());
        check_folder(folder, &[&own]).expect("it is not replaced");
        check_folder(folder, &[&figures.join("loop-1.csv")]).expect_err("it would be replaced");
    }

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
