//! Discrepancy of the friction law (Kennedy and O'Hagan 2001): no friction law is known exactly, so its shape may deviate by a share
//! of the friction before any effect is called missing.
//!
//! ```text
//! F = F_model + sum a_k t_k,   a_k ~ N(0, 1)
//! t = s mu E P_q(E) r_b,   s mu E P_q(E) (1 - d r_b) / 2   and   s mu E P_q(E) (m_b - r_b)
//! ```
//! E: force of the baseline, N. mu: its friction divided by load. s: [`SHARE`]. P_q: Legendre polynomial of order q over the range
//! of E. r_b: mean drag of elastic-plastic elements with lengths in band b, -1 to 1. d: direction, 1 or -1.
//! m_b: drag of a contact that forgets earlier reversals, `d - (d - m_0) (1 + x / l)^-2`; x: travel since the last reversal, mm; m_0:
//! its drag there; l: mean length of the band, mm.
//! The first kind of term changes how much friction reverses over which travel, at each load. The second lets the two directions
//! differ after a reversal. The third lets the contact forget small nested loops.
//! The terms are linear, so they are solved for inside the residuals, like the zero of each recording.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::diagnose::conditioning::Track;
use crate::diagnose::course::Split;
use crate::model::friction::elements::Elements;

/// Standard deviation of a term as a share of the friction.
const SHARE: f64 = 0.1;
/// Bands of lengths, elements in each, and the range of the lengths in mm, spaced by a constant factor.
const BANDS: usize = 8;
const PER_BAND: usize = 2;
const LENGTHS_MM: [f64; 2] = [0.01, 8.0];
/// Orders of the polynomial of the load.
const ORDERS: usize = 3;
/// Number of terms.
const TERMS: usize = 3 * BANDS * ORDERS;

/// The terms by which the friction law may deviate, at every point of the recordings.
pub(in crate::diagnose) struct Discrepancy {
    /// Weighted force of one standard deviation of each term; one column per point.
    terms: DMatrix<f64>,
    /// Normal matrix of the fitted points, with the prior.
    factor: Cholesky<f64, Dyn>,
    /// RMS friction, N.
    friction_n: f64,
}

impl Discrepancy {
    /// Number of terms.
    pub(in crate::diagnose) const COUNT: usize = TERMS;

    /// The terms for a model: its force at every point in N, and its friction divided by load. `weight` and `split` have one entry
    /// for each point. `None` if the model has no friction.
    pub(in crate::diagnose) fn new(
        tracks: &[Track],
        weight: &[f64],
        split: &[Split],
        force_n: &[f64],
        ratio: f64,
    ) -> Option<Discrepancy> {
        let [low, high] = force_n
            .iter()
            .fold([f64::INFINITY, 0.0f64], |[l, h], f| [l.min(*f), h.max(*f)]);
        if !(ratio > 0.0 && high > low) {
            return None;
        }
        let mut terms = Vec::with_capacity(TERMS * weight.len());
        let mut at = 0;
        for track in tracks {
            let mut drags = BandDrags::new();
            for i in 0..track.len() {
                let load = (2.0 * force_n[at] - high - low) / (high - low);
                let size = SHARE * ratio * force_n[at].max(0.0) * weight[at];
                let orders = [1.0, load, 0.5 * (3.0 * load * load - 1.0)].map(|p| p * size);
                for [drag, forgetful] in drags.move_to(track.displacement_mm[i]) {
                    terms.extend(orders.map(|order| order * drag));
                    terms.extend(orders.map(|order| 0.5 * order * (1.0 - track.direction[i] * drag)));
                    terms.extend(orders.map(|order| order * (forgetful - drag)));
                }
                at += 1;
            }
        }
        let squares: f64 = force_n.iter().map(|f| f * f).sum();
        let friction_n = ratio * (squares / force_n.len() as f64).sqrt();
        Discrepancy::of(DMatrix::from_vec(TERMS, weight.len(), terms), split, friction_n)
    }

    fn of(terms: DMatrix<f64>, split: &[Split], friction_n: f64) -> Option<Discrepancy> {
        let fitted = DVector::from_iterator(split.len(), split.iter().map(|s| f64::from(*s == Split::Fit)));
        let mut masked = terms.clone();
        for (mut column, &counts) in masked.column_iter_mut().zip(&fitted) {
            column *= counts;
        }
        let normal = &masked * terms.transpose() + DMatrix::identity(TERMS, TERMS);
        Some(Discrepancy {
            terms,
            factor: normal.cholesky()?,
            friction_n,
        })
    }

    /// The same with other points fitted.
    pub(super) fn with_split(&self, split: &[Split]) -> Option<Discrepancy> {
        Discrepancy::of(self.terms.clone(), split, self.friction_n)
    }

    /// The same on some of the points.
    pub(super) fn on(&self, points: std::ops::Range<usize>, split: &[Split]) -> Option<Discrepancy> {
        let terms = self.terms.columns(points.start, points.len()).into_owned();
        Discrepancy::of(terms, split, self.friction_n)
    }

    /// RMS friction of the baseline, N.
    pub(in crate::diagnose) fn friction_n(&self) -> f64 {
        self.friction_n
    }

    /// Takes from weighted residuals what the terms explain of the fitted points. Returns the size of each term in its standard
    /// deviations.
    pub(super) fn remove(&self, split: &[Split], residuals: &mut [f64]) -> DVector<f64> {
        let fitted = residuals
            .iter()
            .zip(split)
            .map(|(r, s)| if *s == Split::Fit { *r } else { 0.0 });
        let fitted = DVector::from_iterator(residuals.len(), fitted);
        let sizes = self.factor.solve(&(&self.terms * fitted));
        for (residual, column) in residuals.iter_mut().zip(self.terms.column_iter()) {
            *residual -= column.dot(&sizes);
        }
        sizes
    }
}

/// Drags of the bands, with memory and without.
struct BandDrags {
    at_mm: f64,
    direction: f64,
    since_mm: f64,
    elements: Elements<{ BANDS * PER_BAND }>,
    /// Mean length of each band, mm.
    lengths_mm: [f64; BANDS],
    /// Drag of the forgetful contact of each band, and its value at the last reversal.
    forgetful: [[f64; 2]; BANDS],
}

impl BandDrags {
    fn new() -> BandDrags {
        let count = BANDS * PER_BAND;
        let [shortest, longest] = LENGTHS_MM;
        let lengths_mm: [f64; BANDS * PER_BAND] =
            std::array::from_fn(|k| shortest * (longest / shortest).powf((k as f64 + 0.5) / count as f64));
        BandDrags {
            at_mm: 0.0,
            direction: 1.0,
            since_mm: 0.0,
            elements: Elements::new(lengths_mm),
            lengths_mm: band_means(&lengths_mm),
            forgetful: [[0.0; 2]; BANDS],
        }
    }

    /// Moves to a displacement; a track is monotone between reversals, so every step is travel.
    fn move_to(&mut self, displacement_mm: f64) -> [[f64; 2]; BANDS] {
        let travel_mm = displacement_mm - std::mem::replace(&mut self.at_mm, displacement_mm);
        if travel_mm * self.direction < 0.0 {
            self.direction = -self.direction;
            self.since_mm = 0.0;
            self.forgetful.iter_mut().for_each(|f| f[1] = f[0]);
        }
        self.since_mm += travel_mm.abs();
        let drags = band_means(self.elements.advance(travel_mm));
        std::array::from_fn(|band| {
            let [forgetful, at_reversal] = &mut self.forgetful[band];
            let left = self.direction - *at_reversal;
            *forgetful = self.direction - left / (1.0 + self.since_mm / self.lengths_mm[band]).powi(2);
            [drags[band], *forgetful]
        })
    }
}

/// Mean over the elements of each band.
fn band_means(of: &[f64; BANDS * PER_BAND]) -> [f64; BANDS] {
    std::array::from_fn(|band| of[band * PER_BAND..][..PER_BAND].iter().sum::<f64>() / PER_BAND as f64)
}

#[cfg(test)]
mod tests {
    use super::super::data::Data;
    use super::super::data::tests::case;
    use super::*;

    const RATIO: f64 = 0.05;

    /// Data of a cyclic motion, and the force of the baseline.
    fn baseline() -> (Data, Vec<f64>) {
        let (data, _) = case(|_, _| 0.0);
        let force_n = data.tracks[0].displacement_mm.iter().map(|x| 80.0 * x).collect();
        (data, force_n)
    }

    fn of(data: &Data, force_n: &[f64], ratio: f64) -> Option<Discrepancy> {
        Discrepancy::new(&data.tracks, &data.weight, &data.split, force_n, ratio)
    }

    /// Mean square on selecting cycles, in units of the noise, of a force in N before and after the discrepancy is taken away.
    fn powers(error_n: impl Fn(&Data, usize) -> f64) -> [f64; 2] {
        let (data, force_n) = baseline();
        let mut residuals: Vec<f64> = (0..data.len())
            .map(|i| data.weight[i] * error_n(&data, i))
            .collect();
        let before = data.sum(&residuals, Split::Select);
        let discrepancy = of(&data, &force_n, RATIO).expect("friction");
        discrepancy.remove(&data.split, &mut residuals);
        [before, data.sum(&residuals, Split::Select)].map(|sum| sum / data.count(Split::Select) as f64)
    }

    #[test]
    fn a_fifth_of_the_friction_in_another_law_is_its_shape() {
        // An exponential after each reversal, which is none of the terms.
        let [before, after] = powers(|data, i| {
            let track = &data.tracks[0];
            let drag = track.direction[i] * (1.0 - 2.0 * (-track.since_reversal_mm[i] / 0.7).exp());
            0.2 * RATIO * 80.0 * track.displacement_mm[i] * drag
        });
        assert!(before > 10.0 && after < 0.05 * before, "{before} {after}");
    }

    #[test]
    fn what_is_no_friction_stays() {
        let [ripple, left] = powers(|data, i| 3.0 * (4.0 * data.tracks[0].displacement_mm[i]).sin());
        // Along one motion, displacement and travel since the reversal go together, so a part is imitated.
        assert!(left > 0.65 * ripple, "a ripple: {ripple} {left}");
        let [late, left] = powers(|data, i| if data.tracks[0].cycle[i] > 5 { 3.0 } else { -3.0 });
        assert!(left > 0.9 * late, "a change after five cycles: {late} {left}");
    }

    #[test]
    fn only_fitted_points_decide_and_a_part_has_its_own_terms() {
        let (data, force_n) = baseline();
        let discrepancy = of(&data, &force_n, RATIO).expect("friction");
        let held_out = |i: &usize| data.split[*i] != Split::Fit;
        let mut residuals: Vec<f64> = (0..data.len())
            .map(|i| if held_out(&i) { 5.0 * data.weight[i] } else { 0.0 })
            .collect();
        let sizes = discrepancy.remove(&data.split, &mut residuals);
        assert!(sizes.norm() < 1e-9, "{sizes}");
        let half = discrepancy
            .on(0..data.len() / 2, &data.split[..data.len() / 2])
            .expect("regular");
        let mut residuals = vec![1.0; data.len() / 2];
        half.remove(&data.split[..data.len() / 2], &mut residuals);
        assert!(residuals.iter().all(|r| r.is_finite()));
        assert!(of(&data, &force_n, 0.0).is_none());
    }
}
