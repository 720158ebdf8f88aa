//! The control thread: an OS thread of its own that polls the [`Rig`] on absolute deadlines of 1 ms, at real-time
//! priority and with locked memory where the system allows it, and says so where not. No async runtime comes near it.
//!
//! In the steady loop it neither waits for anybody nor allocates: requests come through a bounded channel that it only
//! tries, the status leaves through a mutex that it only tries, samples through the recorder that it was given.

use std::io;
use std::sync::mpsc::{self, Receiver, SyncSender, TryRecvError};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::thread::JoinHandle;

use nix::sys::mman::{MlockAllFlags, mlockall};
use nix::sys::resource::{RLIM_INFINITY, Resource, getrlimit, setrlimit};
use nix::time::{ClockId, ClockNanosleepFlags, clock_nanosleep};
use tokio::sync::oneshot;

use super::run::RunOrder;
use super::{Phase, Refusal, Rig, RigStatus, TareReport};
use crate::link::priority::raise_this_thread;
use crate::link::{Link, now_ns as monotonic_ns};
use crate::recording::{Event, Header, Outcome, Recorder, Sample};

/// Period of the loop.
const PERIOD_NS: u64 = 1_000_000;
/// The status is published every so many turns.
const STATUS_TURNS: u64 = 20;
/// A turn that begins later than this after its deadline is counted as late.
const LATE_NS: u64 = PERIOD_NS;
/// Requests that wait; people do not press faster.
const REQUESTS: usize = 8;

/// What people ask of control.
pub(crate) enum Request {
    /// Arms the rig and starts a run into this recorder, which is dropped once the run is over or came to nothing.
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
    /// A link that was lost is open again. The rig is only observed until someone starts anew.
    Relink(Box<Link>),
    /// Ends the control thread. Commands stop, the lease lapses: only for after a stop.
    End,
}

/// What control says to a request that it accepted.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Reply {
    /// It is under way.
    Accepted,
    /// The tare that was taken.
    Tared(TareReport),
}

/// Why a request got no answer from control.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum RequestError {
    /// Control refused.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// Too many requests wait.
    #[error("too many requests wait for the control thread: ask again in a moment")]
    Overloaded,
    /// The thread has ended.
    #[error("the control thread has ended: restart the daemon")]
    Ended,
}

/// Counts of the loop itself.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema,
)]
pub(crate) struct LoopHealth {
    /// Turns so far.
    pub turns: u64,
    /// Turns that began more than 1 ms after their deadline.
    pub late_turns: u64,
    /// Latest begin of a turn after its deadline in microseconds.
    pub worst_lateness_us: u64,
}

type Envelope = (Request, oneshot::Sender<Result<Reply, Refusal>>);

/// The control thread as everybody else sees it.
#[derive(Clone)]
pub(crate) struct Control {
    requests: SyncSender<Envelope>,
    published: Arc<Mutex<(RigStatus, LoopHealth)>>,
    degraded: Arc<[String]>,
}

impl Control {
    /// Starts the thread. The handle joins once [`Request::End`] was asked for or every `Control` is gone.
    pub(crate) fn spawn(rig: Rig, link: Link) -> io::Result<(Control, JoinHandle<()>)> {
        let (requests, inbox) = mpsc::sync_channel(REQUESTS);
        let (ready, degraded) = mpsc::sync_channel(1);
        let published = Arc::new(Mutex::new((rig.status(), LoopHealth::default())));
        let shared = Arc::clone(&published);
        let thread = std::thread::Builder::new()
            .name("control".to_owned())
            .spawn(move || {
                // The receiver waits just below; it is gone only if that thread died.
                let _ = ready.send(degradations());
                Loop {
                    rig,
                    link,
                    recorder: None,
                    inbox,
                    published: shared,
                    health: LoopHealth::default(),
                }
                .run();
            })?;
        let degraded = degraded
            .recv()
            .map_err(|_| io::Error::other("the control thread ended at its start"))?
            .into();
        Ok((
            Control {
                requests,
                published,
                degraded,
            },
            thread,
        ))
    }

    /// The newest status, at most about 20 ms old.
    pub(crate) fn status(&self) -> (RigStatus, LoopHealth) {
        self.published
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// What keeps the loop from its full precision, one sentence each; empty where all is well.
    pub(crate) fn degraded(&self) -> &[String] {
        &self.degraded
    }

    /// Asks control; the answer comes within a turn or two.
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

struct Loop {
    rig: Rig,
    link: Link,
    /// Of the run under way.
    recorder: Option<Box<dyn Recorder + Send>>,
    inbox: Receiver<Envelope>,
    published: Arc<Mutex<(RigStatus, LoopHealth)>>,
    health: LoopHealth,
}

impl Loop {
    fn run(mut self) {
        let mut deadline_ns = monotonic_ns();
        loop {
            let now_ns = monotonic_ns();
            self.note_lateness(now_ns.saturating_sub(deadline_ns));
            match &mut self.recorder {
                Some(recorder) => self.rig.poll(now_ns, &mut self.link, recorder.as_mut()),
                None => self.rig.poll(now_ns, &mut self.link, &mut Nobody),
            }
            if !self.take_request(now_ns) {
                return;
            }
            if self.health.turns.is_multiple_of(STATUS_TURNS) {
                self.let_go_of_recorder();
                self.publish();
            }
            deadline_ns += PERIOD_NS;
            // Turns that were missed are not made up for: the rig's ticks, not our turns, say what is due.
            if now_ns > deadline_ns + PERIOD_NS {
                deadline_ns = now_ns + PERIOD_NS;
            }
            sleep_until(deadline_ns);
        }
    }

    fn note_lateness(&mut self, late_ns: u64) {
        self.health.turns += 1;
        self.health.late_turns += u64::from(late_ns > LATE_NS);
        self.health.worst_lateness_us = self.health.worst_lateness_us.max(late_ns / 1000);
    }

    /// One request a turn; false where the thread is to end.
    fn take_request(&mut self, now_ns: u64) -> bool {
        let (request, answer) = match self.inbox.try_recv() {
            Ok(envelope) => envelope,
            Err(TryRecvError::Empty) => return true,
            Err(TryRecvError::Disconnected) => return false,
        };
        let accepted = |result: Result<(), Refusal>| result.map(|()| Reply::Accepted);
        let mut goes_on = true;
        let result = match request {
            Request::Start(order, recorder) => accepted(
                self.rig
                    .start(*order)
                    .inspect(|()| self.recorder = Some(recorder)),
            ),
            Request::Stop(cause) => accepted(self.rig.stop(&cause, now_ns)),
            Request::Hold => accepted(self.rig.hold()),
            Request::Resume => accepted(self.rig.resume()),
            Request::Reset => accepted(self.rig.reset()),
            Request::Tare => self.rig.tare().map(Reply::Tared),
            Request::Relink(link) => {
                self.link = *link;
                Ok(Reply::Accepted)
            }
            Request::End => {
                goes_on = false;
                Ok(Reply::Accepted)
            }
        };
        self.publish();
        // Whoever asked may have gone; the request stands all the same. Sending wakes, it never waits.
        let _ = answer.send(result);
        goes_on
    }

    /// A run that is over, or never began, needs its recorder no more: dropping it ends the recording thread.
    fn let_go_of_recorder(&mut self) {
        if matches!(
            self.rig.phase(),
            Phase::Ready | Phase::Interlocked | Phase::Connecting
        ) {
            self.recorder = None;
        }
    }

    /// Leaves the status for whoever wants it. Where a reader holds the lock just now this round is left out, so a
    /// reader that is preempted delays the status and never control. A watch channel would not do: its writer waits for
    /// readers. Buffers of the status are reused.
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

/// Between runs nothing is recorded.
struct Nobody;

impl Recorder for Nobody {
    fn begin(&mut self, _: &Header) {}
    fn sample(&mut self, _: &Sample) {}
    fn event(&mut self, _: &Event) {}
    fn end(&mut self, _: &Outcome) {}
}

fn sleep_until(deadline_ns: u64) {
    let at = std::time::Duration::from_nanos(deadline_ns).into();
    // A signal ends the sleep early: the loop then polls once more, which does no harm.
    let _ = clock_nanosleep(ClockId::CLOCK_MONOTONIC, ClockNanosleepFlags::TIMER_ABSTIME, &at);
}

/// Raises this thread as far as the system allows; what it does not allow comes back as sentences.
fn degradations() -> Vec<String> {
    let mut missing = Vec::new();
    if let Err(reason) = raise_this_thread() {
        missing.push(format!(
            "no real-time priority ({reason}): samples stay complete, but commands may come late under load; grant CAP_SYS_NICE or set LimitRTPRIO=50"
        ));
    }
    if let Err(reason) = lock_memory() {
        missing.push(format!(
            "memory is not locked ({reason}): the control loop may wait for a page; set LimitMEMLOCK=infinity"
        ));
    }
    missing
}

/// Locks what is there and what comes. Not under a finite limit that cannot be lifted: there a later allocation would
/// fail, which is worse.
fn lock_memory() -> Result<(), String> {
    let (soft, _) = getrlimit(Resource::RLIMIT_MEMLOCK).map_err(|e| e.to_string())?;
    if soft != RLIM_INFINITY && setrlimit(Resource::RLIMIT_MEMLOCK, RLIM_INFINITY, RLIM_INFINITY).is_err() {
        return Err(format!("limit {} KiB", soft / 1024));
    }
    mlockall(MlockAllFlags::MCL_CURRENT | MlockAllFlags::MCL_FUTURE).map_err(|e| e.to_string())
}
