//! Whether the rig does what the commands ask: its state and its queue, as STATUS tells them, while a run goes on.

use crate::protocol::message::RigState;
use crate::protocol::tick::ticks_in_ms;

/// The rig may contradict the commands for this long: the way of a status, and the beginning of a motion. 100 ms.
const PATIENCE_TICKS: u64 = ticks_in_ms(100);

/// What the run expects of the rig at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Expected {
    /// Tick at which the commands of this stretch began.
    pub from_tick: u64,
    /// Tick of the last command of the profile, once it has been sent.
    pub last_tick: Option<u64>,
}

/// How long the rig has been contradicting the commands.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ObedienceWatch {
    /// Tick since which each contradiction stands: not in motion, and nothing in the queue.
    idle_since: Option<u64>,
    empty_since: Option<u64>,
}

impl ObedienceWatch {
    /// Takes a status that came at `tick`. Returns what is wrong.
    pub(super) fn take(
        &mut self,
        state: RigState,
        queue_ms: u8,
        tick: u64,
        expected: Expected,
    ) -> Option<String> {
        let under_way = tick >= expected.from_tick && expected.last_tick.is_none_or(|last| tick < last);
        let idle = under_way && state != RigState::Running;
        let empty = under_way && expected.last_tick.is_none() && queue_ms == 0;
        if stands(&mut self.idle_since, idle, tick) {
            return Some(format!(
                "the rig does not follow the commands: for {} ms its state has been {state} instead of running: check that the firmware accepts commands in this state",
                ticks_since(self.idle_since, tick)
            ));
        }
        stands(&mut self.empty_since, empty, tick).then(|| {
            format!(
                "the rig does not accept the commands: its queue has been empty for {} ms: check link and firmware",
                ticks_since(self.empty_since, tick)
            )
        })
    }
}

fn stands(since: &mut Option<u64>, on: bool, tick: u64) -> bool {
    *since = if on { Some(since.unwrap_or(tick)) } else { None };
    since.is_some_and(|since| tick.saturating_sub(since) >= PATIENCE_TICKS)
}

fn ticks_since(since: Option<u64>, tick: u64) -> u64 {
    tick.saturating_sub(since.unwrap_or(tick))
}

#[cfg(test)]
mod tests {
    use super::*;

    const RUNNING: Expected = Expected {
        from_tick: 1000,
        last_tick: None,
    };

    fn first_finding(state: RigState, queue_ms: u8, expected: Expected) -> Option<(u64, String)> {
        let mut watch = ObedienceWatch::default();
        (0..300).map(|k| 900 + 10 * k).find_map(|tick| {
            let text = watch.take(state, queue_ms, tick, expected)?;
            Some((tick, text))
        })
    }

    #[test]
    fn a_rig_that_stays_armed_is_found_a_tenth_of_a_second_after_the_first_command() {
        let (tick, text) = first_finding(RigState::Armed, 90, RUNNING).expect("found");
        assert_eq!(tick, 1100, "{text}");
        assert!(text.contains("armed"), "{text}");
    }

    #[test]
    fn an_empty_queue_is_found_while_commands_are_sent() {
        let (tick, text) = first_finding(RigState::Running, 0, RUNNING).expect("found");
        assert!(tick == 1100 && text.contains("queue"), "{tick}: {text}");
    }

    #[test]
    fn the_end_of_the_profile_is_no_finding() {
        let ending = Expected {
            last_tick: Some(1050),
            ..RUNNING
        };
        assert_eq!(first_finding(RigState::Armed, 0, ending), None);
        assert_eq!(first_finding(RigState::Running, 90, RUNNING), None);
    }
}
