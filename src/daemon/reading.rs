//! The uncorrected readings of both sensors over the last second, for a calibration. The recording thread writes them, during a run
//! and between runs; a handler reads them.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use super::client_types::{CountsReading, SensorReadings};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::{Flags, Sample};

/// Samples of the window: one second.
pub(crate) const WINDOW_SAMPLES: usize = SAMPLE_RATE_HZ as usize;

/// One sample: tick, counts of force and displacement; `None` without a valid reading.
type Counts = (u64, Option<i32>, Option<i32>);

/// The newest readings. Clones share them.
#[derive(Debug, Clone, Default)]
pub(super) struct Readings(Arc<Mutex<VecDeque<Counts>>>);

impl Readings {
    /// Takes one sample. A gap empties the window.
    pub(super) fn push(&self, sample: &Sample) {
        let valid = |counts: i32, invalid| (!sample.flags.contains(invalid)).then_some(counts);
        let mut window = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if window.back().is_some_and(|(tick, ..)| tick + 1 != sample.tick) {
            window.clear();
        }
        if window.len() == WINDOW_SAMPLES {
            window.pop_front();
        }
        window.push_back((
            sample.tick,
            valid(sample.force_counts, Flags::FORCE_INVALID),
            valid(sample.displacement_counts, Flags::DISPLACEMENT_INVALID),
        ));
    }

    /// Mean and scatter over the window. `bench` is the name of the bench.
    pub(super) fn summary(&self, bench: &str) -> SensorReadings {
        let window = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let tick = |end: Option<&Counts>| end.map_or(0, |(tick, ..)| *tick);
        SensorReadings {
            bench: bench.to_owned(),
            samples: window.len() as u32,
            first_tick: tick(window.front()),
            last_tick: tick(window.back()),
            force: summary(window.iter().map(|(_, force, _)| *force)),
            displacement: summary(window.iter().map(|(.., displacement)| *displacement)),
        }
    }
}

/// Mean and standard deviation of the valid counts.
fn summary(counts: impl Iterator<Item = Option<i32>> + Clone) -> CountsReading {
    let valid = || counts.clone().flatten().map(f64::from);
    let (all, n) = (counts.clone().count(), valid().count() as f64);
    let mean_counts = valid().sum::<f64>() / n.max(1.0);
    let squares = valid().map(|c| (c - mean_counts).powi(2)).sum::<f64>();
    CountsReading {
        mean_counts,
        sigma_counts: (squares / (n - 1.0).max(1.0)).sqrt(),
        invalid: all as u32 - n as u32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::run_file::test_support;

    fn sample(tick: u64, counts: i32) -> Sample {
        Sample {
            force_counts: counts,
            displacement_counts: -counts,
            flags: Flags::default(),
            ..test_support::sample(tick)
        }
    }

    #[test]
    fn the_window_is_the_last_second_and_a_gap_empties_it() {
        let readings = Readings::default();
        assert_eq!(readings.summary("b").samples, 0);
        for tick in 1..=3000 {
            // Far off in the first seconds, then 99 and 101 in turn.
            let counts = if tick <= 2000 {
                5000
            } else {
                100 + (tick as i32 % 2) * 2 - 1
            };
            readings.push(&sample(tick, counts));
        }
        let found = readings.summary("b");
        assert_eq!(
            (found.samples, found.first_tick, found.last_tick),
            (1000, 2001, 3000)
        );
        assert_eq!(
            (found.force.mean_counts, found.displacement.mean_counts),
            (100.0, -100.0)
        );
        assert!((found.force.sigma_counts - 1.0).abs() < 1e-3);
        let mut invalid = sample(3001, 7);
        invalid.flags.insert(Flags::FORCE_INVALID);
        readings.push(&invalid);
        let found = readings.summary("b");
        assert_eq!((found.force.invalid, found.displacement.invalid), (1, 0));
        readings.push(&sample(3005, 7));
        let found = readings.summary("b");
        assert_eq!((found.samples, found.force.mean_counts), (1, 7.0));
    }
}
