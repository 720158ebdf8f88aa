//! Helpers for the tests of all effects: a spring without friction, a motion, and the checks that every effect must pass.

use nalgebra::{DMatrix, DVector};

use super::{Effect, Recorded, Span};
use crate::model::Plant;
use crate::model::equivalent::Equivalent;

/// A spring with 100 N at zero displacement, 80 N/mm and no friction.
pub(crate) fn spring() -> Box<dyn Plant> {
    Box::new(Equivalent::new(&[100.0, 80.0, 0.0, 0.5], 0.0).expect("four values"))
}

/// Ranges that [`motion`] covers.
pub(crate) fn span() -> Span {
    Span {
        displacement_mm: [0.0, 12.0],
        force_n: [0.0, 1060.0],
        speed_mm_s: 75.0,
        duration_s: 60.0,
        cycles: 6.0,
    }
}

/// Time steps and displacements: a slow ramp up, a hold and down, then sines of two amplitudes at 2 Hz.
/// Recordings of a straight line from 0 to a displacement in mm and a force in N, with a contact at 0.
pub(crate) fn ramp([top_mm, top_n]: [f64; 2]) -> Recorded<'static> {
    Recorded {
        span: Span {
            displacement_mm: [0.0, top_mm],
            force_n: [0.0, top_n],
            ..span()
        },
        noise_n: 1.0,
        force_n: &|_| None,
        force_below_n: &|_| Some(0.0),
    }
}

pub(crate) fn motion() -> Vec<(f64, f64)> {
    let mut steps = Vec::new();
    steps.extend((0..200).map(|i| (0.1, 0.05 * f64::from(i))));
    steps.extend((0..100).map(|_| (0.1, 10.0)));
    steps.extend((0..200).map(|i| (0.1, 10.0 - 0.05 * f64::from(i))));
    for amplitude in [3.0, 6.0] {
        steps.extend((0..750).map(|i| {
            let angle = std::f64::consts::TAU * 2.0 * 0.002 * f64::from(i);
            (0.002, amplitude * (1.0 - angle.cos()))
        }));
    }
    steps
}

/// Forces over [`motion`].
pub(crate) fn drive(plant: &mut Box<dyn Plant>) -> Vec<f64> {
    motion()
        .into_iter()
        .map(|(dt_s, x)| plant.step(x, dt_s))
        .collect()
}

/// Makes the plant that an effect is tested on.
type Inside = fn() -> Box<dyn Plant>;

fn forces(effect: &Effect, values: &[f64], inside: Inside) -> Vec<f64> {
    drive(&mut (effect.attach)(values, inside()))
}

/// Asserts that the effect changes no bit of the force at its neutral values.
pub(crate) fn neutral_changes_nothing(effect: &Effect) {
    assert_eq!(
        forces(effect, effect.neutral, spring),
        drive(&mut spring()),
        "{}",
        effect.code
    );
}

/// Asserts that a fit from one of the starts of the effect ends at `truth`, within a share of 1e-3.
pub(crate) fn parameters_are_recovered(effect: &Effect, truth: &[f64]) {
    parameters_are_recovered_on(spring, effect, truth);
}

/// The same on another plant than a spring.
pub(crate) fn parameters_are_recovered_on(inside: Inside, effect: &Effect, truth: &[f64]) {
    let wanted = forces(effect, truth, inside);
    let close = |values: &[f64]| {
        values
            .iter()
            .zip(truth)
            .all(|(v, t)| (v - t).abs() <= 1e-3 * t.abs().max(1e-3))
    };
    let mut ends = Vec::new();
    for start in (effect.starts)(&span()) {
        let values = fitted(effect, start, &wanted, inside);
        if close(&values) {
            return;
        }
        ends.push(values);
    }
    panic!("{}: wanted {truth:?}, ended at {ends:?}", effect.code);
}

/// Levenberg-Marquardt fit of the forces `wanted`, within the bounds of the parameters.
fn fitted(effect: &Effect, start: Vec<f64>, wanted: &[f64], inside: Inside) -> Vec<f64> {
    let mut values = start;
    let mut damping = 1e-3;
    for _ in 0..150 {
        let residual = misfit(effect, &values, wanted, inside);
        let jacobian = jacobian(effect, &values, &residual, wanted, inside);
        let mut normal = jacobian.tr_mul(&jacobian);
        for n in 0..values.len() {
            normal[(n, n)] *= 1.0 + damping;
            normal[(n, n)] += 1e-12;
        }
        let Some(step) = normal.lu().solve(&(-jacobian.tr_mul(&residual))) else {
            break;
        };
        let next: Vec<f64> = values
            .iter()
            .zip(step.iter())
            .zip(effect.parameters)
            .map(|((v, s), p)| (v + s).clamp(p.bounds[0], p.bounds[1]))
            .collect();
        if misfit(effect, &next, wanted, inside).norm_squared() < residual.norm_squared() {
            values = next;
            damping *= 0.3;
        } else {
            damping *= 4.0;
        }
    }
    values
}

/// Differences between the forces of the effect and `wanted`, N.
fn misfit(effect: &Effect, values: &[f64], wanted: &[f64], inside: Inside) -> DVector<f64> {
    DVector::from_vec(
        forces(effect, values, inside)
            .iter()
            .zip(wanted)
            .map(|(a, b)| a - b)
            .collect(),
    )
}

/// Derivatives of the misfit by each parameter, as differences with steps that stay within the bounds.
fn jacobian(
    effect: &Effect,
    values: &[f64],
    residual: &DVector<f64>,
    wanted: &[f64],
    inside: Inside,
) -> DMatrix<f64> {
    let columns: Vec<DVector<f64>> = (0..values.len())
        .map(|n| {
            let mut moved = values.to_vec();
            let mut h = 1e-5 * moved[n].abs().max(1e-3);
            if moved[n] + h > effect.parameters[n].bounds[1] {
                h = -h;
            }
            moved[n] += h;
            (misfit(effect, &moved, wanted, inside) - residual) / h
        })
        .collect();
    DMatrix::from_columns(&columns)
}
