//! The age of a sample: the rig's tick against the host's clock. The fastest arrivals fix the offset between the two; a
//! sample that arrives later than they did is late by the difference.

use crate::protocol::tick::TICK_NS;
use crate::units::NS_PER_MS;

/// The fit follows a rig clock whose rate is off by up to 1000 ppm.
const DRIFT_NS_PER_TICK: i64 = TICK_NS as i64 / 1000;

/// Host time of tick 0, fitted to the fastest arrivals.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct RigClock {
    origin_ns: Option<i64>,
}

impl RigClock {
    /// Forgets the fit.
    pub(crate) fn restart(&mut self) {
        self.origin_ns = None;
    }

    /// Takes the arrival of one tick. Returns true for the first one after a restart.
    pub(crate) fn take(&mut self, tick: u64, now_ns: u64) -> bool {
        let seen = Self::origin(tick, now_ns);
        let first = self.origin_ns.is_none();
        self.origin_ns = Some(match self.origin_ns {
            Some(origin) => seen.min(origin + DRIFT_NS_PER_TICK),
            None => seen,
        });
        first
    }

    /// Delay of a tick in ms beyond the fastest transport.
    pub(crate) fn age_ms(&self, tick: u64, now_ns: u64) -> u64 {
        let late_ns = self
            .origin_ns
            .map_or(0, |origin| Self::origin(tick, now_ns) - origin);
        u64::try_from(late_ns).unwrap_or(0) / NS_PER_MS
    }

    fn origin(tick: u64, now_ns: u64) -> i64 {
        now_ns as i64 - (tick * TICK_NS) as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_age_of_a_late_sample_is_its_delay() {
        let mut clock = RigClock::default();
        assert!(clock.take(10, 1_000 * TICK_NS));
        assert!(!clock.take(11, 1_001 * TICK_NS));
        assert_eq!(clock.age_ms(12, 1_002 * TICK_NS + 25 * NS_PER_MS), 25);
    }

    #[test]
    fn a_clock_that_runs_fast_by_500_ppm_never_looks_late() {
        let mut clock = RigClock::default();
        for tick in 0..100_000u64 {
            let now_ns = 1_000 * TICK_NS + tick * (TICK_NS + TICK_NS / 2000);
            clock.take(tick, now_ns);
            assert_eq!(clock.age_ms(tick, now_ns), 0);
        }
    }
}
