//! From a search to a diagnosis: findings with confidence, alternatives, what is unexplained, errors, the improved model.

use super::bank;
use super::choose::without;
use super::condition::Split;
use super::diagnosis::*;
use super::fit::profile;
use super::next_test;
use super::problem::ModelStructure;
use super::residual;
use super::select::{FitContext, Node, Search, Worth};
use super::surrogate;
use super::tables::{baseline_parameters, candidates, curves, errors, not_testable, offset, values_of};
use crate::effect::Axis;
use crate::identify::Residuals;
use crate::identify::confidence::{Confidence, Warning, confidence};
use crate::identify::evaluator::Evaluator;

/// Left by everything that was tried, and found again by the bank on other cycles: in mean square of the noise, as a share
/// of what the baseline left, in log-likelihood.
const LEFT_POWER: f64 = 0.06;
const LEFT_SHARE: f64 = 0.15;
const LEFT_GAIN: f64 = 10.0;
/// Mean square above the noise on reporting cycles: chance and a form that is a little off stay below.
const LEFT_REPORTED: f64 = 0.45;
/// Mean square on selecting cycles, in units of the noise, above which a fit is none, and the share of the baseline's that
/// it must then be; far above it nothing is explained, whatever the share.
const NO_FIT: f64 = 3.0;
const NO_FIT_SHARE: f64 = 0.5;
const FAR_OFF: f64 = 25.0;
/// Sets within this share of the best gain are named as the nearest where nothing explains.
const NEAREST: f64 = 0.05;
/// Two explanations closer than this in log-likelihood, or this share of what the finding brings, are not told apart.
const CLOSE_GAIN: f64 = 6.0;
const CLOSE_SHARE: f64 = 0.04;
/// Whatever the finding brings: a mean square above the best, in units of the noise, that is told apart.
pub(super) const ALIKE: f64 = 0.04;
/// Temperature of the confidence: of the claims that two runs of 400 sealed cases (seeds 404 and 777) were 71 % sure of, 97 % were
/// right; with this exponent of the doubt they are 93 % sure.
const SHARPNESS: f64 = 3.0;
/// Rise of the sum of squares, in variances, at the ends of a 95 % interval.
const RISE: f64 = 3.84;

/// A finding before it is put into words.
struct Named {
    place: usize,
    /// Node that lacks it.
    without: usize,
    loss: f64,
    confidence: f64,
    /// Code, node and lack of gain of what could replace it.
    rivals: Vec<(&'static str, usize, f64)>,
}

pub(super) fn conclude(
    bench: &FitContext<'_>,
    mut search: Search,
    plain: &Node,
    nominal: Option<Vec<f64>>,
) -> Diagnosis {
    let extras = bench.setup.extras.len();
    let (data, worth) = (bench.data, search.worth);
    let chosen = search.chosen;
    let places: Vec<usize> = (extras..search.nodes[chosen].attached.len())
        .filter(|&k| !search.nodes[chosen].attached[k].own)
        .collect();
    let named: Vec<Named> = places
        .into_iter()
        .map(|k| rivals(bench, &mut search, k))
        .collect();
    let (before, after) = (&search.nodes[0], &search.nodes[chosen]);
    let left = bank::left(data, &after.residuals);
    let explained = (before.select - after.select).max(0.0);
    let unexplained_share = (left.sum.max(0.0) / (explained + left.sum.max(1e-9))).clamp(0.0, 1.0);
    let counted = data.count(Split::Select).max(1) as f64;
    let repeats = left.power > LEFT_POWER
        && unexplained_share > LEFT_SHARE
        && 0.5 * left.sum / worth.correlation > LEFT_GAIN;
    // Something that does not repeat from cycle to cycle escapes the bank, but not the noise.
    let (power, power_before) = (after.select / counted, before.select / counted);
    let no_fit =
        power > NO_FIT && worth.correlation > 4.0 && power - 1.0 > NO_FIT_SHARE * (power_before - 1.0);
    // What only the reporting cycles show (a specimen that changed late) is beyond a fit, but no reason to call it adequate.
    let reported = data.sum(&after.residuals, Split::Report) / data.count(Split::Report).max(1) as f64;
    let changed = reported > NO_FIT.max(2.0 * power);
    // What is left where nothing was fitted or chosen: above the noise, and no small part of what there was.
    let reported_before =
        data.sum(&before.residuals, Split::Report) / data.count(Split::Report).max(1) as f64;
    let beyond = reported > 1.0 + LEFT_REPORTED && reported - 1.0 > LEFT_SHARE * (reported_before - 1.0);
    let unexplained = repeats || no_fit || changed || beyond || power > FAR_OFF;
    let confidence = intervals(bench, after, worth);
    let alarms = alarms(bench, after, &confidence);
    let verdict = match (unexplained, named.is_empty()) {
        (true, _) => Verdict::Unexplained,
        (false, false) => Verdict::MissingPhysics,
        (false, true) => Verdict::Adequate,
    };
    let mut effects = Vec::new();
    let mut alternatives = Vec::new();
    for n in &named {
        let finding = finding(bench, after, n, &confidence, unexplained_share);
        for &(code, _, lack) in &n.rivals {
            alternatives.push(alternative(bench, after, n, code, lack));
        }
        if !unexplained {
            effects.push(finding);
        }
    }
    if unexplained {
        alternatives = turn_round(bench, plain, before);
        for other in nearest(bench, &search) {
            if alternatives.iter().all(|a| a.code != other.code) {
                alternatives.push(other);
            }
        }
    }
    let next_test = named.iter().filter(|n| !n.rivals.is_empty()).find_map(|n| {
        let rival = |&(code, node, lack): &(&'static str, usize, f64)| next_test::Rival {
            code,
            node: &search.nodes[node],
            lack,
        };
        let question = next_test::Question {
            chosen: after,
            code: after.attached[n.place].effect.code,
            without: rival(&("nothing", n.without, n.loss)),
            rivals: n.rivals.iter().map(rival).collect(),
        };
        next_test::propose(bench, &question)
    });
    let location = locations(bench, [plain, before, after], &named, unexplained);
    let fit = errors(bench, &search, plain, nominal);
    let summary = summary(verdict, &effects, &location, &fit);
    Diagnosis {
        verdict,
        summary,
        alternatives,
        location,
        next_test,
        baseline_parameters: baseline_parameters(bench, after, &confidence),
        alarms,
        candidates: candidates(bench, &search),
        not_testable: not_testable(bench, before),
        unexplained_share,
        curves: curves(data, plain, after),
        maps: residual::maps(data, &plain.residuals, &after.residuals),
        improved: improved(bench, after),
        effects,
        fit,
    }
}

/// Did freeing the form of the baseline's own friction take most of the difference away?
fn turns_otherwise(bench: &FitContext<'_>, plain: &Node, freed: &Node) -> bool {
    let freed_form = plain.attached.len() < bench.setup.extras.len();
    freed_form && freed.select <= NO_FIT_SHARE * plain.select
}

/// What a friction that is generalised with much success looks like: its look-alikes, with the error before and after.
fn turn_round(bench: &FitContext<'_>, plain: &Node, freed: &Node) -> Vec<Alternative> {
    let Some(form) = &bench.setup.form else {
        return Vec::new();
    };
    if !turns_otherwise(bench, plain, freed) {
        return Vec::new();
    }
    let [own, general] =
        [plain, freed].map(|n| 100.0 * super::tables::errors_of(bench.data, &n.residuals).nrmse_heldout);
    let alternative = |r: &crate::effect::LookAlike| Alternative {
        code: r.code.to_owned(),
        instead_of: "unknown".to_owned(),
        why: format!(
            "{}: with a general friction law the error on held-out cycles falls from {own:.2} % to {general:.2} %",
            r.why
        ),
        test: r.test.to_owned(),
    };
    form.effect.confusable_with.iter().map(alternative).collect()
}

/// Codes of the sets that come nearest where nothing explains, best set first, each with why it was refused.
fn nearest(bench: &FitContext<'_>, search: &Search) -> Vec<Alternative> {
    let rows = candidates(bench, search);
    let best = rows.first().map_or(0.0, |r| r.gain);
    let mut codes: Vec<String> = Vec::new();
    for row in rows
        .iter()
        .filter(|r| r.gain > 0.0 && r.gain >= (1.0 - NEAREST) * best)
    {
        for code in &row.codes {
            let named = bench.setup.candidates.iter().any(|c| c.effect.code == code);
            if named && !codes.contains(code) && codes.len() < 5 {
                codes.push(code.clone());
            }
        }
    }
    let power = |n: &Node| n.select / bench.data.count(Split::Select).max(1) as f64;
    let least = search.nodes.iter().map(power).fold(f64::INFINITY, f64::min);
    codes
        .into_iter()
        .map(|code| Alternative {
            code,
            instead_of: "unknown".to_owned(),
            why: format!(
                "it is among the nearest in the library, but the best set still leaves {:.1} times the noise on cycles that it was not fitted on, and that repeats",
                least.sqrt()
            ),
            test: "look at the located place on the specimen".to_owned(),
        })
        .collect()
}

/// Lack of gain from which a rival of a finding that brings `loss` is told apart; `alike` is [`ALIKE`] over all samples.
/// The allowance for a form that is a little off is not made where the rival has gone as far as it can.
pub(super) fn told_apart(rival: &Node, loss: f64, alike: f64) -> f64 {
    if strained(rival) {
        return CLOSE_GAIN;
    }
    CLOSE_GAIN.max((CLOSE_SHARE * loss).min(alike))
}

/// Is a parameter of an effect held by a bound that nobody believes in?
fn strained(node: &Node) -> bool {
    let named = node.attached.iter().rev().take_while(|a| !a.own);
    let parameters = named.flat_map(|a| a.parameters.iter().rev());
    let values = node.values.iter().rev().skip(1);
    parameters.zip(values).any(|(p, v)| p.strained_by(*v))
}

/// What could stand in the place of one effect of the chosen set.
fn rivals(bench: &FitContext<'_>, search: &mut Search, place: usize) -> Named {
    let extras = bench.setup.extras.len();
    let chosen = search.chosen;
    let code = search.nodes[chosen].attached[place].effect.code;
    let minus = without(bench, &mut search.nodes, chosen, place);
    let loss = search
        .worth
        .gain(search.nodes[minus].cost() - search.nodes[chosen].cost());
    let seen: Vec<_> = search.nodes.iter().map(|n| n.key(extras)).collect();
    let parent = search.nodes[minus].clone();
    if let Some((settled, tangent)) = bench.settled(&parent) {
        let children = bench.children(&settled, &tangent, &seen, 8);
        search.nodes.extend(children);
        surrogate::refit_rivals(bench, search, &parent.key(extras));
    }
    let base = parent.key(extras);
    let counted = bench.data.counted() as f64;
    let alike = search.worth.gain(ALIKE * search.worth.spread * counted);
    let mut rivals: Vec<(&'static str, usize, f64)> = Vec::new();
    let mut doubt = 0.0;
    for (i, node) in search.nodes.iter().enumerate() {
        if node.attached.len() != base.len() + extras + 1 {
            continue;
        }
        let mut rest = node.key(extras);
        rest.retain(|code| !base.contains(code));
        let &[other] = rest.as_slice() else {
            continue;
        };
        if other == code || rivals.iter().any(|r| r.0 == other) {
            continue;
        }
        let lack = search.worth.gain(node.cost() - search.nodes[chosen].cost());
        doubt += (-lack / (2.0 + 0.02 * loss)).exp();
        if lack < told_apart(node, loss, alike) {
            rivals.push((other, i, lack));
        }
    }
    rivals.sort_by(|a, b| a.2.total_cmp(&b.2));
    Named {
        place,
        without: minus,
        loss,
        confidence: 1.0 / (1.0 + doubt.powf(SHARPNESS)),
        rivals,
    }
}

fn intervals(bench: &FitContext<'_>, node: &Node, worth: Worth) -> Confidence {
    let structure = ModelStructure::new(bench.setup, bench.data, node.attached.clone());
    let mut evaluator = Evaluator::new(&structure, bench.threads);
    let mut residuals = vec![0.0; structure.count()];
    evaluator.residuals(&node.values, &mut residuals);
    let mut found = confidence(&mut evaluator, &node.values, &residuals, 1e-5);
    // Zeros of held-out points pass for a perfect fit there; only what was fitted tells the variance.
    let wider = (residuals.len() as f64 / bench.data.count(Split::Fit).max(1) as f64).sqrt();
    for ((interval, sigma), value) in found.ci95.iter_mut().zip(&mut found.sigma).zip(&node.values) {
        *sigma *= wider;
        if let Some(ends) = interval {
            *ends = ends.map(|end| value + wider * (end - value));
        }
    }
    if let Some((settled, tangent)) = bench.settled(node) {
        let rise = RISE * worth.spread * worth.correlation;
        for (k, attached) in node.attached.iter().enumerate() {
            for &(i, axis) in attached.effect.kinks {
                let place = offset(bench, &node.attached, k) + i;
                let width = bench.span.width(axis);
                let profiled = profile(&structure, &settled, &tangent, place, width, rise);
                found.ci95[place] = match (found.ci95[place], profiled) {
                    (Some(a), Some(b)) => Some([a[0].min(b[0]), a[1].max(b[1])]),
                    (a, b) => a.or(b),
                };
            }
        }
    }
    found
}

fn alarms(bench: &FitContext<'_>, node: &Node, confidence: &Confidence) -> Vec<String> {
    let own = bench.setup.model.parameters.len();
    let names: Vec<&str> = bench.setup.model.parameters.iter().map(|p| p.name).collect();
    // Held parameters are no finding of the fit; what they are is said below.
    let held = |warning: &Warning| {
        let of = |name: &str| {
            bench
                .setup
                .surrogate
                .as_ref()
                .zip(names.iter().position(|n| *n == name))
        };
        matches!(warning, Warning::NotIdentifiable { names, .. } if names.iter().any(|n| of(n).is_some_and(|(s, k)| s.holds(k))))
    };
    let mut alarms: Vec<String> = confidence
        .warnings
        .iter()
        .filter(|w| !held(w))
        .map(ToString::to_string)
        .filter(|text| names.iter().any(|n| text.contains(n)))
        .collect();
    alarms.extend(bench.setup.surrogate.iter().flat_map(|s| s.remarks()));
    let zero_n = node.values[node.values.len() - 1];
    if zero_n.abs() > 4.0 * bench.data.zero_sigma_n {
        alarms.push(format!(
            "the force channel's zero is off by {zero_n:.1} N: check the tare"
        ));
    }
    debug_assert!(own <= node.values.len());
    let lowest_n = bench.span.force_n[0];
    if lowest_n < -0.05 * bench.data.force_range_n {
        alarms.push(format!(
            "the force goes down to {lowest_n:.0} N: a spring under a pusher cannot pull, so check sign and zero, or another device was measured"
        ));
    }
    for track in &bench.data.tracks {
        alarms.extend(track.remarks.iter().map(|r| format!("{}: {r}", track.name)));
    }
    alarms
}

fn finding(
    bench: &FitContext<'_>,
    node: &Node,
    named: &Named,
    confidence: &Confidence,
    left: f64,
) -> Finding {
    let attached = &node.attached[named.place];
    let from = offset(bench, &node.attached, named.place);
    let group = &node.values[from..from + attached.parameters.len()];
    Finding {
        code: attached.effect.code.to_owned(),
        confidence: (named.confidence * (1.0 - left * left)).clamp(0.0, 0.99),
        statement: (attached.effect.statement)(group),
        parameters: values_of(&attached.parameters, from, node, confidence),
        gain: Some(named.loss),
    }
}

fn alternative(bench: &FitContext<'_>, node: &Node, named: &Named, code: &str, lack: f64) -> Alternative {
    let effect = node.attached[named.place].effect;
    let other = crate::effect::find(code).ok();
    let known = effect
        .confusable_with
        .iter()
        .find(|r| r.code == code)
        .or_else(|| other.and_then(|o| o.confusable_with.iter().find(|r| r.code == effect.code)));
    let reason = known.map_or("the recordings do not excite the difference", |r| r.why);
    debug_assert!(bench.threads > 0);
    Alternative {
        code: code.to_owned(),
        instead_of: effect.code.to_owned(),
        why: format!(
            "{reason}; it fits worse by only {lack:.1} of {:.0} in log-likelihood",
            named.loss
        ),
        test: known
            .map_or("a recording at another speed, mean load and amplitude", |r| {
                r.test
            })
            .to_owned(),
    }
}

fn locations(
    bench: &FitContext<'_>,
    [plain, before, after]: [&Node; 3],
    named: &[Named],
    unexplained: bool,
) -> Vec<Location> {
    let jacobian = |node: &Node| {
        let structure = ModelStructure::new(bench.setup, bench.data, node.attached.clone());
        let residuals = structure.fitted(&node.values);
        residuals.map_or_else(
            || nalgebra::DMatrix::zeros(structure.count(), 0),
            |r| structure.sensitivities(&node.values, &r).0,
        )
    };
    if unexplained {
        // Where the baseline goes wrong, then where what is left lies: freeing its friction may have moved it.
        let mut list = residual::locate(bench.data, &plain.residuals, &jacobian(plain));
        if turns_otherwise(bench, plain, before) {
            // What a freer turn-round takes away lies after the reversals, wherever else it shows.
            list.sort_by_key(|l| l.axis != Axis::DistanceFromReversalMm);
        }
        let left = residual::locate(bench.data, &after.residuals, &jacobian(after));
        list.extend(left.into_iter().filter(|l| l.share > LEFT_SHARE));
        return list;
    }
    let mut list = Vec::new();
    for n in named {
        let attached = &after.attached[n.place];
        let from = offset(bench, &after.attached, n.place);
        let group = &after.values[from..from + attached.parameters.len()];
        if let Some(place) = (attached.effect.place)(group, &bench.span) {
            let share = residual::share_in(bench.data, &before.residuals, &place);
            list.push(Location {
                axis: place.axis,
                from: place.from,
                to: place.to,
                direction: place.branch,
                share,
                words: residual::words(place.axis, place.from, place.to, place.branch, share),
            });
        }
    }
    let found = residual::locate(bench.data, &before.residuals, &jacobian(before));
    if !named.is_empty() {
        list.extend(
            found
                .into_iter()
                .filter(|f| list.iter().all(|l: &Location| l.axis != f.axis))
                .collect::<Vec<_>>(),
        );
    }
    list
}

fn improved(bench: &FitContext<'_>, node: &Node) -> ImprovedModel {
    let model = bench.setup.model;
    let named = |parameters: &[crate::model::Parameter], from: usize| -> Vec<(String, f64)> {
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
        parameters: named(model.parameters, 0),
        structure: bench.setup.structure.clone(),
        effects: order
            .into_iter()
            .map(|k| AttachedEffect {
                code: node.attached[k].effect.code.to_owned(),
                parameters: named(&node.attached[k].parameters, offset(bench, &node.attached, k)),
            })
            .collect(),
        force_zero_n: node.values[node.values.len() - 1],
    }
}

fn summary(verdict: Verdict, effects: &[Finding], location: &[Location], fit: &FitErrors) -> String {
    match verdict {
        Verdict::Adequate => format!(
            "The baseline explains the recordings: {:.2} % error on cycles it was not fitted on, noise {:.2} %.",
            100.0 * fit.improved.nrmse_heldout,
            100.0 * fit.noise_floor_nrmse
        ),
        Verdict::MissingPhysics => format!(
            "Missing: {}. The error on cycles not fitted on falls from {:.2} % to {:.2} %, noise {:.2} %.",
            effects
                .iter()
                .map(|e| e.code.replace('_', " "))
                .collect::<Vec<_>>()
                .join(" and "),
            100.0 * fit.baseline.nrmse_heldout,
            100.0 * fit.improved.nrmse_heldout,
            100.0 * fit.noise_floor_nrmse
        ),
        Verdict::Unexplained => format!(
            "Nothing in the library explains the difference{}.",
            location
                .first()
                .map_or(String::new(), |l| format!(": {}", l.words))
        ),
    }
}
