//! To which counted cycle a sample belongs, and whether a cycle ran to its end. A hold belongs to no cycle: a cycle that goes on
//! after a hold is one cycle; where the profile repeats the cycle from its start, the first piece stays incomplete. A stop leaves
//! its cycle incomplete.

use super::{Flags, Sample};

/// Follows the counted cycles of a run, sample by sample.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct CycleFollower {
    /// Number of the cycle under way.
    cycle: Option<u32>,
    /// The rig holds or unloads since the last sample of that cycle.
    paused: bool,
}

/// Where a sample lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CyclePlace {
    /// In no counted cycle.
    Outside,
    /// The first sample of a cycle.
    First,
    /// A further sample of the cycle under way.
    Further {
        /// A hold lies between this sample and the one before it.
        after_hold: bool,
    },
}

impl CycleFollower {
    /// Takes the next sample. Returns where it lies and, if a cycle has ended before it, whether that cycle is complete.
    pub(crate) fn add(&mut self, sample: &Sample) -> (CyclePlace, Option<bool>) {
        if sample.flags.contains(Flags::NOT_PROFILE) {
            self.paused = self.cycle.is_some();
            return (CyclePlace::Outside, None);
        }
        let after_hold = std::mem::take(&mut self.paused);
        if self.cycle == Some(sample.cycle) {
            return (CyclePlace::Further { after_hold }, None);
        }
        let ended = self.cycle.take().map(|_| !after_hold);
        if sample.cycle == 0 {
            return (CyclePlace::Outside, ended);
        }
        self.cycle = Some(sample.cycle);
        (CyclePlace::First, ended)
    }

    /// The run is over. `completed`: the profile ran to its end. Returns whether the last cycle is complete, if one is under way.
    pub(crate) fn finish(&mut self, completed: bool) -> Option<bool> {
        self.cycle.take().map(|_| completed && !self.paused)
    }
}
