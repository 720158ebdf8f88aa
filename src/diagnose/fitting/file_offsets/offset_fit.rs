//! Fits the baseline with offsets of the recordings (Gauss-Newton; the columns are difference quotients), and leaves out the offsets that
//! bring too little.

use nalgebra::{DMatrix, DVector};

use super::offsets::OffsetKind::{Delay, Displacement, Force};
use super::offsets::{FileOffsets, OffsetKind};
use super::shift::shifted;
use crate::diagnose::conditioning::{Track, median, range};
use crate::diagnose::course::Split;
use crate::diagnose::fitting::data::Data;
use crate::diagnose::fitting::fit::converge;
use crate::diagnose::fitting::node::Node;
use crate::diagnose::fitting::structure::ModelStructure;
use crate::identify::Residuals;

/// The first step, a linear prediction, must explain this share, or the search ends.
const LEAST_PREDICTED: f64 = 0.5;
/// Log-likelihood that each offset must gain.
pub(super) const GAIN_OF_EACH: f64 = 5.0;
/// Prior standard deviations: force and displacement as a share of their ranges, delay in s.
const PRIOR_SHARE: f64 = 0.1;
const PRIOR_S: f64 = 3e-3;
/// A recording has a delay of its own if one of [`PRIOR_S`] moves the displacement, at the highest speed, by this many noises of the LVDT. In a
/// slower one a delay only turns each reversal, as another friction law does: a ramp got 29 ms, and then two wrong effects were sure. At half,
/// it still gets none; at double, one of up to 3 mm/s with a noise of 2 um gets none.
const LEAST_MOVED: f64 = 2.0;
/// Steps of the difference quotients, as shares of the priors, and number of Gauss-Newton steps.
const STEP: f64 = 1e-3;
const ROUNDS: usize = 5;
/// An offset that moves by less than this share of its prior has converged.
const CONVERGED: f64 = 1e-4;

/// Index of a recording, and the kind of offset that it has.
type OwnOffset = (usize, OffsetKind);

/// A fit of the baseline with offsets.
pub(in crate::diagnose::fitting) struct OffsetFit {
    /// The offsets that were fitted; the others are zero.
    pub(super) own: Vec<OwnOffset>,
    /// One for each recording.
    pub offsets: Vec<FileOffsets>,
    pub(super) cost: f64,
}

impl OffsetFit {
    /// Zeros of one kind, all of them known, beside a fit with this sum of squares.
    pub(super) fn of_zeros(kind: OffsetKind, offsets: Vec<FileOffsets>, cost: f64) -> OffsetFit {
        let own = (0..offsets.len()).filter(|&file| offsets[file].of(kind) != 0.0);
        OffsetFit {
            own: own.map(|file| (file, kind)).collect(),
            offsets,
            cost,
        }
    }

    pub(super) fn has(&self, kind: OffsetKind) -> bool {
        self.own.iter().any(|own| own.1 == kind)
    }
}

/// Some kinds of offsets in all recordings that show them.
fn in_all(tracks: &[Track], kinds: &[OffsetKind]) -> Vec<OwnOffset> {
    let every = (0..tracks.len()).flat_map(|file| kinds.iter().map(move |&kind| (file, kind)));
    every
        .filter(|&(file, kind)| kind != Delay || shows_delays(&tracks[file]))
        .collect()
}

fn shows_delays(track: &Track) -> bool {
    PRIOR_S * track.top_speed_mm_s() >= LEAST_MOVED * track.noise_mm
}

/// Which recordings may have an offset.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum OffsetsOf {
    /// All of them. What they share is taken out again, and the fit ends after a first step that is predicted to explain too little.
    All,
    /// Those that are listed.
    Known,
}

/// Fits the baseline with some kinds of offsets in all recordings; `None` if the first step is predicted to explain too little.
pub(super) fn fitted_in_all(
    structure: &ModelStructure<'_>,
    node: &Node,
    kinds: &[OffsetKind],
) -> Option<OffsetFit> {
    // A zero that all recordings share is no offset: the first recording is the reference until the offsets are centred.
    let mut own = in_all(&structure.data.tracks, kinds);
    own.retain(|&(file, kind)| file > 0 || kind == Delay);
    (!own.is_empty()).then(|| fitted(structure, node, &own, OffsetsOf::All))?
}

/// Fits the baseline with offsets of some recordings.
pub(super) fn fitted(
    structure: &ModelStructure<'_>,
    node: &Node,
    own: &[OwnOffset],
    of: OffsetsOf,
) -> Option<OffsetFit> {
    let counted = structure.data.count(Split::Fit) as f64;
    let mut offsets = vec![FileOffsets::default(); structure.data.tracks.len()];
    let mut values = node.values.clone();
    for round in 0..ROUNDS {
        let line = slopes_beside(structure, &offsets, values, own)?;
        let right = line.columns.tr_mul(&line.residuals);
        let step = line.normal().cholesky()?.solve(&right);
        let explained = right.dot(&step);
        if round == 0 && of == OffsetsOf::All && explained < LEAST_PREDICTED * (line.fit.fit - counted) {
            return None;
        }
        for (&(file, kind), by) in own.iter().zip(&step) {
            offsets[file].add(kind, by * prior(&structure.data.tracks[file], kind));
        }
        if of == OffsetsOf::All {
            centre(&mut offsets, own);
        }
        values = line.fit.values;
        if step.amax() < CONVERGED {
            break;
        }
    }
    let data = shifted(structure.data, &offsets);
    let here = ModelStructure::new(structure.setup, &data, node.attached.clone());
    let (fit, _) = converge(&here, values)?;
    Some(OffsetFit {
        own: own.to_vec(),
        offsets,
        cost: fit.cost(),
    })
}

/// The baseline fitted beside some offsets, with the changes by further ones that it cannot follow.
struct OffsetSlopes {
    fit: Node,
    residuals: DVector<f64>,
    /// One for each further offset, in units of its prior.
    columns: DMatrix<f64>,
}

impl OffsetSlopes {
    /// Normal matrix of the offsets, with their prior.
    fn normal(&self) -> DMatrix<f64> {
        let mut normal = self.columns.tr_mul(&self.columns);
        for k in 0..normal.nrows() {
            normal[(k, k)] += 1.0;
        }
        normal
    }
}

fn slopes_beside(
    structure: &ModelStructure<'_>,
    offsets: &[FileOffsets],
    values: Vec<f64>,
    own: &[OwnOffset],
) -> Option<OffsetSlopes> {
    let data = shifted(structure.data, offsets);
    let here = ModelStructure::new(structure.setup, &data, structure.attached.clone());
    let (fit, tangent) = converge(&here, values)?;
    let residuals = here.fitted(&fit.values)?;
    let mut columns = columns(&here, &fit.values, own)?;
    for mut column in columns.column_iter_mut() {
        let projected = tangent.project(&column.clone_owned());
        column.copy_from(&projected);
    }
    Some(OffsetSlopes {
        fit,
        residuals,
        columns,
    })
}

/// The fit without the offsets that bring too little (backward elimination), and with a zero on one channel of a recording at most;
/// `None` if none is left.
pub(super) fn sparse(structure: &ModelStructure<'_>, node: &Node, dense: &OffsetFit) -> Option<OffsetFit> {
    let kinds: Vec<OffsetKind> = [Force, Displacement, Delay]
        .into_iter()
        .filter(|&kind| dense.has(kind))
        .collect();
    let all = in_all(&structure.data.tracks, &kinds);
    let line = slopes_beside(structure, &dense.offsets, node.values.clone(), &all)?;
    let covariance = line.normal().cholesky()?.inverse();
    let sizes: Vec<f64> = all
        .iter()
        .map(|&(file, kind)| dense.offsets[file].of(kind) / prior(&structure.data.tracks[file], kind))
        .collect();
    let out = left_out(&all, &sizes, &covariance);
    let own: Vec<OwnOffset> = (0..all.len())
        .filter(|k| !out.contains(k))
        .map(|k| all[k])
        .collect();
    (!own.is_empty()).then(|| fitted(structure, node, &own, OffsetsOf::Known))?
}

/// Indices of the offsets that bring too little, and of one zero of each recording that has two. `sizes` in units of the priors;
/// `covariance` is theirs.
fn left_out(all: &[OwnOffset], sizes: &[f64], covariance: &DMatrix<f64>) -> Vec<usize> {
    let mut out: Vec<usize> = Vec::new();
    let mut lost = 0.0;
    loop {
        let left: Vec<usize> = (0..all.len()).filter(|k| !out.contains(k)).collect();
        // The rise of the sum of squares without these and one more.
        let rise = |&next: &usize| {
            let without: Vec<usize> = out.iter().copied().chain([next]).collect();
            let size = DVector::from_iterator(without.len(), without.iter().map(|&k| sizes[k]));
            let block = covariance.select_rows(&without).select_columns(&without);
            Some((size.dot(&block.cholesky()?.solve(&size)), next))
        };
        let least = |of: &[usize]| of.iter().filter_map(rise).min_by(|a, b| a.0.total_cmp(&b.0));
        let has = |file: usize, kind: OffsetKind| left.iter().any(|&k| all[k] == (file, kind));
        let of_two = |&&k: &&usize| all[k].1 != Delay && has(all[k].0, Force) && has(all[k].0, Displacement);
        let two_zeros: Vec<usize> = left.iter().filter(of_two).copied().collect();
        let brings_little = |(with, _): &(f64, usize)| 0.5 * (with - lost) < GAIN_OF_EACH;
        let Some((with, next)) = least(&left).filter(brings_little).or_else(|| least(&two_zeros)) else {
            return out;
        };
        out.push(next);
        lost = with;
    }
}

/// Most recordings have no zero of their own: what all have in common is a parameter of the baseline.
fn centre(offsets: &mut [FileOffsets], own: &[OwnOffset]) {
    let has = |kind: OffsetKind| own.iter().any(|o| o.1 == kind);
    let middle = |f: fn(&FileOffsets) -> f64| median(offsets.iter().map(f).collect());
    let (force_n, displacement_mm) = (middle(|o| o.force_n), middle(|o| o.displacement_mm));
    for offset in offsets {
        if has(Force) {
            offset.force_n -= force_n;
        }
        if has(Displacement) {
            offset.displacement_mm -= displacement_mm;
        }
    }
}

/// Prior standard deviation of an offset, in its unit.
fn prior(track: &Track, kind: OffsetKind) -> f64 {
    match kind {
        Force => PRIOR_SHARE * range(&track.force_n),
        Displacement => PRIOR_SHARE * range(&track.displacement_mm),
        Delay => PRIOR_S,
    }
}

/// Fall of the fitted residuals when an offset moves by its prior: one column for each.
fn columns(structure: &ModelStructure<'_>, values: &[f64], own: &[OwnOffset]) -> Option<DMatrix<f64>> {
    let data = structure.data;
    let mut columns = DMatrix::zeros(structure.count(), own.len());
    let mut from = 0;
    for (file, track) in data.tracks.iter().enumerate() {
        let alone = data.one(file);
        let fitted = |data: &Data| -> Option<DVector<f64>> {
            ModelStructure::new(structure.setup, data, structure.attached.clone()).fitted(values)
        };
        let before = fitted(&alone)?;
        for (k, &(_, kind)) in own.iter().enumerate().filter(|(_, o)| o.0 == file) {
            let mut offset = FileOffsets::default();
            offset.add(kind, STEP * prior(track, kind));
            let after = fitted(&shifted(&alone, &[offset]))?;
            for i in 0..track.len() {
                columns[(from + i, k)] = (before[i] - after[i]) / STEP;
            }
        }
        from += track.len();
    }
    Some(columns)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What stays of three recordings with zeros on both channels and a delay each. Their sizes are in units of the priors, their
    /// uncertainty is 0.01, and the two zeros of a recording go together.
    fn kept(sizes: [[f64; 3]; 3]) -> Vec<OwnOffset> {
        let kinds = [Force, Displacement, Delay];
        let all: Vec<OwnOffset> = (0..3).flat_map(|file| kinds.map(|kind| (file, kind))).collect();
        let sizes = sizes.concat();
        let mut covariance = DMatrix::from_diagonal_element(9, 9, 1e-4);
        for file in 0..3 {
            let (force, displacement) = (3 * file, 3 * file + 1);
            covariance[(force, displacement)] = 0.9e-4;
            covariance[(displacement, force)] = 0.9e-4;
        }
        let out = left_out(&all, &sizes, &covariance);
        (0..9).filter(|k| !out.contains(k)).map(|k| all[k]).collect()
    }

    #[test]
    fn an_offset_that_brings_too_little_is_left_out() {
        let found = kept([[0.5, 0.0, 0.0], [0.01, 0.0, 0.02], [0.0, 0.005, 0.3]]);
        assert_eq!(found, [(0, Force), (2, Delay)]);
    }

    #[test]
    fn a_recording_has_a_zero_on_one_channel_at_most() {
        let found = kept([[0.5, 0.4, 0.0], [0.0, 0.0, 0.0], [-0.2, 0.6, 0.2]]);
        assert_eq!(found, [(0, Force), (2, Displacement), (2, Delay)]);
    }
}
