//! The firmware's command queue: slots by tick, holes between two known slots bridged by a straight line.
//! Whether a command is allowed, and what happens when the queue runs dry, is decided in `firmware`.

use crate::protocol::message::WireMode;

/// Slots: how far ahead commands may be sent, in ticks.
pub(crate) const QUEUE_SLOTS: u64 = 512;

/// A set point for one tick, in the counts of its mode's channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SetPoint {
    /// Which channel.
    pub mode: WireMode,
    /// Set point in counts; between two slots not a whole number.
    pub counts: f64,
    /// The motion ends here.
    pub last: bool,
}

#[derive(Debug, Clone, Copy)]
struct QueueSlot {
    tick: u64,
    point: SetPoint,
}

/// Why a command was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Rejected {
    /// Its tick has passed.
    Stale,
    /// Its tick lies beyond the queue.
    TooFarAhead,
}

/// The queue.
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

    /// Takes a command for the tick whose low 16 bits are `tick_low`, seen from `now`. A second one for a tick replaces
    /// the first.
    pub(crate) fn push(&mut self, tick_low: u16, now: u64, point: SetPoint) -> Result<(), Rejected> {
        let ahead = tick_low.wrapping_sub(now as u16) as i16;
        if ahead <= 0 {
            return Err(Rejected::Stale);
        }
        if ahead as u64 >= QUEUE_SLOTS {
            return Err(Rejected::TooFarAhead);
        }
        let tick = now + ahead as u64;
        if let Some(slot) = self.slots.get_mut((tick % QUEUE_SLOTS) as usize) {
            *slot = Some(QueueSlot { tick, point });
        }
        self.newest = Some(self.newest.map_or(tick, |newest| newest.max(tick)));
        Ok(())
    }

    /// Ticks from `now` to the newest command; 0 where none is due any more.
    pub(crate) fn level_ms(&self, now: u64) -> u64 {
        self.newest.map_or(0, |newest| newest.saturating_sub(now))
    }

    /// The newest command.
    pub(crate) fn newest(&self) -> Option<SetPoint> {
        self.newest.and_then(|tick| self.at(tick))
    }

    /// The set point at `tick`: its slot, or the straight line from `before` (the set point of the tick before, of the
    /// same mode) to the next slot known. `None` beyond the newest, or in a hole with nothing before it.
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
    fn stale_and_far_commands_are_rejected() {
        let mut queue = CommandQueue::default();
        // The tick's low half wraps between now and due.
        let now = 0x0001_FFF0;
        assert_eq!(queue.push(0xFFF0, now, point(1.0)), Err(Rejected::Stale));
        assert_eq!(queue.push(0xFF00, now, point(1.0)), Err(Rejected::Stale));
        assert_eq!(queue.push(0x0010, now, point(1.0)), Ok(()));
        assert_eq!(queue.level_ms(now), 32);
        assert_eq!(queue.push(0x01F0, now, point(1.0)), Err(Rejected::TooFarAhead));
        assert_eq!(queue.set_point(0x0002_0010, None), Some(point(1.0)));
    }

    #[test]
    fn holes_are_bridged_by_a_straight_line() {
        let mut queue = CommandQueue::default();
        queue.push(10, 0, point(100.0)).expect("ahead");
        queue.push(14, 0, point(180.0)).expect("ahead");
        assert_eq!(queue.set_point(9, None), None);
        let mut before = queue.set_point(10, None);
        for (tick, expected) in [(11, 120.0), (12, 140.0), (13, 160.0), (14, 180.0)] {
            before = queue.set_point(tick, before);
            assert_eq!(before.map(|p| p.counts), Some(expected));
        }
        assert_eq!(queue.set_point(15, before), None);
    }

    #[test]
    fn a_hole_between_two_modes_is_not_bridged() {
        let mut queue = CommandQueue::default();
        let force = SetPoint {
            mode: WireMode::Force,
            counts: 50.0,
            last: false,
        };
        queue.push(3, 0, force).expect("ahead");
        assert_eq!(queue.set_point(2, Some(point(1.0))), None);
    }
}
