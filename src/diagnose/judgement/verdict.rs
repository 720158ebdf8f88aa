//! From a search to a diagnosis: the verdict, findings, locations, alarms and the improved model.

use nalgebra::DMatrix;

use super::alternatives::{JudgedEffect, alternative, judge, nearest};
use super::groups::group;
use super::intervals::intervals;
use super::left_out::courses;
use super::location::{locate, share_in, words};
use super::look_alikes::{explains_most, look_alikes};
use super::tables::{
    baseline_parameters, candidates, curves, errors, errors_of_model, maps, not_testable, values_of,
};
use super::varying_coefficient::{Variation, variation};
use super::{law, two_sided, yardsticks};
use crate::diagnose::course::{Course, Split};
use crate::diagnose::diagnosis::*;
use crate::diagnose::fitting::{FitContext, ModelStructure, Node, ShapeShares, converge};
use crate::diagnose::search::{LACK_GAIN, LACK_POWER, LackOfFit, SearchResult, lack_of_fit, simplify};
use crate::effect::Axis;
use crate::identify::Residuals;
use crate::identify::confidence::{Confidence, Warning};
use crate::model::Parameter;

/// The lack of fit is unexplained structure if it exceeds [`LACK_POWER`], [`LACK_GAIN`] and this share of what the effects explain.
const LACK_SHARE: f64 = 0.15;
/// Mean square above the noise on reporting cycles that chance and the inexact form of an effect do not reach.
const REPORT_POWER: f64 = 0.45;
/// A set does not fit if it leaves this mean square on selecting cycles, in units of the noise, and this share of the baseline's.
const NO_FIT_POWER: f64 = 3.0;
const NO_FIT_SHARE: f64 = 0.5;
/// Such residuals must also be correlated over this many samples: a noise that was estimated too low is not.
const NO_FIT_CORRELATION: f64 = 4.0;
/// If a set leaves this mean square, the verdict is `unexplained`, even if the set explains a large share.
const FAR_OFF_POWER: f64 = 25.0;
/// A force zero beyond this many standard deviations raises an alarm.
const ZERO_ALARM: f64 = 4.0;
/// A tensile force above this share of the range raises an alarm.
const TENSION_ALARM: f64 = 0.05;
/// Axes that follow from the path of the displacement.
const OF_PATH: [Axis; 3] = [Axis::DisplacementMm, Axis::ForceN, Axis::DistanceFromReversalMm];
/// Highest confidence that is reported.
const MOST_CONFIDENCE: f64 = 0.99;

/// What a verdict needs beside the search.
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
    /// Where all that follows from the path is in doubt: what was found of it before.
    pub of_path: Option<FoundOfPath>,
}

/// Effects that follow from the path of the displacement, as a search found them in which the path was not in doubt.
#[derive(Clone, Default)]
pub(in crate::diagnose) struct FoundOfPath {
    effects: Vec<Finding>,
    alternatives: Vec<Alternative>,
    location: Vec<Location>,
}

impl FoundOfPath {
    /// What a diagnosis names; nothing where it explains nothing.
    fn of(before: &Diagnosis) -> FoundOfPath {
        if before.verdict == Verdict::Unexplained {
            return FoundOfPath::default();
        }
        let follows = |code: &str| crate::effect::find(code).is_ok_and(|e| e.follows_path);
        let named = |code: &str| follows(code) && before.effects.iter().any(|e| e.code == code);
        FoundOfPath {
            effects: before
                .effects
                .iter()
                .filter(|e| follows(&e.code))
                .cloned()
                .collect(),
            alternatives: before
                .alternatives
                .iter()
                .filter(|a| named(&a.instead_of))
                .cloned()
                .collect(),
            location: before
                .location
                .iter()
                .filter(|l| OF_PATH.contains(&l.axis))
                .cloned()
                .collect(),
        }
    }

    fn clear_if(&mut self, unexplained: bool) {
        if unexplained {
            *self = FoundOfPath::default();
        }
    }

    fn names(&self, code: &str) -> bool {
        self.effects.iter().any(|e| e.code == code)
    }
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
    let effects = judge_all(context, &mut search);
    Judgement {
        diagnosis: diagnosis(context, &search, &effects, known),
        search,
        effects,
    }
}

/// Judges a search in which all that follows from the path was in doubt, after the judgement of the search before it. It decides about
/// effects of speed and time alone. `None` where it adds nothing: it leaves structure, or it neither names such effects nor refuses one.
pub(in crate::diagnose) fn conclude_of_path(
    context: &FitContext<'_>,
    search: SearchResult,
    known: Known<'_>,
    before: &Diagnosis,
) -> Option<Judgement> {
    let of_path = FoundOfPath::of(before);
    let found = search.nodes[search.chosen].attached.len() > context.setup.extras.len();
    let refused = before.effects.len() > of_path.effects.len();
    if !is_explained(context, &search, known.base) || !(found || refused) {
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
    let (before, after) = (&search.nodes[0], &search.nodes[search.chosen]);
    let mut of_path = known.of_path.unwrap_or_default();
    let nothing_named = judged.is_empty() && of_path.effects.is_empty();
    let rest = Rest::of(context, search, base, nothing_named);
    let unexplained = rest.unexplained;
    of_path.clear_if(unexplained);
    let verdict = verdict_of(unexplained, nothing_named);
    let named = if unexplained { before } else { after };
    let courses = courses(context.data);
    let written = as_written(context, plain, named, &of_path);
    let delivered = delivered(plain, [&written, refitted], &rest, &courses);
    let confidence = intervals(context, named, search.likelihood);
    let named_effects = if unexplained { &[] } else { judged };
    let found = findings(context, search, named_effects, &confidence, rest.share);
    let effects = [of_path.effects, found].concat();
    let located = locations(context, unexplained, [refitted, before, after], judged);
    let location = with_path(of_path.location, located);
    let alternatives = alternatives(context, search, refitted, judged, unexplained);
    let alternatives = [of_path.alternatives, alternatives].concat();
    let fit = errors(plain, search, refitted, delivered.errors, known.nominal);
    let of_shape = rest.shape.filter(|_| !unexplained);
    let residuals = [&refitted.residuals[..], &delivered.residuals];
    Diagnosis {
        verdict,
        summary: summary(verdict, &effects, delivered.modelled_by(), &location, &fit)
            + &limits_in_words(of_shape, search.cut_short),
        alternatives,
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
        model_steps: context.setup.steps(),
        friction_shape_share: rest.shape.map(|s| s.friction),
        curve_shape_share: rest.shape.and_then(|s| s.curve),
        curves: curves(context.data, residuals),
        maps: maps(context.data, residuals[0], residuals[1]),
        improved: delivered.model,
        law: delivered.law,
        yardsticks: yardsticks::errors(&courses, context.threads()),
        proof: None,
        left_out: Vec::new(),
        refitted: as_model(context, refitted, None),
        courses,
        effects,
        fit,
    }
}

/// What the chosen set leaves.
struct Rest {
    unexplained: bool,
    /// Its share of what the baseline left.
    share: f64,
    /// How much of the difference was left to the shape of the laws in doubt.
    shape: Option<ShapeShares>,
}

impl Rest {
    /// `base`: the baseline without a discrepancy.
    fn of(context: &FitContext<'_>, search: &SearchResult, base: &Node, nothing_named: bool) -> Rest {
        let (before, after) = (&search.nodes[0], &search.nodes[search.chosen]);
        let left = lack_of_fit(context.data, &after.residuals);
        let mut rest = Rest {
            unexplained: is_unexplained(context, search, base, left),
            share: unexplained_share(base, after, left),
            shape: shape_shares(context, after),
        };
        // The rest is also compared with what the shape of the friction law left to explain: of the whole it may be a small share.
        rest.unexplained |= repeats(search, unexplained_share(before, after, left), left);
        rest.unexplained |= nothing_named && rest.is_beyond_shape();
        rest
    }

    fn is_beyond_shape(&self) -> bool {
        self.shape.is_some_and(|s| !s.are_errors_of_shape())
    }
}

/// What is written as the improved model.
struct Delivered {
    model: ImprovedModel,
    /// The set with its parameters; with a law, refitted beside that.
    node: Node,
    law: Option<DiscoveredLaw>,
    /// True for the model of a device that pushes and pulls.
    two_sided: bool,
    /// Weighted residuals of every point.
    residuals: Vec<f64>,
    errors: Errors,
}

impl Delivered {
    /// What an unexplained difference is modelled by, in words.
    fn modelled_by(&self) -> Option<String> {
        if self.two_sided {
            return Some(
                "the model two-sided (spring, damper and ten friction elements that do not follow the load; it pushes and pulls)"
                    .to_owned(),
            );
        }
        let law = self.law.as_ref()?;
        Some(format!("a law read off the recordings, {}", law.equation))
    }
}

/// The named set; where the difference is unexplained or more than an error of shape, with a law read off the recordings; where it is
/// unexplained, or a two-sided device. What is refused is neither written nor quoted.
fn delivered(
    context: &FitContext<'_>,
    [named, refitted]: [&Node; 2],
    rest: &Rest,
    courses: &[Course],
) -> Delivered {
    let heldout = |context: &FitContext<'_>, node: &Node| errors_of_model(context, node).nrmse_heldout;
    let without_law = heldout(context, named).min(heldout(context, refitted));
    let found = (rest.unexplained || rest.is_beyond_shape())
        .then(|| law::discover(context, named))
        .flatten()
        // Both errors are quoted, so a law that raises the error is refused, however well it fits the fitted cycles.
        .filter(|found| heldout(&context.with_setup(&found.setup), &found.node) < without_law);
    let with_law = found.as_ref().map(|found| context.with_setup(&found.setup));
    let node = found.as_ref().map_or(named, |found| &found.node).clone();
    if rest.unexplained
        && let Some(device) = two_sided::better_than(context, courses, &node.residuals)
    {
        return Delivered {
            model: device.model,
            node: named.clone(),
            law: None,
            two_sided: true,
            residuals: device.residuals,
            errors: device.errors,
        };
    }
    let law = found.as_ref().map(|found| found.law.clone());
    Delivered {
        model: as_model(context, &node, law.as_ref()),
        errors: errors_of_model(with_law.as_ref().unwrap_or(context), &node),
        residuals: node.residuals.clone(),
        node,
        law,
        two_sided: false,
    }
}

/// The node as it can be written: a file has no discrepancy, so the baseline is fitted again without it. The effects keep their
/// values, and those that are not named are taken out.
fn as_written(context: &FitContext<'_>, plain: &FitContext<'_>, node: &Node, of_path: &FoundOfPath) -> Node {
    if context.data.discrepancy.is_none() {
        return node.clone();
    }
    let extras = context.setup.extras.len();
    let (mut written, mut held) = (Vec::new(), Vec::new());
    let mut values = node.values[..context.setup.model.parameters.len()].to_vec();
    for (k, attached) in node.attached.iter().enumerate() {
        if k < extras && !attached.own && !of_path.names(attached.effect.code) {
            continue;
        }
        let from = context.offset(&node.attached, k);
        let own = &node.values[from..from + attached.parameters.len()];
        values.extend(own);
        written.push(attached.clone());
        held.push(attached.clone());
        if k >= extras {
            let parameters = held.iter_mut().last().map(|h| &mut h.parameters);
            for (parameter, value) in parameters.into_iter().flatten().zip(own) {
                parameter.bounds = [*value; 2];
            }
        }
    }
    values.extend(node.values.last());
    converge(&plain.structure(held), values).map_or_else(
        || node.clone(),
        |(fitted, _)| Node {
            attached: written,
            ..fitted
        },
    )
}

/// How much of the difference a set leaves to the shape of the friction law and of the spring's curve.
fn shape_shares(context: &FitContext<'_>, node: &Node) -> Option<ShapeShares> {
    let discrepancy = context.data.discrepancy.as_ref()?;
    let structure = context.structure(node.attached.clone());
    let (_, sizes) = structure.compared(&node.values)?;
    Some(discrepancy.shares(&sizes, &context.data.weight))
}

/// Said where the budget of the search was spent.
const CUT_SHORT: &str = " The search ended at its budget: larger sets of effects were not compared. Diagnose fewer recordings, or \
    shorter ones.";

/// What the diagnosis left to the shape of a law, and whether its search was cut short.
fn limits_in_words(shape: Option<ShapeShares>, cut_short: bool) -> String {
    shape.map_or(String::new(), rest_in_words) + if cut_short { CUT_SHORT } else { "" }
}

fn rest_in_words(shares: ShapeShares) -> String {
    if let (false, Some(curve)) = (shares.are_errors_of_shape(), shares.curve) {
        return format!(
            " The rest follows from the path of the displacement alone, {:.1} % of the force range as a curve and {:.0} % of the \
             friction: these recordings do not tell which effect it is, so it is not named.",
            100.0 * curve,
            100.0 * shares.friction
        );
    }
    let friction = 100.0 * shares.friction;
    let (size, shape) = match shares.curve {
        None => (format!("{friction:.1} % of the friction"), "the friction law"),
        Some(curve) => (
            format!(
                "{friction:.1} % of the friction and {:.2} % of the force range",
                100.0 * curve
            ),
            "the friction law and of the spring's curve",
        ),
    };
    format!(" The rest, {size}, has the shape of {shape}: no further effect is named.")
}

/// True if the chosen set leaves no structure above the noise; `base` is the baseline without a discrepancy.
pub(super) fn is_explained(context: &FitContext<'_>, search: &SearchResult, base: &Node) -> bool {
    let left = lack_of_fit(context.data, &search.nodes[search.chosen].residuals);
    !is_unexplained(context, search, base, left)
}

fn verdict_of(unexplained: bool, nothing_named: bool) -> Verdict {
    match (unexplained, nothing_named) {
        (true, _) => Verdict::Unexplained,
        (false, false) => Verdict::MissingPhysics,
        (false, true) => Verdict::Adequate,
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

/// Share of the baseline's residuals above the noise that the chosen set leaves.
fn unexplained_share(before: &Node, after: &Node, left: LackOfFit) -> f64 {
    let explained = (before.select - after.select).max(0.0);
    (left.sum.max(0.0) / (explained + left.sum.max(1e-9))).clamp(0.0, 1.0)
}

/// True if the chosen set leaves structure above the noise.
fn is_unexplained(context: &FitContext<'_>, search: &SearchResult, before: &Node, left: LackOfFit) -> bool {
    let data = context.data;
    let correlation_time = search.likelihood.correlation_time;
    let after = &search.nodes[search.chosen];
    let repeats = repeats(search, unexplained_share(before, after, left), left);
    // Structure that does not repeat from cycle to cycle is not found by regressions, but it exceeds the noise.
    let counted = data.count(Split::Select).max(1) as f64;
    let (power, power_before) = (after.select / counted, before.select / counted);
    let no_fit = power > NO_FIT_POWER
        && correlation_time > NO_FIT_CORRELATION
        && power - 1.0 > NO_FIT_SHARE * (power_before - 1.0);
    // A change that only the reporting cycles show, as of a specimen that changed late.
    let reporting = data.count(Split::Report).max(1) as f64;
    let reported = data.sum(&after.residuals, Split::Report) / reporting;
    let changed = reported > NO_FIT_POWER.max(2.0 * power);
    // The rest on reporting cycles exceeds the noise and is a considerable share of what the baseline leaves there.
    let reported_before = data.sum(&before.residuals, Split::Report) / reporting;
    let above_noise = reported > 1.0 + REPORT_POWER && reported - 1.0 > LACK_SHARE * (reported_before - 1.0);
    let late = (changed || above_noise) && !fits_every_cycle(context, after);
    repeats || no_fit || late || power > FAR_OFF_POWER
}

/// True if the structure that is left is larger than chance and than the error of an effect's form; `share`: its share of what was to
/// be explained.
fn repeats(search: &SearchResult, share: f64, left: LackOfFit) -> bool {
    left.power > LACK_POWER
        && share > LACK_SHARE
        && 0.5 * left.sum / search.likelihood.correlation_time > LACK_GAIN
}

/// True if one set of values fits the cycles of every split to within the noise. What the fitted cycles leave undetermined, such as
/// the friction where only unloading was fitted, is then no structure. A slow model is not fitted again.
fn fits_every_cycle(context: &FitContext<'_>, node: &Node) -> bool {
    if context.setup.model.slow {
        return false;
    }
    let every = context.data.all_fitted();
    let structure = ModelStructure::new(context.setup, &every, node.attached.clone());
    let Some((refitted, _)) = converge(&structure, node.values.clone()) else {
        return false;
    };
    [Split::Fit, Split::Select, Split::Report]
        .into_iter()
        .all(|split| {
            let counted = context.data.count(split).max(1) as f64;
            context.data.sum(&refitted.residuals, split) / counted < 1.0 + REPORT_POWER
        })
}

/// The named effects.
fn findings(
    context: &FitContext<'_>,
    search: &SearchResult,
    judged: &[JudgedEffect],
    confidence: &Confidence,
    unexplained_share: f64,
) -> Vec<Finding> {
    let trust = |j: &JudgedEffect| j.trust_beside(judged) * (1.0 - unexplained_share.powi(2));
    let named = judged.iter();
    named
        .map(|j| finding(context, search, j, confidence, trust(j)))
        .collect()
}

/// A named effect. `trust_in_set`: factor of its confidence, for the other effects of the set and for what is left unexplained.
fn finding(
    context: &FitContext<'_>,
    search: &SearchResult,
    judged: &JudgedEffect,
    confidence: &Confidence,
    trust_in_set: f64,
) -> Finding {
    let node = &search.nodes[search.chosen];
    let attached = &node.attached[judged.place];
    let from = context.offset(&node.attached, judged.place);
    let group = &node.values[from..from + attached.parameters.len()];
    let variation = variation(context, search.likelihood, node, judged.place);
    let trust = variation.map_or(1.0, Variation::trust);
    Finding {
        code: attached.effect.code.to_owned(),
        confidence: (judged.confidence * trust * trust_in_set).clamp(0.0, MOST_CONFIDENCE),
        size_spread: variation.map(|v| v.spread),
        statement: one_of(&judged.group, attached.effect.code) + &(attached.effect.statement)(group),
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

/// Where the refitted baseline differs from the recordings, then where the chosen set still does.
fn unexplained_locations(context: &FitContext<'_>, [refitted, before, after]: [&Node; 3]) -> Vec<Location> {
    let data = context.data;
    let mut list = locate(data, &refitted.residuals, &sensitivities(context, refitted));
    if explains_most(context, refitted, before) {
        // What a general friction law explains is after the reversals, even if it also shows along other axes.
        list.sort_by_key(|l| l.axis != Axis::DistanceFromReversalMm);
    }
    let left = locate(data, &after.residuals, &sensitivities(context, after));
    list.extend(left.into_iter().filter(|l| l.share > LACK_SHARE));
    list
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
        let attached = &after.attached[j.place];
        let from = context.offset(&after.attached, j.place);
        let group = &after.values[from..from + attached.parameters.len()];
        if let Some(place) = (attached.effect.place)(group, &context.span) {
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
    unexplained: bool,
    [refitted, before, after]: [&Node; 3],
    judged: &[JudgedEffect],
) -> Vec<Location> {
    match unexplained {
        true => unexplained_locations(context, [refitted, before, after]),
        false => effect_locations(context, [before, after], judged),
    }
}

/// Locations, where those on an axis of the path were found before: in this search that axis is in doubt.
fn with_path(of_path: Vec<Location>, found: Vec<Location>) -> Vec<Location> {
    let axes: Vec<Axis> = of_path.iter().map(|l| l.axis).collect();
    let beside = found.into_iter().filter(|l| !axes.contains(&l.axis));
    of_path.into_iter().chain(beside).collect()
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

/// The model of a node, with its effects in the order in which they are attached.
fn as_model(context: &FitContext<'_>, node: &Node, law: Option<&DiscoveredLaw>) -> ImprovedModel {
    let model = context.setup.model;
    let values = |parameters: &[Parameter], from: usize| -> Vec<(String, f64)> {
        parameters
            .iter()
            .enumerate()
            .map(|(i, p)| (p.name.to_owned(), node.values[from + i]))
            .collect()
    };
    let mut order: Vec<usize> = (0..node.attached.len()).collect();
    order.sort_by_key(|&k| (node.attached[k].effect.stage, node.attached[k].effect.code));
    ImprovedModel {
        model: model.name.to_owned(),
        parameters: values(model.parameters, 0),
        structure: context.setup.structure.clone(),
        effects: order
            .into_iter()
            .map(|k| AttachedEffect {
                code: node.attached[k].effect.code.to_owned(),
                parameters: values(&node.attached[k].parameters, context.offset(&node.attached, k)),
            })
            .collect(),
        law: law.map(|l| l.law.clone()),
        force_zero_n: node.values[node.values.len() - 1],
    }
}

fn summary(
    verdict: Verdict,
    effects: &[Finding],
    modelled: Option<String>,
    location: &[Location],
    fit: &FitErrors,
) -> String {
    let percent = |share: f64| format!("{:.2} %", 100.0 * share);
    let noise = percent(fit.noise_floor_nrmse);
    let improved = percent(fit.improved.nrmse_heldout);
    match verdict {
        Verdict::Adequate => {
            format!(
                "The baseline explains the recordings: error {improved} on held-out cycles, noise {noise}."
            )
        }
        Verdict::MissingPhysics => {
            let name = |e: &Finding| match e.group.join(" or ").replace('_', " ") {
                none if none.is_empty() => e.code.replace('_', " "),
                group => format!("one of {group}"),
            };
            let codes: Vec<String> = effects.iter().map(name).collect();
            let baseline = percent(fit.baseline.nrmse_heldout);
            format!(
                "Missing: {}. The error on held-out cycles falls from {baseline} to {improved}{}, noise {noise}.",
                codes.join(" and "),
                modelled.map_or(String::new(), |what| format!(" with {what}"))
            )
        }
        Verdict::Unexplained => {
            let baseline = percent(fit.baseline.nrmse_heldout);
            let place = location
                .first()
                .map_or(String::new(), |l| format!(": {}", l.words));
            let modelled = modelled.map_or(String::new(), |what| {
                format!(
                    " Modelled by {what}: the error on held-out cycles falls from {baseline} to {improved}, noise {noise}."
                )
            });
            format!("No effect in the library explains the difference{place}.{modelled}")
        }
    }
}
