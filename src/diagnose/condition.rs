//! Conditions a recording: smooth monotone travel between reversals, noise, bins that keep reversals sharp, branches,
//! cycles, what is masked and why. It knows no model.
//!
//! The plant is stepped over every point of a [`Track`]; only points with a weight count. Between reversals the
//! displacement is made monotone (pool adjacent violators), so that noise is no travel for a friction law.

pub(super) use super::smoothing::noise;
use super::smoothing::{monotone, smoothed};
use super::travel::{Travel, settled_from};
use super::turning::{settle_turns, turned};
use crate::model::Motion;
use crate::recording::{Flags, Recording, cycles};

/// Fewer samples than this are no recording.
const LEAST_SAMPLES: usize = 20;
/// Averaging never counts for more than this factor in noise: hum and drift do not average out.
const LARGEST_AVERAGING: f64 = 4.0;

/// A channel's noise may differ from recording to recording by this factor: its filter follows the sampling rate.
const OTHERS: f64 = 1.5;

/// Why a recording cannot be judged.
#[derive(Debug, thiserror::Error, PartialEq)]
pub(crate) enum ConditionError {
    /// Too short, or nothing left after masking.
    #[error("{name}: {have} usable samples, at least {LEAST_SAMPLES} are needed: record longer")]
    TooShort {
        /// The recording.
        name: String,
        /// Usable samples.
        have: usize,
    },
    /// Columns of different length, values not finite, or time that does not rise.
    #[error("{name}, row {row}: {reason}")]
    Malformed {
        /// The recording.
        name: String,
        /// From 1, the header not counted.
        row: usize,
        /// What is wrong and what to do.
        reason: &'static str,
    },
    /// A channel that never moves.
    #[error("{name}: the {channel} does not change: check the channel and its sign")]
    Flat {
        /// The recording.
        name: String,
        /// `displacement` or `force`.
        channel: &'static str,
    },
}

/// What a block of samples is used for; no parameter is ever fitted on `Select` or `Report`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Split {
    /// Parameters are fitted here.
    Fit,
    /// Candidates are compared here.
    Select,
    /// Errors are quoted from here.
    Report,
}

/// A conditioned recording: columns of equal length.
#[derive(Debug, Clone)]
pub(crate) struct Track {
    /// Name of the recording.
    pub name: String,
    /// Time in s from the recording's first sample.
    pub time_s: Vec<f64>,
    /// Displacement in mm, monotone between reversals.
    pub displacement_mm: Vec<f64>,
    /// Force in N, mean of the samples in the bin.
    pub force_n: Vec<f64>,
    /// 1 / standard deviation in 1/N; 0 where masked.
    pub weight: Vec<f64>,
    /// Direction of travel: 1 loading, -1 unloading.
    pub direction: Vec<f64>,
    /// Travel since the last reversal in mm.
    pub since_reversal_mm: Vec<f64>,
    /// Speed in mm/s, acceleration in mm/s2 and the turning points on either side in mm, seen with hindsight.
    pub motion: Vec<Motion>,
    /// How far the last turning point may be off, mm.
    pub turn_error_mm: Vec<f64>,
    /// Time in s that the point is the mean over.
    pub width_s: Vec<f64>,
    /// Cycle from 1.
    pub cycle: Vec<u32>,
    /// What the sample's cycle is used for.
    pub part: Vec<Split>,
    /// Frequency of the motion in Hz; 0 where there are not two reversals.
    pub frequency_hz: f64,
    /// Raw samples a second.
    pub sample_hz: f64,
    /// Noise of one raw force sample in N, from the signal itself.
    pub noise_n: f64,
    /// Noise of one raw displacement sample in mm.
    pub noise_mm: f64,
    /// Whole cycles.
    pub cycles: u32,
    /// What was masked or noticed, one sentence each.
    pub remarks: Vec<String>,
}

impl Track {
    /// Number of points.
    pub(crate) fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True where there is none.
    pub(crate) fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Largest speed in mm/s.
    pub(crate) fn top_speed_mm_s(&self) -> f64 {
        let speeds = self.motion.iter().map(|m| m.velocity_mm_s.abs());
        speeds.fold(0.0, f64::max)
    }

    /// Time since the point before, in s.
    pub(crate) fn dt_s(&self, i: usize) -> f64 {
        if i == 0 {
            0.0
        } else {
            self.time_s[i] - self.time_s[i - 1]
        }
    }
}

/// Conditions recordings of one rig, each into at most about `budget` points.
pub(crate) fn condition(recordings: &[Recording], budget: usize) -> Result<Vec<Track>, ConditionError> {
    let raw = recordings
        .iter()
        .map(RawTrack::new)
        .collect::<Result<Vec<_>, _>>()?;
    // The channels are the same in all: where one motion hides their noise, another shows it.
    let least = |f: fn(&RawTrack) -> f64| OTHERS * raw.iter().map(f).fold(f64::INFINITY, f64::min);
    let (noise_mm, noise_n) = (least(|r| r.noise_mm), least(|r| r.noise_n));
    Ok(raw
        .into_iter()
        .map(|mut raw| {
            raw.noise_mm = raw.noise_mm.min(noise_mm);
            raw.noise_n = raw.noise_n.min(noise_n);
            raw.track(budget)
        })
        .collect())
}

/// The samples of a recording that are used.
struct RawTrack<'a> {
    recording: &'a Recording,
    kept: Vec<usize>,
    time_s: Vec<f64>,
    displacement_mm: Vec<f64>,
    force_n: Vec<f64>,
    noise_mm: f64,
    noise_n: f64,
    remarks: Vec<String>,
}

impl<'a> RawTrack<'a> {
    fn new(recording: &'a Recording) -> Result<RawTrack<'a>, ConditionError> {
        check(recording)?;
        let mut remarks = Vec::new();
        let kept = usable(recording, &mut remarks);
        if kept.len() < LEAST_SAMPLES {
            return Err(ConditionError::TooShort {
                name: recording.name.clone(),
                have: kept.len(),
            });
        }
        let column = |values: &[f64]| kept.iter().map(|&i| values[i]).collect::<Vec<f64>>();
        let start_s = recording.time_s[kept[0]];
        let time_s: Vec<f64> = kept.iter().map(|&i| recording.time_s[i] - start_s).collect();
        let (displacement_mm, force_n) = (column(&recording.displacement_mm), column(&recording.force_n));
        for (values, channel) in [(&displacement_mm, "displacement"), (&force_n, "force")] {
            if range(values) <= 0.0 {
                return Err(ConditionError::Flat {
                    name: recording.name.clone(),
                    channel,
                });
            }
        }
        Ok(RawTrack {
            noise_mm: noise(&time_s, &displacement_mm),
            noise_n: noise(&time_s, &force_n),
            recording,
            kept,
            time_s,
            displacement_mm,
            force_n,
            remarks,
        })
    }

    /// Conditions into at most about `budget` points.
    fn track(self, budget: usize) -> Track {
        let RawTrack {
            recording,
            kept,
            time_s,
            displacement_mm: raw_mm,
            force_n,
            noise_mm,
            noise_n,
            mut remarks,
        } = self;
        let (stroke_mm, force_range_n) = (range(&raw_mm), range(&force_n));
        let mut locals = smoothed(&time_s, &raw_mm, noise_mm);
        let smooth_mm: Vec<f64> = locals.iter().map(|l| l.mm).collect();
        // As small as the noise lets it be: a turn-round that is missed leaves the friction on the wrong side.
        let band_mm = (6.0 * noise_mm).max(5e-4 * stroke_mm);
        let turns: Vec<usize> = cycles::reversals(&smooth_mm, band_mm)
            .iter()
            .map(|r| r.index)
            .collect();
        settle_turns(&time_s, &raw_mm, &turns, noise_mm, &mut locals);
        let smooth_mm: Vec<f64> = locals.iter().map(|l| l.mm).collect();
        let steady_mm = monotone(&smooth_mm, &turns);
        let motion = Travel::new(&steady_mm, &turns);
        let cycle: Vec<u32> = match &recording.cycle {
            Some(counted) if kept.iter().any(|&i| counted[i] > 0) => {
                kept.iter().map(|&i| counted[i]).collect()
            }
            _ => motion.half.iter().map(|&h| h / 2 + 1).collect(),
        };
        let clipped = clipped(&raw_mm, &force_n, noise_mm, &mut remarks);
        let turned = turned(&time_s, &locals, &steady_mm, &turns, noise_mm);
        let bins = bins(&time_s, &steady_mm, &motion, stroke_mm, budget);
        let rate = force_range_n / stroke_mm;
        let sigma_n = noise_n.hypot(rate * noise_mm).max(1e-5 * force_range_n);
        let mut track = Track {
            name: recording.name.clone(),
            time_s: Vec::new(),
            displacement_mm: Vec::new(),
            force_n: Vec::new(),
            weight: Vec::new(),
            direction: Vec::new(),
            since_reversal_mm: Vec::new(),
            motion: Vec::new(),
            turn_error_mm: Vec::new(),
            width_s: Vec::new(),
            cycle: Vec::new(),
            part: Vec::new(),
            frequency_hz: motion.frequency_hz(&time_s),
            sample_hz: (time_s.len() - 1) as f64 / (time_s[time_s.len() - 1] - time_s[0]),
            noise_n,
            noise_mm,
            cycles: 0,
            remarks,
        };
        let settled = settled_from(&steady_mm, &force_n, &turns, stroke_mm);
        for (bin, judged) in bins {
            let n = bin.len() as f64;
            let mean = |v: &[f64]| v[bin.clone()].iter().sum::<f64>() / n;
            let last = bin.end - 1;
            track.time_s.push(mean(&time_s));
            track.displacement_mm.push(mean(&steady_mm));
            track.force_n.push(mean(&force_n));
            let masked = !judged || bin.start < settled || bin.clone().any(|i| clipped[i]);
            let averaging = n.sqrt().min(LARGEST_AVERAGING);
            track.weight.push(if masked { 0.0 } else { averaging / sigma_n });
            track.direction.push(motion.direction[last]);
            track.since_reversal_mm.push(motion.since_mm[last]);
            track.cycle.push(cycle[last]);
            track.motion.push(Motion {
                velocity_mm_s: locals[bin.clone()].iter().map(|l| l.mm_s).sum::<f64>() / n,
                acceleration_mm_s2: locals[bin.clone()].iter().map(|l| l.mm_s2).sum::<f64>() / n,
                reach_mm: motion.reach(last, &turned),
            });
            track.width_s.push(n / track.sample_hz);
            track.turn_error_mm.push(motion.turn_error_mm(last, &turned));
            // The turning point itself lies between samples: the plant goes there, nothing is compared.
            let between = turned.iter().filter_map(|t| Some((t.between?, t.mm)));
            if let Some(((_, time), mm)) = between.into_iter().find(|((i, _), _)| *i == last) {
                track.time_s.push(time);
                track.displacement_mm.push(mm);
                track.force_n.push(force_n[last]);
                track.weight.push(0.0);
                track.direction.push(motion.direction[last]);
                track.since_reversal_mm.push(motion.since_mm[last]);
                track.cycle.push(cycle[last]);
                track.motion.push(Motion {
                    velocity_mm_s: 0.0,
                    acceleration_mm_s2: locals[last].mm_s2,
                    reach_mm: motion.reach(last, &turned),
                });
                track.width_s.push(0.0);
                track.turn_error_mm.push(motion.turn_error_mm(last, &turned));
            }
        }
        let n = track.len();
        debug_assert!(track.time_s.windows(2).all(|w| w[1] > w[0]));
        track.part = vec![Split::Fit; n];
        track.cycles = track.cycle.iter().copied().max().unwrap_or(0);
        track
    }
}

fn check(recording: &Recording) -> Result<(), ConditionError> {
    let malformed = |row: usize, reason: &'static str| ConditionError::Malformed {
        name: recording.name.clone(),
        row,
        reason,
    };
    let n = recording.len();
    if recording.displacement_mm.len() != n || recording.force_n.len() != n {
        return Err(malformed(
            n,
            "columns have different lengths: give one value a row in each",
        ));
    }
    for i in 0..n {
        let finite = recording.time_s[i].is_finite()
            && recording.displacement_mm[i].is_finite()
            && recording.force_n[i].is_finite();
        if !finite {
            return Err(malformed(
                i + 1,
                "a value is not finite: remove the row or mend the value",
            ));
        }
        if i > 0 && recording.time_s[i] <= recording.time_s[i - 1] {
            return Err(malformed(
                i + 1,
                "time does not rise: sort the rows and remove doubles",
            ));
        }
    }
    Ok(())
}

/// Samples whose flags leave both channels believable.
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
            "{} of {n} samples are flagged as not valid and left out",
            n - kept.len()
        ));
    }
    kept
}

pub(super) fn range(values: &[f64]) -> f64 {
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    high - low
}

/// A displacement that stands at its extreme while the force goes on is a clipped LVDT: masked and named.
fn clipped(x: &[f64], force_n: &[f64], noise_mm: f64, remarks: &mut Vec<String>) -> Vec<bool> {
    let mut mask = vec![false; x.len()];
    let high = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let low = x.iter().copied().fold(f64::INFINITY, f64::min);
    let (stroke, force_range) = (high - low, range(force_n));
    let tolerance = (0.5 * noise_mm).max(1e-7 * stroke);
    for rail in [low, high] {
        let mut i = 0;
        while i < x.len() {
            let start = i;
            while i < x.len() && (x[i] - rail).abs() <= tolerance {
                i += 1;
            }
            if i > start + 4 && range(&force_n[start..i]) > 0.05 * force_range {
                mask[start..i].fill(true);
            }
            i += usize::from(i == start);
        }
    }
    let count = mask.iter().filter(|m| **m).count();
    if count > 0 {
        remarks.push(format!(
            "the displacement channel clips: {count} samples stand at {low:.2} or {high:.2} mm while the force goes on; they are masked"
        ));
    }
    mask
}

/// Bins, and whether they are judged: in a few whole cycles spread over the recording they are, fine after reversals; all
/// others are only gone through, in steps too coarse for a mean force to belong to a mean displacement.
fn bins(
    time_s: &[f64],
    x: &[f64],
    motion: &Travel,
    stroke_mm: f64,
    budget: usize,
) -> Vec<(std::ops::Range<usize>, bool)> {
    let n = time_s.len();
    if n <= budget {
        return (0..n).map(|i| (i..i + 1, true)).collect();
    }
    let halves = motion.half[n - 1] + 1;
    let cycles = halves.div_ceil(2);
    let fine_cycles = 9;
    let every = cycles.div_ceil(fine_cycles).max(1);
    let duration_s = time_s[n - 1] - time_s[0];
    let fine = |i: usize| {
        let cycle = motion.half[i] / 2;
        cycle.is_multiple_of(every) || cycle + 2 >= cycles || cycle <= 1
    };
    let cost: Vec<f64> = (0..n)
        .map(|i| {
            if i == 0 {
                return 0.0;
            }
            let (resolution_mm, slow) = if fine(i) {
                let turn_mm = motion.since_mm[i].min(motion.until_mm[i]);
                ((stroke_mm / 600.0).max(0.04 * turn_mm), 1.0)
            } else {
                (stroke_mm / 25.0, 8.0)
            };
            let dt_s = time_s[i] - time_s[i - 1];
            (x[i] - x[i - 1]).abs() / resolution_mm + 300.0 * dt_s / duration_s.min(30.0) / slow
        })
        .collect();
    let mut scale = cost.iter().sum::<f64>() / budget as f64;
    loop {
        let mut bins = Vec::with_capacity(budget);
        let (mut start, mut filled) = (0, 0.0);
        for (i, cost) in cost.iter().enumerate() {
            filled += cost / scale;
            // A turning point, and the sample before it, stand alone: a mean would cut the travel short.
            let turns = (1..=2).any(|k| i + k < n && motion.half[i + k] != motion.half[i])
                || (i > 0 && motion.half[i - 1] != motion.half[i]);
            if filled >= 1.0 || turns || i + 1 == n {
                bins.push((start..i + 1, fine(start)));
                start = i + 1;
                filled = 0.0;
            }
        }
        if bins.len() <= budget + 4 * halves as usize || scale > 1e12 {
            return bins;
        }
        scale *= 1.1;
    }
}

/// Shares whole cycles out: of four, two for fitting, one for selecting, one for reporting. Recordings of fewer cycles are
/// fitted; where no recording has enough cycles, whole recordings are held out instead.
pub(super) fn share_out(tracks: &mut [Track]) {
    let mut shared = false;
    for track in tracks.iter_mut() {
        let mut counted: Vec<u32> = track
            .cycle
            .iter()
            .zip(&track.weight)
            .filter(|(_, w)| **w > 0.0)
            .map(|(c, _)| *c)
            .collect();
        counted.dedup();
        counted.sort_unstable();
        counted.dedup();
        if counted.len() < 3 {
            continue;
        }
        shared = true;
        let order: &[Split] = if counted.len() == 3 {
            &[Split::Fit, Split::Select, Split::Report]
        } else {
            &[Split::Fit, Split::Select, Split::Fit, Split::Report]
        };
        for (part, cycle) in track.part.iter_mut().zip(&track.cycle) {
            let place = counted.binary_search(cycle).unwrap_or(0);
            *part = order[place % order.len()];
        }
    }
    if !shared && tracks.len() >= 3 {
        let n = tracks.len();
        tracks[n - 1].part.fill(Split::Report);
        tracks[n - 2].part.fill(Split::Select);
    } else if !shared {
        // One or two ramps: every fourth stretch of the travel, as the least bad.
        for track in tracks.iter_mut() {
            let n = track.len();
            for (i, part) in track.part.iter_mut().enumerate() {
                *part = match i * 24 / n % 4 {
                    1 => Split::Select,
                    3 => Split::Report,
                    _ => Split::Fit,
                };
            }
        }
    }
}

#[cfg(test)]
mod tests;
