//! Run files as a user meets them: damaged ones over HTTP and in lists, names that come from inside a file, access rights.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use super::support::{Daemon, PATIENCE, json, run};
use crate::recording::Recorder;
use crate::recording::run_file::RunFileWriter;
use crate::recording::run_file::test_support::{header, outcome, sample};

/// Samples of the run files of these tests: three blocks.
const SAMPLES: u64 = 5000;

/// A closed run with this id; `name` is the name of its file.
fn run_file(folder: &Path, name: &str, run_id: &str) -> PathBuf {
    let path = folder.join(name).with_extension("leafrun");
    let mut head = header();
    head.run_id = run_id.to_owned();
    let mut writer = RunFileWriter::create(&path, &head).expect("made");
    writer.begin(&head);
    for tick in 0..SAMPLES {
        writer.sample(&sample(tick));
    }
    writer.end(&outcome(SAMPLES));
    path
}

/// Changes one byte in the middle of the samples of the first block.
fn damage(path: &Path) {
    let mut bytes = std::fs::read(path).expect("read");
    // Load-cell counts and LVDT counts of tick 600, as they stand in a record.
    let s = sample(600);
    let mut wanted = s.force_counts.to_le_bytes().to_vec();
    wanted.extend(s.displacement_counts.to_le_bytes());
    let at = bytes.windows(8).position(|w| w == wanted).expect("the record");
    bytes[at] ^= 0x40;
    std::fs::write(path, bytes).expect("written");
}

/// GET of an address; status, head and body.
pub(super) fn get(daemon: &Daemon, path: &str) -> (u16, String, String) {
    let mut stream = TcpStream::connect(daemon.authority()).expect("the daemon listens");
    stream.set_read_timeout(Some(PATIENCE)).expect("set");
    let host = daemon.authority();
    write!(
        stream,
        "GET {path} HTTP/1.1\r\nHost: {host}\r\n{}Connection: close\r\n\r\n",
        daemon.bearer()
    )
    .expect("sent");
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).expect("answered");
    let answer = String::from_utf8_lossy(&answer).into_owned();
    let status = answer
        .split(' ')
        .nth(1)
        .and_then(|s| s.parse().ok())
        .expect("a status");
    let (head, body) = answer.split_once("\r\n\r\n").expect("a body");
    (status, head.to_owned(), body.to_owned())
}

#[test]
fn a_damaged_run_is_listed_as_damaged_and_not_served_as_if_it_were_whole() {
    let folder = tempfile::tempdir().expect("a folder");
    run_file(folder.path(), "whole", "whole");
    damage(&run_file(folder.path(), "broken", "broken"));
    let daemon = Daemon::ready(folder.path(), &[]);
    for listed in [
        json(folder.path(), &["runs"]).0,
        serde_json::from_str(&get(&daemon, "/api/runs").2).expect("JSON"),
    ] {
        let of = |id: &str| {
            let runs = listed.as_array().expect("a list").iter();
            runs.clone().find(|r| r["run_id"] == id).expect("listed").clone()
        };
        assert_eq!(of("whole")["ending"], "completed");
        let broken = of("broken");
        assert_eq!(broken["ending"], "damaged", "{broken}");
        assert!(
            broken["problem"].as_str().expect("text").contains("2048 samples"),
            "{broken}"
        );
    }
    assert_eq!(get(&daemon, "/api/runs/whole/csv").0, 200);
    let (status, _, body) = get(&daemon, "/api/runs/broken/csv");
    assert_eq!(status, 409, "{body}");
    assert!(
        body.contains("2048 samples") && body.contains("partial=1"),
        "{body}"
    );
    let (status, head, body) = get(&daemon, "/api/runs/broken/csv?partial=1");
    assert_eq!(status, 200, "{body}");
    assert_eq!(body.lines().count() as u64, SAMPLES - 2048 + 1);
    assert!(head.to_lowercase().contains("leafbench-partial: "), "{head}");
    assert!(head.contains("broken-partial.csv"), "{head}");
    for (format, mark) in [("mf4", "MDF     4.10"), ("parquet", "PAR1")] {
        let (status, head, body) = get(&daemon, &format!("/api/runs/whole/{format}"));
        assert_eq!(status, 200, "{body}");
        assert!(
            body.starts_with(mark) && head.contains(&format!("whole.{format}")),
            "{head}"
        );
        assert_eq!(get(&daemon, &format!("/api/runs/broken/{format}")).0, 409);
    }
    let (_, _, detail) = get(&daemon, "/api/runs/broken");
    assert!(detail.contains("\"damaged\""), "{detail}");
}

#[test]
fn a_run_id_from_inside_a_file_never_leads_out_of_the_folder() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, id) in [
        ("up", "../escaped"),
        ("absolute", "/tmp/leafbench-escaped"),
        ("line", "a\"\r\nX: 1"),
    ] {
        let file = run_file(folder.path(), name, id);
        let out = folder.path().join("out");
        let exported = run(&[
            "export",
            file.to_str().expect("UTF-8"),
            "--out",
            out.to_str().expect("UTF-8"),
        ]);
        assert_eq!(exported.status.code(), Some(2), "{name}: {exported:?}");
        let said = String::from_utf8_lossy(&exported.stderr).into_owned();
        assert!(said.contains("run id"), "{said}");
    }
    assert!(!folder.path().join("escaped.csv").exists());
    assert!(!Path::new("/tmp/leafbench-escaped.csv").exists());
}

/// The access rights of every file below a folder.
fn rights(folder: &Path, into: &mut Vec<(PathBuf, u32)>) {
    for entry in std::fs::read_dir(folder).expect("listed") {
        let entry = entry.expect("an entry");
        let mode = entry.metadata().expect("read").permissions().mode() & 0o777;
        into.push((entry.path(), mode));
        if entry.path().is_dir() {
            rights(&entry.path(), into);
        }
    }
}

#[test]
fn other_users_cannot_read_recordings_exports_and_the_files_of_the_daemon() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let daemon = Daemon::ready(&data, &[]);
    let (started, code) = json(&data, &["run", "static-ramp-12s"]);
    assert_eq!(code, 0, "{started}");
    let out = folder.path().join("out");
    let (exported, code) = json(
        &data,
        &["export", "latest", "--out", out.to_str().expect("UTF-8")],
    );
    assert_eq!(code, 0, "{exported}");
    let mut found = Vec::new();
    rights(folder.path(), &mut found);
    // Where the daemon listens is for all users of the computer: they show tokens of their own.
    let (listens, secret): (Vec<_>, Vec<_>) = found
        .iter()
        .partition(|(path, _)| path.ends_with("data/daemon.json"));
    assert!(listens.iter().all(|(_, mode)| *mode == 0o644), "{listens:?}");
    let open: Vec<_> = secret.iter().filter(|(_, mode)| mode & 0o077 != 0).collect();
    assert!(open.is_empty(), "others can read or write {open:?}");
    assert!(found.len() > 5, "{found:?}");
    drop(daemon);
}
