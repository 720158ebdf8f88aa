//! Links: move frames, never look inside. A link is lock-free rings that a task on a thread of its own serves, so the
//! control thread neither waits nor allocates.
//!
//! A new backend is one file and one line in [`BACKENDS`].

pub mod loopback;
mod wake;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::protocol::frame::Frame;
use wake::Waker;

/// Frames that a ring holds: 4 s of samples, so a reader that stalls for 2 s loses nothing.
pub const RING_FRAMES: usize = 8192;

/// A frame with the host's monotonic arrival time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arrival {
    /// The frame.
    pub frame: Frame,
    /// Nanoseconds on the host's monotonic clock; in memory what the pair's virtual clock showed as it was sent.
    pub at_ns: u64,
}

/// Counters of a link, written by its task, read by anyone.
#[derive(Debug, Default)]
pub struct LinkHealth {
    /// The link is open; false once the far end is gone.
    pub open: AtomicBool,
    /// Frames that the bus or port refused (queue full, write deadline).
    pub send_failures: AtomicU64,
    /// Frames that arrived when the ring was full.
    pub overflows: AtomicU64,
    /// CAN error frames, or serial packets with a wrong CRC or framing.
    pub bus_errors: AtomicU64,
    /// CAN bus-off reports.
    pub bus_off: AtomicU64,
}

impl LinkHealth {
    /// Open, all counters zero.
    pub fn opened() -> Self {
        LinkHealth {
            open: AtomicBool::new(true),
            ..Self::default()
        }
    }

    /// True while the far end is there.
    pub fn is_open(&self) -> bool {
        self.open.load(Ordering::Relaxed)
    }
}

/// One end of a link. All three methods are lock-free, never wait and never allocate.
pub struct Link {
    /// Counters.
    pub health: Arc<LinkHealth>,
    /// Towards the far end, in order. `at_ns` means something in memory only.
    out: rtrb::Producer<Arrival>,
    /// Overtakes `out`, where there is a queue to overtake.
    urgent: Option<rtrb::Producer<Arrival>>,
    inbox: rtrb::Consumer<Arrival>,
    /// Virtual clock that stamps what we send; in memory only.
    clock: Option<Arc<AtomicU64>>,
    /// Wakes the task that empties `out` and `urgent`; none in memory.
    wake: Option<Waker>,
}

impl Link {
    /// Queues `frame`. False, and counted, where the ring is full or the far end gone.
    pub fn send(&mut self, frame: Frame) -> bool {
        let at_ns = self.stamp();
        let sent = !self.out.is_abandoned() && self.out.push(Arrival { frame, at_ns }).is_ok();
        self.after_send(sent)
    }

    /// Queues `frame` before all others: the abort.
    pub fn send_urgent(&mut self, frame: Frame) -> bool {
        let at_ns = self.stamp();
        let Some(urgent) = &mut self.urgent else {
            return self.send(frame);
        };
        let sent = !urgent.is_abandoned() && urgent.push(Arrival { frame, at_ns }).is_ok();
        self.after_send(sent)
    }

    /// The next frame that arrived.
    pub fn receive(&mut self) -> Option<Arrival> {
        // Asked before the pop: what the far end sent before it went is still delivered.
        let abandoned = self.inbox.is_abandoned();
        let arrival = self.inbox.pop().ok();
        if arrival.is_none() && abandoned {
            self.health.open.store(false, Ordering::Relaxed);
        }
        arrival
    }

    fn stamp(&self) -> u64 {
        self.clock
            .as_ref()
            .map_or(0, |clock| clock.load(Ordering::Relaxed))
    }

    fn after_send(&self, sent: bool) -> bool {
        if !sent {
            self.health.send_failures.fetch_add(1, Ordering::Relaxed);
        }
        if let Some(wake) = &self.wake {
            wake.wake();
        }
        sent
    }
}

/// Why a link could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The address has no scheme of ours.
    #[error("link \"{address}\" has no known scheme: write one of {known}")]
    Scheme {
        /// As given.
        address: String,
        /// What there is.
        known: String,
    },
    /// The port or interface is not there, or taken, or forbidden.
    #[error("link {address} cannot be opened: {reason}")]
    Open {
        /// As given.
        address: String,
        /// What is wrong and what to do.
        reason: String,
    },
}

/// A way to reach a rig.
pub struct Backend {
    /// The part of the address before the colon: `can:vcan0`, `serial:/dev/ttyUSB0`.
    pub scheme: &'static str,
    /// One sentence.
    pub what: &'static str,
    /// Opens the address after the scheme and starts the thread that serves the rings; it ends when the [`Link`] is
    /// dropped or the far end is gone. Needs no runtime around it. `side` tells which frames are for us.
    pub open: fn(address: &str, side: Side) -> Result<Link, LinkError>,
}

/// Which end of the wire this is: it decides which identifiers are for us.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The daemon.
    Host {
        /// Node of the rig that we talk to.
        rig_node: u8,
    },
    /// The firmware (the mock rig).
    Rig {
        /// Our own node.
        node: u8,
    },
}

/// All backends.
pub static BACKENDS: &[Backend] = &[];
