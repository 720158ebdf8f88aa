//! The usable samples of a recording. What an imperfect instrument adds is found here, noted with its size, and taken out or refused
//! before any physics is looked for. It uses no model.

use super::clipping::{clipped_displacement, clipped_force};
use super::gaps::gaps;
use super::polarity::turned;
use super::smoothing::{noise, range};
use super::spikes::spikes;
use super::vibration::{
    Vibration, amplitude_at, motion_frequency_hz, remove_all_vibrations, remove_vibrations,
    shows_all_vibrations,
};
use crate::diagnose::error::{ConditionError, TurnedSign};
use crate::diagnose::note::{Note, NoteAction, NoteKind};
use crate::recording::{Flags, Recording};

/// A recording with fewer usable samples is refused.
const LEAST_SAMPLES: usize = 20;
/// Row of the first sample in a CSV file, with the header as row 1.
const FIRST_ROW: usize = 2;
/// Largest number of N, mm or s, and shortest recording in s: what is beyond them comes from a wrong unit.
const LARGEST: f64 = 1e9;
const SHORTEST_S: f64 = 1e-3;
/// A channel whose range is at most this share of its largest value does not change: rounding of the file.
const FLAT: f64 = 1e-8;
/// A vibration moves the specimen if the force answers with this share of what its rate would give.
const ANSWERED: f64 = 0.3;
/// At fewer samples a second, a note says that the true frequency of a vibration may be higher: a rig's hum and vibration often lie between
/// half of this and this.
const FASTEST_VIBRATION_HZ: f64 = 100.0;
/// A line that counts as noise does so with this share of its amplitude: the RMS of a sine.
pub(super) const SINE_RMS: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Columns over the usable samples of a recording.
pub(super) struct Samples<'a> {
    pub recording: &'a Recording,
    /// Index of each sample in the recording.
    pub kept: Vec<usize>,
    /// Time in s from the first usable sample.
    pub time_s: Vec<f64>,
    /// Displacement in mm, without steady hum.
    pub displacement_mm: Vec<f64>,
    /// Force in N, without steady hum.
    pub force_n: Vec<f64>,
    /// The last sample before each gap.
    pub gaps: Vec<usize>,
    /// The last sample before each motion that nobody recorded ends: gaps, and times when the displacement channel clipped.
    pub unseen: Vec<usize>,
    /// Hum or vibration on the displacement channel: amplitude in mm.
    pub vibration_mm: f64,
    /// The part of it that moved the specimen, mm.
    pub shaken_mm: f64,
    /// True if no hum or vibration was found on the displacement, but the motion may hide one.
    pub hides_vibration: bool,
    /// True where a channel stands at an end of its range.
    pub clipped: Vec<bool>,
    /// White noise of one displacement sample in mm.
    pub noise_mm: f64,
    /// RMS in mm of a vibration of the displacement that cannot be subtracted.
    pub wander_mm: f64,
    /// Noise of one force sample in N.
    pub noise_n: f64,
    /// What was masked or noticed, one sentence each.
    pub remarks: Vec<String>,
    pub notes: Vec<Note>,
}

impl<'a> Samples<'a> {
    /// Checks and cleans a recording.
    pub(super) fn new(recording: &'a Recording) -> Result<Samples<'a>, ConditionError> {
        check(recording)?;
        let mut samples = Samples {
            recording,
            kept: Vec::new(),
            time_s: Vec::new(),
            displacement_mm: Vec::new(),
            force_n: Vec::new(),
            gaps: Vec::new(),
            unseen: Vec::new(),
            vibration_mm: 0.0,
            shaken_mm: 0.0,
            hides_vibration: false,
            clipped: Vec::new(),
            noise_mm: 0.0,
            wander_mm: 0.0,
            noise_n: 0.0,
            remarks: Vec::new(),
            notes: Vec::new(),
        };
        let kept = usable(recording, &mut samples.remarks);
        samples.keep(kept)?;
        samples.remove_spikes()?;
        samples.check_signs()?;
        samples.find_gaps();
        samples.find_clipping();
        samples.remove_hum();
        samples.noise_mm = samples
            .noise_mm
            .hypot(noise(&samples.time_s, &samples.displacement_mm));
        samples.noise_n = noise(&samples.time_s, &samples.force_n);
        Ok(samples)
    }

    /// Keeps some samples of the recording.
    fn keep(&mut self, kept: Vec<usize>) -> Result<(), ConditionError> {
        let name = &self.recording.name;
        if kept.len() < LEAST_SAMPLES {
            return Err(ConditionError::TooShort {
                name: name.clone(),
                have: kept.len(),
                least: LEAST_SAMPLES,
            });
        }
        let start_s = self.recording.time_s[kept[0]];
        let column = |values: &[f64]| kept.iter().map(|&i| values[i]).collect::<Vec<f64>>();
        self.time_s = kept.iter().map(|&i| self.recording.time_s[i] - start_s).collect();
        if self.time_s[kept.len() - 1] < SHORTEST_S {
            return Err(ConditionError::Malformed {
                name: name.clone(),
                row: kept[kept.len() - 1] + FIRST_ROW,
                reason: "the usable samples span less than 1 ms: check the unit of time_s",
            });
        }
        self.displacement_mm = column(&self.recording.displacement_mm);
        self.force_n = column(&self.recording.force_n);
        for (values, channel) in [(&self.displacement_mm, "displacement"), (&self.force_n, "force")] {
            let largest = values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            if range(values) <= FLAT * largest {
                return Err(ConditionError::Flat {
                    name: name.clone(),
                    channel,
                });
            }
        }
        self.kept = kept;
        Ok(())
    }

    fn note(&mut self, kind: NoteKind, size: (f64, &'static str), done: NoteAction, text: String) {
        self.notes
            .push(Note::new(&self.recording.name, kind, size, done, text));
    }

    /// Leaves out samples that are far off their neighbours in either channel.
    fn remove_spikes(&mut self) -> Result<(), ConditionError> {
        let mut off = vec![false; self.kept.len()];
        for (channel, unit) in [("displacement", "mm"), ("force", "N")] {
            let values = if unit == "mm" {
                &self.displacement_mm
            } else {
                &self.force_n
            };
            let found = spikes(&self.time_s, values, noise(&self.time_s, values));
            let count = found.samples.len();
            for &i in &found.samples {
                off[i] = true;
            }
            if count > 0 {
                let text = format!(
                    "{count} samples of the {channel} stand up to {:.3} {unit} off their neighbours and are left out: check cable and \
                     plugs of the channel",
                    found.largest
                );
                self.note(
                    NoteKind::Spike,
                    (count as f64, "samples"),
                    NoteAction::Masked,
                    text,
                );
            }
        }
        if !off.contains(&true) {
            return Ok(());
        }
        let left = self.kept.iter().zip(&off).filter(|(_, off)| !**off);
        let left = left.map(|(i, _)| *i).collect();
        self.keep(left)
    }

    /// Refuses a recording whose loading does not raise force and displacement.
    fn check_signs(&self) -> Result<(), ConditionError> {
        let Some(sign) = turned(&self.displacement_mm, &self.force_n) else {
            return Ok(());
        };
        let end = |pick: fn(f64, f64) -> f64| self.force_n.iter().copied().reduce(pick).unwrap_or(0.0);
        let (low_n, high_n) = (end(f64::min), end(f64::max));
        let rate = range(&self.force_n) / range(&self.displacement_mm);
        let what = match sign {
            TurnedSign::Both => format!("the force is never positive ({low_n:.0} to {high_n:.0} N)"),
            _ => format!(
                "the force falls by about {rate:.1} N per mm of rising displacement ({low_n:.0} to {high_n:.0} N)"
            ),
        };
        Err(ConditionError::Polarity {
            name: self.recording.name.clone(),
            what,
            sign,
        })
    }

    fn find_gaps(&mut self) {
        self.gaps = gaps(&self.time_s, &self.displacement_mm, range(&self.displacement_mm));
        self.unseen.clone_from(&self.gaps);
        for i in self.gaps.clone() {
            let (from_s, to_s) = (self.time_s[i], self.time_s[i + 1]);
            let text = format!(
                "no samples from {from_s:.3} s to {to_s:.3} s: what the friction remembers is unknown, so the motion after it is \
                 compared only after enough travel; record without interruption"
            );
            self.note(NoteKind::Gap, (to_s - from_s, "s"), NoteAction::Masked, text);
        }
    }

    /// Masks samples at an end of a channel. A force at its upper end stays: which limit the channel has is a finding.
    fn find_clipping(&mut self) {
        self.clipped = vec![false; self.kept.len()];
        let noise_mm = noise(&self.time_s, &self.displacement_mm);
        if let Some(found) = clipped_displacement(&self.displacement_mm, &self.force_n, noise_mm) {
            let (count, [low, high]) = (found.count(), found.ends);
            let text = format!(
                "the displacement channel clips: {count} samples stay at {low:.2} or {high:.2} mm while the force changes; they are masked"
            );
            self.remarks.push(text.clone());
            let text = format!("{text}: move the LVDT or use one with a longer stroke");
            self.note(
                NoteKind::Clipping,
                (count as f64, "samples"),
                NoteAction::Masked,
                text,
            );
            let ends = |i: &usize| found.mask[*i] && !found.mask.get(i + 1).is_some_and(|m| *m);
            self.unseen.extend((0..found.mask.len()).filter(ends));
            self.clipped = found.mask;
        }
        let Some(found) = clipped_force(&self.force_n, &self.displacement_mm) else {
            return;
        };
        let (count, [low, high]) = (found.count(), found.ends);
        let below = |i: usize| found.mask[i] && self.force_n[i] < 0.5 * (low + high);
        let low_end: Vec<usize> = (0..found.mask.len()).filter(|&i| below(i)).collect();
        for &i in &low_end {
            self.clipped[i] = true;
        }
        let done = if low_end.len() == count {
            NoteAction::Masked
        } else {
            NoteAction::Told
        };
        let text = format!(
            "the force channel clips: {count} samples stay at {low:.1} or {high:.1} N while the displacement changes: check the range \
             of the amplifier"
        );
        self.note(NoteKind::Clipping, (count as f64, "samples"), done, text);
    }

    /// Subtracts hum of constant phase from both channels. On the displacement, hum whose phase wanders counts as noise, so that
    /// its reversals are none.
    fn remove_hum(&mut self) {
        let motion_hz = motion_frequency_hz(&self.time_s, &self.displacement_mm);
        let raw_n = self.force_n.clone();
        let rate = range(&self.force_n) / range(&self.displacement_mm);
        // A vibration that the force answers has moved the specimen.
        let moves = |line: &Vibration| {
            let answer_n = amplitude_at(&self.time_s, &raw_n, motion_hz, line.frequency_hz);
            answer_n > ANSWERED * rate * line.amplitude
        };
        let of_displacement =
            remove_all_vibrations(&self.time_s, &mut self.displacement_mm, motion_hz, &moves);
        self.shaken_mm = of_displacement
            .iter()
            .filter(|line| moves(line))
            .map(|line| line.amplitude)
            .sum();
        self.vibration_mm = of_displacement.iter().map(|line| line.amplitude).sum();
        self.hides_vibration = of_displacement.is_empty() && !shows_all_vibrations(&self.time_s, motion_hz);
        for line in &of_displacement {
            if !line.is_steady() {
                self.wander_mm = self.wander_mm.hypot(SINE_RMS * line.amplitude);
            }
            self.note_hum("displacement", "mm", line);
        }
        let of_force = remove_vibrations(&self.time_s, &mut self.force_n, motion_hz);
        for line in of_force.iter().filter(|line| line.is_steady()) {
            self.note_hum("force", "N", line);
        }
    }

    fn note_hum(&mut self, channel: &str, unit: &'static str, line: &Vibration) {
        let done = if line.is_steady() {
            "it is subtracted"
        } else {
            "its phase wanders, so it counts as noise"
        };
        let rate_hz = (self.time_s.len() - 1) as f64 / self.time_s[self.time_s.len() - 1];
        let perhaps_higher = if rate_hz < FASTEST_VIBRATION_HZ {
            format!(" (or faster: {rate_hz:.0} samples a second do not tell)")
        } else {
            String::new()
        };
        let text = format!(
            "hum or vibration of {:.4} {unit} at {:.2} Hz{perhaps_higher} on the {channel}: {done}; its reversals are not counted; check \
             shielding, grounding and the servo",
            line.amplitude, line.frequency_hz
        );
        self.note(NoteKind::Hum, (line.amplitude, unit), NoteAction::Corrected, text);
    }
}

/// Refuses columns of different length, values that are not finite or too large, and time that does not rise.
fn check(recording: &Recording) -> Result<(), ConditionError> {
    let malformed = |index: usize, reason: &'static str| ConditionError::Malformed {
        name: recording.name.clone(),
        row: index + FIRST_ROW,
        reason,
    };
    let n = recording.len();
    let shortest = n
        .min(recording.displacement_mm.len())
        .min(recording.force_n.len());
    if recording.displacement_mm.len() != n || recording.force_n.len() != n {
        return Err(malformed(
            shortest,
            "a column ends before the others: give one value per row in each column",
        ));
    }
    for i in 0..n {
        let values = [
            recording.time_s[i],
            recording.displacement_mm[i],
            recording.force_n[i],
        ];
        if values.iter().any(|v| !v.is_finite()) {
            return Err(malformed(
                i,
                "a value is not finite: remove the row or correct the value",
            ));
        }
        if values.iter().any(|v| v.abs() > LARGEST) {
            return Err(malformed(i, "a value is above 1e9: check the unit of its column"));
        }
        if i > 0 && recording.time_s[i] <= recording.time_s[i - 1] {
            return Err(malformed(
                i,
                "the time does not rise: sort the rows and remove duplicates",
            ));
        }
    }
    Ok(())
}

/// Indices of the samples whose flags leave force and displacement valid.
fn usable(recording: &Recording, remarks: &mut Vec<String>) -> Vec<usize> {
    let n = recording.len();
    let Some(flags) = recording.flags.as_ref().filter(|f| f.len() == n) else {
        return (0..n).collect();
    };
    let kept: Vec<usize> = (0..n)
        .filter(|&i| !Flags::from_bits_retain(flags[i]).intersects(Flags::UNUSABLE))
        .collect();
    if kept.len() < n {
        remarks.push(format!(
            "{} of {n} samples are flagged as invalid and left out",
            n - kept.len()
        ));
    }
    kept
}
