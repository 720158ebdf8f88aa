//! The test of every run of a lab.
//!
//! It is scaled to the travel of the family: two slow large cycles, five small quick ones, five at a middle speed. Different
//! amplitudes and speeds tell friction, rate and lag apart.

use std::fmt::Write;

use super::Programme;
use super::path::Path;
use crate::profile::{Player, Profile, Slot};

/// Middle of all sines as a share of the largest displacement.
const MEAN: f64 = 0.5;
/// Amplitude as a share of the largest displacement, frequency in Hz and number of counted cycles of each sine.
const SINES: [(f64, f64, u32); 3] = [(0.42, 0.5, 2), (0.12, 2.0, 5), (0.3, 1.5, 5)];
/// Counted cycles of one run.
pub(crate) const CYCLES: u32 = SINES[0].2 + SINES[1].2 + SINES[2].2;
/// Duration of the ramp to the middle and back, s.
const RAMP_S: f64 = 1.0;
/// Commands per second.
const COMMANDS_HZ: f64 = 1000.0;

/// The test of one family, as a bench runs it.
pub(crate) struct LabTest {
    pub profile: Profile,
    pub profile_toml: String,
    slots: Vec<Slot>,
}

impl LabTest {
    /// The test of a family whose largest displacement is `top_mm`.
    pub(crate) fn new(family: &str, top_mm: f64) -> LabTest {
        let profile_toml = profile_toml(family, top_mm);
        let profile = Profile::from_toml(&profile_toml, family).expect("the text below is a profile");
        let mut player = Player::new(&profile, 0.0, COMMANDS_HZ).expect("its sines begin at their mean");
        let slots = std::iter::from_fn(|| player.next()).collect();
        LabTest {
            profile,
            profile_toml,
            slots,
        }
    }

    /// Counted cycles of the test.
    pub(crate) fn cycles(&self) -> u32 {
        CYCLES
    }

    /// Duration of the test, s.
    pub(crate) fn duration_s(&self) -> f64 {
        self.slots.len() as f64 / COMMANDS_HZ
    }

    /// The command of a time in s after the start: the one that was due last.
    pub(crate) fn at(&self, time_s: f64) -> Option<&Slot> {
        let due = (time_s * COMMANDS_HZ).round() as usize;
        self.slots.get(due.min(self.slots.len()).checked_sub(1)?)
    }

    /// The test as a motion.
    pub(super) fn motion(&self) -> Programme {
        let mut points = vec![[0.0, 0.0]];
        for slot in &self.slots {
            points.push([points.len() as f64 / COMMANDS_HZ, slot.command.value()]);
        }
        Programme::Path(Path::new(&points))
    }
}

/// The profile file.
fn profile_toml(family: &str, top_mm: f64) -> String {
    let mean_mm = MEAN * top_mm;
    let mut text = format!("name = \"lab-{family}\"\ncontrol = \"displacement\"\n\n[[block]]\n");
    let mut segment = |lines: String| {
        // A String takes every text.
        let _ = write!(text, "\n[[block.segment]]\n{lines}");
    };
    segment(format!(
        "kind = \"ramp\"\nto_mm = {mean_mm:?}\nduration_s = {RAMP_S:?}\n"
    ));
    for (share, frequency_hz, cycles) in SINES {
        let amplitude_mm = share * top_mm;
        segment(format!(
            "kind = \"sine\"\nmean_mm = {mean_mm:?}\namplitude_mm = {amplitude_mm:?}\nfrequency_hz = {frequency_hz:?}\n\
             cycles = {cycles}\ntaper_cycles = 1\ncorrect = false\n"
        ));
    }
    segment(format!("kind = \"ramp\"\nto_mm = 0.0\nduration_s = {RAMP_S:?}\n"));
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_has_its_cycles_and_reaches_the_travel_that_it_was_scaled_to() {
        let test = LabTest::new("F1", 20.0);
        let cycles = test.slots.iter().map(|s| s.cycle).max();
        assert_eq!(cycles, Some(CYCLES));
        // Ramps of 1 s; sines of 4, 7 and 7 cycles with their tapers at 0.5, 2 and 1.5 Hz.
        assert!((test.duration_s() - (2.0 + 8.0 + 3.5 + 14.0 / 3.0)).abs() < 2e-3);
        let top_mm = test.slots.iter().map(|s| s.command.value()).fold(0.0, f64::max);
        assert!((top_mm - 0.92 * 20.0).abs() < 1e-6);
    }

    #[test]
    fn a_time_has_the_command_that_was_due_last() {
        let test = LabTest::new("F1", 20.0);
        assert_eq!(test.at(0.0), None);
        let at = |time_s| test.at(time_s).map(|s| (s.cycle, s.segment));
        // The first counted cycle begins after the ramp and one growing cycle.
        assert_eq!(at(2.9), Some((0, 2)));
        assert_eq!(at(3.1), Some((1, 2)));
        assert_eq!(test.at(1e3).map(|s| s.command.value()), Some(0.0));
    }
}
