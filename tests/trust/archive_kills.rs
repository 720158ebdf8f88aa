//! The archive and `kill -9`: at any instant, and at each call of the system that can change a file. `LEAFBENCH_KILLS` sets how many
//! kills at random instants there are.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::kills::kills;
use crate::archive::{ArchiveError, ArchiveStore, Verified, verify};
use crate::recording::Recorder;
use crate::recording::run_file::RunFileWriter;
use crate::recording::run_file::test_support::{header, outcome, sample};
use crate::tests::support::{Process, program};

/// Runs of each archive, and samples of a run.
const RUNS: usize = 12;
const SAMPLES: u64 = 1500;

/// Closed runs of three specimens.
fn make_runs(folder: &Path) -> Vec<PathBuf> {
    let make = |number: usize| {
        let path = folder.join(format!("run-{number}.leafrun"));
        let mut head = header();
        head.run_id = format!("run-{number}");
        head.specimen = format!("pack-{}", number % 3);
        let mut writer = RunFileWriter::create(&path, &head).expect("made");
        (0..SAMPLES).for_each(|tick| writer.sample(&sample(tick)));
        writer.end(&outcome(SAMPLES));
        path
    };
    (0..RUNS).map(make).collect()
}

fn archive(to: &Path, runs: &[PathBuf]) -> Command {
    let mut command = Command::new(program());
    command.arg("archive").arg(to).args(runs);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command
}

/// What is in the archive after a kill; `None` if there is none yet.
fn look(place: &Path, runs: &[PathBuf]) -> Option<Verified> {
    let store = ArchiveStore::open(place.to_str().expect("UTF-8")).expect("a folder");
    match verify(&store, runs, &|_| {}) {
        Err(ArchiveError::NoArchive { .. }) => None,
        found => Some(found.expect("an archive that can be read")),
    }
}

/// Nothing of the archive is damaged, and each run is in it whole or not at all, also for a program that lists the files.
fn hold(place: &Path, runs: &[PathBuf], when: &str) {
    let Some(found) = look(place, runs) else { return };
    assert_eq!(found.problems, Vec::<String>::new(), "{when}");
    assert_eq!(found.runs + found.missing_runs.len(), RUNS, "{when}");
    assert_eq!(found.samples, found.runs as u64 * SAMPLES, "{when}");
    let with_samples: BTreeSet<String> = parquet_files(&place.join("samples"))
        .iter()
        .map(|path| path.file_stem().expect("a name").to_string_lossy().into_owned())
        .collect();
    for path in parquet_files(&place.join("runs")) {
        for run in run_ids(&path) {
            assert!(
                with_samples.contains(&run),
                "{when}: {run} is in the table of runs and has no samples"
            );
        }
    }
}

fn parquet_files(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Vec::new();
    };
    let paths = entries.map(|entry| entry.expect("an entry").path());
    paths
        .flat_map(|path| match path.is_dir() {
            true => parquet_files(&path),
            false => vec![path],
        })
        .filter(|path| path.extension().is_some_and(|extension| extension == "parquet"))
        .collect()
}

/// The column `run_id` of a Parquet file.
fn run_ids(path: &Path) -> Vec<String> {
    use arrow_array::cast::AsArray;
    let file = std::fs::File::open(path).expect("opened");
    let reader =
        parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder::try_new(file).expect("a Parquet file");
    let batches = reader
        .build()
        .expect("a reader")
        .map(|batch| batch.expect("rows"));
    batches
        .flat_map(|batch| {
            let ids = batch
                .column_by_name("run_id")
                .expect("a column")
                .as_string::<i32>();
            ids.iter()
                .map(|id| id.expect("a text").to_owned())
                .collect::<Vec<_>>()
        })
        .collect()
}

/// The command to its end: nothing is lost, nothing twice, nothing left over.
fn finish(place: &Path, runs: &[PathBuf], when: &str) {
    assert!(archive(place, runs).status().expect("starts").success(), "{when}");
    let found = look(place, runs).expect("an archive");
    assert!(found.is_clean() && found.runs == RUNS, "{when}: {found:?}");
    let rows: Vec<String> = parquet_files(&place.join("runs"))
        .iter()
        .flat_map(|path| run_ids(path))
        .collect();
    assert_eq!(rows.len(), RUNS, "{when}: {rows:?}");
}

#[test]
fn an_archive_that_is_killed_at_any_instant_has_each_run_whole_or_not_at_all() {
    let folder = tempfile::tempdir().expect("a folder");
    let (sources, place) = (folder.path().join("runs"), folder.path().join("archive"));
    std::fs::create_dir(&sources).expect("made");
    let runs = make_runs(&sources);
    let begun = Instant::now();
    finish(&place, &runs, "without a kill");
    let longest = begun.elapsed().as_micros() as u64 * 5 / 4;
    std::fs::remove_dir_all(&place).expect("removed");
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    let (mut complete, mut half, mut without) = (0, 0, 0);
    for number in 0..kills() {
        let when = format!("kill {number}");
        if !place.exists() && number % 2 == 0 {
            // Half of the runs are in an archive already when the command that is killed begins.
            assert!(
                archive(&place, &runs[..RUNS / 2])
                    .status()
                    .expect("starts")
                    .success()
            );
        }
        let mut child = Process(archive(&place, &runs).spawn().expect("starts"));
        std::thread::sleep(Duration::from_micros(rng.random_range(0..longest)));
        // It may be done.
        let _ = child.0.kill();
        child.0.wait().expect("it ends");
        hold(&place, &runs, &when);
        match look(&place, &runs) {
            Some(found) if found.runs == RUNS => {
                finish(&place, &runs, &when);
                std::fs::remove_dir_all(&place).expect("removed");
                complete += 1;
            }
            Some(_) => half += 1,
            None => without += 1,
        }
    }
    finish(&place, &runs, "after the last kill");
    eprintln!(
        "{} kills: {complete} archives were complete, {half} had no run or half of them, {without} times there was none yet",
        kills()
    );
}

/// Calls of the system that can change a folder.
const CALLS: [&str; 6] = ["write", "fsync", "rename", "link", "unlink", "mkdir"];

/// The command, killed when one of its threads makes its `number`-th call of this kind. True if it came to its end before.
fn killed_at(place: &Path, runs: &[PathBuf], call: &str, number: usize) -> bool {
    let plain = archive(place, runs);
    let mut command = Command::new("strace");
    command.args(["-f", "-qq", "-o", "/dev/null", "-e", &format!("trace={call}")]);
    command.args(["-e", &format!("inject={call}:signal=SIGKILL:when={number}")]);
    command.arg(plain.get_program()).args(plain.get_args());
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command.status().expect("strace starts").success()
}

/// The same at the calls of the system, where strace is installed.
#[test]
fn an_archive_that_is_killed_at_a_call_has_each_run_whole_or_not_at_all() {
    if !Command::new("strace")
        .args(["-qq", "-o", "/dev/null", "true"])
        .status()
        .is_ok_and(|status| status.success())
    {
        eprintln!(
            "SKIPPED the archive at each call: strace is not here (Debian package strace), or may not trace"
        );
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let (sources, place) = (folder.path().join("runs"), folder.path().join("archive"));
    std::fs::create_dir(&sources).expect("made");
    let runs = make_runs(&sources);
    let (mut killed, mut seen) = (0, BTreeSet::new());
    for call in CALLS {
        for number in 1.. {
            if killed_at(&place, &runs, call, number) {
                std::fs::remove_dir_all(&place).expect("removed");
                break;
            }
            let when = format!("killed at {call} {number}");
            hold(&place, &runs, &when);
            seen.insert(look(&place, &runs).map(|found| found.runs));
            finish(&place, &runs, &when);
            std::fs::remove_dir_all(&place).expect("removed");
            killed += 1;
        }
    }
    eprintln!("killed at {killed} calls; runs in the archive after it: {seen:?}");
    assert!(killed > 20 && seen.len() > 1, "{killed} calls, {seen:?}");
}
