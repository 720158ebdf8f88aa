//! Lateness of samples: what waited in this computer is not late, what waited in the link is. Control against the mock rig
//! in virtual time, with pauses of either side.

use std::collections::VecDeque;

use super::support::bench::mock;
use crate::cli::virtual_bench::VirtualBench;
use crate::control::run::RunOrder;
use crate::control::{Phase, Rig};
use crate::daemon::header::{self, Planned};
use crate::link::{Link, loopback};
use crate::mockrig::MockRig;
use crate::profile::Profile;
use crate::protocol::frame::Frame;
use crate::recording::Flags;
use crate::recording::memory::Memory;

const MS: u64 = 1_000_000;
const RAMP: &str = "name = \"ramp\"\ncontrol = \"force\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\nto_n = 1000.0\n\
                    duration_s = 60.0\n[[block.segment]]\nkind = \"ramp\"\nto_n = 0.0\nduration_s = 60.0\n";

/// A bench with a run under way, and a delay on the way from the rig.
struct Bench {
    rig: Rig,
    mock: MockRig,
    host: Link,
    /// The mock rig's end, and the end that the delay reads.
    far: Link,
    near_far: Link,
    /// The end that the delay writes.
    near_host: Link,
    on_the_way: VecDeque<(u64, Frame)>,
    delay_ns: u64,
    now_ns: u64,
    memory: Memory,
}

impl Bench {
    fn running() -> Bench {
        let config = mock();
        let VirtualBench { rig, mock, .. } = VirtualBench::new(&config, None).expect("a sound bench");
        let (near_far, far) = loopback::pair();
        let (host, near_host) = loopback::pair();
        let mut bench = Bench {
            rig,
            mock,
            host,
            far,
            near_far,
            near_host,
            on_the_way: VecDeque::new(),
            delay_ns: 0,
            now_ns: 0,
            memory: Memory::default(),
        };
        bench.until(Phase::Ready);
        bench.steps(600);
        let profile = Profile::from_toml(RAMP, "test").expect("a profile");
        let planned = Planned {
            cycles: 0,
            duration_s: 120.0,
        };
        let at = "2026-01-01T00:00:00Z".parse().expect("a time");
        let header = header::new("test".into(), at, &config, &profile, RAMP.into(), planned);
        bench
            .rig
            .start(RunOrder {
                header,
                profile,
                first_cycle: 1,
            })
            .expect("the rig is ready");
        bench.until(Phase::Running);
        bench.steps(1_000);
        bench
    }

    /// One millisecond of the rig and of the link, without a poll.
    fn tick(&mut self) {
        self.now_ns += MS;
        while let Some(frame) = self.near_host.receive() {
            self.near_far.send(frame);
        }
        self.mock.tick(&mut self.far);
        while let Some(frame) = self.near_far.receive() {
            self.on_the_way.push_back((self.now_ns + self.delay_ns, frame));
        }
        self.deliver();
    }

    fn deliver(&mut self) {
        while let Some((_, frame)) = self.on_the_way.pop_front_if(|(at_ns, _)| *at_ns <= self.now_ns) {
            self.near_host.send(frame);
        }
    }

    fn steps(&mut self, ms: u64) {
        for _ in 0..ms {
            self.tick();
            self.poll(self.now_ns);
        }
    }

    fn poll(&mut self, now_ns: u64) {
        self.rig.poll(now_ns, &mut self.host, &mut self.memory);
    }

    fn until(&mut self, phase: Phase) {
        for _ in 0..5_000 {
            if self.rig.phase() == phase {
                return;
            }
            self.steps(1);
        }
        panic!("not {phase:?}: {:#?}", self.rig.status());
    }

    /// Samples with the flag among those of the newest `count`.
    fn flagged(&self, flag: Flags, count: usize) -> usize {
        let newest = self.memory.samples.iter().rev().take(count);
        newest.filter(|s| s.flags.contains(flag)).count()
    }

    fn assert_all_in_time(&self, what: &str) {
        let all = self.memory.samples.len();
        assert_eq!(self.flagged(Flags::LATE, all), 0, "{what}: late of {all}");
        assert_eq!(self.flagged(Flags::AFTER_GAP, all), 0, "{what}: gaps in {all}");
    }
}

#[test]
fn a_pause_of_the_host_makes_no_sample_late_and_loses_none() {
    for pause_ms in [5, 20, 50, 100, 200, 500] {
        let mut bench = Bench::running();
        (0..pause_ms).for_each(|_| bench.tick());
        bench.steps(2_000);
        bench.assert_all_in_time(&format!("{pause_ms} ms"));
    }
}

/// The control thread takes the time, is preempted, and then reads what arrived meanwhile.
#[test]
fn a_pause_between_the_clock_and_the_read_makes_no_sample_late() {
    for pause_ms in [5, 30, 80] {
        let mut bench = Bench::running();
        let before_ns = bench.now_ns;
        (0..pause_ms).for_each(|_| bench.tick());
        bench.poll(before_ns);
        bench.steps(2_000);
        bench.assert_all_in_time(&format!("{pause_ms} ms"));
    }
}

/// A busy computer stops the process of the mock rig: its clock stands still and is behind from then on.
#[test]
fn a_rig_clock_that_stood_still_makes_samples_late_for_seconds_only() {
    let mut bench = Bench::running();
    for _ in 0..3 {
        for _ in 0..15 {
            bench.now_ns += MS;
            bench.deliver();
            bench.poll(bench.now_ns);
        }
        bench.steps(20);
    }
    bench.steps(2_500);
    let late = bench.rig.status().counters.late;
    assert!(late > 0, "three times 15 ms are more than the 20 ms allowed");
    bench.steps(2_500);
    assert_eq!(bench.rig.status().counters.late, late, "late of the last 2500");
}

#[test]
fn a_delay_in_the_link_is_flagged_from_its_first_sample() {
    let mut bench = Bench::running();
    let before = bench.memory.samples.len();
    bench.delay_ns = 25 * MS;
    bench.steps(100);
    let delayed = &bench.memory.samples[before..];
    // The silence before the first one ends the run, which is soon unloaded.
    assert!(delayed.len() > 20, "{} samples", delayed.len());
    assert!(delayed.iter().all(|s| s.flags.contains(Flags::LATE)));
    let late = bench.rig.status().counters.late;
    assert!(late >= delayed.len() as u64, "{late} counted");
}
