//! `leafbench demo`: its table and files, and the whole story of the concealed effect.

use super::support::leafbench;
use std::path::Path;

use crate::config::Bench;
use serde_json::Value;

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("not a number: {value}"))
}

/// Ramp and sine end, lose nothing, reach their targets and are followed by the twin.
fn check_rows(demo: &Value) {
    let [ramp, sine] = [&demo["rows"][0], &demo["rows"][1]];
    for row in [ramp, sine] {
        assert_eq!(row["ending"], "completed");
        assert_eq!(row["lost"], 0);
    }
    // 2000 N within 5 N; a sample every millisecond for 120 s, both ends included.
    assert!((number(&ramp["peak_force_n"]) - 2000.0).abs() < 5.0);
    assert_eq!(ramp["samples"], 120_001);
    // The amplitude is within 1 % by the fifth counted cycle.
    assert!(number(&sine["amplitude_error"]).abs() < 0.01);
    assert!(number(&sine["twin_nrmse"]) < 0.05);
}

/// The files of ramp and sine; the CSV has a row each millisecond.
fn check_files(folder: &Path) {
    let csv = std::fs::read_to_string(folder.join("static-ramp.csv")).expect("written");
    let time = |row: &str| row.split(',').next().and_then(|t| t.parse::<f64>().ok());
    let times: Vec<f64> = csv
        .lines()
        .skip(1)
        .map(|row| time(row).expect("a time"))
        .collect();
    assert!(times.len() >= 120_001);
    let is_regular = |pair: &[f64]| (pair[1] - pair[0] - 0.001).abs() < 1e-6;
    assert!(times.windows(2).all(is_regular));
    for file in [
        "static-ramp.datapackage.json",
        "sine-6mm-1hz.cycles.csv",
        "sine-6mm-1hz-mean-loop.csv",
    ] {
        assert!(folder.join(file).is_file(), "{file}");
    }
}

/// What was concealed is named, its size is found, and the twin with the written file follows a new motion as one
/// that is told the truth.
fn check_story(story: &Value, folder: &Path) {
    let concealed = &story["concealed"];
    assert_eq!(story["name_check"], "right", "{story:#}");
    assert_eq!(story["named"], serde_json::json!([concealed["code"]]));
    assert_eq!(story["settled"], true, "{story:#}");
    // The improved file has the size that was drawn, and the twin's figures are those of this file.
    let improved = Bench::load(&folder.join("diagnosis/improved.toml")).expect("runs as it is");
    let effect = &improved.model.effects[0];
    assert_eq!(concealed["code"], effect.code.as_str());
    for parameter in &concealed["parameters"].as_array().expect("a list")[..2] {
        let name = parameter["name"].as_str().expect("a name");
        let (concealed, found) = (number(&parameter["value"]), effect.parameters[name]);
        assert!(
            (found / concealed - 1.0).abs() < 0.05,
            "{name}: {found} for {concealed}"
        );
    }
    let fresh = &story["fresh"];
    let recorded = story["recorded"].as_array().expect("a list");
    assert!(
        recorded.iter().all(|run| run["profile"] != fresh["profile"]),
        "{story:#}"
    );
    let [before, after, truth] =
        [&fresh["before"], &fresh["after"], &fresh["truth"]].map(|twin| number(&twin["nrmse"]));
    assert!(
        number(&fresh["noise_nrmse"]) < truth,
        "no twin is below the noise: {fresh:#}"
    );
    assert!(before > 10.0 * after, "{before} before, {after} after");
    assert!(after < 1.5 * truth, "{after} after, {truth} with the true model");
}

/// The page has every picture, and every link leads to a file.
fn check_page(folder: &Path) {
    let page = std::fs::read_to_string(folder.join("index.html")).expect("written");
    // Two loops; the loop and the residual of the mismatch; loop and residual before and after.
    assert_eq!(page.matches("<svg").count(), 6);
    for wanted in [
        "1. Concealed",
        "2. Recorded",
        "3. Diagnosed",
        "The answer is right",
        "4. Before and after",
    ] {
        assert!(page.contains(wanted), "{wanted}");
    }
    let links: Vec<&str> = page
        .split("href=\"")
        .skip(1)
        .filter_map(|rest| rest.split('"').next())
        .collect();
    assert!(links.len() >= 10, "{links:?}");
    for link in links {
        assert!(folder.join(link).is_file(), "{link}");
    }
    assert!(!page.contains("NaN"));
}

#[test]
fn the_demo_runs_loops_and_finds_what_it_concealed() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = leafbench(&["demo", "--json", "--out"])
        .arg(folder.path())
        .output()
        .expect("starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    let demo: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    check_rows(&demo);
    check_files(folder.path());
    check_story(&demo["story"], folder.path());
    check_page(folder.path());
}
