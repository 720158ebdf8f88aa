//! Tests the daemon as a process: kills, signals, forged requests, the live view.

use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};

use super::support::http::request;
use super::support::{Daemon, PATIENCE, json, until};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::run_file::RunFile;
use nix::sys::signal::Signal;

/// A profile that lasts long enough to be interrupted.
const LONG: &str = "name = \"long\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\n\
                    to_mm = 6.0\nduration_s = 1.0\n[[block.segment]]\nkind = \"hold\"\nduration_s = 60.0\n";

/// Starts a run over HTTP and waits until the rig moves.
fn start(daemon: &Daemon, profile: &str) -> String {
    let head = format!(
        "POST /api/run HTTP/1.1\r\nHost: {}\r\nContent-Type: application/json\r\n",
        daemon.authority()
    );
    let (status, body) = request(
        daemon,
        &head,
        &serde_json::json!({ "profile": profile }).to_string(),
    );
    assert_eq!(status, 202, "{body}");
    daemon.until_phase("running");
    let started: serde_json::Value = serde_json::from_str(&body).expect("JSON");
    started["run_id"].as_str().expect("an id").to_owned()
}

fn run_of(data: &Path, run_id: &str) -> serde_json::Value {
    let (runs, _) = json(data, &["runs"]);
    let runs = runs.as_array().expect("a list").clone();
    runs.into_iter()
        .find(|r| r["run_id"] == run_id)
        .expect("the run is listed")
}

#[test]
fn a_killed_daemon_leaves_a_readable_file_that_the_next_daemon_closes_with_the_cause() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut daemon = Daemon::ready(folder.path(), &[]);
    let run_id = start(&daemon, LONG);
    let listed = until("a second of samples in the file", || {
        run_of(folder.path(), &run_id)["samples"]
            .as_f64()
            .filter(|n| *n > f64::from(SAMPLE_RATE_HZ))
    });
    daemon.process.0.kill().expect("killed");
    daemon.process.0.wait().expect("ended");
    let run = run_of(folder.path(), &run_id);
    assert_eq!(run["ending"], "open");
    // What was in the file stays there. How much the thread that writes had still to do is a matter of the computer's load.
    let saved = run["samples"].as_f64().expect("a number");
    assert!(saved >= listed, "{saved} samples, {listed} before the kill");
    assert_eq!(run["lost"], 0);

    let again = Daemon::ready(folder.path(), &[]);
    let run = run_of(folder.path(), &run_id);
    assert_eq!(run["ending"], "aborted");
    assert!(
        run["cause"]
            .as_str()
            .expect("a cause")
            .contains("the file was left open")
    );
    assert!(again.status()["run"].is_null(), "the new daemon only observes");
}

#[test]
fn d9_a_terminated_daemon_unloads_first_and_closes_the_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut daemon = Daemon::ready(folder.path(), &[]);
    let run_id = start(&daemon, LONG);
    until("a loaded specimen", || {
        (daemon.status()["rig"]["force_n"].as_f64()? > 300.0).then_some(())
    });
    let begun = Instant::now();
    daemon.signal(Signal::SIGTERM);
    let code = daemon.process.0.wait().expect("ended");
    // The daemon must end within 5 s. A busy computer takes longer, by far not as long as the run would.
    assert!(begun.elapsed() < Duration::from_secs(40), "{:?}", begun.elapsed());
    assert!(code.success(), "{code}");
    let run = run_of(folder.path(), &run_id);
    assert_eq!(run["ending"], "stopped", "{run}");
    assert!(run["cause"].as_str().expect("a cause").contains("SIGTERM"));
    assert!(!folder.path().join("daemon.json").exists());
}

/// The same in the ramp and on hold.
#[test]
fn d9_a_daemon_that_is_ended_in_a_ramp_or_on_hold_unloads_too() {
    for held in [false, true] {
        let folder = tempfile::tempdir().expect("a folder");
        let mut daemon = Daemon::ready(folder.path(), &[]);
        let run_id = start(&daemon, LONG);
        if held {
            let (_, code) = json(folder.path(), &["hold"]);
            assert_eq!(code, 0);
            daemon.until_phase("held");
        }
        daemon.signal(Signal::SIGTERM);
        assert!(daemon.process.0.wait().expect("ended").success());
        let run = run_of(folder.path(), &run_id);
        assert_eq!(run["ending"], "stopped", "{run}");
        assert!(run["cause"].as_str().expect("a cause").contains("SIGTERM"));
    }
}

/// What makes the control loop less punctual is in the status and in the header of each run.
#[test]
fn o3_missing_real_time_rights_are_shown_and_written_into_the_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let shown = daemon.status()["degraded"].clone();
    let run_id = start(&daemon, LONG);
    let (_, code) = json(folder.path(), &["stop"]);
    assert_eq!(code, 0);
    daemon.back_to_ready();
    let file = RunFile::open(&folder.path().join(format!("{run_id}.leafrun"))).expect("a run file");
    let written = serde_json::json!(file.header().remarks);
    assert_eq!(
        written, shown,
        "the same sentences, none where the system gives the rights"
    );
}

#[test]
fn p4_a_stopped_run_keeps_its_data_and_a_second_start_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let run_id = start(&daemon, LONG);
    let head = format!(
        "POST /api/run HTTP/1.1\r\nHost: {}\r\nContent-Type: application/json\r\n",
        daemon.authority()
    );
    let (status, body) = request(
        &daemon,
        &head,
        &serde_json::json!({ "profile": LONG }).to_string(),
    );
    assert_eq!(status, 409, "{body}");
    assert!(body.contains(&run_id), "{body}");
    let (_, code) = json(folder.path(), &["stop", "--reason", "enough"]);
    assert_eq!(code, 0);
    daemon.until_phase("ready");
    let run = until("a closed file", || {
        Some(run_of(folder.path(), &run_id)).filter(|r| r["ending"] != "open")
    });
    assert_eq!(
        (run["ending"].as_str(), run["cause"].as_str()),
        (Some("stopped"), Some("enough"))
    );
    assert_eq!(
        json(folder.path(), &["runs"]).0.as_array().map(Vec::len),
        Some(1),
        "the refused start left no file"
    );
}

#[test]
fn p1_a_predicted_trip_is_refused_before_anything_moves() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let far = LONG
        .replace("to_mm = 6.0", "to_mm = 44.0")
        .replace("duration_s = 1.0", "duration_s = 20.0");
    let head = format!(
        "POST /api/run HTTP/1.1\r\nHost: {}\r\nContent-Type: application/json\r\n",
        daemon.authority()
    );
    let (status, body) = request(&daemon, &head, &serde_json::json!({ "profile": far }).to_string());
    assert_eq!(status, 422, "{body}");
    assert!(body.contains("force_max_n"), "{body}");
    assert_eq!(daemon.status()["rig"]["phase"], "ready");
    assert_eq!(json(folder.path(), &["runs"]).0, serde_json::json!([]));
}

#[test]
fn forged_hosts_and_origins_wrong_types_and_large_bodies_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::start(folder.path(), &[]);
    let host = daemon.authority().to_owned();
    let json_type = "Content-Type: application/json\r\n";
    let cases = [
        (format!("GET /api/status HTTP/1.1\r\nHost: {host}\r\n"), 200),
        (
            "GET /api/status HTTP/1.1\r\nHost: evil.example\r\n".to_owned(),
            403,
        ),
        ("GET / HTTP/1.1\r\nHost: evil.example\r\n".to_owned(), 403),
        (
            format!("GET / HTTP/1.1\r\nHost: {host}\r\nOrigin: http://evil.example\r\n"),
            403,
        ),
        (
            format!("POST /api/stop HTTP/1.1\r\nHost: {host}\r\nOrigin: http://evil.example\r\n{json_type}"),
            403,
        ),
        (
            format!("POST /api/stop HTTP/1.1\r\nHost: {host}\r\nOrigin: null\r\n{json_type}"),
            403,
        ),
        (
            format!("POST /api/stop HTTP/1.1\r\nHost: {host}\r\nContent-Type: text/plain\r\n"),
            415,
        ),
        (format!("POST /api/reset HTTP/1.1\r\nHost: {host}\r\n"), 415),
        (
            format!("GET /api/runs/..%2f..%2fetc%2fpasswd HTTP/1.1\r\nHost: {host}\r\n"),
            404,
        ),
        (
            format!("GET /api/runs/none/csv HTTP/1.1\r\nHost: {host}\r\n"),
            404,
        ),
        (format!("GET /api/nothing HTTP/1.1\r\nHost: {host}\r\n"), 404),
        (
            format!("GET / HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n"),
            200,
        ),
    ];
    for (head, expected) in cases {
        let (status, body) = request(&daemon, &head, "");
        assert_eq!(status, expected, "{head}{body}");
    }
    let run = format!("POST /api/run HTTP/1.1\r\nHost: {host}\r\n{json_type}");
    assert_eq!(request(&daemon, &run, &"x".repeat((1 << 20) + 1)).0, 413);
    assert_eq!(request(&daemon, &run, "{").0, 400);
    assert_eq!(request(&daemon, &run, "{\"profil\":\"x\"}").0, 422);
    let upgrade = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
                   Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n";
    let forged =
        format!("GET /api/live HTTP/1.1\r\nHost: {host}\r\nOrigin: http://evil.example\r\n{upgrade}");
    assert_eq!(request(&daemon, &forged, "").0, 403);
}

#[test]
fn the_live_view_sends_status_and_samples_with_the_twin() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    start(&daemon, LONG);
    let stream = TcpStream::connect(daemon.authority()).expect("the daemon listens");
    stream.set_read_timeout(Some(PATIENCE)).expect("set");
    let address: tungstenite::http::Uri = format!("ws://{}/api/live", daemon.authority())
        .parse()
        .expect("an address");
    let asked = tungstenite::ClientRequestBuilder::new(address)
        .with_header("Authorization", format!("Bearer {}", daemon.token()));
    let (mut socket, _) = tungstenite::client(asked, stream).expect("upgraded");
    let (mut status, mut twin_points) = (false, 0);
    while !status || twin_points < 100 {
        let tungstenite::Message::Text(text) = socket.read().expect("a message") else {
            continue;
        };
        let message: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        match message["type"].as_str() {
            Some("status") => status = message["status"]["rig"]["phase"] == "running",
            Some("samples") => {
                let points = message["twin_force_n"].as_array().expect("a column");
                assert_eq!(
                    points.len(),
                    message["time_s"].as_array().expect("a column").len()
                );
                twin_points += points.iter().filter(|p| p.is_number()).count();
            }
            other => panic!("{other:?}"),
        }
    }
}
