//! The command line as a technician and a script use it: in virtual time, and in real time against the mock rig in memory.

use super::support::{self, program};
use std::path::Path;

use super::support::{Daemon, config, json, leafbench, run};

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn run_without_a_daemon_says_how_to_start_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let report = folder.path().join("report.xml");
    let output = leafbench(&["run", "static-ramp", "--data"])
        .arg(folder.path())
        .arg("--junit")
        .arg(&report)
        .output()
        .expect("starts");
    assert_eq!(output.status.code(), Some(3));
    let said = text(&output.stderr);
    assert!(
        said.contains("leafbench daemon --bench bench-configs/benches/mock.toml"),
        "{said}"
    );
    let report = std::fs::read_to_string(report).expect("a report of a run that did not start");
    assert!(
        report.contains("<testcase classname=\"leafbench\" name=\"static-ramp\" time=\"0.000\">")
            && report.contains("errors=\"1\"")
            && report.contains("message=\"no daemon is running here"),
        "{report}"
    );
}

#[test]
fn usage_errors_and_unusable_input_are_two() {
    assert_eq!(run(&["fly"]).status.code(), Some(2));
    assert_eq!(run(&["plan"]).status.code(), Some(2));
    let output = run(&["plan", "no-such-profile"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        text(&output.stderr).contains("static-ramp"),
        "the message lists what there is"
    );
    assert_eq!(run(&["--help"]).status.code(), Some(0));
}

#[test]
fn plan_shows_the_margins_and_a_predicted_trip_is_one() {
    let output = run(&["plan", "static-ramp", "--json"]);
    assert_eq!(output.status.code(), Some(0));
    let plan: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    // The model reaches the force asked for to a tenth of a count.
    assert!((plan["force_max_n"].as_f64().expect("a number") - 2000.0).abs() < 0.02);
    assert_eq!(plan["trips"], serde_json::json!([]));

    let folder = tempfile::tempdir().expect("a folder");
    let far = folder.path().join("far.toml");
    let profile = "name = \"far\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\n\
                   to_mm = 44.0\nduration_s = 20.0\n";
    std::fs::write(&far, profile).expect("written");
    let output = run(&["plan", far.to_str().expect("UTF-8")]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stdout).contains("WOULD TRIP") && text(&output.stdout).contains("force_max_n"));
}

#[test]
fn simulate_writes_a_row_a_millisecond() {
    let folder = tempfile::tempdir().expect("a folder");
    let csv = folder.path().join("ramp.csv");
    let output = leafbench(&["simulate", "static-ramp-12s", "--out"])
        .arg(&csv)
        .output()
        .expect("starts");
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let rows = std::fs::read_to_string(&csv).expect("written");
    assert_eq!(rows.lines().count(), 12_001, "header and 12 s at 1 kHz");
    assert!(
        rows.lines()
            .next()
            .expect("a header")
            .starts_with("time_s,displacement_mm,force_n,command_n")
    );
}

/// Half a second up, half a second down.
fn short_profile(folder: &Path) -> String {
    let path = folder.join("short.toml");
    let text = "name = \"short\"\ncontrol = \"displacement\"\n[[block]]\n\
                [[block.segment]]\nkind = \"ramp\"\nto_mm = 3.0\nduration_s = 0.5\n\
                [[block.segment]]\nkind = \"ramp\"\nto_mm = 0.0\nduration_s = 0.5\n";
    std::fs::write(&path, text).expect("written");
    path.to_str().expect("UTF-8").to_owned()
}

/// The report for CI has one case, which passed, with the samples of the run.
fn assert_passed_in(report: &Path, ended: &serde_json::Value) {
    let report = std::fs::read_to_string(report).expect("written");
    let samples = format!("<property name=\"samples\" value=\"{}\"/>", ended["samples"]);
    assert!(
        report.contains(&samples) && report.contains("failures=\"0\" errors=\"0\""),
        "{report}"
    );
}

/// Exports the newest run to `out` and looks at the first bytes of the files; what the command says.
fn exported_in_all_formats(data: &Path, out: &Path) -> serde_json::Value {
    let out = out.to_str().expect("UTF-8");
    let order = ["export", "latest", "--format", "csv,parquet,mf4", "--out", out];
    let (written, code) = json(data, &order);
    assert_eq!(code, 0, "{written}");
    for (format, mark) in [("mf4", "MDF     "), ("parquet", "PAR1")] {
        let bytes = std::fs::read(written[format].as_str().expect("a path")).expect("written");
        assert!(bytes.starts_with(mark.as_bytes()), "{format}");
    }
    written
}

#[test]
fn a_technicians_day_tare_run_status_runs_export() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let daemon = Daemon::ready(&data, &[]);
    let (tare, _) = support::until("a still rig", || {
        Some(json(&data, &["tare"])).filter(|(_, code)| *code == 0)
    });
    assert!(tare["force_new_n"].as_f64().expect("a number").abs() < 50.0);

    let profile = short_profile(folder.path());
    let report = folder.path().join("report.xml");
    let (ended, code) = json(
        &data,
        &[
            "run",
            &profile,
            "--operator",
            "test",
            "--specimen",
            "samurai-front 7",
            "--junit",
            report.to_str().expect("UTF-8"),
        ],
    );
    assert_eq!(
        (code, &ended["ending"]),
        (0, &serde_json::json!("completed")),
        "{ended}"
    );
    assert_passed_in(&report, &ended);
    let run_id = ended["run_id"].as_str().expect("an id");
    assert_eq!(daemon.status()["run"]["state"], "ended");

    let (runs, _) = json(&data, &["runs"]);
    assert_eq!(runs[0]["run_id"], run_id);
    assert_eq!(runs[0]["specimen"], "samurai-front 7");
    let written = exported_in_all_formats(&data, &folder.path().join("out"));
    let csv = std::fs::read_to_string(written["csv"].as_str().expect("a path")).expect("written");
    assert_eq!(
        csv.lines().count() as u64,
        1 + written["rows"].as_u64().expect("rows")
    );
    assert_eq!(written["rows"], ended["samples"]);
    // The twin ran beside it: its column is filled in the rows.
    let header: Vec<&str> = csv.lines().next().expect("a header").split(',').collect();
    let twin = header
        .iter()
        .position(|c| *c == "twin_force_n")
        .expect("a column");
    let filled = csv
        .lines()
        .skip(1)
        .filter(|row| row.split(',').nth(twin).is_some_and(|v| !v.is_empty()));
    assert!(filled.count() > 500);
    let (refused, code) = json(&data, &["reset"]);
    assert_eq!(code, 4, "nothing is latched: {refused}");
}

#[test]
fn d8_a_second_daemon_is_refused_by_the_data_folder() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::start(folder.path(), &[]);
    let output = leafbench(&["daemon", "--listen", "127.0.0.1:0", "--data"])
        .arg(folder.path())
        .output();
    let output = output.expect("starts");
    assert_eq!(output.status.code(), Some(2));
    assert!(
        text(&output.stderr).contains("belongs to another daemon"),
        "{}",
        text(&output.stderr)
    );
    // The first one is undisturbed.
    daemon.until_phase("ready");
}

#[test]
fn a_daemon_beyond_loopback_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = leafbench(&["daemon", "--listen", "0.0.0.0:0", "--data"])
        .arg(folder.path())
        .output();
    let output = output.expect("starts");
    assert_eq!(output.status.code(), Some(2));
    let said = text(&output.stderr);
    assert!(said.contains("0.0.0.0:0") && said.contains("127.0.0.1"), "{said}");
}

#[test]
fn a_bench_file_with_a_wrong_key_is_refused_with_its_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let bench = folder.path().join("bench.toml");
    let good = std::fs::read_to_string(config("benches/mock.toml")).expect("shipped");
    let line = good.lines().position(|l| l.starts_with("force_max_n = "));
    let line = 1 + line.expect("the key is shipped");
    std::fs::write(&bench, good.replace("force_max_n", "force_max")).expect("written");
    let output = leafbench(&["plan", "static-ramp", "--bench"])
        .arg(&bench)
        .output()
        .expect("starts");
    assert_eq!(output.status.code(), Some(2));
    let said = text(&output.stderr);
    assert!(
        said.contains(&format!("line {line}")) && said.contains("`force_max`"),
        "{said}"
    );
}

/// A triangle of the equivalent spring (rate 80 N/mm, ratio 0.15, presliding 0.4 mm), stepped here and not by the fit.
fn recording_csv() -> String {
    use crate::model;
    let mut plant = model::find("equivalent")
        .and_then(|m| m.plant(&[0.0, 80.0, 0.15, 0.4], &toml::Table::new()))
        .expect("within bounds");
    let mut text = "time_s,displacement_mm,force_n\n".to_owned();
    for k in 0..=1600 {
        let phase = f64::from(k % 800) / 400.0;
        let x_mm = 2.0 + 8.0 * if phase <= 1.0 { phase } else { 2.0 - phase };
        let force_n = plant.step(x_mm, 0.01);
        text += &format!("{:.3},{x_mm:.6},{force_n:.6}\n", 0.01 * f64::from(k));
    }
    text
}

#[test]
fn identify_gives_parameters_back_and_writes_a_specimen() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let (recording, out) = (folder.path().join("a.csv"), folder.path().join("found.toml"));
    std::fs::write(&recording, recording_csv()).expect("written");
    let run = std::process::Command::new(program())
        .args([
            "identify",
            "--model",
            "equivalent",
            "--fix",
            "preload_n=0",
            "--json",
            "--out",
        ])
        .args([&out, &recording])
        .output()
        .expect("started");
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let found: serde_json::Value = serde_json::from_slice(&run.stdout).expect("JSON");
    let specimen = crate::config::Specimen::load(&out).expect("a specimen file");
    for (name, truth) in [
        ("rate_n_per_mm", 80.0),
        ("friction_ratio", 0.15),
        ("presliding_mm", 0.4),
    ] {
        let entry = found["parameters"]
            .as_array()
            .and_then(|all| all.iter().find(|p| p["name"] == name))
            .expect("listed");
        let value = entry["value"].as_f64().expect("a number");
        // No noise: what is left is the CSV's six decimals and the fit's own tolerance.
        assert!((value / truth - 1.0).abs() < 1e-4, "{name}: {value}");
        assert_eq!(specimen.model.parameters[name], value);
    }
}

#[test]
fn identify_refuses_bad_input_and_says_what_to_do() {
    let refused = |arguments: &[&str], word: &str| {
        let run = std::process::Command::new(program())
            .arg("identify")
            .args(arguments)
            .output()
            .expect("started");
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        assert_eq!(run.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(word), "{arguments:?}: {said}");
    };
    refused(&["--model", "equivalent"], "nothing to fit to");
    refused(&["a.csv"], "no model to fit");
    refused(&["--model", "wobble", "a.csv"], "no model is called \"wobble\"");
    refused(&["--model", "equivalent", "no-such-file.csv"], "no-such-file.csv");
    refused(&["--model", "equivalent", "--fix", "rate", "a.csv"], "NAME=VALUE");
    refused(
        &["--model", "equivalent", "--fix", "rte=3", "a.csv"],
        "has no parameter \"rte\"",
    );
}
