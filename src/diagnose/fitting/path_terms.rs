//! Terms of the discrepancy for every force that follows from the path of the displacement alone. They need no model.
//!
//! ```text
//! t = s_f R r_l h_p(x),   s_c R h_q(x)
//! ```
//! R: range of the force, N. r_l: drag of an elastic-plastic element of length l, -1 to 1. h: hat functions of the displacement x at
//! [`FRICTION_PLACES`] and [`CURVE_PLACES`] places. s: [`FRICTION_SHARE`] and [`CURVE_SHARE`].
//! The first kind is any friction that returns to where it turned, at any place. The second is any curve.

use nalgebra::DMatrix;

use crate::diagnose::conditioning::Track;
use crate::model::friction::elements::Elements;

/// Elastic-plastic elements, and the range of their lengths in mm, spaced by a constant factor.
pub(super) const ELEMENTS: usize = 16;
const LENGTHS_MM: [f64; 2] = [0.01, 8.0];
/// Places of the travel between which the friction of an element is interpolated, and its standard deviation as a share of the range.
const FRICTION_PLACES: usize = 5;
const FRICTION_SHARE: f64 = 0.02;
/// The same of the curve. A bend within one fourteenth of the travel is not followed.
const CURVE_PLACES: usize = 14;
const CURVE_SHARE: f64 = 0.05;

/// Weighted forces of the friction's terms, one column per point.
pub(super) fn friction(tracks: &[Track], weight: &[f64], range_n: f64) -> DMatrix<f64> {
    let ends_mm = ends_mm(tracks);
    let count = ELEMENTS * FRICTION_PLACES;
    let mut terms = Vec::with_capacity(count * weight.len());
    let mut weights = weight.iter();
    for track in tracks {
        let mut elements = Elements::new(lengths_mm());
        let mut before_mm = 0.0;
        for (displacement_mm, weight) in track.displacement_mm.iter().zip(weights.by_ref()) {
            let size = FRICTION_SHARE * range_n * weight;
            let hats = hats::<FRICTION_PLACES>(*displacement_mm, ends_mm).map(|hat| size * hat);
            for drag in elements.advance(displacement_mm - before_mm) {
                terms.extend(hats.map(|hat| hat * drag));
            }
            before_mm = *displacement_mm;
        }
    }
    DMatrix::from_vec(count, weight.len(), terms)
}

/// Weighted forces of the curve's terms, one column per point.
pub(super) fn curve(tracks: &[Track], weight: &[f64], range_n: f64) -> DMatrix<f64> {
    let ends_mm = ends_mm(tracks);
    let size = CURVE_SHARE * range_n;
    let reached_mm = tracks.iter().flat_map(|t| &t.displacement_mm);
    let terms = reached_mm
        .zip(weight)
        .flat_map(|(x, weight)| hats::<CURVE_PLACES>(*x, ends_mm).map(|hat| size * weight * hat));
    DMatrix::from_iterator(CURVE_PLACES, weight.len(), terms)
}

/// Hat functions at equal distances: the share that each place has of a value between them.
fn hats<const N: usize>(at_mm: f64, [first, last]: [f64; 2]) -> [f64; N] {
    let at = (at_mm - first) / (last - first).max(f64::MIN_POSITIVE) * (N - 1) as f64;
    std::array::from_fn(|place| (1.0 - (at - place as f64).abs()).max(0.0))
}

/// Lengths of the elements, mm.
pub(super) fn lengths_mm() -> [f64; ELEMENTS] {
    let [shortest, longest] = LENGTHS_MM;
    std::array::from_fn(|k| shortest * (longest / shortest).powf((k as f64 + 0.5) / ELEMENTS as f64))
}

/// Smallest and largest displacement of all tracks, mm.
pub(super) fn ends_mm(tracks: &[Track]) -> [f64; 2] {
    let reached_mm = tracks.iter().flat_map(|t| &t.displacement_mm);
    reached_mm.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], x| {
        [l.min(*x), h.max(*x)]
    })
}
