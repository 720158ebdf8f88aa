//! Faults D1 and K6: programs that are killed at any instant. `LEAFBENCH_KILLS` sets how many kills there are.

use std::collections::HashMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::live_writer;
use crate::recording::Recorder;
use crate::recording::run_file::RunFileWriter;
use crate::recording::run_file::test_support::{header, outcome, sample};
use crate::tests::support::{Process, program};

/// Kills where `LEAFBENCH_KILLS` says nothing.
const KILLS: usize = 30;

/// How many kills there are.
pub(super) fn kills() -> usize {
    std::env::var("LEAFBENCH_KILLS").map_or(KILLS, |n| n.parse().expect("a whole number"))
}

/// Waits until `path` exists: the process has begun its work.
fn until_there(path: &Path) {
    let until = Instant::now() + Duration::from_secs(60);
    while !path.exists() {
        assert!(Instant::now() < until, "no {}", path.display());
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn d1_a_killed_writer_loses_its_last_20_ms_and_corrupts_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let binary = std::env::current_exe().expect("a test binary knows its path");
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut lost = Vec::new();
    for number in 0..kills() {
        let path = folder.path().join(format!("{number}.leafrun"));
        let mut command = Command::new(&binary);
        command
            .args(["--exact", live_writer::WRITER, "--ignored", "--nocapture"])
            .env(live_writer::FILE, &path)
            .stdout(Stdio::piped())
            .stderr(Stdio::null());
        let mut writer = Process(command.spawn().expect("this binary starts"));
        until_there(&path);
        std::thread::sleep(Duration::from_micros(rng.random_range(20_000..400_000)));
        writer.0.kill().expect("it lives");
        writer.0.wait().expect("it ends");
        let mut output = String::new();
        let mut pipe = writer.0.stdout.take().expect("piped");
        pipe.read_to_string(&mut output).expect("text");
        let Some((passed, _)) = live_writer::newest_report(&output) else {
            // Killed before its first sample; the file may not even be a database yet.
            continue;
        };
        let left = live_writer::hold_to_what_was_written(&path);
        lost.push(passed.saturating_sub(left));
        crate::recording::run_file::remove(&path);
    }
    lost.sort_unstable();
    let at = |share: usize| lost[(lost.len() - 1) * share / 100];
    eprintln!(
        "{} kills: 0 corrupt; samples lost: median {}, 95 % {}, most {}",
        lost.len(),
        at(50),
        at(95),
        at(100)
    );
    assert!(lost.len() * 10 >= kills() * 8, "{} writers had begun", lost.len());
    // The most is printed and not held: on a busy machine without real-time rights the recording thread waits its turn.
    assert!(at(95) <= 20, "{lost:?}");
}

/// A closed run whose samples begin at `from`, under the name `run.leafrun`.
fn make_run(folder: &Path, from: u64) -> PathBuf {
    let path = folder.join("run.leafrun");
    crate::recording::run_file::remove(&path);
    let mut writer = RunFileWriter::create(&path, &header()).expect("made");
    writer.begin(&header());
    (from..from + 3000).for_each(|tick| writer.sample(&sample(tick)));
    writer.end(&outcome(3000));
    path
}

fn export(run: &Path, out: &Path) -> Command {
    let mut command = Command::new(program());
    command
        .arg("export")
        .arg(run)
        .args(["--force", "--format", "csv,mf4,parquet", "--out"])
        .arg(out)
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    command
}

/// The finished files of a folder with their content. What an export leaves behind is hidden.
fn visible(folder: &Path) -> HashMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).expect("listed");
    let files = entries.map(|entry| entry.expect("an entry").path());
    files
        .map(|file| {
            (
                file.file_name().expect("a name").to_string_lossy().into_owned(),
                file,
            )
        })
        .filter(|(name, _)| !name.starts_with('.'))
        .map(|(name, file)| (name, std::fs::read(file).expect("read")))
        .collect()
}

/// A run that is exported over the export of another run, and what both exports give.
struct Exports {
    folder: tempfile::TempDir,
    run: PathBuf,
    source: Vec<u8>,
    old: HashMap<String, Vec<u8>>,
    new: HashMap<String, Vec<u8>>,
    took: Duration,
}

impl Exports {
    fn new() -> Exports {
        let folder = tempfile::tempdir().expect("a folder");
        let of = |from| {
            let run = make_run(folder.path(), from);
            let out = folder.path().join(format!("of-{from}"));
            let begun = Instant::now();
            assert!(export(&run, &out).status().expect("starts").success());
            (visible(&out), begun.elapsed(), run)
        };
        let (old, _, _) = of(0);
        let (new, took, run) = of(250);
        assert_eq!(
            old.len(),
            5,
            "CSV, its package, cycles, MF4, Parquet: {:?}",
            old.keys()
        );
        assert!(
            old.iter().all(|(name, content)| new[name] != *content),
            "two exports that differ"
        );
        Exports {
            source: std::fs::read(&run).expect("read"),
            folder,
            run,
            old,
            new,
            took,
        }
    }

    /// A folder that holds the old export.
    fn out(&self) -> PathBuf {
        let out = self.folder.path().join("out");
        let _ = std::fs::remove_dir_all(&out);
        std::fs::create_dir(&out).expect("made");
        for (name, content) in &self.old {
            std::fs::write(out.join(name), content).expect("written");
        }
        out
    }

    /// Each file is the old or the new one, and the run is as it was. Returns how many files are new.
    fn hold(&self, out: &Path, when: &str) -> usize {
        let found = visible(out);
        assert_eq!(found.len(), self.old.len(), "{when}: {:?}", found.keys());
        for (name, content) in &found {
            let whole = *content == self.old[name] || *content == self.new[name];
            assert!(whole, "{when}: {name} is neither the old nor the new file");
        }
        assert_eq!(std::fs::read(&self.run).expect("read"), self.source, "{when}");
        found
            .iter()
            .filter(|(name, content)| **content == self.new[*name])
            .count()
    }
}

#[test]
fn k6_an_export_that_is_killed_at_any_instant_leaves_old_or_new_files() {
    let exports = Exports::new();
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let mut seen = [0_usize; 6];
    for number in 0..kills() {
        let out = exports.out();
        let mut child = Process(export(&exports.run, &out).spawn().expect("starts"));
        let longest = exports.took.as_micros() as u64 * 5 / 4;
        std::thread::sleep(Duration::from_micros(rng.random_range(0..longest)));
        // It may be done.
        let _ = child.0.kill();
        child.0.wait().expect("it ends");
        seen[exports.hold(&out, &format!("kill {number}"))] += 1;
    }
    eprintln!("{} exports killed; with 0 to 5 new files: {seen:?}", kills());
}

/// Calls of the system that can change a file.
const CALLS: &str = "openat,mkdir,write,pwrite64,writev,fsync,fdatasync,ftruncate,rename,renameat,renameat2,unlink,unlinkat,close";

impl Exports {
    /// The export under strace, with more options.
    fn traced(&self, out: &Path, options: &[&str]) -> bool {
        let plain = export(&self.run, out);
        let mut command = Command::new("strace");
        command.args(["-f", "-qq", "-e", &format!("trace={CALLS}")]);
        command
            .args(options)
            .arg(plain.get_program())
            .args(plain.get_args());
        command.stdout(Stdio::null()).stderr(Stdio::null());
        command.status().is_ok_and(|status| status.success())
    }

    /// The calls of the export's main thread from its first temporary file on, in order: the kind, and which one of its kind it is.
    /// `None` where nothing can be traced.
    fn calls(&self) -> Option<Vec<(String, usize)>> {
        let log = self.folder.path().join("calls");
        if !self.traced(&self.out(), &["-o", log.to_str().expect("UTF-8")]) {
            return None;
        }
        let text = std::fs::read_to_string(&log).expect("read");
        let main = text.split_whitespace().next().expect("a process").to_owned();
        let mut numbers = HashMap::new();
        let mut calls = Vec::new();
        let mut begun = false;
        for line in text
            .lines()
            .filter(|line| line.split_whitespace().next() == Some(&main))
        {
            let words = line.split_whitespace().nth(1).unwrap_or_default();
            let kind = words.split('(').next().unwrap_or_default().to_owned();
            let number = numbers.entry(kind.clone()).or_insert(0_usize);
            *number += 1;
            begun |= line.contains(".tmp");
            if begun && CALLS.split(',').any(|call| call == kind) {
                calls.push((kind, *number));
            }
        }
        Some(calls)
    }
}

/// The same at each call of the system, where strace is installed.
#[test]
fn k6_an_export_that_is_killed_at_each_call_leaves_old_or_new_files() {
    let exports = Exports::new();
    let Some(calls) = exports.calls() else {
        eprintln!("SKIPPED k6 at each call: strace is not here (Debian package strace), or may not trace");
        return;
    };
    let mut seen = [0_usize; 6];
    for (kind, number) in &calls {
        let out = exports.out();
        // strace counts each kind of call for itself.
        let inject = format!("inject={kind}:signal=SIGKILL:when={number}");
        let done = exports.traced(&out, &["-e", &inject, "-o", "/dev/null"]);
        let when = format!("killed at {kind} {number}");
        assert!(!done, "{when}: it was not killed");
        seen[exports.hold(&out, &when)] += 1;
    }
    eprintln!("killed at {} calls; with 0 to 5 new files: {seen:?}", calls.len());
    assert!(
        calls.len() > 20 && seen.iter().all(|count| *count > 0),
        "each state was seen: {seen:?}"
    );
}
