//! From a search to a diagnosis: the verdict, findings, alternatives, locations and alarms.

use nalgebra::DMatrix;

use super::alternatives::{
    JudgedEffect, alternative, better_law, better_rival, judge, more_plausible, nearest,
};
use super::delivered::{as_model, as_written, delivered};
use super::error_of_form::{FreeLaws, LEAST_TRUST, trust_beside};
use super::further_names::{
    self, Doubtful, doubtful, hardly_believed, is_much_worse, trusted, without_implausible,
};
use super::groups::group;
use super::intervals::intervals;
use super::location::{locate, share_in, words};
use super::look_alikes::{explains_most, look_alikes};
use super::of_path::{FoundOfPath, with_path};
use super::rest::{LACK_SHARE, Rest, is_explained};
use super::summary::summary;
use super::tables::{baseline_parameters, candidates, curves, errors, maps, not_testable, values_of};
use super::taken_back::take_back;
use super::trust::Trust;
use super::varying_coefficient::variation;
use crate::diagnose::course::Course;
use crate::diagnose::diagnosis::*;
use crate::diagnose::fitting::{FitContext, Node};
use crate::diagnose::search::{SearchResult, simplify, without};
use crate::effect::Axis;
use crate::identify::Residuals;
use crate::identify::confidence::{Confidence, Warning};

/// A force zero beyond this many standard deviations raises an alarm.
const ZERO_ALARM: f64 = 4.0;
/// A tensile force above this share of the range raises an alarm.
const TENSION_ALARM: f64 = 0.05;
/// What a verdict needs beside the search: the same for every search of these recordings.
#[derive(Clone)]
pub(in crate::diagnose) struct Known<'a> {
    /// The data without a discrepancy.
    pub plain: &'a FitContext<'a>,
    /// The baseline with its own friction law.
    pub refitted: &'a Node,
    /// What the search started from, without a discrepancy.
    pub base: &'a Node,
    /// Residuals of the baseline before the fit.
    pub nominal: Option<Vec<f64>>,
    /// The recordings as plants are driven over them, and what simple models leave of them.
    pub courses: Vec<Course>,
    pub yardsticks: Vec<YardstickError>,
    /// Where all that follows from the path is in doubt: what was found of it before.
    pub of_path: Option<FoundOfPath>,
    /// True if the search beside the path confirmed the effects of speed and time, or found them.
    pub path_given_away: bool,
}

/// A search with what its chosen set was found to be.
pub(in crate::diagnose) struct Judgement {
    /// All but the next test.
    pub diagnosis: Diagnosis,
    /// The search, with the sets that were compared with the chosen one.
    pub search: SearchResult,
    /// The missing effects of the chosen set, with their rivals.
    pub effects: Vec<JudgedEffect>,
}

/// Judges the chosen set and puts everything together.
pub(in crate::diagnose) fn conclude(
    context: &FitContext<'_>,
    mut search: SearchResult,
    known: Known<'_>,
) -> Judgement {
    take_back(context, &mut search);
    let (effects, doubtful) = judge_sure(context, &mut search, &known);
    let mut diagnosis = diagnosis(context, &search, &effects, known);
    if diagnosis.verdict == Verdict::MissingPhysics {
        diagnosis.summary += &further_names::in_words(&doubtful);
    }
    Judgement {
        diagnosis,
        search,
        effects,
    }
}

/// Judges the search in which everything that follows from the path was in doubt. `before` is the diagnosis without it: effects of the
/// path keep what it says, and effects of speed and time are decided here. `None` where `before` stands: the search leaves structure, or
/// it neither names nor refuses an effect of speed or time.
pub(in crate::diagnose) fn conclude_of_path(
    context: &FitContext<'_>,
    search: SearchResult,
    known: Known<'_>,
    before: &Diagnosis,
) -> Option<Judgement> {
    let of_path = FoundOfPath::of(before);
    let found = search.nodes[search.chosen].attached.len() > context.setup.extras.len();
    let refused = before.effects.len() > of_path.effects.len();
    if !is_explained(context, &search, [known.base, known.refitted]) || !(found || refused) {
        return None;
    }
    let of_path = Some(of_path);
    let judged = conclude(context, search, Known { of_path, ..known });
    (judged.diagnosis.verdict != Verdict::Unexplained || !found).then_some(judged)
}

/// The diagnosis without a next test.
fn diagnosis(
    context: &FitContext<'_>,
    search: &SearchResult,
    judged: &[JudgedEffect],
    known: Known<'_>,
) -> Diagnosis {
    let (plain, refitted, base) = (known.plain, known.refitted, known.base);
    let laws = FreeLaws::of(search, refitted, known.path_given_away);
    let (before, after) = (&search.nodes[0], &search.nodes[search.chosen]);
    let (path_in_doubt, mut of_path) = (known.of_path.is_some(), known.of_path.unwrap_or_default());
    let nothing_named = judged.is_empty() && of_path.effects.is_empty();
    let rest = Rest::of(context, search, [base, refitted], nothing_named);
    let rest = rest.with_sweeps(context.data, search, path_in_doubt);
    of_path.clear_if(rest.unexplained);
    let verdict = verdict_of(rest.unexplained, nothing_named);
    let named = if rest.unexplained { before } else { after };
    let written = as_written(context, plain, named, &of_path);
    let delivered = delivered(plain, [&written, refitted], &rest, &known.courses);
    let confidence = intervals(context, named, search.likelihood);
    let given = if rest.unexplained { &[] } else { judged };
    let found = findings(context, search, given, &confidence, (laws, &rest));
    let effects = [of_path.effects, found].concat();
    let located = locations(context, &rest, [refitted, before, after], judged);
    let location = with_path(of_path.location, located);
    let others = alternatives(context, search, refitted, judged, rest.unexplained);
    let fit = errors(plain, search, refitted, delivered.errors, known.nominal);
    let residuals = [&refitted.residuals[..], &delivered.residuals];
    Diagnosis {
        verdict,
        summary: summary(verdict, &effects, delivered.modelled_by(), &location, &fit)
            + &rest.limits_in_words(search.cut_short),
        alternatives: [of_path.alternatives, others].concat(),
        location,
        next_test: None,
        no_next_test: None,
        baseline_parameters: baseline_parameters(context, &delivered.node, &confidence),
        alarms: alarms(context, &delivered.node, &confidence),
        notes: context.data.tracks.iter().flat_map(|t| t.notes.clone()).collect(),
        candidates: candidates(context, search),
        not_testable: not_testable(context, before),
        unexplained_share: rest.share,
        search_cut_short: search.cut_short,
        single_sweep: rest.sweep.as_ref().map(|sweep| sweep.recording.clone()),
        model_steps: context.setup.steps(),
        friction_shape_share: rest.shape.map(|s| s.friction),
        curve_shape_share: rest.shape.and_then(|s| s.curve),
        free_laws_gain: laws.gain,
        curves: curves(context.data, residuals),
        maps: maps(context.data, residuals[0], residuals[1]),
        improved: delivered.model,
        law: delivered.law,
        yardsticks: known.yardsticks,
        proof: None,
        left_out: Vec::new(),
        refitted: as_model(context, refitted, None),
        courses: known.courses,
        effects,
        fit,
    }
}

fn verdict_of(unexplained: bool, nothing_named: bool) -> Verdict {
    match (unexplained, nothing_named) {
        (true, _) => Verdict::Unexplained,
        (false, false) => Verdict::MissingPhysics,
        (false, true) => Verdict::Adequate,
    }
}

/// Judges the effects of the chosen set. Takes back those that may be nothing but the error of form of the other laws, the least trusted
/// first. An effect that is not plausible gives its place to a rival that is, or is taken back where the others do without it.
fn judge_trusted(
    context: &FitContext<'_>,
    search: &mut SearchResult,
    known: &Known<'_>,
) -> Vec<JudgedEffect> {
    loop {
        let effects = judge_all(context, search);
        let laws = FreeLaws::of(search, known.refitted, known.path_given_away).in_full();
        let trust = effects.iter().map(|j| (trust_beside(j, &effects, laws), j.place));
        let least = trust.min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, place)) = least.filter(|(trust, _)| *trust < LEAST_TRUST) {
            search.chosen = without(context, &mut search.nodes, search.chosen, place);
        } else if let Some(rival) =
            more_plausible(context, search, &effects).or_else(|| better_law(context, search, &effects))
        {
            search.chosen = rival;
        } else if let Some(smaller) = without_implausible(context, search, &effects) {
            search.chosen = smaller;
        } else {
            return effects;
        }
    }
}

/// Judges the effects of the chosen set. Each that is hardly believed gives its place to a rival that fits better, or is taken back. Takes
/// back each doubtful name beside a sure one where the others explain the recordings too.
fn judge_sure(
    context: &FitContext<'_>,
    search: &mut SearchResult,
    known: &Known<'_>,
) -> (Vec<JudgedEffect>, Vec<Doubtful>) {
    let fits = [known.base, known.refitted];
    let key = |node: &Node| node.key(context.setup.extras.len());
    let mut taken_back = Vec::new();
    // A set that was given up does not come back, so this ends.
    let mut given_up = Vec::new();
    let mut effects = judge_trusted(context, search, known);
    loop {
        let rest = Rest::of(context, search, fits, false);
        let beside = (FreeLaws::of(search, known.refitted, known.path_given_away), &rest);
        let all = trusted(context, search, &effects, beside);
        if let Some(place) = hardly_believed(&all) {
            given_up.push(key(&search.nodes[search.chosen]));
            let better = better_rival(&effects, place);
            search.chosen = better
                .filter(|&set| !given_up.contains(&key(&search.nodes[set])))
                .unwrap_or_else(|| without(context, &mut search.nodes, search.chosen, place));
            effects = judge_trusted(context, search, known);
            continue;
        }
        let Some(doubtful) = doubtful(search, all) else {
            return (effects, taken_back);
        };
        let kept = search.chosen;
        search.chosen = without(context, &mut search.nodes, kept, doubtful.place);
        let [with, without] = [kept, search.chosen].map(|set| &search.nodes[set]);
        if is_much_worse(context.data, with, without) || !is_explained(context, search, fits) {
            search.chosen = kept;
            return (effects, taken_back);
        }
        taken_back.push(doubtful);
        effects = judge_trusted(context, search, known);
    }
}

/// Compares every effect of the chosen set with what could take its place.
fn judge_all(context: &FitContext<'_>, search: &mut SearchResult) -> Vec<JudgedEffect> {
    let attached = &search.nodes[search.chosen].attached;
    let missing: Vec<usize> = (context.setup.extras.len()..attached.len())
        .filter(|&k| !attached[k].own)
        .collect();
    let mut judged: Vec<JudgedEffect> = missing.into_iter().map(|k| judge(context, search, k)).collect();
    group(context, search, &mut judged);
    // A free shape would let a rival imitate the effect in every test that could separate the two.
    for rival in judged.iter().flat_map(|j| &j.rivals) {
        simplify(context, search, rival.node);
    }
    judged
}

/// The named effects.
fn findings(
    context: &FitContext<'_>,
    search: &SearchResult,
    judged: &[JudgedEffect],
    confidence: &Confidence,
    beside: (FreeLaws, &Rest),
) -> Vec<Finding> {
    let sure = |j: &JudgedEffect| Trust::of(context, search, j, judged, beside).in_effect;
    let named = judged.iter();
    named
        .map(|j| finding(context, search, j, confidence, sure(j)))
        .collect()
}

/// A named effect. `sure` is the confidence in it.
fn finding(
    context: &FitContext<'_>,
    search: &SearchResult,
    judged: &JudgedEffect,
    confidence: &Confidence,
    sure: f64,
) -> Finding {
    let node = &search.nodes[search.chosen];
    let attached = &node.attached[judged.place];
    let from = context.offset(&node.attached, judged.place);
    let values = context.effect_values(node, judged.place);
    let variation = variation(context, search.likelihood, node, judged.place);
    Finding {
        code: attached.effect.code.to_owned(),
        confidence: sure,
        size_spread: variation.map(|v| v.spread),
        statement: one_of(&judged.group, attached.effect.code) + &(attached.effect.statement)(values),
        group: match judged.group.as_slice() {
            [] => Vec::new(),
            others => [attached.effect.code]
                .iter()
                .chain(others)
                .map(|&c| c.to_owned())
                .collect(),
        },
        parameters: values_of(&attached.parameters, from, node, confidence),
        gain: Some(judged.loss),
    }
}

/// The beginning of the statement of an effect that the recordings cannot tell from others.
fn one_of(others: &[&str], code: &str) -> String {
    if others.is_empty() {
        return String::new();
    }
    let spaced: Vec<String> = others.iter().map(|c| c.replace('_', " ")).collect();
    format!(
        "One of: {}, {}; these recordings do not tell which. If it is {0}: ",
        code.replace('_', " "),
        spaced.join(", ")
    )
}

/// Rivals of the findings; where nothing explains the recordings, the look-alikes of the friction law and the nearest effects.
fn alternatives(
    context: &FitContext<'_>,
    search: &SearchResult,
    refitted: &Node,
    judged: &[JudgedEffect],
    unexplained: bool,
) -> Vec<Alternative> {
    if unexplained {
        let mut list = look_alikes(context, refitted, &search.nodes[0]);
        for other in nearest(context, search) {
            if list.iter().all(|a| a.code != other.code) {
                list.push(other);
            }
        }
        return list;
    }
    let attached = &search.nodes[search.chosen].attached;
    judged
        .iter()
        .flat_map(|j| {
            j.rivals
                .iter()
                .map(|r| alternative(attached[j.place].effect, j, r))
        })
        .collect()
}

/// Weighted sensitivities of a node.
fn sensitivities(context: &FitContext<'_>, node: &Node) -> DMatrix<f64> {
    let structure = context.structure(node.attached.clone());
    structure.fitted(&node.values).map_or_else(
        || DMatrix::zeros(structure.count(), 0),
        |r| structure.sensitivities(&node.values, &r).0,
    )
}

/// Where the refitted baseline differs from the recordings, and where the chosen set still does. What is more likely to be missing comes first.
fn unexplained_locations(
    context: &FitContext<'_>,
    rest: &Rest,
    [refitted, before, after]: [&Node; 3],
) -> Vec<Location> {
    let data = context.data;
    let mut list = locate(data, &refitted.residuals, &sensitivities(context, refitted));
    let mut left = locate(data, &after.residuals, &sensitivities(context, after));
    left.retain(|l| l.share > LACK_SHARE);
    let of_friction = explains_most(context, refitted, before);
    if of_friction {
        // What a general friction law explains is after the reversals, even if it also shows along other axes.
        list.sort_by_key(|l| l.axis != Axis::DistanceFromReversalMm);
    }
    // If a general friction law explains most, or all held-out cycles are explained, the rest shows what is missing.
    let (mut places, others) = match of_friction || rest.sweep.is_some() {
        true => (left, list),
        false => (list, left),
    };
    for other in others {
        if !places.contains(&other) {
            places.push(other);
        }
    }
    places
}

/// Where the effects say that they act, then where the baseline differs along other axes.
fn effect_locations(
    context: &FitContext<'_>,
    [before, after]: [&Node; 2],
    judged: &[JudgedEffect],
) -> Vec<Location> {
    if judged.is_empty() {
        return Vec::new();
    }
    let mut list = Vec::new();
    for j in judged {
        let acts = after.attached[j.place].effect.place;
        if let Some(place) = acts(context.effect_values(after, j.place), &context.span) {
            let share = share_in(context.data, &before.residuals, &place);
            list.push(Location {
                axis: place.axis,
                from: place.from,
                to: place.to,
                direction: place.branch,
                share,
                words: words(place.axis, place.from, place.to, place.branch, share),
            });
        }
    }
    let own = list.len();
    for found in locate(context.data, &before.residuals, &sensitivities(context, before)) {
        if list[..own].iter().all(|l: &Location| l.axis != found.axis) {
            list.push(found);
        }
    }
    list
}

/// Where the effects act, or where the baseline differs if nothing explains it.
fn locations(
    context: &FitContext<'_>,
    rest: &Rest,
    [refitted, before, after]: [&Node; 3],
    judged: &[JudgedEffect],
) -> Vec<Location> {
    match rest.unexplained {
        true => unexplained_locations(context, rest, [refitted, before, after]),
        false => effect_locations(context, [before, after], judged),
    }
}

/// Parameters that are suspect, and remarks on the recordings: findings about the input.
fn alarms(context: &FitContext<'_>, node: &Node, confidence: &Confidence) -> Vec<String> {
    let parameters = context.setup.model.parameters;
    let surrogate = context.setup.surrogate.as_ref();
    // Parameters that a surrogate fixes are reported by its own remarks.
    let is_fixed = |name: &&str| {
        let index = parameters.iter().position(|p| p.name == *name);
        surrogate.zip(index).is_some_and(|(s, i)| s.is_fixed(i))
    };
    let about_fixed =
        |w: &Warning| matches!(w, Warning::NotIdentifiable { names, .. } if names.iter().any(is_fixed));
    let mut alarms: Vec<String> = confidence
        .warnings
        .iter()
        .filter(|w| !about_fixed(w))
        .map(ToString::to_string)
        .filter(|text| parameters.iter().any(|p| text.contains(p.name)))
        .collect();
    alarms.extend(surrogate.iter().flat_map(|s| s.remarks()));
    let zero_n = node.values[node.values.len() - 1];
    if zero_n.abs() > ZERO_ALARM * context.data.zero_sigma_n {
        alarms.push(format!(
            "the zero of the force channel is off by {zero_n:.1} N: check the tare"
        ));
    }
    let lowest_n = context.span.force_n[0];
    if lowest_n < -TENSION_ALARM * context.data.force_range_n {
        alarms.push(format!(
            "the force falls to {lowest_n:.0} N, but a pusher cannot pull a spring: check sign and zero of the force, and which device was measured"
        ));
    }
    for track in &context.data.tracks {
        alarms.extend(track.remarks.iter().map(|r| format!("{}: {r}", track.name)));
    }
    alarms
}
