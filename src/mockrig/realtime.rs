//! The mock rig in real time: ticks on the monotonic clock, for a process at the far end of a link.

use std::sync::atomic::{AtomicBool, Ordering};

use nix::errno::Errno;
use nix::sys::time::TimeSpec;
use nix::time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep};

use super::MockRig;
use crate::link::Link;
use crate::protocol::tick;
use crate::units::NS_PER_S;

/// Period of the firmware's loop in ns.
const TICK_NS: i64 = tick::TICK_NS as i64;
const SECOND_NS: i64 = NS_PER_S as i64;

/// Punctuality of a real-time run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Punctuality {
    /// Number of ticks.
    pub ticks: u64,
    /// Ticks that began more than one period after their deadline.
    pub late_ticks: u64,
    /// Largest delay of a tick in ns.
    pub worst_ns: u64,
    /// Number of delays too long to catch up. The rig's clock stood still meanwhile.
    pub stalls: u64,
}

/// Largest delay that is caught up tick by tick. After a longer one the ticks go on from there: a burst of ticks would leave
/// the host no time to answer, and a real rig does not tick in bursts either.
const CATCH_UP_NS: i64 = 3 * TICK_NS;

impl MockRig {
    /// Ticks in real time until `stop` is set or the other end is closed. Each tick has an absolute deadline. No tick is skipped;
    /// after a stall the rig's clock is behind the host's by the length of the stall.
    pub(crate) fn run_realtime(mut self, mut link: Link, stop: &AtomicBool) -> Result<Punctuality, Errno> {
        let mut punctuality = Punctuality::default();
        let mut due_ns = now_ns()?;
        while !stop.load(Ordering::Relaxed) && link.health.is_open() {
            due_ns += TICK_NS;
            let late_ns = now_ns()? - due_ns;
            if late_ns < 0 {
                sleep_until(due_ns)?;
            }
            let late_ns = (now_ns()? - due_ns).max(0);
            punctuality.worst_ns = punctuality.worst_ns.max(late_ns as u64);
            punctuality.late_ticks += u64::from(late_ns > TICK_NS);
            punctuality.ticks += 1;
            if late_ns > CATCH_UP_NS {
                punctuality.stalls += 1;
                due_ns += late_ns;
            }
            self.tick(&mut link);
            link.flush(now_ns()? as u64);
        }
        Ok(punctuality)
    }
}

fn now_ns() -> Result<i64, Errno> {
    let now = clock_gettime(ClockId::CLOCK_MONOTONIC)?;
    Ok(now.tv_sec() * SECOND_NS + now.tv_nsec())
}

fn sleep_until(due_ns: i64) -> Result<(), Errno> {
    let due = TimeSpec::new(due_ns / SECOND_NS, due_ns % SECOND_NS);
    loop {
        match clock_nanosleep(ClockId::CLOCK_MONOTONIC, ClockNanosleepFlags::TIMER_ABSTIME, &due) {
            Err(Errno::EINTR) => {}
            done => return done.map(|_| ()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::loopback;
    use crate::mockrig::MockRigConfig;
    use crate::model::equivalent::Equivalent;

    #[test]
    fn ticks_keep_up_with_the_clock() {
        let plant = Equivalent::new(&[0.0, 80.0, 0.1, 0.5], 0.0).expect("four values");
        let rig = MockRig::new(&MockRigConfig::default(), Box::new(plant)).expect("defaults are possible");
        let (mut host, rig_link) = loopback::pair();
        let stop = AtomicBool::new(false);
        let start_ns = now_ns().expect("always there");
        let punctuality = std::thread::scope(|scope| {
            let running = scope.spawn(|| rig.run_realtime(rig_link, &stop));
            // The boot-up and two heartbeats: 200 ticks have passed.
            let mut beats = 0;
            while beats < 3 {
                beats += u32::from(host.receive().is_some());
                sleep_until(now_ns().expect("always there") + TICK_NS).expect("the clock works");
            }
            stop.store(true, Ordering::Relaxed);
            running.join().expect("no panic").expect("the clock works")
        });
        let elapsed_ticks = (now_ns().expect("always there") - start_ns) / TICK_NS;
        // Never ahead of the clock.
        assert!(punctuality.ticks >= 200, "{punctuality:?}");
        assert!(
            punctuality.ticks as i64 <= elapsed_ticks + 1,
            "{punctuality:?} in {elapsed_ticks} periods"
        );
    }
}
