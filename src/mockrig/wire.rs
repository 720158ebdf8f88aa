//! The wire at the rig's end, with the faults of a link: frames that are lost, changed, repeated, out of order, late, or of another node.

use std::collections::VecDeque;

use rand::rand_core::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::link::Link;
use crate::protocol::cob;
use crate::protocol::frame::Frame;
use crate::protocol::message::{COUNTER_MODULO, FromRig, LeaseMessage, SampleMessage, ToRig};

/// Faults of the link; none by default. Shares are of the frames, 0 to 1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct WireFaults {
    /// Share of the samples that is lost.
    pub sample_lost: f64,
    /// Share of the status frames that is lost.
    pub status_lost: f64,
    /// Share of the emergency frames that is lost.
    pub emergency_lost: f64,
    /// Share of the leases that is lost.
    pub lease_lost: f64,
    /// Share of the commands that is lost.
    pub command_lost: f64,
    /// Share of the requests that is lost.
    pub request_lost: f64,
    /// Share of the NMT frames that is lost.
    pub abort_lost: f64,
    /// No frame passes.
    pub silent: bool,
    /// Share of the frames to the host in which one bit changes.
    pub corrupt: f64,
    /// Share of the frames to the rig in which one bit changes.
    pub host_corrupt: f64,
    /// Share of the frames to the host that arrives twice.
    pub repeated: f64,
    /// Share of the frames to the host that arrives after the next one.
    pub reordered: f64,
    /// Largest delay of the frames to the host, ms.
    pub late_ms: f64,
    /// Another host sends leases of its own.
    pub second_host: bool,
    /// Another rig of this node sends samples.
    pub second_rig: bool,
}

/// The delay of frames grows by one tick in this many.
const LATE_GROWS_TICKS: u64 = 3;
/// Period of the lease of a second host, ticks.
const SECOND_HOST_TICKS: u64 = 10;
/// Session of the second host; a session of leafbench is never this by chance alone, and then nothing happens.
const SECOND_SESSION: u8 = 255;

/// The wire with the frames that are on their way.
pub(super) struct Wire {
    pub faults: WireFaults,
    node: u8,
    tick: u64,
    /// Tick at which frames began to be late.
    late_since: Option<u64>,
    random: ChaCha8Rng,
    /// A frame that waits for the next one.
    held: Option<Frame>,
    /// Frames that are late, with the tick at which they arrive.
    late: VecDeque<(u64, Frame)>,
}

impl Wire {
    /// A sound wire of the rig `node`.
    pub(super) fn new(node: u8, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(3);
        Wire {
            faults: WireFaults::default(),
            node,
            tick: 0,
            late_since: None,
            random,
            held: None,
            late: VecDeque::new(),
        }
    }

    /// Begins a tick: late frames whose time has come arrive, and another rig sends its sample.
    pub(super) fn begin_tick(&mut self, link: &mut Link) {
        self.tick += 1;
        let late_since = self.late_since.unwrap_or(self.tick);
        self.late_since = (self.faults.late_ms > 0.0).then_some(late_since);
        while let Some(&(due, frame)) = self.late.front()
            && due <= self.tick
        {
            self.late.pop_front();
            link.send(frame);
        }
        if self.faults.second_rig {
            let sample = SampleMessage {
                // The counter and the tick of a rig that was started at another time.
                counter: ((self.tick + 7) % u64::from(COUNTER_MODULO)) as u8,
                tick: (self.tick as u16).wrapping_add(20_000),
                force_counts: 0,
                displacement_counts: 0,
            };
            link.send(FromRig::Sample(sample).encode(self.node));
        }
    }

    /// The frame of another host in this tick.
    pub(super) fn foreign(&mut self) -> Option<ToRig> {
        let due = self.faults.second_host && self.tick.is_multiple_of(SECOND_HOST_TICKS);
        due.then(|| {
            ToRig::Lease(LeaseMessage {
                counter: (self.tick / SECOND_HOST_TICKS % u64::from(COUNTER_MODULO)) as u8,
                session: SECOND_SESSION,
                control_tick: self.tick as u16,
            })
        })
    }

    /// Sends a frame of the rig.
    pub(super) fn send(&mut self, frame: Frame, urgent: bool, link: &mut Link) {
        if self.faults == WireFaults::default() && self.late.is_empty() && self.held.is_none() {
            // The link counts what it refuses.
            let _ = match urgent {
                true => link.send_urgent(frame),
                false => link.send(frame),
            };
            return;
        }
        let function = frame.id.wrapping_sub(u16::from(self.node));
        let lost = match function {
            cob::SAMPLE => self.faults.sample_lost,
            cob::STATUS => self.faults.status_lost,
            cob::EMERGENCY => self.faults.emergency_lost,
            _ => 0.0,
        };
        if self.faults.silent || self.happens(lost) {
            return;
        }
        let frame = self.changed(frame, self.faults.corrupt);
        let repeated = self.happens(self.faults.repeated);
        if self.held.is_none() && self.happens(self.faults.reordered) {
            self.held = Some(frame);
            return;
        }
        self.passes(frame, link);
        if repeated {
            self.passes(frame, link);
        }
        if let Some(held) = self.held.take() {
            self.passes(held, link);
        }
    }

    fn passes(&mut self, frame: Frame, link: &mut Link) {
        let grown = self
            .late_since
            .map_or(0, |since| (self.tick - since) / LATE_GROWS_TICKS);
        let due = self.tick + grown.min(self.faults.late_ms as u64);
        // No frame overtakes another one.
        let due = self.late.back().map_or(due, |(last, _)| due.max(*last));
        if due > self.tick {
            self.late.push_back((due, frame));
        } else {
            link.send(frame);
        }
    }

    /// The frame of the host as it arrives at the rig.
    pub(super) fn arrives(&mut self, frame: Frame) -> Option<Frame> {
        let faults = self.faults;
        if faults == WireFaults::default() {
            return Some(frame);
        }
        let lost = match frame.id {
            cob::NMT => faults.abort_lost,
            id => match id.wrapping_sub(u16::from(self.node)) {
                cob::LEASE => faults.lease_lost,
                cob::COMMAND => faults.command_lost,
                cob::REQUEST => faults.request_lost,
                _ => 0.0,
            },
        };
        if faults.silent || self.happens(lost) {
            return None;
        }
        Some(self.changed(frame, faults.host_corrupt))
    }

    /// The frame with one bit changed, in a share of the cases. NMT and configuration have no checksum in the frame: the CAN
    /// frame around them has one.
    fn changed(&mut self, mut frame: Frame, share: f64) -> Frame {
        let function = frame.id.wrapping_sub(u16::from(self.node));
        let protected = [
            cob::SAMPLE,
            cob::STATUS,
            cob::EMERGENCY,
            cob::COMMAND,
            cob::LEASE,
            cob::REQUEST,
        ];
        if protected.contains(&function) && self.happens(share) {
            let bit = self.random.next_u64() % (8 * u64::from(frame.len.max(1)));
            if let Some(byte) = frame.data.get_mut((bit / 8) as usize) {
                *byte ^= 1 << (bit % 8);
            }
        }
        frame
    }

    fn happens(&mut self, share: f64) -> bool {
        share > 0.0 && ((self.random.next_u64() >> 11) as f64 / (1u64 << 53) as f64) < share
    }
}
