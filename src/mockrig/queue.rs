//! The firmware's command queue: one slot per tick; missing slots between two known ones are interpolated linearly.
//! Whether a command is allowed, and what follows from an empty queue, is decided in `requests` and `firmware`.

use crate::protocol::message::WireMode;
use crate::protocol::tick::ticks_in_ms;

/// How far ahead a command may be due: 250 ms.
const AHEAD_MAX_TICKS: u64 = ticks_in_ms(250);
/// Slots of the ring: the commands ahead, and the one of this tick.
const QUEUE_SLOTS: u64 = AHEAD_MAX_TICKS + 1;

/// A set point for one tick, in the counts of its mode's channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SetPoint {
    /// Channel that the set point is for.
    pub mode: WireMode,
    /// Set point in counts; an interpolated one is not a whole number.
    pub counts: f64,
    /// The motion ends here.
    pub last: bool,
}

#[derive(Debug, Clone, Copy)]
struct QueueSlot {
    tick: u64,
    point: SetPoint,
}

/// The commands that are not yet due, and the newest that were.
#[derive(Debug, Clone)]
pub(crate) struct CommandQueue {
    slots: Box<[Option<QueueSlot>]>,
    newest: Option<u64>,
}

impl Default for CommandQueue {
    fn default() -> Self {
        CommandQueue {
            slots: vec![None; QUEUE_SLOTS as usize].into_boxed_slice(),
            newest: None,
        }
    }
}

impl CommandQueue {
    /// Empties the queue.
    pub(crate) fn clear(&mut self) {
        self.slots.fill(None);
        self.newest = None;
    }

    /// Takes a command for the tick nearest to `now` with the low 16 bits `tick_low`. A second one for a tick replaces the
    /// first. Returns false, and drops the command, if its tick is due, has passed, or is beyond the queue.
    pub(crate) fn push(&mut self, tick_low: u16, now: u64, point: SetPoint) -> bool {
        let ahead = tick_low.wrapping_sub(now as u16) as i16;
        if ahead <= 0 || ahead as u64 > AHEAD_MAX_TICKS {
            return false;
        }
        let tick = now + ahead as u64;
        if let Some(slot) = self.slots.get_mut((tick % QUEUE_SLOTS) as usize) {
            *slot = Some(QueueSlot { tick, point });
        }
        self.newest = Some(self.newest.map_or(tick, |newest| newest.max(tick)));
        true
    }

    /// Ticks from `now` to the newest command; 0 if all are due.
    pub(crate) fn level(&self, now: u64) -> u64 {
        self.newest.map_or(0, |newest| newest.saturating_sub(now))
    }

    /// The newest command.
    pub(crate) fn newest(&self) -> Option<SetPoint> {
        self.newest.and_then(|tick| self.at(tick))
    }

    /// The set point at `tick`: its slot, or the linear interpolation between `before` (the set point of the tick before, of
    /// the same mode) and the next known slot. `None` after the newest command, and where nothing is known before.
    pub(crate) fn set_point(&self, tick: u64, before: Option<SetPoint>) -> Option<SetPoint> {
        if let Some(point) = self.at(tick) {
            return Some(point);
        }
        let newest = self.newest.filter(|&newest| newest > tick)?;
        let before = before?;
        let (next_tick, next) = (tick + 1..=newest).find_map(|t| self.at(t).map(|point| (t, point)))?;
        (next.mode == before.mode).then(|| SetPoint {
            counts: before.counts + (next.counts - before.counts) / (next_tick + 1 - tick) as f64,
            last: false,
            ..next
        })
    }

    /// The command sent for exactly `tick`.
    pub(crate) fn at(&self, tick: u64) -> Option<SetPoint> {
        self.slots
            .get((tick % QUEUE_SLOTS) as usize)?
            .filter(|slot| slot.tick == tick)
            .map(|slot| slot.point)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(counts: f64) -> SetPoint {
        SetPoint {
            mode: WireMode::Displacement,
            counts,
            last: false,
        }
    }

    #[test]
    fn commands_due_now_past_or_too_far_ahead_are_dropped() {
        let mut queue = CommandQueue::default();
        // The tick's low half wraps between now and due.
        let now = 0x0001_FFF0;
        for (tick_low, taken) in [
            (0xFFF0, false),
            (0xFF00, false),
            (0x0010, true),
            (0x00EA, true),
            (0x00EB, false),
        ] {
            assert_eq!(queue.push(tick_low, now, point(1.0)), taken, "{tick_low:#06x}");
        }
        assert_eq!(queue.level(now), 250);
        assert_eq!(queue.set_point(0x0002_0010, None), Some(point(1.0)));
    }

    #[test]
    fn missing_slots_are_interpolated() {
        let mut queue = CommandQueue::default();
        assert!(queue.push(10, 0, point(100.0)) && queue.push(14, 0, point(180.0)));
        assert_eq!(queue.set_point(9, None), None);
        let mut before = queue.set_point(10, None);
        for (tick, expected) in [(11, 120.0), (12, 140.0), (13, 160.0), (14, 180.0)] {
            before = queue.set_point(tick, before);
            assert_eq!(before.map(|p| p.counts), Some(expected));
        }
        assert_eq!(queue.set_point(15, before), None);
    }

    #[test]
    fn a_missing_slot_between_two_modes_is_not_interpolated() {
        let mut queue = CommandQueue::default();
        let force = SetPoint {
            mode: WireMode::Force,
            counts: 50.0,
            last: false,
        };
        assert!(queue.push(3, 0, force));
        assert_eq!(queue.set_point(2, Some(point(1.0))), None);
    }
}
