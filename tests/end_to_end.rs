//! The whole chain: a concealed effect in the mock rig, runs, export, `diagnose`, and a twin that follows better with what it wrote.

use super::support::program;
use std::process::Command;

use super::support::bench::{concealing, play, sine, twin_nrmse};
use crate::config::Bench;

#[test]
fn what_is_concealed_is_found_and_the_improved_model_follows_the_rig() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = |path: &std::path::Path| path.to_str().expect("UTF-8").to_owned();
    let bench = concealing(
        "progressive_stiffness",
        &[("extra_rate_n_per_mm", 15.0), ("knee_mm", 8.0), ("width_mm", 0.5)],
    );
    let bench_file = folder.path().join("bench.toml");
    std::fs::write(&bench_file, bench.to_toml()).expect("scratch folder is writable");
    let mut arguments = vec!["diagnose".to_owned(), "--bench".to_owned(), text(&bench_file)];
    // What a technician would run: a slow loop and a quick one.
    let profiles = [sine("slow", 12.0, 0.25, 5), sine("quick", 6.0, 2.0, 12)];
    for profile in &profiles {
        let (_, csv) = play(&bench, profile, Some(folder.path()));
        arguments.push(text(&csv.expect("exported")));
    }
    let out = folder.path().join("out");
    arguments.extend(["--out".to_owned(), text(&out)]);
    let ran = Command::new(program())
        .args(&arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("the program starts");
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let json = std::fs::read_to_string(out.join("diagnosis.json")).expect("written");
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    let codes: Vec<&str> = json["effects"]
        .as_array()
        .expect("a list")
        .iter()
        .filter_map(|e| e["code"].as_str())
        .collect();
    let said = String::from_utf8_lossy(&ran.stdout);
    assert!(codes.contains(&"progressive_stiffness"), "{codes:?}: {said}");

    // The rig stays what it is; only the twin's model is improved. No fit has seen this motion.
    let improved = Bench::load(&out.join("improved.toml")).expect("runs as it is");
    let fresh = sine("fresh", 10.0, 1.0, 8);
    let (before, _) = play(&bench, &fresh, None);
    let taught = Bench {
        model: improved.model.clone(),
        ..bench
    };
    let (after, _) = play(&taught, &fresh, None);
    let [before, after] = [twin_nrmse(&before.samples), twin_nrmse(&after.samples)];
    assert!(
        after < 0.5 * before,
        "twin's error on a fresh run: {before:.5} before, {after:.5} after"
    );
}
