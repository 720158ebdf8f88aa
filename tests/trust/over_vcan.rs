//! Fault D1 over a real CAN stack in real time. Exact limits are asserted in virtual time; the limit here allows what a second kernel
//! on a shared machine adds. `LEAFBENCH_KILLS` sets how many kills there are.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use socketcan::{CanFrame, CanSocket, EmbeddedFrame, Frame as _, Socket};

use crate::protocol::frame::Frame;
use crate::protocol::message::{Cause, FromRig, RigState, ToRig};
use crate::tests::support::{Daemon, Process, config, leafbench, until};
use crate::tests::two_processes::{ONE_BENCH, vcan0_is_there};

const NODE: u8 = 1;
/// Kills where `LEAFBENCH_KILLS` says nothing.
const KILLS: usize = 5;
/// The lease of 50 ms, and what a second kernel may add under load.
const LONGEST: Duration = Duration::from_millis(100);

/// What the bus has shown so far.
#[derive(Debug, Default)]
struct Seen {
    state: Option<RigState>,
    last_lease: Option<Instant>,
    unloading: Option<(Instant, Cause)>,
}

/// Follows the bus until it is told to end.
fn follow(bus: &CanSocket, seen: &Mutex<Seen>, ended: &AtomicBool) {
    while !ended.load(Ordering::Relaxed) {
        let Ok(CanFrame::Data(frame)) = bus.read_frame() else {
            continue;
        };
        let now = Instant::now();
        let Ok(id) = u16::try_from(frame.raw_id()) else {
            continue;
        };
        let frame = Frame::new(id, frame.data());
        let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
        if let Ok(ToRig::Lease(_)) = ToRig::decode(&frame, NODE) {
            seen.last_lease = Some(now);
        }
        if let Ok(FromRig::Status(status)) = FromRig::decode(&frame, NODE) {
            if status.state == RigState::Unload && seen.state != Some(RigState::Unload) {
                seen.unloading = Some((now, status.cause));
            }
            seen.state = Some(status.state);
        }
    }
}

/// Starts a run and waits until the rig moves. A busy machine may end it at once; then it is started again.
fn moving_run(daemon: &Daemon, seen: &Mutex<Seen>) -> Process {
    until("a run", || {
        daemon.back_to_ready();
        let run = leafbench(&["run", "sine-6mm-2.5hz-10", "--data"])
            .arg(&daemon.data)
            .stdout(std::process::Stdio::null())
            .spawn();
        let mut run = Process(run.expect("leafbench starts"));
        let moves = until("a rig that moves", || {
            if seen.lock().unwrap_or_else(PoisonError::into_inner).state == Some(RigState::Running) {
                return Some(true);
            }
            run.0.try_wait().expect("a child").is_some().then_some(false)
        });
        moves.then_some(run)
    })
}

/// Kills a daemon in a run; the time from its last lease to the unload of the rig, both as the bus shows them. `None` if the run
/// had ended by then, or the rig unloaded for another reason.
fn unloads_after(kill_after: Duration, daemon: Daemon, seen: &Mutex<Seen>) -> Option<Duration> {
    let _run = moving_run(&daemon, seen);
    std::thread::sleep(kill_after);
    if seen.lock().unwrap_or_else(PoisonError::into_inner).state != Some(RigState::Running) {
        return None;
    }
    drop(daemon);
    let stopped = |seen: &Seen| seen.state != Some(RigState::Running);
    until("an unload", || {
        stopped(&seen.lock().unwrap_or_else(PoisonError::into_inner)).then_some(())
    });
    let seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
    let (leased, (unloading, cause)) = (seen.last_lease?, seen.unloading?);
    (cause == Cause::LeaseLapsed).then(|| unloading.saturating_duration_since(leased))
}

#[test]
fn d1_a_killed_daemon_leaves_a_rig_that_unloads_within_100_ms_on_vcan() {
    if !vcan0_is_there() {
        return;
    }
    let _alone = ONE_BENCH.lock().unwrap_or_else(PoisonError::into_inner);
    let kills = std::env::var("LEAFBENCH_KILLS").map_or(KILLS, |n| n.parse().expect("a whole number"));
    let folder = tempfile::tempdir().expect("a folder");
    let bench = config("benches/mock-vcan.toml");
    let bench = bench.to_str().expect("UTF-8");
    let rig = leafbench(&["mock-rig", "--bench", bench, "--link", "can:vcan0"])
        .stdout(std::process::Stdio::null())
        .spawn();
    let _rig = Process(rig.expect("leafbench starts"));
    let bus = CanSocket::open("vcan0").expect("vcan0 opens");
    bus.set_read_timeout(Duration::from_millis(100)).expect("set");
    let (seen, ended) = (Mutex::new(Seen::default()), AtomicBool::new(false));
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut took: Vec<Duration> = std::thread::scope(|scope| {
        scope.spawn(|| follow(&bus, &seen, &ended));
        let _end = EndOfFollowing(&ended);
        (0..kills)
            .filter_map(|_| {
                let daemon = Daemon::start(folder.path(), &["--bench", bench, "--link", "can:vcan0"]);
                let after = Duration::from_millis(rng.random_range(0..1500));
                unloads_after(after, daemon, &seen)
            })
            .collect()
    });
    took.sort_unstable();
    assert!(
        took.len() * 10 >= kills * 8,
        "{} of {kills} runs were killed",
        took.len()
    );
    let last = took.len() - 1;
    eprintln!(
        "{} kills over vcan, from the last lease to the unload: shortest {:?}, median {:?}, longest {:?}",
        took.len(),
        took[0],
        took[last / 2],
        took[last]
    );
    // No lower limit: a mock rig that was delayed catches up on its ticks, so that its lease ends earlier in real time.
    assert!(took[last] <= LONGEST, "{took:?}");
}

/// Ends the thread that follows the bus, also if the test fails: otherwise it would wait for it for ever.
struct EndOfFollowing<'t>(&'t AtomicBool);

impl Drop for EndOfFollowing<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
