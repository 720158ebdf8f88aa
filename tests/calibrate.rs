//! `leafbench calibrate`: a load cell that is off by gain and curvature, from its points to a bench that measures by the new file; and
//! the walk at a running daemon, interrupted and continued.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdin, Command, Output, Stdio};

use super::support::bench::{mock, play};
use super::support::{Daemon, Process, http, json, leafbench, until};
use crate::config::Bench;
use crate::recording::Sample;

/// Ramps to each level, and holds at which the reading settles: zero, five levels up, four down, zero.
fn staircase() -> String {
    let levels = [0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 20.0, 15.0, 10.0, 5.0, 0.0];
    let mut text = "name = \"staircase\"\ncontrol = \"displacement\"\n[[block]]\n".to_owned();
    for level in levels {
        text += &format!(
            "[[block.segment]]\nkind = \"ramp\"\nto_mm = {level:?}\nduration_s = 1.0\n\
             [[block.segment]]\nkind = \"hold\"\nduration_s = 1.5\n"
        );
    }
    text
}

/// The mock bench with these settings of its load cell.
fn with_load_cell(settings: &str) -> Bench {
    let mut bench = mock();
    bench.mock_rig.insert(
        "load_cell".to_owned(),
        settings.parse::<toml::Table>().expect("TOML").into(),
    );
    bench
}

/// Mean over the last second of each hold: every second segment.
fn at_holds(samples: &[Sample], value: fn(&Sample) -> f64) -> Vec<f64> {
    (1..=11)
        .map(|hold| {
            let held: Vec<f64> = samples
                .iter()
                .filter(|s| s.segment == 2 * hold)
                .map(value)
                .collect();
            let last = &held[held.len() - 1000..];
            last.iter().sum::<f64>() / 1000.0
        })
        .collect()
}

fn write_bench(bench: &Bench, folder: &Path, calibration: Option<&Path>) -> PathBuf {
    let mut text = bench.to_toml();
    if let Some(file) = calibration {
        let (before, rest) = text.split_once("[force_channel]\n").expect("a table");
        let (_, after) = rest.split_once("\n[").expect("another table");
        text = format!(
            "{before}[force_channel]\ncalibration = \"{}\"\n\n[{after}",
            file.display()
        );
    }
    let path = folder.join(if calibration.is_some() {
        "after.toml"
    } else {
        "before.toml"
    });
    std::fs::write(&path, text).expect("written");
    path
}

fn calibrate(arguments: &[&str], folder: &Path) -> Command {
    let mut command = leafbench(&[
        "calibrate",
        "--json",
        "--serial",
        "0041",
        "--reference-uncertainty",
        "0.1",
    ]);
    command.args(arguments).current_dir(folder);
    command
}

fn result(output: &Output) -> serde_json::Value {
    assert_eq!(
        output.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// Relative to the truth at the holds above zero, with the zero taken off, in percent.
fn worst_error_percent(measured: &[f64], truth: &[f64]) -> f64 {
    let error = |(m, t): (&f64, &f64)| (100.0 * (m - measured[0] - (t - truth[0])) / t).abs();
    let loaded = measured.iter().zip(truth).filter(|(_, t)| **t > 100.0);
    loaded.map(error).fold(0.0, f64::max)
}

/// The points as a technician writes them down.
fn points_csv(truth: &[f64], readings: &[f64]) -> String {
    let mut points = "direction,reference_n,reading_n\n".to_owned();
    for (k, (t, r)) in truth.iter().zip(readings).enumerate() {
        points += &format!("{},{t},{r}\n", if k <= 5 { "up" } else { "down" });
    }
    points
}

/// Who reads a CSV learns which sensor it was and by which calibration.
fn check_identity(csv: &Path, bench: &Bench) {
    let package = csv.with_extension("datapackage.json");
    let text = std::fs::read_to_string(package).expect("written");
    let package: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let sensor = &package["leafbench"]["calibration"]["force_n"];
    assert_eq!(sensor["certificate"], "LC-7", "{sensor:#}");
    assert_eq!(sensor["serial"], "0041", "{sensor:#}");
    assert_eq!(
        sensor["file_sha256"],
        bench.force_channel.sensor().file_sha256.as_str()
    );
    assert!(sensor["curve"][0].as_f64().expect("a factor") < 0.0, "{sensor:#}");
}

#[test]
fn a_load_cell_with_wrong_gain_and_curvature_measures_right_by_its_new_file() {
    let folder = tempfile::tempdir().expect("a folder");
    // The same motion, as the LVDT controls it: the cell without error shows the true force, to half a count.
    let (true_run, _) = play(&with_load_cell("noise_rms_counts = 0.0"), &staircase(), None);
    let wrong = with_load_cell("noise_rms_counts = 5.0\ngain = 1.02\ncurvature = 0.06\nzero_counts = 30.0");
    let (found_run, _) = play(&wrong, &staircase(), None);
    let truth = at_holds(&true_run.samples, |s| s.force_n);
    let readings = at_holds(&found_run.samples, |s| 0.1 * f64::from(s.force_counts));
    assert!(worst_error_percent(&readings, &truth) > 2.5);

    assert!(truth[0].abs() < 0.06 && truth[10].abs() < 0.06, "{truth:?}");
    std::fs::write(folder.path().join("points.csv"), points_csv(&truth, &readings)).expect("written");
    let before = write_bench(&wrong, folder.path(), None);
    let arguments = [
        "--channel",
        "force",
        "--certificate",
        "LC-7",
        "--points",
        "points.csv",
        "--out",
        "cell.toml",
        "--bench",
    ];
    let mut command = calibrate(&arguments, folder.path());
    let done = result(&command.arg(&before).output().expect("starts"));
    assert_eq!(
        done["polynomial"].as_array().expect("factors").len(),
        3,
        "a square, no cube: {done:#}"
    );
    assert!(
        done["as_found_percent"].as_f64().expect("a number").abs() > 2.5,
        "{done:#}"
    );
    assert_eq!(
        done["class"], "ISO 7500-1 class 1, of 1 series in place of 3",
        "{done:#}"
    );

    // A second one never replaces the first.
    let again = calibrate(&arguments, folder.path())
        .arg(&before)
        .output()
        .expect("starts");
    assert_eq!(again.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&again.stderr).contains("is there already"));

    let after =
        Bench::load(&write_bench(&wrong, folder.path(), Some(Path::new("cell.toml")))).expect("a bench");
    assert_eq!(
        done["calibration_hash"],
        format!("{:#010x}", after.calibration_hash())
    );
    let (right_run, csv) = play(&after, &staircase(), Some(folder.path()));
    let corrected = at_holds(&right_run.samples, |s| s.force_n);
    assert!(worst_error_percent(&corrected, &truth) < 0.1);

    check_identity(&csv.expect("exported"), &after);
}

#[test]
fn a_calibration_that_cannot_be_right_is_refused_before_a_file_is_written() {
    let folder = tempfile::tempdir().expect("a folder");
    for (points, more, wanted) in [
        (
            "direction,reference_n,reading_n\nup,0,0\nup,500,510\n",
            None,
            "2 points are too few",
        ),
        (
            "direction,reference_n,reading_n\nup,0,0\nup,500,5100\nup,900,9200\ndown,0,0\n",
            None,
            "its slope",
        ),
        (
            "direction,reference_n\nup,0\n",
            None,
            "the points have 1 rows, and the calibration has 11 steps",
        ),
        ("direction,reference_n\n", Some("20000"), "--max 20000 is outside"),
    ] {
        std::fs::write(folder.path().join("points.csv"), points).expect("written");
        let arguments = [
            "--channel",
            "force",
            "--certificate",
            "LC-8",
            "--points",
            "points.csv",
            "--max",
        ];
        let output = calibrate(&arguments, folder.path())
            .arg(more.unwrap_or("2000"))
            .output()
            .expect("starts");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(wanted), "{said}");
        assert!(!folder.path().join("LC-8.toml").exists());
    }
}

/// A walk at a daemon, with a test in place of the technician.
struct Walk {
    process: Process,
    stdin: Option<ChildStdin>,
    said: BufReader<ChildStderr>,
}

impl Walk {
    fn start(daemon: &Daemon, folder: &Path) -> Walk {
        let mut command = calibrate(
            &[
                "--channel",
                "displacement",
                "--certificate",
                "LV-3",
                "--levels",
                "2",
                "--max",
                "2",
                "--data",
            ],
            folder,
        );
        let mut child: Child = command
            .arg(&daemon.data)
            .args(["--bench", folder.join("bench.toml").to_str().expect("UTF-8")])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("starts");
        Walk {
            stdin: child.stdin.take(),
            said: BufReader::new(child.stderr.take().expect("piped")),
            process: Process(child),
        }
    }

    /// The next line that begins with one of these.
    fn until_said(&mut self, wanted: &[&str]) -> String {
        let mut all = String::new();
        loop {
            let mut line = String::new();
            let length = self.said.read_line(&mut line).expect("UTF-8");
            assert!(length > 0, "it ended: {all}");
            if wanted.iter().any(|w| line.trim_start().starts_with(w)) {
                return line;
            }
            all += &line;
        }
    }

    /// Brings the rig to `level_mm` of the true scale, whose readings are 1 % high, and takes the point.
    fn take(&mut self, daemon: &Daemon, level_mm: f64) {
        loop {
            let at_mm = bring(daemon, 1.01 * level_mm);
            writeln!(self.stdin.as_mut().expect("open"), "{}", at_mm / 1.01).expect("taken");
            // A rig that unloads meanwhile is not still: it is brought there again.
            if self
                .until_said(&["taken:", "the reading moves", "there was no second"])
                .contains("taken:")
            {
                return;
            }
        }
    }
}

/// Jogs until the reading was near `reading_mm` and still for a whole second; its mean over that second.
fn bring(daemon: &Daemon, reading_mm: f64) -> f64 {
    let now = || daemon.status()["rig"]["displacement_mm"].as_f64();
    until("the place", || {
        let away = reading_mm - now()?;
        if away.abs() > 0.05 {
            json(&daemon.data, &["jog", &format!("{:.4}", away.clamp(-2.0, 2.0))]);
            // A further step while it moves would be added to this one.
            until("the end of the step", || {
                daemon.status()["rig"]["hold_left_s"].is_number().then_some(())
            });
        }
        let window: serde_json::Value = http::get_json(daemon, "/api/reading");
        let sensor = &window["displacement"];
        let mean_mm = 0.0005 * sensor["mean_counts"].as_f64()?;
        // The noise is one count; a rig that creeps spreads more.
        let still = window["samples"] == 1000 && sensor["sigma_counts"].as_f64()? < 1.5;
        (still && (mean_mm - reading_mm).abs() < 0.05).then_some(mean_mm)
    })
}

#[test]
fn a_walk_is_interrupted_continued_and_ends_with_a_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut bench = mock();
    bench.mock_rig.insert(
        "lvdt".to_owned(),
        "gain = 1.01".parse::<toml::Table>().expect("TOML").into(),
    );
    let path = folder.path().join("bench.toml");
    std::fs::write(&path, bench.to_toml()).expect("written");
    let daemon = Daemon::ready(
        &folder.path().join("data"),
        &["--bench", path.to_str().expect("UTF-8")],
    );

    let mut walk = Walk::start(&daemon, folder.path());
    assert!(
        walk.until_said(&["step"])
            .starts_with("step 1 of 5, series 1, up")
    );
    writeln!(walk.stdin.as_mut().expect("open"), "a lot").expect("taken");
    assert!(walk.until_said(&["\""]).contains("\"a lot\" is not a number"));
    walk.take(&daemon, 0.0);
    walk.take(&daemon, 1.0);
    drop(walk.stdin.take());
    assert_eq!(walk.process.0.wait().expect("ends").code(), Some(1));
    assert!(folder.path().join("LV-3.toml.part").is_file() && !folder.path().join("LV-3.toml").exists());

    let mut walk = Walk::start(&daemon, folder.path());
    assert!(
        walk.until_said(&["step"])
            .starts_with("step 3 of 5, series 1, up")
    );
    for level_mm in [2.0, 1.0, 0.0] {
        walk.take(&daemon, level_mm);
    }
    let status = walk.process.0.wait().expect("ends");
    let mut out = String::new();
    std::io::Read::read_to_string(walk.process.0.stdout.as_mut().expect("piped"), &mut out).expect("UTF-8");
    assert_eq!(status.code(), Some(0), "{out}");
    let done: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    let slope = done["polynomial"][1].as_f64().expect("a factor");
    // The reference is the reading of a second before: the rig creeps by less than 4 um between them, over 2 mm.
    assert!((slope * 1.01 - 1.0).abs() < 0.002, "{done:#}");
    assert!(folder.path().join("LV-3.toml").is_file() && !folder.path().join("LV-3.toml.part").exists());
}
