//! The serial link over real pseudo-terminals: exchange, an unplugged port, a peer that stops reading, a taken port,
//! noise. What frames mean is tested in `protocol`.

use std::io::{Read, Write};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::support::wire::Terminal;
use super::support::{self, Daemon, config};
use super::trust::allocations;
use crate::link::{self, Link, Side};
use crate::protocol::frame::Frame;
use crate::protocol::message::{FromRig, LeaseMessage, NmtCommand, SampleMessage, ToRig, next_counter};
use crate::protocol::serial_framing::{Decoder, PACKET_MAX, encode};

const NODE: u8 = 5;
/// Far beyond what a loaded machine needs; only a lost frame waits this long.
const PATIENCE: Duration = Duration::from_secs(120);

fn address(terminal: &Terminal) -> String {
    format!("serial:{}", terminal.port)
}

fn open(address: &str, side: Side) -> Link {
    link::open(address, side).unwrap_or_else(|error| panic!("{error}"))
}

fn host(terminal: &Terminal) -> Link {
    open(&address(terminal), Side::Host { rig_node: NODE })
}

fn wait_until(what: &str, mut done: impl FnMut() -> bool) {
    let until = Instant::now() + PATIENCE;
    while !done() {
        assert!(Instant::now() < until, "waited in vain: {what}");
        std::thread::sleep(Duration::from_micros(200));
    }
}

fn next(link: &mut Link) -> Frame {
    let mut frame = None;
    wait_until("a frame", || {
        frame = link.receive();
        frame.is_some()
    });
    frame.expect("waited for")
}

fn sample(tick: u16) -> FromRig {
    FromRig::Sample(SampleMessage {
        counter: (tick % 15) as u8,
        tick,
        force_counts: i32::from(tick),
        displacement_counts: -7,
    })
}

fn packet(message: FromRig) -> Vec<u8> {
    let mut packet = [0; PACKET_MAX];
    let len = encode(&message.encode(NODE), &mut packet);
    packet[..len].to_vec()
}

/// Copies both ways between two terminals until one is closed, as a cable does.
fn cable(one: &Terminal, other: &Terminal) {
    for (from, to) in [(one, other), (other, one)] {
        let mut from = from.master.try_clone().expect("a copy");
        let mut to = to.master.try_clone().expect("a copy");
        std::thread::spawn(move || std::io::copy(&mut from, &mut to));
    }
}

#[test]
fn two_links_over_a_cable() {
    let (here, there) = (Terminal::new(), Terminal::new());
    cable(&here, &there);
    let mut host = host(&here);
    let mut rig = open(
        &format!("{}?baud=460800", address(&there)),
        Side::Rig { node: NODE },
    );
    for tick in 0..2000 {
        assert!(rig.send(sample(tick).encode(NODE)));
        let lease = ToRig::Lease(LeaseMessage {
            counter: (tick % 15) as u8,
            session: 1,
            control_tick: tick,
        });
        assert!(host.send(lease.encode(NODE)));
        rig.flush(link::now_ns());
        host.flush(link::now_ns());
        assert_eq!(FromRig::decode(&next(&mut host), NODE), Ok(sample(tick)));
        assert_eq!(ToRig::decode(&next(&mut rig), NODE), Ok(lease));
    }
    let stop = ToRig::Nmt {
        command: NmtCommand::Stop,
        node: 0,
    };
    assert!(host.send_urgent(stop.encode(NODE)));
    host.flush(link::now_ns());
    assert_eq!(ToRig::decode(&next(&mut rig), NODE), Ok(stop));
    for health in [&host.health, &rig.health] {
        assert_eq!(health.bus_errors.load(Ordering::Relaxed), 0);
        assert_eq!(health.send_failures.load(Ordering::Relaxed), 0);
    }
}

#[test]
fn noise_is_counted_and_the_frames_after_it_arrive() {
    let mut terminal = Terminal::new();
    let mut host = host(&terminal);
    // The tail of a packet that began before us is no error.
    terminal
        .master
        .write_all(&packet(sample(0))[4..])
        .expect("written");
    terminal.master.write_all(&packet(sample(1))).expect("written");
    assert_eq!(FromRig::decode(&next(&mut host), NODE), Ok(sample(1)));
    assert_eq!(host.health.bus_errors.load(Ordering::Relaxed), 0);
    terminal.master.write_all(&[9, 9, 9, 0]).expect("written");
    terminal.master.write_all(&packet(sample(2))).expect("written");
    assert_eq!(FromRig::decode(&next(&mut host), NODE), Ok(sample(2)));
    wait_until("the count", || {
        host.health.bus_errors.load(Ordering::Relaxed) == 1
    });
}

/// A thread that read the port would have to be awake for this; here the kernel keeps the bytes.
#[test]
fn half_a_second_without_a_reader_loses_nothing() {
    let mut terminal = Terminal::new();
    let mut host = host(&terminal);
    for tick in 0..500 {
        terminal.master.write_all(&packet(sample(tick))).expect("room");
    }
    for tick in 0..500 {
        assert_eq!(FromRig::decode(&next(&mut host), NODE), Ok(sample(tick)));
    }
    assert_eq!(host.health.good_packets.load(Ordering::Relaxed), 500);
    assert_eq!(host.health.bad_packets.load(Ordering::Relaxed), 0);
}

#[test]
fn t4_an_unplugged_port_closes_the_link() {
    let terminal = Terminal::new();
    let mut host = host(&terminal);
    assert!(host.health.is_open());
    drop(terminal.master);
    wait_until("the link to close", || {
        host.receive().is_none() && !host.health.is_open()
    });
    let lease = ToRig::Lease(LeaseMessage {
        counter: 0,
        session: 1,
        control_tick: 0,
    });
    assert!(!host.send(lease.encode(NODE)));
    let refused = host.health.send_failures.load(Ordering::Relaxed);
    host.flush(link::now_ns());
    assert_eq!((host.receive(), refused), (None, 1));
}

#[test]
fn t5_a_peer_that_stops_reading_fails_the_sends_and_not_the_caller() {
    let mut terminal = Terminal::new();
    let mut host = host(&terminal);
    let mut counter = 0;
    let mut tick = 0_u16;
    // Nobody reads: the terminal's buffer fills up, then the deadline runs out.
    wait_until("a send to fail", || {
        for _ in 0..100 {
            host.send(
                ToRig::Lease(LeaseMessage {
                    counter,
                    session: 1,
                    control_tick: tick,
                })
                .encode(NODE),
            );
            counter = next_counter(counter);
            tick = tick.wrapping_add(1);
        }
        host.flush(link::now_ns());
        host.health.send_failures.load(Ordering::Relaxed) > 0
    });
    assert!(host.health.is_open());
    // It reads again: what comes then is whole frames, in order.
    let last = ToRig::Lease(LeaseMessage {
        counter: 0,
        session: 2,
        control_tick: 0,
    });
    let mut reader = terminal.master.try_clone().expect("a copy");
    let found = std::thread::spawn(move || {
        let mut decoder = Decoder::default();
        let mut bytes = [0; 4096];
        let mut before = None;
        loop {
            let count = reader.read(&mut bytes).expect("bytes");
            for frame in bytes[..count].iter().filter_map(|&byte| decoder.push(byte)) {
                match ToRig::decode(&frame, NODE) {
                    Ok(message) if message == last => return decoder.errors(),
                    Ok(ToRig::Lease(LeaseMessage { control_tick, .. })) => {
                        assert!(before < Some(control_tick), "{before:?} then {control_tick}");
                        before = Some(control_tick);
                    }
                    other => panic!("{other:?}"),
                }
            }
        }
    });
    let urgent_until_found = || {
        host.send_urgent(last.encode(NODE));
        host.flush(link::now_ns());
        found.is_finished()
    };
    wait_until("the frames after the stall", urgent_until_found);
    // The packet that the deadline cut is the only one damaged.
    assert!(found.join().expect("all in order") <= 1);
    terminal.master.flush().expect("the terminal lives");
    drop(terminal.slave);
}

#[test]
fn t7_a_taken_port_is_refused_and_the_owner_undisturbed() {
    let mut terminal = Terminal::new();
    let mut owner = host(&terminal);
    let error = link::open(&address(&terminal), Side::Rig { node: NODE })
        .err()
        .expect("the port is taken")
        .to_string();
    assert!(
        error.contains(&address(&terminal)) && error.contains("taken"),
        "{error}"
    );
    terminal.master.write_all(&packet(sample(3))).expect("written");
    assert_eq!(FromRig::decode(&next(&mut owner), NODE), Ok(sample(3)));
    // Closed, it is free again.
    drop(owner);
    open(&address(&terminal), Side::Rig { node: NODE });
}

/// An adapter that is pulled out and plugged in again gets its name in /dev back, here a symbolic link.
#[test]
fn l12_a_daemon_outlives_an_unplugged_adapter_and_opens_it_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let port = folder.path().join("ttyUSB0");
    let plug_in = || {
        let terminal = Terminal::new();
        std::os::unix::fs::symlink(&terminal.port, &port).expect("a name in /dev");
        terminal
    };
    let adapter = plug_in();
    let bench = config("benches/mock-serial.toml");
    let mut daemon = Daemon::start(
        &folder.path().join("data"),
        &[
            "--bench",
            bench.to_str().expect("UTF-8"),
            "--link",
            &format!("serial:{}", port.display()),
        ],
    );
    let mut until_open = |open: bool| {
        support::until(&format!("link_open = {open}"), || {
            let ended = daemon.process.0.try_wait().expect("a process");
            assert!(ended.is_none(), "the daemon ended: {ended:?}");
            Some(daemon.status()).filter(|s| s["link_open"] == open)
        });
    };
    until_open(true);
    std::fs::remove_file(&port).expect("the name is gone");
    drop(adapter);
    until_open(false);
    // Long enough for two attempts to open it.
    std::thread::sleep(Duration::from_millis(2500));
    until_open(false);
    let again = plug_in();
    until_open(true);
    drop(again);
    until_open(false);
}

/// The control thread reads and writes the port itself, so neither may ask for memory.
#[test]
fn frames_are_sent_and_received_without_an_allocation() {
    let terminal = Terminal::new();
    let mut host = host(&terminal);
    let mut master = terminal.master.try_clone().expect("a copy");
    let lease = |tick: u16| {
        ToRig::Lease(LeaseMessage {
            counter: (tick % 15) as u8,
            session: 1,
            control_tick: tick,
        })
        .encode(NODE)
    };
    let packets: Vec<Vec<u8>> = (0..500).map(|tick| packet(sample(tick))).collect();
    let mut swallowed = [0; 4096];
    let before = allocations::of_this_thread();
    for (tick, packet) in (0..).zip(&packets) {
        master.write_all(packet).expect("written");
        assert!(host.send(lease(tick)));
        host.flush(u64::from(tick) * 1_000_000);
        next(&mut host);
        assert!(master.read(&mut swallowed).expect("read") > 0);
    }
    let after = allocations::of_this_thread();
    assert_eq!((after.count, after.freed), (before.count, before.freed));
}
