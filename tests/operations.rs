//! The daemon as a service: signs of life for systemd, lines for the journal, figures for Prometheus; and the doctor's exit code.

use std::fs::File;
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::time::Instant;

use nix::sys::signal::Signal;

use super::support::http::{post_head, request};
use super::support::{Daemon, PATIENCE, json, leafbench, until};

/// Waits for a message of the daemon to its service manager.
fn until_told(socket: &UnixDatagram, wanted: &str) -> String {
    let began = Instant::now();
    loop {
        let mut buffer = [0; 256];
        let length = socket.recv(&mut buffer).unwrap_or(0);
        let told = String::from_utf8_lossy(&buffer[..length]).into_owned();
        if told.starts_with(wanted) {
            return told;
        }
        assert!(began.elapsed() < PATIENCE, "no {wanted}");
    }
}

#[test]
fn systemd_hears_that_the_daemon_is_ready_that_control_turns_and_that_it_ends() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("notify");
    let socket = UnixDatagram::bind(&path).expect("bound");
    socket.set_read_timeout(Some(PATIENCE)).expect("set");
    let log = File::create(folder.path().join("log")).expect("created");
    let at = log.metadata().expect("a file");
    let mut command = leafbench(&["daemon", "--json", "--listen", "127.0.0.1:0", "--data"]);
    command
        .arg(folder.path())
        .env("NOTIFY_SOCKET", &path)
        .env("WATCHDOG_USEC", "200000")
        .env("JOURNAL_STREAM", format!("{}:{}", at.dev(), at.ino()));
    let mut daemon = Daemon::start_with_log(command, folder.path(), log);
    let ready = until_told(&socket, "READY=1\n");
    assert!(ready.contains(&daemon.url), "{ready}");
    for _ in 0..5 {
        until_told(&socket, "WATCHDOG=1");
    }
    daemon.signal(Signal::SIGTERM);
    until_told(&socket, "STOPPING=1");
    daemon.process.0.wait().expect("ended");
    let log = std::fs::read_to_string(folder.path().join("log")).expect("readable");
    assert!(log.contains("<6>"), "{log}");
    assert!(
        log.lines()
            .all(|line| line.starts_with('<') && line[2..].starts_with('>')),
        "{log}"
    );
}

/// The number behind a figure.
fn figure(text: &str, name: &str) -> f64 {
    let line = text.lines().find_map(|line| line.strip_prefix(name));
    let number = line.and_then(|rest| rest.trim().parse().ok());
    number.unwrap_or_else(|| panic!("{name} in {text}"))
}

fn metrics(daemon: &Daemon) -> String {
    let head = format!("GET /metrics HTTP/1.1\r\nHost: {}\r\n", daemon.authority());
    let (status, body) = request(daemon, &head, "");
    assert_eq!(status, 200, "{body}");
    body
}

#[test]
fn the_figures_follow_the_bench_through_a_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let before = metrics(&daemon);
    assert!((figure(&before, "leafbench_bench_state{state=\"ready\"}") - 1.0).abs() < f64::EPSILON);
    let profile = "name = \"short\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\n\
                   to_mm = 4.0\nduration_s = 1.5\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 0.0\nduration_s = 1.5\n";
    let order = serde_json::json!({ "profile": profile }).to_string();
    let (status, body) = request(&daemon, &post_head(&daemon, "/api/run"), &order);
    assert_eq!(status, 202, "{body}");
    until("the error of the twin", || {
        metrics(&daemon)
            .contains("\nleafbench_twin_error_newtons ")
            .then_some(())
    });
    let after = until("the end of the run", || {
        let text = metrics(&daemon);
        let over = ["completed", "stopped", "aborted"]
            .iter()
            .map(|result| figure(&text, &format!("leafbench_runs_total{{result=\"{result}\"}}")))
            .sum::<f64>();
        (over > 0.5).then_some(text)
    });
    let rises = |name: &str| figure(&after, name) - figure(&before, name);
    assert!(rises("leafbench_samples_total") > 1000.0);
    assert!(rises("leafbench_control_lateness_seconds_count") > 1000.0);
    assert!(figure(&after, "leafbench_disk_free_bytes") > 0.0);
}

#[test]
fn doctor_ends_with_1_where_a_problem_is_and_names_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let (report, code) = json(folder.path(), &["doctor", "--link", "serial:/dev/no-such-port"]);
    assert_eq!(code, 1, "{report}");
    let findings = report["findings"].as_array().expect("a list");
    let port = findings.iter().find(|f| f["subject"] == "serial port");
    let port = port.unwrap_or_else(|| panic!("{report}"));
    assert_eq!(
        (&port["grade"], &port["place"]),
        (&"problem".into(), &"/dev/no-such-port".into())
    );
    let (report, code) = json(folder.path(), &["doctor"]);
    assert_eq!(code, i32::from(report["problems"] != 0), "{report}");
}

/// The unit and what the package puts beside it name only what the program has.
#[test]
fn the_unit_starts_the_daemon_with_arguments_that_it_has() {
    let unit = Path::new(env!("CARGO_MANIFEST_DIR")).join("packaging/leafbench.service");
    let unit = std::fs::read_to_string(unit).expect("in the repository");
    let line = unit
        .lines()
        .find_map(|line| line.strip_prefix("ExecStart=/usr/bin/leafbench "));
    let mut arguments: Vec<&str> = line.expect("a command").split_whitespace().collect();
    arguments.push("--help");
    let help = leafbench(&arguments).output().expect("leafbench starts");
    assert!(help.status.success(), "{arguments:?}");
    for wanted in [
        "Type=notify",
        "WatchdogSec=2",
        "LimitRTPRIO=50",
        "LimitMEMLOCK=infinity",
    ] {
        assert!(unit.lines().any(|line| line == wanted), "{wanted}");
    }
}
