//! Every command of README.md (its indented blocks), typed as it stands in a fresh copy of the tree, one after the other. Only what
//! the README leaves to the reader is filled in: RUN is a run of this bench, and the tables of other programs are those that it
//! describes. The daemon gets a free port.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::support::{Daemon, http, program, until};
use crate::cli;

/// Commands that are checked for their arguments only, by how they begin, and why.
const PARSED_ONLY: &[(&str, &str)] = &[
    (
        "leafbench mock-rig --bench bench-configs/benches/mock-vcan.toml",
        "needs CAN (vcan0); tests/two_processes.rs runs it",
    ),
    (
        "leafbench daemon --bench bench-configs/benches/mock-vcan.toml",
        "needs CAN (vcan0); tests/two_processes.rs runs it",
    ),
    (
        "leafbench rig-check --link serial:/dev/ttyUSB0",
        "needs a rig at a serial port; tests/rig_check runs it over a pseudo-terminal",
    ),
    (
        "leafbench papers",
        "computes for minutes; the tests of `papers` and `identify` check its results",
    ),
];
/// Commands of cargo that build or test: this test is one of them.
const OF_CARGO: &[&str] = &["cargo test --release"];
/// The daemon of the README, which the other commands find through its data folder.
const DAEMON: &str = "leafbench daemon --bench bench-configs/benches/mock.toml";
/// The program as cargo runs it.
const CARGO_RUN: &str = "cargo run --release -- ";
/// Not part of a fresh clone.
const NOT_COPIED: [&str; 7] = [
    "target",
    ".git",
    "leafbench-data",
    "leafbench-demo",
    "loops",
    "diagnosis",
    "fleet-report",
];

/// The commands of a document: lines that are indented by four columns or more and begin with a program.
fn commands(text: &str) -> Vec<String> {
    let indented = text.lines().filter(|line| line.starts_with("    "));
    let lines = indented.map(|line| line.trim().to_owned());
    lines
        .filter(|line| line.starts_with("leafbench ") || line.starts_with("cargo "))
        .collect()
}

/// The words of a line as a shell takes them: quotes keep spaces.
fn words(line: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut quoted = false;
    for c in line.chars() {
        match c {
            '"' => quoted = !quoted,
            ' ' if !quoted => words.push(String::new()),
            c => words.last_mut().expect("never empty").push(c),
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("created");
    for entry in std::fs::read_dir(from).expect("readable") {
        let entry = entry.expect("an entry");
        let (path, name) = (entry.path(), entry.file_name());
        if NOT_COPIED.iter().any(|left_out| *left_out == name) {
            continue;
        }
        // A link becomes what it leads to.
        match path.is_dir() {
            true => copy(&path, &to.join(name)),
            false => drop(std::fs::copy(&path, to.join(name)).expect("copied")),
        }
    }
}

/// The fresh copy, with a free port in place of 7117.
fn fresh_copy(to: &Path) {
    copy(Path::new(env!("CARGO_MANIFEST_DIR")), to);
    let bench = to.join("bench-configs/benches/mock.toml");
    let text = std::fs::read_to_string(&bench).expect("shipped");
    assert!(text.contains("127.0.0.1:7117"), "the port that the README names");
    std::fs::write(bench, text.replace("127.0.0.1:7117", "127.0.0.1:0")).expect("written");
}

/// The program in the fresh copy, which finds nothing of this tree.
fn leafbench(words: &[String], folder: &Path) -> Command {
    let mut command = Command::new(program());
    command
        .args(words)
        .current_dir(folder)
        .env_remove("LEAFBENCH_DATA")
        .stdin(Stdio::null());
    command
}

/// Run ids in the order of their exports: names of the CSVs of whole runs in `loops`.
fn exported_runs(folder: &Path) -> Vec<String> {
    let Ok(files) = std::fs::read_dir(folder.join("loops")) else {
        return Vec::new();
    };
    let names = files.filter_map(|file| file.ok()?.file_name().into_string().ok());
    let mut runs: Vec<String> = names
        .filter_map(|name| Some(name.strip_suffix(".csv")?.to_owned()))
        .filter(|name| !name.contains('.') && !name.contains("mean"))
        .collect();
    runs.sort();
    runs
}

/// Puts what the reader has in place of what the README calls RUN and OTHER, and writes the tables of other programs.
fn filled_in(line: &str, folder: &Path) -> String {
    let runs = exported_runs(folder);
    if !["RUN", "OTHER", "logger.csv", "table.csv"]
        .iter()
        .any(|word| line.contains(word))
    {
        return line.to_owned();
    }
    let newest = runs.last().expect("a run was exported before").clone();
    if line.contains("logger.csv") && line.contains("import") {
        write_logger(
            &folder.join(format!("loops/{newest}.csv")),
            &folder.join("logger.csv"),
        );
    }
    if line.contains("table.csv") {
        let table = "peak_force_n,loop_energy_j,motion,stroke_mm,frequency_hz,valley_mm,duration_s\n\
                     2000,6.1,ramp,24.2,,,120\n1100,2.9,sine,12,1,2,\n1500,4.3,sine,16,1,2,\n";
        std::fs::write(folder.join("table.csv"), table).expect("written");
    }
    // A second run of the same test stands for another one.
    let other = folder.join(format!("loops/{newest}-2.csv"));
    if line.contains("OTHER") {
        std::fs::copy(folder.join(format!("loops/{newest}.csv")), &other).expect("copied");
    }
    line.replace("OTHER", &format!("{newest}-2"))
        .replace("RUN", &newest)
}

/// A recording as another program writes it: other names, kN, the opposite sign of the force, no time.
fn write_logger(csv: &Path, logger: &Path) {
    let recording = crate::recording::csv::read_file(csv).expect("exported");
    let mut text = "Weg,Kraft\n".to_owned();
    for (mm, n) in recording.displacement_mm.iter().zip(&recording.force_n) {
        text += &format!("{mm:.4},{:.5}\n", -0.001 * n);
    }
    std::fs::write(logger, text).expect("written");
}

/// A person types no faster than this: the rig has unloaded and was still for a second.
fn until_at_rest(daemon: &Daemon) {
    daemon.until_phase("ready");
    until("a second of samples", || {
        let reading = http::get_json(daemon, "/api/reading");
        (reading["samples"] == 1000).then_some(())
    });
}

fn run_one(line: &str, folder: &Path) {
    let line = filled_in(line, folder);
    let words = words(&line);
    let output = leafbench(&words[1..], folder)
        .output()
        .expect("the program starts");
    assert_eq!(
        output.status.code(),
        Some(0),
        "{line}\n{}\n{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
}

#[test]
fn every_command_of_the_readme_works_as_it_stands_in_a_fresh_copy() {
    let folder = tempfile::tempdir().expect("a folder");
    let tree: PathBuf = folder.path().join("leafbench");
    fresh_copy(&tree);
    let text = std::fs::read_to_string(tree.join("README.md")).expect("copied");
    let commands = commands(&text);
    assert!(commands.len() >= 25, "{} commands", commands.len());
    let mut daemon = None;
    for line in &commands {
        if OF_CARGO.contains(&line.as_str()) {
            continue;
        }
        let line = line
            .strip_prefix(CARGO_RUN)
            .map_or(line.clone(), |words| format!("leafbench {words}"));
        let parsed = words(&line);
        assert_eq!(
            parsed[0], "leafbench",
            "{line}: add it to OF_CARGO with its reason, or write it as {CARGO_RUN}"
        );
        assert_eq!(cli::refusal(&parsed), None, "{line}");
        if let Some((_, why)) = PARSED_ONLY.iter().find(|(begin, _)| line.starts_with(begin)) {
            eprintln!("PARSED ONLY {line}: {why}");
            continue;
        }
        match line == DAEMON {
            true => {
                let mut command = leafbench(&parsed[1..], &tree);
                command.arg("--json");
                let started = Daemon::start_command(command, |_| tree.join("leafbench-data"));
                started.until_phase("ready");
                daemon = Some(started);
            }
            false => run_one(&line, &tree),
        }
        // A run ends with an unload; the next command of a person comes later than that.
        if let Some(daemon) = &daemon {
            until_at_rest(daemon);
        }
    }
    assert!(daemon.is_some(), "the README starts a daemon");
    for (begin, _) in PARSED_ONLY {
        assert!(
            commands.iter().any(|line| line.starts_with(begin)),
            "{begin} is not in the README any more"
        );
    }
}

#[test]
fn words_are_those_of_a_shell() {
    assert_eq!(
        words("a  --map \"Weg=x,Kraft=y*2\" c"),
        ["a", "--map", "Weg=x,Kraft=y*2", "c"]
    );
    assert_eq!(
        commands("text\n    leafbench a\n       leafbench b --c\n  leafbench d\n    ls\n"),
        ["leafbench a", "leafbench b --c"]
    );
}
