//! Turns a recording into a [`Track`]: noise, reversals, cycles, bins and masks. It uses no model.
//!
//! The plant is stepped over every point of a track; only points with a weight are compared. Between reversals the displacement is
//! made monotone (pool adjacent violators), so that noise is no travel for a friction law.

use std::ops::Range;

use super::polarity::energy_given_j;
use super::samples::{SINE_RMS, Samples};
use super::smoothing::{Local, monotone, range, smoothed};
use super::thinning::bins;
use super::track::Track;
use super::travel::{Travel, compared, starts_from_rest};
use super::turning_points::{TurningPoint, smooth_dwells, turning_points};
use crate::diagnose::course::Split;
use crate::diagnose::error::ConditionError;
use crate::diagnose::note::{Note, NoteAction, NoteKind};
use crate::model::Motion;
use crate::recording::{Recording, cycles};

/// Averaging in a bin lowers the noise by at most this factor: hum and drift do not average out.
pub(in crate::diagnose) const LARGEST_AVERAGING: f64 = 4.0;
/// Factor by which the noise of a channel may differ between recordings: its filter may follow the sampling rate.
const NOISE_RATIO: f64 = 1.5;
/// Smallest travel between reversals, in noises and as a share of the stroke. It is kept small: a reversal that is missed puts the
/// friction on the wrong side.
const REVERSAL_NOISES: f64 = 6.0;
const REVERSAL_STROKE: f64 = 5e-4;
/// Smallest noise of a force sample as a share of its range: below it, rounding of the file counts.
const LEAST_NOISE: f64 = 1e-5;
/// Share of the stroke after a reversal for which the friction remembers that a vibration turned the specimen.
const SHAKEN_TRAVEL: f64 = 0.15;

/// One row of a [`Track`].
#[derive(Clone, Copy)]
struct TrackPoint {
    time_s: f64,
    displacement_mm: f64,
    force_n: f64,
    weight: f64,
    direction: f64,
    since_reversal_mm: f64,
    motion: Motion,
    turn_error_mm: f64,
    hidden_mm: f64,
    width_s: f64,
    cycle: u32,
}

/// Conditions recordings of one rig, each into about `budget` points at most.
pub(super) fn condition(recordings: &[Recording], budget: usize) -> Result<Vec<Track>, ConditionError> {
    let mut raw = recordings
        .iter()
        .map(Samples::new)
        .collect::<Result<Vec<_>, _>>()?;
    // The channels are the same in all recordings. A vibration is noise where no line of it was found.
    let vibrations = raw.iter().map(|r| r.vibration_mm).filter(|mm| *mm > 0.0);
    let hidden_mm = SINE_RMS * vibrations.reduce(f64::min).unwrap_or(0.0);
    for raw in raw.iter_mut().filter(|r| r.hides_vibration) {
        raw.noise_mm = raw.noise_mm.max(hidden_mm);
    }
    // Where one motion hides the noise of the channels, another shows it.
    let least = |f: fn(&Samples) -> f64| NOISE_RATIO * raw.iter().map(f).fold(f64::INFINITY, f64::min);
    let (noise_mm, with_vibration_mm, noise_n) = (
        least(|r| r.noise_mm),
        least(|r| r.noise_mm.hypot(SINE_RMS * r.vibration_mm)),
        least(|r| r.noise_n),
    );
    Ok(raw
        .into_iter()
        .map(|mut raw| {
            let most_mm = if raw.vibration_mm > 0.0 {
                noise_mm
            } else {
                with_vibration_mm
            };
            raw.noise_mm = raw.noise_mm.min(most_mm).hypot(raw.wander_mm);
            raw.noise_n = raw.noise_n.min(noise_n);
            raw.track(budget)
        })
        .collect())
}

impl Samples<'_> {
    /// Conditions into about `budget` points at most.
    fn track(mut self, budget: usize) -> Track {
        let stroke_mm = range(&self.displacement_mm);
        let force_range_n = range(&self.force_n);
        let motion = SmoothMotion::new(&self.time_s, &self.displacement_mm, self.noise_mm, &self.gaps);
        let cycle = self.cycles(&motion.travel);
        self.note_backwards(&motion.travel);
        let rate = force_range_n / stroke_mm;
        let sigma_n = self
            .noise_n
            .hypot(rate * self.noise_mm)
            .max(LEAST_NOISE * force_range_n);
        let known = compared(&motion.steady_mm, &self.force_n, &motion.travel, &self.unseen);
        self.note_start(&known, &motion.travel);
        let mut points = Vec::new();
        for (bin, compared) in bins(
            &self.time_s,
            &motion.steady_mm,
            &motion.travel,
            &self.gaps,
            stroke_mm,
            budget,
        ) {
            let masked = !compared || bin.clone().any(|i| !known[i] || self.clipped[i]);
            let sigma_n = (!masked).then_some(sigma_n);
            let point = self.mean_point(&motion, &cycle, bin.clone(), sigma_n);
            points.push(point);
            points.extend(self.turning_point(&motion, point, bin.end - 1));
        }
        let frequency_hz = motion.travel.frequency_hz(&self.time_s);
        self.into_track(&points, frequency_hz)
    }

    /// Notes a recording that starts within a cycle; `known` tells where the state of the friction is known.
    fn note_start(&mut self, known: &[bool], travel: &Travel) {
        let first = known.iter().position(|k| *k).unwrap_or(0);
        if first == 0 || starts_from_rest(&self.displacement_mm, &self.force_n, travel) {
            return;
        }
        let masked_s = self.time_s[first];
        self.notes.push(Note::new(
            &self.recording.name,
            NoteKind::Start,
            (masked_s, "s"),
            NoteAction::Masked,
            format!(
                "the recording starts at {:.2} mm and {:.0} N, not unloaded at rest: what the friction remembers is unknown, so the \
                 first {masked_s:.2} s are not compared; start recordings from the unloaded rest",
                self.displacement_mm[0], self.force_n[0]
            ),
        ));
    }

    /// Notes loops that give energy.
    fn note_backwards(&mut self, travel: &Travel) {
        let given_j = energy_given_j(&self.displacement_mm, &self.force_n, travel.turns.len());
        if let Some(given_j) = given_j {
            self.notes.push(Note::new(
                &self.recording.name,
                NoteKind::Skew,
                (given_j, "J"),
                NoteAction::Told,
                format!(
                    "the loops give {given_j:.3} J instead of taking it up: the force leads the displacement; check that both channels \
                     have the same filters and the same clock"
                ),
            ));
        }
    }

    /// Cycle of every sample: as the recording counts them, or from the reversals.
    fn cycles(&self, travel: &Travel) -> Vec<u32> {
        match &self.recording.cycle {
            Some(counted)
                if counted.len() == self.recording.len() && self.kept.iter().any(|&i| counted[i] > 0) =>
            {
                self.kept.iter().map(|&i| counted[i]).collect()
            }
            _ => travel.half.iter().map(|&h| h / 2 + 1).collect(),
        }
    }

    fn sample_hz(&self) -> f64 {
        (self.time_s.len() - 1) as f64 / (self.time_s[self.time_s.len() - 1] - self.time_s[0])
    }

    /// Mean of a bin of samples; `sigma_n` is the noise of one sample, `None` where the point is masked.
    fn mean_point(
        &self,
        motion: &SmoothMotion,
        cycle: &[u32],
        bin: Range<usize>,
        sigma_n: Option<f64>,
    ) -> TrackPoint {
        let n = bin.len() as f64;
        let mean = |v: &[f64]| v[bin.clone()].iter().sum::<f64>() / n;
        let last = bin.end - 1;
        let locals = &motion.locals[bin.clone()];
        TrackPoint {
            time_s: mean(&self.time_s),
            displacement_mm: mean(&motion.steady_mm),
            force_n: mean(&self.force_n),
            weight: sigma_n.map_or(0.0, |sigma_n| n.sqrt().min(LARGEST_AVERAGING) / sigma_n),
            direction: motion.travel.direction[last],
            since_reversal_mm: motion.travel.since_mm[last],
            motion: Motion {
                velocity_mm_s: locals.iter().map(|l| l.mm_s).sum::<f64>() / n,
                acceleration_mm_s2: locals.iter().map(|l| l.mm_s2).sum::<f64>() / n,
                reach_mm: motion.travel.reach(last, &motion.turning_points),
            },
            turn_error_mm: motion.travel.turn_error_mm(last, &motion.turning_points),
            hidden_mm: (largest(&motion.back_mm[bin]) - self.noise_mm).max(self.shaken_back_mm(motion, last)),
            width_s: n / self.sample_hz(),
            cycle: cycle[last],
        }
    }

    /// Way in mm that a vibration moves the specimen to and fro near a reversal, where the motion is slower than the vibration. It is
    /// no reversal of the test, but the friction remembers it for some travel.
    fn shaken_back_mm(&self, motion: &SmoothMotion, i: usize) -> f64 {
        let remembered_mm = SHAKEN_TRAVEL * range(&motion.steady_mm);
        if motion.travel.since_mm[i].min(motion.travel.until_mm[i]) < remembered_mm {
            2.0 * self.shaken_mm
        } else {
            0.0
        }
    }

    /// The turning point that follows sample `last`, if it lies between two samples: the plant is stepped to it, nothing is compared.
    fn turning_point(&self, motion: &SmoothMotion, before: TrackPoint, last: usize) -> Option<TrackPoint> {
        let between = motion
            .turning_points
            .iter()
            .filter_map(|t| Some((t.between?, t.mm)));
        let ((_, time_s), displacement_mm) = between.into_iter().find(|((i, _), _)| *i == last)?;
        Some(TrackPoint {
            time_s,
            displacement_mm,
            force_n: self.force_n[last],
            weight: 0.0,
            motion: Motion {
                velocity_mm_s: 0.0,
                acceleration_mm_s2: motion.locals[last].mm_s2,
                ..before.motion
            },
            width_s: 0.0,
            ..before
        })
    }

    fn into_track(self, points: &[TrackPoint], frequency_hz: f64) -> Track {
        let column = |f: fn(&TrackPoint) -> f64| points.iter().map(f).collect::<Vec<f64>>();
        debug_assert!(points.windows(2).all(|w| w[1].time_s > w[0].time_s));
        Track {
            name: self.recording.name.clone(),
            time_s: column(|p| p.time_s),
            displacement_mm: column(|p| p.displacement_mm),
            force_n: column(|p| p.force_n),
            weight: column(|p| p.weight),
            direction: column(|p| p.direction),
            since_reversal_mm: column(|p| p.since_reversal_mm),
            motion: points.iter().map(|p| p.motion).collect(),
            turn_error_mm: column(|p| p.turn_error_mm),
            hidden_mm: column(|p| p.hidden_mm),
            width_s: column(|p| p.width_s),
            cycle: points.iter().map(|p| p.cycle).collect(),
            split: vec![Split::Fit; points.len()],
            frequency_hz,
            sample_hz: self.sample_hz(),
            noise_n: self.noise_n,
            noise_mm: self.noise_mm,
            vibration_mm: self.vibration_mm,
            cycles: points.iter().map(|p| p.cycle).max().unwrap_or(0),
            remarks: self.remarks,
            notes: self.notes,
        }
    }
}

/// The motion of a recording without its noise.
struct SmoothMotion {
    /// Displacement, speed and acceleration at every sample.
    locals: Vec<Local>,
    /// Displacement in mm, monotone between reversals.
    steady_mm: Vec<f64>,
    /// Way back from the farthest point since the last turn, mm.
    back_mm: Vec<f64>,
    travel: Travel,
    turning_points: Vec<TurningPoint>,
}

impl SmoothMotion {
    /// `gaps` are the last samples before a gap: no window reaches over one, and no turn is dated within one.
    fn new(time_s: &[f64], raw_mm: &[f64], noise_mm: f64, gaps: &[usize]) -> SmoothMotion {
        let mut locals = Vec::with_capacity(raw_mm.len());
        let ends = gaps.iter().map(|last| last + 1).chain([raw_mm.len()]);
        for end in ends {
            let piece = locals.len()..end;
            locals.extend(smoothed(&time_s[piece.clone()], &raw_mm[piece], noise_mm));
        }
        let smooth_mm: Vec<f64> = locals.iter().map(|l| l.mm).collect();
        let band_mm = (REVERSAL_NOISES * noise_mm).max(REVERSAL_STROKE * range(raw_mm));
        let turns: Vec<usize> = cycles::reversals(&smooth_mm, band_mm)
            .iter()
            .map(|r| r.index)
            .collect();
        smooth_dwells(time_s, raw_mm, &turns, noise_mm, &mut locals);
        let smooth_mm: Vec<f64> = locals.iter().map(|l| l.mm).collect();
        let steady_mm = monotone(&smooth_mm, &turns);
        let travel = Travel::new(&steady_mm, &turns);
        let mut turning_points = turning_points(time_s, &locals, &steady_mm, &turns, noise_mm);
        for (turn, &index) in turning_points.iter_mut().zip(&turns) {
            if turn.between.is_some_and(|(i, _)| gaps.contains(&i)) {
                (turn.mm, turn.between) = (steady_mm[index], None);
            }
        }
        SmoothMotion {
            back_mm: way_back(&locals, &travel),
            travel,
            turning_points,
            locals,
            steady_mm,
        }
    }
}

/// Way back in mm of every sample from the farthest point that the motion has reached since its last turn. It is the part of
/// the motion that is too small for a turn.
fn way_back(locals: &[Local], travel: &Travel) -> Vec<f64> {
    let mut farthest_mm = f64::NEG_INFINITY;
    let mut half = None;
    let samples = locals.iter().zip(&travel.half).zip(&travel.direction);
    samples
        .map(|((local, of_sample), direction)| {
            let along_mm = direction * local.mm;
            if half != Some(of_sample) {
                (half, farthest_mm) = (Some(of_sample), along_mm);
            }
            farthest_mm = farthest_mm.max(along_mm);
            farthest_mm - along_mm
        })
        .collect()
}

/// Largest value of the condition, in its own unit.
fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

#[cfg(test)]
mod tests;
