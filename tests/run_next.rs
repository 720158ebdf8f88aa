//! `diagnose --run-next`: the bench runs the test that tells and judges again.

#[path = "support/bench.rs"]
#[expect(dead_code, reason = "each test takes its part")]
mod virtual_rig;

use std::process::Command;

use virtual_rig::{concealing, play, sine};

#[test]
fn rounds_are_run_and_kept_until_it_is_settled_or_nothing_helps() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = |path: &std::path::Path| path.to_str().expect("UTF-8").to_owned();
    let bench = concealing(
        "progressive_stiffness",
        &[("extra_rate_n_per_mm", 15.0), ("knee_mm", 8.0), ("width_mm", 2.0)],
    );
    let file = folder.path().join("bench.toml");
    std::fs::write(&file, bench.to_toml()).expect("scratch folder is writable");
    // One short sine about the knee alone: a knee and a smooth bend are alike there.
    let (_, csv) = play(&bench, &sine("one", 9.0, 1.0, 8), Some(folder.path()));
    let out = folder.path().join("out");
    let ran = Command::new(env!("CARGO_BIN_EXE_leafbench"))
        .args([
            "diagnose",
            "--run-next=virtual",
            "--rounds",
            "2",
            "--json",
            "--bench",
            &text(&file),
            "--out",
            &text(&out),
        ])
        .arg(csv.expect("exported"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("the program starts");
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let ended: serde_json::Value = serde_json::from_slice(&ran.stdout).expect("JSON");
    println!("{} {}\n{:#}", ended["settled"], ended["why"], ended["rounds"]);
    let rounds = ended["rounds"].as_array().expect("a list");
    assert!(!rounds.is_empty() && rounds.len() <= 3);
    assert!(ended["why"].as_str().is_some_and(|w| !w.is_empty()));
    for (number, round) in rounds.iter().enumerate() {
        for name in ["diagnosis.json", "report.html", "improved.toml"] {
            assert!(
                out.join(format!("round-{number}")).join(name).is_file(),
                "{name} of round {number}"
            );
        }
        // Every round but the last ended with a test, and its recording is there.
        let recording = round["recording"].as_str();
        assert_eq!(recording.is_some(), number + 1 < rounds.len(), "{round}");
        assert!(recording.is_none_or(|path| std::path::Path::new(path).is_file()));
    }
    assert!(out.join("rounds.json").is_file() && out.join("report.html").is_file());
}
