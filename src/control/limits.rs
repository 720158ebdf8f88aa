//! The host's detectors, the second layer behind the firmware's limits: silence, lost samples, amplitude too small. They run
//! in every poll.

use crate::units::{NS_PER_MS, NS_PER_S};

/// What control must do, mildest first.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Action {
    /// Keep the position; an operator may resume.
    Hold(String),
    /// NMT stop: the firmware unloads.
    Abort(String),
}

/// Limits of the detectors; faults L1, L2, L9 and H5 of the fault list in `docs`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct DetectorLimits {
    /// A stream without samples for longer is an abort, ms.
    pub silence_ms: u64,
    /// More lost samples within one second are a hold.
    pub lost_per_s: u32,
    /// An amplitude too small by more than this fraction in two counted cycles in a row is a hold.
    pub under_peak: f64,
}

impl Default for DetectorLimits {
    fn default() -> Self {
        DetectorLimits {
            silence_ms: 20,
            lost_per_s: 10,
            under_peak: 0.05,
        }
    }
}

/// Longest time that one pause between two polls adds to the silence, ns.
const PAUSE_MAX_NS: u64 = 5 * NS_PER_MS;

/// State of the detectors over one connection.
#[derive(Debug)]
pub(crate) struct Detectors {
    limits: DetectorLimits,
    last_sample_ns: Option<u64>,
    /// Time that polls without a sample have covered.
    silent_ns: u64,
    last_poll_ns: Option<u64>,
    /// Start of the window of lost samples in ns, and their number in it.
    lost_window: (u64, u32),
    /// Counted cycles in a row with too small an amplitude.
    short_cycles: u32,
}

impl Detectors {
    /// Detectors before the first sample.
    pub(crate) fn new(limits: DetectorLimits) -> Self {
        Detectors {
            limits,
            last_sample_ns: None,
            silent_ns: 0,
            last_poll_ns: None,
            lost_window: (0, 0),
            short_cycles: 0,
        }
    }

    /// Resets the counts of cycles and lost samples at the start of a run.
    pub(crate) fn begin_run(&mut self, now_ns: u64) {
        self.lost_window = (now_ns, 0);
        self.short_cycles = 0;
    }

    /// Takes a sample that arrived at `now_ns` after `lost` missing ones.
    pub(crate) fn on_sample(&mut self, now_ns: u64, lost: u64) -> Option<Action> {
        self.last_sample_ns = Some(now_ns);
        self.silent_ns = 0;
        if lost == 0 {
            return None;
        }
        if now_ns.saturating_sub(self.lost_window.0) > NS_PER_S {
            self.lost_window = (now_ns, 0);
        }
        self.lost_window.1 = self
            .lost_window
            .1
            .saturating_add(u32::try_from(lost).unwrap_or(u32::MAX));
        (self.lost_window.1 > self.limits.lost_per_s).then(|| {
            Action::Hold(format!(
                "{} samples were lost within 1 s (limit {}): check the bus load and the cable, then resume",
                self.lost_window.1, self.limits.lost_per_s
            ))
        })
    }

    /// Milliseconds since the newest sample; `None` before the first.
    pub(crate) fn age_ms(&self, now_ns: u64) -> Option<u64> {
        self.last_sample_ns
            .map(|at| now_ns.saturating_sub(at) / NS_PER_MS)
    }

    /// Detects a silent stream; called once per poll. If this process was stopped, it could not receive samples. So a pause
    /// between two polls counts as [`PAUSE_MAX_NS`] at most; the firmware's lease covers longer pauses.
    pub(crate) fn silence(&mut self, now_ns: u64) -> Option<Action> {
        let pause_ns = now_ns.saturating_sub(self.last_poll_ns.replace(now_ns)?);
        self.last_sample_ns?;
        self.silent_ns += pause_ns.min(PAUSE_MAX_NS);
        (self.silent_ns > self.limits.silence_ms * NS_PER_MS).then(|| {
            Action::Abort(format!(
                "no sample for {} ms (limit {} ms), the rig unloads by itself: check the link and the rig",
                self.age_ms(now_ns).unwrap_or(0),
                self.limits.silence_ms
            ))
        })
    }

    /// Takes the amplitude of a counted cycle that ended; `asked` is the amplitude of the profile.
    pub(crate) fn on_cycle(&mut self, cycle: u32, asked: f64, measured: f64) -> Option<Action> {
        if asked <= 0.0 || measured >= asked * (1.0 - self.limits.under_peak) {
            self.short_cycles = 0;
            return None;
        }
        self.short_cycles += 1;
        (self.short_cycles >= 2).then(|| {
            Action::Hold(format!(
                "the amplitude of cycle {cycle} is {measured:.3} instead of {asked:.3}, as in the cycle before (limit {:.0} % too small), the actuator cannot follow: lower the frequency or the amplitude",
                100.0 * self.limits.under_peak
            ))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_is_detected_after_its_limit_and_not_before() {
        let mut d = Detectors::new(DetectorLimits::default());
        assert!(
            (0..1000).all(|ms| d.silence(ms * NS_PER_MS).is_none()),
            "no silence before the first sample"
        );
        d.on_sample(1000 * NS_PER_MS, 0);
        assert!((1000..=1019).all(|ms| d.silence(ms * NS_PER_MS).is_none()));
        assert!((1020..=1022).any(|ms| matches!(d.silence(ms * NS_PER_MS), Some(Action::Abort(_)))));
    }

    #[test]
    fn a_pause_of_the_host_itself_is_no_silence() {
        let mut d = Detectors::new(DetectorLimits::default());
        d.silence(0);
        d.on_sample(0, 0);
        assert_eq!(d.silence(500 * NS_PER_MS), None);
        d.on_sample(501 * NS_PER_MS, 0);
        assert_eq!(d.silence(502 * NS_PER_MS), None);
    }

    #[test]
    fn a_few_lost_samples_are_counted_many_in_a_second_hold() {
        let mut d = Detectors::new(DetectorLimits::default());
        d.begin_run(0);
        assert_eq!(d.on_sample(10 * NS_PER_MS, 3), None);
        assert_eq!(d.on_sample(20 * NS_PER_MS, 7), None);
        assert!(matches!(d.on_sample(30 * NS_PER_MS, 1), Some(Action::Hold(_))));
        assert_eq!(d.on_sample(2_000 * NS_PER_MS, 3), None, "the window moves on");
    }

    #[test]
    fn too_small_an_amplitude_needs_two_cycles_in_a_row() {
        let mut d = Detectors::new(DetectorLimits::default());
        assert_eq!(d.on_cycle(1, 6.0, 5.6), None);
        assert_eq!(d.on_cycle(2, 6.0, 5.95), None);
        assert_eq!(d.on_cycle(3, 6.0, 5.6), None);
        assert!(matches!(d.on_cycle(4, 6.0, 5.6), Some(Action::Hold(_))));
    }
}
