//! `leafbench diagnose`: of recordings, of tables (`targets`), or of recordings and the tests that follow (`run_next`).

mod files;
pub(crate) mod inputs;
mod job;
mod leave_out;
mod proof;
mod run_next;
pub(crate) mod steps;
mod targets;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, ValueEnum};

use super::shared::client::DataArg;
use super::shared::local::{self, BenchArg, model_names};
use super::shared::progress::Progress;
use super::{CliCommand, CliError, Done, Output};
use crate::config::{Bench, EffectConfig, ModelConfig};
use crate::diagnose::diagnosis::{Diagnosis, ImprovedModel, Note};
use crate::diagnose::{Baseline, DiagnoseOptions, Verdict};
use crate::effect;
use crate::recording::Recording;
use crate::report::diagnosis::{Context, InputFile};
use run_next::VirtualRig;
use steps::{baseline_for, diagnosed, in_mm_and_n};

pub(super) use files::{IMPROVED, REPORT};
pub(super) use run_next::Ended;

/// Largest number of tests of `--run-next`, unless `--rounds` says otherwise.
const MOST_TESTS: u32 = 4;

/// Name the physics that recordings show and the baseline model lacks, and write the model with it added
#[derive(Debug, Args)]
#[command(after_help = codes_of_physics())]
pub(super) struct DiagnoseArgs {
    #[arg(
        value_name = "RECORDING",
        required_unless_present = "targets",
        num_args = 1..,
        help = "Recordings of one specimen on one rig: CSV with time_s, displacement_mm, force_n; run files (.leafrun); run ids,\n\
                whole or short; latest for the newest finished run"
    )]
    recordings: Vec<PathBuf>,
    #[arg(
        long,
        value_name = "CSV",
        num_args = 1..,
        conflicts_with = "recordings",
        help = "Tables instead of recordings: tests by peak_force_n (or fmax_kn) and loop_energy_j, with mount,\n\
                amplitude_mm, frequency_hz, source; or one loop by branch, displacement_mm, force_n"
    )]
    targets: Vec<PathBuf>,
    #[command(flatten)]
    bench: BenchArg,
    #[arg(
        long,
        value_name = "MODEL",
        help = format!("Model to start from: {} [default: from the bench file]", model_names())
    )]
    baseline: Option<String>,
    #[arg(
        long,
        value_name = "CODE,CODE",
        num_args = 1,
        value_delimiter = ',',
        help = "Physics that the baseline has already, by the codes below; \"\" for none\n\
                [default: the bench's list and the model's own]"
    )]
    known: Option<Vec<String>>,
    #[arg(
        long,
        value_name = "WHERE",
        value_enum,
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "live",
        conflicts_with = "targets",
        help = "Run the test that the diagnosis proposes, add its recording and diagnose again, until it is settled;\n\
                --run-next alone is --run-next=live"
    )]
    run_next: Option<NextTestRig>,
    /// Largest number of tests that --run-next runs
    #[arg(
        long,
        value_name = "N",
        requires = "run_next",
        value_parser = clap::value_parser!(u32).range(1..=20),
        default_value_t = MOST_TESTS
    )]
    rounds: u32,
    #[arg(
        long,
        value_name = "NAME,NAME",
        value_delimiter = ',',
        conflicts_with_all = ["targets", "run_next"],
        help = "Recordings that are only predicted, by file name: nothing is fitted to them and nothing chosen by them"
    )]
    leave_out: Vec<String>,
    /// Turns the sign of these channels of all recordings before the diagnosis
    #[arg(
        long,
        value_name = "CHANNEL,CHANNEL",
        value_enum,
        num_args = 1,
        value_delimiter = ',',
        conflicts_with = "targets"
    )]
    flip: Vec<FlippedChannel>,
    /// Take recordings of different specimens together: they are the same spring under several names
    #[arg(long, conflicts_with = "targets")]
    mixed_specimens: bool,
    /// Run as a job of the daemon: at a low priority, with progress as lines of JSON, until stdin is closed
    #[arg(long, hide = true, conflicts_with_all = ["targets", "run_next"])]
    job: bool,
    #[command(flatten)]
    data: DataArg,
    /// Folder for diagnosis.json, report.html with figures/, improved.toml and, if there is a next test, next-test.toml
    #[arg(long, value_name = "DIR", default_value = "diagnosis")]
    out: PathBuf,
}

/// The rig that runs the next test.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum NextTestRig {
    /// On the daemon's rig
    Live,
    /// On the bench's mock rig in virtual time
    Virtual,
}

/// A channel whose sign is turned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum FlippedChannel {
    /// The column force_n
    Force,
    /// The column displacement_mm
    Displacement,
}

fn codes_of_physics() -> String {
    let codes: Vec<&str> = effect::EFFECTS.iter().map(|e| e.code).collect();
    let list = local::wrapped(&codes).replace('\n', "\n  ");
    format!("Codes of physics for --known:\n  {list}")
}

impl CliCommand for DiagnoseArgs {
    const NAME: &'static str = "diagnose";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench diagnose latest",
        "leafbench diagnose loops/RUN.csv loops/OTHER.csv",
        "leafbench diagnose --run-next=virtual --bench bench-configs/benches/mock.toml loops/RUN.csv",
        "leafbench diagnose --baseline leaf-pack --known coulomb_friction --out diagnosis loops/RUN.csv",
        "leafbench diagnose --leave-out OTHER.csv loops/RUN.csv loops/OTHER.csv",
        "leafbench diagnose --flip force loops/RUN.csv",
        "leafbench diagnose --targets table.csv",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        if self.job {
            job::begin();
        }
        let bench = self.bench.load()?;
        let baseline = self.baseline(&bench.model)?;
        let given = self.recordings.iter().chain(&self.targets);
        let read: Vec<&Path> = given.map(PathBuf::as_path).chain(self.bench.path()).collect();
        files::check_folder(&self.out, &read)?;
        let job = DiagnoseJob {
            bench: &bench,
            baseline: &baseline,
            folder: &self.out,
            output,
            date: now_utc(),
            of_daemon: self.job,
        };
        if !self.targets.is_empty() {
            return targets::run(&self.targets, &job);
        }
        let (mut recordings, read) =
            inputs::read(&self.recordings, &self.data.folder, self.mixed_specimens, output)?;
        recordings.iter().try_for_each(in_mm_and_n)?;
        let [force, displacement] =
            [FlippedChannel::Force, FlippedChannel::Displacement].map(|channel| self.flip.contains(&channel));
        recordings
            .iter_mut()
            .for_each(|recording| recording.turn_signs(force, displacement));
        if let Some(rig) = self.run_next {
            let tester = run_next::tester(rig, &self.data, &job)?;
            return run_next::run(tester, self.rounds, &job, recordings, read);
        }
        let left_out = leave_out::take(&mut recordings, &self.leave_out)?;
        let diagnosis = job.diagnose(&recordings, &read, &left_out, None)?;
        output.result(&diagnosis, || text(&diagnosis, job.folder))?;
        Ok(Done::Success)
    }
}

impl DiagnoseArgs {
    /// What the diagnosis starts from: the bench's model or that of `--baseline`; its known physics or that of `--known`.
    fn baseline(&self, config: &ModelConfig) -> Result<Baseline, CliError> {
        baseline_for(config, self.baseline.as_deref(), self.known.as_deref())
    }
}

/// Diagnoses recordings and runs the next tests on the bench's mock rig until it is settled, as `diagnose --run-next=virtual`
/// does. The files go to `folder`.
pub(super) fn until_settled(
    bench: &Bench,
    recordings: Vec<Recording>,
    folder: &Path,
    output: &Output,
) -> Result<Ended, CliError> {
    let baseline = baseline_for(&bench.model, None, None)?;
    let job = DiagnoseJob {
        bench,
        baseline: &baseline,
        folder,
        output,
        date: now_utc(),
        of_daemon: false,
    };
    let read = recordings
        .iter()
        .map(|recording| inputs::input_csv(Path::new(&recording.name)))
        .collect::<Result<_, _>>()?;
    // Ctrl-C ends the process as usual: the caller has nothing to bring to an end.
    let mut tester = VirtualRig::new(&job, Arc::default());
    run_next::until_settled(&mut tester, MOST_TESTS, &job, recordings, read)
}

/// Day and time of now, UTC: the report itself reads no clock.
fn now_utc() -> String {
    jiff::Timestamp::now().strftime("%Y-%m-%d %H:%M").to_string()
}

/// What stays the same when recordings are added.
struct DiagnoseJob<'a> {
    /// The rig and its specimen.
    bench: &'a Bench,
    /// What the diagnosis starts from.
    baseline: &'a Baseline,
    /// Folder of `--out`.
    folder: &'a Path,
    /// Where results are printed.
    output: &'a Output,
    /// Day and time of the diagnosis, UTC.
    date: String,
    /// It is a job of the daemon, which reads its progress.
    of_daemon: bool,
}

impl DiagnoseJob<'_> {
    /// Diagnoses and writes the files to the folder of `--out`, and also to that of a round of `--run-next`. The recordings in
    /// `left_out` are only predicted.
    fn diagnose(
        &self,
        recordings: &[Recording],
        read: &[InputFile],
        left_out: &[Recording],
        round_folder: Option<&Path>,
    ) -> Result<Diagnosis, CliError> {
        let (diagnosis, improved) = self.diagnose_with_progress(recordings, left_out)?;
        let context = Context {
            bench_specimen: &self.bench.specimen.name,
            baseline: self.baseline.model.name,
            recordings: recordings.len(),
            inputs: read,
            version: env!("CARGO_PKG_VERSION"),
            date: &self.date,
        };
        let files = files::of_diagnosis(&diagnosis, improved, &context)?;
        for folder in [Some(self.folder), round_folder].into_iter().flatten() {
            files::write(folder, &files)?;
        }
        Ok(diagnosis)
    }

    fn diagnose_with_progress(
        &self,
        recordings: &[Recording],
        left_out: &[Recording],
    ) -> Result<(Diagnosis, Option<String>), CliError> {
        let mut bar = Progress::new("diagnose", self.output.json);
        let mut lines = self.of_daemon.then(job::ProgressLines::default);
        let options = DiagnoseOptions::default().within(self.bench.profile_limits());
        let given = (recordings, left_out);
        let found = diagnosed(self.bench, self.baseline, &options, given, &mut |share, step| {
            bar.show_share(share, step);
            if let Some(lines) = &mut lines {
                lines.show(share, step);
            }
        });
        bar.finish();
        found
    }
}

/// The bench with the improved model in its specimen and its twin, so that twin, simulator and mock rig run it.
pub(crate) fn improved_bench(bench: &Bench, improved: &ImprovedModel) -> Bench {
    let model = ModelConfig {
        name: improved.model.clone(),
        known: Vec::new(),
        force_zero_n: improved.force_zero_n,
        parameters: improved.parameters.iter().cloned().collect(),
        structure: improved.structure.clone(),
        effects: improved
            .effects
            .iter()
            .map(|e| EffectConfig {
                code: e.code.clone(),
                parameters: e.parameters.iter().cloned().collect(),
            })
            .collect(),
        law: improved.law.clone(),
    };
    let mut bench = bench.clone();
    bench.specimen.model = model.clone();
    bench.model = model;
    bench
}

/// The verdict as the terminal shows it.
fn verdict_text(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Adequate => "ADEQUATE",
        Verdict::MissingPhysics => "MISSING PHYSICS",
        Verdict::Unexplained => "UNEXPLAINED",
    }
}

/// The diagnosis as the terminal shows it.
fn text(d: &Diagnosis, folder: &Path) -> String {
    let note = |n: &Note| format!("  note on {}: {} ({})", n.recording, n.text, n.done.word());
    let mut lines: Vec<String> = d.notes.iter().map(note).collect();
    lines.push(format!("{}: {}", verdict_text(d.verdict), d.summary));
    for e in &d.effects {
        lines.push(format!(
            "  {} ({:.0} % sure): {}",
            e.code,
            100.0 * e.confidence,
            e.statement
        ));
    }
    if let Some(law) = &d.law {
        lines.push(format!("  modelled: {}", law.statement));
    }
    for a in &d.alternatives {
        lines.push(format!("  or {} instead of {}: {}", a.code, a.instead_of, a.why));
    }
    for l in &d.location {
        lines.push(format!("  where: {}", l.words));
    }
    let (before, after) = (d.fit.baseline.nrmse_heldout, d.fit.improved.nrmse_heldout);
    lines.push(format!(
        "  error on held-out cycles: {:.3} % before, {:.3} % after, noise floor {:.3} %",
        100.0 * before,
        100.0 * after,
        100.0 * d.fit.noise_floor_nrmse
    ));
    lines.extend(yardsticks(d));
    lines.extend(leave_out::table(&d.left_out));
    lines.extend(d.proof.iter().map(|proof| format!("  {}", proof.words)));
    if let Some(next) = &d.next_test {
        lines.push(format!("  next test: {}", next.why));
    }
    lines.extend(d.no_next_test.iter().map(|why| format!("  no next test: {why}")));
    let mut named = vec![files::REPORT, files::DIAGNOSIS];
    named.extend(d.proof.as_ref().filter(|p| p.written).map(|_| files::IMPROVED));
    named.extend(d.next_test.as_ref().map(|_| files::NEXT_TEST));
    lines.push(format!("  {}: {}", folder.display(), named.join(", ")));
    lines.join("\n")
}

/// The errors of the yardsticks, and what it means if one of them is better.
fn yardsticks(d: &Diagnosis) -> Vec<String> {
    let errors = d.yardsticks.iter();
    let errors: Vec<String> = errors
        .map(|y| format!("{:.3} % {}", 100.0 * y.nrmse_leftout, y.name))
        .collect();
    let mut lines = Vec::new();
    if !errors.is_empty() {
        lines.push(format!("  yardsticks on the same cycles: {}", errors.join("; ")));
    }
    lines.extend(d.yardstick_warning().map(|text| format!("  {text}")));
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth::{Case, World};

    #[test]
    fn a_round_gets_every_file_of_its_diagnosis() {
        let folder = tempfile::tempdir().expect("a folder");
        let bench = Bench::shipped().expect("built in");
        let baseline = Baseline::of(crate::model::find("equivalent").expect("listed"));
        let job = DiagnoseJob {
            bench: &bench,
            baseline: &baseline,
            folder: folder.path(),
            output: &Output { json: true },
            date: "2026-11-24 10:00".to_owned(),
            of_daemon: false,
        };
        let round = folder.path().join("round-0");
        // A ramp and one sine leave look-alikes in some of these cases (`Family::Confounded`), which a next test can settle.
        let found = (0..8).find_map(|round_of_cases| {
            let case = Case::draw(World::Own, 1, 11 + 20 * round_of_cases, Some(2.0));
            let diagnosis = job
                .diagnose(&case.recordings, &[], &[], Some(&round))
                .expect("diagnosed");
            diagnosis.next_test
        });
        assert!(found.is_some(), "no case has a next test");
        for name in [files::DIAGNOSIS, files::REPORT, files::IMPROVED, files::NEXT_TEST] {
            let read = |folder: &Path| std::fs::read_to_string(folder.join(name)).expect(name);
            assert_eq!(read(&round), read(folder.path()));
        }
    }
}
