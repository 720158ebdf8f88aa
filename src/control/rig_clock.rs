//! How old a sample is: the rig's tick against the host's clock. The quickest arrivals date the rig's clock; a sample
//! that comes later than they did is late by the difference.

const MS: u64 = 1_000_000;
/// The fit follows a rig clock that is off by up to 1000 ppm: 1 us a millisecond tick.
const DRIFT_NS_PER_TICK: i64 = 1_000;

/// Host time of tick 0, fitted to the quickest arrivals.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct RigClock {
    origin_ns: Option<i64>,
}

impl RigClock {
    /// Forgets the fit.
    pub(crate) fn restart(&mut self) {
        self.origin_ns = None;
    }

    /// Takes the arrival of one tick. True for the first after a restart.
    pub(crate) fn take(&mut self, tick: u64, now_ns: u64) -> bool {
        let seen = Self::origin(tick, now_ns);
        let first = self.origin_ns.is_none();
        self.origin_ns = Some(match self.origin_ns {
            Some(origin) => seen.min(origin + DRIFT_NS_PER_TICK),
            None => seen,
        });
        first
    }

    /// Age of a tick in ms beyond the quickest transport.
    pub(crate) fn age_ms(&self, tick: u64, now_ns: u64) -> u64 {
        let late_ns = self
            .origin_ns
            .map_or(0, |origin| Self::origin(tick, now_ns) - origin);
        u64::try_from(late_ns).unwrap_or(0) / MS
    }

    fn origin(tick: u64, now_ns: u64) -> i64 {
        now_ns as i64 - (tick * MS) as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_sample_has_its_lateness_as_age() {
        let mut clock = RigClock::default();
        assert!(clock.take(10, 1_000 * MS));
        assert!(!clock.take(11, 1_001 * MS));
        assert_eq!(clock.age_ms(12, 1_027 * MS), 25);
    }

    #[test]
    fn a_clock_that_runs_fast_by_500_ppm_never_looks_late() {
        let mut clock = RigClock::default();
        for tick in 0..100_000u64 {
            let now_ns = 1_000 * MS + tick * MS + tick * 500;
            clock.take(tick, now_ns);
            assert_eq!(clock.age_ms(tick, now_ns), 0);
        }
    }
}
