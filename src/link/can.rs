//! Frames over a CAN interface of the kernel (SocketCAN). The thread that owns the link reads and writes the sockets
//! itself; they never block.
//!
//! The kernel's filters drop foreign frames, its queue holds the frames between two reads, the abort has a socket of its
//! own, and frames that the kernel dropped are counted (`SO_RXQ_OVFL`). There is no automatic restart after bus-off: the
//! interface's `restart-ms` stays as the administrator set it, which should be 0.

use std::io::{self, IoSliceMut};
use std::os::fd::AsRawFd;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use nix::libc;
use nix::sys::socket::{ControlMessageOwned, MsgFlags, getsockopt, recvmsg, setsockopt, sockopt};
use socketcan::{CanFilter, CanFrame, CanSocket, EmbeddedFrame, Socket, SocketOptions, StandardId};

use super::{Access, Backend, Link, LinkHealth, Port, Side};
use crate::protocol::cob;
use crate::protocol::frame::Frame;

/// CAN interfaces of the kernel, real or virtual.
pub(super) const BACKEND: Backend = Backend {
    scheme: "can",
    place: "INTERFACE",
    what: "CAN interface of the kernel (SocketCAN): can:can0",
    access: Access::Port(open),
};

/// Requested receive buffer in bytes: some 20 000 frames. The kernel's usual 208 KiB hold 278.
pub(crate) const RECEIVE_BUFFER_BYTES: usize = 8 << 20;
/// `struct can_frame`: identifier word, length, three bytes of padding, data.
const CAN_FRAME_BYTES: usize = 16;
/// Identifier word of an error frame.
const ERROR_FLAG: u32 = 0x2000_0000;
/// Flags of extended identifiers, remote requests and error frames. Data frames of the protocol have none of them.
const ANY_FLAG: u32 = 0xE000_0000;

/// Opens the interface `name` (`can0`, `vcan0`).
fn open(name: &str, side: Side) -> Result<Link, String> {
    let with_advice = |error: io::Error| advice(name, &error);
    let socket = CanSocket::open(name).map_err(with_advice)?;
    let urgent = CanSocket::open(name).map_err(with_advice)?;
    let granted = prepare(&socket, &urgent, side).map_err(with_advice)?;
    if granted < RECEIVE_BUFFER_BYTES {
        tracing::warn!(
            interface = name,
            "the receive buffer has {granted} bytes: a long stall of this host loses frames; \
             run `sysctl -w net.core.rmem_max={RECEIVE_BUFFER_BYTES}` to allow more"
        );
    }
    let port = CanPort {
        sockets: Some(Sockets { socket, urgent }),
        dropped: 0,
        control: nix::cmsg_space!(u32),
    };
    Ok(Link::over(port, Arc::new(LinkHealth::opened())))
}

fn advice(name: &str, error: &io::Error) -> String {
    match error.raw_os_error() {
        Some(libc::ENODEV | libc::ENXIO) => format!(
            "there is no interface {name}: list the interfaces with `ip link`; \
             make a virtual one with `ip link add dev {name} type vcan && ip link set {name} up`, \
             or set a real one up with `ip link set {name} up type can bitrate 1000000`"
        ),
        Some(libc::EAFNOSUPPORT | libc::EPROTONOSUPPORT) => {
            "this kernel has no CAN: run `modprobe can-raw`, and `modprobe vcan` for a virtual interface"
                .to_owned()
        }
        Some(libc::EPERM | libc::EACCES) => {
            format!(
                "no permission to open CAN sockets ({error}): grant CAP_NET_RAW, or run as a user that has it"
            )
        }
        Some(libc::EBUSY | libc::EADDRINUSE) => {
            format!("interface {name} is in use: end the other program that uses it")
        }
        _ => format!("interface {name} fails ({error}): check it with `ip -details link show {name}`"),
    }
}

/// Sets filters, error reports, drop count and buffer. Returns the bytes that the kernel granted for receiving; the kernel
/// reports twice that number.
fn prepare(socket: &CanSocket, urgent: &CanSocket, side: Side) -> io::Result<usize> {
    if setsockopt(socket, sockopt::RcvBufForce, &RECEIVE_BUFFER_BYTES).is_err() {
        setsockopt(socket, sockopt::RcvBuf, &RECEIVE_BUFFER_BYTES)?;
    }
    socket.set_socket_option_int(libc::SOL_SOCKET, libc::SO_RXQ_OVFL, 1)?;
    // The mask covers the flags too, so extended and remote frames with the same number are dropped.
    let filters = side
        .identifiers()
        .map(|id| CanFilter::new(u32::from(id), u32::from(cob::ID_MAX) | 0xC000_0000));
    socket.set_filters(&filters)?;
    socket.set_error_filter_accept_all()?;
    socket.set_nonblocking(true)?;
    urgent.set_filter_drop_all()?;
    urgent.set_nonblocking(true)?;
    Ok(getsockopt(socket, sockopt::RcvBuf)? / 2)
}

/// The sockets of one interface.
struct Sockets {
    socket: CanSocket,
    /// Sends the abort, so that it does not wait in the other socket's queue.
    urgent: CanSocket,
}

/// Sockets and counters of one interface.
struct CanPort {
    /// `None` once the interface is gone: from then on there is no call of the system.
    sockets: Option<Sockets>,
    /// The kernel's count of dropped frames at the last read.
    dropped: u32,
    /// Space for that count, used again in every read, so that reading does not allocate.
    control: Vec<u8>,
}

impl Port for CanPort {
    /// A frame is refused if the kernel's queue is full (the caller tries again at its next turn) or the interface was removed.
    fn send(&mut self, frame: Frame, urgent: bool, health: &LinkHealth) -> bool {
        let can_frame = StandardId::new(frame.id).and_then(|id| CanFrame::new(id, frame.bytes()));
        let written = match (&self.sockets, can_frame) {
            (Some(sockets), Some(frame)) if urgent => sockets.urgent.write_frame(&frame),
            (Some(sockets), Some(frame)) => sockets.socket.write_frame(&frame),
            _ => Err(io::ErrorKind::InvalidInput.into()),
        };
        if let Err(error) = &written {
            health.send_failures.fetch_add(1, Ordering::Relaxed);
            self.close_if_gone(error, health);
        }
        written.is_ok()
    }

    fn receive(&mut self, health: &LinkHealth) -> Option<Frame> {
        loop {
            let socket = &self.sockets.as_ref()?.socket;
            match read(socket, &mut self.control, &mut self.dropped, health) {
                Ok(Some(frame)) => return Some(frame),
                Ok(None) => {}
                Err(nix::Error::EAGAIN) => return None,
                Err(nix::Error::EINTR) => {}
                Err(error) => {
                    health.bus_errors.fetch_add(1, Ordering::Relaxed);
                    self.close_if_gone(&error.into(), health);
                    return None;
                }
            }
        }
    }
}

impl CanPort {
    /// Closes the link if the interface went down or was removed.
    fn close_if_gone(&mut self, error: &io::Error, health: &LinkHealth) {
        if matches!(
            error.raw_os_error(),
            Some(libc::ENODEV | libc::ENXIO | libc::ENETDOWN)
        ) {
            self.sockets = None;
            health.open.store(false, Ordering::Relaxed);
        }
    }
}

/// Reads one frame; `None` if it was an error frame or no data frame of the protocol. Not the reader of the `socketcan` crate,
/// because that one does not return the kernel's count of dropped frames. `dropped` is that count at the last read.
fn read(
    socket: &CanSocket,
    control: &mut [u8],
    dropped: &mut u32,
    health: &LinkHealth,
) -> Result<Option<Frame>, nix::Error> {
    let mut bytes = [0; CAN_FRAME_BYTES];
    let mut parts = [IoSliceMut::new(&mut bytes)];
    let message = recvmsg::<()>(
        socket.as_raw_fd(),
        &mut parts,
        Some(control),
        MsgFlags::MSG_DONTWAIT,
    )?;
    for part in message.cmsgs()? {
        if let ControlMessageOwned::RxqOvfl(total) = part {
            // The count is the total of the socket and wraps around.
            let more = total.wrapping_sub(*dropped);
            *dropped = total;
            health.overflows.fetch_add(u64::from(more), Ordering::Relaxed);
        }
    }
    let whole = message.bytes == CAN_FRAME_BYTES;
    Ok(frame_of(bytes, whole, health))
}

/// The data frame of a `struct can_frame`, or `None` after what else it is was counted. `whole`: all of it was read.
pub(crate) fn frame_of(bytes: [u8; CAN_FRAME_BYTES], whole: bool, health: &LinkHealth) -> Option<Frame> {
    let [a, b, c, d, len, _, _, _, data @ ..] = bytes;
    match data.get(..usize::from(len)) {
        Some(data) if whole => data_frame(u32::from_ne_bytes([a, b, c, d]), data, health),
        _ => {
            health.bus_errors.fetch_add(1, Ordering::Relaxed);
            None
        }
    }
}

/// The data frame, or `None` after an error frame was counted. `word` is the identifier with its flags.
fn data_frame(word: u32, data: &[u8], health: &LinkHealth) -> Option<Frame> {
    if word & ANY_FLAG == 0 {
        return Some(Frame::new(word as u16, data));
    }
    if word & ERROR_FLAG != 0 {
        count_error(word, data, health);
    } else {
        // An extended or remote frame: the filters should have dropped it.
        health.bus_errors.fetch_add(1, Ordering::Relaxed);
    }
    None
}

/// Counts an error frame (linux/can/error.h): the class is in the identifier, the controller's state in byte 1, its error
/// counters in bytes 6 and 7.
fn count_error(class: u32, data: &[u8], health: &LinkHealth) {
    const LOST_ARBITRATION: u32 = 0x02;
    const CONTROLLER: u32 = 0x04;
    const BUS_OFF: u32 = 0x40;
    const RESTARTED: u32 = 0x100;
    const COUNTERS: u32 = 0x200;
    const RECEIVE_OVERFLOW: u8 = 0x01;
    // Lost arbitration is normal on a busy bus; a restart and the error counters are reports, not faults.
    if class & !(ERROR_FLAG | LOST_ARBITRATION | RESTARTED | COUNTERS) != 0 {
        health.bus_errors.fetch_add(1, Ordering::Relaxed);
    }
    if class & BUS_OFF != 0 {
        health.bus_off.fetch_add(1, Ordering::Relaxed);
    }
    let byte = |at: usize| data.get(at).copied().unwrap_or(0);
    let report = if class & CONTROLLER != 0 { byte(1) } else { 0 };
    if report & RECEIVE_OVERFLOW != 0 {
        health.overflows.fetch_add(1, Ordering::Relaxed);
    }
    let counters = (class & COUNTERS != 0).then(|| (byte(6), byte(7)));
    if class & RESTARTED != 0 {
        health.error_passive.store(false, Ordering::Relaxed);
    } else if let Some(passive) = is_passive(report, counters) {
        health.error_passive.store(passive, Ordering::Relaxed);
    }
}

/// Whether a controller is error passive by its report of a state (warning, passive or active), else by its error counters
/// of sending and receiving; `None` if the frame tells neither.
fn is_passive(report: u8, counters: Option<(u8, u8)>) -> Option<bool> {
    const PASSIVE: u8 = 0x30;
    const ANY_STATE: u8 = 0x7C;
    const PASSIVE_FROM: u8 = 128;
    if report & ANY_STATE != 0 {
        return Some(report & PASSIVE != 0);
    }
    counters.map(|(sending, receiving)| sending.max(receiving) >= PASSIVE_FROM)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_frames_pass_and_the_others_are_counted() {
        let health = LinkHealth::opened();
        assert_eq!(
            data_frame(0x185, &[1, 2], &health),
            Some(Frame::new(0x185, &[1, 2]))
        );
        assert_eq!(data_frame(0x8000_0185, &[1, 2], &health), None);
        assert_eq!(data_frame(0x4000_0185, &[], &health), None);
        assert_eq!(health.bus_errors.load(Ordering::Relaxed), 2);
    }

    #[test]
    fn error_frames_set_bus_off_and_passive() {
        let health = LinkHealth::opened();
        data_frame(ERROR_FLAG | 0x204, &[0, 0x20, 0, 0, 0, 0, 130, 0], &health);
        assert!(health.error_passive.load(Ordering::Relaxed));
        data_frame(ERROR_FLAG | 0x40, &[0; 8], &health);
        assert_eq!(health.bus_off.load(Ordering::Relaxed), 1);
        assert_eq!(health.bus_errors.load(Ordering::Relaxed), 2);
        data_frame(ERROR_FLAG | 0x04, &[0, 0x40, 0, 0, 0, 0, 0, 0], &health);
        assert!(!health.error_passive.load(Ordering::Relaxed));
        data_frame(ERROR_FLAG | 0x02, &[11, 0, 0, 0, 0, 0, 0, 0], &health);
        assert_eq!(
            health.bus_errors.load(Ordering::Relaxed),
            3,
            "lost arbitration is no error"
        );
    }

    /// linux/can/error.h, `can_change_state`: a controller that recovers reports "warning" before "active".
    #[test]
    fn error_passive_ends_with_the_report_of_any_better_state() {
        let health = LinkHealth::opened();
        let passive = || health.error_passive.load(Ordering::Relaxed);
        data_frame(ERROR_FLAG | 0x04, &[0, 0x10, 0, 0, 0, 0, 0, 0], &health);
        assert!(passive());
        data_frame(ERROR_FLAG | 0x04, &[0, 0x01, 0, 0, 0, 0, 0, 0], &health);
        assert!(passive(), "an overflow says nothing about the state");
        assert_eq!(health.overflows.load(Ordering::Relaxed), 1);
        data_frame(ERROR_FLAG | 0x04, &[0, 0x08, 0, 0, 0, 0, 0, 0], &health);
        assert!(!passive(), "warning is better than passive");
    }

    /// Some drivers report only the error counters (bytes 6 and 7: of sending, of receiving); passive is 128 and more.
    #[test]
    fn error_counters_tell_passive_where_the_driver_names_no_state() {
        let health = LinkHealth::opened();
        let passive = || health.error_passive.load(Ordering::Relaxed);
        data_frame(ERROR_FLAG | 0x208, &[0, 0, 0, 0, 0, 0, 128, 3], &health);
        assert!(passive());
        data_frame(ERROR_FLAG | 0x208, &[0, 0, 0, 0, 0, 0, 120, 3], &health);
        assert!(!passive());
    }

    #[test]
    fn every_open_error_says_what_to_do() {
        let text = |errno| advice("vcan0", &io::Error::from_raw_os_error(errno));
        assert!(text(libc::ENODEV).contains("ip link add dev vcan0 type vcan"));
        assert!(text(libc::EAFNOSUPPORT).contains("modprobe can-raw"));
        assert!(text(libc::EPERM).contains("CAP_NET_RAW"));
    }
}
