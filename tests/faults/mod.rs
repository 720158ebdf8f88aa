//! The fault matrix of docs/faults.md, row by row: each row has a test that begins with its id. What the tests measure in virtual
//! time is in the document's table "Measured", and each test compares its row. `LEAFBENCH_RECORD=1 cargo test --release faults` writes it.

mod daemon;
mod firmware;
mod link;
mod network;
mod profiles;
mod random;
mod rig;
mod sensors;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::support::virtual_rig::{VirtualRig, order, sine};
use crate::control::Phase;
use crate::detector::Off;
use crate::mockrig::{FAULTS, Injection, MockRigConfig};
use crate::protocol::message::RigState;
use crate::recording::{Ending, EventKind, Outcome};

/// What a row's test saw: times from the begin of the fault, ms of virtual time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Measured {
    /// Until the detector of the row acted.
    detected_ms: u64,
    /// Until the reaction of the row had begun.
    reacted_ms: u64,
    /// Samples missing in the record.
    lost: u64,
    /// Longest time to the reaction that the row allows, ms.
    allowed_ms: u64,
}

impl Measured {
    fn line(&self, id: &str) -> String {
        format!(
            "| {id} | {} | {} | {} | {} |",
            self.detected_ms, self.reacted_ms, self.lost, self.allowed_ms
        )
    }
}

const MEASURED_HEADING: &str = "| id | detected, ms | reaction, ms | samples lost | allowed, ms |";

fn document() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/faults.md")
}

/// Compares what was measured with the table of the document, or writes it there.
fn is_as_documented(id: &str, measured: Measured) {
    static WRITING: Mutex<()> = Mutex::new(());
    let line = measured.line(id);
    println!("{line}");
    assert!(
        measured.reacted_ms <= measured.allowed_ms,
        "{id}: the reaction took {} ms, {} ms are allowed",
        measured.reacted_ms,
        measured.allowed_ms
    );
    let _guard = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
    let text = std::fs::read_to_string(document()).expect("the document is in the repository");
    let start = text
        .find(MEASURED_HEADING)
        .expect("the table of what was measured");
    let of_row = text[start..]
        .lines()
        .find(|l| l.starts_with(&format!("| {id} |")));
    if std::env::var_os("LEAFBENCH_RECORD").is_none() {
        assert_eq!(
            of_row,
            Some(line.as_str()),
            "{id}: run `LEAFBENCH_RECORD=1 cargo test --release faults`, and read the difference"
        );
        return;
    }
    let written = match of_row {
        Some(old) => text.replace(old, &line),
        None => {
            let at = text[start..].find("\n\n").map_or(text.len(), |end| start + end);
            format!("{}\n{line}{}", &text[..at], &text[at..])
        }
    };
    std::fs::write(document(), written).expect("the document can be written");
}

/// A bench 3 s into a ramp of 4 s to 18 mm, at about 13 mm and 1000 N.
fn moving() -> VirtualRig {
    let mut bench = VirtualRig::new();
    bench.start(sine(6.0, 1.0, 3));
    bench.ticks(3_000);
    bench
}

/// The same, of a mock rig with faults from its own schedule.
fn with_faults(faults: &[&str]) -> VirtualRig {
    VirtualRig::with(&MockRigConfig {
        faults: faults.iter().map(|fault| (*fault).to_owned()).collect(),
        ..MockRigConfig::default()
    })
}

/// Puts one fault into an injection.
type Inject = fn(&mut Injection);

/// Injects a fault, and measures how long it takes until it is `detected` and until the reaction has begun (`reacted`).
fn measure(
    bench: &mut VirtualRig,
    inject: impl FnOnce(&mut Injection),
    detected: impl Fn(&VirtualRig) -> bool,
    reacted: impl Fn(&VirtualRig) -> bool,
    allowed_ms: u64,
) -> Measured {
    inject(&mut bench.mock.injection);
    let mut detected_ms = None;
    for ms in 1..=allowed_ms {
        bench.tick();
        if detected_ms.is_none() && detected(bench) {
            detected_ms = Some(ms);
        }
        if reacted(bench) {
            return Measured {
                detected_ms: detected_ms.unwrap_or(ms),
                reacted_ms: ms,
                lost: 0,
                allowed_ms,
            };
        }
    }
    panic!(
        "no reaction within {allowed_ms} ms, the rig is {} ({}): {:#?}",
        bench.mock.state(),
        bench.mock.cause(),
        bench.rig.status()
    );
}

/// The run has ended for the daemon, which still records.
fn run_ended(bench: &VirtualRig) -> bool {
    bench.rig.phase() != Phase::Running
}

fn rig_unloads(bench: &VirtualRig) -> bool {
    bench.mock.state() == RigState::Unload
}

fn rig_is_off(bench: &VirtualRig) -> bool {
    bench.mock.state() == RigState::Tripped && !bench.mock.pressure_on()
}

fn outcome(bench: &VirtualRig) -> &Outcome {
    bench.memory.outcome.as_ref().expect("the run ended")
}

/// The fault is over. The run is closed as aborted with `words` in its cause, and the bench is latched until a reset, which moves
/// nothing.
fn is_aborted_and_latched(bench: &mut VirtualRig, words: &str) {
    bench.mock.injection = Injection::default();
    bench.until(Phase::Interlocked, 30_000);
    let end = outcome(bench);
    assert_eq!(end.ending, Ending::Aborted, "{}", end.cause);
    assert!(end.cause.contains(words), "{}", end.cause);
    assert!(bench.rig.start(order(sine(1.0, 1.0, 1))).is_err(), "latched");
    let at_mm = bench.mock.displacement_mm();
    bench.rig.reset().expect("is interlocked");
    bench.ticks(300);
    assert!(
        (bench.mock.displacement_mm() - at_mm).abs() < 0.1,
        "a reset moved the rig"
    );
    assert!(!bench.mock.pressure_on(), "a reset switched the pressure on");
}

/// The texts of the events of the run so far that contain `words`.
fn told(bench: &VirtualRig, words: &str) -> usize {
    bench
        .memory
        .events
        .iter()
        .filter(|event| event.text.contains(words))
        .count()
}

/// Every sample is in the record or counted as lost, and all gaps are told.
fn account_is_closed(bench: &VirtualRig) {
    let samples = &bench.memory.samples;
    let (first, last) = (
        samples.first().expect("samples"),
        samples.last().expect("samples"),
    );
    let end = outcome(bench);
    assert_eq!(end.samples, samples.len() as u64);
    assert_eq!(last.tick - first.tick + 1, end.samples + end.lost, "{end:?}");
    assert!(
        samples.windows(2).all(|w| w[1].tick > w[0].tick),
        "in order, none twice"
    );
    let gaps = bench
        .memory
        .events
        .iter()
        .filter(|e| e.kind == EventKind::Gap)
        .count();
    let gaps_in_ticks = samples.windows(2).filter(|w| w[1].tick != w[0].tick + 1).count();
    assert_eq!(gaps, gaps_in_ticks, "each gap has its event");
}

/// The ids of the rows of docs/faults.md.
fn rows() -> Vec<String> {
    let text = std::fs::read_to_string(document()).expect("the document is in the repository");
    let matrix = text.split("## Fault matrix").nth(1).unwrap_or_default();
    let matrix = matrix.split("## Measured").next().unwrap_or_default();
    let is_id = |id: &str| {
        let (letter, number) = id.split_at(id.len().min(1));
        letter.chars().all(|c| c.is_ascii_uppercase()) && number.parse::<u32>().is_ok()
    };
    let first_cell = |line: &str| line.split('|').nth(1).map(|cell| cell.trim().to_owned());
    matrix
        .lines()
        .filter_map(first_cell)
        .filter(|id| is_id(id))
        .collect()
}

/// All Rust text below a folder.
fn sources(folder: &Path) -> String {
    let mut text = String::new();
    for entry in std::fs::read_dir(folder).expect("a folder of the repository") {
        let path = entry.expect("readable").path();
        if path.is_dir() {
            text += &sources(&path);
        } else if path.extension().is_some_and(|e| e == "rs") {
            text += &std::fs::read_to_string(&path).expect("readable");
        }
    }
    text
}

/// Rows that a step of CI proves, because no test can: the power cut, and what others publish about dependencies.
const STEPS_OF_CI: [(&str, &str); 2] = [
    ("O4", ".ci/power-cut \"$binary\""),
    ("N11", "check licenses bans sources"),
];

#[test]
fn matrix_is_complete() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let code = sources(&root.join("src")) + &sources(&root.join("tests"));
    let rows = rows();
    assert!(rows.len() > 70, "the matrix was not understood: {rows:?}");
    let unique: BTreeSet<&String> = rows.iter().collect();
    assert_eq!(unique.len(), rows.len(), "an id stands twice");
    let tests: Vec<&str> = code
        .lines()
        .filter_map(|line| line.trim_start().strip_prefix("fn "))
        .collect();
    let has_test = |id: &str| {
        let begin = format!("{}_", id.to_lowercase());
        tests.iter().any(|test| {
            // One test can cover two rows: n3_n4_...
            let after_a_row = test
                .split_once('_')
                .filter(|(first, _)| unique.contains(&first.to_uppercase()));
            test.starts_with(&begin) || after_a_row.is_some_and(|(_, more)| more.starts_with(&begin))
        })
    };
    let ci = std::fs::read_to_string(root.join(".ci/run")).expect("CI");
    let of_ci = |id: &str| {
        STEPS_OF_CI
            .iter()
            .any(|(row, step)| *row == id && ci.contains(step))
    };
    let missing: Vec<&String> = rows.iter().filter(|id| !has_test(id) && !of_ci(id)).collect();
    assert!(
        missing.is_empty(),
        "rows without a test that begins with their id: {missing:?}"
    );
}

/// The table of faults that can be played says of each what the program says.
#[test]
fn every_fault_that_can_be_played_is_documented() {
    let text = std::fs::read_to_string(document()).expect("the document is in the repository");
    let table = text
        .split("## Play faults on the mock rig")
        .nth(1)
        .expect("the section");
    let table = table.split("\n## ").next().unwrap_or_default();
    let documented: Vec<&str> = table.lines().filter(|line| line.starts_with("| `")).collect();
    let wanted: Vec<String> = FAULTS
        .iter()
        .map(|fault| {
            let unit = |amount: &crate::mockrig::Amount| {
                if amount.unit == "-" {
                    String::new()
                } else {
                    format!(" {}", amount.unit)
                }
            };
            let [default, range] = fault.amount.map_or(["-".to_owned(), "-".to_owned()], |amount| {
                let [low, high] = amount.range;
                [
                    format!("{}{}", amount.default, unit(&amount)),
                    format!("{low} to {high}{}", unit(&amount)),
                ]
            });
            format!("| `{}` | {default} | {range} | {} |", fault.name, fault.what)
        })
        .collect();
    assert_eq!(documented, wanted);
}

/// A row's test without its comparison with the document.
type Body = fn() -> Measured;

/// Each detector that can be switched off, with the test that must then fail.
const DETECTORS: &[(&str, Body)] = &[
    ("L1", link::l1),
    ("L2", link::l2),
    ("L3", link::l3),
    ("L4", link::l4),
    ("L5", link::l5),
    ("L6", link::l6),
    ("L6 firmware", link::l6_firmware),
    ("L7", link::l7),
    ("L9", link::l9),
    ("L10", link::l10),
    ("L10 firmware", link::l10_firmware),
    ("L11", link::l11),
    ("L14", link::l14),
    ("L16", link::l16),
    ("L17", link::l17),
    ("T2", link::t2),
    ("X1", sensors::x1),
    ("X2", sensors::x2),
    ("X3", sensors::x3),
    ("X3 daemon", sensors::x3_daemon),
    ("X4", sensors::x4),
    ("X5", sensors::x5),
    ("X6", sensors::x6),
    ("X7", sensors::x7),
    ("F1", firmware::f1),
    ("F2", firmware::f2),
    ("F3", firmware::f3),
    ("F4", firmware::f4),
    ("F5", firmware::f5),
    ("F6", firmware::f6),
    ("F7", firmware::f7),
    ("F8", firmware::f8),
    ("H1", rig::h1),
    ("H2", rig::h2),
    ("H3", rig::h3),
    ("H4", rig::h4),
    ("H5", rig::h5),
    ("H6", rig::h6),
    ("H7", rig::h7),
    ("H8", rig::h8),
    ("D1", daemon::d1),
    ("D4", daemon::d4),
    ("O1", daemon::o1),
];

#[test]
fn without_its_detector_each_row_fails() {
    let mut silent = Vec::new();
    for (detector, body) in DETECTORS {
        let _off = Off::new(detector);
        if std::panic::catch_unwind(body).is_ok() {
            silent.push(*detector);
        }
    }
    assert!(silent.is_empty(), "nobody notices the loss of {silent:?}");
}

/// A detector that is switched off in the code is in the list above.
#[test]
fn every_switch_is_in_the_list() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let code = sources(&root.join("src/control")) + &sources(&root.join("src/mockrig"));
    let switches: BTreeSet<&str> = code
        .split("detector::acts(\"")
        .skip(1)
        .filter_map(|rest| rest.split('"').next())
        .collect();
    let listed: BTreeSet<&str> = DETECTORS.iter().map(|(detector, _)| *detector).collect();
    assert_eq!(switches, listed);
}

/// A bench file with a mistyped fault is refused with its line.
#[test]
fn a_mistyped_fault_in_a_bench_file_is_refused_with_its_place() {
    let text = crate::tests::support::bench::mock().to_toml();
    let with = |fault: &str| text.replacen("[mock_rig]", &format!("[mock_rig]\nfaults = [\"{fault}\"]"), 1);
    assert_ne!(with("leak@3s"), text, "the bench has the table");
    crate::config::Bench::parse(&with("leak@run+3s..4s"), "bench.toml").expect("understood");
    let error = crate::config::Bench::parse(&with("leka@3s"), "bench.toml").expect_err("no such fault");
    let said = error.to_string();
    assert!(
        said.contains("did you mean leak?") && said.contains("bench.toml"),
        "{said}"
    );
}
