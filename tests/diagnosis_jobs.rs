//! Diagnoses that the daemon computes: asked for over HTTP, followed, cancelled, and their improved model as twin.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::support::bench::{concealing, play, sine};
use super::support::http::{answer, post, request};
use super::support::{Daemon, config, until};
use crate::recording::run_file::{EXTENSION, RunFile};

/// A profile of a second.
const SHORT: &str = "name = \"short\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\n\
                     to_mm = 1.0\nduration_s = 0.5\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 0.0\nduration_s = 0.5\n";

/// A daemon whose rig conceals a weak helper leaf, with the runs `one` and `two` in its data folder. One short sine about the
/// knee leaves look-alikes, so there is a next test.
pub fn confounded(folder: &Path) -> Daemon {
    let bench = concealing(
        "progressive_stiffness",
        &[("extra_rate_n_per_mm", 0.5), ("knee_mm", 8.0), ("width_mm", 2.0)],
    );
    let file = folder.join("bench.toml");
    std::fs::write(&file, bench.to_toml()).expect("written");
    let data = folder.join("data");
    std::fs::create_dir(&data).expect("made");
    play(&bench, &sine("one", 9.0, 1.0, 8), Some(&data));
    play(&bench, &sine("two", 9.0, 1.0, 3), Some(&data));
    let text = |path: PathBuf| path.to_str().expect("UTF-8").to_owned();
    let profiles = text(config("profiles"));
    Daemon::ready(&data, &["--bench", &text(file), "--profiles", &profiles])
}

fn of_method(daemon: &Daemon, method: &str, path: &str) -> (u16, String) {
    let head = format!("{method} {path} HTTP/1.1\r\nHost: {}\r\n", daemon.authority());
    request(daemon, &head, "")
}

fn get(daemon: &Daemon, path: &str) -> Value {
    let (status, body) = of_method(daemon, "GET", path);
    assert_eq!(status, 200, "{path}: {body}");
    serde_json::from_str(&body).expect("JSON")
}

fn posted(daemon: &Daemon, path: &str, body: &Value) -> (u16, Value) {
    let (status, body) = answer(post(daemon, path, body));
    (status, serde_json::from_str(&body).expect("JSON"))
}

/// Asks for a diagnosis; its id.
fn ask(daemon: &Daemon, runs: &[&str]) -> String {
    let (status, job) = posted(daemon, "/api/diagnoses", &json!({ "runs": runs }));
    assert_eq!(status, 202, "{job}");
    job["id"].as_str().expect("an id").to_owned()
}

fn until_over(daemon: &Daemon, id: &str) -> Value {
    until("the end of the diagnosis", || {
        let job = get(daemon, &format!("/api/diagnoses/{id}"));
        let over = !["queued", "running"].contains(&job["state"].as_str().expect("a word"));
        over.then_some(job)
    })
}

/// The header of a run that has just been recorded.
fn recorded_twin(daemon: &Daemon) -> (String, String) {
    let (status, started) = posted(daemon, "/api/run", &json!({ "profile": SHORT }));
    assert_eq!(status, 202, "{started}");
    let id = started["run_id"].as_str().expect("an id");
    until("the end of the run", || {
        let run = &get(daemon, &format!("/api/runs/{id}"))["summary"];
        (run["ending"] != "open").then_some(())
    });
    daemon.back_to_ready();
    let run = RunFile::open(&daemon.data.join(id).with_extension(EXTENSION)).expect("opens");
    (run.header().twin.clone(), run.header().bench_toml.clone())
}

/// The results can be read, and nothing else of the folder.
fn check_files(daemon: &Daemon, id: &str) {
    for (file, part) in [
        ("report.html", "<html"),
        ("diagnosis.json", "\"verdict\""),
        ("improved.toml", "[model]"),
        ("next-test.toml", "[[block"),
    ] {
        let (status, text) = of_method(daemon, "GET", &format!("/api/diagnoses/{id}/{file}"));
        assert!(status == 200 && text.contains(part), "{file}: {status}");
    }
    for file in ["job.json", "bench.toml", "..%2fjob.json", "%2e%2e"] {
        assert_eq!(
            of_method(daemon, "GET", &format!("/api/diagnoses/{id}/{file}")).0,
            404,
            "{file}"
        );
    }
}

/// The improved model becomes the twin, and goes again.
fn check_twin(daemon: &Daemon, id: &str) {
    let own = recorded_twin(daemon);
    assert_eq!(own.0, "equivalent");
    let (status, said) = posted(daemon, "/api/twin", &json!({ "diagnosis": id }));
    assert!(
        status == 200 && said["message"].as_str().is_some_and(|m| m.contains(id)),
        "{said}"
    );
    let shown = daemon.status();
    assert_eq!(shown["twin_diagnosis"], id);
    let improved = recorded_twin(daemon);
    assert_eq!(shown["twin"], improved.0.as_str());
    assert!(
        improved.0.contains(&format!("(diagnosis {id})")),
        "{}",
        improved.0
    );
    assert_ne!(improved.1, own.1, "the header has the model that the twin had");
    assert_eq!(posted(daemon, "/api/twin", &json!({ "diagnosis": null })).0, 200);
    assert_eq!(recorded_twin(daemon), own);
    assert_eq!(
        posted(daemon, "/api/twin", &json!({ "diagnosis": "none" })).0,
        404
    );
}

/// The jobs outlive the daemon; a removed one is gone with its files.
fn check_next_daemon(daemon: Daemon, folder: &Path, id: &str, found: &Value) {
    drop(daemon);
    let bench = folder.join("bench.toml");
    let again = Daemon::start(&folder.join("data"), &["--bench", bench.to_str().expect("UTF-8")]);
    assert_eq!(get(&again, "/api/diagnoses")[0]["found"], *found);
    assert_eq!(
        of_method(&again, "DELETE", &format!("/api/diagnoses/{id}")).0,
        200
    );
    assert_eq!(get(&again, "/api/diagnoses"), json!([]));
    assert!(!again.data.join("diagnoses").join(id).exists());
}

#[test]
fn a_diagnosis_is_computed_beside_the_daemon_and_its_model_becomes_the_twin_and_goes_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = confounded(folder.path());
    let id = ask(&daemon, &["one"]);
    let mut steps = Vec::new();
    let job = until("the end of the diagnosis", || {
        let job = get(&daemon, &format!("/api/diagnoses/{id}"));
        if job["state"] == "running" {
            steps.push((job["share"].as_f64().expect("a share"), job["step"].clone()));
            return None;
        }
        (job["state"] != "queued").then_some(job)
    });
    assert_eq!(job["state"], "done", "{job}");
    assert!(steps.windows(2).all(|w| w[0].0 <= w[1].0), "{steps:?}");
    assert!(
        steps.iter().any(|(share, step)| *share > 0.0 && step != ""),
        "{steps:?}"
    );
    let found = &job["found"];
    assert_eq!(
        (&found["verdict"], &found["improved"]),
        (&json!("missing_physics"), &json!(true)),
        "{job}"
    );
    assert_ne!(found["next_test"], "", "{job}");
    check_files(&daemon, &id);
    check_twin(&daemon, &id);
    check_next_daemon(daemon, folder.path(), &id, found);
}

#[test]
fn the_twin_keeps_its_model_while_the_bench_is_at_work() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let long = SHORT.replace("duration_s = 0.5\n[[", "duration_s = 60.0\n[[");
    assert_eq!(posted(&daemon, "/api/run", &json!({ "profile": long })).0, 202);
    daemon.until_phase("running");
    let (status, refusal) = posted(&daemon, "/api/twin", &json!({ "diagnosis": null }));
    assert_eq!(status, 409);
    assert!(
        refusal["error"]
            .as_str()
            .is_some_and(|e| e.contains("while the bench is at work")),
        "{refusal}"
    );
    posted(&daemon, "/api/stop", &json!({}));
}

#[test]
fn one_diagnosis_at_a_time_is_computed_and_each_can_be_cancelled() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = confounded(folder.path());
    let (first, second) = (ask(&daemon, &["one", "two"]), ask(&daemon, &["two"]));
    let state = |id: &str| get(&daemon, &format!("/api/diagnoses/{id}"))["state"].clone();
    until("the first one at work", || {
        (state(&first) == "running").then_some(())
    });
    assert_eq!(state(&second), "queued");
    // The next one begins after the one that is cancelled.
    let (status, cancelled) = of_method(&daemon, "DELETE", &format!("/api/diagnoses/{first}"));
    assert!(
        status == 200 && cancelled.contains("\"cancelled\""),
        "{cancelled}"
    );
    until("the second one at work", || {
        (state(&second) == "running").then_some(())
    });
    assert_eq!(state(&first), "cancelled");
    assert_eq!(
        of_method(&daemon, "DELETE", &format!("/api/diagnoses/{second}")).0,
        200
    );
    assert_eq!(until_over(&daemon, &second)["state"], "cancelled");
    assert_eq!(
        of_method(&daemon, "GET", &format!("/api/diagnoses/{second}/report.html")).0,
        409
    );
    assert_eq!(of_method(&daemon, "GET", "/api/diagnoses/none").0, 404);
}

#[test]
fn runs_that_cannot_be_diagnosed_are_refused_in_words() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let (_, started) = posted(
        &daemon,
        "/api/run",
        &json!({ "profile": SHORT, "specimen": "leaf 1", "override_by": "test" }),
    );
    let first = started["run_id"].as_str().expect("an id").to_owned();
    daemon.until_phase("running");
    daemon.back_to_ready();
    let (_, started) = posted(
        &daemon,
        "/api/run",
        &json!({ "profile": SHORT, "specimen": "leaf 2", "override_by": "test" }),
    );
    let second = started["run_id"].as_str().expect("an id").to_owned();
    daemon.until_phase("running");
    let open = posted(&daemon, "/api/diagnoses", &json!({ "runs": [second] }));
    assert!(
        open.0 == 422 && open.1["error"].as_str().is_some_and(|e| e.contains("no end yet")),
        "{open:?}"
    );
    daemon.back_to_ready();
    for (runs, status, words) in [
        (json!([first, second]), 422, "\"leaf 1\" and \"leaf 2\""),
        (json!(["none"]), 404, "there is no run \"none\""),
        (json!([]), 422, "0 runs were chosen"),
    ] {
        let refused = posted(&daemon, "/api/diagnoses", &json!({ "runs": runs }));
        let error = refused.1["error"].as_str().expect("a text");
        assert!(refused.0 == status && error.contains(words), "{refused:?}");
    }
    // A run of a second has no motion to diagnose: what the program says gets to the page.
    let failed = until_over(&daemon, &ask(&daemon, &[&first]));
    if failed["state"] == "failed" {
        assert_ne!(failed["error"], "", "{failed}");
    }
}
