//! Fits for the search: many structures that differ by one effect, so Jacobians are kept as long as they serve.
//!
//! A structure that is already fitted has its Jacobian; a child adds only its own columns, made anew at each step, while
//! the parent's stay (a chord method). What is kept of the children is settled: Gauss-Newton with a fresh Jacobian of all
//! columns, as often as that still gains.

use nalgebra::{DMatrix, DVector};

use super::baseline::Attached;
use super::condition::Split;
use super::problem::ModelStructure;
use super::score::{Tangent, spliced};
use super::select::Node;
use crate::effect::Span;
use crate::identify::least_squares::bounded_step;

/// A fall of the sum of squares that is worth no further step: a tenth of what one parameter gains on noise.
const SETTLED: f64 = 0.1;
/// Steps with the parent's Jacobian, and Jacobians of a settling.
const STEPS: usize = 9;
/// First and last trial move of a kink, as a share of what the recordings cover.
const FIRST_TRIAL: f64 = 0.02;
const LAST_TRIAL: f64 = 2e-4;
const ROUNDS: usize = 12;
/// Least half width of a kink's interval, as a share of what the recordings cover, and halvings of the last stretch.
const NEAREST_END: f64 = 1e-5;
const HALVINGS: usize = 5;

/// One way down: values, their residuals as the fit sees them, their sum of squares.
struct NodeDescent<'s, 'a> {
    structure: &'s ModelStructure<'a>,
    values: Vec<f64>,
    residuals: DVector<f64>,
    cost: f64,
    damping: f64,
}

impl<'s, 'a> NodeDescent<'s, 'a> {
    fn new(structure: &'s ModelStructure<'a>, values: Vec<f64>) -> Option<Self> {
        let residuals = structure.fitted(&values)?;
        Some(NodeDescent {
            cost: residuals.norm_squared(),
            residuals,
            values,
            structure,
            damping: 1e-4,
        })
    }

    /// A damped step; how far the sum of squares fell, 0 where no damping makes it fall.
    fn step(&mut self, normal: &DMatrix<f64>, gradient: &DVector<f64>, scale: &[f64]) -> f64 {
        let bounds: Vec<[f64; 2]> = self.structure.parameters_bounds();
        let room: Vec<[f64; 2]> = (0..scale.len())
            .map(|i| bounds[i].map(|bound| (bound - self.values[i]) / scale[i]))
            .collect();
        for _ in 0..5 {
            let step = bounded_step(normal, gradient, self.damping, &room);
            let values: Vec<f64> = (0..scale.len())
                .map(|i| (self.values[i] + step[i] * scale[i]).clamp(bounds[i][0], bounds[i][1]))
                .collect();
            if let Some(residuals) = self.structure.fitted(&values) {
                let cost = residuals.norm_squared();
                if cost < self.cost {
                    let fell = self.cost - cost;
                    (self.values, self.residuals, self.cost) = (values, residuals, cost);
                    self.damping = (0.2 * self.damping).max(1e-9);
                    return fell;
                }
            }
            self.damping = (10.0 * self.damping).max(1e-3);
        }
        0.0
    }

    /// Moves the place of a kink by trials, the other parameters following each; smaller moves where none is lower.
    fn try_out(
        &mut self,
        place: usize,
        width: f64,
        normal: &DMatrix<f64>,
        scale: &[f64],
        gradient: &dyn Fn(&DVector<f64>) -> DVector<f64>,
    ) {
        let held = holding(normal, place);
        let mut size = FIRST_TRIAL * width;
        while size > LAST_TRIAL * width {
            let lower = [size, -size].into_iter().find_map(|by| {
                let trial = self.moved(place, self.values[place] + by, &held, scale, gradient)?;
                (trial.cost < self.cost - SETTLED).then_some(trial)
            });
            match lower {
                Some(trial) => *self = trial,
                None => size *= 0.4,
            }
        }
    }

    /// One parameter put to a value, the others following it; `held` is the normal matrix that leaves it there.
    fn moved(
        &self,
        place: usize,
        value: f64,
        held: &DMatrix<f64>,
        scale: &[f64],
        gradient: &dyn Fn(&DVector<f64>) -> DVector<f64>,
    ) -> Option<Self> {
        let [low, high] = self.structure.parameters_bounds()[place];
        let mut values = self.values.clone();
        values[place] = value.clamp(low, high);
        let mut trial = NodeDescent::new(self.structure, values)?;
        for _ in 0..2 {
            let mut slope = gradient(&trial.residuals);
            slope[place] = 0.0;
            if trial.step(held, &slope, scale) < SETTLED {
                break;
            }
        }
        Some(trial)
    }

    fn node(self) -> Option<Node> {
        Node::new(self.structure, self.values)
    }
}

/// A normal matrix under which one parameter stays.
fn holding(normal: &DMatrix<f64>, place: usize) -> DMatrix<f64> {
    let mut held = normal.clone();
    held.row_mut(place).fill(0.0);
    held.column_mut(place).fill(0.0);
    held[(place, place)] = 1.0;
    held
}

/// How far the place of a kink may go, up and down, until the fit's sum of squares has risen by `rise`: a kink between samples
/// has no slope that an interval could be made of. `width` is what the recordings cover.
pub(super) fn profile(
    structure: &ModelStructure<'_>,
    node: &Node,
    tangent: &Tangent,
    place: usize,
    width: f64,
    rise: f64,
) -> Option<[f64; 2]> {
    let descent = NodeDescent::new(structure, node.values.clone())?;
    let held = holding(&tangent.normal, place);
    let [low, high] = structure.parameters_bounds()[place];
    let too_far = |value: f64| {
        value <= low
            || value >= high
            || descent
                .moved(place, value, &held, &tangent.scale, &|residuals| {
                    tangent.jacobian.tr_mul(residuals)
                })
                .is_none_or(|there| there.cost > descent.cost + rise)
    };
    let at = node.values[place];
    let end = |sign: f64| {
        let (mut inside, mut outside) = (0.0, NEAREST_END * width);
        while !too_far(at + sign * outside) {
            (inside, outside) = (outside, 2.0 * outside);
            if outside > width {
                return None;
            }
        }
        for _ in 0..HALVINGS {
            let middle = 0.5 * (inside + outside);
            if too_far(at + sign * middle) {
                outside = middle;
            } else {
                inside = middle;
            }
        }
        Some(at + sign * outside)
    };
    Some([end(-1.0)?, end(1.0)?])
}

/// A child of a settled node: one effect more, from one start, with the node's Jacobian kept.
pub(super) fn grow(
    parent: &ModelStructure<'_>,
    node: &Node,
    tangent: &Tangent,
    candidate: &Attached,
    start: &[f64],
    span: &Span,
) -> Option<Node> {
    let structure = parent.with(candidate);
    let (p, k) = (node.values.len(), candidate.parameters.len());
    // Order of the values: the parent's without its zero, the child's, the zero.
    let place = |i: usize| if i + 1 == p { p - 1 + k } else { i };
    let own: Vec<usize> = (p - 1..p - 1 + k).collect();
    let mut descent = NodeDescent::new(&structure, spliced(&node.values, start))?;
    let mut scale = structure.scale(&descent.values);
    for i in 0..p {
        scale[place(i)] = tangent.scale[i];
    }
    let (mut idle, mut last) = (0, None);
    for _ in 0..STEPS {
        let own_scale = structure.scale(&descent.values);
        for &i in &own {
            scale[i] = own_scale[i];
        }
        let columns = structure.columns(&descent.values, &descent.residuals, &own, &scale);
        let cross = tangent.jacobian.tr_mul(&columns);
        let inner = columns.tr_mul(&columns);
        let mut normal = DMatrix::zeros(p + k, p + k);
        for i in 0..p {
            for j in 0..p {
                normal[(place(i), place(j))] = tangent.normal[(i, j)];
            }
            for j in 0..k {
                normal[(place(i), p - 1 + j)] = cross[(i, j)];
                normal[(p - 1 + j, place(i))] = cross[(i, j)];
            }
        }
        normal.view_mut((p - 1, p - 1), (k, k)).copy_from(&inner);
        let gradient = whole_gradient(tangent, &columns, &descent.residuals);
        let fell = descent.step(&normal, &gradient, &scale);
        last = Some((normal, columns));
        idle = if fell < SETTLED.max(2e-4 * descent.cost) {
            idle + 1
        } else {
            0
        };
        if fell == 0.0 || idle == 2 {
            break;
        }
    }
    if let Some((normal, columns)) = last {
        for &(i, axis) in candidate.effect.kinks {
            descent.try_out(p - 1 + i, span.width(axis), &normal, &scale, &|residuals| {
                whole_gradient(tangent, &columns, residuals)
            });
        }
    }
    descent.node()
}

/// Gradient in the order of the values: the parent's columns without its zero, the child's, the zero.
fn whole_gradient(tangent: &Tangent, columns: &DMatrix<f64>, residuals: &DVector<f64>) -> DVector<f64> {
    let (ours, theirs) = (tangent.jacobian.tr_mul(residuals), columns.tr_mul(residuals));
    let (p, k) = (ours.len(), theirs.len());
    DVector::from_fn(p + k, |i, _| {
        if i + 1 < p {
            ours[i]
        } else if i < p - 1 + k {
            theirs[i + 1 - p]
        } else {
            ours[p - 1]
        }
    })
}

/// Goes down from a node to where no step gains, and gives the tangent there.
pub(super) fn settle(structure: &ModelStructure<'_>, values: Vec<f64>) -> Option<(Node, Tangent)> {
    let mut descent = NodeDescent::new(structure, values)?;
    for round in 0.. {
        let tangent = Tangent::new(structure, &descent.values)?;
        if round == ROUNDS {
            return Some((descent.node()?, tangent));
        }
        let before = descent.cost;
        for _ in 0..2 {
            let gradient = tangent.jacobian.tr_mul(&descent.residuals);
            if descent.step(&tangent.normal, &gradient, &tangent.scale) < SETTLED {
                break;
            }
        }
        if before - descent.cost < 5.0 * SETTLED {
            return Some((descent.node()?, tangent));
        }
    }
    None
}

/// A few steps down on the structure's own model with the slopes of its surrogate.
pub(super) fn polish(exact: &ModelStructure<'_>, tangent: &Tangent, values: Vec<f64>) -> Option<Node> {
    let mut descent = NodeDescent::new(exact, values)?;
    for _ in 0..STEPS {
        let gradient = tangent.jacobian.tr_mul(&descent.residuals);
        let fell = descent.step(&tangent.normal, &gradient, &tangent.scale);
        if fell < (5.0 * SETTLED).max(1e-3 * descent.cost) {
            break;
        }
    }
    descent.node()
}

impl Node {
    /// Residuals and sums at some values.
    pub(super) fn new(structure: &ModelStructure<'_>, values: Vec<f64>) -> Option<Node> {
        let residuals = structure.residuals(&values)?;
        Some(Node {
            fit: structure.data.sum(&residuals, Split::Fit),
            select: structure.data.sum(&residuals, Split::Select),
            residuals,
            values,
            attached: structure.attached.clone(),
        })
    }
}
