//! How late the turns of the control loop began: counts in fixed classes of delay, for the status, the metrics and the run file.
//! Measuring is left to `control::realtime`.

use serde::{Deserialize, Serialize};

/// Upper ends of the classes of delays, us. A longer delay is in none of them.
pub(crate) const LATENESS_BOUNDS_US: [u64; 10] =
    [50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000];

/// How many turns had which delay.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Vec<LatenessClass>", into = "Vec<LatenessClass>")]
pub(crate) struct LatenessCounts {
    /// Turns in each class of [`LATENESS_BOUNDS_US`].
    pub counts: [u64; LATENESS_BOUNDS_US.len()],
    /// Turns with a longer delay.
    pub beyond: u64,
}

impl LatenessCounts {
    /// Counts a turn that was late by `late_us`.
    pub(crate) fn note(&mut self, late_us: u64) {
        let class = LATENESS_BOUNDS_US.iter().position(|bound| late_us <= *bound);
        match class.and_then(|class| self.counts.get_mut(class)) {
            Some(count) => *count += 1,
            None => self.beyond += 1,
        }
    }
}

/// The turns whose delay is above the class before and not above `up_to_us`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub(crate) struct LatenessClass {
    /// Upper end of the class in microseconds; `null`: the turns beyond all classes.
    pub up_to_us: Option<u64>,
    /// Number of turns.
    pub turns: u64,
}

impl From<LatenessCounts> for Vec<LatenessClass> {
    fn from(lateness: LatenessCounts) -> Self {
        let bounds = LATENESS_BOUNDS_US.iter().map(|bound| Some(*bound)).chain([None]);
        let counts = lateness.counts.iter().copied().chain([lateness.beyond]);
        bounds
            .zip(counts)
            .map(|(up_to_us, turns)| LatenessClass { up_to_us, turns })
            .collect()
    }
}

impl From<Vec<LatenessClass>> for LatenessCounts {
    /// A class that this program does not have counts to the next longer one.
    fn from(classes: Vec<LatenessClass>) -> Self {
        let mut lateness = LatenessCounts::default();
        for class in classes {
            let at = class
                .up_to_us
                .and_then(|us| LATENESS_BOUNDS_US.iter().position(|bound| us <= *bound));
            match at.and_then(|at| lateness.counts.get_mut(at)) {
                Some(count) => *count += class.turns,
                None => lateness.beyond += class.turns,
            }
        }
        lateness
    }
}

/// RunPunctuality of the control loop during one run, in the outcome of its file.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct RunPunctuality {
    /// Turns of the loop during the run.
    pub turns: u64,
    /// Turns that began more than one tick after their deadline.
    pub late_turns: u64,
    /// Largest delay of a turn in microseconds.
    pub worst_lateness_us: u64,
    /// Turns by their delay.
    pub lateness: LatenessCounts,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_turn_is_in_one_class_and_the_classes_read_back_the_same() {
        let mut lateness = LatenessCounts::default();
        for late_us in [0, 50, 51, 1000, 50_000, 50_001, 9_000_000] {
            lateness.note(late_us);
        }
        let classes = Vec::<LatenessClass>::from(lateness);
        let turns = |up_to_us| {
            classes
                .iter()
                .find(|class| class.up_to_us == up_to_us)
                .map(|c| c.turns)
        };
        assert_eq!(
            [Some(50), Some(100), Some(1000), Some(50_000), None].map(turns),
            [Some(2), Some(1), Some(1), Some(1), Some(2)]
        );
        let json = serde_json::to_string(&lateness).expect("plain numbers");
        assert_eq!(
            serde_json::from_str::<LatenessCounts>(&json).expect("as written"),
            lateness
        );
    }
}
