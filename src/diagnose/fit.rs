//! Fits for the search: many structures that differ by one effect, so Jacobians are kept as long as they serve.
//!
//! A structure that is already fitted has its Jacobian; a child adds only its own columns, made anew at each step, while
//! the parent's stay (a chord method). What is kept of the children is settled: Gauss-Newton with a fresh Jacobian of all
//! columns, as often as that still gains.

use nalgebra::{DMatrix, DVector};

use super::baseline::Attached;
use super::condition::Part;
use super::problem::Structure;
use super::score::{Tangent, spliced};
use super::select::Node;
use crate::identify::least_squares::bounded_step;

/// A fall of the sum of squares that is worth no further step: a tenth of what one parameter gains on noise.
const SETTLED: f64 = 0.1;
/// Steps with the parent's Jacobian, and Jacobians of a settling.
const STEPS: usize = 9;
const ROUNDS: usize = 5;

/// One way down: values, their residuals as the fit sees them, their sum of squares.
struct Descent<'s, 'a> {
    structure: &'s Structure<'a>,
    values: Vec<f64>,
    residuals: DVector<f64>,
    cost: f64,
    damping: f64,
}

impl<'s, 'a> Descent<'s, 'a> {
    fn new(structure: &'s Structure<'a>, values: Vec<f64>) -> Option<Self> {
        let residuals = structure.fitted(&values)?;
        Some(Descent {
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

    fn node(self) -> Option<Node> {
        Node::new(self.structure, self.values)
    }
}

/// A child of a settled node: one effect more, from one start, with the node's Jacobian kept.
pub(super) fn grow(
    parent: &Structure<'_>,
    node: &Node,
    tangent: &Tangent,
    candidate: &Attached,
    start: &[f64],
) -> Option<Node> {
    let structure = parent.with(candidate);
    let (p, k) = (node.values.len(), candidate.parameters.len());
    // Order of the values: the parent's without its zero, the child's, the zero.
    let place = |i: usize| if i + 1 == p { p - 1 + k } else { i };
    let own: Vec<usize> = (p - 1..p - 1 + k).collect();
    let mut descent = Descent::new(&structure, spliced(&node.values, start))?;
    let mut scale = structure.scale(&descent.values);
    for i in 0..p {
        scale[place(i)] = tangent.scale[i];
    }
    let mut idle = 0;
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
        let ours = tangent.jacobian.tr_mul(&descent.residuals);
        let theirs = columns.tr_mul(&descent.residuals);
        let mut gradient = DVector::zeros(p + k);
        for i in 0..p {
            gradient[place(i)] = ours[i];
        }
        for j in 0..k {
            gradient[p - 1 + j] = theirs[j];
        }
        let fell = descent.step(&normal, &gradient, &scale);
        idle = if fell < SETTLED.max(2e-4 * descent.cost) {
            idle + 1
        } else {
            0
        };
        if fell == 0.0 || idle == 2 {
            break;
        }
    }
    descent.node()
}

/// Goes down from a node to where no step gains, and gives the tangent there.
pub(super) fn settle(structure: &Structure<'_>, values: Vec<f64>) -> Option<(Node, Tangent)> {
    let mut descent = Descent::new(structure, values)?;
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

impl Node {
    /// Residuals and sums at some values.
    pub fn new(structure: &Structure<'_>, values: Vec<f64>) -> Option<Node> {
        let residuals = structure.residuals(&values)?;
        Some(Node {
            fit: structure.data.sum(&residuals, Part::Fit),
            select: structure.data.sum(&residuals, Part::Select),
            residuals,
            values,
            attached: structure.attached.clone(),
        })
    }
}
