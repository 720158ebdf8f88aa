//! A link of lock-free rings: in memory the far end holds their other ends, on a serial port a thread does.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::wake::Waker;
use super::{Arrival, LinkHealth};
use crate::protocol::frame::Frame;

/// This end's rings.
pub(super) struct Rings {
    /// Towards the far end, in order.
    pub out: Outlet,
    /// Overtakes `out`, where there is a queue to overtake.
    pub urgent: Option<Outlet>,
    /// From the far end.
    pub inbox: rtrb::Consumer<Arrival>,
    /// Virtual clock that stamps what we send; in memory only.
    pub clock: Option<Arc<AtomicU64>>,
    /// The thread that serves the rings; none in memory.
    pub service: Option<std::thread::JoinHandle<()>>,
}

/// A ring towards the far end, and what wakes the task that empties it (none in memory).
pub(super) struct Outlet {
    /// `at_ns` means something in memory only.
    pub ring: rtrb::Producer<Arrival>,
    pub waker: Option<Waker>,
}

impl Rings {
    pub(super) fn send(&mut self, frame: Frame, urgent: bool, health: &LinkHealth) -> bool {
        let at_ns = self
            .clock
            .as_ref()
            .map_or(0, |clock| clock.load(Ordering::Relaxed));
        let outlet = match &mut self.urgent {
            Some(outlet) if urgent => outlet,
            _ => &mut self.out,
        };
        outlet.push(Arrival { frame, at_ns }, health)
    }

    pub(super) fn receive(&mut self, health: &LinkHealth) -> Option<Arrival> {
        // Asked before the pop: what the far end sent before it went is still delivered.
        let abandoned = self.inbox.is_abandoned();
        let arrival = self.inbox.pop().ok();
        if arrival.is_none() && abandoned {
            health.open.store(false, Ordering::Relaxed);
        }
        arrival
    }

    pub(super) fn close(self) {
        let Rings {
            service, out, urgent, ..
        } = self;
        drop((out, urgent));
        if let Some(service) = service {
            // A panic there has been reported by the panic hook; there is nothing left to close.
            let _ = service.join();
        }
    }
}

impl Outlet {
    fn push(&mut self, arrival: Arrival, health: &LinkHealth) -> bool {
        let sent = !self.ring.is_abandoned() && self.ring.push(arrival).is_ok();
        if !sent {
            health.send_failures.fetch_add(1, Ordering::Relaxed);
        }
        if let Some(waker) = &self.waker {
            waker.wake();
        }
        sent
    }
}
