//! The twin reports a model mismatch during the run: once, at the right place, and never for a model that is right.

use super::support;
use super::support::bench::{concealing, mock, play, sine, twin_nrmse};
use super::support::{Daemon, config, json, until};
use crate::recording::memory::Memory;
use crate::recording::{Event, EventKind};

/// Largest NRMSE of a twin that has all the physics: noise of both sensors and the ripple of the servo.
const LARGEST_NRMSE: f64 = 0.005;

/// The reports of a model mismatch in a run.
fn reports(memory: &Memory) -> Vec<&Event> {
    memory
        .events
        .iter()
        .filter(|e| e.kind == EventKind::ModelMismatch)
        .collect()
}

/// The displacements in the text of an event, between "from" and "mm".
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
fn a_twin_with_all_the_physics_reports_nothing() {
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
        assert!(reports(&memory).is_empty(), "{head:?}: {:?}", reports(&memory));
        // The twin ran: without its forces there would be nothing to report either, and this error would be NaN.
        let error = twin_nrmse(&memory.samples);
        assert!(error < LARGEST_NRMSE, "{head:?}: {error}");
    }
    // Specimen and twin have the same effect: the twin still has all the physics.
    let mut bench = concealing(
        "progressive_stiffness",
        &[("extra_rate_n_per_mm", 20.0), ("knee_mm", 9.0), ("width_mm", 0.5)],
    );
    bench.model = bench.specimen.model.clone();
    let (memory, _) = play(&bench, &profiles[0], None);
    assert!(reports(&memory).is_empty(), "{:?}", reports(&memory));
    assert!(twin_nrmse(&memory.samples) < LARGEST_NRMSE);
}

#[test]
fn a_helper_leaf_that_the_twin_lacks_is_reported_once_where_it_makes_contact() {
    let bench = concealing(
        "progressive_stiffness",
        &[("extra_rate_n_per_mm", 20.0), ("knee_mm", 9.0), ("width_mm", 0.5)],
    );
    let (memory, _) = play(&bench, &sine("helper", 12.0, 0.5, 10), None);
    let events = reports(&memory);
    assert_eq!(events.len(), 1, "{events:?}");
    let [from, to] = interval(&events[0].text);
    // 14 mm is the top. The residual exceeds four standard deviations 0.3 mm beyond the knee.
    assert!((from - 9.0).abs() < 1.0 && to > 13.0, "{}", events[0].text);
    assert!(events[0].text.contains("above the twin"), "{}", events[0].text);
    // Within the first cycles and not at the end: two seconds of ramp, two per cycle.
    assert!(events[0].time_s < 8.0, "{}", events[0].time_s);
}

#[test]
fn lost_motion_is_reported_from_the_reversal_on() {
    let bench = concealing("backlash", &[("gap_mm", 0.8)]);
    let (memory, _) = play(&bench, &sine("gap", 12.0, 0.5, 8), None);
    let events = reports(&memory);
    assert_eq!(events.len(), 1, "{events:?}");
    // The spring stays while the gap closes, so the mismatch begins within the gap of a turning point: rest, 2 or 14 mm.
    let text = &events[0].text;
    let [from, to] = interval(text);
    let after = text.split("ing, ").nth(1).and_then(|t| t.split(" to ").next());
    let after: f64 = after.and_then(|t| t.parse().ok()).expect("a distance");
    let near = if text.contains("unloading") {
        14.0 - to
    } else {
        from
    };
    assert!(after < 1.0 && (-0.1..3.0).contains(&near), "{text}");
}

#[test]
fn a_mismatch_holds_the_run_if_the_bench_asks_for_it() {
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
    let mut run = support::leafbench(&["run", profile.to_str().expect("UTF-8"), "--json", "--data"])
        .arg(&data)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .expect("leafbench starts");
    let held = daemon.until_phase("held");
    let text = held["run"]["model_mismatch"]
        .as_str()
        .expect("a report")
        .to_owned();
    // The specimen has friction that the twin lacks, which resists the loading.
    assert!(text.contains(" N above the twin"), "{text}");
    // A run of a minute that was held within seconds.
    assert!(held["rig"]["elapsed_s"].as_f64().expect("a number") < 30.0);
    json(&data, &["stop"]);
    until("the run's end", || run.try_wait().ok().flatten());
}
