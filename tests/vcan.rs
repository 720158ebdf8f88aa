//! Frames over a real CAN stack: two links on `vcan0`. Without CAN in the kernel, the test says so and passes;
//! `LEAFBENCH_REQUIRE_VCAN=1` makes that a failure. `.ci/uml-run TEST_BINARY vcan` runs it under a kernel with CAN.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::support::json;
use super::trust::allocations;
use crate::link::{self, Link, Side};
use crate::protocol::frame::Frame;
use crate::protocol::message::{FromRig, LeaseMessage, NmtCommand, SampleMessage, ToRig, next_counter};
use socketcan::{CanFrame, CanRemoteFrame, CanSocket, EmbeddedFrame, ExtendedId, Socket, StandardId};

const NODE: u8 = 5;
/// Longest wait for a frame: far longer than a busy virtual machine needs.
const PATIENCE: Duration = Duration::from_secs(120);

/// Whether `vcan0` exists; if not, the caller returns.
fn vcan0(test: &str) -> bool {
    let Err(error) = CanSocket::open("vcan0") else {
        return true;
    };
    let required = std::env::var("LEAFBENCH_REQUIRE_VCAN").is_ok_and(|value| value == "1");
    assert!(
        !required,
        "{test}: no vcan0 ({error}), and LEAFBENCH_REQUIRE_VCAN=1 forbids to skip"
    );
    eprintln!("SKIPPED {test}: no vcan0 here ({error}); run the test binary with .ci/uml-run");
    false
}

fn open(side: Side) -> Link {
    link::open("can:vcan0", side).expect("vcan0 opens")
}

fn host() -> Link {
    open(Side::Host { rig_node: NODE })
}

fn rig() -> Link {
    open(Side::Rig { node: NODE })
}

fn next(link: &mut Link) -> Frame {
    let until = Instant::now() + PATIENCE;
    loop {
        if let Some(frame) = link.receive() {
            return frame;
        }
        assert!(
            Instant::now() < until,
            "nothing arrived; health: {:?}",
            link.health
        );
        std::thread::sleep(Duration::from_micros(200));
    }
}

fn sample(counter: u8, tick: u16) -> FromRig {
    FromRig::Sample(SampleMessage {
        counter,
        tick,
        force_counts: i32::from(tick) - 40_000,
        displacement_counts: -7,
    })
}

/// All in one test: the tests of a crate run side by side, and these share one bus.
#[test]
fn two_links_on_vcan0() {
    if !vcan0("two_links_on_vcan0") {
        return;
    }
    ten_thousand_samples_arrive_in_order();
    both_directions_and_the_abort();
    foreign_frames_stay_in_the_kernel();
    a_stalled_reader_loses_nothing_in_two_seconds();
    a_missing_interface_is_named();
    a_vanished_interface_closes_the_link();
}

/// An interface of its own, because it is down at first.
#[test]
fn doctor_sees_a_can_interface_that_is_down_and_one_that_is_up_on_vcan() {
    if !vcan0("doctor_sees_a_can_interface_that_is_down_and_one_that_is_up_on_vcan") {
        return;
    }
    let name = "vcandoctor";
    let ip = |arguments: &[&str]| {
        let status = std::process::Command::new("ip").args(arguments).status();
        assert!(status.expect("ip runs").success(), "{arguments:?}");
    };
    let folder = tempfile::tempdir().expect("a folder");
    let of = |subject: &str| {
        let (report, code) = json(folder.path(), &["doctor", "--link", &format!("can:{name}")]);
        assert_eq!(code, i32::from(report["problems"] != 0), "{report}");
        let findings = report["findings"].as_array().expect("a list").clone();
        let found = findings.into_iter().find(|f| f["subject"] == subject);
        found.unwrap_or_else(|| panic!("{subject}: {report}"))
    };
    assert_eq!(of("CAN interface")["grade"], "problem", "there is none");
    ip(&["link", "add", "dev", name, "type", "vcan"]);
    assert!(
        of("CAN interface")["what"]
            .as_str()
            .expect("a text")
            .ends_with("is down")
    );
    ip(&["link", "set", name, "up"]);
    assert_eq!(of("CAN interface")["grade"], "ok");
    assert!(
        of("CAN bit rate")["what"]
            .as_str()
            .expect("a text")
            .contains("virtual (vcan)")
    );
    ip(&["link", "delete", name]);
}

fn ten_thousand_samples_arrive_in_order() {
    let (mut host, mut rig) = (host(), rig());
    let mut counter = 0;
    for tick in 0..10_000 {
        // The ring holds fewer than 10,000 frames, so each one is received at once, as control does.
        assert!(rig.send(sample(counter, tick).encode(NODE)));
        assert_eq!(FromRig::decode(&next(&mut host), NODE), Ok(sample(counter, tick)));
        counter = next_counter(counter);
    }
    assert_eq!(host.health.overflows.load(Ordering::Relaxed), 0);
    assert_eq!(rig.health.send_failures.load(Ordering::Relaxed), 0);
}

fn both_directions_and_the_abort() {
    let (mut host, mut rig) = (host(), rig());
    let lease = ToRig::Lease(LeaseMessage {
        counter: 3,
        session: 9,
        control_tick: 77,
    });
    assert!(host.send(lease.encode(NODE)));
    assert_eq!(ToRig::decode(&next(&mut rig), NODE), Ok(lease));
    let stop = ToRig::Nmt {
        command: NmtCommand::Stop,
        node: NODE,
    };
    assert!(host.send_urgent(stop.encode(NODE)));
    assert_eq!(ToRig::decode(&next(&mut rig), NODE), Ok(stop));
    // Frames that were queued before the close are still sent.
    assert!(host.send(lease.encode(NODE)));
    drop(host);
    assert_eq!(ToRig::decode(&next(&mut rig), NODE), Ok(lease));
}

fn foreign_frames_stay_in_the_kernel() {
    let mut host = host();
    let bus = CanSocket::open("vcan0").expect("vcan0 opens");
    let id = |id| StandardId::new(id).expect("11 bits");
    // Another node's sample, our own direction, an extended and a remote frame with our number.
    let foreign = [
        CanFrame::new(id(0x186), &[0; 8]).expect("a frame"),
        CanFrame::new(id(0x205), &[0; 8]).expect("a frame"),
        CanFrame::new(ExtendedId::new(0x185).expect("29 bits"), &[0; 8]).expect("a frame"),
        CanRemoteFrame::new_remote(id(0x185), 8).expect("a frame").into(),
    ];
    for frame in &foreign {
        bus.write_frame(frame).expect("written");
    }
    let last = CanFrame::new(id(0x705), &[5]).expect("a frame");
    bus.write_frame(&last).expect("written");
    assert_eq!(next(&mut host), Frame::new(0x705, &[5]));
    assert_eq!(host.receive(), None);
    assert_eq!(host.health.bus_errors.load(Ordering::Relaxed), 0);
}

fn a_stalled_reader_loses_nothing_in_two_seconds() {
    let mut host = host();
    let bus = CanSocket::open("vcan0").expect("vcan0 opens");
    // Two seconds of three frames per millisecond, while nobody receives.
    for tick in 0..6000_u16 {
        let frame = sample((tick % 15) as u8, tick).encode(NODE);
        let frame =
            CanFrame::new(StandardId::new(frame.id).expect("11 bits"), frame.bytes()).expect("a frame");
        bus.write_frame_insist(&frame).expect("written");
    }
    for tick in 0..6000_u16 {
        assert_eq!(
            FromRig::decode(&next(&mut host), NODE),
            Ok(sample((tick % 15) as u8, tick))
        );
    }
    assert_eq!(host.health.overflows.load(Ordering::Relaxed), 0);
}

fn a_missing_interface_is_named() {
    let error = link::open("can:can7", Side::Rig { node: 1 })
        .err()
        .expect("no can7")
        .to_string();
    assert!(error.contains("ip link add dev can7 type vcan"), "{error}");
}

fn a_vanished_interface_closes_the_link() {
    let ip = |arguments: &str| {
        let status = std::process::Command::new("ip")
            .args(arguments.split(' '))
            .status()
            .expect("ip runs");
        assert!(status.success(), "ip {arguments}");
    };
    // An interface of its own, so that no other test loses its bus.
    ip("link add dev vcan7 type vcan");
    ip("link set vcan7 up");
    let mut gone = link::open("can:vcan7", Side::Rig { node: NODE }).expect("vcan7 opens");
    assert!(gone.health.is_open());
    ip("link del dev vcan7");
    let until = Instant::now() + PATIENCE;
    while gone.health.is_open() {
        assert!(gone.receive().is_none());
        assert!(Instant::now() < until, "the link never noticed");
        std::thread::sleep(Duration::from_millis(1));
    }
    let lease = ToRig::Lease(LeaseMessage {
        counter: 0,
        session: 1,
        control_tick: 0,
    });
    assert!(!gone.send(lease.encode(NODE)));
}

/// The control thread reads and writes the sockets itself, so neither may ask for memory.
#[test]
fn vcan_frames_are_sent_and_received_without_an_allocation() {
    if !vcan0("vcan_frames_are_sent_and_received_without_an_allocation") {
        return;
    }
    let (mut host, mut rig) = (host(), rig());
    let before = allocations::of_this_thread();
    for tick in 0..1000_u16 {
        assert!(rig.send(sample((tick % 15) as u8, tick).encode(NODE)));
        rig.flush(0);
        next(&mut host);
    }
    assert_eq!(host.receive(), None);
    let after = allocations::of_this_thread();
    assert_eq!((after.count, after.freed), (before.count, before.freed));
}
