//! The mock rig in real time: ticks on the monotonic clock, for a process at the far end of a link.

use std::sync::atomic::{AtomicBool, Ordering};

use nix::errno::Errno;
use nix::sys::time::TimeSpec;
use nix::time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep};

use super::MockRig;
use crate::link::Link;
use crate::protocol::tick;
use crate::units::{NS_PER_MS, NS_PER_S};

/// Period of the firmware's loop in ns.
const TICK_NS: i64 = tick::TICK_NS as i64;
const SECOND_NS: i64 = NS_PER_S as i64;

/// Punctuality of a real-time run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Punctuality {
    /// Number of ticks.
    pub ticks: u64,
    /// Wakes more than one period after their deadline.
    pub late_ticks: u64,
    /// Largest delay of a tick in ns.
    pub worst_ns: u64,
    /// Number of delays too long to catch up. The rig's clock stood still meanwhile.
    pub stalls: u64,
}

/// Largest delay that is made up. After a longer one, which is a fault to every host, the ticks go on from there.
const CATCH_UP_NS: i64 = 500 * NS_PER_MS as i64;
/// Ticks in one period while a delay is made up. A burst would leave the host no time to answer, and a real rig does not
/// tick in bursts either; a clock that stays behind would make every later sample late.
const CATCH_UP_TICKS: u32 = 2;
/// Rest after such a period. A thread with real-time priority that never sleeps keeps the host from its processor.
const REST_NS: i64 = TICK_NS / 4;

/// When the rig wakes up, and how many ticks it then makes.
struct Schedule {
    /// When the next tick is due, ns.
    due_ns: i64,
    /// When the rig last woke up, ns.
    woke_ns: i64,
    punctuality: Punctuality,
}

impl Schedule {
    fn new(now_ns: i64) -> Self {
        Schedule {
            due_ns: now_ns + TICK_NS,
            woke_ns: now_ns,
            punctuality: Punctuality::default(),
        }
    }

    /// Time of the next wake: at least one period after the one before.
    fn next_ns(&self) -> i64 {
        self.due_ns.max(self.woke_ns + TICK_NS)
    }

    /// The ticks of a period that made up a delay were done at `done_ns`: the next wake leaves others some time.
    fn rest_from(&mut self, done_ns: i64) {
        self.woke_ns = self.woke_ns.max(done_ns + REST_NS - TICK_NS);
    }

    /// Number of ticks to make now.
    fn wake(&mut self, now_ns: i64) -> u32 {
        let late_ns = (now_ns - self.due_ns).max(0);
        self.woke_ns = now_ns;
        let punctuality = &mut self.punctuality;
        punctuality.worst_ns = punctuality.worst_ns.max(late_ns as u64);
        punctuality.late_ticks += u64::from(late_ns > TICK_NS);
        let ticks = if late_ns > CATCH_UP_NS {
            punctuality.stalls += 1;
            self.due_ns += late_ns;
            1
        } else if late_ns >= TICK_NS {
            CATCH_UP_TICKS
        } else {
            1
        };
        punctuality.ticks += u64::from(ticks);
        self.due_ns += i64::from(ticks) * TICK_NS;
        ticks
    }
}

impl MockRig {
    /// Ticks in real time until `stop` is set or the other end is closed. Each tick has an absolute deadline. No tick is
    /// skipped; after a stall that is too long to make up, the rig's clock is behind the host's by the length of the stall.
    pub(crate) fn run_realtime(mut self, mut link: Link, stop: &AtomicBool) -> Result<Punctuality, Errno> {
        let mut schedule = Schedule::new(now_ns()?);
        while !stop.load(Ordering::Relaxed) && link.health.is_open() {
            sleep_until(schedule.next_ns())?;
            let woke_ns = now_ns()?;
            let ticks = schedule.wake(woke_ns);
            for _ in 0..ticks {
                self.tick(&mut link);
            }
            link.flush(woke_ns as u64);
            if ticks > 1 {
                schedule.rest_from(now_ns()?);
            }
        }
        Ok(schedule.punctuality)
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

    const MS: i64 = TICK_NS;

    /// Every wake is punctual; the ticks of each until `until_ms`.
    fn run_until(schedule: &mut Schedule, until_ms: i64) -> Vec<u32> {
        let mut ticks = Vec::new();
        while schedule.next_ns() <= until_ms * MS {
            let now_ns = schedule.next_ns();
            ticks.push(schedule.wake(now_ns));
        }
        ticks
    }

    #[test]
    fn a_stall_is_made_up_at_double_speed() {
        let mut schedule = Schedule::new(0);
        assert_eq!(run_until(&mut schedule, 100).len(), 100);
        // The computer stops the process for 80 ms.
        assert_eq!(schedule.wake(180 * MS), 2);
        let after = run_until(&mut schedule, 280);
        assert!(after.iter().all(|&ticks| ticks <= 2), "{after:?}");
        assert_eq!(after.len(), 100, "one wake a period");
        assert_eq!(schedule.punctuality.ticks, 280, "the clock is right again");
        assert_eq!(schedule.punctuality.stalls, 0);
    }

    #[test]
    fn a_rig_that_is_too_slow_for_its_computer_still_sleeps() {
        let mut schedule = Schedule::new(0);
        let mut now_ns = 10 * MS;
        for _ in 0..100 {
            assert_eq!(schedule.wake(now_ns), 2);
            // Two ticks take 3 ms.
            schedule.rest_from(now_ns + 3 * MS);
            assert!(schedule.next_ns() >= now_ns + 3 * MS + REST_NS);
            now_ns = schedule.next_ns();
        }
    }

    #[test]
    fn a_stall_of_seconds_is_not_made_up() {
        let mut schedule = Schedule::new(0);
        run_until(&mut schedule, 100);
        assert_eq!(schedule.wake(3_100 * MS), 1);
        assert!(run_until(&mut schedule, 3_200).iter().all(|&ticks| ticks == 1));
        assert_eq!(
            (schedule.punctuality.stalls, schedule.punctuality.ticks),
            (1, 201)
        );
    }

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
