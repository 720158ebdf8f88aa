//! The mock rig against a host of a few lines, in virtual time.

use std::f64::consts::TAU;

use super::*;
use crate::link::loopback;
use crate::model::equivalent::Equivalent;
use crate::protocol::message::{
    Cause, ConfigAbort, NmtCommand, NmtState, RequestCode, RequestResult, RigState, WireMode, next_counter,
    object,
};

mod faults;
mod lifecycle;
mod tracking;

/// A bench with a host that keeps its lease and its queue, as long as it is told to.
struct TestRig {
    rig: MockRig,
    host: Link,
    rig_link: Link,
    tick: u64,
    session: u8,
    keeps_lease: bool,
    counters: [u8; 3],
    /// Set point at a tick: counts, last.
    #[allow(clippy::type_complexity)]
    motion: Option<(WireMode, Box<dyn Fn(u64) -> Option<(i32, bool)>>)>,
    sent_until: u64,
    received: Vec<FromRig>,
    samples: Vec<(u64, f64, f64)>,
    state: RigState,
    cause: Cause,
    ack: (u8, RequestResult),
    queue_ms: u8,
}

const KEEP_AHEAD: u64 = 100;

impl TestRig {
    fn new(config: &MockRigConfig) -> Self {
        let plant = Equivalent::new(&[0.0, 80.0, 0.1, 0.5], 0.0).expect("four values");
        let (host, rig_link) = loopback::pair();
        TestRig {
            rig: MockRig::new(config, Box::new(plant)).expect("defaults are possible"),
            host,
            rig_link,
            tick: 0,
            session: 7,
            keeps_lease: true,
            counters: [0; 3],
            motion: None,
            sent_until: 0,
            received: Vec::new(),
            samples: Vec::new(),
            state: RigState::Off,
            cause: Cause::None,
            ack: (15, RequestResult::None),
            queue_ms: 0,
        }
    }

    fn send(&mut self, message: ToRig) {
        assert!(self.host.send(message.encode(1)));
    }

    fn counter(&mut self, stream: usize) -> u8 {
        self.counters[stream] = next_counter(self.counters[stream]);
        self.counters[stream]
    }

    /// One millisecond.
    fn step(&mut self) {
        if self.keeps_lease && self.tick.is_multiple_of(10) {
            let counter = self.counter(0);
            let (session, control_tick) = (self.session, self.tick as u16);
            self.send(ToRig::Lease {
                counter,
                session,
                control_tick,
            });
        }
        while let Some((mode, motion)) = &self.motion {
            let (mode, tick) = (*mode, self.sent_until.max(self.tick + 1) + 1);
            if tick > self.tick + KEEP_AHEAD {
                break;
            }
            let Some((counts, last)) = motion(tick) else {
                break;
            };
            let counter = self.counter(1);
            let (session, due) = (self.session, tick as u16);
            self.send(ToRig::Command {
                counter,
                session,
                tick: due,
                mode,
                counts,
                last,
            });
            self.sent_until = tick;
        }
        self.rig.tick(&mut self.rig_link);
        self.tick += 1;
        while let Some(arrival) = self.host.receive() {
            let message = FromRig::decode(&arrival.frame, 1).expect("the rig sends what can be read");
            match message {
                FromRig::Sample {
                    tick,
                    force_counts,
                    displacement_counts,
                    ..
                } => {
                    assert_eq!(tick, self.tick as u16);
                    let force_n = f64::from(force_counts) * FORCE_N_PER_COUNT;
                    self.samples.push((
                        self.tick,
                        force_n,
                        f64::from(displacement_counts) * DISPLACEMENT_MM_PER_COUNT,
                    ));
                }
                FromRig::Status {
                    state,
                    cause,
                    ack_counter,
                    ack_result,
                    queue_ms,
                    ..
                } => {
                    (self.state, self.cause, self.queue_ms) = (state, cause, queue_ms);
                    self.ack = (ack_counter, ack_result);
                }
                other => self.received.push(other),
            }
        }
    }

    fn run(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.step();
        }
    }

    /// Ticks until `state`, at most `most`.
    fn until(&mut self, state: RigState, most: u64) -> u64 {
        (1..=most)
            .find(|_| {
                self.step();
                self.state == state
            })
            .unwrap_or_else(|| panic!("{:?} ({:?}) instead of {state:?}", self.state, self.cause))
    }

    fn request(&mut self, code: RequestCode, argument: u32) -> RequestResult {
        let counter = self.counter(2);
        let session = self.session;
        self.send(ToRig::Request {
            counter,
            session,
            code,
            argument,
        });
        self.run(2);
        assert_eq!(self.ack.0, counter, "acknowledged");
        self.ack.1
    }

    fn armed(config: &MockRigConfig) -> Self {
        let mut bench = TestRig::new(config);
        bench.run(3);
        bench.send(ToRig::Nmt {
            command: NmtCommand::Start,
            node: 0,
        });
        assert_eq!(bench.request(RequestCode::OpenSession, 0), RequestResult::Done);
        let crc = bench.rig.firmware().limits.crc32();
        assert_eq!(bench.request(RequestCode::Arm, crc), RequestResult::Done);
        bench.run(400);
        assert_eq!(bench.state, RigState::Armed);
        bench
    }

    /// A sine about `mean_mm` after a smooth approach of 1 s from 0.
    fn sine(&mut self, mean_mm: f64, amplitude_mm: f64, hz: f64) {
        let start = self.tick;
        self.motion = Some((
            WireMode::Displacement,
            Box::new(move |tick| {
                let t = (tick - start) as f64 * 1e-3;
                let taper = 0.5 - 0.5 * (TAU * 0.5 * t.min(1.0)).cos();
                let x = taper * (mean_mm + amplitude_mm * (TAU * hz * (t - 1.0)).sin());
                Some(((x / DISPLACEMENT_MM_PER_COUNT).round() as i32, false))
            }),
        ));
    }

    fn hold_at(&mut self, mm: f64) {
        let from = self.rig.displacement_mm();
        let start = self.tick;
        self.motion = Some((
            WireMode::Displacement,
            Box::new(move |tick| {
                let part = ((tick - start) as f64 * 1e-3).min(1.0);
                let x = from + (mm - from) * (0.5 - 0.5 * (TAU * 0.5 * part).cos());
                Some(((x / DISPLACEMENT_MM_PER_COUNT).round() as i32, false))
            }),
        ));
        self.run(1200);
        assert_eq!(self.state, RigState::Running);
    }

    fn emergencies(&self) -> Vec<Cause> {
        let cause = |message: &FromRig| match message {
            FromRig::Emergency { cause, .. } => Some(*cause),
            _ => None,
        };
        self.received.iter().filter_map(cause).collect()
    }
}

fn default_bench() -> TestRig {
    TestRig::armed(&MockRigConfig::default())
}
