//! Recordings of the same motion that disagree: the specimen, its mounting or an instrument changed between them.

use super::data::Data;
use crate::diagnose::conditioning::{Track, median, range};
use crate::diagnose::note::{Note, NoteAction, NoteKind};

/// Two recordings repeat one motion if its ends and each of its reversals differ by less than this share of the stroke, and its frequency
/// by less than this share.
const SAME_ENDS: f64 = 0.03;
const SAME_FREQUENCY: f64 = 0.1;
/// Number of bins of the displacement on each branch, and fewest points of a bin.
const BINS: usize = 24;
const LEAST_POINTS: usize = 3;
/// Recordings disagree if their mean loops differ by this many standard errors (RMS), and by this share of the force range.
const LEAST_ERRORS: f64 = 5.0;
const LEAST_SHARE: f64 = 0.004;

/// Notes on recordings that disagree with an earlier one of the same motion.
pub(super) fn disagreements(data: &Data) -> Vec<Note> {
    let loops: Vec<MeanLoop> = (0..data.tracks.len())
        .map(|file| MeanLoop::of(data, file))
        .collect();
    let mut notes = Vec::new();
    for (k, track) in data.tracks.iter().enumerate() {
        let against = (0..k).filter(|&j| same_motion(&data.tracks[j], track));
        let worst = against
            .filter_map(|j| Some((j, loops[j].difference(&loops[k], track)?)))
            .filter(|(_, (rms_n, errors))| {
                *errors > LEAST_ERRORS && *rms_n > LEAST_SHARE * data.force_range_n
            })
            .max_by(|a, b| a.1.0.total_cmp(&b.1.0));
        if let Some((j, (rms_n, _))) = worst {
            let text = format!(
                "it repeats the motion of {}, but the mean loops differ by {rms_n:.1} N: check what was changed between the two, and \
                 diagnose them apart",
                data.tracks[j].name
            );
            notes.push(Note::new(
                &track.name,
                NoteKind::Disagreement,
                (rms_n, "N"),
                NoteAction::Told,
                text,
            ));
        }
    }
    notes
}

fn ends(track: &Track) -> [f64; 2] {
    let x = &track.displacement_mm;
    x.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| {
        [l.min(*v), h.max(*v)]
    })
}

fn same_motion(a: &Track, b: &Track) -> bool {
    let ([low_a, high_a], [low_b, high_b]) = (ends(a), ends(b));
    let room_mm = SAME_ENDS * (high_a - low_a).min(high_b - low_b);
    let same_ends = (low_a - low_b).abs() < room_mm && (high_a - high_b).abs() < room_mm;
    let (fast, slow) = (
        a.frequency_hz.max(b.frequency_hz),
        a.frequency_hz.min(b.frequency_hz),
    );
    let same_turns = turns(a)
        .zip(turns(b))
        .all(|(a, b)| a.0 == b.0 && (a.1 - b.1).abs() < room_mm);
    same_ends && same_turns && slow > 0.0 && fast - slow < SAME_FREQUENCY * fast
}

/// Direction from each reversal on, and its displacement in mm.
fn turns(track: &Track) -> impl Iterator<Item = (f64, f64)> {
    track
        .turns()
        .map(|i| (track.direction[i], track.displacement_mm[i - 1]))
}

/// Points of the loop of one recording, by bins of the displacement and by branch.
struct MeanLoop {
    /// Displacement in mm and force in N of the compared points of each bin.
    bins: Vec<Vec<[f64; 2]>>,
}

impl MeanLoop {
    fn of(data: &Data, file: usize) -> MeanLoop {
        let from = data.lengths[..file].iter().sum::<usize>();
        let track = &data.tracks[file];
        let [low_mm, high_mm] = ends(track);
        let mut bins = vec![Vec::new(); 2 * BINS];
        for i in (0..track.len()).filter(|&i| data.weight[from + i] > 0.0) {
            let x = track.displacement_mm[i];
            let bin = ((x - low_mm) / (high_mm - low_mm) * BINS as f64) as usize;
            let branch = usize::from(track.direction[i] > 0.0);
            bins[2 * bin.min(BINS - 1) + branch].push([x, data.force_n[from + i]]);
        }
        MeanLoop { bins }
    }

    /// RMS difference of two loops in N, and the same in standard errors. The bins at the ends are left out, where the loop is steep.
    fn difference(&self, other: &MeanLoop, track: &Track) -> Option<(f64, f64)> {
        let rate = range(&track.force_n) / range(&track.displacement_mm);
        let inner = 4..2 * BINS - 4;
        let pairs = self.bins[inner.clone()].iter().zip(&other.bins[inner]);
        let found: Vec<[f64; 2]> = pairs
            .filter(|(a, b)| a.len().min(b.len()) >= LEAST_POINTS)
            .map(|(a, b)| {
                let ([mean_a, error_a], [mean_b, error_b]) = (level(a, rate), level(b, rate));
                [mean_a - mean_b, error_a.hypot(error_b)]
            })
            .collect();
        if found.len() < BINS / 2 {
            return None;
        }
        let rms_n = (found.iter().map(|[d, _]| d * d).sum::<f64>() / found.len() as f64).sqrt();
        let error_n = median(found.iter().map(|[_, error]| *error).collect());
        (error_n > 0.0).then_some((rms_n, rms_n / error_n))
    }
}

/// Mean force of a bin and its standard error, with the spring's own rise taken out.
fn level(points: &[[f64; 2]], rate: f64) -> [f64; 2] {
    let n = points.len() as f64;
    let flat = points.iter().map(|[x, force_n]| force_n - rate * x);
    let mean = flat.clone().sum::<f64>() / n;
    let variance = flat.map(|f| (f - mean).powi(2)).sum::<f64>() / (n - 1.0);
    [mean, (variance / n).sqrt()]
}

#[cfg(test)]
mod tests {
    use super::super::data::tests::sampled;
    use super::*;

    #[test]
    fn repeats_that_differ_are_noted() {
        let (one, noise) = sampled(0.005, 20.0, |_, _| 0.0);
        let mut both = one.clone();
        for (file, offset_n) in [(0, 0.0), (1, 12.0)] {
            if file == 1 {
                both.tracks.push(one.tracks[0].clone());
                both.tracks[1].name = "second".to_owned();
                both.lengths.push(one.lengths[0]);
                both.weight.extend(&one.weight);
                both.split.extend(&one.split);
                both.force_n.extend(&one.force_n);
            }
            let from = file * one.len();
            for (i, noise) in noise.iter().enumerate() {
                both.force_n[from + i] += noise + offset_n;
            }
        }
        let notes = disagreements(&both);
        assert_eq!(notes.len(), 1, "{notes:?}");
        assert!((notes[0].size.value - 12.0).abs() < 1.0, "{notes:?}");
        // Other turns between the same ends are another motion: both first rise from rest.
        let mut smaller = both.clone();
        let track = &mut smaller.tracks[1];
        let highest_mm = range(&track.displacement_mm);
        for x in track.displacement_mm[1..]
            .iter_mut()
            .filter(|x| **x < 0.4 * highest_mm)
        {
            *x = 0.4 * highest_mm;
        }
        assert_eq!(disagreements(&smaller), []);
        both.force_n[one.len()..].iter_mut().for_each(|f| *f -= 12.0);
        assert_eq!(disagreements(&both), []);
    }
}
