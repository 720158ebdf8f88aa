//! The test of every run of a lab.
//!
//! It is scaled to the travel of the family: two slow large cycles, five small quick ones, five at a middle speed. Different
//! amplitudes and speeds tell friction, rate and lag apart.

use std::fmt::Write;

use super::Programme;
use super::path::Path;

/// Middle of all sines as a share of the largest displacement.
const MEAN: f64 = 0.5;
/// Amplitude as a share of the largest displacement, frequency in Hz and number of counted cycles of each sine.
const SINES: [(f64, f64, u32); 3] = [(0.42, 0.5, 2), (0.12, 2.0, 5), (0.3, 1.5, 5)];
/// Counted cycles of one run.
pub(crate) const CYCLES: u32 = SINES[0].2 + SINES[1].2 + SINES[2].2;
/// Duration of the ramp to the middle and back, s.
const RAMP_S: f64 = 1.0;
/// Commands per second.
pub(crate) const COMMANDS_HZ: f64 = 1000.0;

/// One command of a test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LabCommand {
    pub displacement_mm: f64,
    /// Counted cycle, from 1; 0 outside the counted cycles.
    pub cycle: u32,
    /// Segment of the profile, from 1.
    pub segment: u32,
}

/// The test of one family, as a bench plays its profile: [`COMMANDS_HZ`] commands per second.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LabTest {
    pub commands: Vec<LabCommand>,
}

impl LabTest {
    /// Duration of the test, s.
    pub(crate) fn duration_s(&self) -> f64 {
        self.commands.len() as f64 / COMMANDS_HZ
    }

    /// The command of a time in s after the start: the one that was due last.
    pub(crate) fn at(&self, time_s: f64) -> Option<&LabCommand> {
        let due = (time_s * COMMANDS_HZ).round() as usize;
        self.commands.get(due.min(self.commands.len()).checked_sub(1)?)
    }

    /// The test as a motion.
    pub(super) fn motion(&self) -> Programme {
        let mut points = vec![[0.0, 0.0]];
        for command in &self.commands {
            points.push([points.len() as f64 / COMMANDS_HZ, command.displacement_mm]);
        }
        Programme::Path(Path::new(&points))
    }
}

/// The profile file of a family whose largest displacement is `top_mm`.
pub(crate) fn profile_toml(family: &str, top_mm: f64) -> String {
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
    fn a_time_has_the_command_that_was_due_last() {
        let command = |k: u32| LabCommand {
            displacement_mm: f64::from(k),
            cycle: 0,
            segment: 1,
        };
        let test = LabTest {
            commands: (1..=2000).map(command).collect(),
        };
        assert_eq!(test.duration_s(), 2.0);
        let at = |time_s| test.at(time_s).map(|c| c.displacement_mm);
        assert_eq!(
            [at(0.0), at(0.001), at(1.5), at(1e3)],
            [None, Some(1.0), Some(1500.0), Some(2000.0)]
        );
    }
}
