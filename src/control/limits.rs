//! The host's own detectors, the second layer behind the firmware's limits: silence, lost samples, age, under-peak.
//! Each is checked in the poll that reads the sample, never by a watcher that may not be attached.

const MS: u64 = 1_000_000;

/// What a detector asks for, mildest first.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Action {
    /// Keep the position; an operator may resume.
    Hold(String),
    /// NMT stop: the firmware unloads.
    Abort(String),
}

/// Figures of the detectors (faults.md, ids L1, L2, L9, H5).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct DetectorLimits {
    /// Sample stream silent for longer is an abort.
    pub silence_ms: u64,
    /// More samples lost within a second is a hold.
    pub lost_per_s: u32,
    /// Amplitude short by more than this share over two counted cycles is a hold.
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

/// Longest pause between two polls that counts as looking at the stream.
const LOOK_MS: u64 = 5;

/// State of the detectors over one connection.
#[derive(Debug)]
pub(crate) struct Detectors {
    limits: DetectorLimits,
    last_sample_ns: Option<u64>,
    /// How long polls have looked and found no sample.
    looked_in_vain_ns: u64,
    last_look_ns: Option<u64>,
    lost_window: (u64, u32),
    short_cycles: u32,
}

impl Detectors {
    /// Detectors that have seen nothing yet.
    pub(crate) fn new(limits: DetectorLimits) -> Self {
        Detectors {
            limits,
            last_sample_ns: None,
            looked_in_vain_ns: 0,
            last_look_ns: None,
            lost_window: (0, 0),
            short_cycles: 0,
        }
    }

    /// A run starts: counts of cycles and losses begin anew.
    pub(crate) fn begin_run(&mut self, now_ns: u64) {
        self.lost_window = (now_ns, 0);
        self.short_cycles = 0;
    }

    /// A sample came at `now_ns` after `lost` missing ones.
    pub(crate) fn on_sample(&mut self, now_ns: u64, lost: u64) -> Option<Action> {
        self.last_sample_ns = Some(now_ns);
        self.looked_in_vain_ns = 0;
        if lost == 0 {
            return None;
        }
        if now_ns.saturating_sub(self.lost_window.0) > 1000 * MS {
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
        self.last_sample_ns.map(|at| now_ns.saturating_sub(at) / MS)
    }

    /// The stream is silent for too long; asked once a poll. A host that was itself stopped cannot judge the stream: a
    /// pause between two looks counts as [`LOOK_MS`] at most, and the firmware's lease covers the rest.
    pub(crate) fn silence(&mut self, now_ns: u64) -> Option<Action> {
        let since_look_ns = now_ns.saturating_sub(self.last_look_ns.replace(now_ns)?);
        self.last_sample_ns?;
        self.looked_in_vain_ns += since_look_ns.min(LOOK_MS * MS);
        (self.looked_in_vain_ns > self.limits.silence_ms * MS).then(|| {
            Action::Abort(format!(
                "no sample for {} ms (limit {} ms): the rig unloads by itself; check link and rig",
                self.age_ms(now_ns).unwrap_or(0),
                self.limits.silence_ms
            ))
        })
    }

    /// A counted cycle ended with `measured` amplitude where `asked` was asked for.
    pub(crate) fn on_cycle(&mut self, cycle: u32, asked: f64, measured: f64) -> Option<Action> {
        if asked <= 0.0 || measured >= asked * (1.0 - self.limits.under_peak) {
            self.short_cycles = 0;
            return None;
        }
        self.short_cycles += 1;
        (self.short_cycles >= 2).then(|| {
            Action::Hold(format!(
                "amplitude {measured:.3} of {asked:.3} asked for in cycle {cycle} and the one before (limit {:.0} % short): the actuator cannot follow; lower frequency or amplitude",
                100.0 * self.limits.under_peak
            ))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_is_seen_after_its_limit_and_not_before() {
        let mut d = Detectors::new(DetectorLimits::default());
        assert!(
            (0..1000).all(|ms| d.silence(ms * MS).is_none()),
            "nothing heard yet is not silence"
        );
        d.on_sample(1000 * MS, 0);
        assert!((1000..=1019).all(|ms| d.silence(ms * MS).is_none()));
        assert!((1020..=1022).any(|ms| matches!(d.silence(ms * MS), Some(Action::Abort(_)))));
    }

    #[test]
    fn a_host_that_was_stopped_itself_looks_again_before_it_judges() {
        let mut d = Detectors::new(DetectorLimits::default());
        d.silence(0);
        d.on_sample(0, 0);
        assert_eq!(d.silence(500 * MS), None);
        d.on_sample(501 * MS, 0);
        assert_eq!(d.silence(502 * MS), None);
    }

    #[test]
    fn a_few_lost_samples_are_counted_many_in_a_second_hold() {
        let mut d = Detectors::new(DetectorLimits::default());
        d.begin_run(0);
        assert_eq!(d.on_sample(10 * MS, 3), None);
        assert_eq!(d.on_sample(20 * MS, 7), None);
        assert!(matches!(d.on_sample(30 * MS, 1), Some(Action::Hold(_))));
        assert_eq!(d.on_sample(2_000 * MS, 3), None, "the window moves on");
    }

    #[test]
    fn under_peak_needs_two_cycles_in_a_row() {
        let mut d = Detectors::new(DetectorLimits::default());
        assert_eq!(d.on_cycle(1, 6.0, 5.6), None);
        assert_eq!(d.on_cycle(2, 6.0, 5.95), None);
        assert_eq!(d.on_cycle(3, 6.0, 5.6), None);
        assert!(matches!(d.on_cycle(4, 6.0, 5.6), Some(Action::Hold(_))));
    }
}
