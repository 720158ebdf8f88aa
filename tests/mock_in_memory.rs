//! The control loop with the mock rig in memory on a busy computer, by a clock that the test moves: whatever pauses the
//! computer makes, the run is the same as on an idle one.

use std::pin::pin;
use std::sync::{Arc, Mutex};

use super::support::bench::mock;
use crate::cli::virtual_bench::VirtualBench;
use crate::control::Phase;
use crate::control::realtime::{ControlHandle, ControlLoop, LoopHealth, Reply, Request, RequestError};
use crate::control::run::RunOrder;
use crate::daemon::header::{self, Planned};
use crate::link::loopback;
use crate::profile::Profile;
use crate::recording::memory::Memory;
use crate::recording::{Ending, Flags};

const MS: u64 = 1_000_000;
const RAMP: &str = "name = \"ramp\"\ncontrol = \"force\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\nto_n = 800.0\n\
                    duration_s = 6.0\n[[block.segment]]\nkind = \"ramp\"\nto_n = 0.0\nduration_s = 6.0\n";

struct Computer {
    handle: ControlHandle,
    control: ControlLoop,
    now_ns: u64,
    runtime: tokio::runtime::Runtime,
}

impl Computer {
    fn new() -> Computer {
        let VirtualBench { rig, mock, .. } = VirtualBench::new(&mock(), None).expect("a sound bench");
        let mut rig_end = mock;
        let link = loopback::stepped(move |far| rig_end.tick(far));
        let (handle, control) = ControlLoop::new(rig, link, 0);
        let runtime = tokio::runtime::Builder::new_current_thread()
            .build()
            .expect("a runtime");
        Computer {
            handle,
            control,
            now_ns: 0,
            runtime,
        }
    }

    /// The loop's next turn comes after `pause_ms`.
    fn turn(&mut self, pause_ms: u64) {
        self.now_ns += pause_ms * MS;
        assert!(self.control.turn(self.now_ns), "the loop goes on");
    }

    fn phase(&self) -> Phase {
        self.handle.status().0.phase
    }

    fn health(&self) -> LoopHealth {
        self.handle.status().1
    }

    fn until(&mut self, phase: Phase, mut pause_ms: impl FnMut() -> u64) {
        for _ in 0..60_000 {
            if self.phase() == phase {
                return;
            }
            let pause_ms = pause_ms();
            self.turn(pause_ms);
        }
        panic!("not {phase:?}: {:#?}", self.handle.status());
    }

    /// Asks, makes one turn after `pause_ms`, and takes the answer.
    fn ask(&mut self, request: Request, pause_ms: u64) -> Result<Reply, RequestError> {
        let handle = self.handle.clone();
        let mut asked = pin!(handle.ask(request));
        // The first poll sends the request.
        let first = self.runtime.block_on(std::future::poll_fn(|context| {
            std::task::Poll::Ready(asked.as_mut().poll(context))
        }));
        assert!(first.is_pending(), "nothing answers before the turn");
        self.turn(pause_ms);
        self.runtime.block_on(asked)
    }

    /// Starts the ramp; what it records.
    fn start(&mut self) -> Arc<Mutex<Memory>> {
        let memory = Arc::new(Mutex::new(Memory::default()));
        let profile = Profile::from_toml(RAMP, "test").expect("a profile");
        let planned = Planned {
            cycles: 0,
            duration_s: 12.0,
        };
        let at = "2026-01-01T00:00:00Z".parse().expect("a time");
        let header = header::new("test".into(), at, &mock(), &profile, RAMP.into(), planned);
        let order = RunOrder {
            header,
            profile,
            first_cycle: 1,
        };
        let start = Request::Start(Box::new(order), Box::new(Arc::clone(&memory)));
        assert_eq!(self.ask(start, 1), Ok(Reply::Accepted));
        memory
    }
}

/// Pauses of a computer with many busy processes, in ms: mostly short, now and then longer than every time-out of the link.
fn busy() -> impl FnMut() -> u64 {
    let mut turn = 0_u64;
    move || {
        turn += 1;
        match turn % 97 {
            13 => 35,
            41 => 130,
            77 => 700,
            _ => 1 + turn % 3,
        }
    }
}

#[test]
fn a_run_on_a_busy_computer_is_the_run_on_an_idle_one() {
    let run = |mut pause_ms: Box<dyn FnMut() -> u64>| {
        let mut computer = Computer::new();
        computer.until(Phase::Ready, &mut pause_ms);
        (0..700).for_each(|_| computer.turn(1));
        let memory = computer.start();
        computer.until(Phase::Running, &mut pause_ms);
        computer.until(Phase::Ready, &mut pause_ms);
        let (status, health) = computer.handle.status();
        assert_eq!(
            (status.counters.lost, status.counters.late),
            (0, 0),
            "{status:#?}"
        );
        assert_eq!(
            status.counters.late_polls, 0,
            "control has no pauses in the rig's time"
        );
        assert_eq!(health.skipped_ms, 0);
        let memory = memory.lock().expect("one thread").clone();
        let outcome = memory.outcome.as_ref().expect("the run ended");
        assert_eq!(
            (outcome.ending, outcome.lost, outcome.late),
            (Ending::Completed, 0, 0),
            "{outcome:?}"
        );
        assert!(
            memory
                .samples
                .iter()
                .all(|s| !s.flags.intersects(Flags::LATE | Flags::AFTER_GAP))
        );
        memory.samples.len()
    };
    assert_eq!(run(Box::new(busy())), run(Box::new(|| 1)));
}

#[test]
fn a_pause_of_seconds_is_skipped_and_shown() {
    let mut computer = Computer::new();
    computer.until(Phase::Ready, || 1);
    (0..700).for_each(|_| computer.turn(1));
    let memory = computer.start();
    computer.until(Phase::Running, || 1);
    computer.turn(3_000);
    computer.until(Phase::Ready, || 1);
    assert_eq!(computer.health().skipped_ms, 2_999);
    let memory = memory.lock().expect("one thread");
    let outcome = memory.outcome.as_ref().expect("the run ended");
    assert_eq!(
        (outcome.ending, outcome.lost),
        (Ending::Completed, 0),
        "{outcome:?}"
    );
}

/// While the loop makes up for a pause, an operator's stop waits for one turn, not for the whole pause.
#[test]
fn a_request_is_taken_while_the_rig_catches_up() {
    let mut computer = Computer::new();
    computer.until(Phase::Ready, || 1);
    (0..700).for_each(|_| computer.turn(1));
    computer.start();
    computer.until(Phase::Running, || 1);
    let samples = computer.handle.status().0.counters.samples;
    assert_eq!(
        computer.ask(Request::Stop("test".into()), 900),
        Ok(Reply::Accepted)
    );
    let taken = computer.handle.status().0.counters.samples - samples;
    assert!(taken <= 41, "{taken} samples before the stop");
}
