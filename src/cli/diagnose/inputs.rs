//! The recordings of a diagnosis: CSV files, run files, and runs of the data folder by their id.

use std::path::{Path, PathBuf};

use crate::cli::shared::local;
use crate::cli::{CliError, Output};
use crate::recording::export::{run_file_sha256, sha256_of};
use crate::recording::run_file::{EXTENSION, RunFile};
use crate::recording::{Recording, csv, datapackage, run_recording};
use crate::regular_file::{self, TABLE_MAX_BYTES};
use crate::report::diagnosis::InputFile;

/// End of the names of tables with one row for each cycle, which `leafbench export` writes beside a recording.
const CYCLES_CSV: &str = ".cycles.csv";

/// A recording, and the specimen that its run file or data package names.
pub(crate) struct GivenRecording {
    pub recording: Recording,
    pub file: InputFile,
}

/// A file as the report names it.
pub(super) fn input_file(path: &Path, name: &str, specimen: Option<String>) -> Result<InputFile, CliError> {
    let sha256 = sha256_of(path).map_err(CliError::file(path, "reading"))?;
    Ok(InputFile {
        name: name.to_owned(),
        sha256: Some(sha256),
        specimen,
    })
}

/// The CSV of a recording as the report names it.
pub(super) fn input_csv(path: &Path) -> Result<InputFile, CliError> {
    input_file(path, &path.display().to_string(), specimen_of_package(path))
}

/// What the words on the command line stand for.
enum GivenInput {
    /// A CSV file, of this bench or of another program.
    Csv(PathBuf),
    RunFile(PathBuf),
    /// A run id, a short id or `latest`.
    RunId(String),
}

impl GivenInput {
    fn of(word: &Path) -> GivenInput {
        let text = word.to_string_lossy();
        if word.extension().is_some_and(|e| e == EXTENSION) {
            return GivenInput::RunFile(word.to_owned());
        }
        // An id has neither a folder nor an extension.
        if word.exists() || text.contains(['/', '.']) {
            return GivenInput::Csv(word.to_owned());
        }
        GivenInput::RunId(text.into_owned())
    }
}

/// Reads the recordings that the words stand for. Tables of cycles, which a pattern such as `loops/*.csv` includes, are left out.
/// Recordings of several specimens are refused, unless `mixed` allows them.
pub(super) fn read(
    words: &[PathBuf],
    data_folder: &Path,
    mixed: bool,
    output: &Output,
) -> Result<(Vec<Recording>, Vec<InputFile>), CliError> {
    let is_table = |word: &&PathBuf| word.to_string_lossy().ends_with(CYCLES_CSV);
    let (tables, words): (Vec<&PathBuf>, Vec<&PathBuf>) = words.iter().partition(is_table);
    if words.is_empty() {
        let name = tables
            .first()
            .map_or(String::new(), |path| path.display().to_string());
        return Err(CliError::Input(format!(
            "{name} has one row for each cycle and is no recording: give the recording, which has the same name without .cycles"
        )));
    }
    for table in tables {
        output.note(&format!(
            "{} is left out: it has one row for each cycle",
            table.display()
        ));
    }
    let mut note = |text: String| output.note(&text);
    let given = words
        .into_iter()
        .map(|word| match GivenInput::of(word) {
            GivenInput::Csv(path) => of_csv(&path),
            GivenInput::RunFile(path) => of_run(&path, &path.display().to_string(), &mut note),
            GivenInput::RunId(id) => {
                let run = local::find_finished_run(data_folder, &id)?;
                of_run(&run.path, &run.run_id, &mut note)
            }
        })
        .collect::<Result<Vec<_>, _>>()?;
    if !mixed {
        let named = given.iter();
        one_specimen(named.map(|g| (g.recording.name.as_str(), g.file.specimen.as_deref())))?;
    }
    Ok(given
        .into_iter()
        .map(|given| (given.recording, given.file))
        .unzip())
}

/// Reads a CSV, and the specimen in the data package beside it.
pub(crate) fn of_csv(path: &Path) -> Result<GivenRecording, CliError> {
    Ok(GivenRecording {
        recording: csv::read_file(path)?,
        file: input_csv(path)?,
    })
}

/// The specimen in the data package beside a CSV; none without a package, and none in one of another program.
fn specimen_of_package(csv: &Path) -> Option<String> {
    let text = regular_file::read_text(&datapackage::path_of(csv), TABLE_MAX_BYTES).ok()?;
    let package: serde_json::Value = serde_json::from_str(&text).ok()?;
    let specimen = package.get("leafbench")?.get("specimen")?.as_str()?;
    Some(specimen.to_owned())
}

/// Reads a run file. `note` gets what is not whole about it.
pub(crate) fn of_run(
    path: &Path,
    name: &str,
    note: &mut dyn FnMut(String),
) -> Result<GivenRecording, CliError> {
    let run = RunFile::open(path)?;
    let missing = run.survey().incomplete();
    if !missing.is_empty() {
        note(format!("{name} is not whole: {missing}"));
    }
    if run.outcome().is_none() {
        note(format!(
            "{name} has no end: it is still going, or its daemon was killed; what it has so far is taken"
        ));
    }
    let recording = run_recording::read(name, &run);
    if recording.is_empty() {
        return Err(CliError::Input(format!(
            "{name} has no samples: choose another run from `leafbench runs`"
        )));
    }
    let sha256 = run_file_sha256(&run).map_err(CliError::file(path, "reading"))?;
    Ok(GivenRecording {
        recording,
        file: InputFile {
            name: name.to_owned(),
            sha256,
            specimen: Some(run.header().specimen.clone()),
        },
    })
}

/// Refuses recordings that name different specimens. Those that name none may be of any.
pub(crate) fn one_specimen<'a>(
    given: impl Iterator<Item = (&'a str, Option<&'a str>)>,
) -> Result<(), CliError> {
    let mut named = given.filter_map(|(name, specimen)| Some((name, specimen?)));
    let Some((first, specimen)) = named.next() else {
        return Ok(());
    };
    match named.find(|(_, other)| *other != specimen) {
        None => Ok(()),
        Some((name, other)) => Err(CliError::Input(format!(
            "{first} is of specimen \"{specimen}\" and {name} of specimen \"{other}\": diagnose the recordings of each specimen by \
             themselves, or add --mixed-specimens if it is the same spring"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::Recorder;
    use crate::recording::export::{self, Selection};
    use crate::recording::run_file::RunFileWriter;
    use crate::recording::run_file::test_support::{header, outcome, sample};

    const QUIET: Output = Output { json: true };

    /// A run of a specimen in a data folder, and its CSV; `ends` closes the run.
    fn recorded(folder: &Path, id: &str, specimen: &str, ends: bool) -> PathBuf {
        let mut head = header();
        (head.run_id, head.specimen) = (id.to_owned(), specimen.to_owned());
        // The list of runs is sorted by this.
        head.started_utc = format!("2026-11-23T09:16:21.{id}Z");
        let path = folder.join(format!("{id}.{EXTENSION}"));
        let mut writer = RunFileWriter::create(&path, &head).expect("created");
        (0..1500).for_each(|tick| writer.sample(&sample(tick)));
        if ends {
            writer.end(&outcome(1500));
        }
        drop(writer);
        let run = RunFile::open(&path).expect("opens");
        let csv = folder.join(format!("{id}.csv"));
        export::export(&run, Selection::Whole, &csv).expect("exported");
        export::export_cycles(&run, &folder.join(format!("{id}.cycles.csv"))).expect("exported");
        csv
    }

    fn names(words: &[&Path], folder: &Path, mixed: bool) -> Result<Vec<String>, String> {
        let words: Vec<PathBuf> = words.iter().map(|w| w.to_path_buf()).collect();
        match read(&words, folder, mixed, &QUIET) {
            Ok((recordings, _)) => Ok(recordings.into_iter().map(|r| r.name).collect()),
            Err(error) => Err(error.to_string()),
        }
    }

    #[test]
    fn ids_short_ids_run_files_and_csv_are_read_and_tables_of_cycles_left_out() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path();
        let csv = recorded(folder, "101-abc", "leaf 7", true);
        recorded(folder, "102-def", "leaf 7", true);
        recorded(folder, "103-ghi", "leaf 7", false);
        let run_file = folder.join("101-abc.leafrun");
        let cycles = folder.join("101-abc.cycles.csv");
        let read = names(
            &[&cycles, &csv, Path::new("latest"), Path::new("abc"), &run_file],
            folder,
            false,
        );
        let shown = |path: &Path| path.display().to_string();
        // The newest run that is over; 103 has no end.
        let wanted = [shown(&csv), "102-def".into(), "101-abc".into(), shown(&run_file)];
        assert_eq!(read, Ok(wanted.to_vec()));
        let only_table = names(&[&cycles], folder, false).expect_err("no recording");
        assert!(only_table.contains("has one row for each cycle"), "{only_table}");
        let unknown = names(&[Path::new("zzz")], folder, false).expect_err("no run");
        assert!(unknown.contains("there is no run \"zzz\""), "{unknown}");
    }

    #[test]
    fn recordings_of_two_specimens_are_refused_unless_they_are_allowed() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path();
        let first = recorded(folder, "101-abc", "leaf 7", true);
        let second = recorded(folder, "102-def", "leaf 8", true);
        let foreign = folder.join("foreign.csv");
        std::fs::write(&foreign, "time_s,displacement_mm,force_n\n0,1,2\n1,2,3\n").expect("written");
        // A CSV names its specimen in its data package, a run file in its header.
        for other in [second.as_path(), Path::new("102-def")] {
            let refused = names(&[&first, other], folder, false).expect_err("two specimens");
            assert!(
                refused.contains("specimen \"leaf 7\"") && refused.contains("specimen \"leaf 8\""),
                "{refused}"
            );
            assert_eq!(names(&[&first, other], folder, true).map(|n| n.len()), Ok(2));
        }
        assert_eq!(names(&[&first, &foreign], folder, false).map(|n| n.len()), Ok(2));
    }
}
