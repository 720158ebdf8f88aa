//! Starts that do not become a run: stopped, left or refused before anything moves. And starts that may not be one: another
//! bench, an overdue calibration, another specimen.

use std::path::{Path, PathBuf};
use std::process::Stdio;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::{Value, json as object};

use super::support::http::{answer, post};
use super::support::{Daemon, Process, config, json, leafbench, until};

/// A profile of 20 hours: its check takes many seconds, so that there is time to stop it.
const HOURS: &str = "name = \"hours\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\n\
                     to_mm = 6.0\nduration_s = 1.0\n[[block.segment]]\nkind = \"hold\"\nduration_s = 72000.0\n";
/// A profile whose check takes milliseconds.
const SECONDS: &str = "name = \"seconds\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\n\
                       to_mm = 3.0\nduration_s = 0.3\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 0.0\nduration_s = 0.3\n";
/// A counted cycle each 0.4 s.
const CYCLES: &str = "name = \"cycles\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\n\
                      to_mm = 8.0\nduration_s = 1.0\n[[block.segment]]\nkind = \"sine\"\nmean_mm = 8.0\namplitude_mm = 3.0\n\
                      frequency_hz = 2.5\ncycles = 500\ntaper_cycles = 1\n";

fn until_preparing(daemon: &Daemon) {
    until("a run in preparation", || {
        (daemon.status()["preparing"] != false).then_some(())
    });
}

/// Nothing is prepared, nothing runs, and there is no run and no file of one.
fn assert_nothing_happened(daemon: &Daemon) {
    let status = until("the end of the preparation", || {
        Some(daemon.status()).filter(|s| s["preparing"] == false)
    });
    assert_eq!(status["rig"]["phase"], "ready", "{status}");
    assert_eq!(json(&daemon.data, &["runs"]).0, object!([]));
    let files = std::fs::read_dir(&daemon.data).expect("listed").flatten();
    let runs: Vec<_> = files
        .map(|file| file.file_name().to_string_lossy().into_owned())
        .filter(|name| name.contains(".leafrun"))
        .collect();
    assert!(runs.is_empty(), "{runs:?}");
}

#[test]
fn a_stop_while_a_run_is_prepared_withdraws_it_for_good() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let starting = post(&daemon, "/api/run", &object!({ "profile": HOURS }));
    until_preparing(&daemon);
    let (stopped, code) = json(folder.path(), &["stop", "--reason", "oil leak"]);
    assert_eq!(code, 0, "{stopped}");
    let (status, refusal) = answer(starting);
    assert_eq!(status, 409, "{refusal}");
    assert!(
        refusal.contains("stopped before it began (oil leak)"),
        "{refusal}"
    );
    assert_nothing_happened(&daemon);
    // A stop is taken where nothing is to be stopped too, and does not harm the next run.
    let (idle, code) = json(folder.path(), &["stop"]);
    assert_eq!(code, 0, "{idle}");
    let (status, started) = answer(post(&daemon, "/api/run", &object!({ "profile": SECONDS })));
    assert_eq!(status, 202, "{started}");
}

#[test]
fn ctrl_c_in_leafbench_run_while_it_is_prepared_moves_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let daemon = Daemon::ready(&data, &[]);
    let profile = folder.path().join("hours.toml");
    std::fs::write(&profile, HOURS).expect("written");
    let mut run = leafbench(&["run"]);
    let run = run.arg(&profile).arg("--data").arg(&data).stdout(Stdio::null());
    let mut run = Process(run.spawn().expect("starts"));
    until_preparing(&daemon);
    kill(Pid::from_raw(run.0.id() as i32), Signal::SIGINT).expect("there");
    let code = until("the end of leafbench run", || {
        let phase = daemon.status()["rig"]["phase"].clone();
        assert_eq!(phase, "ready", "the rig moves after Ctrl-C");
        run.0.try_wait().expect("a child")
    });
    assert_eq!(code.code(), Some(4));
    assert_nothing_happened(&daemon);
}

#[test]
fn a_client_that_leaves_before_the_run_begins_gets_no_motion_and_leaves_no_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let leaving = post(&daemon, "/api/run", &object!({ "profile": HOURS }));
    until_preparing(&daemon);
    drop(leaving);
    assert_nothing_happened(&daemon);
}

#[test]
fn a_client_that_leaves_at_any_moment_leaves_no_run_without_an_end() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    for _ in 0..20 {
        drop(post(&daemon, "/api/run", &object!({ "profile": SECONDS })));
        // A run that has begun before the daemon saw the client leave is followed to its end.
        until("a bench at rest", || {
            let status = daemon.status();
            let at_rest = status["rig"]["phase"] == "ready" && status["preparing"] != true;
            (at_rest && status["run"]["state"] != "arming").then_some(())
        });
    }
    until("the end of every run", || {
        let runs = json(folder.path(), &["runs"]).0;
        let open = runs.as_array()?.iter().filter(|run| run["ending"] == "open");
        (open.count() == 0).then_some(())
    });
}

#[test]
fn a_second_start_is_refused_while_the_first_is_prepared_and_a_terminated_daemon_starts_none() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut daemon = Daemon::ready(folder.path(), &[]);
    let first = post(&daemon, "/api/run", &object!({ "profile": HOURS }));
    until_preparing(&daemon);
    let (status, refusal) = answer(post(&daemon, "/api/run", &object!({ "profile": SECONDS })));
    assert_eq!(status, 409, "{refusal}");
    assert!(refusal.contains("another run is being prepared"), "{refusal}");
    daemon.signal(Signal::SIGTERM);
    assert_eq!(answer(first).0, 503);
    assert!(daemon.process.0.wait().expect("ended").success());
    assert_eq!(json(folder.path(), &["runs"]).0, object!([]));
}

/// The shipped mock bench in a file of its own, with one text replaced.
fn bench(folder: &Path, name: &str, from: &str, to: &str) -> PathBuf {
    let shipped = std::fs::read_to_string(config("benches/mock.toml")).expect("shipped");
    assert!(shipped.contains(from), "{from}");
    let specimens = config("specimens");
    let text = shipped
        .replace(from, to)
        .replace("../specimens", specimens.to_str().expect("UTF-8"));
    let path = folder.join(name);
    std::fs::write(&path, text).expect("written");
    path
}

fn daemon_with(data: &Path, bench: &Path) -> Daemon {
    Daemon::ready(data, &["--bench", bench.to_str().expect("UTF-8")])
}

/// Starts a run, waits for a counted cycle, stops it, and waits until its file is closed.
fn interrupted_run(daemon: &Daemon, request: &Value) -> String {
    let (status, body) = answer(post(daemon, "/api/run", request));
    assert_eq!(status, 202, "{body}");
    let started: Value = serde_json::from_str(&body).expect("JSON");
    let before = until("a counted cycle", || {
        let status = daemon.status();
        let cycles = status["rig"]["cycles_completed"].as_u64()?;
        (status["rig"]["phase"] == "running" && cycles > 0).then_some(cycles)
    });
    assert!(before > 0);
    assert_eq!(json(&daemon.data, &["stop"]).1, 0);
    daemon.until_phase("ready");
    until("a closed file", || {
        (daemon.status()["run"]["state"] == "ended").then_some(())
    });
    started["run_id"].as_str().expect("an id").to_owned()
}

#[test]
fn a_run_is_resumed_once_and_on_its_own_bench_only() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let own = bench(folder.path(), "own.toml", "seed = 1", "seed = 1");
    let tighter = bench(
        folder.path(),
        "tighter.toml",
        "force_max_n = 3200.0",
        "force_max_n = 3100.0",
    );
    let daemon = daemon_with(&data, &own);
    let parent = interrupted_run(&daemon, &object!({ "profile": CYCLES }));
    drop(daemon);

    let daemon = daemon_with(&data, &tighter);
    let resume = object!({ "resume_run": parent });
    let (status, refusal) = answer(post(&daemon, "/api/run", &resume));
    assert_eq!(status, 409, "{refusal}");
    let difference = "limits.force_max_n of its bench was 3200.0 and is now 3100.0";
    assert!(refusal.contains(difference), "{refusal}");
    drop(daemon);

    let daemon = daemon_with(&data, &own);
    let other = object!({ "resume_run": parent, "specimen": "samurai-front 8" });
    let (status, refusal) = answer(post(&daemon, "/api/run", &other));
    assert!(
        status == 409 && refusal.contains("its specimen was"),
        "{status} {refusal}"
    );
    // A short id stands for the run; the recording has the whole one, by which the second try below finds it.
    let short = parent.rsplit('-').next().expect("a part");
    let child = interrupted_run(&daemon, &object!({ "resume_run": short }));
    let (status, refusal) = answer(post(&daemon, "/api/run", &resume));
    assert_eq!(status, 409, "{refusal}");
    assert!(
        refusal.contains(&format!("resumed already, by run {child}")),
        "{refusal}"
    );
    // The chain goes on at its end.
    interrupted_run(&daemon, &object!({ "resume_run": child }));
}

#[test]
fn p6_an_overdue_calibration_and_a_foreign_specimen_need_a_name_that_is_recorded() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let overdue = bench(
        folder.path(),
        "overdue.toml",
        "calibrated = \"2026-09-01\"\ndue = \"2099-12-31\"",
        "calibrated = \"2019-09-01\"\ndue = \"2020-09-01\"",
    );
    let daemon = daemon_with(&data, &overdue);
    let profile = folder.path().join("seconds.toml");
    std::fs::write(&profile, SECONDS).expect("written");
    let profile = profile.to_str().expect("UTF-8");
    let (refused, code) = json(&data, &["run", profile, "--specimen", "leaf 7"]);
    assert_eq!(code, 4, "{refused}");
    let why = refused["error"].as_str().expect("a text");
    for part in [
        "load cell",
        "LVDT",
        "due on 2020-09-01",
        "\"leaf 7\"",
        "--override NAME",
    ] {
        assert!(why.contains(part), "{part}: {why}");
    }
    assert_eq!(json(&data, &["runs"]).0, object!([]));

    let order = ["run", profile, "--specimen", "leaf 7", "--override", "R. Meier"];
    let (ended, code) = json(&data, &order);
    assert_eq!(code, 0, "{ended}");
    let out = folder.path().join("out");
    let (written, code) = json(
        &data,
        &["export", "latest", "--out", out.to_str().expect("UTF-8")],
    );
    assert_eq!(code, 0, "{written}");
    let metadata = std::fs::read_dir(&out).expect("listed").flatten();
    let metadata = metadata
        .map(|file| file.path())
        .find(|path| path.to_string_lossy().ends_with("datapackage.json"));
    let metadata = std::fs::read_to_string(metadata.expect("written")).expect("read");
    assert_eq!(
        metadata.matches("override by R. Meier: ").count(),
        3,
        "{metadata}"
    );
    drop(daemon);
}

#[test]
fn a_profile_that_begins_with_an_absolute_table_starts_on_a_rig_that_is_not_exactly_at_zero() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    // The mean of 500 samples with noise: after the tare no reading is exactly 0.
    until("a tare", || (json(folder.path(), &["tare"]).1 == 0).then_some(()));
    let (status, body) = answer(post(&daemon, "/api/run", &object!({ "profile": "table" })));
    assert_eq!(status, 202, "{body}");
    until("a run", || {
        let status = daemon.status();
        assert_ne!(
            status["run"]["state"], "never_started",
            "{}",
            status["run"]["cause"]
        );
        (status["rig"]["phase"] == "running").then_some(())
    });
}
