//! The log of the wire at a daemon: what candump would have written, and a simulated run with noise.

use super::support::{Daemon, json, leafbench, run};
use crate::protocol::cob;
use crate::recording::{Recording, csv};

#[test]
fn a_daemon_logs_every_frame_of_a_mock_rig_in_both_directions() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = folder.path().join("wire.log");
    let daemon = Daemon::ready(
        &folder.path().join("data"),
        &["--wire-log", log.to_str().expect("UTF-8")],
    );
    let (started, code) = json(&daemon.data, &["jog", "0.1"]);
    assert_eq!(code, 0, "{started}");
    daemon.until_phase("ready");
    let samples = daemon.status()["rig"]["counters"]["samples"]
        .as_u64()
        .expect("a number");
    daemon.signal(nix::sys::signal::Signal::SIGTERM);
    let mut daemon = daemon;
    assert!(daemon.process.0.wait().expect("ends").success());
    let text = std::fs::read_to_string(&log).expect("written");
    let (mut last, mut seen) = (0.0, std::collections::BTreeMap::<u16, u64>::new());
    for line in text.lines() {
        let mut parts = line.split(' ');
        let time = parts
            .next()
            .and_then(|t| t.strip_prefix('(')?.strip_suffix(')')?.parse::<f64>().ok());
        let time = time.unwrap_or_else(|| panic!("{line}"));
        assert!(time >= last, "{line}");
        last = time;
        assert_eq!(parts.next(), Some("mock"), "{line}");
        let (id, bytes) = parts
            .next()
            .and_then(|f| f.split_once('#'))
            .unwrap_or_else(|| panic!("{line}"));
        assert!(bytes.len() <= 16 && bytes.len().is_multiple_of(2), "{line}");
        *seen
            .entry(u16::from_str_radix(id, 16).expect("an identifier"))
            .or_default() += 1;
    }
    let count = |function| seen.get(&cob::id(function, 1)).copied().unwrap_or(0);
    assert!(
        count(cob::SAMPLE) >= samples,
        "{} of {samples} samples",
        count(cob::SAMPLE)
    );
    for function in [
        cob::COMMAND,
        cob::LEASE,
        cob::REQUEST,
        cob::STATUS,
        cob::HEARTBEAT,
    ] {
        assert!(count(function) > 0, "{seen:?}");
    }
}

#[test]
fn a_wire_log_that_cannot_be_written_stops_the_start() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = leafbench(&[
        "daemon",
        "--listen",
        "127.0.0.1:0",
        "--wire-log",
        "/no/such/folder/w.log",
        "--data",
    ])
    .arg(folder.path())
    .output()
    .expect("starts");
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("/no/such/folder/w.log"));
}

/// Root of the mean square of the differences.
fn rms(a: &[f64], b: &[f64]) -> f64 {
    let squares: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
    (squares / a.len() as f64).sqrt()
}

#[test]
fn simulate_rig_writes_what_a_run_with_noise_and_hydraulics_would() {
    let folder = tempfile::tempdir().expect("a folder");
    let simulated = |name: &str, more: &[&str]| {
        let path = folder.path().join(name);
        let mut arguments = vec![
            "simulate",
            "sine-6mm-2.5hz-10",
            "--out",
            path.to_str().expect("UTF-8"),
        ];
        arguments.extend(more);
        let output = run(&arguments);
        assert_eq!(
            output.status.code(),
            Some(0),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        csv::read_file(&path).expect("a recording")
    };
    let [model, rig, again, other] = [
        ("model.csv", &[] as &[&str]),
        ("rig.csv", &["--rig"]),
        ("again.csv", &["--rig"]),
        ("other.csv", &["--rig", "--seed", "7"]),
    ]
    .map(|(name, more)| simulated(name, more));
    assert!(folder.path().join("rig.datapackage.json").is_file());
    assert_eq!(rig.force_n, again.force_n, "one seed, one noise");
    assert_ne!(rig.force_n, other.force_n);
    assert!(rig.flags.is_some() && rig.cycle.as_ref().is_some_and(|c| c.iter().max() == Some(&10)));
    // Two noises of one count each; the servo follows them a little.
    let noise_n = rms(&rig.force_n, &other.force_n);
    assert!((0.1..1.0).contains(&noise_n), "{noise_n} N");
    // The hydraulics lag the command by more than the noise; the model follows it.
    let lag_mm = |recording: &Recording| {
        let command = recording.command.as_deref().expect("a command");
        let pairs = command.iter().zip(&recording.displacement_mm);
        let lags = pairs
            .filter(|(command, _)| command.is_finite())
            .map(|(command, mm)| (command - mm).abs());
        lags.fold(0.0, f64::max)
    };
    assert!(
        lag_mm(&rig) > 0.05 && lag_mm(&model) < 0.05,
        "{} {}",
        lag_mm(&rig),
        lag_mm(&model)
    );
    let left = std::fs::read_dir(folder.path()).expect("a folder").count();
    assert_eq!(left, 7, "four CSVs and three data packages, no scratch folder");
    let path = folder.path().join("rig.csv");
    let refused = run(&[
        "simulate",
        "sine-6mm-2.5hz-10",
        "--rig",
        "--out",
        path.to_str().expect("UTF-8"),
    ]);
    assert_eq!(refused.status.code(), Some(2), "it is there already");
}
