//! The proof of `fleet predict` from end to end: the last run of each specimen of a known laboratory is held out, predicted and judged.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::{Args, FromArgMatches};

use super::coverage::FleetCoverageArgs;
use super::diagnose::FleetDiagnoseArgs;
use super::predict::FleetPredictArgs;
use super::report::FleetReportArgs;
use crate::acceptance::{RunResult, RunVerdict};
use crate::archive::{AddOptions, ArchiveStore, add};
use crate::cli::{Done, Output, lab};
use crate::identify::confidence::wilson_interval;
use crate::recording::Recorder;
use crate::recording::run_file::{RunFile, RunFileWriter};
use crate::truth::{Lab, LabRequest};

const QUIET: Output = Output { json: true };

/// Arguments as they are typed.
fn typed<A: Args + FromArgMatches>(words: &[&str]) -> A {
    let command = A::augment_args(clap::Command::new("command").no_binary_name(true));
    let matches = command.try_get_matches_from(words).expect("arguments");
    A::from_arg_matches(&matches).expect("arguments")
}

/// The folder of a laboratory whose last runs are held out.
struct HeldOut {
    folder: tempfile::TempDir,
    /// Run files that are not in the archive, one for each specimen, each with whether an instrument was imperfect.
    last: Vec<(PathBuf, bool)>,
}

/// Runs that passed, of how many: those of sound instruments, and those of imperfect ones.
type PassedRuns = [(usize, usize); 2];

impl HeldOut {
    /// Draws a laboratory with some of its families, and archives and diagnoses all but the last run of each specimen.
    fn new(request: &LabRequest, families: &[usize]) -> HeldOut {
        let folder = tempfile::tempdir().expect("a folder");
        let mut lab = Lab::draw(request);
        let of_family: Vec<usize> = lab.specimens.iter().map(|s| s.family_index).collect();
        lab.runs.retain(|run| families.contains(&of_family[run.specimen]));
        lab::write(&lab, &folder.path().join("lab"), &QUIET).expect("written");
        let files = std::fs::read_dir(folder.path().join("lab/runs")).expect("listed");
        let mut files: Vec<PathBuf> = files.map(|e| e.expect("an entry").path()).collect();
        // The names begin with the start.
        files.sort();
        let specimen = |path: &PathBuf| RunFile::open(path).expect("opens").header().specimen.clone();
        let last: BTreeMap<String, PathBuf> =
            files.iter().map(|path| (specimen(path), path.clone())).collect();
        files.retain(|path| last.values().all(|held| held != path));
        let archive = folder.path().join("archive");
        let store = ArchiveStore::open(&archive.display().to_string()).expect("made");
        add(&store, &files, AddOptions::default(), &|_| {}).expect("archived");
        let words = [&archive.display().to_string(), "--estimates-only"];
        typed::<FleetDiagnoseArgs>(&words).run(&QUIET).expect("diagnosed");
        let last = last.into_values().map(|path| {
            let imperfect = is_imperfect(&lab, &path);
            (path, imperfect)
        });
        HeldOut {
            folder,
            last: last.collect(),
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Predicts each held-out run and judges it by the predicted profile.
    fn passed(&self, more: &[&str]) -> PassedRuns {
        let mut passed = PassedRuns::default();
        for (path, imperfect) in &self.last {
            let of = &mut passed[usize::from(*imperfect)];
            of.0 += usize::from(self.verdict(path, more) == RunVerdict::Pass);
            of.1 += 1;
        }
        passed
    }

    fn verdict(&self, path: &Path, more: &[&str]) -> RunVerdict {
        let run = RunFile::open(path).expect("opens");
        let header = run.header().clone();
        let [bench, profile] = ["bench.toml", "profile.toml"].map(|name| self.path(name));
        std::fs::write(&bench, &header.bench_toml).expect("written");
        std::fs::write(&profile, &header.profile_toml).expect("written");
        let names = [
            self.path("archive"),
            profile,
            self.path("lab/specimens.csv"),
            bench,
            self.path("predicted"),
        ];
        let [archive, profile, specimens, bench, out] = names.map(|path| path.display().to_string());
        let words = [
            "--specimens",
            &specimens,
            "--bench",
            &bench,
            "--out",
            &out,
            "--at",
            &header.started_utc,
            "--force",
        ];
        let words = [&[archive.as_str(), profile.as_str()], &words[..], more].concat();
        typed::<FleetPredictArgs>(&words).run(&QUIET).expect("predicted");
        let predicted = self
            .path("predicted")
            .join(format!("{}-predicted.toml", header.profile_name));
        let judged = self.path("judged.leafrun");
        let _ = std::fs::remove_file(&judged);
        let profile_toml = std::fs::read_to_string(predicted).expect("read");
        let mut writer = RunFileWriter::create(
            &judged,
            &crate::recording::Header {
                profile_toml,
                ..header
            },
        )
        .expect("made");
        run.samples().for_each(|sample| writer.sample(&sample));
        writer.end(run.outcome().expect("an end"));
        let result = RunResult::of(&RunFile::open(&judged).expect("opens"));
        println!(
            "{} {more:?}: {:?} {}",
            result.specimen, result.verdict, result.why
        );
        result.verdict
    }
}

/// True if an instrument was imperfect in a run: its file ends in its number.
fn is_imperfect(lab: &Lab, path: &Path) -> bool {
    let stem = path.file_stem().and_then(|stem| stem.to_str()).expect("a name");
    let number: usize = stem
        .rsplit('-')
        .next()
        .expect("a number")
        .parse()
        .expect("a number");
    let family = &lab.families[lab.specimens[lab.runs[number - 1].specimen].family_index];
    let test = lab::PlayedTest::new(&family.name, family.top_mm).expect("played");
    lab.record_and_tell(number - 1, &test.test).1
}

/// What the drawings of a laboratory said of its specimens: verdict of each specimen in each quantity.
fn verdicts(request: &LabRequest, families: &[usize]) -> BTreeMap<(String, String), String> {
    let folder = tempfile::tempdir().expect("a folder");
    let mut lab = Lab::draw(request);
    let of_family: Vec<usize> = lab.specimens.iter().map(|s| s.family_index).collect();
    lab.runs.retain(|run| families.contains(&of_family[run.specimen]));
    lab::write(&lab, &folder.path().join("lab"), &QUIET).expect("written");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (archive, out) = (path("archive"), path("report"));
    let [specimens, drawings] = ["lab/specimens.csv", "lab/drawings.toml"].map(path);
    let files = std::fs::read_dir(path("lab/runs")).expect("listed");
    let files: Vec<PathBuf> = files.map(|e| e.expect("an entry").path()).collect();
    let store = ArchiveStore::open(&archive).expect("made");
    add(&store, &files, AddOptions::default(), &|_| {}).expect("archived");
    typed::<FleetDiagnoseArgs>(&[&archive, "--estimates-only"])
        .run(&QUIET)
        .expect("diagnosed");
    let words = [
        &archive,
        "--specimens",
        &specimens,
        "--drawings",
        &drawings,
        "--out",
        &out,
    ];
    typed::<FleetReportArgs>(&words).run(&QUIET).expect("reported");
    let table = csv::Reader::from_path(path("report/drawings.csv")).expect("written");
    let rows = table.into_deserialize::<BTreeMap<String, String>>();
    rows.map(|row| {
        let row = row.expect("a row");
        (
            (row["specimen"].clone(), row["quantity"].clone()),
            row["verdict"].clone(),
        )
    })
    .collect()
}

/// The two families that have the outliers, with four runs a specimen. The rate has a nominal and is sure. The friction is compared with nine
/// others that scatter by 5 %: its outlier, 10 % beyond the limit, is out of tolerance or undecided, but never within.
#[test]
fn the_outliers_of_a_laboratory_are_not_within_tolerance_and_nothing_else_is_out() {
    for nothing in [false, true] {
        let request = LabRequest {
            seed: 72,
            specimens: 40,
            runs: 160,
            nothing,
        };
        let verdicts = verdicts(&request, &[0, 3]);
        assert_eq!(verdicts.len(), 40, "two quantities of 20 specimens");
        let of = |specimen: &str, quantity: &str| {
            let key = (specimen.to_owned(), quantity.to_owned());
            verdicts[&key].as_str()
        };
        let [rate, friction] = [of("F1-01", "rate_n_per_mm"), of("F4-10", "friction_ratio")];
        let out = verdicts.values().filter(|v| *v == "out of tolerance").count();
        let expected = [rate, friction]
            .iter()
            .filter(|v| **v == "out of tolerance")
            .count();
        assert_eq!(out, expected, "{verdicts:?}");
        match nothing {
            true => assert_eq!(out, 0, "{verdicts:?}"),
            false => assert!(
                rate == "out of tolerance" && friction != "within tolerance",
                "{verdicts:?}"
            ),
        }
    }
}

#[test]
fn a_held_out_run_keeps_its_predicted_band() {
    let request = LabRequest {
        seed: 71,
        specimens: 20,
        runs: 120,
        nothing: true,
    };
    let held = HeldOut::new(&request, &[0]);
    assert_eq!(held.last.len(), 5);
    // Each run has a chance of 5 % to fail: two or more of five with 2.3 %, three or more with 0.1 %.
    for way in [&[][..], &["--from-model"]] {
        let [sound, imperfect] = held.passed(way);
        assert!(
            sound.0 + 2 >= sound.1 && sound.1 + imperfect.1 == 5,
            "{way:?}: {sound:?}"
        );
        let json = std::fs::read_to_string(held.path("predicted/prediction.json")).expect("written");
        let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
        // 30 runs of the family less the five that are held out.
        let runs = match way.is_empty() {
            true => json["basis"]["measured"]["runs"].as_u64(),
            false => json["basis"]["model"]["misfit"]["runs"].as_u64(),
        };
        assert!(
            runs.is_some_and(|runs| (3..=25).contains(&runs) && (runs == 25 || !way.is_empty())),
            "{json}"
        );
    }
    let archive = held.path("archive").display().to_string();
    let out = held.path("coverage").display().to_string();
    let words = [archive.as_str(), "--out", &out];
    assert_eq!(
        typed::<FleetCoverageArgs>(&words).run(&QUIET).expect("counted"),
        Done::Success
    );
    let table = std::fs::read_to_string(held.path("coverage/coverage.csv")).expect("written");
    assert!(table.lines().count() > 100, "{table}");
}

/// Some five minutes. `cargo test --release --lib held_out_runs_of_whole -- --ignored --nocapture` prints the figures of docs/fleet.md.
#[test]
#[ignore = "takes about five minutes"]
fn held_out_runs_of_whole_laboratories_keep_their_band() {
    let ways: [&[&str]; 2] = [&[], &["--from-model"]];
    let mut sums = [PassedRuns::default(); 2];
    for (seed, nothing) in [(3101, true), (3102, false), (3103, false)] {
        let request = LabRequest {
            seed,
            specimens: 40,
            runs: 400,
            nothing,
        };
        let held = HeldOut::new(&request, &[0, 1, 2, 3]);
        for (way, sum) in ways.iter().zip(&mut sums) {
            let passed = held.passed(way);
            println!("seed {seed} {way:?}: sound and imperfect instruments {passed:?}");
            let both = sum.iter_mut().zip(passed);
            both.for_each(|(sum, of)| *sum = (sum.0 + of.0, sum.1 + of.1));
        }
    }
    for ([(passed, all), imperfect], way) in sums.into_iter().zip(ways) {
        let ci95 = wilson_interval(passed, all);
        println!("{way:?}: sound instruments {passed} of {all} {ci95:?}, imperfect ones {imperfect:?}");
        // 95 % are wanted.
        assert!(
            ci95.is_some_and(|[low, high]| low <= 0.95 && high >= 0.95),
            "{way:?}"
        );
    }
}
