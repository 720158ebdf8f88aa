//! Links: move frames, never look inside. A link is a socket that never blocks, or lock-free rings that a thread of its
//! own serves, so the control thread neither waits nor allocates.
//!
//! A new backend is one file and one line in [`BACKENDS`].

mod can;
pub(crate) mod loopback;
pub(crate) mod priority;
mod rings;
mod serial;
mod service;
mod wake;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::protocol::cob;
use crate::protocol::frame::Frame;

/// Frames that a ring holds: 4 s of samples, so a reader that stalls for 2 s loses nothing.
pub(crate) const RING_FRAMES: usize = 8192;

/// A frame with the host's monotonic arrival time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Arrival {
    /// The frame.
    pub frame: Frame,
    /// Nanoseconds on the host's monotonic clock; in memory what the pair's virtual clock showed as it was sent.
    pub at_ns: u64,
}

/// Counters of a link, written by its task, read by anyone.
#[derive(Debug, Default)]
pub(crate) struct LinkHealth {
    /// The link is open; false once the far end is gone.
    pub open: AtomicBool,
    /// Frames that the bus or port refused (queue full, write deadline).
    pub send_failures: AtomicU64,
    /// Frames that arrived when the ring, or the kernel's queue before it, was full.
    pub overflows: AtomicU64,
    /// A CAN controller reports that it is error passive: no new run should start.
    pub error_passive: AtomicBool,
    /// CAN error frames, or serial packets with a wrong CRC or framing.
    pub bus_errors: AtomicU64,
    /// CAN bus-off reports.
    pub bus_off: AtomicU64,
}

impl LinkHealth {
    /// Open, all counters zero.
    pub(crate) fn opened() -> Self {
        LinkHealth {
            open: AtomicBool::new(true),
            ..Self::default()
        }
    }

    /// True while the far end is there.
    pub(crate) fn is_open(&self) -> bool {
        self.open.load(Ordering::Relaxed)
    }
}

/// One end of a link. `send`, `send_urgent` and `receive` are lock-free, never wait and never allocate.
pub(crate) struct Link {
    /// Counters.
    pub health: Arc<LinkHealth>,
    wire: Wire,
}

/// What a link is made of.
enum Wire {
    /// In memory, or a port that a thread of its own serves.
    Rings(rings::Rings),
    /// A CAN interface, by the kernel's own queues.
    Can(can::Port),
}

impl Link {
    fn over(wire: Wire) -> Self {
        Link {
            health: Arc::new(LinkHealth::opened()),
            wire,
        }
    }

    /// Queues `frame`. False, and counted, where the queue is full or the far end gone.
    pub(crate) fn send(&mut self, frame: Frame) -> bool {
        match &mut self.wire {
            Wire::Rings(rings) => rings.send(frame, false, &self.health),
            Wire::Can(port) => port.send(frame, false, &self.health),
        }
    }

    /// Queues `frame` before all others: the abort.
    pub(crate) fn send_urgent(&mut self, frame: Frame) -> bool {
        match &mut self.wire {
            Wire::Rings(rings) => rings.send(frame, true, &self.health),
            Wire::Can(port) => port.send(frame, true, &self.health),
        }
    }

    /// The next frame that arrived.
    pub(crate) fn receive(&mut self) -> Option<Arrival> {
        match &mut self.wire {
            Wire::Rings(rings) => rings.receive(&self.health),
            Wire::Can(port) => port.receive(&self.health),
        }
    }

    /// Waits until what was queued is sent and the port is free again. A link that is just dropped does the same, but
    /// nobody waits for it. Not for the control thread.
    pub(crate) fn close(self) {
        if let Wire::Rings(rings) = self.wire {
            rings.close();
        }
    }
}

/// Now, on the host's monotonic clock: the clock of [`Arrival::at_ns`] on real links.
pub(crate) fn now_ns() -> u64 {
    let Ok(now) = nix::time::clock_gettime(nix::time::ClockId::CLOCK_MONOTONIC) else {
        // The clock exists on every Linux.
        return 0;
    };
    now.tv_sec() as u64 * 1_000_000_000 + now.tv_nsec() as u64
}

/// Why a link could not be opened.
#[derive(Debug, thiserror::Error)]
pub(crate) enum LinkError {
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
pub(crate) struct Backend {
    /// The part of the address before the colon: `can:vcan0`, `serial:/dev/ttyUSB0`.
    pub scheme: &'static str,
    /// One sentence.
    pub what: &'static str,
    /// Opens the address after the scheme, or says what is wrong and what to do. A thread that serves it ends when the
    /// [`Link`] is dropped or the far end is gone. Needs no runtime around it. `side` tells which frames are for us.
    pub open: fn(address: &str, side: Side) -> Result<Link, String>,
}

/// Which end of the wire this is: it decides which identifiers are for us.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
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

impl Side {
    /// Identifiers that are for this end.
    pub(crate) fn identifiers(self) -> [u16; 5] {
        match self {
            Side::Host { rig_node } => [
                cob::EMERGENCY,
                cob::SAMPLE,
                cob::STATUS,
                cob::CONFIG_ANSWER,
                cob::HEARTBEAT,
            ]
            .map(|function| function + u16::from(rig_node & 0x7F)),
            Side::Rig { node } => {
                let own = |function| function + u16::from(node & 0x7F);
                [
                    cob::NMT,
                    own(cob::COMMAND),
                    own(cob::LEASE),
                    own(cob::REQUEST),
                    own(cob::CONFIG_REQUEST),
                ]
            }
        }
    }
}

/// All backends.
pub(crate) static BACKENDS: &[Backend] = &[
    Backend {
        scheme: "can",
        what: "CAN interface of the kernel (SocketCAN): can:can0",
        open: can::open,
    },
    Backend {
        scheme: "serial",
        what: "serial port, 921600 Bd unless said otherwise: serial:/dev/ttyUSB0?baud=460800",
        open: serial::open,
    },
];

/// Opens the link at `address`, such as `can:vcan0` or `serial:/dev/ttyUSB0`.
pub(crate) fn open(address: &str, side: Side) -> Result<Link, LinkError> {
    let backend = address.split_once(':').and_then(|(scheme, rest)| {
        let backend = BACKENDS.iter().find(|backend| backend.scheme == scheme)?;
        Some((backend, rest))
    });
    let Some((backend, rest)) = backend else {
        let known: Vec<&str> = BACKENDS.iter().map(|backend| backend.what).collect();
        return Err(LinkError::Scheme {
            address: address.to_owned(),
            known: known.join("; "),
        });
    };
    (backend.open)(rest, side).map_err(|reason| LinkError::Open {
        address: address.to_owned(),
        reason,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_scheme_names_the_known_ones() {
        for address in ["vcan0", "usb:1", ""] {
            let error = open(address, Side::Rig { node: 1 })
                .err()
                .expect("no such scheme")
                .to_string();
            assert!(
                error.contains("can:can0") && error.contains("serial:/dev/ttyUSB0"),
                "{error}"
            );
        }
    }

    #[test]
    fn the_two_sides_share_no_identifier() {
        let host = Side::Host { rig_node: 5 }.identifiers();
        assert!(
            Side::Rig { node: 5 }
                .identifiers()
                .iter()
                .all(|id| !host.contains(id))
        );
    }
}
