//! The control loop of the daemon with the mock rig in memory, by the clock of the test.

use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll, Waker};

use super::allocations;
use crate::cli::virtual_bench::VirtualBench;
use crate::control::Phase;
use crate::control::realtime::{ControlHandle, ControlLoop, Reply, Request};
use crate::control::run::RunOrder;
use crate::link::loopback;
use crate::recording::Recorder;
use crate::tests::support::bench::mock;

pub const MS: u64 = 1_000_000;
/// Longest wait for a phase.
const LONGEST_TICKS: u64 = 2_000_000;

/// The control loop with the mock rig in memory, by the clock of the test.
pub struct Loop {
    pub handle: ControlHandle,
    pub control: ControlLoop,
    pub now_ns: u64,
    /// Allocations and frees of the mock rig, which the loop steps on its thread and which is no part of control.
    pub of_mock: Arc<[AtomicU64; 2]>,
}

impl Loop {
    pub fn new() -> Loop {
        let VirtualBench { rig, mut mock, .. } = VirtualBench::new(&mock(), None).expect("a sound bench");
        let of_mock = Arc::new([const { AtomicU64::new(0) }; 2]);
        let counts = Arc::clone(&of_mock);
        let link = loopback::stepped(move |far| {
            let before = allocations::of_this_thread();
            mock.tick(far);
            let after = allocations::of_this_thread();
            counts[0].fetch_add(after.count - before.count, Ordering::Relaxed);
            counts[1].fetch_add(after.freed - before.freed, Ordering::Relaxed);
        });
        let (handle, control) = ControlLoop::new(rig, link, 0);
        Loop {
            handle,
            control,
            now_ns: 0,
            of_mock,
        }
    }

    pub fn turn(&mut self) {
        self.now_ns += MS;
        self.control.note_lateness(0);
        assert!(self.control.turn(self.now_ns), "the loop goes on");
    }

    /// Rests as long as a start needs, then starts a run.
    pub fn start(&mut self, order: RunOrder, recorder: Box<dyn Recorder + Send>) {
        self.until(Phase::Ready);
        (0..700).for_each(|_| self.turn());
        self.ask(Request::Start(Box::new(order), recorder));
        self.until(Phase::Running);
    }

    pub fn until(&mut self, phase: Phase) {
        for _ in 0..LONGEST_TICKS {
            if self.handle.status().0.phase == phase {
                return;
            }
            self.turn();
        }
        panic!("not {phase:?}: {:#?}", self.handle.status());
    }

    pub fn ask(&mut self, request: Request) {
        let handle = self.handle.clone();
        let mut asked = pin!(handle.ask(request));
        let context = &mut Context::from_waker(Waker::noop());
        assert!(asked.as_mut().poll(context).is_pending());
        self.turn();
        let answer = asked.as_mut().poll(context);
        assert!(matches!(answer, Poll::Ready(Ok(Reply::Accepted))), "{answer:?}");
    }
}
