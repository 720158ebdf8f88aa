//! Links carry frames between host and rig. What frames mean is left to `protocol`.
//!
//! The thread that owns a link reads and writes its socket, port or ring itself. None of them blocks, so the control thread
//! neither waits nor allocates. A new link is one file with a `BACKEND` and one line in [`BACKENDS`].

mod can;
pub(crate) mod loopback;
pub(crate) mod priority;
mod serial;
mod serial_queue;
pub(crate) mod wire_log;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::protocol::cob;
use crate::protocol::frame::Frame;
use crate::units::NS_PER_S;

pub(crate) use can::RECEIVE_BUFFER_BYTES as CAN_RECEIVE_BUFFER_BYTES;
#[cfg(test)]
pub(crate) use can::frame_of as frame_of_the_kernel;

/// All links, in the order in which help texts name them.
static BACKENDS: &[Backend] = &[loopback::BACKEND, can::BACKEND, serial::BACKEND];

/// A kind of link.
struct Backend {
    /// The part of the address before the colon.
    scheme: &'static str,
    /// The part of the address after the colon, as help texts name it; empty where the address has none.
    place: &'static str,
    /// One sentence with an example.
    what: &'static str,
    access: Access,
}

/// How a link reaches the rig.
enum Access {
    /// Both ends are in this process; [`loopback::pair`] makes them.
    InProcess,
    /// Over a port. The function opens the part of the address after the colon, or returns what is wrong and what to do.
    /// `side` says which frames are for this end. It may wait for the system, so it is not for an async task.
    Port(fn(place: &str, side: Side) -> Result<Link, String>),
}

/// State and counters of a link, written by the link, read by anyone.
#[derive(Debug, Default)]
pub(crate) struct LinkHealth {
    /// The link is open; false once the other end is closed and the port is free again.
    pub open: AtomicBool,
    /// Frames that the bus or port refused (queue full, write deadline).
    pub send_failures: AtomicU64,
    /// Frames lost because a queue of the kernel or of the CAN controller was full.
    pub overflows: AtomicU64,
    /// The CAN controller's newest report says error passive; false again once it reports a better state.
    pub error_passive: AtomicBool,
    /// CAN error frames, or serial packets with a wrong CRC or framing.
    pub bus_errors: AtomicU64,
    /// CAN bus-off reports.
    pub bus_off: AtomicU64,
    /// Serial packets dropped because COBS, CRC-16, length or identifier was wrong; 0 on other links.
    pub bad_packets: AtomicU64,
    /// Serial packets that were whole, of any identifier; 0 on other links.
    pub good_packets: AtomicU64,
}

impl LinkHealth {
    /// Open, all counters zero.
    fn opened() -> Self {
        LinkHealth {
            open: AtomicBool::new(true),
            ..Self::default()
        }
    }

    /// True while the other end is open.
    pub(crate) fn is_open(&self) -> bool {
        self.open.load(Ordering::Relaxed)
    }
}

/// One end of a link. None of its functions waits or allocates.
pub(crate) struct Link {
    /// State and counters; shared, because they are read by other threads.
    pub health: Arc<LinkHealth>,
    port: Box<dyn Port>,
    /// The next tick of a rig in memory that does not run by itself.
    far_end: Option<Box<dyn FnMut() + Send>>,
    /// Gets a copy of each frame, where a log is wanted.
    tap: Option<wire_log::Tap>,
}

/// Transport of the frames of a link. No function waits or allocates.
trait Port: Send {
    /// Queues `frame`, an urgent one before all others. False, and counted, if the queue is full or the other end is closed.
    fn send(&mut self, frame: Frame, urgent: bool, health: &LinkHealth) -> bool;

    /// The next frame that arrived. Closes `health` if the other end is closed.
    fn receive(&mut self, health: &LinkHealth) -> Option<Frame>;

    /// Hands the queued frames to the system at `now_ns` (monotonic). Nothing to do where `send` does that already.
    fn flush(&mut self, _now_ns: u64, _health: &LinkHealth) {}
}

impl Link {
    fn over(port: impl Port + 'static, health: Arc<LinkHealth>) -> Self {
        Link {
            health,
            port: Box::new(port),
            far_end: None,
            tap: None,
        }
    }

    /// True if the far end is a rig that ticks only in [`Link::step_far_end`].
    pub(crate) fn is_stepped(&self) -> bool {
        self.far_end.is_some()
    }

    /// One tick of a stepped far end; nothing on other links.
    pub(crate) fn step_far_end(&mut self) {
        if let Some(tick) = &mut self.far_end {
            tick();
        }
    }

    /// Queues `frame`; it leaves with the next [`Link::flush`]. False, and counted, if the queue is full or the other end is closed.
    pub(crate) fn send(&mut self, frame: Frame) -> bool {
        self.sends(frame, false)
    }

    /// Queues `frame` before all others; for the abort and the emergency.
    pub(crate) fn send_urgent(&mut self, frame: Frame) -> bool {
        self.sends(frame, true)
    }

    fn sends(&mut self, frame: Frame, urgent: bool) -> bool {
        let sent = self.port.send(frame, urgent, &self.health);
        if let Some(tap) = self.tap.as_mut().filter(|_| sent) {
            tap.take(&frame);
        }
        sent
    }

    /// The next frame that arrived.
    pub(crate) fn receive(&mut self) -> Option<Frame> {
        let frame = self.port.receive(&self.health);
        if let (Some(tap), Some(frame)) = (&mut self.tap, &frame) {
            tap.take(frame);
        }
        frame
    }

    /// Hands the queued frames to the system, all at once. Call it after every round of sending, and at least once in 10 ms
    /// while frames may wait: it also drops what the other end does not accept in time. `now_ns` is monotonic.
    pub(crate) fn flush(&mut self, now_ns: u64) {
        self.port.flush(now_ns, &self.health);
    }
}

/// Time in ns on the host's monotonic clock.
pub(crate) fn now_ns() -> u64 {
    let Ok(now) = nix::time::clock_gettime(nix::time::ClockId::CLOCK_MONOTONIC) else {
        // The clock exists on every Linux.
        return 0;
    };
    now.tv_sec() as u64 * NS_PER_S + now.tv_nsec() as u64
}

/// Why a link could not be opened.
#[derive(Debug, thiserror::Error)]
pub(crate) enum LinkError {
    /// The address has no known scheme, or its part after the colon is missing or too much.
    #[error("link \"{address}\" has no known scheme: write one of {known}")]
    Scheme {
        /// The address as given.
        address: String,
        /// The sentences of the links that could be meant.
        known: String,
    },
    /// The port or interface does not exist, is in use, or may not be opened.
    #[error("link {address} cannot be opened: {reason}")]
    Open {
        /// The address as given.
        address: String,
        /// What is wrong and what to do.
        reason: String,
    },
}

/// Which end of the wire this is. It decides which identifiers are for this end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    /// The daemon, or another program that controls a rig.
    Host {
        /// Node of the rig at the far end.
        rig_node: u8,
    },
    /// The firmware (the mock rig).
    Rig {
        /// Node of this rig.
        node: u8,
    },
}

impl Side {
    /// Identifiers that are for this end.
    fn identifiers(self) -> [u16; 5] {
        match self {
            Side::Host { rig_node } => [
                cob::EMERGENCY,
                cob::SAMPLE,
                cob::STATUS,
                cob::CONFIG_ANSWER,
                cob::HEARTBEAT,
            ]
            .map(|function| cob::id(function, rig_node)),
            Side::Rig { node } => [
                cob::NMT,
                cob::id(cob::COMMAND, node),
                cob::id(cob::LEASE, node),
                cob::id(cob::REQUEST, node),
                cob::id(cob::CONFIG_REQUEST, node),
            ],
        }
    }
}

/// The backend of `address` and the part of the address after the colon; `None` if the address is not complete.
fn find(address: &str) -> Option<(&'static Backend, &str)> {
    let (scheme, place) = address.split_once(':')?;
    let backend = BACKENDS.iter().find(|backend| backend.scheme == scheme)?;
    (backend.place.is_empty() == place.is_empty()).then_some((backend, place))
}

/// True if `address` has a known scheme and a part after the colon where its scheme needs one.
pub(crate) fn is_address(address: &str) -> bool {
    find(address).is_some()
}

/// True if both ends of the link are in this process: the rig is a mock rig in memory.
pub(crate) fn is_in_process(address: &str) -> bool {
    matches!(find(address), Some((backend, _)) if matches!(backend.access, Access::InProcess))
}

/// The forms of all addresses for help texts: `mock:, can:INTERFACE or serial:PORT`.
pub(crate) fn address_forms() -> String {
    list_of_forms(BACKENDS.iter())
}

/// The forms of the addresses that [`open`] takes: `can:INTERFACE or serial:PORT`.
pub(crate) fn port_forms() -> String {
    list_of_forms(ports())
}

fn ports() -> impl Iterator<Item = &'static Backend> {
    BACKENDS
        .iter()
        .filter(|backend| matches!(backend.access, Access::Port(_)))
}

fn list_of_forms(backends: impl Iterator<Item = &'static Backend>) -> String {
    let forms: Vec<String> = backends.map(|b| format!("{}:{}", b.scheme, b.place)).collect();
    match forms.split_last() {
        Some((last, [])) => last.clone(),
        Some((last, others)) => format!("{} or {last}", others.join(", ")),
        None => String::new(),
    }
}

/// Opens the link over a port at `address`, such as `can:vcan0` or `serial:/dev/ttyUSB0`.
pub(crate) fn open(address: &str, side: Side) -> Result<Link, LinkError> {
    let Some((
        Backend {
            access: Access::Port(open),
            ..
        },
        place,
    )) = find(address)
    else {
        let known: Vec<&str> = ports().map(|backend| backend.what).collect();
        return Err(LinkError::Scheme {
            address: address.to_owned(),
            known: known.join("; "),
        });
    };
    open(place, side).map_err(|reason| LinkError::Open {
        address: address.to_owned(),
        reason,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_scheme_names_the_known_ones() {
        for address in ["vcan0", "usb:1", "", "can:", "mock:", "mock:x"] {
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
    fn an_address_in_process_has_nothing_after_the_colon() {
        assert!(is_in_process("mock:") && is_address("mock:"));
        assert!(!is_in_process("can:vcan0") && is_address("can:vcan0"));
        assert!(!is_in_process("mock:x") && !is_address("mock:x") && !is_address("can:"));
        assert_eq!(address_forms(), "mock:, can:INTERFACE or serial:PORT");
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
