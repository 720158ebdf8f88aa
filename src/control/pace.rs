//! Time of a rig in memory that the control loop steps itself. It follows the host's clock in whole ticks and never jumps: a
//! computer that is busy slows rig and control down together, so that neither looks broken to the other.

use crate::protocol::tick::TICK_NS;
use crate::units::NS_PER_S;

/// Most ticks in one turn of the loop. Between two turns the loop takes a request and publishes its status.
const TICKS_PER_TURN: u64 = 20;
/// The rig's time catches up with the host's if it is behind by no more than this, ns. A longer delay is skipped: a test that
/// runs at twenty times its speed for long helps nobody.
const CATCH_UP_NS: u64 = NS_PER_S;

/// The time of a stepped rig.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pace {
    /// Time of the newest tick, ns: the host's clock at the start, then one tick period more each.
    newest_ns: u64,
    /// Host time that was skipped so far, ns.
    skipped_ns: u64,
}

impl Pace {
    /// Starts at `now_ns` on the host's monotonic clock.
    pub(super) fn new(now_ns: u64) -> Self {
        Pace {
            newest_ns: now_ns,
            skipped_ns: 0,
        }
    }

    /// Ticks to make in this turn.
    pub(super) fn due(&mut self, now_ns: u64) -> u64 {
        let behind_ns = now_ns.saturating_sub(self.newest_ns + self.skipped_ns);
        if behind_ns > CATCH_UP_NS {
            self.skipped_ns += behind_ns - TICK_NS;
            return 1;
        }
        (behind_ns / TICK_NS).min(TICKS_PER_TURN)
    }

    /// Time of the next tick, which is made now.
    pub(super) fn tick(&mut self) -> u64 {
        self.newest_ns += TICK_NS;
        self.newest_ns
    }

    /// Time of the newest tick in ns.
    pub(super) fn newest_ns(&self) -> u64 {
        self.newest_ns
    }

    /// Host time that was skipped so far, in ms.
    pub(super) fn skipped_ms(&self) -> u64 {
        self.skipped_ns / crate::units::NS_PER_MS
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::NS_PER_MS;

    /// One turn at `now_ms`; returns its ticks.
    fn turn(pace: &mut Pace, now_ms: u64) -> u64 {
        let due = pace.due(now_ms * NS_PER_MS);
        (0..due).for_each(|_| {
            pace.tick();
        });
        due
    }

    #[test]
    fn a_tick_a_millisecond_and_none_twice() {
        let mut pace = Pace::new(NS_PER_S);
        assert!((1001..2000).all(|ms| turn(&mut pace, ms) == 1));
        assert_eq!(turn(&mut pace, 1999), 0);
        assert_eq!(pace.newest_ns(), 1999 * NS_PER_MS);
    }

    #[test]
    fn a_stall_is_made_up_in_bounded_portions() {
        let mut pace = Pace::new(0);
        let ticks: Vec<u64> = (500..530).map(|ms| turn(&mut pace, ms)).collect();
        assert!(ticks.iter().all(|&ticks| ticks <= TICKS_PER_TURN), "{ticks:?}");
        assert_eq!(ticks.iter().sum::<u64>(), 529, "none is left out");
        assert_eq!(pace.skipped_ms(), 0);
    }

    #[test]
    fn a_long_stall_is_skipped_and_counted() {
        let mut pace = Pace::new(0);
        assert_eq!(turn(&mut pace, 5_000), 1);
        assert_eq!(turn(&mut pace, 5_001), 1);
        assert_eq!((pace.newest_ns(), pace.skipped_ms()), (2 * NS_PER_MS, 4_999));
    }
}
