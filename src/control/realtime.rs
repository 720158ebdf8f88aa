//! The control thread: an OS thread without async runtime that polls the [`Rig`] once per tick on absolute deadlines, at
//! real-time priority and with locked memory where the system allows it. Where not, it reports that.
//!
//! A rig in memory ticks only when the loop steps it, and the poll after the tick has the tick's time.
//!
//! In the steady loop it neither waits for other threads nor allocates: it reads requests from a bounded channel and writes
//! the status under a mutex without blocking on either, and gives samples to the recorder of the run.

use std::io;
use std::sync::mpsc::{self, Receiver, SyncSender, TryRecvError};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::thread::JoinHandle;

use nix::sys::mman::{MlockAllFlags, mlockall};
use nix::sys::resource::{RLIM_INFINITY, Resource, getrlimit, setrlimit};
use nix::time::{ClockId, ClockNanosleepFlags, clock_nanosleep};
use tokio::sync::oneshot;

use super::pace::Pace;
use super::run::RunOrder;
use super::{Phase, Refusal, Rig, RigStatus, TareReport};
use crate::link::priority::raise_this_thread;
use crate::link::{Link, now_ns as monotonic_ns};
use crate::protocol::tick::TICK_NS;
use crate::recording::punctuality::{LatenessClass, LatenessCounts};
use crate::recording::{Event, Header, Outcome, Recorder, RunPunctuality, Sample, StreamEvent};

/// Period of the loop.
const PERIOD_NS: u64 = TICK_NS;
/// The status is published every this many turns.
const STATUS_TURNS: u64 = 20;
/// A turn that begins later than this after its deadline is counted as late.
const LATE_NS: u64 = PERIOD_NS;
/// Most requests that wait.
const REQUESTS: usize = 8;

/// A request to the control thread.
pub(crate) enum Request {
    /// Arms the rig and starts a run into this recorder, which is dropped once the run is over or could not start.
    Start(Box<RunOrder>, Box<dyn Recorder + Send>),
    /// Ends the run with this cause; the rig unloads.
    Stop(String),
    /// Keeps the position.
    Hold,
    /// Goes on after a hold.
    Resume,
    /// Clears the latch.
    Reset,
    /// Takes the present readings as zero.
    Tare,
    /// Returns to the tared zero.
    Zero,
    /// Moves by this step in mm; 0 ends a jog.
    Jog(f64),
    /// The same, if a jog is under way.
    JogOn(f64),
    /// Writes an event of the operator into the run under way; without a run nothing happens.
    Note(String),
    /// The link was lost and is open again. The rig is only observed until the next start.
    Relink(Box<Link>),
    /// Ends the control thread. Commands stop and the lease lapses, so it must follow a stop.
    End,
}

/// Answer to an accepted request.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Reply {
    /// The request is under way.
    Accepted,
    /// The tare that was taken.
    Tared(TareReport),
}

/// Why a request got no answer from control.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum RequestError {
    /// The request is not possible now.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// Too many requests wait.
    #[error("too many requests wait for the control thread: ask again in a moment")]
    Overloaded,
    /// The thread has ended.
    #[error("the control thread has ended: restart the daemon")]
    Ended,
}

/// RunPunctuality of the control loop.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema,
)]
pub(crate) struct LoopHealth {
    /// Turns so far.
    pub turns: u64,
    /// Turns that began more than one tick after their deadline.
    pub late_turns: u64,
    /// Largest delay of a turn after its deadline in microseconds.
    pub worst_lateness_us: u64,
    /// Time in ms that a mock rig in memory stood still because this computer was too slow for it.
    #[serde(default)]
    pub skipped_ms: u64,
    /// Turns by their delay.
    #[serde(default)]
    #[schema(value_type = Vec<LatenessClass>)]
    pub lateness: LatenessCounts,
    /// Sum of all delays, us, for `/metrics` only.
    #[serde(skip)]
    #[schema(ignore)]
    pub sum_us: u64,
}

impl LoopHealth {
    /// Counts a turn that began this long after its deadline.
    pub(crate) fn note(&mut self, late_ns: u64) {
        let late_us = late_ns / 1000;
        self.turns += 1;
        self.late_turns += u64::from(late_ns > LATE_NS);
        self.worst_lateness_us = self.worst_lateness_us.max(late_us);
        self.sum_us += late_us;
        self.lateness.note(late_us);
    }

    /// The turns so far as the punctuality of one run.
    fn of_run(&self) -> RunPunctuality {
        RunPunctuality {
            turns: self.turns,
            late_turns: self.late_turns,
            worst_lateness_us: self.worst_lateness_us,
            lateness: self.lateness,
        }
    }
}

type Envelope = (Request, oneshot::Sender<Result<Reply, Refusal>>);

/// The other threads' handle of the control thread.
#[derive(Clone)]
pub(crate) struct ControlHandle {
    requests: SyncSender<Envelope>,
    published: Arc<Mutex<(RigStatus, LoopHealth)>>,
    degraded: Arc<[String]>,
}

impl ControlHandle {
    /// Starts the thread. `watcher` sees the samples that no run records. The thread ends after [`Request::End`], or when every
    /// `ControlHandle` is dropped.
    pub(crate) fn spawn(
        rig: Rig,
        link: Link,
        watcher: Box<dyn Recorder + Send>,
    ) -> io::Result<(ControlHandle, JoinHandle<()>)> {
        let (mut handle, mut control) = ControlLoop::new(rig, link, monotonic_ns());
        control.watcher = watcher;
        let (ready, degraded) = mpsc::sync_channel(1);
        let thread = std::thread::Builder::new()
            .name("control".to_owned())
            .spawn(move || {
                // The receiver waits below. Sending fails only if its thread has ended.
                let _ = ready.send(degradations());
                control.run();
            })?;
        handle.degraded = degraded
            .recv()
            .map_err(|_| io::Error::other("the control thread ended at its start"))?
            .into();
        Ok((handle, thread))
    }

    /// The newest status, at most about 20 ms old.
    pub(crate) fn status(&self) -> (RigStatus, LoopHealth) {
        self.published
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Why the loop is less punctual than it could be, one sentence each; empty if all is well.
    pub(crate) fn degraded(&self) -> &[String] {
        &self.degraded
    }

    /// Sends a request. The answer comes within two turns.
    pub(crate) async fn ask(&self, request: Request) -> Result<Reply, RequestError> {
        let (answer, wait) = oneshot::channel();
        self.requests
            .try_send((request, answer))
            .map_err(|error| match error {
                mpsc::TrySendError::Full(_) => RequestError::Overloaded,
                mpsc::TrySendError::Disconnected(_) => RequestError::Ended,
            })?;
        Ok(wait.await.map_err(|_| RequestError::Ended)??)
    }
}

/// The loop of the control thread. Tests call its turns with a clock of their own.
pub(crate) struct ControlLoop {
    rig: Rig,
    link: Link,
    /// Time of a rig that this loop steps; `None` where the rig has its own clock.
    pace: Option<Pace>,
    /// Recorder of the run under way.
    recorder: Option<Box<dyn Recorder + Send>>,
    /// In its place between two runs.
    watcher: Box<dyn Recorder + Send>,
    inbox: Receiver<Envelope>,
    published: Arc<Mutex<(RigStatus, LoopHealth)>>,
    health: LoopHealth,
    /// The same since the start of the run under way.
    run_health: LoopHealth,
}

impl ControlLoop {
    /// The loop and its handle, without a thread. `now_ns` is the time on the monotonic clock.
    pub(crate) fn new(rig: Rig, link: Link, now_ns: u64) -> (ControlHandle, ControlLoop) {
        let (requests, inbox) = mpsc::sync_channel(REQUESTS);
        let published = Arc::new(Mutex::new((rig.status(), LoopHealth::default())));
        let handle = ControlHandle {
            requests,
            published: Arc::clone(&published),
            degraded: Arc::default(),
        };
        let control = ControlLoop {
            pace: link.is_stepped().then(|| Pace::new(now_ns)),
            rig,
            link,
            recorder: None,
            watcher: Box::new(NoRecorder),
            inbox,
            published,
            health: LoopHealth::default(),
            run_health: LoopHealth::default(),
        };
        (handle, control)
    }

    fn run(mut self) {
        let mut deadline_ns = monotonic_ns();
        loop {
            let now_ns = monotonic_ns();
            self.note_lateness(now_ns.saturating_sub(deadline_ns));
            if !self.turn(now_ns) {
                return;
            }
            deadline_ns += PERIOD_NS;
            // Missed turns are not repeated: what is due depends on the rig's ticks, not on the number of turns.
            if now_ns > deadline_ns + PERIOD_NS {
                deadline_ns = now_ns + PERIOD_NS;
            }
            sleep_until(deadline_ns);
        }
    }

    /// Counts a turn that begins `late_ns` after its deadline.
    pub(crate) fn note_lateness(&mut self, late_ns: u64) {
        self.health.note(late_ns);
        self.run_health.note(late_ns);
    }

    /// One turn at `now_ns`: the polls that are due, at most one request, now and then the status. Returns false if the thread
    /// must end.
    pub(crate) fn turn(&mut self, now_ns: u64) -> bool {
        let polled_ns = self.poll_what_is_due(now_ns);
        if !self.take_request(polled_ns) {
            return false;
        }
        if self.health.turns.is_multiple_of(STATUS_TURNS) {
            self.drop_idle_recorder();
            self.publish();
        }
        true
    }

    /// Polls a rig with its own clock once, a stepped one after each of its ticks that are due. Returns the rig's time in ns.
    fn poll_what_is_due(&mut self, now_ns: u64) -> u64 {
        let Some(mut pace) = self.pace else {
            self.poll(now_ns);
            return now_ns;
        };
        for _ in 0..pace.due(now_ns) {
            self.link.step_far_end();
            self.poll(pace.tick());
        }
        self.health.skipped_ms = pace.skipped_ms();
        self.pace = Some(pace);
        pace.newest_ns()
    }

    fn poll(&mut self, now_ns: u64) {
        match &mut self.recorder {
            Some(recorder) => {
                let recorder = &mut Timed {
                    next: recorder.as_mut(),
                    health: &self.run_health,
                };
                self.rig.poll(now_ns, &mut self.link, recorder);
            }
            None => self.rig.poll(now_ns, &mut self.link, self.watcher.as_mut()),
        }
    }

    /// Takes at most one request. Returns false if the thread must end.
    fn take_request(&mut self, now_ns: u64) -> bool {
        let (request, answer) = match self.inbox.try_recv() {
            Ok(envelope) => envelope,
            Err(TryRecvError::Empty) => return true,
            Err(TryRecvError::Disconnected) => return false,
        };
        let accepted = |result: Result<(), Refusal>| result.map(|()| Reply::Accepted);
        let mut goes_on = true;
        let result = match request {
            Request::Start(order, recorder) => accepted(self.rig.start(*order).inspect(|()| {
                self.recorder = Some(recorder);
                self.run_health = LoopHealth::default();
            })),
            Request::Stop(cause) => {
                self.rig.stop(&cause, now_ns, &mut self.link);
                Ok(Reply::Accepted)
            }
            Request::Hold => accepted(self.rig.hold()),
            Request::Resume => accepted(self.rig.resume()),
            Request::Reset => accepted(self.rig.reset()),
            Request::Tare => self.rig.tare().map(Reply::Tared),
            Request::Zero => accepted(self.rig.zero().inspect(|()| self.recorder = None)),
            Request::Jog(step_mm) => accepted(self.rig.jog(step_mm)),
            Request::JogOn(step_mm) => accepted(self.rig.jog_on(step_mm)),
            Request::Note(text) => {
                if let Some(recorder) = &mut self.recorder {
                    self.rig.note(text, now_ns, &mut self.link, recorder.as_mut());
                }
                Ok(Reply::Accepted)
            }
            Request::Relink(link) => {
                self.link = *link;
                self.pace = self.link.is_stepped().then(|| Pace::new(now_ns));
                Ok(Reply::Accepted)
            }
            Request::End => {
                goes_on = false;
                Ok(Reply::Accepted)
            }
        };
        self.publish();
        // Fails if the caller no longer waits; the request is valid all the same. Sending never blocks.
        let _ = answer.send(result);
        goes_on
    }

    /// Drops the recorder once the run is over or could not start. That ends the recording thread.
    fn drop_idle_recorder(&mut self) {
        if matches!(
            self.rig.phase(),
            Phase::Ready | Phase::Interlocked | Phase::Connecting
        ) {
            self.recorder = None;
        }
    }

    /// Publishes the status. If a reader holds the lock, this round is skipped, so that a preempted reader delays the status
    /// but never control. Not a watch channel, because its writer waits for readers. Buffers of the status are reused.
    fn publish(&mut self) {
        let mut slot = match self.published.try_lock() {
            Ok(slot) => slot,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return,
        };
        self.rig.status_into(&mut slot.0);
        slot.1 = self.health;
    }
}

/// Adds the punctuality of the loop to the outcome of a run, and passes everything else on.
struct Timed<'a> {
    next: &'a mut dyn Recorder,
    health: &'a LoopHealth,
}

impl Recorder for Timed<'_> {
    fn begin(&mut self, header: &Header) {
        self.next.begin(header);
    }

    fn sample(&mut self, sample: &Sample) {
        self.next.sample(sample);
    }

    fn event(&mut self, event: &Event) {
        self.next.event(event);
    }

    fn stream_event(&mut self, event: &StreamEvent) {
        self.next.stream_event(event);
    }

    fn end(&mut self, outcome: &Outcome) {
        // A loop whose caller has a clock of its own counts no turns.
        let punctuality = (self.health.turns > 0).then(|| self.health.of_run());
        self.next.end(&Outcome {
            punctuality,
            ..outcome.clone()
        });
    }

    fn watch(&mut self, sample: &Sample) {
        self.next.watch(sample);
    }

    fn flush(&mut self) {
        self.next.flush();
    }
}

/// Recorder between runs: nothing is recorded.
pub(crate) struct NoRecorder;

impl Recorder for NoRecorder {
    fn begin(&mut self, _: &Header) {}
    fn sample(&mut self, _: &Sample) {}
    fn event(&mut self, _: &Event) {}
    fn end(&mut self, _: &Outcome) {}
}

fn sleep_until(deadline_ns: u64) {
    let at = std::time::Duration::from_nanos(deadline_ns).into();
    // A signal ends the sleep early: the loop then polls once too often, which is harmless.
    let _ = clock_nanosleep(ClockId::CLOCK_MONOTONIC, ClockNanosleepFlags::TIMER_ABSTIME, &at);
}

/// Raises this thread as far as the system allows. Returns one sentence for each thing that it does not allow.
fn degradations() -> Vec<String> {
    let mut missing = Vec::new();
    if let Err(reason) = raise_this_thread() {
        missing.push(format!(
            "no real-time priority ({reason}): samples stay complete, but commands may be late under load; grant CAP_SYS_NICE or set LimitRTPRIO=50"
        ));
    }
    if let Err(reason) = lock_memory() {
        missing.push(format!(
            "memory is not locked ({reason}): the control loop may wait for a memory page; set LimitMEMLOCK=infinity"
        ));
    }
    missing
}

/// Locks present and future memory. Not under a finite limit that cannot be raised, because a later allocation would fail
/// under such a limit.
fn lock_memory() -> Result<(), String> {
    let (soft, _) = getrlimit(Resource::RLIMIT_MEMLOCK).map_err(|e| e.to_string())?;
    if soft != RLIM_INFINITY && setrlimit(Resource::RLIMIT_MEMLOCK, RLIM_INFINITY, RLIM_INFINITY).is_err() {
        return Err(format!("the limit is {} KiB", soft / 1024));
    }
    mlockall(MlockAllFlags::MCL_CURRENT | MlockAllFlags::MCL_FUTURE).map_err(|e| e.to_string())
}
