//! Groups: effects that the recordings cannot tell apart because their axes go together. With one sine at one frequency the speed
//! follows from place and branch, so nothing contradicts one law that takes the place of another.

use nalgebra::DVector;

use super::alternatives::{JudgedEffect, RivalSet, at_implausible_bound};
use crate::diagnose::fitting::{FitContext, Key};
use crate::diagnose::search::{SearchResult, binned, go_together, kinks_are_recorded, recorded_points};
use crate::effect::Axis;

/// Cosine between what two sets explain from which they look alike; the forms of laws are seldom exact to better than a quarter.
const ALIKE: f64 = 0.95;
/// Share of a difference that follows from the displacement alone, from which the loop's shape decides in any recording: most of it. The
/// friction changes with the load, so even two stiffnesses differ between the branches too.
const BY_PLACE: f64 = 0.5;
/// Bins of that displacement: finer than the width of a knee.
const PLACES: usize = 48;
/// A loop is two curves of the displacement, its middle and its width: of more effects no two are told apart by it.
const LOOP_CURVES: usize = 2;
/// Largest number of other codes in a group.
const MOST: usize = 3;

/// Adds to each effect what it cannot be told apart from, where speed and place go together in the recordings.
pub(super) fn group(context: &FitContext<'_>, search: &SearchResult, judged: &mut [JudgedEffect]) {
    let points = recorded_points(context.data);
    if !go_together(&points, [Axis::VelocityMmS, Axis::DisplacementMm]) {
        return;
    }
    let pairs = alike_within(context, search, judged);
    for (k, effect) in judged.iter_mut().enumerate() {
        let mut others = alike_sets(context, search, effect);
        others.extend(pairs.iter().filter(|p| p[0] == k).map(|p| AlikeSet {
            codes: vec![codes(context, search, search.chosen)[p[1]]],
            node: None,
            share: 1.0,
            strained: false,
        }));
        share_confidence(effect, others);
    }
}

/// A set that looks like the chosen one and lacks an effect of it.
struct AlikeSet {
    /// Codes that stand for the effect there.
    codes: Key,
    /// Index of the set; `None` where the codes are in the chosen set too.
    node: Option<usize>,
    /// How far the confidence is shared with it: 1 where it explains the same.
    share: f64,
    /// True if a parameter of the set is at a bound outside its plausible range.
    strained: bool,
}

/// Enters the group of an effect and divides its confidence.
fn share_confidence(effect: &mut JudgedEffect, others: Vec<AlikeSet>) {
    let mut doubt = 0.0;
    for other in others {
        // A set that needs a code of the group too is no further explanation.
        let known = other.codes.iter().any(|c| effect.group.contains(c));
        if known || effect.group.len() + other.codes.len() > MOST {
            continue;
        }
        doubt += other.share;
        effect.group.extend(&other.codes);
        for code in other.codes {
            if let (Some(node), true) = (other.node, effect.rivals.iter().all(|r| r.code != code)) {
                effect.rivals.push(RivalSet {
                    code,
                    node,
                    // The recordings count for nothing here: the next test must separate the two by itself.
                    lack: 0.0,
                    strained: other.strained,
                });
            }
        }
    }
    // Rivals that were found before belong to the group as well, and have their share in the confidence already.
    for rival in &effect.rivals {
        if !effect.group.contains(&rival.code) && effect.group.len() < MOST {
            effect.group.push(rival.code);
        }
    }
    effect.confidence = effect.confidence.min(1.0 / (1.0 + doubt));
}

/// Codes of the missing effects of a set, in the order in which they are attached.
fn codes(context: &FitContext<'_>, search: &SearchResult, set: usize) -> Key {
    let attached = &search.nodes[set].attached[context.setup.extras.len()..];
    attached.iter().map(|a| a.effect.code).collect()
}

/// Sets of no more effects that lack an effect and explain nearly the same: those with the fewest other codes first, the best first.
fn alike_sets(context: &FitContext<'_>, search: &SearchResult, effect: &JudgedEffect) -> Vec<AlikeSet> {
    let own = codes(context, search, search.chosen);
    let code = own[effect.place - context.setup.extras.len()];
    let cost = |set: usize| search.nodes[set].cost();
    // The sine of the angle between two explanations is what one does not explain of the other.
    let most_lack = (1.0 - ALIKE * ALIKE) * (cost(0) - cost(search.chosen));
    let lack = |set: usize| cost(set) - cost(search.chosen);
    // Where the other effects explain nearly all by themselves, a further one beside them says nothing.
    let suffices = lack(effect.without) < most_lack;
    let rest: Key = own.iter().copied().filter(|c| *c != code).collect();
    let mut sets: Vec<usize> = (1..search.nodes.len())
        .filter(|&set| {
            let of_set = codes(context, search, set);
            let beside = rest.iter().all(|c| of_set.contains(c)) && of_set.len() > rest.len();
            !of_set.contains(&code)
                && of_set.len() <= own.len()
                && !(suffices && beside)
                && lack(set) < most_lack
                && kinks_are_recorded(context, &search.nodes[set])
                && !told_by_place(context, search, set)
        })
        .collect();
    let alike = |set: usize| {
        let of_set = codes(context, search, set);
        let new: Key = of_set.iter().copied().filter(|c| !own.contains(c)).collect();
        AlikeSet {
            node: (!new.is_empty()).then_some(set),
            codes: if new.is_empty() { of_set } else { new },
            share: (-lack(set).max(0.0) / most_lack).exp(),
            strained: at_implausible_bound(&search.nodes[set]),
        }
    };
    sets.sort_by(|&a, &b| cost(a).total_cmp(&cost(b)));
    let mut alike: Vec<AlikeSet> = sets.into_iter().map(alike).collect();
    alike.sort_by_key(|set| set.codes.len());
    alike
}

/// True if what separates a set from the chosen one follows from the displacement alone: that is recorded, whatever the speed.
fn told_by_place(context: &FitContext<'_>, search: &SearchResult, set: usize) -> bool {
    let data = context.data;
    let Some(places) = binned(data, Axis::DisplacementMm, PLACES) else {
        return false;
    };
    let (one, other) = (&search.nodes[search.chosen], &search.nodes[set]);
    let (mut sums, mut whole) = ([[0.0; 2]; PLACES], 0.0);
    for (i, bin) in places.bin.iter().enumerate() {
        if let Some(bin) = bin {
            let difference = other.residuals[i] - one.residuals[i];
            sums[*bin][0] += data.weight[i] * difference;
            sums[*bin][1] += data.weight[i] * data.weight[i];
            whole += difference * difference;
        }
    }
    let filled = sums.iter().filter(|s| s[1] > 0.0);
    filled.map(|[sum, power]| sum * sum / power).sum::<f64>() > BY_PLACE * whole
}

/// Pairs of judged effects whose parts of the force look alike beside the baseline, or cancel, or that are more than one loop tells: each
/// stands for the other, or both for something else. Each pair in both orders; indices of effects after those of the baseline.
fn alike_within(context: &FitContext<'_>, search: &SearchResult, judged: &[JudgedEffect]) -> Vec<[usize; 2]> {
    let chosen = &search.nodes[search.chosen];
    let structure = context.structure(chosen.attached.clone());
    let (Some((_, tangent)), Some(with), true) = (
        context.converged(&search.nodes[0]),
        structure.fitted(&chosen.values),
        judged.len() > 1,
    ) else {
        return Vec::new();
    };
    let part = |j: &JudgedEffect| -> Option<DVector<f64>> {
        let neutral = chosen.attached[j.place].effect.neutral;
        let from = context.offset(&chosen.attached, j.place);
        let mut values = chosen.values.clone();
        values.splice(from..from + neutral.len(), neutral.iter().copied());
        Some(tangent.project(&(structure.fitted(&values)? - &with)))
    };
    let parts: Vec<Option<DVector<f64>>> = judged.iter().map(part).collect();
    let alike = |a: usize, b: usize| {
        let (Some(one), Some(other)) = (&parts[a], &parts[b]) else {
            return false;
        };
        let alike = one.dot(other) > ALIKE * one.norm() * other.norm();
        // Two forces of which each takes away more of the other than both explain together.
        let cancel = (one + other).norm() < one.norm().min(other.norm());
        a != b && (alike || cancel || judged.len() > LOOP_CURVES)
    };
    let every = (0..judged.len()).flat_map(|a| (0..judged.len()).map(move |b| [a, b]));
    every.filter(|&[a, b]| alike(a, b)).collect()
}
