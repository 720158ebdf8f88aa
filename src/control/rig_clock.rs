//! The rig's clock against the host's: how late the link delivered a sample, and how far the two clocks drift apart.
//!
//! A sample that is read in one poll arrived after the poll before it and before the poll after it. So what waited in this
//! computer, because control was not running, is never taken for a delay of the link: it arrived, as far as anyone can tell,
//! right after the poll before. The fastest arrivals of the last two seconds fix the offset between the clocks.

use crate::protocol::tick::TICK_NS;
use crate::units::{NS_PER_MS, NS_PER_S};

/// One stretch of the fit, ns. At half of it a busy computer leaves too few fast arrivals, at double of it a rig clock that
/// stood still makes samples late for twice as long.
const STRETCH_NS: u64 = NS_PER_S;
/// A poll that comes later than this after the one before follows a pause of the host; a tick younger than this ends the
/// reading of what waited.
const PAUSE_NS: u64 = 5 * NS_PER_MS;
/// After a pause the kernel may hand over what waited in several portions, for at most this long.
const CATCH_UP_NS: u64 = 100 * NS_PER_MS;
/// Stretches over which the drift is measured: 10 s between the first and the last.
const STRETCHES: usize = 11;

/// The fastest arrival within one stretch.
#[derive(Debug, Clone, Copy, Default)]
struct FastestArrival {
    /// Start of the stretch on the host's clock, ns.
    since_ns: u64,
    /// Host time of tick 0 by the fastest arrival, ns.
    origin_ns: i64,
}

/// A pause of the host, until all that waited meanwhile is read.
#[derive(Debug, Clone, Copy)]
struct Pause {
    /// Time of the last poll before it, ns.
    since_ns: u64,
    /// Latest end of reading what waited, ns.
    until_ns: u64,
}

/// Host time of tick 0, fitted to the fastest arrivals.
#[derive(Debug, Clone, Default)]
pub(crate) struct RigClock {
    /// Times of this poll and of the poll before it, ns.
    poll_ns: Option<u64>,
    before_ns: Option<u64>,
    pause: Option<Pause>,
    /// Newest tick of this poll. It enters the fit with the time of the next poll: this poll's own time may be before the
    /// arrival, if the thread was stopped between reading the clock and reading the link.
    newest: Option<u64>,
    is_fitted: bool,
    /// The stretches, the one under way last.
    stretches: [FastestArrival; STRETCHES],
    /// Number of stretches in use, from the end of the array.
    used: usize,
}

impl RigClock {
    /// Forgets the fit, not the polls.
    pub(crate) fn restart(&mut self) {
        *self = RigClock {
            poll_ns: self.poll_ns,
            before_ns: self.before_ns,
            pause: self.pause,
            ..RigClock::default()
        };
    }

    /// A poll begins at `now_ns`. Call it in every poll, before the link is read.
    pub(crate) fn begin_poll(&mut self, now_ns: u64) {
        if let Some(tick) = self.newest.take() {
            self.fit(now_ns, origin_ns(tick, now_ns));
        }
        self.before_ns = self.poll_ns.replace(now_ns);
        self.pause = self.pause.filter(|pause| now_ns < pause.until_ns);
        if let Some(before_ns) = self.before_ns
            && now_ns.saturating_sub(before_ns) > PAUSE_NS
        {
            self.pause = Some(Pause {
                since_ns: self.pause.map_or(before_ns, |pause| pause.since_ns),
                until_ns: now_ns + CATCH_UP_NS,
            });
        }
    }

    /// Takes a tick that was read in this poll. Returns true for the first one after a restart.
    pub(crate) fn take(&mut self, tick: u64) -> bool {
        self.newest = Some(tick);
        if self
            .late_ns(tick, self.poll_ns)
            .is_some_and(|late_ns| late_ns < PAUSE_NS)
        {
            self.pause = None;
        }
        !std::mem::replace(&mut self.is_fitted, true)
    }

    /// Delay of a tick of this poll in the link, in ms beyond the fastest delivery of the last one to two seconds. It is the
    /// least delay that is certain: too small by one to two poll periods, and 0 for a tick that may have waited in this computer.
    pub(crate) fn age_ms(&self, tick: u64) -> u64 {
        let arrived_after_ns = self.pause.map(|pause| pause.since_ns).or(self.before_ns);
        self.late_ns(tick, arrived_after_ns).unwrap_or(0) / NS_PER_MS
    }

    /// Delay of a tick that arrived at `at_ns`; `None` without a fit.
    fn late_ns(&self, tick: u64, at_ns: Option<u64>) -> Option<u64> {
        let late_ns = origin_ns(tick, at_ns?) - self.fitted_ns()?;
        Some(u64::try_from(late_ns).unwrap_or(0))
    }

    /// Rate error of the rig's clock over the last 10 s in ppm, positive if it is fast; `None` within the first 10 s. It is the
    /// smaller one of the two halves, so that one stall or one jump is no drift.
    pub(crate) fn drift_ppm(&self) -> Option<i64> {
        let [first, .., last] = self.stretches;
        let middle = self.stretches.get(STRETCHES / 2)?;
        if self.used < STRETCHES {
            return None;
        }
        let halves = [rate_ppm(&first, middle), rate_ppm(middle, &last)];
        let [a, b] = halves;
        if a.signum() != b.signum() {
            return Some(0);
        }
        halves.into_iter().min_by_key(|ppm| ppm.abs())
    }

    fn fit(&mut self, now_ns: u64, seen_ns: i64) {
        if let Some(current) = self.stretches.last_mut()
            && self.used > 0
            && now_ns.saturating_sub(current.since_ns) < STRETCH_NS
        {
            current.origin_ns = current.origin_ns.min(seen_ns);
            return;
        }
        self.stretches.rotate_left(1);
        self.used = (self.used + 1).min(STRETCHES);
        if let Some(current) = self.stretches.last_mut() {
            *current = FastestArrival {
                since_ns: now_ns,
                origin_ns: seen_ns,
            };
        }
    }

    /// Host time of tick 0 by the stretch under way and the one before it, ns.
    fn fitted_ns(&self) -> Option<i64> {
        let newest = self.stretches.iter().rev().take(self.used.min(2));
        newest.map(|stretch| stretch.origin_ns).min()
    }
}

/// Host time of tick 0 if `tick` happened at `at_ns`.
fn origin_ns(tick: u64, at_ns: u64) -> i64 {
    at_ns as i64 - (tick * TICK_NS) as i64
}

/// Rate error of the rig's clock from one stretch to a later one, ppm. A rig clock that is fast moves its tick 0 back.
fn rate_ppm(from: &FastestArrival, to: &FastestArrival) -> i64 {
    let span_ns = to.since_ns.saturating_sub(from.since_ns).max(1) as i64;
    (from.origin_ns - to.origin_ns).saturating_mul(1_000_000) / span_ns
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Polls once a millisecond, from `seconds` on for one second. A tick of the rig takes `tick_ns`; returns the greatest age.
    fn worst_age_ms(clock: &mut RigClock, seconds: std::ops::Range<u64>, tick_ns: u64) -> u64 {
        let mut worst_ms = 0;
        let mut taken = seconds.start * NS_PER_S / tick_ns;
        for ms in seconds.start * 1000..seconds.end * 1000 {
            let now_ns = ms * NS_PER_MS;
            clock.begin_poll(now_ns);
            while (taken + 1) * tick_ns <= now_ns {
                taken += 1;
                clock.take(taken);
                worst_ms = worst_ms.max(clock.age_ms(taken));
            }
        }
        worst_ms
    }

    #[test]
    fn the_age_of_a_late_sample_is_its_delay_less_two_polls() {
        let mut clock = RigClock::default();
        assert_eq!(worst_age_ms(&mut clock, 0..3, TICK_NS), 0);
        (3000..=3025).for_each(|ms| clock.begin_poll(ms * NS_PER_MS));
        assert!(!clock.take(3000));
        assert_eq!(clock.age_ms(3000), 23);
    }

    /// The kernel moves bytes from a serial driver to the reader in portions.
    #[test]
    fn what_waited_during_a_pause_is_not_late_though_it_comes_in_portions() {
        let mut clock = RigClock::default();
        worst_age_ms(&mut clock, 0..3, TICK_NS);
        for (ms, ticks) in [(3500, 3000..3250), (3501, 3250..3490), (3502, 3490..3502)] {
            clock.begin_poll(ms * NS_PER_MS);
            for tick in ticks {
                clock.take(tick);
                let age_ms = clock.age_ms(tick);
                assert!(age_ms * NS_PER_MS < PAUSE_NS, "tick {tick}: {age_ms} ms");
            }
        }
        // All is read: what is late from now on, the link delayed.
        clock.begin_poll(3530 * NS_PER_MS - 1);
        clock.begin_poll(3530 * NS_PER_MS);
        clock.take(3502);
        assert!(clock.age_ms(3502) == 0, "a pause of 28 ms");
        for ms in 3531..3560 {
            clock.begin_poll(ms * NS_PER_MS);
        }
        clock.take(3530);
        assert_eq!(clock.age_ms(3530), 0, "within 100 ms of the pause");
        for ms in 3560..3700 {
            clock.begin_poll(ms * NS_PER_MS);
        }
        clock.take(3660);
        assert!(clock.age_ms(3660) > 30);
    }

    #[test]
    fn only_the_first_tick_after_a_restart_is_the_first() {
        let mut clock = RigClock::default();
        assert!(clock.take(10));
        assert!(!clock.take(11));
        clock.restart();
        assert!(clock.take(12));
        assert_eq!(clock.age_ms(12), 0, "nothing to compare with");
    }

    #[test]
    fn a_clock_that_is_off_by_500_ppm_never_looks_late_and_its_drift_is_known() {
        for (tick_ns, ppm) in [(TICK_NS + 500, -500), (TICK_NS - 500, 500)] {
            let mut clock = RigClock::default();
            assert!(worst_age_ms(&mut clock, 0..10, tick_ns) <= 1);
            assert_eq!(clock.drift_ppm(), None, "less than 10 s");
            assert!(worst_age_ms(&mut clock, 10..20, tick_ns) <= 1);
            let drift_ppm = clock.drift_ppm().expect("after 10 s");
            // The fastest arrival is known to one poll period: 1 ms in 5 s are 200 ppm.
            assert!((drift_ppm - ppm).abs() <= 200, "{drift_ppm}");
        }
    }

    #[test]
    fn one_stall_of_the_rig_clock_is_no_drift() {
        let mut clock = RigClock::default();
        worst_age_ms(&mut clock, 0..15, TICK_NS);
        // The rig's clock stood still for 100 ms.
        for ms in 15_000..30_000 {
            clock.begin_poll(ms * NS_PER_MS);
            clock.take(ms - 100);
        }
        assert_eq!(clock.drift_ppm(), Some(0));
    }

    #[test]
    fn a_drift_of_two_thousand_ppm_is_seen_within_eleven_seconds() {
        let mut clock = RigClock::default();
        worst_age_ms(&mut clock, 0..12, TICK_NS - 2000);
        assert!(clock.drift_ppm().is_some_and(|ppm| ppm > 1500), "{clock:?}");
    }
}
