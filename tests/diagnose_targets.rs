//! Diagnoses from published tables only: what must be found in them, and what must not.

use super::support::program;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::diagnose::Verdict;
use crate::diagnose::aggregates::{AggregateDiagnosis, TableReader, TargetsTable, diagnose_table};

fn table_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/tables")
        .join(name)
}

fn tables(names: &[&str]) -> TargetsTable {
    let mut reader = TableReader::default();
    for name in names {
        let file = std::fs::File::open(table_path(name)).expect("kept with the tests");
        reader.read(file, name).expect("readable");
    }
    reader.finish()
}

fn paper() -> TargetsTable {
    tables(&[
        "p000_table2_static.csv",
        "p000_table3_dynamic.csv",
        "p000_table6_7_optimised.csv",
    ])
}

fn diagnose(table: TargetsTable) -> AggregateDiagnosis {
    let mut simulate = |_: &[_]| panic!("the tables have a model of their own");
    diagnose_table(table, &mut simulate, 0, &mut |_| {}).expect("sound tables")
}

fn leafbench(arguments: &[&str]) -> Output {
    Command::new(program())
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("the program starts")
}

fn figure(d: &AggregateDiagnosis, code: &str, name: &str) -> (f64, [f64; 2]) {
    let all = d.effects.iter().chain(&d.excluded);
    let finding = all.clone().find(|f| f.code == code);
    let finding = finding.unwrap_or_else(|| {
        panic!(
            "{code} is not among {:?}",
            all.map(|f| &f.code).collect::<Vec<_>>()
        )
    });
    let value = finding.parameters.iter().find(|v| v.name.contains(name));
    let value = value.unwrap_or_else(|| panic!("{name} is not among {:?}", finding.parameters));
    (value.value, value.ci95.expect("an interval"))
}

#[test]
fn the_first_papers_tables_show_the_missing_physics() {
    let d = diagnose(paper());
    assert_eq!(d.verdict, Verdict::MissingPhysics);
    assert_impossible_parameters(&d);
    assert_friction_findings(&d);
    assert_one_set_for_all_tests(&d);
    // Two figures per test do not show the shape of the loop.
    for code in [
        "presliding",
        "stribeck",
        "backlash",
        "series_compliance",
        "channel_delay",
    ] {
        assert!(d.not_testable.iter().any(|n| n.code == code), "{code}");
    }
    assert!(d.location.is_empty() && d.fit.improved.nrmse_heldout.is_none());
}

/// The reported optimum is impossible on both mountings, and fits as many parameters as figures.
fn assert_impossible_parameters(d: &AggregateDiagnosis) {
    let impossible: Vec<&String> = d.alarms.iter().filter(|a| a.contains("impossible")).collect();
    assert!(
        impossible
            .iter()
            .any(|a| a.contains("-13.09991") && a.contains("2 parameters to 2 figures")),
        "{impossible:?}"
    );
    assert!(impossible.iter().any(|a| a.contains("8.51317")), "{impossible:?}");
    assert_eq!(
        d.rows.iter().filter(|r| r.optimum.is_some()).count(),
        2,
        "the optimum is printed for the static rows only"
    );
}

fn assert_friction_findings(d: &AggregateDiagnosis) {
    // Friction is missing at low speed.
    let (_, measured) = figure(d, "rate_independent_friction", "measured loss over rate");
    let (_, model) = figure(d, "rate_independent_friction", "model's loss over rate");
    assert!(
        measured[1] < 0.05 && measured[0] > -0.05 && model[0] > 0.3,
        "{measured:?} {model:?}"
    );
    let (times, _) = figure(d, "rate_independent_friction", "slowest test");
    assert!((times - 8.9074 / 0.1926).abs() < 0.1);
    // Friction grows with load.
    for (mount, power) in [(", shackle", 1.95), (", no shackle", 2.18)] {
        let name = format!("measured loss over peak force{mount}");
        let (p, ci) = figure(d, "load_dependent_friction", &name);
        assert!((p - power).abs() < 0.05 && ci[0] > 1.5, "{mount}: {p} {ci:?}");
    }
    // It is not viscous damping.
    let (_, viscous) = figure(d, "viscous_damping", "viscous share");
    assert!(
        viscous[1] < 10.0 && d.effects.iter().all(|f| f.code != "viscous_damping"),
        "{viscous:?}"
    );
    // With shackle a part does not depend on load; without shackle none.
    let (_, with) = figure(d, "coulomb_friction", "no load, shackle");
    let (without, _) = figure(d, "coulomb_friction", "no load, no shackle");
    assert!(with[0] > 0.0 && without < with[0], "{with:?} {without}");
}

/// One set of leaf-pack parameters meets static and dynamic tests, and is what the files for the twin contain.
fn assert_one_set_for_all_tests(d: &AggregateDiagnosis) {
    let worst = |i: usize| {
        d.rows
            .iter()
            .map(|r| (r.ours.expect("fitted")[i] / r.measured[i] - 1.0).abs())
            .fold(0.0, f64::max)
    };
    assert!(
        worst(0) < 0.03 && worst(1) < 0.1,
        "worst peak force {:.3}, worst loop energy {:.3}",
        worst(0),
        worst(1)
    );
    assert!(!d.parameters.is_empty());
    assert_eq!(d.improved.len(), 2);
    for (mount, improved) in &d.improved {
        let mut plant = improved.plant().expect("a sound model");
        let peak = (0..=60)
            .map(|k| plant.step(0.5 * f64::from(k), 1.0))
            .fold(0.0, f64::max);
        assert!(peak > 1900.0 && peak < 4000.0, "{mount}: {peak} N at 30 mm");
    }
}

/// The numbers below `n` in a seeded random order.
fn shuffled(n: usize, seed: u64) -> Vec<usize> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut order: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        order.swap(i, (state >> 33) as usize % (i + 1));
    }
    order
}

#[test]
fn shuffled_energies_give_no_finding() {
    for seed in 1..=200 {
        let mut table = paper();
        let energies: Vec<f64> = table.rows.iter().map(|r| r.measured.loop_energy_j).collect();
        for (row, from) in table.rows.iter_mut().zip(shuffled(energies.len(), seed)) {
            row.measured.loop_energy_j = energies[from];
        }
        if table
            .rows
            .iter()
            .zip(&energies)
            .filter(|(r, e)| r.measured.loop_energy_j != **e)
            .count()
            < 3
        {
            continue;
        }
        let d = diagnose(table);
        assert!(
            d.effects.is_empty() && d.excluded.is_empty(),
            "seed {seed}: {}",
            d.summary
        );
        assert_eq!(d.verdict, Verdict::Unexplained, "seed {seed}");
    }
}

#[test]
fn the_models_own_rows_as_measurement_are_adequate() {
    let mut table = paper();
    for row in &mut table.rows {
        row.measured = row.model.expect("the table has simulated rows");
    }
    let d = diagnose(table);
    assert_eq!(d.verdict, Verdict::Adequate, "{}", d.summary);
    assert!(d.effects.is_empty() && d.alarms.is_empty());
}

#[test]
fn a_single_loops_points_show_both_ends_and_no_rate() {
    let d = diagnose(tables(&["p001_table5_1_load_deflection.csv"]));
    assert_eq!(d.verdict, Verdict::MissingPhysics);
    let (length, ci) = figure(&d, "presliding", "transition_length_mm");
    assert!(
        ci[0] <= length && length <= ci[1] && ci[1] < 48.0,
        "{length} {ci:?}"
    );
    let (_, softer) = figure(&d, "presliding", "along a branch");
    assert!(softer[1] < 0.0, "{softer:?}");
    // Both ends are located, and hold most of the error.
    assert_eq!(d.location.len(), 2);
    assert!(d.location.iter().map(|l| l.share).sum::<f64>() > 0.6);
    for code in ["viscous_damping", "stribeck", "rate_independent_friction"] {
        assert!(
            d.not_testable
                .iter()
                .any(|n| n.code == code && n.why.contains("rate")),
            "{code}"
        );
    }
    // The errors of the envelope lines are reported for comparison.
    let [before, after] =
        [d.fit.baseline.nrmse_train, d.fit.improved.nrmse_train].map(|e| e.expect("points give it"));
    assert!(after < 0.2 * before, "{before} {after}");
    assert!(d.rows.iter().all(|r| r.model.is_some() && r.ours.is_some()));
    // The improved model gives the row's figures along the points.
    let mut plant = d.improved[0].1.plant().expect("a sound model");
    let mut at = 0.0;
    for row in &d.rows {
        let [to, ours_n] = row.ours.expect("checked above");
        let mut force_n = 0.0;
        for i in 1..=40 {
            force_n = plant.step(at + (to - at) * f64::from(i) / 40.0, 1.0);
        }
        at = to;
        assert!(
            (force_n - ours_n).abs() < 0.1,
            "{to} mm: {force_n} N, reported {ours_n}"
        );
    }
}

#[test]
fn an_envelope_as_measurement_has_sharp_ends() {
    let mut table = tables(&["p001_table5_1_load_deflection.csv"]);
    for (mm, n) in &mut table.points.loading {
        *n = 33.354 * *mm + 499.07;
    }
    for (mm, n) in &mut table.points.unloading {
        *n = 33.354 * *mm - 206.53;
    }
    let d = diagnose(table);
    assert_eq!(d.verdict, Verdict::Adequate, "{}", d.summary);
}

#[test]
fn the_command_writes_its_files_and_refuses_with_row_and_column() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let text = |path: &Path| path.to_str().expect("UTF-8").to_owned();
    let out = folder.path().join("out");
    let points = table_path("p001_table5_1_load_deflection.csv");
    // From a folder that has no bench file.
    let ran = Command::new(program())
        .args(["diagnose", "--targets", &text(&points), "--out", &text(&out)])
        .current_dir(folder.path())
        .output()
        .expect("the program starts");
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let json = std::fs::read_to_string(out.join("diagnosis.json")).expect("written");
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    for field in [
        "verdict",
        "effects",
        "alternatives",
        "location",
        "fit",
        "next_test",
    ] {
        assert!(json.get(field).is_some(), "{field} of docs/formats.md");
    }
    let page = std::fs::read_to_string(out.join("report.html")).expect("written");
    assert!(page.contains("<svg"));
    let outside = page.replace("http://www.w3.org/2000/svg", "");
    for outside_source in [
        "http", "<script", "src=", "href=", "@import", "url(", "fetch(", "<link", "NaN",
    ] {
        assert!(!outside.contains(outside_source), "{outside_source}");
    }

    let bad = folder.path().join("bad.csv");
    for (rows, wanted) in [
        (
            "mount,fmax_kn,loop_energy_j\nshackle,1,2\nshackle,NaN,2\n",
            ["row 3", "fmax_kn"],
        ),
        ("mount,fmax_kn\nshackle,1\n", ["row 1", "loop_energy_j"]),
        (
            "mount,fmax_kn,loop_energy_j\nshackle,1,2\n",
            ["source", "simulation"],
        ),
        ("", ["row 1", "column"]),
    ] {
        std::fs::write(&bad, rows).expect("scratch folder is writable");
        let ran = leafbench(&["diagnose", "--targets", &text(&bad)]);
        let said = String::from_utf8_lossy(&ran.stderr).into_owned();
        assert_eq!(ran.status.code(), Some(2), "{said}");
        assert!(wanted.iter().all(|w| said.contains(w)), "{wanted:?}: {said}");
    }
}
