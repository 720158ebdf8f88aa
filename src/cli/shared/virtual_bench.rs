//! A whole bench in virtual time: control and the mock rig over a link in memory, the recorder called inline. One step is
//! a millisecond; the same config and seed give the same bits. [`record_run`] plays a profile on it into a run file.

use std::path::Path;

use super::error::CliError;
use super::local;
use super::progress::Progress;
use crate::cancel::CancelFlag;
use crate::config::Bench;
use crate::control::run::RunOrder;
use crate::control::{Phase, Rig};
use crate::daemon::header;
use crate::link::{Link, loopback};
use crate::mockrig::MockRig;
use crate::profile::{Player, Profile};
use crate::protocol::tick::{SAMPLE_RATE_HZ, TICK_NS};
use crate::recording::memory::Memory;
use crate::recording::run_file::{self, EXTENSION, RunFile, RunFileWriter};
use crate::recording::{Ending, Event, Header, Outcome, Recorder, Sample};
use crate::twin::Twin;

/// Longest wait for a ready rig, in ms of bench time; the hello takes about 100 ms.
const READY_WITHIN_MS: u64 = 10_000;
/// Time for arming and unloading, in addition to the profile itself.
const BESIDE_THE_RUN_MS: u64 = 60_000;
/// Rest before the run, in which control measures the start level.
const REST_MS: u64 = 500;
/// Session number of the host in virtual time.
const SESSION: u8 = 1;
/// The progress bar moves this often, in ms of bench time.
const PROGRESS_MS: u64 = 500;

/// Control on one end of the link, the mock rig on the other.
pub(crate) struct VirtualBench {
    /// Control, which is the host's side.
    pub rig: Rig,
    /// The mock rig.
    pub mock: MockRig,
    host_end: Link,
    rig_end: Link,
    now_ns: u64,
}

impl VirtualBench {
    /// The bench's mock rig with the bench's specimen, and control as the daemon configures it. `seed` is of the sensor noise.
    pub(crate) fn new(bench: &Bench, seed: Option<u64>) -> Result<VirtualBench, CliError> {
        let (host_end, rig_end) = loopback::pair();
        Ok(VirtualBench {
            rig: Rig::new(bench.rig_config(SESSION)),
            mock: local::mock_rig(bench, seed)?,
            host_end,
            rig_end,
            now_ns: 0,
        })
    }

    /// One millisecond: the rig ticks, then control polls the link.
    pub(crate) fn step(&mut self, recorder: &mut dyn Recorder) {
        self.now_ns += TICK_NS;
        self.mock.tick(&mut self.rig_end);
        self.rig.poll(self.now_ns, &mut self.host_end, recorder);
    }

    /// Virtual time since the start, in ns.
    pub(crate) fn now_ns(&self) -> u64 {
        self.now_ns
    }

    /// Steps until the bench is in `phase`; false if that takes longer than `limit_ms`.
    pub(crate) fn run_until(&mut self, phase: Phase, limit_ms: u64, recorder: &mut dyn Recorder) -> bool {
        for _ in 0..limit_ms {
            if self.rig.phase() == phase {
                return true;
            }
            self.step(recorder);
        }
        self.rig.phase() == phase
    }

    /// Connects if necessary, plays one run to its end and unloads. `each_ms` is called after every step.
    pub(crate) fn play(
        &mut self,
        order: RunOrder,
        recorder: &mut dyn Recorder,
        mut each_ms: impl FnMut(&VirtualBench),
    ) -> Result<Outcome, CliError> {
        let limit_ms = (order.header.duration_planned_s * 1e3) as u64 + BESIDE_THE_RUN_MS;
        let mut watched = Watched {
            next: recorder,
            outcome: None,
        };
        if !self.run_until(Phase::Ready, READY_WITHIN_MS, &mut watched) {
            return Err(self.failed("did not get ready"));
        }
        (0..REST_MS).for_each(|_| self.step(&mut watched));
        self.rig.start(order)?;
        for _ in 0..limit_ms {
            self.step(&mut watched);
            each_ms(self);
            if self.rig.phase() == Phase::Ready || self.rig.phase() == Phase::Interlocked {
                break;
            }
        }
        let outcome = watched.outcome.take();
        outcome.ok_or_else(|| self.failed("did not end the run in time"))
    }

    fn failed(&self, what: &str) -> CliError {
        let notice = self.rig.status().notice;
        CliError::Input(format!(
            "the bench in virtual time {what}: {notice}: check the bench file"
        ))
    }
}

/// A run that was played in virtual time.
pub(crate) struct RecordedRun {
    /// The closed run file, open for reading.
    pub file: RunFile,
    /// Bench time from the hello to the unloaded rig.
    pub virtual_s: f64,
}

/// Plays one profile on the bench's mock rig, from the hello to the unloaded rig, into `PROFILE.leafrun` in `folder`; an earlier
/// file there is replaced. The bench's model runs beside it as the twin.
pub(crate) fn record_run(
    bench: &Bench,
    profile: &Profile,
    profile_toml: String,
    folder: &Path,
    silent: bool,
) -> Result<RecordedRun, CliError> {
    let path = folder.join(format!("{}.{EXTENSION}", profile.name));
    run_file::remove(&path);
    let header = header_of(bench, profile, profile_toml)?;
    let writer = RunFileWriter::create(&path, &header)?;
    let disk = writer.status();
    let mut chain = Twin::new(
        bench.model.plant()?,
        bench.displacement_channel.noise_mm,
        Box::new(writer),
        || false,
    )
    .watching(bench.noise());
    let order = RunOrder {
        header,
        profile: profile.clone(),
        first_cycle: 1,
    };
    let mut progress = Progress::new(&profile.name, silent);
    let mut steps = 0;
    let mut virtual_bench = VirtualBench::new(bench, None)?;
    virtual_bench.play(order, &mut chain, |bench| {
        steps += 1;
        if steps % PROGRESS_MS == 0 {
            progress.show_played(&bench.rig.status());
        }
    })?;
    progress.finish();
    // The run file is closed before it is opened for reading.
    drop(chain);
    if let Some(problem) = disk.problem() {
        return Err(CliError::Input(problem));
    }
    Ok(RecordedRun {
        file: RunFile::open(&path)?,
        virtual_s: virtual_bench.now_ns() as f64 * 1e-9,
    })
}

/// Plays one profile on the bench's mock rig and keeps the run in memory, without a twin. `flag` ends it by unwinding.
pub(crate) fn record_in_memory(
    bench: &Bench,
    profile: &Profile,
    flag: &CancelFlag,
) -> Result<Memory, CliError> {
    let mut memory = Memory::default();
    let order = RunOrder {
        header: header_of(bench, profile, String::new())?,
        profile: profile.clone(),
        first_cycle: 1,
    };
    let outcome = VirtualBench::new(bench, None)?.play(order, &mut memory, |_| flag.unwind_if_cancelled())?;
    match outcome.ending {
        Ending::Completed => Ok(memory),
        _ => Err(CliError::Input(format!(
            "profile {} did not run to its end on the mock rig: {}",
            profile.name, outcome.cause
        ))),
    }
}

fn header_of(bench: &Bench, profile: &Profile, profile_toml: String) -> Result<Header, CliError> {
    let player = Player::new(profile, 0.0, f64::from(SAMPLE_RATE_HZ))?;
    let planned = header::Planned {
        cycles: player.total_cycles(),
        duration_s: player.duration_s(),
    };
    let now = jiff::Timestamp::now();
    Ok(header::new(
        profile.name.clone(),
        now,
        bench,
        profile,
        profile_toml,
        planned,
    ))
}

/// Passes everything on to the recorder and keeps the outcome.
struct Watched<'a> {
    next: &'a mut dyn Recorder,
    outcome: Option<Outcome>,
}

impl Recorder for Watched<'_> {
    fn begin(&mut self, header: &Header) {
        self.next.begin(header);
    }

    fn sample(&mut self, sample: &Sample) {
        self.next.sample(sample);
    }

    fn event(&mut self, event: &Event) {
        self.next.event(event);
    }

    fn end(&mut self, outcome: &Outcome) {
        self.outcome = Some(outcome.clone());
        self.next.end(outcome);
    }

    fn flush(&mut self) {
        self.next.flush();
    }
}
