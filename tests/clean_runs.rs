//! Runs of the shipped profiles on a mock rig that conceals nothing: the twin raises no alarm, and `diagnose` finds nothing.

use std::sync::{Arc, Mutex};

use super::support::bench::{order, play, seeded, shipped_profiles, twin};
use crate::cli::virtual_bench::VirtualBench;
use crate::diagnose::{Baseline, DiagnoseOptions, Verdict, diagnose};
use crate::model;
use crate::recording::EventKind;
use crate::recording::csv;
use crate::recording::memory::Memory;

/// Seeds of the sensor noise in CI; the long test draws its own.
const SEEDS: [u64; 3] = [1, 2, 3];
/// Profiles and seeds of which a diagnosis once found something: lost motion of 0.6 and 2 um, a limit above every force, structure
/// where the servo settles in a hold, structure where the fitted cycles were all unloading, and a delay of 0.8 ms.
const ONCE_FOUND: [(&str, u64); 7] = [
    ("ramp-hold-steps", 11),
    ("sine-6mm-2.5hz-10", 11),
    ("sine-6mm-2.5hz-10", 13),
    ("static-ramp-12s", 12),
    ("static-ramp-12s", 1_795_373_042),
    ("table", 11),
    ("table", 16),
];
/// Number of runs of every profile in the long tests, and the first of their seeds.
const RUNS: &str = "LEAFBENCH_CLEAN_RUNS";
const FIRST_SEED: &str = "LEAFBENCH_CLEAN_SEED";

fn from_environment(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().expect(name))
}

fn now_s() -> u64 {
    let now = std::time::SystemTime::UNIX_EPOCH.elapsed();
    now.expect("after 1970").as_secs()
}

/// Plays a profile twice on one bench, because the second run begins where the first left the specimen; the alarms of both.
fn alarms(profile: &str, seed: u64) -> Vec<String> {
    let bench = seeded(seed);
    let mut virtual_bench = VirtualBench::new(&bench, None).expect("a sound bench");
    let mut found = Vec::new();
    for run in 1..=2 {
        let kept = Arc::new(Mutex::new(Memory::default()));
        let mut chain = twin(&bench, Box::new(Arc::clone(&kept)));
        let ran = virtual_bench.play(order(&bench, profile), &mut chain, |_| {});
        let outcome = ran.expect("runs");
        assert_eq!(outcome.cause, "", "run {run} with seed {seed}");
        let memory = kept.lock().expect("one thread");
        assert!(
            memory.samples.iter().any(|s| s.twin_force_n.is_some()),
            "the twin ran"
        );
        let reports = memory
            .events
            .iter()
            .filter(|e| e.kind == EventKind::ModelMismatch);
        found.extend(reports.map(|e| format!("run {run}, {:.3} s: {}", e.time_s, e.text)));
    }
    found
}

/// Alarms of every shipped profile with these seeds, as lines.
fn all_alarms(seeds: impl Iterator<Item = u64> + Clone) -> Vec<String> {
    let mut lines = Vec::new();
    for (name, profile) in shipped_profiles() {
        let mut count = 0;
        for seed in seeds.clone() {
            let found = alarms(&profile, seed);
            count += found.len();
            lines.extend(found.into_iter().map(|a| format!("{name}, seed {seed}, {a}")));
        }
        println!("{name}: {} runs, {count} alarms", 2 * seeds.clone().count());
    }
    lines
}

#[test]
fn the_twin_raises_no_alarm_on_clean_runs_of_every_shipped_profile() {
    let found = all_alarms(SEEDS.into_iter());
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// What `diagnose` finds in the exported run of a profile, with the bench's own model as the baseline; `None` if that is adequate.
fn finding(profile: &str, seed: u64) -> Option<String> {
    let folder = tempfile::tempdir().expect("a folder");
    let bench = seeded(seed);
    let (_, csv) = play(&bench, profile, Some(folder.path()));
    let recording = csv::read_file(&csv.expect("exported")).expect("a recording");
    let mut baseline = Baseline::of(model::find(&bench.model.name).expect("listed"));
    baseline.start = Some(bench.model.values().expect("sound"));
    let found = diagnose(
        &[recording],
        &baseline,
        &DiagnoseOptions::default(),
        &mut |_, _| {},
    );
    let found = found.expect("diagnosed");
    let codes: Vec<_> = found.effects.iter().map(|e| (&e.code, e.confidence)).collect();
    (found.verdict != Verdict::Adequate).then(|| format!("{} {codes:?}", found.summary))
}

#[test]
fn a_diagnosis_finds_nothing_in_clean_runs() {
    let profiles = shipped_profiles();
    for (name, seed) in ONCE_FOUND {
        let (_, profile) = profiles.iter().find(|(n, _)| n == name).expect("shipped");
        assert_eq!(finding(profile, seed), None, "{name}, seed {seed}");
    }
}

/// As `a_hundred_clean_runs_of_every_shipped_profile`, with a diagnosis of each run.
#[test]
#[ignore = "half an hour: run it after a change of the diagnosis"]
fn a_diagnosis_finds_nothing_in_clean_runs_of_every_shipped_profile() {
    let (first, runs) = (from_environment(FIRST_SEED, now_s()), from_environment(RUNS, 10));
    println!("first seed {first}");
    let mut found = Vec::new();
    for (name, profile) in shipped_profiles() {
        let of_profile = (first..first + runs).filter_map(|seed| Some((seed, finding(&profile, seed)?)));
        let before = found.len();
        found.extend(of_profile.map(|(seed, text)| format!("{name}, seed {seed}: {text}")));
        println!("{name}: {runs} runs, {} with a finding", found.len() - before);
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// `LEAFBENCH_CLEAN_RUNS=50 LEAFBENCH_CLEAN_SEED=N cargo test --lib clean_runs -- --ignored --nocapture`: 100 runs of every
/// profile, in pairs on one bench. The seeds are new in every call unless they are given.
#[test]
#[ignore = "minutes: run it after a change of twin, servo or sensors"]
fn a_hundred_clean_runs_of_every_shipped_profile() {
    let first = from_environment(FIRST_SEED, now_s());
    println!("first seed {first}");
    let found = all_alarms(first..first + from_environment(RUNS, 50));
    assert!(found.is_empty(), "{}", found.join("\n"));
}
