//! The host's detectors, the second layer behind the firmware's limits. Each one is a small state machine that is fed by
//! `control` and says what must be done; `docs/faults.md` lists their faults.
//!
//! | file | finds |
//! |---|---|
//! | `silence` | streams that stopped |
//! | `window` | bursts and rates of events |
//! | `values` | readings beyond the limits, sensors without a reading |
//! | `plausibility` | sensors that cannot be right |
//! | `obedience` | a rig that does not do what the commands ask |

mod obedience;
mod plausibility;
mod silence;
mod values;
mod window;

use super::channel::Reading;
use super::physical_limits::PhysicalLimits;
use crate::detector;
use crate::protocol::message::RigState;
use crate::recording::Flags;
use crate::units::{NS_PER_MS, NS_PER_S};

pub(crate) use obedience::Expected;
use obedience::ObedienceWatch;
pub(crate) use plausibility::JudgedSample;
use plausibility::PlausibilityWatch;
use silence::Silence;
use values::ValueWatch;
use window::{Burst, Rate};

/// What control must do, mildest first.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Action {
    /// Tell the operator and write it into the run, which goes on.
    Tell(String),
    /// Keep the position; an operator may resume.
    Hold(String),
    /// NMT stop: the firmware unloads.
    Abort(String),
}

/// Limits of the detectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct DetectorLimits {
    /// A stream without samples for longer, or with samples that are later than this, is an abort, ms (faults L2, L9).
    pub silence_ms: u64,
    /// Samples without a status for longer are an abort, ms.
    pub status_silence_ms: u64,
    /// More lost samples within one second are a hold (fault L1).
    pub lost_per_s: u64,
    /// A larger share of bad packets within one second is an abort (fault T2).
    pub bad_packets: f64,
    /// An amplitude too small by more than this fraction in two counted cycles in a row is a hold (fault H5).
    pub under_peak: f64,
}

impl Default for DetectorLimits {
    fn default() -> Self {
        DetectorLimits {
            silence_ms: 20,
            status_silence_ms: 100,
            lost_per_s: 10,
            bad_packets: 0.01,
            under_peak: 0.05,
        }
    }
}

/// This many damaged frames within [`CORRUPT_WINDOW_NS`] are an abort (faults L6 and L10).
const CORRUPT_FRAMES: usize = 3;
const CORRUPT_WINDOW_NS: u64 = 100 * NS_PER_MS;
/// Fewer bad packets in a second than this are noise, whatever their share.
const BAD_PACKETS_LEAST: u64 = 5;
/// This many late samples in a row are an abort. A single one can be a frame that a bridge held back.
const LATE_SAMPLES: u32 = 3;

/// What is wrong with a frame that was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Damage {
    /// Its checksum or a field.
    Content,
    /// Its counter or tick, with a right checksum.
    Sequence,
}

/// Counters of a link at one moment, each since the link was opened.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct LinkCounts {
    /// Times that the CAN controller reported bus-off.
    pub bus_off: u64,
    /// Frames lost in the receive queue of this computer.
    pub overflows: u64,
    /// Serial packets dropped for their framing, length or CRC-16.
    pub bad_packets: u64,
    /// Serial packets received without an error.
    pub good_packets: u64,
}

/// State of the detectors over one connection.
#[derive(Debug)]
pub(crate) struct Detectors {
    limits: DetectorLimits,
    last_poll_ns: Option<u64>,
    samples: Silence,
    statuses: Silence,
    last_sample_ns: Option<u64>,
    lost: Rate,
    corrupt: Burst<CORRUPT_FRAMES>,
    /// Frames in a row that were out of sequence and had a right checksum.
    whole_frames: u32,
    packets: Rate,
    link: LinkCounts,
    late_samples: u32,
    values: ValueWatch,
    plausibility: PlausibilityWatch,
    obedience: ObedienceWatch,
    /// Counted cycles in a row with too small an amplitude.
    short_cycles: u32,
}

impl Detectors {
    /// Detectors before the first sample.
    pub(crate) fn new(limits: DetectorLimits) -> Self {
        Detectors {
            limits,
            last_poll_ns: None,
            samples: Silence::default(),
            statuses: Silence::default(),
            last_sample_ns: None,
            lost: Rate::default(),
            corrupt: Burst::default(),
            whole_frames: 0,
            packets: Rate::default(),
            link: LinkCounts::default(),
            late_samples: 0,
            values: ValueWatch::default(),
            plausibility: PlausibilityWatch::default(),
            obedience: ObedienceWatch::default(),
            short_cycles: 0,
        }
    }

    /// Resets what belongs to one run.
    pub(crate) fn begin_run(&mut self) {
        self.lost = Rate::default();
        self.corrupt = Burst::default();
        self.whole_frames = 0;
        self.packets = Rate::default();
        self.late_samples = 0;
        self.values = ValueWatch::default();
        self.plausibility = PlausibilityWatch::default();
        self.obedience = ObedienceWatch::default();
        self.short_cycles = 0;
    }

    /// Forgets the stream after a reboot of the rig or a loss of the link.
    pub(crate) fn forget_stream(&mut self) {
        self.samples.forget();
        self.statuses.forget();
    }

    /// Judges both readings of a sample. Returns its flags and what is wrong.
    pub(crate) fn judge(&mut self, now_ns: u64, judged: &JudgedSample) -> (Flags, Option<Action>) {
        self.plausibility.take(now_ns, judged)
    }

    /// Takes a sample that arrived at `now_ns` after `lost` missing ones, `age_ms` late on the link.
    pub(crate) fn on_sample(
        &mut self,
        now_ns: u64,
        lost: u64,
        age_ms: u64,
        reading: &Reading,
        limits: &PhysicalLimits,
    ) -> Option<Action> {
        self.last_sample_ns = Some(now_ns);
        self.samples.hear();
        let of_values = self
            .values
            .take(reading, limits)
            .filter(|_| detector::acts("F8"))
            .map(Action::Abort);
        of_values
            .or_else(|| self.late(age_ms))
            .or_else(|| self.lost(now_ns, lost))
    }

    fn late(&mut self, age_ms: u64) -> Option<Action> {
        let limit_ms = self.limits.silence_ms;
        self.late_samples = if age_ms > limit_ms {
            self.late_samples.saturating_add(1)
        } else {
            0
        };
        (self.late_samples >= LATE_SAMPLES && detector::acts("L9")).then(|| {
            Action::Abort(format!(
                "samples arrive {age_ms} ms late (limit {limit_ms} ms): check the link for a bridge or an adapter that collects frames"
            ))
        })
    }

    fn lost(&mut self, now_ns: u64, lost: u64) -> Option<Action> {
        if lost == 0 {
            return None;
        }
        let [within_1s, _] = self.lost.add([lost, 0], now_ns, NS_PER_S);
        (within_1s > self.limits.lost_per_s && detector::acts("L1")).then(|| {
            Action::Hold(format!(
                "{within_1s} samples were lost within 1 s (limit {}): check the bus load and the cable, then resume",
                self.limits.lost_per_s
            ))
        })
    }

    /// Milliseconds since the newest sample; `None` before the first.
    pub(crate) fn age_ms(&self, now_ns: u64) -> Option<u64> {
        self.last_sample_ns
            .map(|at| now_ns.saturating_sub(at) / NS_PER_MS)
    }

    /// Takes a status.
    pub(crate) fn on_status(&mut self) {
        self.statuses.hear();
    }

    /// Compares a status that came at the sample `tick` with what the run expects.
    pub(crate) fn on_progress(
        &mut self,
        state: RigState,
        queue_ms: u8,
        tick: u64,
        expected: Expected,
    ) -> Option<Action> {
        self.obedience
            .take(state, queue_ms, tick, expected)
            .filter(|_| detector::acts("F7"))
            .map(Action::Abort)
    }

    /// Ends a poll, after its frames: finds streams that stopped.
    pub(crate) fn end_poll(&mut self, now_ns: u64) -> Option<Action> {
        let pause_ns = now_ns.saturating_sub(self.last_poll_ns.replace(now_ns).unwrap_or(now_ns));
        self.samples.end_poll(pause_ns);
        self.statuses.end_poll(pause_ns);
        if let Some(ms) = self
            .samples
            .beyond_ms(self.limits.silence_ms)
            .filter(|_| detector::acts("L2"))
        {
            return Some(Action::Abort(format!(
                "no sample for {ms} ms (limit {} ms): check the link and the rig",
                self.limits.silence_ms
            )));
        }
        self.status_silence_ms().map(|ms| {
            Action::Abort(format!(
                "no status for {ms} ms (limit {} ms) while samples arrive, so the state of the rig is unknown: check the firmware and the link",
                self.limits.status_silence_ms
            ))
        })
    }

    /// Milliseconds without a status, if they exceed the limit.
    pub(crate) fn status_silence_ms(&self) -> Option<u64> {
        self.statuses
            .beyond_ms(self.limits.status_silence_ms)
            .filter(|_| detector::acts("L16"))
    }

    /// Takes a frame that was refused: for its content, or because counter or tick is out of sequence.
    pub(crate) fn on_damaged_frame(&mut self, damage: Damage, now_ns: u64) -> Option<Action> {
        // Noise on the cable does not write right checksums.
        self.whole_frames = match damage {
            Damage::Content => 0,
            Damage::Sequence => self.whole_frames.saturating_add(1),
        };
        let is_masquerade = self.whole_frames as usize >= CORRUPT_FRAMES && detector::acts("L10");
        let found = self.corrupt.hit(now_ns, CORRUPT_WINDOW_NS) && detector::acts("L6");
        found.then(|| {
            Action::Abort(match is_masquerade {
                true => format!(
                    "masquerade: {CORRUPT_FRAMES} damaged frames within 100 ms, all with a right checksum and a wrong counter or tick: a second rig uses this node number, or the link changes the order of frames"
                ),
                false => format!(
                    "{CORRUPT_FRAMES} damaged frames within 100 ms: check cable, termination and shielding, and that no second rig has this node"
                ),
            })
        })
    }

    /// Takes the link's counters. A link that was opened again counts from zero.
    pub(crate) fn on_link(&mut self, now: LinkCounts, now_ns: u64) -> Option<Action> {
        let before = std::mem::replace(&mut self.link, now);
        let more = |now: u64, before: u64| now.saturating_sub(before);
        let bad = more(now.bad_packets, before.bad_packets);
        let good = more(now.good_packets, before.good_packets);
        let [bad, good] = self.packets.add([bad, good], now_ns, NS_PER_S);
        if more(now.bus_off, before.bus_off) > 0 && detector::acts("L3") {
            return Some(Action::Abort(
                "the CAN controller went bus-off: check bit rate, termination and wiring, then set the interface down and up".to_owned(),
            ));
        }
        if detector::acts("T2")
            && bad >= BAD_PACKETS_LEAST
            && bad as f64 > self.limits.bad_packets * (bad + good) as f64
        {
            return Some(Action::Abort(format!(
                "{bad} of {} serial packets within 1 s were damaged: check cable, bit rate and adapter",
                bad + good
            )));
        }
        let lost = more(now.overflows, before.overflows);
        (lost > 0 && detector::acts("L11")).then(|| {
            Action::Hold(format!(
                "{lost} frames were lost in this computer's receive queue: end other programs, then resume"
            ))
        })
    }

    /// Takes the amplitude of a counted cycle that ended; `asked` is the amplitude of the profile.
    pub(crate) fn on_cycle(&mut self, cycle: u32, asked: f64, measured: f64) -> Option<Action> {
        if asked <= 0.0 || measured >= asked * (1.0 - self.limits.under_peak) || !detector::acts("H5") {
            self.short_cycles = 0;
            return None;
        }
        self.short_cycles += 1;
        let short = format!(
            "the amplitude of cycle {cycle} is {measured:.3} instead of {asked:.3} (limit {:.0} % too small)",
            100.0 * self.limits.under_peak
        );
        Some(match self.short_cycles {
            1 => Action::Tell(format!("{short}: the cycle is not valid")),
            _ => Action::Hold(format!(
                "{short}, as in the cycle before, neither is valid, the actuator cannot follow: lower the frequency or the amplitude"
            )),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::Flags;

    const LIMITS: PhysicalLimits = PhysicalLimits::EXAMPLE;
    const STILL: Reading = Reading {
        force_n: 0.0,
        displacement_mm: 0.0,
        flags: Flags::empty(),
    };

    fn detectors() -> Detectors {
        Detectors::new(DetectorLimits::default())
    }

    fn sample(d: &mut Detectors, ms: u64, lost: u64, age_ms: u64) -> Option<Action> {
        d.on_sample(ms * NS_PER_MS, lost, age_ms, &STILL, &LIMITS)
    }

    #[test]
    fn samples_without_status_are_found() {
        let mut d = detectors();
        d.on_status();
        let found = (0..200).find_map(|ms| {
            sample(&mut d, ms, 0, 0);
            d.end_poll(ms * NS_PER_MS).map(|action| (ms, action))
        });
        let (ms, Action::Abort(text)) = found.expect("found") else {
            panic!("a hold");
        };
        assert!(ms == 101 && text.contains("no status for 101 ms"), "{ms}: {text}");
    }

    #[test]
    fn a_few_lost_samples_are_counted_many_in_a_second_hold() {
        let mut d = detectors();
        assert_eq!(sample(&mut d, 990, 6, 0), None);
        assert!(
            matches!(sample(&mut d, 1010, 6, 0), Some(Action::Hold(_))),
            "12 within 20 ms, across the start of a second"
        );
        assert_eq!(sample(&mut d, 4_000, 3, 0), None, "the window moves on");
    }

    #[test]
    fn samples_that_stay_late_abort_a_single_one_does_not() {
        let mut d = detectors();
        assert_eq!(sample(&mut d, 1, 0, 150), None);
        assert_eq!(sample(&mut d, 2, 0, 0), None);
        assert_eq!(sample(&mut d, 3, 0, 21), None);
        assert_eq!(sample(&mut d, 4, 0, 21), None);
        assert!(matches!(sample(&mut d, 5, 0, 21), Some(Action::Abort(_))));
    }

    #[test]
    fn three_damaged_frames_in_a_tenth_of_a_second_abort() {
        let mut d = detectors();
        assert_eq!(d.on_damaged_frame(Damage::Content, 0), None);
        assert_eq!(d.on_damaged_frame(Damage::Content, 50 * NS_PER_MS), None);
        assert!(matches!(
            d.on_damaged_frame(Damage::Sequence, 90 * NS_PER_MS),
            Some(Action::Abort(_))
        ));
    }

    fn packets(bad_packets: u64, good_packets: u64) -> LinkCounts {
        LinkCounts {
            bad_packets,
            good_packets,
            ..LinkCounts::default()
        }
    }

    #[test]
    fn one_percent_of_damaged_packets_aborts_fewer_than_five_do_not() {
        let mut d = detectors();
        assert_eq!(
            d.on_link(packets(4, 100), 0),
            None,
            "four of a hundred are too few"
        );
        assert_eq!(d.on_link(packets(4, 2000), NS_PER_S / 2), None);
        assert_eq!(
            d.on_link(packets(12, 2000), NS_PER_S * 9 / 10),
            None,
            "12 of 2012"
        );
        let action = d.on_link(packets(30, 2100), NS_PER_S * 19 / 20);
        assert!(matches!(action, Some(Action::Abort(_))), "30 of 2130");
    }

    #[test]
    fn bus_off_aborts_and_an_overflow_holds() {
        let mut d = detectors();
        let counts = LinkCounts {
            bus_off: 1,
            overflows: 3,
            ..LinkCounts::default()
        };
        assert!(matches!(d.on_link(counts, 0), Some(Action::Abort(_))));
        assert_eq!(d.on_link(counts, NS_PER_MS), None, "each report counts once");
        let counts = LinkCounts {
            overflows: 7,
            ..counts
        };
        let Some(Action::Hold(text)) = d.on_link(counts, 2 * NS_PER_MS) else {
            panic!("no hold");
        };
        assert!(text.contains("4 frames"), "{text}");
    }

    #[test]
    fn too_small_an_amplitude_needs_two_cycles_in_a_row() {
        let mut d = detectors();
        assert!(matches!(d.on_cycle(1, 6.0, 5.6), Some(Action::Tell(_))));
        assert_eq!(d.on_cycle(2, 6.0, 5.95), None);
        assert!(matches!(d.on_cycle(3, 6.0, 5.6), Some(Action::Tell(_))));
        assert!(matches!(d.on_cycle(4, 6.0, 5.6), Some(Action::Hold(_))));
    }
}
