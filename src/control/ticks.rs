//! The rig's tick: 16 bits on the wire, 64 bits inside.

/// Unfolds the low 16 bits of the rig's tick.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Ticks {
    newest: Option<u64>,
}

/// Place of a sample in the stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TickOrder {
    /// The next one after `lost` missing ones.
    Next {
        /// Tick of the sample, unfolded to 64 bits.
        tick: u64,
        /// Samples missing before it.
        lost: u64,
    },
    /// The newest one again, or an older one.
    Old,
}

impl Ticks {
    /// Newest tick received.
    pub(crate) fn newest(&self) -> Option<u64> {
        self.newest
    }

    /// Ticks from the newest one to the one with these low bits; 0 before the first.
    pub(crate) fn ahead(&self, low: u16) -> u64 {
        self.newest
            .map_or(0, |newest| u64::from(low.wrapping_sub(newest as u16)))
    }

    /// Starts again after a reboot of the firmware or a loss of the link.
    pub(crate) fn restart(&mut self) {
        self.newest = None;
    }

    /// Places a sample by its low 16 bits. Up to half of the 16-bit range (32.8 s) ahead counts as new.
    pub(crate) fn place(&mut self, low: u16) -> TickOrder {
        let Some(newest) = self.newest else {
            let tick = u64::from(low);
            self.newest = Some(tick);
            return TickOrder::Next { tick, lost: 0 };
        };
        let ahead = low.wrapping_sub(newest as u16);
        if ahead == 0 || ahead >= 0x8000 {
            return TickOrder::Old;
        }
        let tick = newest + u64::from(ahead);
        self.newest = Some(tick);
        TickOrder::Next {
            tick,
            lost: u64::from(ahead) - 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_unfold_over_the_wrap_and_count_what_is_missing() {
        let mut t = Ticks::default();
        assert_eq!(
            t.place(65_534),
            TickOrder::Next {
                tick: 65_534,
                lost: 0
            }
        );
        assert_eq!(
            t.place(65_535),
            TickOrder::Next {
                tick: 65_535,
                lost: 0
            }
        );
        assert_eq!(
            t.place(2),
            TickOrder::Next {
                tick: 65_538,
                lost: 2
            }
        );
        assert_eq!(t.place(1), TickOrder::Old);
        assert_eq!(t.place(2), TickOrder::Old);
    }
}
