//! Chooses one of the fitted sets: the largest penalised gain, then backward elimination of effects that bring too little.

use super::knees::kinks_are_recorded;
use super::lack_of_fit::rest;
use crate::diagnose::conditioning::median;
use crate::diagnose::course::Split;
use crate::diagnose::fitting::{
    Attached, Data, FitContext, Key, LikelihoodScale, Node, PARAMETER_PENALTY, PENALTY,
};
use crate::diagnose::note::NoteKind;

/// Share of the whole gain that an effect must bring.
pub(super) const LEAST_SHARE: f64 = 5e-4;
/// Mean square that an effect must take away, in units of the noise: an RMS of 7 % of the noise is no finding.
const LEAST_POWER: f64 = 0.005;
/// The same for a slow model: the error of its coarse steps repeats in every cycle and does not average out.
const LEAST_POWER_SLOW: f64 = 0.2;
/// RMS force that an effect must take away, as a share of the range: one seventh of `data::LINEARITY`.
const LEAST_FORCE_SHARE: f64 = 3e-5;
/// RMS change of the force, as a share of the range, below which an effect changes nothing: a hundredth of the above.
const ZERO_FORCE_SHARE: f64 = 3e-7;
/// Share of the required gain that must also show on selecting cycles alone.
const LEAST_HELD_OUT: f64 = 0.25;
/// A displacement that an effect takes must be this many standard deviations of the LVDT noise: a turning point is known to about
/// one, and lost motion is the difference of two.
const LEAST_NOISES: f64 = 2.0;
/// The same for the displacement that a delay takes at the highest speed: filters that differ a little delay one channel, too.
const LEAST_DELAY_NOISES: f64 = 8.0;
/// Share of the force that a vibration of the displacement makes, which an effect must take away: so much of it may stay when it is
/// taken out.
const LEAST_VIBRATION: f64 = 0.25;
/// Error of the baseline on cycles that were not fitted, in units of the noise, below which there is nothing to find. Clean runs of
/// the mock rig have 0.04 to 0.5, effects of strength 1 in sealed cases 0.8 and more.
const WITHIN_NOISE: f64 = 0.5;

/// True if the baseline predicts the cycles that were not fitted to well within the noise. Quantisation, filters and the servo of a
/// clean run repeat, so a fit finds them significant; they are no physics.
fn predicts_within_noise(data: &Data, baseline: &Node) -> bool {
    let not_fitted = [Split::Select, Split::Report];
    let counted: usize = not_fitted.iter().map(|&split| data.count(split)).sum();
    let squares: f64 = not_fitted
        .iter()
        .map(|&split| data.sum(&baseline.residuals, split))
        .sum();
    counted > 0 && squares < WITHIN_NOISE.powi(2) * counted as f64
}

/// Index of the chosen set. Sets that are needed for the comparison and not fitted yet are added to `nodes`.
pub(super) fn choose(context: &FitContext<'_>, nodes: &mut Vec<Node>, likelihood: LikelihoodScale) -> usize {
    if predicts_within_noise(context.data, &nodes[0]) {
        return 0;
    }
    let extras = context.setup.extras.len();
    // A set that drives a parameter of the baseline to an implausible bound is penalised like one with one more effect.
    let of_baseline = implausible_bounds(context, &nodes[0]);
    let strained = |node: &Node| implausible_bounds(context, node).saturating_sub(of_baseline);
    let penalty = |node: &Node| penalty(&node.attached[extras..]) + PENALTY * strained(node) as f64;
    // Sets with an effect that is too small to be real.
    let mut barred: Vec<usize> = Vec::new();
    loop {
        let best = lowest(nodes, |k, n| {
            if !barred.contains(&k) && kinks_are_recorded(context, n) {
                likelihood.gain(n.cost()) + penalty(n)
            } else {
                f64::INFINITY
            }
        });
        let mut chosen = best;
        loop {
            match eliminate(context, nodes, likelihood, chosen) {
                Elimination::Done => return chosen,
                Elimination::Smaller(smaller) => chosen = smaller,
                Elimination::Negligible => break,
            }
        }
        // The best set too: without an effect that it does not need it is the set with the negligible one.
        barred.extend([best, chosen]);
    }
}

/// What backward elimination finds in a set.
enum Elimination {
    /// Every gain is sufficient.
    Done,
    /// Index of the set without the effect whose gain is farthest below the required gain.
    Smaller(usize),
    /// Such an effect is too small to be real, and yet the set is better with it: it imitates another one, so the other sets are
    /// compared again without this one.
    Negligible,
}

/// Log-likelihood that effects must bring for their number and their parameters.
pub(in crate::diagnose) fn penalty(effects: &[Attached]) -> f64 {
    let of = |a: &Attached| {
        let free = a.parameters.iter().filter(|p| p.is_free()).count();
        PENALTY + PARAMETER_PENALTY * free.saturating_sub(1) as f64
    };
    effects.iter().map(of).sum()
}

/// Looks for the effect whose gain is farthest below the required gain.
fn eliminate(
    context: &FitContext<'_>,
    nodes: &mut Vec<Node>,
    likelihood: LikelihoodScale,
    chosen: usize,
) -> Elimination {
    let total = likelihood.gain(nodes[0].cost() - nodes[chosen].cost());
    // An effect that takes less than the set leaves is the error of another effect's form.
    let rest = likelihood.gain(rest(context.data, &nodes[chosen].residuals));
    let mut removed: Option<(f64, usize, bool)> = None;
    for place in context.setup.extras.len()..nodes[chosen].attached.len() {
        let smaller = best_without(context, nodes, chosen, place);
        let loss = likelihood.gain(nodes[smaller].cost() - nodes[chosen].cost());
        let own = penalty(&nodes[chosen].attached[place..=place]);
        let needed = required_gain(context, likelihood, total).max(rest).max(own);
        let held_out = likelihood.gain(nodes[smaller].select - nodes[chosen].select);
        let negligible = is_negligible(context, &nodes[smaller], &nodes[chosen], place);
        let excess = if negligible {
            loss.min(needed) - needed - PENALTY
        } else {
            loss - needed
        };
        if (excess < 0.0 || held_out < LEAST_HELD_OUT * needed.min(PENALTY))
            && removed.is_none_or(|(least, ..)| excess < least)
        {
            removed = Some((excess, smaller, negligible && loss > needed));
        }
    }
    match removed {
        None => Elimination::Done,
        Some((.., true)) => Elimination::Negligible,
        Some((_, smaller, _)) => Elimination::Smaller(smaller),
    }
}

/// The best smaller set without the effect at `place`. Two effects that cancel each other both look necessary, so other sets
/// without this effect count too.
fn best_without(context: &FitContext<'_>, nodes: &mut Vec<Node>, chosen: usize, place: usize) -> usize {
    let extras = context.setup.extras.len();
    let code = nodes[chosen].attached[place].effect.code;
    let mut best = without(context, nodes, chosen, place);
    for (k, node) in nodes.iter().enumerate() {
        let lacks = node.attached[extras..].iter().all(|a| a.effect.code != code);
        let smaller = node.attached.len() < nodes[chosen].attached.len();
        if lacks && smaller && node.cost() < nodes[best].cost() {
            best = k;
        }
    }
    best
}

/// Gain in log-likelihood that an effect must bring over the set without it; `total` is the gain of all effects.
fn required_gain(context: &FitContext<'_>, likelihood: LikelihoodScale, total: f64) -> f64 {
    let counted = context.data.counted() as f64;
    let power = if context.setup.surrogate.is_some() {
        LEAST_POWER_SLOW
    } else {
        LEAST_POWER
    };
    let of_noise = likelihood.gain(power * likelihood.variance * counted);
    PENALTY.max(LEAST_SHARE * total).max(of_noise)
}

/// True for an effect that is too small to be real, however often it repeats.
fn is_negligible(context: &FitContext<'_>, without: &Node, with: &Node, place: usize) -> bool {
    explained_force_n(context.data, without, with) < least_force_n(context)
        || below_displacement_noise(context, with, place)
        || delays_less_than_noise(context, with, place)
        || is_zero(context, with, place)
}

/// RMS force in N that an effect must take away.
fn least_force_n(context: &FitContext<'_>) -> f64 {
    let data = context.data;
    let notes = data.tracks.iter().flat_map(|t| &t.notes);
    let vibration_mm = notes
        .filter(|note| note.kind == NoteKind::Hum && note.size.unit == "mm")
        .map(|note| note.size.value)
        .fold(0.0, f64::max);
    let rate_n_per_mm = data.force_range_n / context.span.travel_mm();
    (LEAST_FORCE_SHARE * data.force_range_n).max(LEAST_VIBRATION * vibration_mm * rate_n_per_mm)
}

/// RMS force in N by which one node improves on another; points count by their weight.
fn explained_force_n(data: &Data, without: &Node, with: &Node) -> f64 {
    let (mut sum, mut weights) = (0.0, 0.0);
    for (i, &weight) in data.weight.iter().enumerate() {
        if data.split[i] != Split::Report {
            sum += without.residuals[i].powi(2) - with.residuals[i].powi(2);
            weights += weight * weight;
        }
    }
    (sum.max(0.0) / f64::max(weights, f64::MIN_POSITIVE)).sqrt()
}

/// True for an effect that moves the displacement by less than the LVDT resolves. Its mean over many reversals may be significant,
/// but the errors of the reversals are too.
fn below_displacement_noise(context: &FitContext<'_>, node: &Node, place: usize) -> bool {
    has_size_below(
        context,
        node,
        place,
        "mm",
        LEAST_NOISES * displacement_noise_mm(context),
    )
}

/// The same for a delay: at the highest speed it moves the displacement by less than the LVDT resolves.
fn delays_less_than_noise(context: &FitContext<'_>, node: &Node, place: usize) -> bool {
    let least_mm = LEAST_DELAY_NOISES * displacement_noise_mm(context);
    let least_ms = 1e3 * least_mm / context.span.speed_mm_s.max(f64::MIN_POSITIVE);
    has_size_below(context, node, place, "ms", least_ms)
}

fn displacement_noise_mm(context: &FitContext<'_>) -> f64 {
    let tracks = context.data.tracks.iter();
    let shaken_mm = tracks.clone().map(|t| t.vibration_mm).fold(0.0, f64::max);
    median(tracks.map(|t| t.noise_mm).collect()).max(shaken_mm)
}

/// True if a parameter in this unit, which is zero without the effect, is smaller than `least`.
fn has_size_below(context: &FitContext<'_>, node: &Node, place: usize, unit: &str, least: f64) -> bool {
    let attached = &node.attached[place];
    let sizes = attached.parameters.iter().zip(attached.effect.neutral);
    sizes
        .zip(context.effect_values(node, place))
        .filter(|((p, neutral), _)| p.unit == unit && **neutral == 0.0)
        .any(|(_, value)| value.abs() < least)
}

/// True for an effect that changes no force at its values, such as a limit above every force. What its node gained is then due to
/// the other parameters.
fn is_zero(context: &FitContext<'_>, node: &Node, place: usize) -> bool {
    let from = context.offset(&node.attached, place);
    let neutral = node.attached[place].effect.neutral;
    let mut values = node.values.clone();
    values.splice(from..from + neutral.len(), neutral.iter().copied());
    let Some(without) = Node::new(&context.structure(node.attached.clone()), values) else {
        return false;
    };
    changed_force_n(context.data, &without, node) < ZERO_FORCE_SHARE * context.data.force_range_n
}

/// RMS change of the force in N from one node to another; points count by their weight.
fn changed_force_n(data: &Data, from: &Node, to: &Node) -> f64 {
    let weights: f64 = data.weight.iter().map(|weight| weight * weight).sum();
    let pairs = from.residuals.iter().zip(&to.residuals);
    let sum: f64 = pairs.map(|(a, b)| (a - b).powi(2)).sum();
    (sum / weights.max(f64::MIN_POSITIVE)).sqrt()
}

/// Number of the baseline's parameters that are at a bound outside their plausible range.
fn implausible_bounds(context: &FitContext<'_>, node: &Node) -> usize {
    let own = context.setup.model.parameters.iter().zip(&node.values);
    own.filter(|(p, v)| p.strained_by(**v)).count()
}

/// Index of the set without one effect of another set. It is fitted if it is not in `nodes`, and again if the effect is zero.
pub(in crate::diagnose) fn without(
    context: &FitContext<'_>,
    nodes: &mut Vec<Node>,
    of: usize,
    place: usize,
) -> usize {
    let extras = context.setup.extras.len();
    let (attached, values) = left_as_it_is(context, &nodes[of], place);
    let mut key: Key = attached[extras..].iter().map(|a| a.effect.code).collect();
    key.sort_unstable();
    let known = (0..nodes.len())
        .filter(|&i| nodes[i].key(extras) == key)
        .min_by(|&a, &b| nodes[a].fit.total_cmp(&nodes[b].fit));
    if let Some(known) = known
        && !is_zero(context, &nodes[of], place)
    {
        return known;
    }
    let fitted = context.converge(attached, values).map(|(node, _)| node);
    match (fitted, known) {
        (Some(node), Some(known)) => {
            if node.cost() < nodes[known].cost() {
                nodes[known] = node;
            }
            known
        }
        (Some(node), None) => {
            nodes.push(node);
            nodes.len() - 1
        }
        (None, known) => known.unwrap_or(0),
    }
}

/// The effects and values of a set without the effect at `place`; the other values stay as they are.
pub(in crate::diagnose) fn left_as_it_is(
    context: &FitContext<'_>,
    node: &Node,
    place: usize,
) -> (Vec<Attached>, Vec<f64>) {
    let (mut attached, mut values) = (node.attached.clone(), node.values.clone());
    let from = context.offset(&attached, place);
    values.drain(from..from + attached[place].parameters.len());
    attached.remove(place);
    (attached, values)
}

/// Index of the node of lowest cost.
pub(super) fn lowest(nodes: &[Node], cost: impl Fn(usize, &Node) -> f64) -> usize {
    (0..nodes.len())
        .min_by(|&a, &b| cost(a, &nodes[a]).total_cmp(&cost(b, &nodes[b])))
        .expect("the baseline is the first node")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two recordings with a noise of 1 N and of 10 N. An error of 2 N leaves the first; the second changes by chance.
    #[test]
    fn a_noisy_recording_does_not_hide_what_a_good_one_shows() {
        let data = Data {
            tracks: Vec::new(),
            force_n: vec![0.0; 200],
            weight: [[1.0; 100], [0.1; 100]].concat(),
            split: vec![Split::Fit; 200],
            lengths: vec![100, 100],
            zero_sigma_n: 1.0,
            force_range_n: 1000.0,
            discrepancy: None,
        };
        let node = |good: f64, noisy: f64| Node {
            attached: Vec::new(),
            values: Vec::new(),
            residuals: [[good; 100], [noisy; 100]].concat(),
            fit: 0.0,
            select: 0.0,
        };
        // The first falls from 2 N to 0, the second rises from 10 to 10.4 N: without weights the error would have risen.
        let taken = explained_force_n(&data, &node(2.0, 1.0), &node(0.0, 1.04));
        assert!(
            (taken - f64::sqrt((4.0 - 0.0816) / 1.01)).abs() < 1e-12,
            "{taken}"
        );
    }
}
