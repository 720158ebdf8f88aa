//! A daemon and commands in a hostile neighbourhood: a taken port, floods of connections, pipes and devices in place of files.

use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{ExitStatus, Stdio};
use std::time::{Duration, Instant};

use nix::sys::stat::Mode;

use super::support::http::{post_head, request};
use super::support::{Daemon, Process, json, leafbench, until};

/// Half-open connections of the flood: more than any daemon of one bench has clients.
const FLOOD: usize = 1135;
/// Time within which a stop is answered, also under the flood.
const STOP_LIMIT: Duration = Duration::from_millis(100);

/// Starts a daemon that must refuse, and waits for its end.
fn refused_daemon(data: &Path, listen: &str) -> (ExitStatus, String) {
    let mut child = leafbench(&["daemon", "--listen", listen, "--data"]);
    let child = child.arg(data).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = Process(child.spawn().expect("starts"));
    let status = until("the end of a daemon that cannot serve", || {
        child.0.try_wait().expect("a child")
    });
    let mut said = String::new();
    let stderr = child.0.stderr.take().expect("piped");
    std::io::Read::read_to_string(&mut { stderr }, &mut said).expect("read");
    (status, said)
}

#[test]
fn a_daemon_on_a_taken_port_says_so_and_releases_rig_and_folder() {
    let taken = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = taken.local_addr().expect("an address").to_string();
    let folder = tempfile::tempdir().expect("a folder");
    let (status, said) = refused_daemon(folder.path(), &address);
    assert_eq!(status.code(), Some(2), "{said}");
    assert!(said.contains(&format!("cannot listen on {address}")), "{said}");
    assert!(!folder.path().join("daemon.json").exists());
    // The folder is free for the next daemon.
    Daemon::ready(folder.path(), &[]);
}

#[test]
fn a_daemon_that_cannot_say_where_it_listens_ends() {
    let folder = tempfile::tempdir().expect("a folder");
    // A folder in place of the file cannot be replaced.
    std::fs::create_dir_all(folder.path().join("daemon.json/x")).expect("made");
    let (status, said) = refused_daemon(folder.path(), "127.0.0.1:0");
    assert_eq!(status.code(), Some(2), "{said}");
    assert!(said.contains("daemon.json cannot be used"), "{said}");
}

#[test]
fn a_stop_is_answered_at_once_beside_a_thousand_half_open_requests() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let mut flood = Vec::new();
    for _ in 0..FLOOD {
        let mut half = TcpStream::connect(daemon.authority()).expect("accepted");
        // The daemon may have closed it already.
        let _ = half.write_all(b"POST /api/run HTTP/1.1\r\nHost: ");
        flood.push(half);
    }
    let head = post_head(&daemon, "/api/stop");
    let mut took: Vec<Duration> = (0..21)
        .map(|_| {
            let begun = Instant::now();
            let (status, body) = request(&daemon, &head, "{}");
            assert_eq!(status, 200, "{body}");
            begun.elapsed()
        })
        .collect();
    took.sort_unstable();
    eprintln!("stops beside {FLOOD} half-open requests: {took:?}");
    // The median, because another process may hold this machine for longer once.
    assert!(took[10] < STOP_LIMIT, "{took:?}");
}

#[test]
fn a_pipe_among_the_profiles_is_listed_with_its_problem_and_blocks_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let profiles = folder.path().join("profiles");
    std::fs::create_dir(&profiles).expect("made");
    nix::unistd::mkfifo(&profiles.join("pipe.toml"), Mode::S_IRWXU).expect("made");
    let data = folder.path().join("data");
    let daemon = Daemon::start(&data, &["--profiles", profiles.to_str().expect("UTF-8")]);
    let head = format!("GET /api/profiles HTTP/1.1\r\nHost: {}\r\n", daemon.authority());
    let (status, body) = request(&daemon, &head, "");
    assert_eq!(status, 200, "{body}");
    assert!(body.contains("it is a pipe: give a regular file"), "{body}");
}

#[test]
fn commands_refuse_pipes_and_devices_in_place_of_files() {
    let folder = tempfile::tempdir().expect("a folder");
    let pipe = folder.path().join("pipe.toml");
    nix::unistd::mkfifo(&pipe, Mode::S_IRWXU).expect("made");
    let pipe = pipe.to_str().expect("UTF-8");
    let cases: [&[&str]; 9] = [
        &["plan", "static-ramp", "--bench", "/dev/zero"],
        &["plan", "static-ramp", "--bench", pipe],
        &["plan", pipe],
        &["simulate", pipe, "--out", "unused.csv"],
        &["identify", "--model", "equivalent", pipe],
        &["identify", "--model", "equivalent", "--targets", pipe],
        &["diagnose", pipe],
        &["diagnose", "--targets", "/dev/zero"],
        &["diagnose", "--bench", pipe, "unused.csv"],
    ];
    for arguments in cases {
        let child = leafbench(arguments).stderr(Stdio::piped()).spawn();
        let mut child = Process(child.expect("starts"));
        let what = format!("the end of {arguments:?}");
        let status = until(&what, || child.0.try_wait().expect("a child"));
        let mut said = String::new();
        let stderr = child.0.stderr.take().expect("piped");
        std::io::Read::read_to_string(&mut { stderr }, &mut said).expect("read");
        assert_eq!(status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains("give a regular file"), "{arguments:?}: {said}");
    }
    // The file by which a command finds its daemon.
    let data = folder.path().join("data");
    std::fs::create_dir(&data).expect("made");
    nix::unistd::mkfifo(&data.join("daemon.json"), Mode::S_IRWXU).expect("made");
    assert_eq!(json(&data, &["status"]).1, 3);
}
