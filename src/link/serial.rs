//! Frames over a serial port or pseudo-terminal, in the packets of `protocol::serial_framing`. The thread that owns the link
//! reads and writes the port itself, without blocking: bytes that came while it did not run wait in the kernel, as on CAN.
//!
//! Never flushes the port, because tcdrain would block. A read of zero bytes means that the port is unplugged.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use nix::fcntl::OFlag;
use tokio_serial::{ErrorKind, SerialPort};

use super::serial_queue::PacketQueue;
use super::{Access, Backend, Link, LinkHealth, Port, Side};
use crate::protocol::frame::Frame;
use crate::protocol::serial_framing::Decoder;

/// Serial ports and pseudo-terminals.
pub(super) const BACKEND: Backend = Backend {
    scheme: "serial",
    place: "PORT",
    what: "serial port, 921600 Bd unless the address says otherwise: serial:/dev/ttyUSB0?baud=460800",
    access: Access::Port(open),
};

/// Bits per second if the address gives none.
const DEFAULT_BAUD: u32 = 921_600;
/// Bytes of one read: as many as the kernel's terminal buffer holds.
const READ_BYTES: usize = 4096;
/// Most reads until `receive` says that there is nothing more: 64 KiB, far more than a line carries in a poll. A
/// pseudo-terminal that is flooded must not keep control in a loop.
const READS_IN_A_ROW: u32 = 16;

/// Opens `/dev/ttyUSB0` or `/dev/ttyUSB0?baud=460800` exclusively.
fn open(address: &str, side: Side) -> Result<Link, String> {
    let (path, baud) = parse(address)?;
    let line = Line::open(path, baud).map_err(|error| advice(path, baud, &error))?;
    let port = PacketPort {
        line: Some(line),
        own: side.identifiers(),
        decoder: Decoder::default(),
        input: [0; READ_BYTES],
        unread: 0..0,
        reads: 0,
        queue: PacketQueue::new(),
    };
    Ok(Link::over(port, Arc::new(LinkHealth::opened())))
}

fn parse(address: &str) -> Result<(&str, u32), String> {
    let Some((path, options)) = address.split_once('?') else {
        return Ok((address, DEFAULT_BAUD));
    };
    let baud = options
        .strip_prefix("baud=")
        .and_then(|baud| baud.parse().ok())
        .filter(|&baud| baud > 0);
    let baud =
        baud.ok_or_else(|| format!("\"{options}\" is not an option of a serial port: write ?baud=460800"))?;
    Ok((path, baud))
}

fn advice(path: &str, baud: u32, error: &tokio_serial::Error) -> String {
    match error.kind() {
        ErrorKind::Io(io::ErrorKind::NotFound) => {
            format!(
                "there is no {path}: check that the adapter is plugged in; `ls -l /dev/serial/by-id` lists the ports"
            )
        }
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => {
            format!(
                "no permission for {path}: add yourself to its group (see `ls -l {path}`) and log in again"
            )
        }
        ErrorKind::NoDevice => format!(
            "{path} is taken by another program or not a serial port ({error}): find the program with `fuser -v {path}` and end it"
        ),
        _ => format!("{path} fails at {baud} Bd ({error}): check the adapter and the baud rate"),
    }
}

/// An open port.
struct Line {
    /// For reading and writing without blocking.
    file: File,
    /// Holds the port's exclusive lock and its settings. It blocks, so nothing is read or written through it.
    _lock: Box<dyn SerialPort>,
}

impl Line {
    fn open(path: &str, baud: u32) -> Result<Line, tokio_serial::Error> {
        // Before the lock, which would refuse a second opening of the port.
        let file = File::options()
            .read(true)
            .write(true)
            .custom_flags((OFlag::O_NOCTTY | OFlag::O_NONBLOCK).bits())
            .open(path)
            .map_err(|error| match error.raw_os_error() {
                Some(nix::libc::EBUSY) => tokio_serial::Error::new(ErrorKind::NoDevice, error.to_string()),
                _ => error.into(),
            })?;
        let _lock = tokio_serial::new(path, baud).exclusive(true).open()?;
        Ok(Line { file, _lock })
    }
}

/// A port and the packets on their way through it.
struct PacketPort {
    /// `None` once the port is unplugged.
    line: Option<Line>,
    /// Identifiers that are for this end.
    own: [u16; 5],
    decoder: Decoder,
    /// Bytes of the newest read, and those of them that are not decoded yet.
    input: [u8; READ_BYTES],
    unread: std::ops::Range<usize>,
    /// Reads since `receive` last said that there is nothing more.
    reads: u32,
    queue: PacketQueue,
}

impl Port for PacketPort {
    fn send(&mut self, frame: Frame, urgent: bool, health: &LinkHealth) -> bool {
        let queued = self.line.is_some() && self.queue.push(&frame, urgent);
        if !queued {
            health.send_failures.fetch_add(1, Ordering::Relaxed);
        }
        queued
    }

    fn receive(&mut self, health: &LinkHealth) -> Option<Frame> {
        loop {
            if let Some(frame) = self.decode(health) {
                return Some(frame);
            }
            if !self.read(health) {
                self.reads = 0;
                return None;
            }
        }
    }

    /// One write for all packets. What the port does not accept stays for the next call, for 20 ms.
    fn flush(&mut self, now_ns: u64, health: &LinkHealth) {
        let Some(line) = &mut self.line else { return };
        if !self.queue.has_packets() {
            return;
        }
        match line.file.write(self.queue.bytes()) {
            Ok(count) => self.queue.accept(count, now_ns),
            Err(error) if is_later(&error) => self.queue.accept(0, now_ns),
            Err(_) => return self.close(health),
        }
        if self.queue.is_overdue(now_ns) {
            let dropped = self.queue.drop_ordinary();
            health.send_failures.fetch_add(dropped, Ordering::Relaxed);
        }
    }
}

impl PacketPort {
    /// The next frame for this end among the bytes that were read.
    fn decode(&mut self, health: &LinkHealth) -> Option<Frame> {
        for at in self.unread.by_ref() {
            let errors_before = self.decoder.errors();
            let frame = self.input.get(at).and_then(|&byte| self.decoder.push(byte));
            if self.decoder.errors() > errors_before {
                health.bad_packets.fetch_add(1, Ordering::Relaxed);
                health.bus_errors.fetch_add(1, Ordering::Relaxed);
            }
            if let Some(frame) = frame {
                health.good_packets.fetch_add(1, Ordering::Relaxed);
                if self.own.contains(&frame.id) {
                    return Some(frame);
                }
            }
        }
        None
    }

    /// Reads what waits in the kernel. False if nothing does, or if it is the next poll's turn.
    fn read(&mut self, health: &LinkHealth) -> bool {
        // After a small part of the buffer nothing more waits: the read that would only say so is left out.
        let drained = self.reads > 0 && self.unread.end < READ_BYTES / 2;
        let Some(line) = &mut self.line else { return false };
        if drained || self.reads >= READS_IN_A_ROW {
            return false;
        }
        self.reads += 1;
        match line.file.read(&mut self.input) {
            // An unplugged adapter reads zero bytes for ever.
            Ok(0) => {
                self.close(health);
                false
            }
            Ok(count) => {
                self.unread = 0..count;
                true
            }
            Err(error) if is_later(&error) => false,
            Err(_) => {
                self.close(health);
                false
            }
        }
    }

    /// Frees the port. From then on there is nothing to read and no call of the system.
    fn close(&mut self, health: &LinkHealth) {
        self.line = None;
        health.open.store(false, Ordering::Relaxed);
    }
}

/// True if the port is sound and only has nothing to read or no room to write.
fn is_later(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_with_and_without_a_bit_rate() {
        assert_eq!(parse("/dev/ttyUSB0"), Ok(("/dev/ttyUSB0", 921_600)));
        assert_eq!(parse("/dev/ttyUSB0?baud=460800"), Ok(("/dev/ttyUSB0", 460_800)));
        for wrong in [
            "/dev/ttyUSB0?baud=",
            "/dev/ttyUSB0?baud=0",
            "/dev/ttyUSB0?rate=1",
            "/dev/ttyUSB0?",
        ] {
            assert!(
                parse(wrong).is_err_and(|advice| advice.contains("?baud=460800")),
                "{wrong}"
            );
        }
    }

    /// The daemon opens a lost link again from a task.
    #[test]
    fn a_missing_port_is_named_inside_a_runtime_too() {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .build()
            .expect("a runtime");
        runtime.block_on(async {
            assert!(open("/dev/no-such-port", Side::Rig { node: 1 }).is_err());
        });
    }

    #[test]
    fn a_missing_port_is_named_with_advice() {
        let error = open("/dev/no-such-port", Side::Rig { node: 1 })
            .err()
            .expect("no such port");
        assert!(
            error.contains("/dev/no-such-port") && error.contains("plugged in"),
            "{error}"
        );
    }
}
