//! The twin watches its residual while the run goes on: told once, at the right place, and not where nothing is wrong.

use super::support;
use super::support::bench::{concealing, mock, play, sine, twin_nrmse};
use super::support::{Daemon, config, json, until};
use crate::recording::memory::Memory;
use crate::recording::{Event, EventKind};

fn told(memory: &Memory) -> Vec<&Event> {
    memory
        .events
        .iter()
        .filter(|e| e.kind == EventKind::ModelMismatch)
        .collect()
}

/// The numbers of an event's text between `from` and `mm`: displacement from and to.
fn interval(text: &str) -> [f64; 2] {
    let place = text
        .split(" from ")
        .nth(1)
        .and_then(|t| t.split(" mm").next())
        .expect("a place");
    let mut ends = place.split(" to ").map(|t| t.parse().expect("a number"));
    [ends.next().expect("from"), ends.next().expect("to")]
}

#[test]
fn a_twin_with_all_the_physics_tells_of_nothing() {
    let profiles = [
        sine("slow", 12.0, 0.5, 6),
        sine("fast", 6.0, 2.5, 20),
        "name = \"ramp\"\ncontrol = \"force\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\nto_n = 1500.0\nduration_s = 20.0\n\
         [[block.segment]]\nkind = \"ramp\"\nto_n = 0.0\nduration_s = 20.0\n"
            .to_owned(),
    ];
    for profile in &profiles {
        let (memory, _) = play(&mock(), profile, None);
        let head = memory.header.as_ref().map(|h| h.profile_name.clone());
        println!("{head:?}: twin {:.4} %", 100.0 * twin_nrmse(&memory.samples));
        assert!(told(&memory).is_empty(), "{head:?}: {:?}", told(&memory));
    }
    // Both sides with the same effect: still all the physics.
    let mut bench = concealing(
        "progressive_stiffness",
        &[("extra_rate_n_per_mm", 20.0), ("knee_mm", 9.0), ("width_mm", 0.5)],
    );
    bench.model = bench.specimen.model.clone();
    let (memory, _) = play(&bench, &profiles[0], None);
    assert!(told(&memory).is_empty(), "{:?}", told(&memory));
}

#[test]
fn a_helper_leaf_that_the_twin_lacks_is_told_of_once_where_it_takes_up_contact() {
    let bench = concealing(
        "progressive_stiffness",
        &[("extra_rate_n_per_mm", 20.0), ("knee_mm", 9.0), ("width_mm", 0.5)],
    );
    let (memory, _) = play(&bench, &sine("helper", 12.0, 0.5, 10), None);
    let events = told(&memory);
    assert_eq!(events.len(), 1, "{events:?}");
    println!("{:.2} s: {}", events[0].time_s, events[0].text);
    let [from, to] = interval(&events[0].text);
    // 14 mm is the top; the band of six deviations is left 0.4 mm beyond the knee.
    assert!((from - 9.0).abs() < 1.0 && to > 13.0, "{}", events[0].text);
    assert!(events[0].text.contains("above the twin"));
    // Within the first cycles, not at the end: one second of ramp, two a cycle.
    assert!(events[0].time_s < 8.0, "{}", events[0].time_s);
}

#[test]
fn lost_motion_is_told_of_after_the_reversal() {
    let bench = concealing("backlash", &[("gap_mm", 0.8)]);
    let (memory, _) = play(&bench, &sine("gap", 12.0, 0.5, 8), None);
    let events = told(&memory);
    assert_eq!(events.len(), 1, "{events:?}");
    println!("{}", events[0].text);
    // It begins with the way back: the spring waits for the gap to close.
    let [from, _] = interval(&events[0].text);
    let after = events[0]
        .text
        .split("ing, ")
        .nth(1)
        .and_then(|t| t.split(" mm to").next()?.split(" to").next());
    let after: f64 = after
        .and_then(|t| t.trim_end_matches(" mm").parse().ok())
        .expect("a distance");
    assert!(after < 1.0 && from < 14.0, "{}", events[0].text);
}

#[test]
fn a_mismatch_holds_the_run_where_the_bench_says_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut bench = concealing(
        "coulomb_friction",
        &[("friction_n", 60.0), ("transition_mm", 0.2)],
    );
    bench.daemon.model_mismatch = crate::config::MismatchAction::Hold;
    let file = folder.path().join("bench.toml");
    std::fs::write(&file, bench.to_toml()).expect("scratch folder is writable");
    let data = folder.path().join("data");
    let path = file.to_str().expect("UTF-8");
    let profiles = config("profiles");
    let daemon = Daemon::ready(
        &data,
        &["--bench", path, "--profiles", profiles.to_str().expect("UTF-8")],
    );
    let profile = folder.path().join("sine.toml");
    std::fs::write(&profile, sine("sine", 6.0, 1.0, 60)).expect("scratch folder is writable");
    // A run of a minute that is held within seconds.
    let mut run = support::leafbench(&["run", profile.to_str().expect("UTF-8"), "--json", "--data"])
        .arg(&data)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .expect("leafbench starts");
    let held = daemon.until_phase("held");
    let text = held["run"]["model_mismatch"].as_str().expect("told").to_owned();
    println!("{text}");
    assert!(text.contains("model mismatch"), "{held}");
    assert!(held["rig"]["elapsed_s"].as_f64().expect("a number") < 30.0);
    json(&data, &["stop"]);
    until("the run's end", || run.try_wait().ok().flatten());
}
