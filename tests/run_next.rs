//! `diagnose --run-next`: the bench runs the next test, and the diagnosis is repeated with its recording.

use super::support::{self, program};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::support::bench::{concealing, play, sine};
use super::support::{Daemon, config, json, until};
use nix::sys::signal::{Signal, kill};

/// A bench that conceals a weak helper leaf, and one short sine about its knee, in which a knee and a smooth bend are confounded.
fn confounded(folder: &Path) -> (PathBuf, PathBuf) {
    let bench = concealing(
        "progressive_stiffness",
        &[("extra_rate_n_per_mm", 0.5), ("knee_mm", 8.0), ("width_mm", 2.0)],
    );
    let file = folder.join("bench.toml");
    std::fs::write(&file, bench.to_toml()).expect("scratch folder is writable");
    let (_, csv) = play(&bench, &sine("one", 9.0, 1.0, 8), Some(folder));
    (file, csv.expect("exported"))
}

fn text(path: &Path) -> String {
    path.to_str().expect("UTF-8").to_owned()
}

fn daemon(folder: &Path, bench: &Path) -> Daemon {
    let profiles = text(&config("profiles"));
    Daemon::ready(
        &folder.join("data"),
        &["--bench", &text(bench), "--profiles", &profiles],
    )
}

/// Every round has its files; all but the last one a recording.
fn check_rounds(rounds: &[serde_json::Value], out: &Path) {
    for (number, round) in rounds.iter().enumerate() {
        for name in ["diagnosis.json", "report.html", "improved.toml"] {
            assert!(
                out.join(format!("round-{number}")).join(name).is_file(),
                "{name} of round {number}"
            );
        }
        let next_test = out.join(format!("round-{number}/next-test.toml"));
        assert!(next_test.is_file() || number + 1 == rounds.len(), "{round}");
        let recording = round["recording"].as_str();
        assert_eq!(recording.is_some(), number + 1 < rounds.len(), "{round}");
        assert!(recording.is_none_or(|path| Path::new(path).is_file()));
    }
    assert!(out.join("rounds.json").is_file() && out.join("report.html").is_file());
}

/// The result of `--run-next` on a virtual bench, and its rounds.
fn virtual_rounds(folder: &Path, bench: &Path, csv: &Path) -> (serde_json::Value, Vec<serde_json::Value>) {
    let out = folder.join("out");
    let ran = Command::new(program())
        .args([
            "diagnose",
            "--run-next=virtual",
            "--rounds",
            "2",
            "--json",
            "--bench",
            &text(bench),
            "--out",
            &text(&out),
        ])
        .arg(csv)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("the program starts");
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let ended: serde_json::Value = serde_json::from_slice(&ran.stdout).expect("JSON");
    let rounds = ended["rounds"].as_array().expect("a list").clone();
    assert!((1..=3).contains(&rounds.len()), "{ended:#}");
    assert!(ended["why"].as_str().is_some_and(|w| !w.is_empty()), "{ended:#}");
    check_rounds(&rounds, &out);
    // If the last diagnosis has no next test, the profile of an earlier round is removed.
    let has_next_test = !ended["diagnosis"]["next_test"].is_null();
    assert_eq!(out.join("next-test.toml").exists(), has_next_test);
    (ended, rounds)
}

#[test]
fn rounds_are_run_and_kept_until_the_diagnosis_is_settled() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, csv) = confounded(folder.path());
    let (ended, rounds) = virtual_rounds(folder.path(), &file, &csv);
    assert_eq!(ended["settled"], true, "{} {:#}", ended["why"], ended["rounds"]);
    assert!(rounds.len() > 1, "one sine about a knee settled it");
    let last = rounds.last().expect("one at least");
    assert_eq!(last["effects"], serde_json::json!(["progressive_stiffness"]));
}

/// Damping is named beside its look-alike, a delay. Damping below 0.02 N s/mm stays below half the noise in this sine, so it is not
/// named at all. (With the first design a second test was needed.)
#[test]
fn damping_is_told_from_a_delay() {
    let folder = tempfile::tempdir().expect("a folder");
    let bench = concealing("viscous_damping", &[("damping_n_s_per_mm", 0.045)]);
    let file = folder.path().join("bench.toml");
    std::fs::write(&file, bench.to_toml()).expect("scratch folder is writable");
    let (_, csv) = play(&bench, &sine("one", 12.0, 0.5, 2), Some(folder.path()));
    let (ended, rounds) = virtual_rounds(folder.path(), &file, &csv.expect("exported"));
    assert_eq!(ended["settled"], true, "{} {:#}", ended["why"], ended["rounds"]);
    let last = rounds.last().expect("one at least");
    assert_eq!(last["effects"], serde_json::json!(["viscous_damping"]));
}

#[test]
fn a_live_rig_runs_the_test_and_its_recording_counts() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, csv) = confounded(folder.path());
    let daemon = daemon(folder.path(), &file);
    let out = folder.path().join("out");
    let arguments = [
        "diagnose",
        "--run-next",
        "--rounds",
        "1",
        "--bench",
        &text(&file),
        "--out",
        &text(&out),
        &text(&csv),
    ];
    let (ended, code) = json(&daemon.data, &arguments);
    assert_eq!(code, 0, "{ended:#}");
    let rounds = ended["rounds"].as_array().expect("a list");
    assert_eq!(rounds.len(), 2, "one test was run");
    check_rounds(rounds, &out);
    assert_eq!(
        ended["diagnosis"]["curves"].as_array().map(Vec::len),
        Some(2),
        "the new recording was judged too"
    );
}

#[test]
fn ctrl_c_stops_the_rig_and_loses_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, csv) = confounded(folder.path());
    let daemon = daemon(folder.path(), &file);
    let out = folder.path().join("out");
    let child = support::leafbench(&[
        "diagnose",
        "--run-next",
        "--json",
        "--bench",
        &text(&file),
        "--out",
        &text(&out),
    ])
    .arg(csv)
    .arg("--data")
    .arg(&daemon.data)
    .stdout(Stdio::piped())
    .spawn()
    .expect("leafbench starts");
    until("a moving rig", || {
        (daemon.status()["rig"]["elapsed_s"].as_f64()? > 1.0).then_some(())
    });
    kill(nix::unistd::Pid::from_raw(child.id() as i32), Signal::SIGINT).expect("it is there");
    let ended = child.wait_with_output().expect("it ends");
    assert!(ended.status.success());
    let ended: serde_json::Value = serde_json::from_slice(&ended.stdout).expect("JSON");
    assert_eq!(ended["settled"], false);
    assert!(
        ended["why"]
            .as_str()
            .is_some_and(|w| w.contains("leafbench export")),
        "{}",
        ended["why"]
    );
    assert!(out.join("round-0/diagnosis.json").is_file());
    let (runs, _) = json(&daemon.data, &["runs"]);
    assert!(runs[0]["samples"].as_u64().is_some_and(|n| n > 500), "{runs}");
}
