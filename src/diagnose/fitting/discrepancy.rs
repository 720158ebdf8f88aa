//! Discrepancy of the model (Kennedy and O'Hagan 2001): no friction law and no spring's curve is known exactly, so their shapes may
//! deviate before any effect is called missing.
//!
//! ```text
//! F = F_model + sum a_k t_k,   a_k ~ N(0, 1)
//! t = s mu E P_q(E) r_b,   s mu E P_q(E) (1 - d r_b) / 2   and   s mu E P_q(E) (m_b - r_b);   c R (2 / q)^2 P_q(x)
//! ```
//! The last kind is the spring's curve, the others are the friction. R: range of the force, N. c: [`CURVE_SHARE`]. P_q(x): of the
//! displacement, q = 2 to 9. s: [`SHARE`] times the scale, which is a smaller one where that is likelier.
//! E: force of the baseline, N. mu: its friction divided by load. P_q: Legendre polynomial of order q over the range
//! of E. r_b: mean drag of elastic-plastic elements with lengths in band b, -1 to 1. d: direction, 1 or -1.
//! m_b: drag of a contact that forgets earlier reversals, `d - (d - m_0) (1 + x / l)^-2`; x: travel since the last reversal, mm; m_0:
//! its drag there; l: mean length of the band, mm.
//! The first kind of term changes how much friction reverses over which travel, at each load. The second lets the two directions
//! differ after a reversal. The third lets the contact forget small nested loops.
//! Where everything that follows from the path is in doubt, the terms are those of [`path_terms`].
//! The terms are linear, so they are solved for inside the residuals, like the zero of each recording.

use nalgebra::{Cholesky, DMatrix, DVector, DVectorView, Dyn, SymmetricEigen};

use super::path_terms::{self, ELEMENTS, ends_mm, lengths_mm};
use crate::diagnose::conditioning::Track;
use crate::diagnose::course::Split;
use crate::model::friction::elements::Elements;

/// Largest standard deviation of a term as a share of the friction.
const SHARE: f64 = 0.1;
/// Bands of the elements' lengths, and elements in each.
const BANDS: usize = 8;
const PER_BAND: usize = ELEMENTS / BANDS;
/// Orders of the polynomial of the load.
const ORDERS: usize = 3;
/// Number of terms of the friction.
const FRICTION_TERMS: usize = 3 * BANDS * ORDERS;
/// Orders of the polynomials by which the spring's curve may deviate: the lowest, and how many. Level and rate are the baseline's own.
const LOWEST_ORDER: usize = 2;
const CURVE_TERMS: usize = 8;
/// Standard deviation of the lowest of them as a share of the force range; the others fall with the square of the order.
const CURVE_SHARE: f64 = 0.02;
/// Sum of squares over all points, in units of the noise, below which one standard deviation of a term moves no point.
const LEAST_POWER: f64 = 0.01;
/// Largest RMS of the friction's terms as a share of the friction, and of the curve's as a share of the force range: a larger
/// difference is no error of shape.
const MOST_FRICTION: f64 = 0.2;
const MOST_CURVE: f64 = 0.02;

/// What is in doubt.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::diagnose) enum Doubt {
    /// The shape of the friction law.
    Friction,
    /// That, and the spring's curve.
    FrictionAndCurve,
    /// Everything that follows from the path of the displacement alone.
    Path,
}

/// The terms by which the model may deviate, at every point of the recordings.
pub(in crate::diagnose) struct Discrepancy {
    /// Weighted force of one standard deviation of each term; one column per point. The terms are turned to be independent of each
    /// other, and those that move no point are left out.
    terms: DMatrix<f64>,
    /// Number of them that are of the friction; they come first.
    of_friction: usize,
    /// Normal matrix of the fitted points, with the prior.
    factor: Cholesky<f64, Dyn>,
    doubt: Doubt,
    /// RMS friction and range of the force, N.
    friction_n: f64,
    range_n: f64,
}

/// Size of what a discrepancy explains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::diagnose) struct ShapeShares {
    /// RMS of the friction's terms as a share of the RMS friction.
    pub friction: f64,
    /// RMS of the curve's terms as a share of the force range, where the curve is in doubt.
    pub curve: Option<f64>,
}

impl ShapeShares {
    /// True if they are small enough for an error of shape.
    pub(in crate::diagnose) fn are_errors_of_shape(self) -> bool {
        self.friction <= MOST_FRICTION && self.curve.is_none_or(|curve| curve <= MOST_CURVE)
    }
}

impl Discrepancy {
    /// True if the spring's curve may deviate, too.
    pub(super) fn bends_the_curve(&self) -> bool {
        self.doubt != Doubt::Friction
    }

    /// The terms for a model: its force at every point in N, and its friction divided by load. `weight` and `split` have one entry
    /// for each point. `None` if the model has no friction.
    pub(in crate::diagnose) fn new(
        tracks: &[Track],
        weight: &[f64],
        split: &[Split],
        force_n: &[f64],
        ratio: f64,
        doubt: Doubt,
    ) -> Option<Discrepancy> {
        let [low, high] = force_n
            .iter()
            .fold([f64::INFINITY, 0.0f64], |[l, h], f| [l.min(*f), h.max(*f)]);
        if !(ratio > 0.0 && high > low) {
            return None;
        }
        let squares: f64 = force_n.iter().map(|f| f * f).sum();
        let range_n = high - low;
        let by_load = || friction_terms(tracks, weight, force_n, ratio, [low, high]);
        let (friction, curve) = match doubt {
            Doubt::Friction => (by_load(), None),
            Doubt::FrictionAndCurve => (by_load(), Some(curve_terms(tracks, weight, range_n))),
            Doubt::Path => (
                path_terms::friction(tracks, weight, range_n),
                Some(path_terms::curve(tracks, weight, range_n)),
            ),
        };
        let mut terms = independent(friction);
        let of_friction = terms.nrows();
        if let Some(curve) = curve.map(independent) {
            terms = terms.insert_rows(of_friction, curve.nrows(), 0.0);
            terms.rows_mut(of_friction, curve.nrows()).copy_from(&curve);
        }
        Some(Discrepancy {
            factor: factor(&terms, split)?,
            terms,
            of_friction,
            doubt,
            friction_n: ratio * (squares / force_n.len() as f64).sqrt(),
            range_n: high - low,
        })
    }

    pub(super) fn doubt(&self) -> Doubt {
        self.doubt
    }

    /// Number of terms.
    pub(super) fn count(&self) -> usize {
        self.terms.nrows()
    }

    /// The same with the standard deviation of the friction's terms times a factor. The curve keeps its own.
    pub(in crate::diagnose) fn scaled(&self, factor: f64, split: &[Split]) -> Option<Discrepancy> {
        let mut terms = self.terms.clone();
        terms.rows_mut(0, self.of_friction).scale_mut(factor);
        self.with(terms, split)
    }

    /// The same with other points fitted.
    pub(super) fn with_split(&self, split: &[Split]) -> Option<Discrepancy> {
        self.with(self.terms.clone(), split)
    }

    /// The same on some of the points.
    pub(super) fn on(&self, points: std::ops::Range<usize>, split: &[Split]) -> Option<Discrepancy> {
        self.with(self.terms.columns(points.start, points.len()).into_owned(), split)
    }

    /// The same on picked points, each with a factor of its weight.
    pub(super) fn picked(&self, points: &[usize], factors: &[f64], split: &[Split]) -> Option<Discrepancy> {
        let mut terms = self.terms.select_columns(points);
        for (mut column, factor) in terms.column_iter_mut().zip(factors) {
            column *= *factor;
        }
        self.with(terms, split)
    }

    fn with(&self, terms: DMatrix<f64>, split: &[Split]) -> Option<Discrepancy> {
        Some(Discrepancy {
            factor: factor(&terms, split)?,
            terms,
            ..*self
        })
    }

    /// How large the terms are over all points that count.
    pub(in crate::diagnose) fn shares(&self, sizes: &DVector<f64>, weight: &[f64]) -> ShapeShares {
        let rms_n = |rows: std::ops::Range<usize>| {
            let terms = self.terms.rows(rows.start, rows.len());
            let forces = terms.tr_mul(&sizes.rows(rows.start, rows.len()));
            let counted = forces.iter().zip(weight).filter(|(_, w)| **w > 0.0);
            let squares: Vec<f64> = counted.map(|(f, w)| (f / w).powi(2)).collect();
            (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
        };
        let curve = || rms_n(self.of_friction..self.count()) / self.range_n;
        ShapeShares {
            friction: rms_n(0..self.of_friction) / self.friction_n,
            curve: self.bends_the_curve().then(curve),
        }
    }

    /// What the freedom of the terms costs in log-likelihood (the Occam factor of their marginal likelihood), where a sum of squares
    /// counts `per_square`.
    pub(in crate::diagnose) fn freedom(&self, per_square: f64) -> f64 {
        let one = DMatrix::identity(self.count(), self.count());
        let normal = self.factor.l() * self.factor.l().transpose() - &one;
        let scaled = normal * (2.0 * per_square) + one;
        scaled.cholesky().map_or(f64::INFINITY, |c| {
            c.l_dirty().diagonal().iter().map(|d| d.ln()).sum()
        })
    }

    /// Takes from weighted residuals what the terms explain of the fitted points. Returns the size of each term in its standard
    /// deviations.
    pub(super) fn remove(&self, split: &[Split], residuals: &mut [f64]) -> DVector<f64> {
        let sizes = self.sizes(split, residuals);
        for (residual, column) in residuals.iter_mut().zip(self.terms.column_iter()) {
            *residual -= column.dot(&sizes);
        }
        sizes
    }

    /// The same at the fitted points alone: a fit needs no others, and the terms are a tenth of its work.
    pub(super) fn remove_from_fitted(&self, split: &[Split], residuals: &mut [f64]) -> DVector<f64> {
        let sizes = self.sizes(split, residuals);
        for (column, i) in fitted(&self.terms, split) {
            residuals[i] -= column.dot(&sizes);
        }
        sizes
    }

    /// Size of each term that explains the fitted points best.
    fn sizes(&self, split: &[Split], residuals: &[f64]) -> DVector<f64> {
        let mut along = DVector::zeros(self.count());
        for (column, i) in fitted(&self.terms, split) {
            along.axpy(residuals[i], &column, 1.0);
        }
        self.factor.solve(&along)
    }
}

/// Weighted forces of the friction's terms, one column per point. `ends_n`: lowest and highest force.
fn friction_terms(
    tracks: &[Track],
    weight: &[f64],
    force_n: &[f64],
    ratio: f64,
    [low, high]: [f64; 2],
) -> DMatrix<f64> {
    let mut terms = Vec::with_capacity(FRICTION_TERMS * weight.len());
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
    DMatrix::from_vec(FRICTION_TERMS, weight.len(), terms)
}

/// Weighted forces of the curve's terms, one column per point.
fn curve_terms(tracks: &[Track], weight: &[f64], range_n: f64) -> DMatrix<f64> {
    let [first, last] = ends_mm(tracks);
    let reached_mm = tracks.iter().flat_map(|t| &t.displacement_mm);
    let travel_mm = (last - first).max(f64::MIN_POSITIVE);
    let terms = reached_mm.zip(weight).flat_map(|(x, weight)| {
        let size = CURVE_SHARE * range_n * weight;
        curve((2.0 * x - last - first) / travel_mm).map(|term| size * term)
    });
    DMatrix::from_iterator(CURVE_TERMS, weight.len(), terms)
}

/// Normal matrix of the fitted points, with the prior of every term.
fn factor(terms: &DMatrix<f64>, split: &[Split]) -> Option<Cholesky<f64, Dyn>> {
    let mut normal = DMatrix::identity(terms.nrows(), terms.nrows());
    for (column, _) in fitted(terms, split) {
        normal.ger(1.0, &column, &column, 1.0);
    }
    normal.cholesky()
}

/// The columns of the fitted points, each with its index.
fn fitted<'t>(
    terms: &'t DMatrix<f64>,
    split: &'t [Split],
) -> impl Iterator<Item = (DVectorView<'t, f64>, usize)> {
    let columns = terms.column_iter().zip(split).enumerate();
    columns.filter_map(|(i, (column, split))| (*split == Split::Fit).then_some((column, i)))
}

/// Terms with the same prior, turned so that they are orthogonal over all points, without those that move no point.
fn independent(terms: DMatrix<f64>) -> DMatrix<f64> {
    let turned = SymmetricEigen::new(&terms * terms.transpose());
    let kept: Vec<usize> = (0..terms.nrows())
        .filter(|&k| turned.eigenvalues[k] > LEAST_POWER)
        .collect();
    turned.eigenvectors.select_columns(&kept).tr_mul(&terms)
}

/// Legendre polynomials at a place from -1 to 1, divided by the square of their order over the lowest.
fn curve(at: f64) -> [f64; CURVE_TERMS] {
    let mut last = [1.0, at];
    std::array::from_fn(|k| {
        let order = (LOWEST_ORDER + k) as f64;
        let next = ((2.0 * order - 1.0) * at * last[1] - (order - 1.0) * last[0]) / order;
        last = [last[1], next];
        next * (LOWEST_ORDER as f64 / order).powi(2)
    })
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
        let lengths_mm = lengths_mm();
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

    fn of(data: &Data, force_n: &[f64], ratio: f64, doubt: Doubt) -> Option<Discrepancy> {
        Discrepancy::new(&data.tracks, &data.weight, &data.split, force_n, ratio, doubt)
    }

    /// Mean square on selecting cycles, in units of the noise, of a force in N before and after the discrepancy is taken away.
    fn powers(doubt: Doubt, error_n: impl Fn(&Data, usize) -> f64) -> [f64; 2] {
        let (data, force_n) = baseline();
        let mut residuals: Vec<f64> = (0..data.len())
            .map(|i| data.weight[i] * error_n(&data, i))
            .collect();
        let before = data.sum(&residuals, Split::Select);
        let discrepancy = of(&data, &force_n, RATIO, doubt).expect("friction");
        discrepancy.remove(&data.split, &mut residuals);
        [before, data.sum(&residuals, Split::Select)].map(|sum| sum / data.count(Split::Select) as f64)
    }

    #[test]
    fn a_fifth_of_the_friction_in_another_law_is_its_shape() {
        // An exponential after each reversal, which is none of the terms.
        let [before, after] = powers(Doubt::Friction, |data, i| {
            let track = &data.tracks[0];
            let drag = track.direction[i] * (1.0 - 2.0 * (-track.since_reversal_mm[i] / 0.7).exp());
            0.2 * RATIO * 80.0 * track.displacement_mm[i] * drag
        });
        assert!(before > 10.0 && after < 0.05 * before, "{before} {after}");
    }

    #[test]
    fn what_is_no_friction_stays() {
        let [ripple, left] = powers(Doubt::Friction, |data, i| {
            3.0 * (4.0 * data.tracks[0].displacement_mm[i]).sin()
        });
        // Along one motion, displacement and travel since the reversal go together, so a part is imitated.
        assert!(left > 0.65 * ripple, "a ripple: {ripple} {left}");
        let [late, left] = powers(Doubt::Friction, |data, i| {
            if data.tracks[0].cycle[i] > 5 { 3.0 } else { -3.0 }
        });
        assert!(left > 0.9 * late, "a change after five cycles: {late} {left}");
    }

    /// A bend of 3 % of the force range over the whole travel, as of a spring whose ends roll on their pads. Terms of the friction that
    /// differ in the two directions imitate a part of it.
    #[test]
    fn a_bend_of_the_curve_is_its_shape() {
        let bend = |data: &Data, i: usize| (data.tracks[0].displacement_mm[i] - 5.0).powi(2);
        let [before, friction] = powers(Doubt::Friction, bend);
        let [_, both] = powers(Doubt::FrictionAndCurve, bend);
        assert!(
            both < 0.01 * before && both < 0.2 * friction,
            "{before} {friction} {both}"
        );
    }

    /// A curve with a corner and friction that is three times as high at one end; then a change over time.
    #[test]
    fn what_follows_from_the_path_is_explained_and_time_is_not() {
        let of_path = |data: &Data, i: usize| {
            let track = &data.tracks[0];
            let x = track.displacement_mm[i];
            let drag = track.direction[i] * (1.0 - 2.0 * (-track.since_reversal_mm[i] / 0.7).exp());
            40.0 * (x - 4.0).max(0.0) + 10.0 * x * drag
        };
        let [before, after] = powers(Doubt::Path, of_path);
        let [_, known] = powers(Doubt::FrictionAndCurve, of_path);
        assert!(
            after < 1e-3 * before && after < 0.2 * known,
            "{before} {known} {after}"
        );
        let [late, left] = powers(
            Doubt::Path,
            |data, i| {
                if data.tracks[0].cycle[i] > 5 { 3.0 } else { -3.0 }
            },
        );
        assert!(left > 0.9 * late, "a change after five cycles: {late} {left}");
    }

    #[test]
    fn the_sizes_of_both_shapes_are_told_apart() {
        let (data, force_n) = baseline();
        let both = of(&data, &force_n, RATIO, Doubt::FrictionAndCurve).expect("friction");
        let shares = |first: usize| {
            let mut sizes = DVector::zeros(both.count());
            sizes[first] = 1.0;
            both.shares(&sizes, &data.weight)
        };
        let (friction, curve) = (shares(0), shares(both.of_friction));
        assert!(
            friction.friction > 0.0 && friction.curve == Some(0.0),
            "{friction:?}"
        );
        assert!(curve.friction == 0.0 && curve.curve > Some(0.0), "{curve:?}");
        let friction = of(&data, &force_n, RATIO, Doubt::Friction).expect("friction");
        assert!(both.freedom(0.5) > friction.freedom(0.5));
        assert!(both.freedom(0.5) > both.freedom(0.05), "less data, less freedom");
    }

    /// A term that moves the friction by 19 % is an error of its shape, one that moves it by 21 % is not, whatever the scale.
    #[test]
    fn a_large_difference_is_no_error_of_shape() {
        let (data, force_n) = baseline();
        let whole = of(&data, &force_n, RATIO, Doubt::FrictionAndCurve).expect("friction");
        let tenth = whole.scaled(0.1, &data.split).expect("regular");
        for discrepancy in [whole, tenth] {
            let shares = |share: f64, of: &dyn Fn(ShapeShares) -> f64, term: usize| {
                let mut sizes = DVector::zeros(discrepancy.count());
                sizes[term] = 1.0;
                sizes *= share / of(discrepancy.shares(&sizes, &data.weight));
                discrepancy.shares(&sizes, &data.weight)
            };
            let friction = |share: f64| shares(share, &|s| s.friction, 0);
            assert!(friction(0.19).are_errors_of_shape() && !friction(0.21).are_errors_of_shape());
            let curve = |share: f64| shares(share, &|s| s.curve.unwrap_or(0.0), discrepancy.of_friction);
            assert!(curve(0.019).are_errors_of_shape() && !curve(0.021).are_errors_of_shape());
        }
    }

    /// An error of a thousandth of the friction is likelier where the terms are small, one of a fifth where they are large.
    #[test]
    fn a_smaller_scale_has_less_freedom_and_explains_smaller_errors() {
        let (data, force_n) = baseline();
        let whole = of(&data, &force_n, RATIO, Doubt::FrictionAndCurve).expect("friction");
        let tenth = whole.scaled(0.1, &data.split).expect("regular");
        let curve = whole.of_friction..whole.count();
        assert_eq!(
            whole.terms.rows_range(curve.clone()),
            tenth.terms.rows_range(curve)
        );
        // Cost in log-likelihood of an error of the friction's shape, as a share of the friction.
        let cost = |discrepancy: &Discrepancy, share: f64| {
            let error = |i: usize| share * RATIO * force_n[i] * data.tracks[0].direction[i];
            let mut residuals: Vec<f64> = (0..data.len()).map(|i| data.weight[i] * error(i)).collect();
            let sizes = discrepancy.remove(&data.split, &mut residuals);
            0.5 * (data.sum(&residuals, Split::Fit) + sizes.norm_squared()) + discrepancy.freedom(0.5)
        };
        assert!(cost(&tenth, 1e-3) < cost(&whole, 1e-3));
        assert!(cost(&whole, 0.2) < cost(&tenth, 0.2));
    }

    #[test]
    fn only_fitted_points_decide_and_a_part_has_its_own_terms() {
        let (data, force_n) = baseline();
        let discrepancy = of(&data, &force_n, RATIO, Doubt::Friction).expect("friction");
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
        assert!(of(&data, &force_n, 0.0, Doubt::Friction).is_none());
    }
}
