//! Alternatives: the effects that could replace a finding, and the nearest ones where no effect explains the recordings.

use super::plausible::{is_plausible, is_plausible_set};
use super::tables::candidates;
use crate::diagnose::course::Split;
use crate::diagnose::diagnosis::Alternative;
use crate::diagnose::fitting::{Attached, FitContext, Key, Node, Tangent};
use crate::diagnose::search::{
    SearchResult, left_as_it_is, penalty, refit_rivals, rest, with_a_part_more, without,
};
use crate::effect::{Effect, GROWN_LAWS};

/// Two explanations are not distinguished if they differ by less than this in log-likelihood (a ratio of 400), or by less than this
/// share of what the effect brings.
const LEAST_LACK: f64 = 6.0;
const LACK_SHARE: f64 = 0.04;
/// A mean square above the best set's, in units of the noise, that distinguishes in any case.
pub(in crate::diagnose) const DISTINCT_POWER: f64 = 0.04;
/// Exponent of the doubt in the confidence. Calibrated on two blind runs of 400 cases (seeds 404 and 777): of the effects that
/// would have had a confidence of 71 % without it, 97 % were right; with it their confidence is 93 %. Not applied to a doubt above 1,
/// where it made a name that is right in a third of the cases nearly impossible.
const CONFIDENCE_EXPONENT: f64 = 3.0;
/// Highest confidence, before its odds are corrected, in an effect with a rival that is not distinguished: corrected, it is 85 %. Of 11 such
/// names above 90 % in cases that were looked at, 8 were right. It also limits a law that no search begins with: one was named with 97 %, a
/// joint of two rates, where an LVDT was bowed.
const MOST_BESIDE_RIVAL: f64 = 0.8;
/// Highest confidence, before its odds are corrected, in an effect that is not plausible but without which the recordings are explained much
/// worse: something there acts like it. Corrected, it is 51 %. In a case that was looked at, this was a contact beside a soft fixture. At half, such
/// a name is 39 % sure at most; at double, 65 %.
const MOST_IMPLAUSIBLE: f64 = 0.2;
/// A law that no search begins with is named if its log-likelihood, less the penalty of its parameters, is higher by this: a ratio of 20.
/// Of 12 joints and contacts that were higher by at least 3, in cases of three worlds that were looked at, 11 were the hidden effect, and one
/// was a bowed LVDT. Of five laws that were higher by 0.5 to 3, three were not the hidden one. At half, two of those five would be named, too;
/// at double, three of the 12 would not.
const BETTER_LAW: f64 = 3.0;
/// Scale of the lack over which the doubt falls by a factor e: a floor, and a share of what the effect brings, because the form of
/// an effect is never exact.
const DOUBT_FLOOR: f64 = 2.0;
const DOUBT_SHARE: f64 = 0.02;
/// Number of candidates that are fitted in place of an effect.
const RIVALS_TRIED: usize = 8;
/// Number of the closest rivals that are fitted to convergence. A version before had none: a hidden curve of the LVDT then lacked 146 in
/// log-likelihood to the geometry that was named and gained 202. Other numbers were not tried.
const RIVALS_CONVERGED: usize = 4;
/// A rival that lacks more than this share of what the effect explains is not fitted to convergence. Of 141 rivals in 21 cases of five worlds
/// that were looked at, 85 lacked more before, and none of them came below 60 %. At half, a joint that came from 33 % to a better fit than the
/// effect would not be found; at double, all are fitted.
const MOST_LACK_SHARE: f64 = 0.6;
/// Where nothing explains the recordings, the effects of all sets within this share of the best gain are listed as the nearest.
/// `MOST_NEAREST` limits their number.
const NEAREST_SHARE: f64 = 0.05;
const MOST_NEAREST: usize = 5;

/// An effect of the chosen set with its confidence and its rivals.
pub(in crate::diagnose) struct JudgedEffect {
    /// Index in the chosen set.
    pub place: usize,
    /// True if its force follows from the path of the displacement alone.
    pub follows_path: bool,
    /// Index of the set without it.
    pub without: usize,
    /// Gain in log-likelihood that it brings.
    pub loss: f64,
    /// 0 to 1.
    pub confidence: f64,
    /// Effects that could replace it, the best first.
    pub rivals: Vec<RivalSet>,
    /// Other codes that the recordings cannot tell from it (`groups`).
    pub group: Key,
}

/// A set with another effect in place of the finding.
pub(in crate::diagnose) struct RivalSet {
    pub code: &'static str,
    /// Index of the set.
    pub node: usize,
    /// Gain in log-likelihood that it lacks.
    pub lack: f64,
    /// True if a parameter of it is at a bound outside its plausible range.
    pub strained: bool,
}

/// Lack of gain from which a rival of an effect that brings `loss` is distinguished; `distinct` is [`DISTINCT_POWER`] over all
/// points, as a gain. A rival at an implausible bound gets no allowance for the inexact form of an effect.
pub(in crate::diagnose) fn distinguishable_lack(rival: &Node, loss: f64, distinct: f64) -> f64 {
    if at_implausible_bound(rival) {
        return LEAST_LACK;
    }
    LEAST_LACK.max((LACK_SHARE * loss).min(distinct))
}

/// The set to name instead of the chosen one, if the chosen one needs a parameter at a bound outside its plausible range to fit as well
/// as a rival that does not, or an effect that is not plausible in the place of one that is; `None` if the chosen one may stay.
pub(super) fn more_plausible(
    context: &FitContext<'_>,
    search: &SearchResult,
    judged: &[JudgedEffect],
) -> Option<usize> {
    let chosen = &search.nodes[search.chosen];
    let at_a_bound = at_implausible_bound(chosen);
    best_rival(judged, |j, r| {
        // In the place of what cannot be, every rival that is not distinguished is better, however free its law is.
        !is_plausible(context, chosen, j.place)
            || at_a_bound && r.lack < LEAST_LACK && may_be_named(context, &search.nodes[r.node])
    })
}

/// The set to name instead of the chosen one, if what fits better in the place of an effect is a law that no search begins with, or a further
/// part in the law of another effect.
pub(super) fn better_law(
    context: &FitContext<'_>,
    search: &SearchResult,
    judged: &[JudgedEffect],
) -> Option<usize> {
    let extras = context.setup.extras.len();
    best_rival(judged, |_, r| {
        let mut attached = search.nodes[r.node].attached.iter();
        let law = attached.rfind(|a| a.effect.code == r.code);
        let sets = [search.chosen, r.node].map(|set| &search.nodes[set].attached[extras..]);
        let is_larger = larger_law(sets) == Some(r.code);
        r.lack < -BETTER_LAW && (is_larger || law.is_some_and(|a| !begins_a_search(context, a.effect)))
    })
}

/// The set with the rival that fits best in the place of an effect, if it fits better than the effect.
pub(super) fn better_rival(judged: &[JudgedEffect], place: usize) -> Option<usize> {
    best_rival(judged, |j, r| j.place == place && r.lack < 0.0)
}

/// The set of the closest rival that `may_replace` accepts. A rival with a parameter at an implausible bound is left out.
fn best_rival(
    judged: &[JudgedEffect],
    may_replace: impl Fn(&JudgedEffect, &RivalSet) -> bool,
) -> Option<usize> {
    let rivals = judged.iter().flat_map(|j| j.rivals.iter().map(move |r| (j, r)));
    rivals
        .filter(|(j, r)| !r.strained && may_replace(j, r))
        .min_by(|a, b| a.1.lack.total_cmp(&b.1.lack))
        .map(|(_, r)| r.node)
}

/// True if a search may name every missing effect of a set: none of them is a law that is only tried as a rival.
fn may_be_named(context: &FitContext<'_>, node: &Node) -> bool {
    let mut missing = node.attached.iter().rev().take_while(|a| !a.own);
    missing.all(|a| begins_a_search(context, a.effect))
}

/// True if a law is one of the candidates or grew from one, not only tried in the place of one.
fn begins_a_search(context: &FitContext<'_>, law: &Effect) -> bool {
    let candidates = context.setup.candidates.iter();
    let mut laws = candidates.map(|c| c.effect).chain(GROWN_LAWS);
    laws.any(|known| std::ptr::eq(known, law))
}

/// True if a parameter of a missing effect is at a bound outside its plausible range.
pub(super) fn at_implausible_bound(node: &Node) -> bool {
    let missing = node.attached.iter().rev().take_while(|a| !a.own);
    let parameters = missing.flat_map(|a| a.parameters.iter().rev());
    let values = node.values.iter().rev().skip(1);
    parameters.zip(values).any(|(p, v)| p.strained_by(*v))
}

/// Compares one effect of the chosen set with the effects that could take its place.
pub(super) fn judge(context: &FitContext<'_>, search: &mut SearchResult, place: usize) -> JudgedEffect {
    let chosen = search.chosen;
    let without = without(context, &mut search.nodes, chosen, place);
    let base = search.nodes[without].key(context.setup.extras.len());
    let loss = search
        .likelihood
        .gain(search.nodes[without].cost() - search.nodes[chosen].cost());
    let effect = search.nodes[chosen].attached[place].effect;
    fit_rivals(context, search, (place, without), &base);
    let code = effect.code;
    converge_closest(context, search, &base, (code, loss));
    let (rivals, doubt) = compare(context, search, &base, code, loss);
    let most = if !is_plausible(context, &search.nodes[chosen], place) {
        MOST_IMPLAUSIBLE
    } else if rivals.is_empty() && begins_a_search(context, effect) {
        1.0
    } else {
        MOST_BESIDE_RIVAL
    };
    JudgedEffect {
        place,
        follows_path: effect.follows_path,
        without,
        loss,
        confidence: against_rivals(doubt).min(most),
        rivals,
        group: Key::new(),
    }
}

/// Confidence, 0 to 1, in an effect whose rivals together are `doubt` times as likely as the effect itself. A doubt above 1 counts in full:
/// of three effects that fit equally well, each is right in a third of the cases. One below 1 counts less (calibrated).
fn against_rivals(doubt: f64) -> f64 {
    1.0 / (1.0 + doubt.powf(CONFIDENCE_EXPONENT).min(doubt))
}

/// Fits sets with one more effect than the set `without`, whose codes are `base`, and adds them to the search: the candidates, and the
/// freer laws of what looks like the effect at `place` of the chosen set.
fn fit_rivals(
    context: &FitContext<'_>,
    search: &mut SearchResult,
    (place, without): (usize, usize),
    base: &Key,
) {
    let extras = context.setup.extras.len();
    let effect = search.nodes[search.chosen].attached[place].effect;
    // A fit that is worse than without the effect may have started from an older fit of that set: it is fitted again.
    let most = search.nodes[without].cost();
    let fitted = search.nodes.iter().filter(|n| n.cost() < most);
    let seen: Vec<_> = fitted.map(|n| n.key(extras)).collect();
    if let Some(parent) = context.converged(&search.nodes[without]) {
        for child in context.children(std::slice::from_ref(&parent), &seen, RIVALS_TRIED) {
            keep_better(context, search, child);
        }
        search.nodes.extend(with_more_parts(context, &parent, effect));
        let parents = [Some(parent), beside(context, search, place)];
        let rival_laws = context.setup.rival_laws.iter();
        let freer =
            rival_laws.filter(|law| effect.looks_like(law.effect) && !base.contains(&law.effect.code));
        for law in freer {
            let fits = parents.iter().flatten().filter_map(|p| context.child(p, law));
            let best = fits.min_by(|a, b| a.cost().total_cmp(&b.cost()));
            search.nodes.extend(best);
        }
        refit_rivals(context, search, base);
    }
}

/// Rivals of an effect that add no other effect: the set `without` it, with one part more and with two in the law of an effect that looks like
/// it. A leaf that touches low in the travel was named a contact that closes, where a further knee explains as much. Of 13 such contacts beside
/// a leaf in 320 packs, ten were not there.
fn with_more_parts(context: &FitContext<'_>, without: &(Node, Tangent), effect: &Effect) -> Vec<Node> {
    let attached = without.0.attached.iter().enumerate();
    let missing = attached.skip(context.setup.extras.len()).filter(|(_, a)| !a.own);
    let mut sets = Vec::new();
    for (place, _) in missing.filter(|(_, a)| a.effect.looks_like(effect)) {
        let mut larger = with_a_part_more(context, without, place);
        while let Some(set) = larger {
            larger = with_a_part_more(context, &set, place);
            sets.push(set.0);
        }
    }
    sets
}

/// The chosen set without the effect at `place`, with the values that the others have beside it. Fitted again, those values move to explain
/// what the effect did, and a similar law may not find its minimum from there: a joint that closes was no rival of a helper leaf that was
/// named with 93 %.
fn beside(context: &FitContext<'_>, search: &SearchResult, place: usize) -> Option<(Node, Tangent)> {
    let (attached, values) = left_as_it_is(context, &search.nodes[search.chosen], place);
    let structure = context.structure(attached);
    let tangent = Tangent::new(&structure, &values)?;
    Some((Node::new(&structure, values)?, tangent))
}

/// Adds a fit to the search, or puts it in the place of a worse fit of the same set.
fn keep_better(context: &FitContext<'_>, search: &mut SearchResult, fit: Node) {
    let extras = context.setup.extras.len();
    let key = fit.key(extras);
    let mut known = search.nodes.iter_mut();
    match known.find(|n| n.key(extras) == key && may_be_named(context, n)) {
        Some(known) if fit.cost() < known.cost() => *known = fit,
        Some(_) => {}
        None => search.nodes.push(fit),
    }
}

/// Fits the closest rivals to convergence, as the chosen set is. Before, they are fitted with the Jacobian of the set without them, and such
/// a fit stops early where the effect changes the parameters of the baseline. The rivals of a slow model are fitted by `refit_rivals`.
/// `loss` is the gain that the effect `code` brings.
fn converge_closest(
    context: &FitContext<'_>,
    search: &mut SearchResult,
    base: &Key,
    (code, loss): (&str, f64),
) {
    if context.setup.surrogate.is_some() {
        return;
    }
    let rivals = best_replacements(context, search, base, code);
    let closest = rivals.iter().take(RIVALS_CONVERGED);
    let closest: Vec<usize> = closest
        .filter(|r| r.lack < MOST_LACK_SHARE * loss)
        .map(|r| r.node)
        .collect();
    let fitted = context.parallel_map(&closest, |&i| context.converged(&search.nodes[i]));
    for (i, fitted) in closest.into_iter().zip(fitted) {
        if let Some((node, _)) = fitted.filter(|(node, _)| node.cost() < search.nodes[i].cost()) {
            search.nodes[i] = node;
        }
    }
}

/// Rivals that are not distinguished from the chosen set, the best first, and the doubt that all replacements cast on the effect
/// `code`. `base` has the codes of the set without it; `loss` is the gain that it brings.
fn compare(
    context: &FitContext<'_>,
    search: &SearchResult,
    base: &Key,
    code: &str,
    loss: f64,
) -> (Vec<RivalSet>, f64) {
    let likelihood = search.likelihood;
    let distinct = likelihood.gain(DISTINCT_POWER * likelihood.variance * context.data.counted() as f64);
    // The structure that the chosen set leaves is the error of its forms: rivals that lack less are not excluded by it.
    let left = rest(context.data, &search.nodes[search.chosen].residuals);
    let scale = DOUBT_FLOOR + (DOUBT_SHARE * loss).max(likelihood.gain(left));
    let mut rivals = best_replacements(context, search, base, code);
    let doubt = rivals.iter().map(|r| (-r.lack / scale).exp()).sum();
    rivals.retain(|r| r.lack < distinguishable_lack(&search.nodes[r.node], loss, distinct));
    (rivals, doubt)
}

/// The best set with each other effect in the place of the effect `code`, the best first.
fn best_replacements(
    context: &FitContext<'_>,
    search: &SearchResult,
    base: &Key,
    code: &str,
) -> Vec<RivalSet> {
    let extras = context.setup.extras.len();
    let chosen = &search.nodes[search.chosen];
    let replacement = |(i, node): (usize, &Node)| {
        let mut rest = node.key(extras);
        rest.retain(|code| !base.contains(code));
        let more = node.attached.len().checked_sub(base.len() + extras)?;
        let other = match (rest.as_slice(), more) {
            (&[other], 1) if other != code => other,
            ([], 0) => larger_law([chosen, node].map(|set| &set.attached[extras..]))?,
            _ => return None,
        };
        is_plausible_set(context, node).then(|| RivalSet {
            code: other,
            node: i,
            lack: search.likelihood.gain(node.cost() - chosen.cost()) + penalty(&node.attached[extras..])
                - penalty(&chosen.attached[extras..]),
            strained: at_implausible_bound(node),
        })
    };
    let mut sets: Vec<RivalSet> = search.nodes.iter().enumerate().filter_map(replacement).collect();
    sets.sort_by(|a, b| a.lack.total_cmp(&b.lack));
    let mut best: Vec<RivalSet> = Vec::new();
    for set in sets {
        if best.iter().all(|r| r.code != set.code) {
            best.push(set);
        }
    }
    best
}

/// Code of an effect whose law has more parts in the second set than in the first.
fn larger_law([before, after]: [&[Attached]; 2]) -> Option<&'static str> {
    let parts = |a: &Attached| a.effect.amplitudes.len();
    let grew = |a: &&Attached| {
        let known = before.iter().find(|b| b.effect.code == a.effect.code);
        known.is_some_and(|b| parts(a) > parts(b))
    };
    after.iter().find(grew).map(|a| a.effect.code)
}

/// A rival of a judged effect as the report has it: why the two are confounded, and the test that separates them.
pub(super) fn alternative(effect: &Effect, judged: &JudgedEffect, rival: &RivalSet) -> Alternative {
    let other = crate::effect::find(rival.code).ok();
    let known = effect
        .confusable_with
        .iter()
        .find(|r| r.code == rival.code)
        .or_else(|| other.and_then(|o| o.confusable_with.iter().find(|r| r.code == effect.code)));
    let reason = known.map_or("the recordings do not excite the difference", |r| r.why);
    Alternative {
        code: rival.code.to_owned(),
        instead_of: effect.code.to_owned(),
        why: format!("{reason}; {}", why_not_excluded(judged, rival)),
        test: known
            .map_or("a recording at another speed, mean load and amplitude", |r| {
                r.test
            })
            .to_owned(),
    }
}

/// Why the recordings do not exclude a rival, as the end of a sentence.
fn why_not_excluded(judged: &JudgedEffect, rival: &RivalSet) -> String {
    if judged.group.contains(&rival.code) {
        return "in these recordings the speed follows from the displacement, so nothing tells the two apart"
            .to_owned();
    }
    let but = match rival.strained {
        true => "but only with a parameter at the limit of its range",
        false => "but with a law that is free to follow nearly every curve",
    };
    match rival.lack < 0.0 {
        true => format!("it fits better, by {:.1} in log-likelihood, {but}", -rival.lack),
        false => format!(
            "its log-likelihood is lower by only {:.1}, where the effect itself gains {:.0}",
            rival.lack, judged.loss
        ),
    }
}

/// The effects of the best sets, where nothing in the library explains the recordings.
pub(super) fn nearest(context: &FitContext<'_>, search: &SearchResult) -> Vec<Alternative> {
    let rows = candidates(context, search);
    let best = rows.first().map_or(0.0, |r| r.gain);
    let mut codes: Vec<String> = Vec::new();
    for row in rows
        .iter()
        .filter(|r| r.gain > 0.0 && r.gain >= (1.0 - NEAREST_SHARE) * best)
    {
        for code in &row.codes {
            let candidate = context.setup.candidates.iter().any(|c| c.effect.code == code);
            if candidate && !codes.contains(code) && codes.len() < MOST_NEAREST {
                codes.push(code.clone());
            }
        }
    }
    let power = |n: &Node| n.select / context.data.count(Split::Select).max(1) as f64;
    let least = search.nodes.iter().map(power).fold(f64::INFINITY, f64::min);
    codes
        .into_iter()
        .map(|code| Alternative {
            code,
            instead_of: "unknown".to_owned(),
            why: in_a_best_set(least.sqrt()),
            test: "inspect the specimen at the place that is located".to_owned(),
        })
        .collect()
}

/// Why a code of the best sets is no finding; `left` is what the best of them leaves on held-out cycles, in noises.
fn in_a_best_set(left: f64) -> String {
    match left > 1.0 {
        true => format!(
            "it is in one of the best sets, but the best set still leaves {left:.1} times the noise on held-out cycles"
        ),
        false => "it is in one of the best sets, but no set explains all that was recorded".to_owned(),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// An effect of the path without rivals.
    pub(in crate::diagnose::judgement) fn effect(place: usize, loss: f64) -> JudgedEffect {
        JudgedEffect {
            place,
            follows_path: true,
            without: 0,
            loss,
            confidence: 1.0,
            rivals: Vec::new(),
            group: Key::new(),
        }
    }

    #[test]
    fn a_rival_that_fits_better_is_not_called_lower() {
        let rival = |lack, strained| RivalSet {
            code: "series_compliance",
            node: 0,
            lack,
            strained,
        };
        let said = |lack| why_not_excluded(&effect(0, 824.0), &rival(lack, false));
        let at_limit = why_not_excluded(&effect(0, 824.0), &rival(-1.0, true));
        assert!(
            at_limit.ends_with("only with a parameter at the limit of its range"),
            "{at_limit}"
        );
        assert!(said(-5.0).starts_with("it fits better, by 5.0"), "{}", said(-5.0));
        assert!(said(3.0).contains("lower by only 3.0"), "{}", said(3.0));
    }

    #[test]
    fn only_a_rival_that_fits_better_is_better() {
        let rival = |node, lack, strained| RivalSet {
            code: "lift_off",
            node,
            lack,
            strained,
        };
        let mut judged = [effect(0, 40.0), effect(1, 30.0)];
        judged[0].rivals = vec![rival(5, -9.0, false)];
        judged[1].rivals = vec![rival(7, -5.0, true), rival(8, -3.0, false), rival(9, 1.0, false)];
        assert_eq!(better_rival(&judged, 1), Some(8));
        judged[1].rivals.remove(1);
        assert_eq!(better_rival(&judged, 1), None);
    }

    #[test]
    fn one_of_three_that_fit_as_well_is_right_in_a_third_of_the_cases() {
        assert_eq!(against_rivals(0.0), 1.0);
        assert_eq!(against_rivals(1.0), 0.5);
        assert!((against_rivals(2.0) - 1.0 / 3.0).abs() < 1e-12);
        // Calibrated: a rival half as likely takes a ninth.
        assert!((against_rivals(0.5) - 8.0 / 9.0).abs() < 1e-12);
    }
}
