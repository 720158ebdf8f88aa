//! A technician's day at the command line beside the runs themselves: foreign tables, exports, the list of runs, templates,
//! mistyped names, waiting and watching, completions and manual pages.

use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};

use super::support::{Daemon, Process, json, leafbench, run, until};
use crate::recording::Recorder;
use crate::recording::csv;
use crate::recording::run_file::test_support::{header, outcome, sample};
use crate::recording::run_file::{EXTENSION, RunFileWriter};

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

fn said(output: &Output) -> (i32, String) {
    let both = [output.stdout.as_slice(), output.stderr.as_slice()].concat();
    let code = output.status.code().expect("no signal ended it");
    (code, String::from_utf8_lossy(&both).into_owned())
}

/// Runs in a folder, so that defaults such as NAME.imported.csv go there.
fn run_in(folder: &Path, arguments: &[&str]) -> (i32, String) {
    said(&leafbench(arguments).current_dir(folder).output().expect("starts"))
}

/// A foreign table of the repository.
fn foreign(name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recordings/foreign");
    text(&folder.join(name)).to_owned()
}

#[test]
fn a_foreign_table_is_imported_with_everything_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let table = foreign("no-time.csv");
    let map = "Weg [mm]=displacement_mm,Kraft [kN]=force_n*1000";
    let command = ["import", &table, "--map", map, "--flip", "force", "--dt", "0.001"];
    let (code, told) = run_in(folder.path(), &command);
    assert_eq!(code, 0, "{told}");
    for part in [
        "semicolons between columns, decimal commas",
        "every 0.001 s (--dt)",
        "displacement_mm  \"Weg [mm]\" * 1",
        "\"Kraft [kN]\" * 1000 (from --map), sign turned (--flip)",
        "NOTE: the force falls where the displacement rises",
        "no-time.imported.csv  (8 rows over 0.007 s: 0.000 to 5.000 mm, -1432.0 to -10.0 N)",
    ] {
        assert!(told.contains(part), "{part}: {told}");
    }
    let recording = csv::read_file(&folder.path().join("no-time.imported.csv")).expect("a recording");
    assert_eq!(recording.force_n[..2], [-10.0, -115.5]);
    // A second time only with --force.
    let (code, told) = run_in(folder.path(), &command);
    assert!(code == 2 && told.contains("is there already"), "{told}");
    let forced = [&command[..], &["--force"]].concat();
    assert_eq!(run_in(folder.path(), &forced).0, 0);
}

#[test]
fn a_table_that_cannot_be_guessed_is_listed_with_the_line_to_type() {
    let folder = tempfile::tempdir().expect("a folder");
    let (code, told) = run_in(folder.path(), &["import", &foreign("other-names.csv")]);
    assert_eq!(code, 2);
    assert!(
        told.contains("#2 Actuator, front") && told.contains("--map \""),
        "{told}"
    );
    assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 0);
    let (code, told) = run_in(folder.path(), &["import", &foreign("tab.txt"), "--json"]);
    let json: serde_json::Value = serde_json::from_str(&told).expect("JSON");
    assert_eq!(code, 0, "{told}");
    assert_eq!(json["guessed"], true);
    assert_eq!(json["mapped"][1]["column"], "Travel [mm]");
    assert_eq!(json["mapped"][1]["target"], "displacement_mm");
    assert_eq!(json["unused"][0], "Command [mm]");
}

/// A run in a data folder; it is closed if `ends`.
fn recorded(data: &Path, id: &str, ends: bool) -> PathBuf {
    let mut head = header();
    (head.run_id, head.operator) = (id.to_owned(), format!("operator of {id}"));
    head.started_utc = format!("2026-11-{}T10:30:00.000Z", &id[6..8]);
    let path = data.join(format!("{id}.{EXTENSION}"));
    let mut writer = RunFileWriter::create(&path, &head).expect("created");
    (0..1500).for_each(|tick| writer.sample(&sample(tick)));
    if ends {
        writer.end(&outcome(1500));
    }
    path
}

#[test]
fn an_export_replaces_nothing_silently() {
    let folder = tempfile::tempdir().expect("a folder");
    recorded(folder.path(), "20261121t103000-abcd", true);
    let out = folder.path().join("out");
    let export = |more: &[&str]| {
        json(
            folder.path(),
            &[&["export", "abcd", "--out", text(&out)], more].concat(),
        )
    };
    let (written, code) = export(&[]);
    assert_eq!((code, &written["still_going"]), (0, &false.into()), "{written}");
    let csv = PathBuf::from(written["csv"].as_str().expect("a path"));
    std::fs::write(&csv, "edited").expect("written");
    let (refused, code) = export(&[]);
    let why = refused["error"].as_str().expect("a text");
    assert!(
        code == 2 && why.contains("is there already") && why.contains("--force"),
        "{why}"
    );
    assert_eq!(std::fs::read_to_string(&csv).expect("there"), "edited");
    // Another part has other files, although the table of cycles is the same.
    assert_eq!(export(&["--every", "10"]).1, 0);
    assert_eq!(export(&["--force"]).1, 0);
    assert_eq!(
        std::fs::read_to_string(&csv).expect("there").lines().count(),
        1501
    );
}

#[test]
fn an_export_of_a_run_that_goes_on_says_so_in_name_and_words() {
    let folder = tempfile::tempdir().expect("a folder");
    recorded(folder.path(), "20261121t103000-abcd", false);
    let out = folder.path().join("out");
    let arguments = [
        "export",
        "latest",
        "--out",
        text(&out),
        "--data",
        text(folder.path()),
    ];
    for _ in 0..2 {
        let (code, told) = said(&run(&arguments));
        assert_eq!(code, 0, "{told}");
        assert!(told.contains("NOT WHOLE: the run is still going"), "{told}");
    }
    let names = std::fs::read_dir(&out).expect("listed").flatten();
    let mut names: Vec<String> = names
        .map(|f| f.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort_unstable();
    let id = "20261121t103000-abcd-so-far";
    assert_eq!(
        names,
        [
            format!("{id}.csv"),
            format!("{id}.cycles.csv"),
            format!("{id}.datapackage.json")
        ]
    );
}

#[test]
fn runs_are_found_by_short_ids_and_listed_by_what_is_wanted() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path();
    for (id, ends) in [
        ("20261121t103000-abcd", true),
        ("20261122t103000-efgh", true),
        ("20261123t103000-ijkl", false),
    ] {
        recorded(data, id, ends);
    }
    let listed = |options: &[&str]| -> Vec<String> {
        let (runs, code) = json(data, &[&["runs"], options].concat());
        assert_eq!(code, 0, "{runs}");
        let runs = runs.as_array().expect("a list").iter();
        runs.map(|r| r["run_id"].as_str().expect("an id")[16..].to_owned())
            .collect()
    };
    assert_eq!(listed(&[]), ["abcd", "efgh", "ijkl"]);
    assert_eq!(listed(&["--result", "completed", "--limit", "1"]), ["efgh"]);
    assert_eq!(listed(&["--since", "2026-11-22"]), ["efgh", "ijkl"]);
    assert_eq!(
        listed(&["--operator", "OF 20261121", "--specimen", "leaf"]),
        ["abcd"]
    );
    assert_eq!(listed(&["--profile", "ramp"]), [""; 0]);

    let (several, code) = json(data, &["export", "202611"]);
    let why = several["error"].as_str().expect("a text");
    assert_eq!(code, 2);
    assert!(
        why.contains("stands for 3 runs") && why.contains("20261122t103000-efgh"),
        "{why}"
    );
    let (mistyped, code) = json(data, &["export", "20261122t103000-efgi"]);
    let why = mistyped["error"].as_str().expect("a text");
    assert!(
        code == 2 && why.contains("did you mean 20261122t103000-efgh?"),
        "{why}"
    );
    // What diagnose is given goes the same way, and its folder is looked at before any work.
    let (unknown, code) = json(data, &["diagnose", "zzzz", "--out", text(&data.join("out"))]);
    let why = unknown["error"].as_str().expect("a text");
    assert!(code == 2 && why.contains("there is no run \"zzzz\""), "{why}");
    let blocked = data.join("file");
    std::fs::write(&blocked, "x").expect("written");
    let (refused, code) = json(data, &["diagnose", "zzzz", "--out", text(&blocked)]);
    let why = refused["error"].as_str().expect("a text");
    assert!(
        code == 2 && why.contains("writing to the folder of --out failed"),
        "{why}"
    );
}

#[test]
fn new_files_pass_the_plan_as_they_are() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let (code, told) = run_in(folder, &["new", "profile", "my-test"]);
    assert!(
        code == 0 && told.contains("leafbench plan my-test.toml"),
        "{told}"
    );
    let (code, told) = run_in(folder, &["new", "bench", "my-rig"]);
    assert_eq!(code, 0, "{told}");
    let (code, told) = run_in(folder, &["plan", "my-test.toml", "--bench", "my-rig.toml"]);
    assert!(code == 0 && told.contains("stays within every limit"), "{told}");
    let (code, told) = run_in(folder, &["new", "profile", "my-test"]);
    assert!(code == 2 && told.contains("is there already"), "{told}");

    // The bench names the new specimen in place of its own.
    assert_eq!(run_in(folder, &["new", "specimen", "my-spring"]).0, 0);
    let bench = std::fs::read_to_string(folder.join("my-rig.toml")).expect("written");
    let (before, rest) = bench.split_once("name = \"spring-1\"").expect("a specimen");
    let (_, after) = rest.split_once("# Load cell").expect("the next table");
    let bench = format!("{before}file = \"my-spring.toml\"\n\n# Load cell{after}");
    std::fs::write(folder.join("my-rig.toml"), bench).expect("written");
    let (code, told) = run_in(folder, &["plan", "my-test.toml", "--bench", "my-rig.toml"]);
    assert!(code == 0 && told.contains("stays within every limit"), "{told}");
}

#[test]
fn a_profile_that_was_saved_on_the_page_is_found_by_its_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    std::fs::create_dir_all(folder.join("my-data/profiles")).expect("made");
    assert_eq!(run_in(folder, &["new", "profile", "my-own"]).0, 0);
    std::fs::rename(
        folder.join("my-own.toml"),
        folder.join("my-data/profiles/my-own.toml"),
    )
    .expect("moved");
    let (code, told) = run_in(folder, &["plan", "my-own"]);
    assert!(code == 2 && told.contains("there is no profile"), "{told}");
    let (code, told) = run_in(folder, &["plan", "my-own", "--data", "my-data"]);
    assert!(code == 0 && told.contains("stays within every limit"), "{told}");
    let (code, told) = run_in(folder, &["plan", "static-ramp", "--data", "my-data"]);
    assert!(code == 0, "{told}");
}

#[test]
fn mistyped_names_are_asked_about() {
    for (arguments, meant) in [
        (&["plan", "static-rmp"][..], "did you mean static-ramp?"),
        (
            &["plan", "static-ramp", "--bench", "mokc.toml"],
            "benches/mock.toml?",
        ),
        (&["plan", "sine-6mm-1Hz.toml"], "sine-6mm-1hz.toml?"),
    ] {
        let (code, told) = said(&run(arguments));
        assert!(code == 2 && told.contains(meant), "{arguments:?}: {told}");
    }
}

#[test]
fn every_error_is_json_for_scripts() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = text(folder.path());
    for (arguments, code) in [
        (&["fly", "--json"][..], 2),
        (&["--json"], 2),
        (&["plan", "--json"], 2),
        (&["plan", "no-such-profile", "--json"], 2),
        (&["runs", "--since", "yesterday", "--json"], 2),
        (&["status", "--json", "--data", data], 3),
        (&["watch", "--json", "--data", data], 3),
        (
            &[
                "status",
                "--wait",
                "ready",
                "--timeout",
                "0",
                "--json",
                "--data",
                data,
            ],
            3,
        ),
    ] {
        let output = run(arguments);
        let stderr = String::from_utf8_lossy(&output.stderr);
        let error: serde_json::Value =
            serde_json::from_str(&stderr).unwrap_or_else(|e| panic!("{arguments:?}: {e}: {stderr}"));
        assert_eq!(output.status.code(), Some(code), "{arguments:?}");
        assert_eq!(error["exit_code"], code, "{arguments:?}");
        assert!(error["error"].as_str().is_some_and(|e| e.len() > 20), "{error}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
    }
    // Help is no error.
    assert_eq!(run(&["--help", "--json"]).status.code(), Some(0));
}

/// Six seconds of motion: long enough to lose the terminal in.
const SECONDS: &str = "name = \"seconds\"\ncontrol = \"displacement\"\n[[block]]\n\
                       [[block.segment]]\nkind = \"ramp\"\nto_mm = 3.0\nduration_s = 3.0\n\
                       [[block.segment]]\nkind = \"ramp\"\nto_mm = 0.0\nduration_s = 3.0\n";

#[test]
fn a_run_is_watched_again_after_its_terminal_was_closed() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let daemon = Daemon::start(&data, &[]);
    let (status, code) = json(&data, &["status", "--wait", "ready", "--timeout", "300"]);
    assert_eq!((code, &status["rig"]["phase"]), (0, &"ready".into()), "{status}");
    let (none, code) = json(&data, &["watch"]);
    assert!(
        code == 4 && none["error"].as_str().is_some_and(|e| e.contains("no run")),
        "{none}"
    );

    let profile = folder.path().join("seconds.toml");
    std::fs::write(&profile, SECONDS).expect("written");
    let mut command = leafbench(&["run", text(&profile), "--data", text(&data)]);
    let terminal = command.stderr(Stdio::null()).stdout(Stdio::null()).spawn();
    let terminal = Process(terminal.expect("starts"));
    until("a run", || {
        (daemon.status()["run"]["state"] == "running").then_some(())
    });
    // The laptop is closed: the process ends without a word.
    drop(terminal);
    let (waited, code) = json(&data, &["status", "--wait", "ready", "--timeout", "0"]);
    assert_eq!(code, 1, "the bench runs: {waited}");
    let (ended, code) = json(&data, &["watch"]);
    assert_eq!((code, &ended["ending"]), (0, &"completed".into()), "{ended}");
    // Later the same end is told.
    let (again, code) = json(&data, &["watch"]);
    assert_eq!((code, &again), (0, &ended));
}

#[test]
fn completions_and_manual_pages_have_every_command() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let (code, script) = said(&run(&["completions", shell]));
        assert_eq!(code, 0, "{shell}");
        for command in crate::cli::command_names() {
            assert!(script.contains(command), "{shell}: {command}");
        }
    }
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("man");
    let (code, told) = said(&run(&["man", "--out", text(&out)]));
    assert_eq!(code, 0, "{told}");
    for command in crate::cli::command_names() {
        let page = std::fs::read_to_string(out.join(format!("leafbench-{command}.1"))).expect(command);
        assert!(
            page.contains(&format!(".TH leafbench-{command} 1")) && page.contains("Examples:"),
            "{command}: {page}"
        );
    }
    let program = std::fs::read_to_string(out.join("leafbench.1")).expect("written");
    assert!(program.contains("leafbench\\-export(1)"), "{program}");
    assert!(program.contains("leafbench\\-token(1)"), "{program}");
    // Parts of a command have a page too, because that of the command names them.
    for part in [
        "token-add",
        "token-list",
        "token-remove",
        "audit-show",
        "audit-verify",
        "fleet-coverage",
        "fleet-diagnose",
        "fleet-estimate",
        "fleet-predict",
        "fleet-report",
    ] {
        assert!(out.join(format!("leafbench-{part}.1")).is_file(), "{part}");
    }
    assert_eq!(
        std::fs::read_dir(&out).expect("listed").count(),
        1 + crate::cli::command_names().count() + 10
    );
}
