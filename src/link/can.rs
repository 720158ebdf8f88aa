//! Frames over a CAN interface of the kernel. The kernel's filters keep foreign frames from waking us, the abort has a
//! socket of its own, and frames that the kernel dropped are counted (`SO_RXQ_OVFL`). No automatic restart after
//! bus-off: the interface's `restart-ms` stays as the administrator set it, and that should be 0.

use std::io::{self, IoSliceMut};
use std::os::fd::AsRawFd;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use nix::libc;
use nix::sys::socket::{ControlMessageOwned, MsgFlags, getsockopt, recvmsg, setsockopt, sockopt};
use socketcan::{
    CanFilter, CanFrame, EmbeddedFrame, Frame as _, Socket, SocketOptions, StandardId, tokio::CanSocket,
};
use tokio::time::Instant;

use super::service::{self, Ends, Inlet, Lane};
use super::{Link, Side};
use crate::protocol::frame::Frame;

/// Receive buffer that we ask for: some 10 000 frames, where the kernel's usual 208 KiB hold 278.
const RECEIVE_BUFFER_BYTES: usize = 8 << 20;
/// A frame that the kernel's full queue refused is offered again until this long after.
const RETRY_FOR: Duration = Duration::from_millis(2);
/// Between two offers: a queue of 1 Mbit/s empties by a frame every 0.13 ms, timers have a millisecond.
const RETRY_EVERY: Duration = Duration::from_millis(1);
/// A socket whose interface vanished reports an error but never becomes readable, so silence is looked into this often.
/// (The bench itself notices silence within 20 ms, by its own timer.)
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// Frames read in a row before sending gets its turn.
const BATCH_FRAMES: usize = 256;
/// `struct can_frame`: identifier word, length, three bytes of padding, data.
const CAN_FRAME_BYTES: usize = 16;
/// Identifier word of an error frame.
const ERROR_FLAG: u32 = 0x2000_0000;
/// Extended identifier, remote request or error: no data frame of ours.
const ANY_FLAG: u32 = 0xE000_0000;

/// Opens the interface `name` (`can0`, `vcan0`).
pub(super) fn open(name: &str, side: Side) -> Result<Link, String> {
    let runtime = service::runtime().map_err(|error| format!("no runtime for its thread: {error}"))?;
    let granted = receive_buffer(name).map_err(|error| advice(name, &error))?;
    if granted < RECEIVE_BUFFER_BYTES {
        tracing::warn!(
            interface = name,
            "receive buffer is {granted} bytes: a long stall of this host loses frames; \
             `sysctl -w net.core.rmem_max={RECEIVE_BUFFER_BYTES}` allows more"
        );
    }
    let (socket, urgent) = {
        let _inside = runtime.enter();
        sockets(name, side).map_err(|error| advice(name, &error))?
    };
    service::start("link-can", runtime, move |ends| serve(socket, urgent, ends))
        .map_err(|error| format!("its thread cannot be started: {error}"))
}

fn advice(name: &str, error: &io::Error) -> String {
    match error.raw_os_error() {
        Some(libc::ENODEV | libc::ENXIO) => format!(
            "there is no interface {name}: `ip link` lists what there is; \
             a virtual one comes with `ip link add dev {name} type vcan && ip link set {name} up`, \
             a real one with `ip link set {name} up type can bitrate 1000000`"
        ),
        Some(libc::EAFNOSUPPORT | libc::EPROTONOSUPPORT) => {
            "this kernel has no CAN: `modprobe can-raw`, and `modprobe vcan` for a virtual interface"
                .to_owned()
        }
        Some(libc::EPERM | libc::EACCES) => {
            format!(
                "no permission to open CAN sockets: run as a user that may, or grant CAP_NET_RAW ({error})"
            )
        }
        Some(libc::EBUSY | libc::EADDRINUSE) => format!("interface {name} is taken by another program"),
        _ => format!("interface {name}: {error}"),
    }
}

/// Raises the receive buffer of a throw-away socket as [`sockets`] will raise the real one's, and returns the bytes
/// that the kernel granted (it reports twice what was asked for).
fn receive_buffer(name: &str) -> io::Result<usize> {
    let probe = socketcan::CanSocket::open(name)?;
    if setsockopt(&probe, sockopt::RcvBufForce, &RECEIVE_BUFFER_BYTES).is_err() {
        setsockopt(&probe, sockopt::RcvBuf, &RECEIVE_BUFFER_BYTES)?;
    }
    Ok(getsockopt(&probe, sockopt::RcvBuf)? / 2)
}

/// The socket for everything, and one that only sends the abort.
fn sockets(name: &str, side: Side) -> io::Result<(CanSocket, CanSocket)> {
    let socket = CanSocket::open(name)?;
    let wanted = RECEIVE_BUFFER_BYTES as libc::c_int;
    if socket
        .set_socket_option_int(libc::SOL_SOCKET, libc::SO_RCVBUFFORCE, wanted)
        .is_err()
    {
        socket.set_socket_option_int(libc::SOL_SOCKET, libc::SO_RCVBUF, wanted)?;
    }
    socket.set_socket_option_int(libc::SOL_SOCKET, libc::SO_RXQ_OVFL, 1)?;
    // The mask covers the flags too, so extended and remote frames with our number stay out.
    let filters = side
        .identifiers()
        .map(|id| CanFilter::new(u32::from(id), 0x7FF | 0xC000_0000));
    socket.set_filters(&filters)?;
    socket.set_error_filter_accept_all()?;
    let urgent = CanSocket::open(name)?;
    urgent.set_filter_drop_all()?;
    Ok((socket, urgent))
}

async fn serve(socket: CanSocket, urgent_socket: CanSocket, ends: Ends) {
    let Ends { out, urgent, inlet } = ends;
    let health = std::sync::Arc::clone(&inlet.health);
    let sending = async {
        let failures = &health.send_failures;
        // Both go on until the link was dropped, or one finds the interface gone.
        let _ = tokio::try_join!(
            send(&socket, out, failures),
            send(&urgent_socket, urgent, failures)
        );
    };
    // The first of the two to end takes the other with it.
    tokio::select! {
        () = receive(&socket, inlet) => {}
        () = sending => {}
    }
}

/// Sends what the lane brings until the link was dropped; an error means that the interface is gone.
async fn send(socket: &CanSocket, mut lane: Lane, failures: &AtomicU64) -> io::Result<()> {
    while let Some(frame) = lane.next().await {
        let Some(frame) = StandardId::new(frame.id).and_then(|id| CanFrame::new(id, frame.bytes())) else {
            failures.fetch_add(1, Ordering::Relaxed);
            continue;
        };
        if let Err(error) = offer(socket, frame).await {
            failures.fetch_add(1 + lane.discard(), Ordering::Relaxed);
            if is_gone(&error) {
                return Err(error);
            }
        }
    }
    Ok(())
}

/// Writes `frame`, again and again while the queue is full, for [`RETRY_FOR`]. A full queue still polls as writable, so
/// only a timer can pace this.
async fn offer(socket: &CanSocket, frame: CanFrame) -> io::Result<()> {
    let mut until = None;
    loop {
        let error = match socket.try_write_frame(frame) {
            Ok(()) => return Ok(()),
            Err(error) => error,
        };
        let is_full =
            error.raw_os_error() == Some(libc::ENOBUFS) || error.kind() == io::ErrorKind::WouldBlock;
        let now = Instant::now();
        if !is_full || now >= *until.get_or_insert(now + RETRY_FOR) {
            return Err(error);
        }
        tokio::time::sleep(RETRY_EVERY).await;
    }
}

/// True where the interface went down or away.
fn is_gone(error: &io::Error) -> bool {
    matches!(
        error.raw_os_error(),
        Some(libc::ENODEV | libc::ENXIO | libc::ENETDOWN)
    )
}

async fn receive(socket: &CanSocket, mut inlet: Inlet) {
    let mut dropped = 0;
    loop {
        match tokio::time::timeout(LOOK_EVERY, socket.read_frame()).await {
            Ok(Ok(frame)) => take(frame.id_word(), frame.data(), &mut inlet),
            Ok(Err(error)) if is_gone(&error) => return,
            // Anything else (such as a frame of the wrong size) concerns one frame.
            Ok(Err(_)) => {
                inlet.health.bus_errors.fetch_add(1, Ordering::Relaxed);
            }
            // Silence: the drain asks the socket itself.
            Err(_) => {}
        }
        if drain(socket, &mut inlet, &mut dropped).is_err_and(|error| is_gone(&error)) {
            return;
        }
    }
}

/// Reads what else waits, up to a batch, so that a flood leaves time to send. The crate's reader cannot see the kernel's count of frames that it dropped; this one can,
/// and a queue that overflowed is never empty after one read.
fn drain(socket: &CanSocket, inlet: &mut Inlet, dropped_before: &mut u32) -> io::Result<()> {
    let mut control = nix::cmsg_space!(u32);
    for _ in 0..BATCH_FRAMES {
        let mut bytes = [0; CAN_FRAME_BYTES];
        let mut parts = [IoSliceMut::new(&mut bytes)];
        let message = match recvmsg::<()>(
            socket.as_raw_fd(),
            &mut parts,
            Some(&mut control),
            MsgFlags::MSG_DONTWAIT,
        ) {
            Ok(message) => message,
            Err(nix::Error::EAGAIN) => return Ok(()),
            Err(nix::Error::EINTR) => continue,
            Err(error) => return Err(error.into()),
        };
        for part in message.cmsgs()? {
            if let ControlMessageOwned::RxqOvfl(dropped) = part {
                // The count is the socket's total and wraps.
                let more = dropped.wrapping_sub(*dropped_before);
                *dropped_before = dropped;
                inlet
                    .health
                    .overflows
                    .fetch_add(u64::from(more), Ordering::Relaxed);
            }
        }
        let whole = message.bytes == CAN_FRAME_BYTES;
        let [a, b, c, d, len, _, _, _, data @ ..] = bytes;
        match data.get(..usize::from(len)) {
            Some(data) if whole => take(u32::from_ne_bytes([a, b, c, d]), data, inlet),
            _ => {
                inlet.health.bus_errors.fetch_add(1, Ordering::Relaxed);
            }
        }
    }
    Ok(())
}

/// Delivers a data frame, or counts an error frame. `word` is the identifier with its flags.
fn take(word: u32, data: &[u8], inlet: &mut Inlet) {
    if word & ANY_FLAG == 0 {
        inlet.deliver(Frame::new((word & 0x7FF) as u16, data));
    } else if word & ERROR_FLAG != 0 {
        report(word, data, inlet);
    } else {
        // Extended or remote: our filters should have kept it out.
        inlet.health.bus_errors.fetch_add(1, Ordering::Relaxed);
    }
}

/// Counts an error frame (linux/can/error.h): its class stands in the identifier, the controller's state in byte 1.
fn report(class: u32, data: &[u8], inlet: &Inlet) {
    const LOST_ARBITRATION: u32 = 0x02;
    const CONTROLLER: u32 = 0x04;
    const BUS_OFF: u32 = 0x40;
    const RESTARTED: u32 = 0x100;
    const COUNTERS: u32 = 0x200;
    const PASSIVE: u8 = 0x30;
    const ACTIVE: u8 = 0x40;
    let health = &inlet.health;
    // Losing arbitration is how a busy bus works, a restart and the counters are news but no fault.
    if class & !(ERROR_FLAG | LOST_ARBITRATION | RESTARTED | COUNTERS) != 0 {
        health.bus_errors.fetch_add(1, Ordering::Relaxed);
    }
    if class & BUS_OFF != 0 {
        health.bus_off.fetch_add(1, Ordering::Relaxed);
    }
    let state = data.get(1).copied().unwrap_or(0);
    if class & CONTROLLER != 0 && state & PASSIVE != 0 {
        health.error_passive.store(true, Ordering::Relaxed);
    } else if class & CONTROLLER != 0 && state & ACTIVE != 0 || class & RESTARTED != 0 {
        health.error_passive.store(false, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn inlet() -> (Inlet, rtrb::Consumer<super::super::Arrival>) {
        Inlet::for_tests()
    }

    #[test]
    fn data_frames_pass_and_the_others_are_counted() {
        let (mut inlet, mut ring) = inlet();
        take(0x185, &[1, 2], &mut inlet);
        assert_eq!(
            ring.pop().map(|arrival| arrival.frame),
            Ok(Frame::new(0x185, &[1, 2]))
        );
        take(0x8000_0185, &[1, 2], &mut inlet);
        take(0x4000_0185, &[], &mut inlet);
        assert!(ring.pop().is_err());
        assert_eq!(inlet.health.bus_errors.load(Ordering::Relaxed), 2);
    }

    #[test]
    fn error_frames_tell_bus_off_and_passive() {
        let (mut inlet, _ring) = inlet();
        take(ERROR_FLAG | 0x204, &[0, 0x20, 0, 0, 0, 0, 130, 0], &mut inlet);
        assert!(inlet.health.error_passive.load(Ordering::Relaxed));
        take(ERROR_FLAG | 0x40, &[0; 8], &mut inlet);
        assert_eq!(inlet.health.bus_off.load(Ordering::Relaxed), 1);
        assert_eq!(inlet.health.bus_errors.load(Ordering::Relaxed), 2);
        take(ERROR_FLAG | 0x04, &[0, 0x40, 0, 0, 0, 0, 0, 0], &mut inlet);
        assert!(!inlet.health.error_passive.load(Ordering::Relaxed));
        take(ERROR_FLAG | 0x02, &[11, 0, 0, 0, 0, 0, 0, 0], &mut inlet);
        assert_eq!(
            inlet.health.bus_errors.load(Ordering::Relaxed),
            3,
            "lost arbitration is no error"
        );
    }

    #[test]
    fn what_cannot_be_opened_comes_with_advice() {
        let text = |errno| advice("vcan0", &io::Error::from_raw_os_error(errno));
        assert!(text(libc::ENODEV).contains("ip link add dev vcan0 type vcan"));
        assert!(text(libc::EAFNOSUPPORT).contains("modprobe can-raw"));
        assert!(text(libc::EPERM).contains("CAP_NET_RAW"));
    }
}
