//! Faults K1 and K2 on a real disk: the data folder is a small file system in memory that is filled while a run goes on.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::run_files::get;
use super::support::{Daemon, json, leafbench, program, until};
use crate::recording::run_file::{EXTENSION, RunFile};

/// Size of the file system in MiB: more than the space check before a short run asks for.
const DISK_MIB: u64 = 400;
/// Twelve seconds, so that most of the run lies after the moment at which the disk is full.
const RUN: &str = "static-ramp-12s";

/// A shell command line behind `unshare`, in a mount namespace of its own. The rights of root in a new user namespace are
/// enough.
fn unshared(script: &str) -> Command {
    let mut command = Command::new("unshare");
    command.args(["--user", "--map-root-user", "--mount", "--propagation", "private"]);
    command.args(["sh", "-c", script]);
    command.env_remove("LEAFBENCH_DATA");
    command.current_dir(env!("CARGO_MANIFEST_DIR"));
    command
}

/// A daemon whose data folder is a file system of [`DISK_MIB`]; `None` where this system does not allow to mount one.
fn daemon_on_a_small_disk(folder: &Path) -> Option<Daemon> {
    let mount = format!(
        "mount -t tmpfs -o size={DISK_MIB}m leafbench-test {}",
        folder.display()
    );
    let allowed = unshared(&mount)
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|s| s.success());
    if !allowed {
        println!("SKIPPED: this system does not allow a test to mount a file system");
        return None;
    }
    let daemon = format!(
        "{mount} && exec {} daemon --json --listen 127.0.0.1:0 --data {}",
        program().display(),
        folder.display()
    );
    let daemon = Daemon::start_command(unshared(&daemon), |pid| {
        PathBuf::from(format!("/proc/{pid}/root{}", folder.display()))
    });
    daemon.until_phase("ready");
    Some(daemon)
}

/// Takes all free space of the data folder.
fn fill(data: &Path) -> PathBuf {
    let filler = data.join("filler");
    let mut file = std::fs::File::create(&filler).expect("made");
    let block = vec![0x55; 1 << 20];
    let mut size = block.len();
    // Smaller and smaller pieces, down to the last page.
    while size > 0 {
        match std::io::Write::write(&mut file, &block[..size]) {
            Ok(written) if written > 0 => {}
            _ => size /= 2,
        }
    }
    filler
}

fn disk_problem(daemon: &Daemon) -> String {
    daemon.status()["run"]["disk_problem"]
        .as_str()
        .unwrap_or_default()
        .to_owned()
}

/// Starts `leafbench run` and fills the disk two seconds into the run.
fn run_into_a_full_disk(daemon: &Daemon) -> (std::process::Child, PathBuf) {
    let mut command = leafbench(&["run", RUN, "--json", "--data"]);
    command
        .arg(&daemon.data)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let run = command.spawn().expect("leafbench starts");
    until("two seconds of the run", || {
        (daemon.status()["rig"]["elapsed_s"].as_f64()? > 2.0).then_some(())
    });
    (run, fill(&daemon.data))
}

/// The newest run as the daemon lists it: SQLite of this process cannot open a file in the mount namespace of another one.
fn newest(daemon: &Daemon) -> serde_json::Value {
    let (_, _, body) = get(daemon, "/api/runs");
    let runs: serde_json::Value = serde_json::from_str(&body).expect("JSON");
    runs[0].clone()
}

#[test]
fn k1_a_run_on_a_full_disk_is_not_called_completed_and_fails() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some(daemon) = daemon_on_a_small_disk(folder.path()) else {
        return;
    };
    let (run, _filler) = run_into_a_full_disk(&daemon);
    until("the alarm", || {
        Some(disk_problem(&daemon)).filter(|p| !p.is_empty())
    });
    let output = run.wait_with_output().expect("ended");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    let listed = newest(&daemon);
    assert_eq!(listed["ending"], "incomplete", "{listed}");
    let cause = listed["cause"].as_str().expect("a cause");
    assert!(
        cause.contains("are not on the disk") && cause.contains("full"),
        "{cause}"
    );
    // The file, the list and the answer of the run agree on what is missing.
    let report: serde_json::Value = serde_json::from_str(&said).expect("JSON");
    let missing = report["samples_not_saved"].as_u64().expect("a number");
    assert!(missing > 5000, "{report}");
    assert!(cause.contains(&missing.to_string()), "{cause}");
    let recorded = report["samples"].as_u64().expect("a number");
    assert_eq!(listed["samples"].as_u64().expect("a number") + missing, recorded);
}

#[test]
fn k1_a_disk_that_has_space_again_gets_every_sample_of_the_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some(daemon) = daemon_on_a_small_disk(folder.path()) else {
        return;
    };
    let (run, filler) = run_into_a_full_disk(&daemon);
    until("the alarm", || {
        Some(disk_problem(&daemon)).filter(|p| !p.is_empty())
    });
    std::fs::remove_file(filler).expect("removed");
    until("the end of the alarm", || {
        Some(disk_problem(&daemon)).filter(String::is_empty)
    });
    let output = run.wait_with_output().expect("ended");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(0), "{said}");
    let listed = newest(&daemon);
    assert_eq!(
        (&listed["ending"], &listed["lost"]),
        (&"completed".into(), &0.into()),
        "{listed}"
    );
    let report: serde_json::Value = serde_json::from_str(&said).expect("JSON");
    assert_eq!(listed["samples"], report["samples"]);
}

/// Blocks of 512 bytes that a file of the daemon may have: about two seconds of a live run.
const FILE_LIMIT_BLOCKS: u32 = 4096;

#[test]
fn a_run_whose_files_reach_the_limit_of_the_system_goes_on_in_further_files() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let mut command = Command::new("sh");
    command.arg("-c").arg(format!(
        "trap '' XFSZ; ulimit -f {FILE_LIMIT_BLOCKS}; exec {} daemon --json --listen 127.0.0.1:0 --data {}",
        program().display(),
        data.display()
    ));
    command
        .env_remove("LEAFBENCH_DATA")
        .current_dir(env!("CARGO_MANIFEST_DIR"));
    let daemon = Daemon::start_command(command, |_| data.clone());
    daemon.until_phase("ready");
    let (report, code) = json(&data, &["run", RUN]);
    assert_eq!((code, &report["samples_not_saved"]), (1, &0.into()), "{report}");
    let problem = report["disk_problem"].as_str().expect("text");
    assert!(problem.contains("keep all of its files"), "{problem}");
    let (runs, _) = json(&data, &["runs"]);
    let runs = runs.as_array().expect("a list");
    assert!(runs.len() > 1, "{runs:?}");
    let mut ticks = std::collections::BTreeSet::new();
    for run in runs {
        assert_eq!(run["problem"], "", "{run}");
        let id = run["run_id"].as_str().expect("an id");
        let file = RunFile::open(&data.join(format!("{id}.{EXTENSION}"))).expect("readable");
        ticks.extend(file.samples().map(|s| s.tick));
    }
    assert_eq!(
        ticks.len() as u64,
        report["samples"].as_u64().expect("a number"),
        "{runs:?}"
    );
}
