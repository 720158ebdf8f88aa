//! Runs of an archive: the list, runs as recordings, and their diagnoses.

use super::{CallFailure, ReadRecording};
use crate::archive::{ArchiveReader, ArchiveStore, ArchivedRun, DiagnosedRun, add_diagnoses};
use crate::fleet::diagnosed::{Depth, diagnose_run};
use crate::model::{self, Model};
use crate::nearest;

/// All runs of an archive, by start and then by id. `place` is a folder or `s3://BUCKET/PREFIX` (docs/archive.md).
pub fn archived_runs(place: &str) -> Result<Vec<ArchivedRun>, CallFailure> {
    let store = ArchiveStore::open_existing(place)?;
    Ok(ArchiveReader::open(&store)?.runs()?)
}

/// Runs of an archive as recordings, in the order of `run_ids`: the same numbers as those of the run files.
pub fn read_archived(place: &str, run_ids: &[String]) -> Result<Vec<ReadRecording>, CallFailure> {
    let store = ArchiveStore::open_existing(place)?;
    let reader = ArchiveReader::open(&store)?;
    let runs = reader.runs()?;
    let recordings = run_ids.iter().map(|run_id| {
        let Some(run) = runs.iter().find(|run| run.run_id == *run_id) else {
            return Err(unknown_run(place, run_id, &runs));
        };
        Ok(ReadRecording {
            recording: reader.recording(run_id)?,
            specimen: Some(run.specimen.clone()),
            notes: Vec::new(),
        })
    });
    recordings.collect()
}

/// Ids of the runs of an archive that have no diagnosis with this model yet, by start and then by id.
pub fn undiagnosed_runs(place: &str, baseline: &str) -> Result<Vec<String>, CallFailure> {
    let store = ArchiveStore::open_existing(place)?;
    Ok(ArchiveReader::open(&store)?.undiagnosed(model_of(baseline)?.name)?)
}

/// Diagnoses one run of an archive, as `leafbench fleet diagnose` does: with one thread, and the same bits wherever it runs. The archive
/// is only read. `estimates_only`: without the search for missing effects in this run alone.
pub fn diagnose_archived(
    place: &str,
    run_id: &str,
    baseline: &str,
    estimates_only: bool,
) -> Result<DiagnosedRun, CallFailure> {
    let model = model_of(baseline)?;
    let store = ArchiveStore::open_existing(place)?;
    let recording = ArchiveReader::open(&store)?.recording(run_id)?;
    let depth = match estimates_only {
        true => Depth::Estimates,
        false => Depth::Diagnosis,
    };
    Ok(diagnose_run(recording, model, depth))
}

/// Puts diagnoses into the archive and returns how many are new. Each is the JSON of what [`diagnose_archived`] returned. Those that are
/// there already stay as they are.
pub fn store_diagnoses(place: &str, diagnosed: &[String]) -> Result<usize, CallFailure> {
    let diagnosed: Result<Vec<DiagnosedRun>, _> =
        diagnosed.iter().map(|text| serde_json::from_str(text)).collect();
    let diagnosed = diagnosed.map_err(|error| {
        CallFailure::input(format!(
            "a diagnosis is no diagnosis of a run ({error}): give what diagnose_archived returned"
        ))
    })?;
    let store = ArchiveStore::open_existing(place)?;
    Ok(add_diagnoses(&store, &diagnosed)?)
}

fn model_of(name: &str) -> Result<&'static Model, CallFailure> {
    model::find(name).map_err(|error| CallFailure::input(error.to_string()))
}

fn unknown_run(place: &str, run_id: &str, runs: &[ArchivedRun]) -> CallFailure {
    let ids: Vec<&str> = runs.iter().map(|run| run.run_id.as_str()).collect();
    CallFailure::input(format!(
        "{place} has no run \"{run_id}\"{}: it has {} runs, list their ids",
        // Run ids are all alike: only a typo is told from another run.
        nearest::question(nearest::typed_wrong(run_id, &ids)),
        runs.len()
    ))
}

#[cfg(test)]
mod tests {
    use super::super::{FailureKind, read_recording};
    use super::*;
    use crate::archive::{AddOptions, add};
    use crate::recording::Recorder;
    use crate::recording::run_file::test_support::{header, outcome, sample};
    use crate::recording::run_file::{EXTENSION, RunFileWriter};

    #[test]
    fn a_run_comes_back_from_an_archive_and_a_wrong_id_is_asked_about() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join(format!("run-a.{EXTENSION}"));
        let mut head = header();
        (head.run_id, head.specimen) = ("run-a".to_owned(), "leaf 7".to_owned());
        let mut writer = RunFileWriter::create(&path, &head).expect("created");
        (0..1500).for_each(|tick| writer.sample(&sample(tick)));
        writer.end(&outcome(1500));
        drop(writer);
        let place = folder.path().join("archive").display().to_string();
        let store = ArchiveStore::open(&place).expect("made");
        add(
            &store,
            std::slice::from_ref(&path),
            AddOptions::default(),
            &|_| {},
        )
        .expect("added");

        let ids: Vec<String> = archived_runs(&place)
            .expect("listed")
            .into_iter()
            .map(|r| r.run_id)
            .collect();
        assert_eq!(ids, ["run-a"]);
        let archived = read_archived(&place, &ids).expect("read");
        let of_file = read_recording(&path).expect("read");
        assert_eq!(archived[0].specimen.as_deref(), Some("leaf 7"));
        assert_eq!(archived[0].recording.force_n, of_file.recording.force_n);
        let asked = read_archived(&place, &["run-b".to_owned()]).expect_err("no such run");
        assert!(asked.text.contains("did you mean run-a?"), "{asked}");
        let missing = archived_runs("no-such-folder").expect_err("not there");
        assert_eq!(missing.kind, FailureKind::File { os_error: 2 });
    }
}
