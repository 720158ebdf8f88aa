//! Control and the mock rig over a link in virtual time. What passes between them can be dropped, delayed and changed.

use std::collections::VecDeque;

use crate::control::channel::Channels;
use crate::control::detectors::DetectorLimits;
use crate::control::physical_limits::PhysicalLimits;
use crate::control::run::RunOrder;
use crate::control::{Phase, Rig, RigConfig};
use crate::link::{Link, loopback};
use crate::mockrig::{MockRig, MockRigConfig};
use crate::model;
use crate::profile::{Block, CycleSegment, Level, Profile, Segment, Wave};
use crate::protocol::frame::Frame;
use crate::recording::memory::Memory;
use crate::recording::{ChannelScale, FirmwareIdentity, Header, SensorIdentity};
use crate::units::Mode;

/// Nanoseconds of a millisecond.
pub const MS: u64 = 1_000_000;

/// Node of the rig.
pub const NODE: u8 = 1;

/// What arrives of a frame at the other end; `None`: it is lost.
pub type Wire = Box<dyn FnMut(Frame) -> Option<Frame>>;

/// The virtual bench. One tick is a millisecond.
pub struct VirtualRig {
    pub rig: Rig,
    pub mock: MockRig,
    /// The host's end of the link.
    pub host: Link,
    /// The rig's end of the link.
    far: Link,
    /// The other ends of both: the wire between them.
    wire: [Link; 2],
    /// Frames of the rig on their way to the host.
    pub to_host: Wire,
    /// Frames of the host on their way to the rig.
    pub to_rig: Wire,
    /// Delay of the frames to the host, ms.
    pub delay_ms: usize,
    delayed: VecDeque<Vec<Frame>>,
    pub now_ns: u64,
    /// Length of a millisecond of the rig on the host's clock, ns.
    pub ms_ns: u64,
    /// Frames to the host are delivered in blocks of this length, ms; 1 for at once.
    pub block_ms: u64,
    ticks: u64,
    /// The host's frames stay in its queue.
    pub jammed: bool,
    pub memory: Memory,
    /// The host's program runs.
    pub host_alive: bool,
    /// The rig's firmware runs; its clock stands still where it does not.
    pub rig_alive: bool,
}

impl VirtualRig {
    pub fn new() -> Self {
        VirtualRig::with(&MockRigConfig::default())
    }

    pub fn with(mock: &MockRigConfig) -> Self {
        let (host, host_wire) = loopback::pair();
        let (far, far_wire) = loopback::pair();
        VirtualRig {
            rig: Rig::new(rig_config()),
            mock: mock_rig(mock),
            host,
            far,
            wire: [host_wire, far_wire],
            to_host: Box::new(Some),
            to_rig: Box::new(Some),
            delay_ms: 0,
            delayed: VecDeque::new(),
            now_ns: 0,
            ms_ns: MS,
            jammed: false,
            block_ms: 1,
            ticks: 0,
            memory: Memory::default(),
            host_alive: true,
            rig_alive: true,
        }
    }

    /// The rig with another one in its place that has just been switched on.
    pub fn power_cycle(&mut self) {
        let config = MockRigConfig {
            boot_id: MockRigConfig::default().boot_id + 1,
            ..MockRigConfig::default()
        };
        self.mock = mock_rig(&config);
    }

    pub fn tick(&mut self) {
        self.now_ns += self.ms_ns;
        if self.rig_alive {
            self.mock.tick(&mut self.far);
        }
        let mut sent = Vec::new();
        while let Some(frame) = self.wire[1].receive() {
            sent.extend((self.to_host)(frame));
        }
        self.delayed.push_back(sent);
        self.ticks += 1;
        while self.delayed.len() > self.delay_ms && self.ticks.is_multiple_of(self.block_ms) {
            for frame in self.delayed.pop_front().into_iter().flatten() {
                self.wire[0].send(frame);
            }
        }
        if self.host_alive {
            self.rig.poll(self.now_ns, &mut self.host, &mut self.memory);
        }
        while !self.jammed
            && let Some(frame) = self.wire[0].receive()
        {
            if let Some(frame) = (self.to_rig)(frame) {
                self.wire[1].send(frame);
            }
        }
    }

    /// A frame of another node arrives at the host.
    pub fn others_send(&mut self, frame: Frame) {
        self.wire[0].send(frame);
    }

    pub fn ticks(&mut self, ms: u64) {
        for _ in 0..ms {
            self.tick();
        }
    }

    /// Ticks until the bench is in `phase`, and returns how long that took in ms.
    pub fn until(&mut self, phase: Phase, limit_ms: u64) -> u64 {
        for ms in 0..limit_ms {
            if self.rig.phase() == phase {
                return ms;
            }
            self.tick();
        }
        panic!("not {phase:?} after {limit_ms} ms: {:#?}", self.rig.status());
    }

    pub fn start(&mut self, profile: Profile) {
        self.until(Phase::Ready, 2_000);
        self.ticks(600);
        self.rig.start(order(profile)).expect("the rig is ready");
        self.until(Phase::Running, 1_000);
    }

    /// The host again, as after a restart of the daemon: it knows nothing, and has another session.
    pub fn restart_host(&mut self) {
        let mut config = rig_config();
        config.session += 1;
        self.rig = Rig::new(config);
    }

    pub fn stop(&mut self) {
        self.rig
            .stop("stopped by the operator", self.now_ns, &mut self.host);
    }
}

fn rig_config() -> RigConfig {
    let plain = |scale_per_count| ChannelScale {
        scale_per_count,
        offset: 0.0,
        tare: 0.0,
        curve: [0.0; 2],
    };
    RigConfig {
        node: NODE,
        session: 7,
        channels: Channels {
            force: plain(0.1),
            displacement: plain(0.0005),
        },
        limits: PhysicalLimits::EXAMPLE,
        calibration_hash: 0,
        queue_lead_ms: 100,
        commands_per_poll: 3,
        ack_timeout_ms: 20,
        detectors: DetectorLimits::default(),
        tare_limit_n: 200.0,
        tare_limit_mm: 5.0,
        still_sigma_n: 3.0,
        still_sigma_mm: 0.02,
    }
}

fn mock_rig(config: &MockRigConfig) -> MockRig {
    let equivalent = model::find("equivalent").expect("is in the list");
    let plant = equivalent
        .plant(&equivalent.start_values(), &toml::Table::new())
        .expect("starts are within bounds");
    MockRig::new(config, plant).expect("a possible rig")
}

/// The order of a run.
pub fn order(profile: Profile) -> RunOrder {
    RunOrder {
        header: Header {
            run_id: "test".into(),
            started_utc: "2026-01-01T00:00:00Z".into(),
            specimen: "equivalent".into(),
            operator: String::new(),
            profile_name: profile.name.clone(),
            profile_toml: String::new(),
            bench_toml: String::new(),
            bench_sha256: String::new(),
            firmware: FirmwareIdentity::default(),
            program_version: "test".into(),
            sample_rate_hz: 1000.0,
            force_channel: ChannelScale {
                scale_per_count: 0.1,
                offset: 0.0,
                tare: 0.0,
                curve: [0.0; 2],
            },
            displacement_channel: ChannelScale {
                scale_per_count: 0.0005,
                offset: 0.0,
                tare: 0.0,
                curve: [0.0; 2],
            },
            force_sensor: SensorIdentity::default(),
            displacement_sensor: SensorIdentity::default(),
            twin: String::new(),
            first_cycle: 1,
            resumes_run: String::new(),
            cycles_planned: 0,
            duration_planned_s: 0.0,
            remarks: Vec::new(),
            continues: String::new(),
        },
        profile,
        first_cycle: 1,
    }
}

/// A profile of one block.
pub fn profile(mode: Mode, segments: Vec<Segment>) -> Profile {
    Profile {
        name: "test".into(),
        description: String::new(),
        mode,
        blocks: vec![Block { repeat: 1, segments }],
        accept: Vec::new(),
    }
}

/// To 2000 N and back in 120 s.
pub fn static_ramp() -> Profile {
    let ramp = |to| Segment::Ramp {
        to: Level::Absolute(to),
        duration_s: 60.0,
    };
    profile(Mode::Force, vec![ramp(2000.0), ramp(0.0)])
}

/// A ramp to 18 mm, a corrected sine around it, and a ramp back.
pub fn sine(amplitude: f64, frequency_hz: f64, cycles: u32) -> Profile {
    profile(
        Mode::Displacement,
        vec![
            Segment::Ramp {
                to: Level::Absolute(18.0),
                duration_s: 4.0,
            },
            Segment::Cycles(CycleSegment {
                wave: Wave::Sine,
                mean: Level::Absolute(18.0),
                amplitude,
                frequency_hz,
                cycles,
                taper_cycles: 3,
                correct: true,
            }),
            Segment::Ramp {
                to: Level::Absolute(0.0),
                duration_s: 4.0,
            },
        ],
    )
}
