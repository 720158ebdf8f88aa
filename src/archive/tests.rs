use std::path::{Path as FilePath, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use arrow_array::cast::AsArray;
use arrow_array::types::{Decimal128Type, Float64Type, Int64Type};
use futures_util::StreamExt;
use futures_util::stream::BoxStream;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{
    CopyOptions, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    PutMultipartOptions, PutOptions, PutPayload, PutResult,
};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

use super::lock::WriterLock;
use super::manifest::{MANIFEST, Manifest};
use super::*;
use crate::recording::run_file::test_support::{damage_samples, header, outcome, sample};
use crate::recording::run_file::{RunFile, RunFileWriter};
use crate::recording::run_recording;
use crate::recording::{Recorder, Recording};

/// A closed run of so many samples.
fn run(folder: &FilePath, run_id: &str, specimen: &str, ticks: u64) -> PathBuf {
    let path = folder.join(format!("{run_id}.leafrun"));
    let mut head = header();
    head.run_id = run_id.to_owned();
    head.specimen = specimen.to_owned();
    head.bench_toml = "name = \"bench-1\"\n".to_owned();
    let mut writer = RunFileWriter::create(&path, &head).unwrap();
    for tick in 0..ticks {
        writer.sample(&sample(tick));
    }
    writer.end(&outcome(ticks));
    path
}

fn few_runs(folder: &FilePath) -> Vec<PathBuf> {
    let runs = [("run-a", "pack-1"), ("run-b", "pack-1"), ("run-c", "pack 2/x")];
    runs.iter()
        .map(|(id, specimen)| run(folder, id, specimen, 2500))
        .collect()
}

fn in_memory() -> ArchiveStore {
    ArchiveStore::over("memory", Arc::new(InMemory::new()), Path::from("lab/archive")).unwrap()
}

fn add_all(store: &ArchiveStore, files: &[PathBuf]) -> Added {
    add(store, files, AddOptions::default(), &|_| {}).unwrap()
}

fn check(store: &ArchiveStore, files: &[PathBuf]) -> Verified {
    verify(store, files, &|_| {}).unwrap()
}

/// Every object with its content, but for the lock.
fn contents(store: &ArchiveStore) -> Vec<(String, Vec<u8>)> {
    let objects = store.list().unwrap().into_iter();
    objects
        .map(|o| (o.path.clone(), store.get(&o.path).unwrap().unwrap()))
        .collect()
}

#[test]
fn the_samples_of_an_archive_are_the_numbers_of_the_csv() {
    let folder = tempfile::tempdir().unwrap();
    let files = few_runs(folder.path());
    let store = in_memory();
    let added = add_all(&store, &files);
    assert_eq!((added.added, added.present, added.samples), (3, 0, 7500));
    let content = store
        .get("samples/specimen=pack-1/month=2026-11/run-b.parquet")
        .unwrap()
        .unwrap();
    let reader = ParquetRecordBatchReaderBuilder::try_new(bytes_of(content)).unwrap();
    let batches: Vec<_> = reader.build().unwrap().map(Result::unwrap).collect();
    let read = run_recording::read("run-b", &RunFile::open(&files[1]).unwrap());
    let decimals = |column: &str, unit: f64| -> Vec<f64> {
        let arrays = batches.iter().map(|b| b.column_by_name(column).unwrap());
        arrays
            .flat_map(|a| a.as_primitive::<Decimal128Type>().values().to_vec())
            .map(|digits| digits as f64 / unit)
            .collect()
    };
    assert_eq!(decimals("time_s", 1e6), read.time_s);
    assert_eq!(decimals("displacement_mm", 1e5), read.displacement_mm);
    assert_eq!(decimals("force_n", 1e3), read.force_n);
    let empty = |column: &str| {
        batches
            .iter()
            .map(|b| b.column_by_name(column).unwrap().null_count())
            .sum::<usize>()
    };
    assert_eq!(empty("twin_force_n"), 834, "the twin was late in every third row");
    assert_eq!(empty("command_n"), 2500);
}

fn bytes_of(content: Vec<u8>) -> bytes::Bytes {
    content.into()
}

#[test]
fn a_run_of_an_archive_is_the_recording_of_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let files = few_runs(folder.path());
    let store = in_memory();
    add_all(&store, &files);
    let reader = ArchiveReader::open(&store).unwrap();
    let runs = reader.runs().unwrap();
    let ids: Vec<_> = runs
        .iter()
        .map(|run| (run.run_id.as_str(), run.specimen.as_str()))
        .collect();
    assert_eq!(
        ids,
        [("run-a", "pack-1"), ("run-b", "pack-1"), ("run-c", "pack 2/x")]
    );
    assert_eq!(
        (runs[0].bench.as_str(), runs[0].started_utc.get(..7)),
        ("bench-1", Some("2026-11"))
    );
    let of_archive = reader.recording("run-b").unwrap();
    let of_file = run_recording::read("run-b", &RunFile::open(&files[1]).unwrap());
    let bits = |recording: &Recording| {
        let command = recording.command.as_deref().unwrap().iter();
        command.map(|c| c.to_bits()).collect::<Vec<_>>()
    };
    assert_eq!(bits(&of_archive), bits(&of_file));
    let without = |recording: Recording| Recording {
        command: None,
        ..recording
    };
    assert_eq!(without(of_archive), without(of_file));
    assert!(matches!(
        reader.recording("run-x"),
        Err(ArchiveError::NoRun { .. })
    ));
    store
        .put(
            "samples/specimen=pack-1/month=2026-11/run-b.parquet",
            b"other".to_vec(),
        )
        .unwrap();
    assert!(matches!(
        reader.recording("run-b"),
        Err(ArchiveError::Changed { .. })
    ));
}

/// A diagnosis that estimated a parameter and named an effect.
fn diagnosed(run_id: &str) -> DiagnosedRun {
    DiagnosedRun {
        run_id: run_id.to_owned(),
        model: "equivalent".to_owned(),
        program_version: "1".to_owned(),
        verdict: "explained".to_owned(),
        message: String::new(),
        rows: vec![
            DiagnosisRow {
                kind: "parameter".to_owned(),
                quantity: "rate_n_per_mm".to_owned(),
                unit: "N/mm".to_owned(),
                scale: "relative".to_owned(),
                estimate: Some(72.0),
                std_error: Some(0.1),
                form_error: Some(0.05),
                testable: true,
                named: None,
            },
            DiagnosisRow {
                kind: "effect".to_owned(),
                quantity: "backlash".to_owned(),
                named: Some(Estimated {
                    confidence: 0.9,
                    parameter: "gap_mm".to_owned(),
                    value: 0.2,
                    ci95: Some([0.1, 0.3]),
                }),
                ..DiagnosisRow::default()
            },
        ],
    }
}

#[test]
fn diagnoses_are_written_once_and_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let files = few_runs(folder.path());
    let store = in_memory();
    add_all(&store, &files);
    let failed = DiagnosedRun {
        verdict: "failed".to_owned(),
        message: "too short".to_owned(),
        rows: Vec::new(),
        ..diagnosed("run-c")
    };
    let open = || ArchiveReader::open(&store).unwrap();
    assert_eq!(add_diagnoses(&store, &[diagnosed("run-b")]).unwrap(), 1);
    assert_eq!(open().undiagnosed("equivalent").unwrap(), ["run-a", "run-c"]);
    assert_eq!(open().undiagnosed("leaf_pack").unwrap().len(), 3);
    let first = contents(&store);
    assert_eq!(add_diagnoses(&store, &[diagnosed("run-b")]).unwrap(), 0);
    assert_eq!(contents(&store), first);
    assert_eq!(
        add_diagnoses(&store, &[failed.clone(), diagnosed("run-b")]).unwrap(),
        1
    );
    assert_eq!(
        open().diagnoses("equivalent").unwrap(),
        [diagnosed("run-b"), failed]
    );
    assert!(matches!(
        add_diagnoses(&store, &[diagnosed("run-x")]),
        Err(ArchiveError::NoRun { .. })
    ));
    // More runs and a check do not disturb them.
    assert_eq!(add_all(&store, &files).leftovers_removed, 0);
    assert!(check(&store, &files).is_clean());
}

#[test]
fn runs_and_cycles_have_a_row_each() {
    let folder = tempfile::tempdir().unwrap();
    let store = in_memory();
    add_all(&store, &few_runs(folder.path()));
    let table = |name: &str| {
        let objects = store.list().unwrap();
        let path = objects
            .iter()
            .find(|o| o.path.starts_with(name) && o.path.contains("pack-1"));
        let content = store.get(&path.unwrap().path).unwrap().unwrap();
        let reader = ParquetRecordBatchReaderBuilder::try_new(bytes_of(content)).unwrap();
        reader.build().unwrap().next().unwrap().unwrap()
    };
    let runs = table("runs");
    assert_eq!(runs.num_rows(), 2);
    let text = |column: &str| {
        runs.column_by_name(column)
            .unwrap()
            .as_string::<i32>()
            .value(1)
            .to_owned()
    };
    assert_eq!(
        (
            text("run_id"),
            text("bench"),
            text("specimen_name"),
            text("ending")
        ),
        (
            "run-b".into(),
            "bench-1".into(),
            "pack-1".into(),
            "completed".into()
        )
    );
    let cycles = table("cycles");
    assert_eq!(cycles.num_rows(), 6, "three cycles of each run");
    let numbers = cycles
        .column_by_name("cycle")
        .unwrap()
        .as_primitive::<Int64Type>();
    assert_eq!(numbers.values().to_vec(), [1, 2, 3, 1, 2, 3]);
    let peaks = cycles
        .column_by_name("displacement_peak_mm")
        .unwrap()
        .as_primitive::<Float64Type>();
    assert!((peaks.value(0) - 5.98766).abs() < 1e-9, "{}", peaks.value(0));
}

#[test]
fn the_same_command_twice_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let files = few_runs(folder.path());
    let store = in_memory();
    add_all(&store, &files[..2]);
    add_all(&store, &files);
    let first = contents(&store);
    let added = add_all(&store, &files);
    assert_eq!((added.added, added.present, added.leftovers_removed), (0, 3, 0));
    assert_eq!(contents(&store), first);
    let verified = check(&store, &files);
    assert!(verified.is_clean(), "{verified:?}");
    assert_eq!((verified.runs, verified.samples), (3, 7500));
}

#[test]
fn every_flipped_byte_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let store = in_memory();
    add_all(&store, &few_runs(folder.path())[2..]);
    let mut flipped = 0;
    for (path, content) in contents(&store) {
        // Each byte of the small objects, and bytes everywhere in the large ones.
        let step = content.len().div_ceil(400);
        for at in (0..content.len()).step_by(step) {
            let mut other = content.clone();
            other[at] ^= 1 << (at % 8);
            store.put(&path, other).unwrap();
            match verify(&store, &[], &|_| {}) {
                Ok(verified) => assert!(!verified.problems.is_empty(), "byte {at} of {path}"),
                Err(error) => assert!(path == MANIFEST, "{path}: {error}"),
            }
            flipped += 1;
        }
        store.put(&path, content).unwrap();
    }
    assert!(flipped > 800, "{flipped}");
    assert!(check(&store, &[]).is_clean());
}

#[test]
fn what_is_missing_is_named_and_what_was_left_over_is_removed() {
    let folder = tempfile::tempdir().unwrap();
    let files = few_runs(folder.path());
    let store = in_memory();
    add_all(&store, &files[..2]);
    assert_eq!(check(&store, &files).missing_runs, ["run-c"]);
    let gone = "samples/specimen=pack-1/month=2026-11/run-a.parquet";
    let content = store.get(gone).unwrap().unwrap();
    store.delete(gone).unwrap();
    assert_eq!(check(&store, &[]).problems, [format!("{gone} is missing")]);
    store.put(gone, content).unwrap();
    let half = "runs/specimen=pack-1/month=2026-11/part-0.parquet";
    store.put(half, b"half".to_vec()).unwrap();
    assert_eq!(check(&store, &[]).leftovers, [half]);
    assert_eq!(add_all(&store, &files).leftovers_removed, 1);
    assert!(check(&store, &files).is_clean());
}

#[test]
fn a_file_whose_writing_was_interrupted_is_named_and_removed() {
    let folder = tempfile::tempdir().unwrap();
    let files = few_runs(folder.path());
    let place = folder.path().join("archive");
    let store = ArchiveStore::open(place.to_str().unwrap()).unwrap();
    add_all(&store, &files);
    let half = place.join("samples/specimen=pack-1/month=2026-11/run-a.parquet#1");
    std::fs::write(&half, "half").unwrap();
    assert_eq!(check(&store, &files).leftovers, [half.display().to_string()]);
    assert_eq!(add_all(&store, &files).leftovers_removed, 1);
    assert!(!half.exists() && check(&store, &files).is_clean());
}

#[test]
fn only_whole_runs_get_in_and_the_others_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut files = few_runs(folder.path());
    damage_samples(&files[0]);
    let open = folder.path().join("open.leafrun");
    let mut writer = RunFileWriter::create(&open, &header()).unwrap();
    writer.sample(&sample(0));
    writer.flush();
    let text = folder.path().join("text.leafrun");
    std::fs::write(&text, "no run").unwrap();
    files.extend([open, text, files[1].clone()]);
    let store = in_memory();
    let added = add_all(&store, &files);
    assert_eq!(added.added, 2);
    assert_eq!(added.open, [header().run_id]);
    assert_eq!(added.refused.len(), 3, "{:?}", added.refused);
    for part in ["run-a.leafrun", "text.leafrun", "the same run id"] {
        assert!(
            added.refused.iter().any(|r| r.contains(part)),
            "{part}: {:?}",
            added.refused
        );
    }
    assert!(check(&store, &[]).is_clean());
}

#[test]
fn two_commands_do_not_write_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let files = few_runs(folder.path());
    let store = in_memory();
    let lock = WriterLock::take(&store, false).unwrap();
    let refused = add(&store, &files, AddOptions::default(), &|_| {}).unwrap_err();
    assert!(
        refused.to_string().contains("another command writes"),
        "{refused}"
    );
    let taken = add(&store, &files, AddOptions { take_over: true }, &|_| {}).unwrap();
    assert_eq!(taken.added, 3);
    assert!(matches!(lock.check(), Err(ArchiveError::TakenOver { .. })));
    drop(lock);
    let held_by = |host: &str, pid: u32, process: &str| {
        let holder = serde_json::json!({
            "host": host, "pid": pid, "process": process, "since_utc": "2026-11-25T20:00:00Z", "nonce": 1
        });
        store
            .put("_archive/writer.json", holder.to_string().into_bytes())
            .unwrap();
    };
    let here = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap();
    // A process that is gone: no process has this number, or a later one has it.
    for pid in [u32::MAX, std::process::id()] {
        held_by(here.trim(), pid, "an earlier process");
        assert_eq!(add_all(&store, &files).present, 3);
    }
    held_by("elsewhere", 1, "");
    let refused = add(&store, &files, AddOptions::default(), &|_| {}).unwrap_err();
    assert!(refused.to_string().contains("elsewhere"), "{refused}");
}

#[test]
fn a_place_that_cannot_be_is_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    for place in [file.to_str().unwrap(), "gs://bucket/x"] {
        let error = ArchiveStore::open(place).unwrap_err().to_string();
        assert!(error.contains("is no place for an archive"), "{error}");
    }
    let nowhere = folder.path().join("nowhere");
    let error = ArchiveStore::open_existing(nowhere.to_str().unwrap()).unwrap_err();
    assert!(matches!(error, ArchiveError::NoArchive { .. }));
    assert!(!nowhere.exists());
    // An empty folder is none either.
    let store = ArchiveStore::open(folder.path().to_str().unwrap()).unwrap();
    assert!(matches!(
        verify(&store, &[], &|_| {}),
        Err(ArchiveError::NoArchive { .. })
    ));
}

#[test]
fn a_newer_archive_is_refused() {
    let store = in_memory();
    add_all(&store, &[]);
    let text = String::from_utf8(store.get(MANIFEST).unwrap().unwrap()).unwrap();
    let body = text.lines().next().unwrap().replace('1', "2") + "\n";
    let end = format!(
        "{{\"entries\":0,\"sha256\":\"{}\"}}\n",
        partition::hash(body.as_bytes())
    );
    store.put(MANIFEST, (body + &end).into_bytes()).unwrap();
    assert!(matches!(
        Manifest::read(&store),
        Err(ArchiveError::Schema { found: 2, .. })
    ));
}

/// A store that fails every third call: before it did anything, or after it, so that the answer is lost.
#[derive(Debug)]
struct Unreliable {
    inner: InMemory,
    calls: AtomicU64,
}

impl Unreliable {
    fn failure(&self) -> object_store::Error {
        object_store::Error::Generic {
            store: "test",
            source: "the connection was reset".into(),
        }
    }

    /// What happens at this call: (fails before, fails after).
    fn fate(&self) -> (bool, bool) {
        let call = 1 + self.calls.fetch_add(1, Ordering::SeqCst);
        let fails = call.is_multiple_of(3);
        (fails && call.is_multiple_of(2), fails && !call.is_multiple_of(2))
    }

    async fn around<T>(
        &self,
        call: impl Future<Output = object_store::Result<T>>,
    ) -> object_store::Result<T> {
        let (before, after) = self.fate();
        if before {
            return Err(self.failure());
        }
        let answer = call.await;
        if after { Err(self.failure()) } else { answer }
    }
}

impl std::fmt::Display for Unreliable {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "unreliable")
    }
}

#[async_trait::async_trait]
impl ObjectStore for Unreliable {
    async fn put_opts(
        &self,
        location: &Path,
        payload: PutPayload,
        options: PutOptions,
    ) -> object_store::Result<PutResult> {
        self.around(self.inner.put_opts(location, payload, options)).await
    }

    async fn put_multipart_opts(
        &self,
        location: &Path,
        options: PutMultipartOptions,
    ) -> object_store::Result<Box<dyn MultipartUpload>> {
        self.around(self.inner.put_multipart_opts(location, options))
            .await
    }

    async fn get_opts(&self, location: &Path, options: GetOptions) -> object_store::Result<GetResult> {
        self.around(self.inner.get_opts(location, options)).await
    }

    fn delete_stream(
        &self,
        locations: BoxStream<'static, object_store::Result<Path>>,
    ) -> BoxStream<'static, object_store::Result<Path>> {
        match self.fate() {
            (false, false) => self.inner.delete_stream(locations),
            _ => futures_util::stream::iter([Err(self.failure())]).boxed(),
        }
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, object_store::Result<ObjectMeta>> {
        match self.fate() {
            (false, false) => self.inner.list(prefix),
            _ => futures_util::stream::iter([Err(self.failure())]).boxed(),
        }
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> object_store::Result<ListResult> {
        self.around(self.inner.list_with_delimiter(prefix)).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> object_store::Result<()> {
        self.around(self.inner.copy_opts(from, to, options)).await
    }
}

#[test]
fn a_store_that_fails_every_third_call_gets_the_same_archive() {
    let folder = tempfile::tempdir().unwrap();
    let files = few_runs(folder.path());
    let unreliable = Arc::new(Unreliable {
        inner: InMemory::new(),
        calls: AtomicU64::new(0),
    });
    let inner = Arc::clone(&unreliable) as Arc<dyn ObjectStore>;
    let store = ArchiveStore::over("unreliable", inner, Path::from("lab/archive")).unwrap();
    assert_eq!(add_all(&store, &files).added, 3);
    assert!(check(&store, &files).is_clean());
    assert!(unreliable.calls.load(Ordering::SeqCst) > 20);
    let reliable = in_memory();
    add_all(&reliable, &files);
    let tables = |store| contents(store).into_iter().collect::<Vec<_>>();
    assert_eq!(tables(&store), tables(&reliable));
}
