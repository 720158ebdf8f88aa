//! Fits for the search. Most structures differ from a fitted one by one effect, so its Jacobian is used again.
//!
//! A child adds only the columns of its own effect. They are renewed at each step, the parent's columns are not (a chord method).
//! The children that the search keeps are then fitted to convergence: Gauss-Newton with new Jacobians of all columns.

use nalgebra::{DMatrix, DVector};

use super::baseline::Attached;
use super::node::Node;
use super::score::{CandidateScore, Tangent, insert_group};
use super::structure::ModelStructure;
use crate::effect::Span;
use crate::identify::least_squares::bounded_step;

/// A step that lowers the sum of squares by less than this is the last one: a tenth of what one parameter gains on pure noise, or
/// where the model is far off, a share that changes no gain in log-likelihood by one.
const CONVERGED: f64 = 0.1;
const CONVERGED_SHARE: f64 = 2e-5;
/// Largest number of steps with one Jacobian of the parent, and of new Jacobians until convergence.
const STEPS: usize = 9;
const ROUNDS: usize = 12;
/// Most steps with one Jacobian on the way to convergence: a step is one run of the model, a Jacobian one for each parameter.
const CHORD_STEPS: usize = 12;
/// A round is the last one if all its steps together lower the sum of squares by less than this many times an idle step. Of 865 fits of
/// six cases, 5.5 % stopped more than 10 above what 40 further rounds reached. With ten times the number it was 9.4 %, in 0.95 of the time.
const LAST_ROUND: f64 = 5.0;
/// Most trials of a step. Each has ten times the damping of the one before.
const TRIALS: usize = 5;
/// Highest damping at the beginning of a round. A failed step leaves a high damping; with it the next round would hardly move, and the fit
/// would count as converged.
const DAMPING: f64 = 1e-4;
/// A step of a child that lowers the sum of squares by less than this share is idle; two idle steps end the fit.
const IDLE_FALL: f64 = 2e-4;
/// Sizes of a child's effect that its fit may start from, as shares of the predicted size. A smaller size is tried where the larger one
/// is a far start, or where its fit ended worse than without the effect. Of 60 fits of specimens drawn afterwards, 4 ended with 1.3 to
/// 760 times the sum of squares of the set without the effect where only the first size was used.
const SIZES: [f64; 3] = [1.0, 0.2, 0.04];
/// A start is far if its sum of squares is more than this many times that without the effect. Measured on twenty cases that were looked
/// at, on 1858 starts that were worse than no effect. Up to 10 times, the fit from the predicted size ended lower in 133 and higher in 72
/// than the fit from the best of the three sizes, in the same time. Beyond 10 times it ended lower in 36 and higher in 41, and took 23 s
/// instead of 13 s. From 3 to 10 times: lower in 34, higher in 16. From 10 to 30 times: lower in 10, higher in 12.
const FAR: f64 = 10.0;
/// Search for the position of a kink by trials: first and last move as a share of the range that the recordings cover, and the
/// factor from one move to the next.
const FIRST_MOVE: f64 = 0.02;
const LAST_MOVE: f64 = 2e-4;
const SHRINK: f64 = 0.4;
/// Most moves: more follow a valley in which the other parameters move along, which a fit to convergence does far faster.
const MOST_MOVES: usize = 16;
/// Smallest half width of a kink's interval, as a share of the same range, and bisections of its end.
const LEAST_HALF_WIDTH: f64 = 1e-5;
const BISECTIONS: usize = 5;

/// Values tried by a step, and the residuals there.
struct TriedStep {
    values: Vec<f64>,
    residuals: DVector<f64>,
}

/// A Levenberg-Marquardt descent of one structure: values, residuals and sum of squares of the fit.
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
            damping: DAMPING,
        })
    }

    /// A fall of the sum of squares that is not worth a further step.
    fn idle_fall(&self) -> f64 {
        CONVERGED.max(CONVERGED_SHARE * self.cost)
    }

    /// Distances of the values to their bounds, in units of their scale.
    fn room(&self, bounds: &[[f64; 2]], scale: &[f64]) -> Vec<[f64; 2]> {
        (0..scale.len())
            .map(|i| bounds[i].map(|bound| (bound - self.values[i]) / scale[i]))
            .collect()
    }

    /// Fall of the sum of squares that the slopes promise for the next step.
    fn promised_fall(&self, normal: &DMatrix<f64>, gradient: &DVector<f64>, scale: &[f64]) -> f64 {
        let room = self.room(&self.structure.parameters_bounds(), scale);
        let step = bounded_step(normal, gradient, self.damping, &room);
        -2.0 * gradient.dot(&step) - step.dot(&(normal * &step))
    }

    /// A damped step; returns the fall of the sum of squares, 0 where no damping makes it fall.
    fn step(&mut self, normal: &DMatrix<f64>, gradient: &DVector<f64>, scale: &[f64]) -> f64 {
        (0..TRIALS)
            .find_map(|_| self.judge(self.trial(normal, gradient, scale)))
            .unwrap_or(0.0)
    }

    /// The same, but each trial corrects the Jacobian, also a trial that failed.
    fn step_and_learn(&mut self, slopes: &mut SecantSlopes, scale: &[f64]) -> f64 {
        (0..TRIALS)
            .find_map(|_| {
                let gradient = slopes.jacobian.tr_mul(&self.residuals);
                let trial = self.trial(&slopes.normal, &gradient, scale);
                if let Some(trial) = &trial {
                    slopes.learn(self, trial, scale);
                }
                self.judge(trial)
            })
            .unwrap_or(0.0)
    }

    /// Where a step with the present damping leads; `None` where the model cannot be run there.
    fn trial(&self, normal: &DMatrix<f64>, gradient: &DVector<f64>, scale: &[f64]) -> Option<TriedStep> {
        let bounds = self.structure.parameters_bounds();
        let step = bounded_step(normal, gradient, self.damping, &self.room(&bounds, scale));
        let values: Vec<f64> = (0..scale.len())
            .map(|i| (self.values[i] + step[i] * scale[i]).clamp(bounds[i][0], bounds[i][1]))
            .collect();
        let residuals = self.structure.fitted(&values)?;
        Some(TriedStep { values, residuals })
    }

    /// Goes to a trial that lowers the sum of squares, and returns by how much; else raises the damping.
    fn judge(&mut self, trial: Option<TriedStep>) -> Option<f64> {
        if let Some(TriedStep { values, residuals }) = trial {
            let cost = residuals.norm_squared();
            if cost < self.cost {
                let fell = self.cost - cost;
                (self.values, self.residuals, self.cost) = (values, residuals, cost);
                self.damping = (0.2 * self.damping).max(1e-9);
                return Some(fell);
            }
        }
        self.damping = (10.0 * self.damping).max(1e-3);
        None
    }

    /// Moves the position of a kink by trials, because it has no slope; the other parameters are refitted after each move. The moves
    /// become smaller where none lowers the sum of squares, and longer again where one does.
    fn search_kink(
        &mut self,
        place: usize,
        (width, first_move): (f64, f64),
        normal: &DMatrix<f64>,
        scale: &[f64],
        gradient: &dyn Fn(&DVector<f64>) -> DVector<f64>,
    ) {
        let held = with_parameter_fixed(normal, place);
        let (mut size, mut moves) = (first_move * width, 0);
        while size > LAST_MOVE * width && moves < MOST_MOVES {
            let lower = [size, -size].into_iter().find_map(|by| {
                let to_beat = self.cost - self.idle_fall();
                let value = self.values[place] + by;
                let trial = self.refitted_at(place, value, &held, scale, gradient, to_beat)?;
                (trial.cost < to_beat).then_some(trial)
            });
            match lower {
                Some(trial) => {
                    *self = trial;
                    size = (size / SHRINK).min(first_move * width);
                    moves += 1;
                }
                None => size *= SHRINK,
            }
        }
    }

    /// One parameter set to a value and the others refitted; `held` is the normal matrix that keeps it there. `None` where the slopes
    /// say that the sum of squares will not fall below `to_beat`.
    fn refitted_at(
        &self,
        place: usize,
        value: f64,
        held: &DMatrix<f64>,
        scale: &[f64],
        gradient: &dyn Fn(&DVector<f64>) -> DVector<f64>,
        to_beat: f64,
    ) -> Option<Self> {
        let [low, high] = self.structure.parameters_bounds()[place];
        let mut values = self.values.clone();
        values[place] = value.clamp(low, high);
        let mut trial = NodeDescent::new(self.structure, values)?;
        for _ in 0..2 {
            let mut slope = gradient(&trial.residuals);
            slope[place] = 0.0;
            if trial.cost > to_beat && trial.cost - trial.promised_fall(held, &slope, scale) > to_beat {
                return None;
            }
            if trial.step(held, &slope, scale) < trial.idle_fall() {
                break;
            }
        }
        Some(trial)
    }

    fn node(self) -> Option<Node> {
        Node::new(self.structure, self.values)
    }
}

/// The normal matrix under which one parameter stays fixed.
fn with_parameter_fixed(normal: &DMatrix<f64>, place: usize) -> DMatrix<f64> {
    let mut held = normal.clone();
    held.row_mut(place).fill(0.0);
    held.column_mut(place).fill(0.0);
    held[(place, place)] = 1.0;
    held
}

/// Profile likelihood interval of a kink: where the refitted sum of squares has risen by `rise`. A kink between samples has no
/// slope, so a linear interval does not exist. `width` is the range that the recordings cover.
pub(in crate::diagnose) fn profile_interval(
    structure: &ModelStructure<'_>,
    node: &Node,
    tangent: &Tangent,
    place: usize,
    width: f64,
    rise: f64,
) -> Option<[f64; 2]> {
    let descent = NodeDescent::new(structure, node.values.clone())?;
    let held = with_parameter_fixed(&tangent.normal, place);
    let [low, high] = structure.parameters_bounds()[place];
    let gradient = |residuals: &DVector<f64>| tangent.jacobian.tr_mul(residuals);
    let too_far = |value: f64| {
        value <= low
            || value >= high
            || descent
                .refitted_at(
                    place,
                    value,
                    &held,
                    &tangent.scale,
                    &gradient,
                    descent.cost + rise,
                )
                .is_none_or(|there| there.cost > descent.cost + rise)
    };
    let at = node.values[place];
    let end = |sign: f64| {
        let (mut inside, mut outside) = (0.0, LEAST_HALF_WIDTH * width);
        while !too_far(at + sign * outside) {
            (inside, outside) = (outside, 2.0 * outside);
            if outside > width {
                return None;
            }
        }
        for _ in 0..BISECTIONS {
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

/// A converged node to which effects are added: with its tangent on all points, and where there are many, on fewer.
pub(super) struct Parent<'a> {
    pub node: &'a Node,
    pub structure: ModelStructure<'a>,
    pub tangent: &'a Tangent,
    pub coarse: Option<(ModelStructure<'a>, Tangent)>,
}

impl Parent<'_> {
    /// The points to screen on: the fewer ones where there are such.
    pub(super) fn screen(&self) -> (&ModelStructure<'_>, &Tangent) {
        match &self.coarse {
            Some((structure, tangent)) => (structure, tangent),
            None => (&self.structure, self.tangent),
        }
    }
}

/// A child that is fitted to the points to screen on.
pub(super) struct ScreenedChild {
    values: Vec<f64>,
    pub cost: f64,
}

/// Fits a child of a converged node to the points to screen on: one more effect, from one start, with the node's Jacobian used again. A
/// size whose start is far is passed over, but not the smallest. A fit that ends worse than the node without the effect starts again from
/// a smaller size.
pub(super) fn screen_child(
    parent: &Parent<'_>,
    candidate: &Attached,
    score: &CandidateScore,
    span: &Span,
) -> Option<ScreenedChild> {
    let (screen, tangent) = parent.screen();
    let structure = screen.with(candidate);
    let [.., smallest] = SIZES;
    let mut best: Option<NodeDescent<'_, '_>> = None;
    for size in SIZES {
        if best.as_ref().is_some_and(|best| best.cost <= tangent.cost()) {
            break;
        }
        let start = start_of(&structure, parent, candidate, score, (size, span));
        let near = start.filter(|start| size == smallest || start.cost <= FAR * tangent.cost());
        let fitted = near.map(|start| descend(start, tangent, candidate, span, FROM_START));
        best = best
            .into_iter()
            .chain(fitted)
            .min_by(|a, b| a.cost.total_cmp(&b.cost));
    }
    best.map(|NodeDescent { values, cost, .. }| ScreenedChild { values, cost })
}

/// Fits a screened child to all points.
pub(super) fn fit_child(
    parent: &Parent<'_>,
    candidate: &Attached,
    screened: &ScreenedChild,
    span: &Span,
) -> Option<Node> {
    let structure = parent.structure.with(candidate);
    let start = NodeDescent::new(&structure, screened.values.clone())?;
    match parent.coarse {
        Some(_) => descend(start, parent.tangent, candidate, span, FROM_COARSE).node(),
        None => start.node(),
    }
}

/// Start of a child with its effect at a share (`size`) of what `score` predicts. The node's own values are as they are, or corrected for
/// what the effect now explains in their place: the start that fits better is used.
fn start_of<'s, 'a>(
    structure: &'s ModelStructure<'a>,
    parent: &Parent<'_>,
    candidate: &Attached,
    score: &CandidateScore,
    (size, span): (f64, &Span),
) -> Option<NodeDescent<'s, 'a>> {
    let effect = candidate.effect.at_share(&score.start, size, span);
    let unmoved = &parent.node.values;
    let moved = unmoved.iter().zip(&score.moved);
    let moved: Vec<f64> = moved.map(|(u, m)| (1.0 - size) * u + size * m).collect();
    let starts = [unmoved, &moved].into_iter();
    let starts = starts.filter_map(|values| NodeDescent::new(structure, insert_group(values, &effect)));
    starts.min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// Effort of a descent.
#[derive(Clone, Copy)]
struct DescentSettings {
    /// Most Gauss-Newton steps.
    steps: usize,
    /// First move of a kink as a share of the recorded range.
    first_move: f64,
}

/// From a start of the effect, which may be far from the minimum.
const FROM_START: DescentSettings = DescentSettings {
    steps: STEPS,
    first_move: FIRST_MOVE,
};
/// From the minimum on fewer points, to that on all points.
const FROM_COARSE: DescentSettings = DescentSettings {
    steps: 1,
    first_move: 0.05 * FIRST_MOVE,
};

/// Descends from the values of a child, with the tangent of its parent.
fn descend<'s, 'a>(
    mut descent: NodeDescent<'s, 'a>,
    tangent: &Tangent,
    candidate: &Attached,
    span: &Span,
    settings: DescentSettings,
) -> NodeDescent<'s, 'a> {
    let structure = descent.structure;
    let (p, k) = (tangent.scale.len(), candidate.parameters.len());
    // Order of the values: the parent's without the force zero, the new effect's, the force zero.
    let place = |i: usize| if i + 1 == p { p - 1 + k } else { i };
    let own: Vec<usize> = (p - 1..p - 1 + k).collect();
    let mut scale = structure.scale(&descent.values);
    for i in 0..p {
        scale[place(i)] = tangent.scale[i];
    }
    let (mut idle, mut last) = (0, None);
    for _ in 0..settings.steps {
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
        idle = if fell < CONVERGED.max(IDLE_FALL * descent.cost) {
            idle + 1
        } else {
            0
        };
        if fell == 0.0 || idle == 2 {
            break;
        }
    }
    if let Some((normal, columns)) = last {
        for kink in candidate.effect.kinks {
            let moves = (span.width(kink.axis), settings.first_move);
            descent.search_kink(p - 1 + kink.position, moves, &normal, &scale, &|residuals| {
                whole_gradient(tangent, &columns, residuals)
            });
        }
    }
    descent
}

/// Gradient in the order of the values: the parent's without the force zero, the new effect's, the force zero.
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

/// Fits a structure until no step gains, and returns the node with its tangent.
pub(in crate::diagnose) fn converge(
    structure: &ModelStructure<'_>,
    values: Vec<f64>,
) -> Option<(Node, Tangent)> {
    let mut descent = NodeDescent::new(structure, values)?;
    for round in 0.. {
        let tangent = Tangent::at(structure, &descent.values, descent.residuals.clone())?;
        if round == ROUNDS {
            return Some((descent.node()?, tangent));
        }
        let before = descent.cost;
        descent.damping = descent.damping.min(DAMPING);
        let mut slopes = SecantSlopes::new(&tangent);
        let settled = (0..CHORD_STEPS)
            .any(|_| descent.step_and_learn(&mut slopes, &tangent.scale) < descent.idle_fall());
        if settled && before - descent.cost < LAST_ROUND * descent.idle_fall() {
            return Some((descent.node()?, tangent));
        }
    }
    None
}

/// Jacobian that is corrected after each trial by the residuals there (C. G. Broyden, 1965). A trial costs one run of the model, a new
/// Jacobian one run for each parameter.
struct SecantSlopes {
    jacobian: DMatrix<f64>,
    normal: DMatrix<f64>,
}

impl SecantSlopes {
    fn new(tangent: &Tangent) -> Self {
        SecantSlopes {
            jacobian: tangent.jacobian.clone(),
            normal: tangent.normal.clone(),
        }
    }

    /// Corrects the Jacobian so that it predicts the change of the residuals from `from` to `trial`.
    fn learn(&mut self, from: &NodeDescent<'_, '_>, trial: &TriedStep, scale: &[f64]) {
        let step = DVector::from_fn(scale.len(), |i, _| (trial.values[i] - from.values[i]) / scale[i]);
        let length = step.norm_squared();
        if length == 0.0 {
            return;
        }
        let mut missed = &trial.residuals - &from.residuals;
        missed.gemv(-1.0, &self.jacobian, &step, 1.0);
        missed /= length;
        let along = self.jacobian.tr_mul(&missed);
        self.normal.ger(1.0, &along, &step, 1.0);
        self.normal.ger(1.0, &step, &along, 1.0);
        self.normal.ger(missed.norm_squared(), &step, &step, 1.0);
        self.jacobian.ger(1.0, &missed, &step, 1.0);
    }
}

/// A few steps on the model itself, with the slopes of its surrogate.
pub(in crate::diagnose) fn refine(
    exact: &ModelStructure<'_>,
    tangent: &Tangent,
    values: Vec<f64>,
) -> Option<Node> {
    let mut descent = NodeDescent::new(exact, values)?;
    for _ in 0..STEPS {
        let gradient = tangent.jacobian.tr_mul(&descent.residuals);
        let fell = descent.step(&tangent.normal, &gradient, &tangent.scale);
        if fell < (5.0 * CONVERGED).max(1e-3 * descent.cost) {
            break;
        }
    }
    descent.node()
}
