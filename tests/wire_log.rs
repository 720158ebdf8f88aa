//! The log of the wire at a daemon: what candump would have written.

use super::support::{Daemon, json, leafbench};
use crate::protocol::cob;

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
