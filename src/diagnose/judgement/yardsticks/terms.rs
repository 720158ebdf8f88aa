//! Least squares for a force that is a sum of terms: `F = sum strength_i * term_i`, some strengths not negative.
//!
//! Every point counts alike, because the error that yardsticks are compared by counts every point alike.
//! Source of the active-set method: C. L. Lawson, R. J. Hanson, Solving Least Squares Problems (1974), chapter 23. The normal
//! equations are accurate enough for the dozen terms of a yardstick.

use nalgebra::{DMatrix, DVector};

use crate::diagnose::conditioning::range;
use crate::diagnose::course::{Course, Split};

/// Terms of a force: one column over the points of a course for each term.
pub(super) type Terms = Vec<Vec<f64>>;

/// A strength that is held at zero is freed if the cost falls faster than this, in a scale where each term and the force have
/// length 1.
const LEAST_GRADIENT: f64 = 1e-10;
/// Added to the diagonal in the same scale: terms that are equal on the fitted points share their strength.
const RIDGE: f64 = 1e-12;

/// Strengths of the terms by least squares over the fitted points. `terms` has one entry per course, `not_negative` one per term.
/// `None` if there are fewer points than terms or a term is not finite.
pub(super) fn strengths(courses: &[Course], terms: &[Terms], not_negative: &[bool]) -> Option<Vec<f64>> {
    let n = not_negative.len();
    let (mut normal, mut target) = (DMatrix::<f64>::zeros(n, n), DVector::<f64>::zeros(n));
    let (mut force_power, mut count) = (0.0, 0);
    for (course, columns) in courses.iter().zip(terms) {
        for i in course.points(Split::Fit) {
            let force_n = course.force_n[i];
            for a in 0..n {
                target[a] += columns[a][i] * force_n;
                for b in 0..=a {
                    normal[(a, b)] += columns[a][i] * columns[b][i];
                }
            }
            force_power += force_n * force_n;
            count += 1;
        }
    }
    let scale: Vec<f64> = (0..n).map(|a| normal[(a, a)].sqrt()).collect();
    let finite = scale.iter().all(|s| s.is_finite()) && force_power.is_finite();
    if count < n || !finite || force_power <= 0.0 {
        return None;
    }
    // A term that is zero at every fitted point gets no strength.
    let inverse: Vec<f64> = scale
        .iter()
        .map(|s| if *s > 0.0 { 1.0 / s } else { 0.0 })
        .collect();
    for a in 0..n {
        target[a] *= inverse[a] / force_power.sqrt();
        for b in 0..=a {
            normal[(a, b)] *= inverse[a] * inverse[b];
            normal[(b, a)] = normal[(a, b)];
        }
        normal[(a, a)] += RIDGE;
    }
    let solved = not_negative_least_squares(&normal, &target, not_negative)?;
    Some(
        (0..n)
            .map(|a| solved[a] * inverse[a] * force_power.sqrt())
            .collect(),
    )
}

/// Minimises `x'Nx / 2 - x't`, with the entries of `x` that are marked not below zero.
fn not_negative_least_squares(
    normal: &DMatrix<f64>,
    target: &DVector<f64>,
    not_negative: &[bool],
) -> Option<DVector<f64>> {
    let n = target.len();
    let mut free: Vec<bool> = not_negative.iter().map(|bounded| !bounded).collect();
    let mut x = DVector::zeros(n);
    // Each round frees one strength; more rounds than this mean that rounding decides, and the last result is as good.
    for _ in 0..4 * n {
        x = feasible(normal, target, not_negative, &mut free, x)?;
        let descent = target - normal * &x;
        let steepest = (0..n)
            .filter(|&a| !free[a] && descent[a] > LEAST_GRADIENT)
            .max_by(|&a, &b| descent[a].total_cmp(&descent[b]));
        match steepest {
            Some(a) => free[a] = true,
            None => break,
        }
    }
    Some(x)
}

/// The minimum over the free entries. Entries on the way to it that reach zero are held there.
fn feasible(
    normal: &DMatrix<f64>,
    target: &DVector<f64>,
    not_negative: &[bool],
    free: &mut [bool],
    mut x: DVector<f64>,
) -> Option<DVector<f64>> {
    loop {
        let wanted = minimum(normal, target, free)?;
        let below = |a: &usize| free[*a] && not_negative[*a] && wanted[*a] <= 0.0;
        let part = (0..x.len())
            .filter(below)
            .map(|a| {
                if x[a] > 0.0 {
                    x[a] / (x[a] - wanted[a])
                } else {
                    0.0
                }
            })
            .fold(f64::INFINITY, f64::min);
        if part.is_infinite() {
            return Some(wanted);
        }
        let leaving: Vec<usize> = (0..x.len()).filter(below).collect();
        x += (&wanted - &x) * part;
        for a in leaving {
            if x[a] <= 1e-14 {
                x[a] = 0.0;
                free[a] = false;
            }
        }
    }
}

/// The minimum with the entries that are not free at zero.
fn minimum(normal: &DMatrix<f64>, target: &DVector<f64>, free: &[bool]) -> Option<DVector<f64>> {
    let places: Vec<usize> = (0..free.len()).filter(|&a| free[a]).collect();
    let mut x = DVector::zeros(free.len());
    if places.is_empty() {
        return Some(x);
    }
    let part = DMatrix::from_fn(places.len(), places.len(), |a, b| normal[(places[a], places[b])]);
    let right = DVector::from_fn(places.len(), |a, _| target[places[a]]);
    let solved = part.cholesky()?.solve(&right);
    for (place, value) in places.into_iter().zip(solved.iter()) {
        x[place] = *value;
    }
    Some(x)
}

/// The force in N at every point of a course with these terms.
pub(super) fn force_n(terms: &[Vec<f64>], strengths: &[f64]) -> Vec<f64> {
    let mut force_n = vec![0.0; terms.first().map_or(0, Vec::len)];
    for (column, strength) in terms.iter().zip(strengths) {
        for (force_n, term) in force_n.iter_mut().zip(column) {
            *force_n += strength * term;
        }
    }
    force_n
}

/// The terms of offset, linear spring and viscous damper, which more than one yardstick has.
pub(super) fn spring_and_damper(course: &Course) -> Terms {
    let speeds = course.motion.iter().map(|m| m.velocity_mm_s);
    vec![
        vec![1.0; course.force_n.len()],
        course.displacement_mm.clone(),
        speeds.collect(),
    ]
}

/// Which strengths of [`spring_and_damper`] are not negative: a damper takes energy, while a mechanism may have a negative rate.
pub(super) const SPRING_AND_DAMPER: [bool; 3] = [false, false, true];

/// Range of the displacement over all courses in mm.
pub(super) fn stroke_mm(courses: &[Course]) -> f64 {
    let all: Vec<f64> = courses
        .iter()
        .flat_map(|c| c.displacement_mm.iter().copied())
        .collect();
    range(&all)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// minimise |A x - b|^2 for A = [[1, 0], [1, 1]], b = (1, 0): free x = (1, -1); with x2 >= 0 the normal equation of x1 alone
    /// gives 2 x1 = 1.
    #[test]
    fn a_strength_that_would_be_negative_is_zero_and_the_others_are_solved_again() {
        let normal = DMatrix::from_row_slice(2, 2, &[2.0, 1.0, 1.0, 1.0]);
        let target = DVector::from_vec(vec![1.0, 0.0]);
        let free = not_negative_least_squares(&normal, &target, &[false, false]).expect("solved");
        assert!((free - DVector::from_vec(vec![1.0, -1.0])).amax() < 1e-12);
        let bounded = not_negative_least_squares(&normal, &target, &[true, true]).expect("solved");
        assert!((bounded - DVector::from_vec(vec![0.5, 0.0])).amax() < 1e-12);
    }

    /// Optimality (Karush, Kuhn and Tucker) on matrices of a fixed pseudo-random sequence: the descent is zero where the strength is
    /// free and not positive where it is zero.
    #[test]
    fn the_result_cannot_be_improved() {
        let mut state = 1u64;
        let mut random = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1u32 << 31) - 0.5
        };
        for n in 2..12 {
            let a = DMatrix::from_fn(3 * n, n, |_, _| random());
            let b = DVector::from_fn(3 * n, |_, _| random());
            let (normal, target) = (a.tr_mul(&a), a.tr_mul(&b));
            let x = not_negative_least_squares(&normal, &target, &vec![true; n]).expect("solved");
            let descent = &target - &normal * &x;
            for k in 0..n {
                assert!(x[k] >= 0.0 && descent[k] < 1e-9, "{n}: {x} {descent}");
                assert!(x[k] == 0.0 || descent[k].abs() < 1e-9, "{n}: {x} {descent}");
            }
        }
    }
}
