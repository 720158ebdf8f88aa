//! Which of the fitted sets is believed: the largest gain less its price, then whatever can be spared leaves it.

use super::condition::Split;
use super::fit::settle;
use super::problem::Data;
use super::select::{FitContext, Key, Node, PRICE, SHARE, Worth, least};

/// Share of what is left above the noise without it that an effect must bring: less is the misfit of another's form.
const LEFTOVER: f64 = 0.2;
/// Mean square that an effect must take away, in units of the noise: a seventh of the noise in RMS is no finding.
const MATERIAL: f64 = 0.005;
/// The same for a model with steps of its own: what those leave out repeats in every cycle and averages out in none.
const MATERIAL_SLOW: f64 = 0.2;
/// Force that an effect must take away, RMS, as a share of the range: a seventh of what no load cell is straighter than.
const SLIGHT: f64 = 3e-5;

/// What one node takes off another's residuals, N root mean square; a point counts by how well its force is known.
fn taken_n(data: &Data, without: &Node, with: &Node) -> f64 {
    let (mut sum, mut weights) = (0.0, 0.0);
    for (i, &weight) in data.weight.iter().enumerate() {
        if data.part[i] != Split::Report {
            sum += without.residuals[i].powi(2) - with.residuals[i].powi(2);
            weights += weight * weight;
        }
    }
    (sum.max(0.0) / f64::max(weights, f64::MIN_POSITIVE)).sqrt()
}

/// Is the motion that an effect takes finer than the displacement's noise? Its mean over many reversals may stand out, but so do
/// the errors of where they were.
fn within_noise(bench: &FitContext<'_>, node: &Node, place: usize) -> bool {
    let from = super::tables::offset(bench, &node.attached, place);
    let attached = &node.attached[place];
    let noise_mm = super::smoothing::median(bench.data.tracks.iter().map(|t| t.noise_mm).collect());
    let sizes = attached
        .parameters
        .iter()
        .zip(attached.effect.neutral)
        .enumerate();
    sizes
        .filter(|(_, (p, neutral))| p.unit == "mm" && **neutral == 0.0)
        .any(|(i, _)| node.values[from + i].abs() < noise_mm)
}

/// Parameters of the baseline that are held by a bound beyond what anybody believes.
fn held(bench: &FitContext<'_>, node: &Node) -> usize {
    let own = bench.setup.model.parameters.iter().zip(&node.values);
    own.filter(|(p, v)| p.strained_by(**v)).count()
}

/// Does an effect of a node stand at zero? Then it is none, and what its node gained is where the others went.
fn idle(bench: &FitContext<'_>, node: &Node, place: usize) -> bool {
    let from = super::tables::offset(bench, &node.attached, place);
    let attached = &node.attached[place];
    let amplitudes = attached.effect.amplitudes;
    !amplitudes.is_empty()
        && amplitudes.iter().all(|&i| {
            let [low, high] = attached.parameters[i].bounds;
            node.values[from + i].abs() < 1e-9 * (high - low)
        })
}

/// The set with the largest gain less its price, then whatever can be spared leaves it.
pub(super) fn choose(bench: &FitContext<'_>, nodes: &mut Vec<Node>, worth: Worth) -> usize {
    let extras = bench.setup.extras.len();
    // A set with which the baseline goes to a bound that nobody believes in pays as for one effect more.
    let strained = |node: &Node| held(bench, node).saturating_sub(held(bench, &nodes[0]));
    let price = |node: &Node| PRICE * (node.attached.len() - extras + strained(node)) as f64;
    let counted = (bench.data.count(Split::Fit) + bench.data.count(Split::Select)) as f64;
    let mut chosen = least(nodes, |n| worth.gain(n.cost()) + price(n));
    loop {
        let total = worth.gain(nodes[0].cost() - nodes[chosen].cost());
        let mut spared: Option<(f64, usize)> = None;
        for leave in extras..nodes[chosen].attached.len() {
            let code = nodes[chosen].attached[leave].effect.code;
            let mut i = without(bench, nodes, chosen, leave);
            // Two effects that cancel each other each look needed: a smaller set without this one may do as well.
            for (k, node) in nodes.iter().enumerate() {
                let lacks = node.attached[extras..].iter().all(|a| a.effect.code != code);
                let smaller = node.attached.len() < nodes[chosen].attached.len();
                if lacks && smaller && node.cost() < nodes[i].cost() {
                    i = k;
                }
            }
            let loss = worth.gain(nodes[i].cost() - nodes[chosen].cost());
            let slightest = if bench.setup.surrogate.is_some() {
                MATERIAL_SLOW
            } else {
                MATERIAL
            };
            let material = worth.gain(slightest * worth.spread * counted);
            let leftover = worth.gain(LEFTOVER * (nodes[i].cost() - counted).max(0.0));
            let needed = PRICE.max(SHARE * total).max(material).max(leftover);
            let held_out = worth.gain(nodes[i].select - nodes[chosen].select);
            let slight = taken_n(bench.data, &nodes[i], &nodes[chosen]) < SLIGHT * bench.data.force_range_n
                || within_noise(bench, &nodes[chosen], leave)
                || idle(bench, &nodes[chosen], leave);
            let excess = if slight {
                loss.min(needed) - needed - PRICE
            } else {
                loss - needed
            };
            if (excess < 0.0 || held_out < 0.25 * needed.min(PRICE))
                && spared.is_none_or(|(least, _)| excess < least)
            {
                spared = Some((excess, i));
            }
        }
        match spared {
            Some((_, i)) => chosen = i,
            None => return chosen,
        }
    }
}

/// Index of the node that lacks one effect of another; fitted if it is not there yet, or if the effect did nothing.
pub(super) fn without(bench: &FitContext<'_>, nodes: &mut Vec<Node>, of: usize, leave: usize) -> usize {
    let extras = bench.setup.extras.len();
    let mut attached = nodes[of].attached.clone();
    let from = super::tables::offset(bench, &attached, leave);
    let mut values = nodes[of].values.clone();
    values.drain(from..from + attached[leave].parameters.len());
    attached.remove(leave);
    let mut key: Key = attached[extras..].iter().map(|a| a.effect.code).collect();
    key.sort_unstable();
    let known = (0..nodes.len())
        .filter(|&i| nodes[i].key(extras) == key)
        .min_by(|&a, &b| nodes[a].fit.total_cmp(&nodes[b].fit));
    if let Some(known) = known
        && !idle(bench, &nodes[of], leave)
    {
        return known;
    }
    let fitted = settle(&bench.structure(attached), values).map(|(node, _)| node);
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Two recordings, forces known to 1 and to 10 N: 2 N gone from the good one, what the other has left is chance.
    #[test]
    fn a_noisy_recording_does_not_hide_what_a_good_one_shows() {
        let data = Data {
            tracks: Vec::new(),
            force_n: vec![0.0; 200],
            weight: [[1.0; 100], [0.1; 100]].concat(),
            part: vec![Split::Fit; 200],
            lengths: vec![100, 100],
            zero_sigma_n: 1.0,
            force_range_n: 1000.0,
        };
        let node = |good: f64, noisy: f64| Node {
            attached: Vec::new(),
            values: Vec::new(),
            residuals: [[good; 100], [noisy; 100]].concat(),
            fit: 0.0,
            select: 0.0,
        };
        // Off by 2 N, then by nothing; the other by 10 N, then 10.4 N: counted in N alone more came than was taken.
        let taken = taken_n(&data, &node(2.0, 1.0), &node(0.0, 1.04));
        assert!(
            (taken - f64::sqrt((4.0 - 0.0816) / 1.01)).abs() < 1e-12,
            "{taken}"
        );
    }
}
