//! `leafbench diagnose` as a person calls it: it writes its files, the improved model runs, and errors say where and what to do.

use super::support::program;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::config::Bench;
use crate::effect::FORMS;
use crate::recording::Recording;
use crate::truth::{Case, World, sensors};

fn leafbench(arguments: &[&str]) -> Output {
    Command::new(program())
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("the program starts")
}

/// Writes recordings as CSV with every `every`th sample.
fn written(folder: &Path, recordings: &[Recording], every: usize) -> Vec<PathBuf> {
    let write = |recording: &Recording| {
        let path = folder.join(&recording.name);
        let text = sensors::csv(recording);
        let thinned: Vec<&str> = text
            .lines()
            .enumerate()
            .filter(|(i, _)| *i == 0 || i % every == 1 % every)
            .map(|(_, l)| l)
            .collect();
        std::fs::write(&path, thinned.join("\n")).expect("scratch folder is writable");
        path
    };
    recordings.iter().map(write).collect()
}

/// Two recordings of a case, every third sample: enough to check the files and not the digits.
fn files(folder: &Path, code: &str) -> Vec<PathBuf> {
    let case = Case::single(code, 2, 40.0).expect("visible");
    written(folder, &case.recordings[..2], 3)
}

#[test]
fn a_diagnosis_leaves_three_files_and_its_model_runs_in_the_simulator() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let recordings = files(folder.path(), "progressive_stiffness");
    let out = folder.path().join("out");
    let mut arguments = vec!["diagnose", "--out", out.to_str().expect("UTF-8")];
    arguments.extend(recordings.iter().map(|p| p.to_str().expect("UTF-8")));
    let ran = leafbench(&arguments);
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let json = std::fs::read_to_string(out.join("diagnosis.json")).expect("written");
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    // The fields of docs/formats.md.
    assert_eq!(json["verdict"], "missing_physics", "{json:#}");
    assert_eq!(json["effects"][0]["code"], "progressive_stiffness", "{json:#}");
    for list in ["effects", "alternatives", "location"] {
        assert!(json[list].is_array(), "{list}: {json:#}");
    }
    assert!(json.get("next_test").is_some(), "{json:#}");
    for error in [
        "nrmse_train",
        "nrmse_heldout",
        "peak_force_error",
        "loop_energy_error",
    ] {
        assert!(json["fit"]["baseline"][error].is_number() && json["fit"]["improved"][error].is_number());
    }
    assert!(json["fit"]["noise_floor_nrmse"].is_number());
    assert!(out.join("report.html").is_file());
    let csv = out.join("simulated.csv");
    let ran = leafbench(&[
        "simulate",
        "sine-6mm-1hz",
        "--bench",
        out.join("improved.toml").to_str().expect("UTF-8"),
        "--out",
        csv.to_str().expect("UTF-8"),
    ]);
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let rows = std::fs::read_to_string(&csv).expect("written").lines().count();
    // 50 cycles of 1 s at 1 kHz, and the ramps.
    assert!(rows > 50_000, "{rows} rows");
}

/// Runs `leafbench diagnose` into `out` and returns diagnosis.json.
fn diagnosed(out: &Path, recordings: &[PathBuf], more: &[&str]) -> serde_json::Value {
    let mut arguments = vec!["diagnose", "--out", out.to_str().expect("UTF-8")];
    arguments.extend(recordings.iter().map(|p| p.to_str().expect("UTF-8")));
    arguments.extend(more);
    let ran = leafbench(&arguments);
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let json = std::fs::read_to_string(out.join("diagnosis.json")).expect("written");
    serde_json::from_str(&json).expect("JSON")
}

/// A case that was looked at: a contact that closes at 0.8 mm, and relaxation. From these files it was `unexplained`: a contact was no rival of
/// what was named, because the set with it had a poor zero of the force, and each name was taken back in turn.
#[test]
fn a_contact_beside_relaxation_is_named_from_files() {
    let case = Case::draw(World::BoucWen, 1_427_208_227, 34, None);
    let folder = tempfile::tempdir().expect("scratch folder");
    let recordings = written(folder.path(), &case.recordings, 1);
    let json = diagnosed(
        &folder.path().join("out"),
        &recordings,
        &["--baseline", "equivalent"],
    );
    let effects = json["effects"].as_array().expect("a list");
    let mut named: Vec<&str> = effects.iter().filter_map(|e| e["code"].as_str()).collect();
    named.sort_unstable();
    assert_eq!(named, ["lift_off", "relaxation"], "{}", json["summary"]);
}

fn number(value: &serde_json::Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn the_written_model_does_what_the_report_says() {
    let folder = tempfile::tempdir().expect("scratch folder");
    for code in ["progressive_stiffness", "series_compliance", "coulomb_friction"] {
        let out = folder.path().join(code);
        let json = diagnosed(&out, &files(folder.path(), code), &[]);
        let bench = Bench::load(&out.join("improved.toml")).expect("runs as it is");
        let zero_n = number(&json["improved"]["force_zero_n"]);
        assert!(zero_n != 0.0, "choose a case whose fit finds a zero");
        for model in [&bench.model, &bench.specimen.model] {
            assert_eq!(model.force_zero_n, zero_n, "{code}");
        }
        let (simulated, fitted) = (
            number(&json["proof"]["simulated_nrmse"]),
            number(&json["fit"]["improved"]["nrmse_heldout"]),
        );
        assert!(
            (simulated / fitted - 1.0).abs() < 0.02,
            "{code}: {simulated} and {fitted}"
        );
        assert!(simulated < number(&json["proof"]["baseline_nrmse"]), "{code}");
        assert_eq!(json["proof"]["written"], true, "{code}");
        let yardsticks = json["yardsticks"].as_array().expect("a list");
        assert_eq!(yardsticks.len(), 3, "{yardsticks:?}");
        assert!(yardsticks.iter().all(|y| number(&y["nrmse_leftout"]) > 0.0));
    }
}

/// A force zero that a diagnosis found. It was read one unit in the last place off, so that it was another in JSON than in TOML.
#[test]
fn a_number_of_json_is_read_as_it_was_written() {
    let zero_n: f64 = serde_json::from_str("0.36774215603987076").expect("a number");
    assert_eq!(zero_n, 0.36774215603987076);
    assert_eq!(
        toml::from_str::<toml::Table>("n = 0.36774215603987076").expect("TOML")["n"].as_float(),
        Some(zero_n)
    );
}

#[test]
fn a_recording_that_is_left_out_is_only_predicted() {
    let case = Case::single("progressive_stiffness", 2, 40.0).expect("visible");
    let folder = tempfile::tempdir().expect("scratch folder");
    let recordings = written(folder.path(), &case.recordings[..3], 3);
    let name = recordings[1]
        .file_name()
        .and_then(|n| n.to_str())
        .expect("a name");
    let json = diagnosed(&folder.path().join("out"), &recordings, &["--leave-out", name]);
    assert_eq!(json["curves"].as_array().map(Vec::len), Some(2), "{json:#}");
    let left_out = json["left_out"].as_array().expect("a list");
    assert_eq!(left_out.len(), 1, "{left_out:?}");
    let row = &left_out[0];
    assert!(
        row["recording"].as_str().is_some_and(|n| n.ends_with(name)),
        "{row}"
    );
    assert!(number(&row["improved"]) < 0.5 * number(&row["baseline"]), "{row}");
    assert_eq!(row["yardsticks"].as_array().map(Vec::len), Some(3), "{row}");
    assert!(
        json["proof"]["left_out"]
            .as_str()
            .is_some_and(|t| t.contains(name)),
        "{}",
        json["proof"]
    );
    // Without it nothing else changes: the same diagnosis as of the other two recordings alone.
    let others = [recordings[0].clone(), recordings[2].clone()];
    let alone = diagnosed(&folder.path().join("alone"), &others, &[]);
    for field in ["verdict", "effects", "fit", "yardsticks", "improved"] {
        assert_eq!(json[field], alone[field], "{field}");
    }
}

/// A damper that pushes and pulls: friction of 400 N that reverses over 1 mm, and a weak spring about the middle of the stroke.
fn two_sided() -> String {
    device(|x, since_mm, direction| 10.0 * (x - 6.0) + 400.0 * direction * (1.0 - 2.0 * (-since_mm).exp()))
}

/// Eight triangles of 12 mm of a device whose force is a function of displacement, travel since the reversal and direction.
fn device(force_n: fn(f64, f64, f64) -> f64) -> String {
    let rows = (0..1600).map(|i| {
        let (phase, stroke_mm) = (i % 200, 12.0);
        let (direction, back) = if phase < 100 { (1.0, 0) } else { (-1.0, 100) };
        let since_mm = stroke_mm * f64::from(phase - back) / 100.0;
        let x = if direction > 0.0 {
            since_mm
        } else {
            stroke_mm - since_mm
        };
        let noise_n = 2.0 * (f64::from(i) * 12.9898).sin();
        let force_n = force_n(x, since_mm, direction) + noise_n;
        format!("{},{x},{force_n}\n", f64::from(i) * 0.01)
    });
    format!("time_s,displacement_mm,force_n\n{}", rows.collect::<String>())
}

#[test]
fn effects_that_the_diagnosis_refuses_are_not_written() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let path = folder.path().join("damper.csv");
    std::fs::write(&path, two_sided()).expect("scratch folder is writable");
    let out = folder.path().join("out");
    let json = diagnosed(&out, &[path], &[]);
    assert_eq!(json["verdict"], "unexplained", "choose another device");
    let candidates = json["candidates"].as_array().expect("a list");
    let chosen = candidates.iter().any(|c| c["chosen"] == true);
    assert!(chosen, "nothing was refused: choose another device");
    let effects = json["improved"]["effects"].as_array().expect("a list");
    assert!(
        effects
            .iter()
            .all(|e| FORMS.iter().any(|form| e["code"] == form.code)),
        "{effects:?}"
    );
    let bench = Bench::load(&out.join("improved.toml")).expect("runs as it is");
    let is_form = |code: &str| FORMS.iter().any(|form| form.code == code);
    assert!(bench.model.effects.iter().all(|e| is_form(&e.code)));
}

/// A device that pushes and pulls is delivered as one: the model is written, runs, and is as good as the yardstick of its form.
#[test]
fn a_damper_is_modelled_as_a_two_sided_device() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let path = folder.path().join("damper.csv");
    std::fs::write(&path, two_sided()).expect("scratch folder is writable");
    let out = folder.path().join("out");
    let json = diagnosed(&out, &[path], &[]);
    assert_eq!(
        (&json["verdict"], &json["improved"]["model"]),
        (&"unexplained".into(), &"two-sided".into())
    );
    let improved = number(&json["fit"]["improved"]["nrmse_heldout"]);
    assert!(
        improved < 0.2 * number(&json["fit"]["baseline"]["nrmse_heldout"]),
        "{improved}"
    );
    let mut yardsticks = json["yardsticks"].as_array().expect("a list").iter();
    let own = yardsticks
        .find(|y| {
            y["name"]
                .as_str()
                .is_some_and(|n| n.starts_with("ten Maxwell-slip"))
        })
        .expect("listed");
    assert!(
        improved < 1.02 * number(&own["nrmse_leftout"]),
        "{improved}, {own}"
    );
    let simulated = number(&json["proof"]["simulated_nrmse"]);
    assert!(
        (simulated / improved - 1.0).abs() < 0.02,
        "{simulated}, {improved}"
    );
    let bench = Bench::load(&out.join("improved.toml")).expect("runs as it is");
    assert_eq!(bench.model.name, "two-sided");
}

#[test]
fn a_device_that_no_model_of_a_spring_suits_is_said_to_be_met_better_by_a_yardstick() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let path = folder.path().join("damper.csv");
    let cubic = device(|x, _, direction| 2.0 * (x - 6.0).powi(3) + 60.0 * direction);
    std::fs::write(&path, cubic).expect("scratch folder is writable");
    let out = folder.path().join("out");
    let json = diagnosed(&out, &[path], &[]);
    let improved = number(&json["fit"]["improved"]["nrmse_heldout"]);
    let errors = json["yardsticks"].as_array().expect("a list").iter();
    let best = errors
        .map(|y| number(&y["nrmse_leftout"]))
        .fold(f64::INFINITY, f64::min);
    assert!(
        best < 0.5 * improved,
        "{best} and {improved}: choose another device"
    );
    let page = std::fs::read_to_string(out.join("report.html")).expect("written");
    let said = page
        .find("A model that knows nothing of springs predicts better")
        .expect("said");
    assert!(
        said < page.find("<svg").expect("a plot"),
        "it is not on the first screen"
    );
}

/// A fair loop of a leaf spring with its columns in wrong units: the header says mm and N, the figures do not.
fn in_other_units(per_mm: f64, per_n: f64) -> String {
    let rows = (0..600).map(|k| {
        let phase = std::f64::consts::TAU * f64::from(k) / 100.0;
        let (x, n) = (
            10.0 - 6.0 * phase.cos(),
            800.0 - 480.0 * phase.cos() + 60.0 * phase.sin(),
        );
        format!("{},{},{}\n", f64::from(k) * 0.01, x * per_mm, n * per_n)
    });
    format!("time_s,displacement_mm,force_n\n{}", rows.collect::<String>())
}

/// What is wrong, the bytes of the file, and words that the error must have.
type BadFile = (&'static str, Vec<u8>, &'static [&'static str]);

/// Files with a mistake that one row shows.
fn bad_rows() -> [BadFile; 8] {
    [
        ("empty", Vec::new(), &["empty"]),
        (
            "column",
            b"time_s,displacement_mm\n0,1\n".to_vec(),
            &["force_n", "row 1"],
        ),
        (
            "nan",
            b"time_s,displacement_mm,force_n\n0,1,2\n1,NaN,2\n".to_vec(),
            &["row 3", "displacement_mm"],
        ),
        (
            "back",
            b"time_s,displacement_mm,force_n\n1,1,2\n0,1,2\n".to_vec(),
            &["row 3", "time_s"],
        ),
        (
            "unit",
            b"time_s,displacement_m,force_n\n0,1,2\n".to_vec(),
            &["displacement_mm"],
        ),
        (
            "kilonewtons by name",
            b"time_s,displacement_mm,force_kn\n0,1,2\n1,2,3\n".to_vec(),
            &["force_n", "row 1"],
        ),
        (
            "decimal comma",
            b"time_s,displacement_mm,force_n\n0,\"1,5\",2\n".to_vec(),
            &["row 2", "displacement_mm", "point"],
        ),
        (
            "text",
            b"time_s,displacement_mm,force_n\n0,1,2\n1,2,high\n".to_vec(),
            &["row 3", "force_n"],
        ),
    ]
}

/// Files with a mistake that only the whole file shows.
fn bad_as_a_whole() -> [BadFile; 4] {
    let rows: String = (0..10).map(|k| format!("{k},{k}.5,{k}\n")).collect();
    [
        ("binary", vec![0xff, 0xfe, 0x00, 0x81, 0x0a], &["row"]),
        (
            "short",
            format!("time_s,displacement_mm,force_n\n{rows}").into_bytes(),
            &["record longer"],
        ),
        (
            "metres by size",
            in_other_units(1e-3, 1.0).into_bytes(),
            &["displacement_mm", "row", "metres"],
        ),
        (
            "kilonewtons by size",
            in_other_units(1.0, 1e-3).into_bytes(),
            &["force_n", "row", "kilonewtons"],
        ),
    ]
}

#[test]
fn unusable_input_ends_with_2_and_says_file_place_and_remedy() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let path = folder.path().join("bad.csv");
    for (what, bytes, wanted) in bad_rows().into_iter().chain(bad_as_a_whole()) {
        std::fs::write(&path, bytes).expect("scratch folder is writable");
        let ran = leafbench(&["diagnose", path.to_str().expect("UTF-8")]);
        let said = String::from_utf8_lossy(&ran.stderr).into_owned();
        assert_eq!(ran.status.code(), Some(2), "{what}: {said}");
        assert!(said.contains("bad.csv"), "{what}: {said}");
        for word in wanted {
            assert!(said.contains(word), "{what} says {word}: {said}");
        }
    }
}

#[test]
fn an_unknown_code_or_model_is_refused_with_a_list_of_all() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let recordings = files(folder.path(), "sensor_drift");
    let recording = recordings[0].to_str().expect("UTF-8");
    for option in [["--known", "magnetism"], ["--baseline", "rubber"]] {
        let ran = leafbench(&["diagnose", option[0], option[1], recording]);
        let said = String::from_utf8_lossy(&ran.stderr).into_owned();
        assert_eq!(ran.status.code(), Some(2), "{said}");
        assert!(said.contains(option[1]) && said.contains("use one of"), "{said}");
    }
}

#[test]
fn a_turned_force_is_refused_with_the_repair_and_the_repair_works() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let file = files(folder.path(), "progressive_stiffness").swap_remove(0);
    let text = std::fs::read_to_string(&file).expect("written");
    let mut rows = csv::Reader::from_reader(text.as_bytes());
    let heads = rows.headers().expect("a header").clone();
    let force = heads.iter().position(|h| h == "force_n").expect("the column");
    let turned = rows.records().map(|row| {
        let row = row.expect("a row");
        let cells = row.iter().enumerate().map(|(i, cell)| match cell.parse::<f64>() {
            Ok(force_n) if i == force => (-force_n).to_string(),
            _ => cell.to_owned(),
        });
        cells.collect::<Vec<_>>().join(",")
    });
    let header = heads.iter().collect::<Vec<_>>().join(",");
    let lines: Vec<String> = std::iter::once(header).chain(turned).collect();
    std::fs::write(&file, lines.join("\n")).expect("writable");
    let out = folder.path().join("out");
    let [file, out] = [&file, &out].map(|p| p.to_str().expect("UTF-8"));
    let refused = leafbench(&["diagnose", "--out", out, file]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(2), "{said}");
    assert!(said.contains("--flip force"), "{said}");
    let repaired = leafbench(&["diagnose", "--out", out, "--flip", "force", file]);
    assert!(
        repaired.status.success(),
        "{}",
        String::from_utf8_lossy(&repaired.stderr)
    );
}
