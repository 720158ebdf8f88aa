//! Links: move frames, never look inside. A link is two lock-free rings that a task of its own serves, so the control
//! thread neither waits nor allocates.
//!
//! A new backend is one file and one line in [`BACKENDS`].

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::protocol::frame::Frame;

/// Frames that a ring holds: 4 s of samples, so a reader that stalls for 2 s loses nothing.
pub const RING_FRAMES: usize = 8192;

/// A frame with the host's monotonic arrival time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arrival {
    /// The frame.
    pub frame: Frame,
    /// Nanoseconds on the host's monotonic clock; in memory the virtual clock.
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
    /// True while the far end is there.
    pub fn is_open(&self) -> bool {
        self.open.load(Ordering::Relaxed)
    }
}

/// One end of a link.
pub struct Link {
    /// Frames to send, in order.
    pub out: rtrb::Producer<Frame>,
    /// Frames to send before all others: the abort.
    pub urgent: rtrb::Producer<Frame>,
    /// Frames that arrived, in order.
    pub inbox: rtrb::Consumer<Arrival>,
    /// Counters.
    pub health: Arc<LinkHealth>,
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
    /// Opens the address after the scheme; `is_ours` keeps frames of other nodes asleep in the kernel. Must be called
    /// inside a tokio runtime, whose task serves the rings.
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
