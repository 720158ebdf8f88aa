//! `leafbench lab`: the runs of a laboratory that is known, to prove the pooling of runs.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use clap::Args;
use jiff::{SignedDuration, Timestamp};
use rayon::prelude::*;

use super::shared::local::require_new;
use super::shared::progress::Progress;
use super::{CliCommand, CliError, Done, Output};
use crate::config::Bench;
use crate::daemon::header::{self, Planned};
use crate::profile::{Player, Profile};
use crate::recording::export::sha256_of;
use crate::recording::run_file::{EXTENSION, RunFileWriter};
use crate::recording::{Ending, Flags, Header, Outcome, Recorder, Recording, Sample};
use crate::truth::lab_test::{self, COMMANDS_HZ};
use crate::truth::{Lab, LabCommand, LabFamily, LabRequest, LabTest};
use crate::units::Command;

/// Start of the campaign: midnight, UTC, of the first day.
const FIRST_DAY: &str = "2026-01-05T00:00:00Z";
/// Fewest specimens: one for each batch of the four families.
const FEWEST_SPECIMENS: u64 = 8;

/// Write the runs of a synthetic laboratory, whose truth is known, to test the pooling of many runs
#[derive(Debug, Args)]
#[command(
    hide = true,
    after_help = "DIR gets runs/ with the run files, specimens.csv with family and batch of each specimen, drawings.toml with the tolerances of the\n\
                  families, and lab-truth.json with everything that is true of the laboratory: three benches, of which one reads 1 % high and\n\
                  one has a late force channel; four families, of which one batch has a loose clamp; two specimens that are no good; friction\n\
                  that grows with age. The SHA-256 of lab-truth.json is printed: with it one can show later that the truth was not changed."
)]
pub(super) struct LabArgs {
    /// Folder to make
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The same seed gives the same laboratory
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Number of specimens
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(FEWEST_SPECIMENS..=999), default_value_t = 40)]
    specimens: u64,
    /// Number of runs
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=99_999), default_value_t = 400)]
    runs: u64,
    /// A laboratory with nothing to find: right benches, sound specimens, no age
    #[arg(long)]
    nothing: bool,
}

/// Where a lab was written.
#[derive(serde::Serialize)]
pub(super) struct WrittenLab {
    runs: usize,
    folder: PathBuf,
    specimens: PathBuf,
    drawings: PathBuf,
    truth: PathBuf,
    truth_sha256: String,
}

impl CliCommand for LabArgs {
    const NAME: &'static str = "lab";
    const EXAMPLES: &'static [&'static str] = &["leafbench lab --out lab --seed 7"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let lab = Lab::draw(&LabRequest {
            seed: self.seed,
            specimens: self.specimens as usize,
            runs: self.runs as usize,
            nothing: self.nothing,
        });
        let written = write(&lab, &self.out, output)?;
        output.result(&written, || text_of(&written))?;
        Ok(Done::Success)
    }
}

/// Writes truth, table of specimens, drawings and run files.
pub(super) fn write(lab: &Lab, out: &Path, output: &Output) -> Result<WrittenLab, CliError> {
    let folder = out.join("runs");
    let [specimens, drawings, truth] =
        ["specimens.csv", "drawings.toml", "lab-truth.json"].map(|name| out.join(name));
    require_new(&[&folder, &specimens, &drawings, &truth], false)?;
    std::fs::create_dir_all(&folder).map_err(CliError::file(&folder, "creating the folder"))?;
    let text = serde_json::to_string_pretty(lab).map_err(|e| CliError::Internal(e.to_string()))?;
    std::fs::write(&truth, text).map_err(CliError::file(&truth, "writing"))?;
    std::fs::write(&specimens, specimen_table(lab)).map_err(CliError::file(&specimens, "writing"))?;
    std::fs::write(&drawings, drawings_toml(lab)).map_err(CliError::file(&drawings, "writing"))?;
    write_runs(lab, &folder, output)?;
    Ok(WrittenLab {
        runs: lab.runs.len(),
        truth_sha256: sha256_of(&truth).map_err(CliError::file(&truth, "reading"))?,
        folder,
        specimens,
        drawings,
        truth,
    })
}

fn text_of(written: &WrittenLab) -> String {
    format!(
        "{} runs in {}; {}; {}; {} (SHA-256 {})",
        written.runs,
        written.folder.display(),
        written.specimens.display(),
        written.drawings.display(),
        written.truth.display(),
        written.truth_sha256
    )
}

/// The test of a family, played from its profile as a bench does.
pub(crate) struct PlayedTest {
    profile: Profile,
    profile_toml: String,
    pub(crate) test: LabTest,
    /// Counted cycles of the whole test.
    cycles: u32,
}

impl PlayedTest {
    /// Plays the test of one family of a lab.
    pub(crate) fn new(family: &str, top_mm: f64) -> Result<PlayedTest, CliError> {
        let profile_toml = lab_test::profile_toml(family, top_mm);
        let profile = Profile::from_toml(&profile_toml, family)?;
        let mut player = Player::new(&profile, 0.0, COMMANDS_HZ)?;
        let mut test = LabTest { commands: Vec::new() };
        while let Some(slot) = player.next() {
            test.commands.push(LabCommand {
                displacement_mm: slot.command.value(),
                cycle: slot.cycle,
                segment: slot.segment,
            });
        }
        Ok(PlayedTest {
            cycles: player.total_cycles(),
            profile,
            profile_toml,
            test,
        })
    }
}

/// The table that a laboratory keeps of its specimens.
fn specimen_table(lab: &Lab) -> String {
    let rows = lab.specimens.iter();
    let rows = rows.map(|s| format!("{},{},{}\n", s.name, s.family, s.batch));
    std::iter::once("specimen,family,batch\n".to_owned())
        .chain(rows)
        .collect()
}

/// What the drawings of the families allow. The tolerances were fixed before any laboratory was judged by them: 5 to 10 % of the rate is
/// usual for leaf springs, and friction is several times as uncertain.
const RATE_TOLERANCE: &str = "7 %";
const FRICTION_TOLERANCE: &str = "25 %";

/// The drawings of the families. A drawing has the rate that its specimens scatter about. It has no friction: in the equations of another
/// world the friction of the model is another number than the family's own, so a specimen is compared with the others of its family.
fn drawings_toml(lab: &Lab) -> String {
    let of_family = |family: &LabFamily| {
        format!(
            "[family.{0}.rate_n_per_mm]\nnominal = \"{1} N/mm\"\ntolerance = \"{RATE_TOLERANCE}\"\n\n\
             [family.{0}.friction_ratio]\ntolerance = \"{FRICTION_TOLERANCE}\"\n",
            family.name, family.rate_n_per_mm
        )
    };
    let families: Vec<String> = lab.families.iter().map(of_family).collect();
    families.join("\n")
}

fn write_runs(lab: &Lab, folder: &Path, output: &Output) -> Result<(), CliError> {
    let families = lab.families.iter();
    let tests: Vec<PlayedTest> = families
        .map(|f| PlayedTest::new(&f.name, f.top_mm))
        .collect::<Result<_, _>>()?;
    let bench = Bench::shipped()?;
    let (progress, done) = (Mutex::new(Progress::new("lab", output.json)), AtomicUsize::new(0));
    let count = lab.runs.len();
    (0..count).into_par_iter().try_for_each(|number| {
        let test = &tests[lab.specimens[lab.runs[number].specimen].family_index];
        let header = header_of(lab, number, test, bench.clone())?;
        write_run(&header, test, &lab.record(number, &test.test), folder)?;
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        if let Ok(mut bar) = progress.lock() {
            bar.show_share(done as f64 / count as f64, &format!("run {done} of {count}"));
        }
        Ok::<(), CliError>(())
    })?;
    if let Ok(bar) = progress.into_inner() {
        bar.finish();
    }
    Ok(())
}

/// The header that a bench of the laboratory writes: the shipped bench under another name, with its own sample rate.
fn header_of(lab: &Lab, number: usize, test: &PlayedTest, mut bench: Bench) -> Result<Header, CliError> {
    let run = &lab.runs[number];
    let of_lab = &lab.benches[run.bench];
    bench.name.clone_from(&of_lab.name);
    bench.specimen.name.clone_from(&lab.specimens[run.specimen].name);
    let first_day: Timestamp = FIRST_DAY
        .parse()
        .map_err(|e: jiff::Error| CliError::Internal(e.to_string()))?;
    let started = first_day + SignedDuration::from_secs_f64(run.start_s);
    let run_id = format!("{}-{:05}", started.strftime("%Y%m%d-%H%M%S"), number + 1);
    let planned = Planned {
        cycles: test.cycles,
        duration_s: test.test.duration_s(),
    };
    let toml = test.profile_toml.clone();
    Ok(Header {
        operator: run.operator.to_owned(),
        sample_rate_hz: of_lab.sample_rate_hz,
        twin: String::new(),
        ..header::new(run_id, started, &bench, &test.profile, toml, planned)
    })
}

fn write_run(
    header: &Header,
    test: &PlayedTest,
    recording: &Recording,
    folder: &Path,
) -> Result<(), CliError> {
    let path = folder.join(format!("{}.{EXTENSION}", header.run_id));
    let mut writer = RunFileWriter::create(&path, header)?;
    let disk = writer.status();
    for tick in 0..recording.len() {
        writer.sample(&sample(header, test, recording, tick));
    }
    writer.end(&Outcome {
        ending: Ending::Completed,
        cause: String::new(),
        samples: recording.len() as u64,
        lost: 0,
        late: 0,
        cycles_completed: test.cycles,
        unsaved: None,
        punctuality: None,
    });
    match disk.problem() {
        Some(problem) => Err(CliError::Input(problem)),
        None => Ok(()),
    }
}

/// A sample as the rig sends it: values are whole counts.
fn sample(header: &Header, test: &PlayedTest, recording: &Recording, tick: usize) -> Sample {
    let force_counts = header.force_channel.counts(recording.force_n[tick]);
    let displacement_counts = header
        .displacement_channel
        .counts(recording.displacement_mm[tick]);
    let time_s = recording.time_s[tick];
    let due = test.test.at(time_s);
    Sample {
        tick: tick as u64,
        time_s,
        force_n: header.force_channel.value(force_counts),
        displacement_mm: header.displacement_channel.value(displacement_counts),
        force_counts,
        displacement_counts,
        command: due.map(|c| Command::Displacement(c.displacement_mm)),
        cycle: due.map_or(0, |c| c.cycle),
        segment: due.map_or(0, |c| c.segment),
        twin_force_n: None,
        flags: Flags::default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::drawing::Drawings;
    use crate::recording::run_file::{RunFile, listing};

    #[test]
    fn a_test_has_its_cycles_and_reaches_the_travel_that_it_was_scaled_to() {
        let played = PlayedTest::new("F1", 20.0).expect("played");
        assert_eq!(played.cycles, lab_test::CYCLES);
        // Ramps of 1 s; sines of 4, 7 and 7 cycles with their tapers at 0.5, 2 and 1.5 Hz.
        assert!((played.test.duration_s() - (2.0 + 8.0 + 3.5 + 14.0 / 3.0)).abs() < 2e-3);
        let commands = played.test.commands.iter();
        let top_mm = commands.map(|c| c.displacement_mm).fold(0.0, f64::max);
        assert!((top_mm - 0.92 * 20.0).abs() < 1e-6);
    }

    #[test]
    fn run_files_are_whole_and_say_who_was_tested_where() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path().join("lab");
        let args = LabArgs {
            out: out.clone(),
            seed: 3,
            specimens: 8,
            runs: 9,
            nothing: false,
        };
        args.run(&Output { json: true }).expect("written");
        let truth: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(out.join("lab-truth.json")).expect("read"))
                .expect("JSON");
        let table = std::fs::read_to_string(out.join("specimens.csv")).expect("read");
        let drawings = std::fs::read_to_string(out.join("drawings.toml")).expect("read");
        Drawings::read("drawings.toml", &drawings).expect("a file that `fleet report --drawings` takes");
        for family in truth["families"].as_array().expect("families") {
            let rate = format!("nominal = \"{} N/mm\"", family["rate_n_per_mm"]);
            assert!(drawings.contains(&rate.replace(".0 N", " N")), "{drawings}");
        }
        let files = std::fs::read_dir(out.join("runs")).expect("listed");
        let files: Vec<PathBuf> = files.map(|e| e.expect("an entry").path()).collect();
        assert_eq!(files.len(), 9);
        for path in files {
            let run = RunFile::open(&path).expect("opens");
            assert_eq!(run.survey().incomplete(), "");
            let listed = listing(path);
            assert_eq!(listed.cycles_completed, 12);
            assert!(table.contains(&format!("\n{},", listed.specimen)), "{table}");
            let bench: toml::Table = run.header().bench_toml.parse().expect("TOML");
            let benches = truth["benches"].as_array().expect("benches");
            assert!(
                benches
                    .iter()
                    .any(|b| b["name"].as_str() == bench["name"].as_str())
            );
        }
    }
}
