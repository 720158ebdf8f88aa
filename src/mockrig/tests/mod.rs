//! The mock rig against a minimal host in virtual time.

use std::f64::consts::TAU;

use super::*;
use crate::link::loopback;
use crate::model::equivalent::Equivalent;
use crate::protocol::message::{
    Cause, CommandMessage, ConfigAbort, LeaseMessage, NmtCommand, NmtState, RequestCode, RequestMessage,
    RequestResult, RigState, WireMode, next_counter, object,
};
use crate::protocol::tick::TICK_S;

mod answers;
mod criteria;
mod faults;
mod lifecycle;
mod tracking;

impl MockRig {
    /// True displacement in mm.
    pub(crate) fn displacement_mm(&self) -> f64 {
        self.actuator.displacement_mm
    }

    /// True force of the specimen in N.
    fn force_n(&self) -> f64 {
        self.specimen_n
    }

    /// State of the firmware.
    pub(crate) fn state(&self) -> RigState {
        self.firmware.state
    }

    /// The valve is open and the pump on.
    pub(crate) fn pressure_on(&self) -> bool {
        self.drive.open
    }

    /// The first cause that the firmware has latched.
    pub(crate) fn cause(&self) -> Cause {
        self.firmware.cause
    }

    /// Ticks since the lease was renewed.
    pub(crate) fn lease_age_ticks(&self) -> u64 {
        self.firmware.tick - self.firmware.host.renewed_at
    }

    /// Ends all faults, those of the schedule too.
    pub(crate) fn end_faults(&mut self) {
        self.schedule = FaultSchedule::default();
        self.injection = Injection::default();
    }

    /// CRC-32 of the limits in the firmware.
    pub(crate) fn limits_crc(&self) -> u32 {
        self.firmware.limits.crc32()
    }
}

/// The rig and a host that renews its lease and fills the queue until a test stops it.
struct TestRig {
    rig: MockRig,
    host: Link,
    rig_link: Link,
    tick: u64,
    session: u8,
    keeps_lease: bool,
    /// Counters of lease, command and request.
    counters: [u8; 3],
    motion: Option<(WireMode, CommandedMotion)>,
    sent_until: u64,
    received: Vec<FromRig>,
    /// Tick, force in N and displacement in mm.
    samples: Vec<(u64, f64, f64)>,
    state: RigState,
    cause: Cause,
    ack: (u8, RequestResult),
    queue_ms: u8,
}

/// Set point in counts at a tick, and whether it is the last; `None` after the end.
type CommandedMotion = Box<dyn Fn(u64) -> Option<(i32, bool)>>;

/// Commands are sent this many ticks ahead.
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

    /// One tick of host and rig.
    fn step(&mut self) {
        if self.keeps_lease && self.tick.is_multiple_of(10) {
            let lease = LeaseMessage {
                counter: self.counter(0),
                session: self.session,
                control_tick: self.tick as u16,
            };
            self.send(ToRig::Lease(lease));
        }
        self.fill_queue();
        self.rig.tick(&mut self.rig_link);
        self.tick += 1;
        while let Some(frame) = self.host.receive() {
            self.take(FromRig::decode(&frame, 1).expect("the rig sends valid frames"));
        }
    }

    fn fill_queue(&mut self) {
        while let Some((mode, motion)) = &self.motion {
            let (mode, tick) = (*mode, self.sent_until.max(self.tick + 1) + 1);
            if tick > self.tick + KEEP_AHEAD {
                break;
            }
            let Some((counts, last)) = motion(tick) else {
                break;
            };
            let command = CommandMessage {
                counter: self.counter(1),
                session: self.session,
                tick: tick as u16,
                mode,
                counts,
                last,
            };
            self.send(ToRig::Command(command));
            self.sent_until = tick;
        }
    }

    fn take(&mut self, message: FromRig) {
        match message {
            FromRig::Sample(sample) => {
                assert_eq!(sample.tick, self.tick as u16);
                self.samples.push((
                    self.tick,
                    f64::from(sample.force_counts) * FORCE_N_PER_COUNT,
                    f64::from(sample.displacement_counts) * DISPLACEMENT_MM_PER_COUNT,
                ));
            }
            FromRig::Status(status) => {
                (self.state, self.cause, self.queue_ms) = (status.state, status.cause, status.queue_ms);
                self.ack = (status.ack_counter, status.ack_result);
            }
            other => self.received.push(other),
        }
    }

    fn run(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.step();
        }
    }

    /// Number of ticks until `state`, at most `most`.
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
        self.send(ToRig::Request(RequestMessage {
            counter,
            session,
            code,
            argument,
        }));
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
        let crc = bench.rig.limits_crc();
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
                let t = (tick - start) as f64 * TICK_S;
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
                let part = ((tick - start) as f64 * TICK_S).min(1.0);
                let x = from + (mm - from) * (0.5 - 0.5 * (TAU * 0.5 * part).cos());
                Some(((x / DISPLACEMENT_MM_PER_COUNT).round() as i32, false))
            }),
        ));
        self.run(1200);
        assert_eq!(self.state, RigState::Running);
    }

    fn emergencies(&self) -> Vec<Cause> {
        let cause = |message: &FromRig| match message {
            FromRig::Emergency(emergency) => Some(emergency.cause),
            _ => None,
        };
        self.received.iter().filter_map(cause).collect()
    }
}

fn default_bench() -> TestRig {
    TestRig::armed(&MockRigConfig::default())
}
