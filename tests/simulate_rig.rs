//! `leafbench simulate --rig`: an own profile on the mock rig in virtual time, as a run would record it.

use std::path::Path;

use super::support::{leafbench, run};
use crate::recording::{Recording, csv};

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
    check_files(folder.path());
}

/// Four CSVs and three data packages, no scratch folder; and none of them is replaced.
fn check_files(folder: &Path) {
    assert_eq!(std::fs::read_dir(folder).expect("a folder").count(), 7);
    let path = folder.join("rig.csv");
    let refused = run(&[
        "simulate",
        "sine-6mm-2.5hz-10",
        "--rig",
        "--out",
        path.to_str().expect("UTF-8"),
    ]);
    assert_eq!(refused.status.code(), Some(2), "it is there already");
}

#[test]
fn a_run_in_virtual_time_counts_no_minutes_down_that_nobody_waits_for() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = leafbench(&["simulate", "static-ramp", "--rig", "--out"])
        .arg(folder.path().join("ramp.csv"))
        .output()
        .expect("starts");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{said}");
    // The ramp lasts two minutes of bench time and some seconds of computing.
    assert!(!said.contains("min"), "{said}");
}
