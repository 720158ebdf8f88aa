//! Daemon and mock rig as two processes over a real link, in real time: the shortened static ramp and ten cycles of the
//! 2.5 Hz sine, over a pseudo-terminal pair and over vcan0 with candump beside. The sine again with the first paper's whole
//! leaf pack, solved once a millisecond twice: as the rig's specimen and as the daemon's twin.
//!
//! Functional: the daemon must lose nothing and trip on nothing. Exact times are asserted in virtual time elsewhere, so
//! the limits of the bench here allow a machine that stops for a moment.

use super::support::{self, wire};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};

use super::support::{Daemon, Process, config, json, leafbench};
use crate::protocol::frame::Frame;
use crate::protocol::message::{FromRig, SampleMessage};
use crate::recording::run_file::{EXTENSION, RunFile};
use crate::recording::{Flags, Sample};

const SINE: (&str, u32, usize) = ("sine-6mm-2.5hz-10", 10, 17_000);
const PROFILES: [(&str, u32, usize); 2] = [("static-ramp-12s", 0, 12_001), SINE];
/// One bench at a time: two benches in real time would delay each other.
pub(super) static ONE_BENCH: Mutex<()> = Mutex::new(());
/// A shared machine may stop a process for longer than the bench's limits allow. The run is then repeated.
const ATTEMPTS: usize = 10;
/// Least number of frames of a run that candump must have seen for the comparison.
const LEAST_FRAMES: usize = 500;

/// The shipped bench with the longest times that are allowed, for a shared machine: 500 ms of lease and silence, 200 ms of queue.
fn patient_bench(name: &str, folder: &Path) -> PathBuf {
    let shipped = std::fs::read_to_string(config(&format!("benches/{name}.toml"))).expect("is shipped");
    let specimens = config("specimens");
    let text = shipped
        .replace(
            "file = \"../specimens",
            &format!("file = \"{}", specimens.display()),
        )
        .replace("lease_ms = 50", "lease_ms = 500")
        .replace("node = 1\n", "node = 1\nqueue_lead_ms = 200\nsilence_ms = 500\n");
    assert!(
        text.contains("lease_ms = 500") && text.contains("silence_ms = 500"),
        "{text}"
    );
    let path = folder.join(format!("{name}.toml"));
    std::fs::write(&path, text).expect("written");
    path
}

/// Runs one profile to its end; the run's samples. A trip on a silent link may be repeated, nothing else.
fn run_profile(daemon: &Daemon, profile: &str, cycles: u32, samples_at_least: usize) -> Vec<Sample> {
    let mut causes = Vec::new();
    for _ in 0..ATTEMPTS {
        let (ended, code) = json(&daemon.data, &["run", profile]);
        let id = ended["run_id"]
            .as_str()
            .unwrap_or_else(|| panic!("{ended}"))
            .to_owned();
        let file = daemon.data.join(format!("{id}.{EXTENSION}"));
        let run = RunFile::open(&file).expect("the run's file opens");
        let outcome = run.outcome().expect("the run ended").clone();
        if code != 0 {
            eprintln!(
                "DISTURBED {profile}: {}; control loop {}",
                outcome.cause,
                daemon.status()["control_loop"]
            );
            causes.push(outcome.cause);
            daemon.back_to_ready();
            continue;
        }
        let samples: Vec<Sample> = run.samples().collect();
        let with_twin = samples.iter().filter(|s| s.twin_force_n.is_some()).count();
        // For the log of CI, which has no other sign that the run was long.
        eprintln!(
            "{profile}: {} samples recorded, {} lost, {} cycles, twin beside {with_twin}",
            samples.len(),
            outcome.lost,
            outcome.cycles_completed
        );
        assert_eq!((outcome.lost, outcome.cycles_completed), (0, cycles));
        assert!(samples.len() >= samples_at_least, "{} samples", samples.len());
        assert!(
            samples.windows(2).all(|w| w[1].tick == w[0].tick + 1),
            "no tick is missing"
        );
        assert!(samples.iter().all(|s| !s.flags.contains(Flags::AFTER_GAP)));
        assert!(with_twin > 0, "the twin ran beside");
        return samples;
    }
    panic!("{profile} was disturbed {ATTEMPTS} times: {causes:?}");
}

fn start(name: &str, folder: &Path, rig_link: &str, host_link: &str) -> (Process, Daemon) {
    let bench = patient_bench(name, folder);
    let bench = bench.to_str().expect("UTF-8");
    let rig = leafbench(&["mock-rig", "--json", "--bench", bench, "--link", rig_link])
        .stdout(Stdio::piped())
        .spawn();
    let rig = Process(rig.expect("leafbench starts"));
    let daemon = Daemon::ready(&folder.join("data"), &["--bench", bench, "--link", host_link]);
    (rig, daemon)
}

#[test]
fn over_a_pseudo_terminal_pair() {
    let _alone = ONE_BENCH.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().expect("a folder");
    let wire = wire::Wire::new();
    let [rig_port, host_port] = wire.ports.clone().map(|port| format!("serial:{port}"));
    let (_rig, daemon) = start("mock-serial", folder.path(), &rig_port, &host_port);
    for (profile, cycles, samples) in PROFILES {
        run_profile(&daemon, profile, cycles, samples);
    }
}

#[test]
fn over_vcan_with_candump_beside() {
    if !vcan0_is_there() {
        return;
    }
    let _alone = ONE_BENCH.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().expect("a folder");
    let log = folder.path().join("candump.log");
    let out = std::fs::File::create(&log).expect("created");
    let candump = Command::new("candump")
        .args(["-L", "-r", "8388608", "vcan0"])
        .stdout(out)
        .spawn();
    let candump = Process(candump.expect("candump is installed: apt-get install can-utils"));
    let (rig, daemon) = start("mock-vcan", folder.path(), "can:vcan0", "can:vcan0");
    let runs: Vec<Vec<Sample>> = PROFILES
        .iter()
        .map(|&(profile, cycles, samples)| run_profile(&daemon, profile, cycles, samples))
        .collect();
    drop((daemon, rig));
    end_candump(candump, &log);
    let seen = sample_frames(&std::fs::read_to_string(&log).expect("candump's log"));
    for ((profile, ..), run) in PROFILES.iter().zip(&runs) {
        let (first, last) = (run[0].tick, run[run.len() - 1].tick);
        let of_run: BTreeMap<u64, (i32, i32)> = seen.range(first..=last).map(|(t, c)| (*t, *c)).collect();
        let recorded: BTreeMap<u64, (i32, i32)> = run
            .iter()
            .map(|s| (s.tick, (s.force_counts, s.displacement_counts)))
            .collect();
        for (tick, counts) in &of_run {
            assert_eq!(
                recorded.get(tick),
                Some(counts),
                "frame of tick {tick} is not in the run file as it was sent"
            );
        }
        // Under user-mode Linux on a busy machine, candump misses many frames. The frames that it saw were compared.
        assert!(
            of_run.len() > LEAST_FRAMES,
            "{profile}: candump saw only {} frames of {}",
            of_run.len(),
            run.len()
        );
    }
}

/// The whole leaf pack as specimen and as twin, each 1000 times a second.
fn leaf_pack_beside_and_beneath(rig_link: &str, host_link: &str) {
    let folder = tempfile::tempdir().expect("a folder");
    let (mut rig, daemon) = start("samurai-rail", folder.path(), rig_link, host_link);
    let (profile, cycles, least) = SINE;
    let run = run_profile(&daemon, profile, cycles, least);
    let control = daemon.status()["control_loop"].clone();
    drop(daemon);
    let pid = nix::unistd::Pid::from_raw(rig.0.id() as i32);
    nix::sys::signal::kill(pid, nix::sys::signal::Signal::SIGINT).expect("the rig is there");
    let mut said = String::new();
    let stdout = rig.0.stdout.as_mut().expect("piped");
    std::io::Read::read_to_string(stdout, &mut said).expect("the rig ends");
    let empty = run.iter().filter(|s| s.twin_force_n.is_none()).count();
    let ticks: serde_json::Value = serde_json::from_str(&said).expect("the rig's count");
    assert!(ticks["ticks"].as_u64() >= Some(least as u64), "{ticks}");

    // The twin is the specimen. The rest is the noise of both sensors, the servo's ripple and the samples without a twin.
    let pairs = || run.iter().filter_map(|s| Some((s.force_n, s.twin_force_n?)));
    let mean_square = pairs().map(|(f, t)| (f - t).powi(2)).sum::<f64>() / pairs().count() as f64;
    let peak_n = run.iter().fold(0.0, |m, s| s.force_n.max(m));
    assert!(
        mean_square.sqrt() < 0.02 * peak_n,
        "twin against rig: {:.2} N rms of {peak_n:.0} N; deadlines missed: rig {ticks}, control loop {control}, twin {empty}",
        mean_square.sqrt()
    );
}

#[test]
fn leaf_pack_over_a_pseudo_terminal_pair() {
    let _alone = ONE_BENCH.lock().unwrap_or_else(PoisonError::into_inner);
    let wire = wire::Wire::new();
    let [rig_port, host_port] = wire.ports.clone().map(|port| format!("serial:{port}"));
    leaf_pack_beside_and_beneath(&rig_port, &host_port);
}

#[test]
fn leaf_pack_over_vcan() {
    if vcan0_is_there() {
        let _alone = ONE_BENCH.lock().unwrap_or_else(PoisonError::into_inner);
        leaf_pack_beside_and_beneath("can:vcan0", "can:vcan0");
    }
}

/// Waits until candump writes nothing more, then interrupts it, so that it also writes its buffer.
fn end_candump(mut candump: Process, log: &Path) {
    let mut size = 0;
    let mut quiet = 0;
    support::until("candump to catch up", || {
        let now = std::fs::metadata(log).map_or(0, |m| m.len());
        quiet = if now == size { quiet + 1 } else { 0 };
        size = now;
        (quiet > 100).then_some(())
    });
    let pid = nix::unistd::Pid::from_raw(candump.0.id() as i32);
    nix::sys::signal::kill(pid, nix::sys::signal::Signal::SIGINT).expect("candump is there");
    let _ = candump.0.wait();
}

pub(super) fn vcan0_is_there() -> bool {
    if Path::new("/sys/class/net/vcan0").exists() {
        return true;
    }
    let required = std::env::var("LEAFBENCH_REQUIRE_VCAN").is_ok_and(|value| value == "1");
    assert!(
        !required,
        "no vcan0, and LEAFBENCH_REQUIRE_VCAN=1 forbids to skip"
    );
    eprintln!("SKIPPED: no vcan0 here; run the test binary with .ci/uml-run");
    false
}

/// Counts of all sample frames in a candump log, by unfolded tick. The first tick is not unfolded, as in the daemon, which
/// connects within the first 65 s.
fn sample_frames(log: &str) -> BTreeMap<u64, (i32, i32)> {
    let mut frames = BTreeMap::new();
    let mut newest: Option<u64> = None;
    for line in log.lines() {
        let Some((id, data)) = line.split_whitespace().nth(2).and_then(|f| f.split_once('#')) else {
            continue;
        };
        let bytes: Vec<u8> = (0..data.len() / 2)
            .filter_map(|i| u8::from_str_radix(&data[2 * i..2 * i + 2], 16).ok())
            .collect();
        let Ok(id) = u16::from_str_radix(id, 16) else {
            continue;
        };
        let Ok(FromRig::Sample(SampleMessage {
            tick,
            force_counts,
            displacement_counts,
            ..
        })) = FromRig::decode(&Frame::new(id, &bytes), 1)
        else {
            continue;
        };
        let unfolded = match newest {
            None => u64::from(tick),
            Some(newest) => newest + u64::from(tick.wrapping_sub(newest as u16)),
        };
        newest = Some(unfolded);
        frames.insert(unfolded, (force_counts, displacement_counts));
    }
    frames
}
