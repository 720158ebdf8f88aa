//! A whole bench in virtual time: control and the mock rig over a link in memory, the recorder called inline. One step is
//! a millisecond; the same config and seed give the same bits.

use super::{CliError, local};
use crate::config::Bench;
use crate::control::run::RunOrder;
use crate::control::{Phase, Rig};
use crate::link::{Link, loopback};
use crate::mockrig::MockRig;
use crate::recording::{Event, Header, Outcome, Recorder, Sample};

/// Period of both loops.
const STEP_NS: u64 = 1_000_000;
/// The hello takes about 100 ms of bench time; a rig that is not ready by then will not be.
const READY_WITHIN_MS: u64 = 10_000;
/// Arming and unloading beside the profile itself.
const BESIDE_THE_RUN_MS: u64 = 60_000;
/// Session of the host in virtual time.
const SESSION: u8 = 1;

/// Control on one end, the mock rig on the other.
pub(crate) struct VirtualBench {
    /// The host's side.
    pub rig: Rig,
    /// The far end.
    pub mock: MockRig,
    host_end: Link,
    rig_end: Link,
    now_ns: u64,
}

impl VirtualBench {
    /// The bench's mock rig with the bench's specimen, and control as the daemon configures it.
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

    /// One millisecond: the rig ticks, then control looks.
    pub(crate) fn step(&mut self, recorder: &mut dyn Recorder) {
        self.now_ns += STEP_NS;
        self.mock.tick(&mut self.rig_end);
        self.rig.poll(self.now_ns, &mut self.host_end, recorder);
    }

    /// Virtual time since the start.
    pub(crate) fn now_ns(&self) -> u64 {
        self.now_ns
    }

    /// Steps until the bench is in `phase`; false where it was not within `limit_ms`.
    pub(crate) fn run_until(&mut self, phase: Phase, limit_ms: u64, recorder: &mut dyn Recorder) -> bool {
        for _ in 0..limit_ms {
            if self.rig.phase() == phase {
                return true;
            }
            self.step(recorder);
        }
        self.rig.phase() == phase
    }

    /// Connects if need be, plays one run to its end and unloads. `each_ms` sees the bench after every step.
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
            return Err(self.not_as_planned("did not get ready"));
        }
        // Half a second of rest: what control takes the start level from.
        (0..500).for_each(|_| self.step(&mut watched));
        self.rig.start(order)?;
        for _ in 0..limit_ms {
            self.step(&mut watched);
            each_ms(self);
            if self.rig.phase() == Phase::Ready || self.rig.phase() == Phase::Interlocked {
                break;
            }
        }
        let outcome = watched.outcome.take();
        outcome.ok_or_else(|| self.not_as_planned("did not come to an end"))
    }

    fn not_as_planned(&self, what: &str) -> CliError {
        let notice = self.rig.status().notice;
        CliError::Input(format!(
            "the bench in virtual time {what}: {notice}: check the bench config"
        ))
    }
}

/// Keeps the outcome on its way to the recorder.
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
