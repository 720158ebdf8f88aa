//! The whole chain as processes in real time: a daemon whose rig conceals an effect, runs, export, `diagnose`, and a
//! daemon whose twin is the improved model, beside the same rig.

use std::path::{Path, PathBuf};

use super::support::bench::{concealing, twin_nrmse};
use super::support::{Daemon, config, json, run};
use crate::config::Bench;
use crate::recording::Sample;
use crate::recording::run_file::{EXTENSION, RunFile};

/// A shared machine may stop the daemon for longer than the bench's limits allow. The run is then repeated.
const ATTEMPTS: usize = 10;
const SLOW: &str = "static-ramp-12s";
const QUICK: &str = "sine-6mm-2.5hz-10";

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// A daemon on `bench`, in a folder of its own.
fn daemon(folder: &Path, bench: &Bench) -> Daemon {
    std::fs::create_dir_all(folder).expect("scratch folder is writable");
    let file = folder.join("bench.toml");
    std::fs::write(&file, bench.to_toml()).expect("scratch folder is writable");
    let profiles = config("profiles");
    Daemon::ready(
        &folder.join("data"),
        &["--bench", text(&file), "--profiles", text(&profiles)],
    )
}

/// Runs a profile to its end; the run's id and samples. A run that the machine disturbed is repeated.
fn measured(daemon: &Daemon, profile: &str) -> (String, Vec<Sample>) {
    let mut causes = Vec::new();
    for _ in 0..ATTEMPTS {
        let (ended, code) = json(&daemon.data, &["run", profile]);
        let id = ended["run_id"].as_str().unwrap_or_else(|| panic!("{ended}"));
        let file =
            RunFile::open(&daemon.data.join(format!("{id}.{EXTENSION}"))).expect("the run's file opens");
        daemon.back_to_ready();
        if code == 0 {
            return (id.to_owned(), file.samples().collect());
        }
        causes.push(file.outcome().expect("the run ended").cause.clone());
    }
    panic!("{profile} was disturbed {ATTEMPTS} times: {causes:?}");
}

fn exported(daemon: &Daemon, run_id: &str, folder: &Path) -> PathBuf {
    let (written, code) = json(&daemon.data, &["export", run_id, "--out", text(folder)]);
    assert_eq!(code, 0, "{written}");
    PathBuf::from(written["csv"].as_str().expect("a path"))
}

#[test]
fn a_daemon_s_runs_are_diagnosed_and_the_improved_twin_follows_the_rig() {
    let folder = tempfile::tempdir().expect("a folder");
    // A helper leaf makes contact within the travel of the sine. The daemon's model does not have it.
    let mut bench = concealing(
        "progressive_stiffness",
        &[
            ("extra_rate_n_per_mm", 15.0),
            ("knee_mm", 18.0),
            ("width_mm", 0.5),
        ],
    );
    (
        bench.link.queue_lead_ms,
        bench.link.silence_ms,
        bench.limits.lease_ms,
    ) = (200, 200, 200);
    let (before, said) = {
        let daemon = daemon(&folder.path().join("before"), &bench);
        let (slow, _) = measured(&daemon, SLOW);
        let (quick, samples) = measured(&daemon, QUICK);
        for id in [&slow, &quick] {
            exported(&daemon, id, &folder.path().join("loops"));
        }
        let loops = |id: &str| folder.path().join("loops").join(format!("{id}.csv"));
        let bench_file = folder.path().join("before/bench.toml");
        let ran = run(&[
            "diagnose",
            "--bench",
            text(&bench_file),
            "--out",
            text(&folder.path().join("out")),
            text(&loops(&slow)),
            text(&loops(&quick)),
        ]);
        assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
        let said = String::from_utf8_lossy(&ran.stdout).into_owned();
        (twin_nrmse(&samples), said)
    };
    let read = |name: &str| std::fs::read_to_string(folder.path().join("out").join(name)).expect("written");
    let diagnosis: serde_json::Value = serde_json::from_str(&read("diagnosis.json")).expect("JSON");
    let codes: Vec<&str> = (diagnosis["effects"].as_array().expect("a list").iter())
        .filter_map(|e| e["code"].as_str())
        .collect();
    assert!(codes.contains(&"progressive_stiffness"), "{codes:?}: {said}");

    // The rig stays what it is; only the model of the daemon's twin is improved.
    let improved = Bench::load(&folder.path().join("out/improved.toml")).expect("runs as it is");
    let taught = Bench {
        specimen: bench.specimen,
        ..improved
    };
    let daemon = daemon(&folder.path().join("after"), &taught);
    let after = twin_nrmse(&measured(&daemon, QUICK).1);
    assert!(
        after < 0.5 * before,
        "twin's error over {QUICK}: {before:.5} before, {after:.5} after"
    );
}
