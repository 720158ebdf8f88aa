//! Frames over a serial port or pseudo-terminal, in the packets of `protocol::serial_framing`. Never flushes, because
//! tcdrain would block. A read of zero bytes means that the port is unplugged.

use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio_serial::{ErrorKind, SerialPortBuilderExt};

use super::service::{self, Ends, Inlet, Lane};
use super::{Access, Backend, Link, LinkHealth, Side};
use crate::protocol::serial_framing::{self, Decoder, PACKET_MAX};

/// Serial ports and pseudo-terminals.
pub(super) const BACKEND: Backend = Backend {
    scheme: "serial",
    place: "PORT",
    what: "serial port, 921600 Bd unless the address says otherwise: serial:/dev/ttyUSB0?baud=460800",
    access: Access::Port(open),
};

/// Bits per second if the address gives none.
const DEFAULT_BAUD: u32 = 921_600;
/// A peer that does not accept a packet within this time has stopped reading.
const WRITE_DEADLINE: Duration = Duration::from_millis(20);

/// Opens `/dev/ttyUSB0` or `/dev/ttyUSB0?baud=460800` exclusively.
fn open(address: &str, side: Side) -> Result<Link, String> {
    let (path, baud) = parse(address)?;
    let runtime = service::runtime().map_err(|error| {
        format!("the runtime of its thread cannot be started ({error}): free memory and file handles")
    })?;
    let port = {
        let _inside = runtime.enter();
        tokio_serial::new(path, baud).exclusive(true).open_native_async()
    };
    let port = port.map_err(|error| advice(path, baud, &error))?;
    service::start("link-serial", runtime, move |ends| serve(port, ends, side))
        .map_err(|error| format!("its thread cannot be started ({error}): free memory and file handles"))
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

async fn serve<P: AsyncRead + AsyncWrite>(port: P, ends: Ends, side: Side) {
    let Ends { out, urgent, inlet } = ends;
    let health = Arc::clone(&inlet.health);
    let (reader, writer) = tokio::io::split(port);
    // Ends with the first of the two: the port is unplugged, or the link was dropped and all is sent.
    tokio::select! {
        () = receive(reader, inlet, side) => {}
        () = send(writer, out, urgent, &health) => {}
    }
}

async fn receive(mut port: impl AsyncRead + Unpin, mut inlet: Inlet, side: Side) {
    let own = side.identifiers();
    let mut decoder = Decoder::default();
    let mut bytes = [0; 512];
    loop {
        let count = match port.read(&mut bytes).await {
            // An unplugged adapter reads zero bytes for ever.
            Ok(0) => return,
            Ok(count) => count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(_) => return,
        };
        let errors_before = decoder.errors();
        let mut good = 0;
        for &byte in bytes.iter().take(count) {
            let Some(frame) = decoder.push(byte) else { continue };
            good += 1;
            if own.contains(&frame.id) {
                inlet.deliver(frame);
            }
        }
        let bad = decoder.errors() - errors_before;
        inlet.health.good_packets.fetch_add(good, Ordering::Relaxed);
        inlet.health.bad_packets.fetch_add(bad, Ordering::Relaxed);
        inlet.health.bus_errors.fetch_add(bad, Ordering::Relaxed);
    }
}

async fn send(mut port: impl AsyncWrite + Unpin, mut out: Lane, mut urgent: Lane, health: &LinkHealth) {
    let mut packet = [0; PACKET_MAX];
    // A leading zero ends what the other end has received so far: noise, or a packet that the deadline cut off.
    let mut resync = true;
    loop {
        let frame = tokio::select! {
            biased;
            Some(frame) = urgent.next() => frame,
            Some(frame) = out.next() => frame,
            else => return,
        };
        let len = serial_framing::encode(&frame, &mut packet);
        let write = async {
            if resync {
                port.write_all(&[0]).await?;
            }
            port.write_all(&packet[..len]).await
        };
        match tokio::time::timeout(WRITE_DEADLINE, write).await {
            Ok(Ok(())) => resync = false,
            Ok(Err(_)) => return,
            Err(_) => {
                resync = true;
                health
                    .send_failures
                    .fetch_add(1 + out.discard(), Ordering::Relaxed);
            }
        }
    }
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
