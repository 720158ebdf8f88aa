//! A port of lock-free rings. In memory the far end holds their other ends, on a serial port a thread of the link does.

use std::sync::atomic::Ordering;

use super::wake::Waker;
use super::{LinkHealth, Port};
use crate::protocol::frame::Frame;

/// The rings of one end.
pub(super) struct Rings {
    /// To the far end, in order.
    pub out: Outlet,
    /// To the far end, before the frames in `out`; `None` where frames in `out` never wait.
    pub urgent: Option<Outlet>,
    /// From the far end.
    pub inbox: rtrb::Consumer<Frame>,
}

/// A ring to the far end, and what wakes the task that empties it (`None` in memory).
pub(super) struct Outlet {
    pub ring: rtrb::Producer<Frame>,
    pub waker: Option<Waker>,
}

impl Port for Rings {
    fn send(&mut self, frame: Frame, urgent: bool, health: &LinkHealth) -> bool {
        let outlet = match &mut self.urgent {
            Some(outlet) if urgent => outlet,
            _ => &mut self.out,
        };
        outlet.push(frame, health)
    }

    fn receive(&mut self, health: &LinkHealth) -> Option<Frame> {
        // Read before the pop, so that frames sent before the far end closed are still delivered.
        let abandoned = self.inbox.is_abandoned();
        let frame = self.inbox.pop().ok();
        if frame.is_none() && abandoned {
            health.open.store(false, Ordering::Relaxed);
        }
        frame
    }
}

impl Outlet {
    fn push(&mut self, frame: Frame, health: &LinkHealth) -> bool {
        let sent = !self.ring.is_abandoned() && self.ring.push(frame).is_ok();
        if !sent {
            health.send_failures.fetch_add(1, Ordering::Relaxed);
        }
        if let Some(waker) = &self.waker {
            waker.wake();
        }
        sent
    }
}
