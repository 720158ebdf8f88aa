//! Findings from the points of one loop, against the envelope lines of the five-link model.
//!
//! ```text
//! loading    F = a + k u + c u'^2 / 2 - A exp(-s/L)       u displacement, u' from mid travel, s travel since the branch began
//! unloading  F = b + k u + c u'^2 / 2 + B exp(-s/L)
//! ```
//! `A`, `B` and `L` describe the transitions at the two ends; `c` is the change of stiffness with deflection, left out where
//! the points do not show it. `L` is searched on a grid; its interval holds the lengths that Fisher's F allows.

use super::regression::{Estimate, RegressionLine, line};
use super::table::{Points, TargetsTable};
use super::{AggregateDiagnosis, AggregateErrors, Compared, fitted_values, not_testable};
use crate::diagnose::diagnosis::{
    Alternative, Axis, Branch, Finding, ImprovedModel, Location, Value, Verdict,
};
use crate::identify::loop_points::{FiveLinkComparison, LoadDeflectionRow, LoopPoints, compare_five_link};
use crate::identify::{Fit, IdentifyError, confidence::student_975};
use crate::model::five_link;

/// Smallest number of points on a branch that shows a transition.
const LEAST: usize = 4;
/// Envelope lines with an RMS error below this share of the force range are adequate for points that were read by hand.
const ADEQUATE: f64 = 0.015;
/// Shortest and longest transition that is tried, as shares of the travel.
const LENGTHS: [f64; 2] = [0.01, 1.0];
/// Number of steps between them.
const TRIED: usize = 120;
/// Share of the travel at either end that counts as the end.
const END: f64 = 0.17;
/// Confidence from which on a finding is reported.
const SURE: f64 = 0.95;

pub(super) fn diagnose(table: &TargetsTable, threads: usize) -> Result<AggregateDiagnosis, IdentifyError> {
    let Points { loading, unloading } = &table.points;
    let all: Vec<(f64, f64)> = loading.iter().chain(unloading).copied().collect();
    let loop_points = LoopPoints {
        points: &all,
        loading: loading.len(),
    };
    let models = compare_five_link(&loop_points, threads)?;
    let range_n = span(all.iter().map(|p| p.1)).1.max(f64::MIN_POSITIVE);
    let mut out = without_findings(table, &all, &models, range_n);
    if models.envelope.rms_n < ADEQUATE * range_n {
        out.verdict = Verdict::Adequate;
        out.summary = format!(
            "The envelope lines agree with the points within {:.0} N RMS.",
            models.envelope.rms_n
        );
        return Ok(out);
    }
    let residuals: Vec<f64> = all
        .iter()
        .zip(&models.envelope.force_n)
        .map(|(p, f)| p.1 - f)
        .collect();
    let enough = loading.len() >= LEAST && unloading.len() >= LEAST;
    if let Some(found) = enough.then(|| transition(&table.points)).flatten() {
        ends(&all, &residuals, &table.points, &found, &mut out);
        softening(&found, &mut out);
    }
    out.not_testable = not_testable(&out.effects, &out.excluded, why);
    conclude(&mut out, models.envelope.rms_n, models.preloaded.rms_n);
    Ok(out)
}

/// Smallest value and width of the range.
fn span(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
        (l.min(v), h.max(v))
    });
    (low, high - low)
}

fn without_findings(
    table: &TargetsTable,
    all: &[(f64, f64)],
    models: &FiveLinkComparison,
    range_n: f64,
) -> AggregateDiagnosis {
    let error = |row: &LoadDeflectionRow| AggregateErrors {
        nrmse_train: Some(row.rms_n / range_n),
        ..AggregateErrors::default()
    };
    let shown = [&models.envelope, &models.printed, &models.preloaded];
    let mut out = AggregateDiagnosis::new(
        ["displacement in mm", "force in N"],
        shown.map(|row| row.model),
        compared(all, table.points.loading.len(), shown),
        why,
        &table.remarks,
    );
    out.fit.baseline = error(&models.envelope);
    out.fit.improved = error(&models.preloaded);
    out.alarms = models.fit.warnings.iter().map(ToString::to_string).collect();
    out.parameters = fitted_values(&models.fit, |_| true);
    out.improved = vec![("loop".to_owned(), improved(&models.fit))];
    out
}

/// Point by point: measured, and the three models.
fn compared(all: &[(f64, f64)], loading: usize, models: [&LoadDeflectionRow; 3]) -> Vec<Compared> {
    let branch = |i: usize| if i < loading { "loading" } else { "unloading" };
    (0..all.len())
        .map(|i| {
            let [model, optimum, ours] = models.map(|row| Some([all[i].0, row.force_n[i]]));
            Compared {
                name: format!("{} at {:.1} mm", branch(i), all[i].0),
                measured: [all[i].0, all[i].1],
                model,
                optimum,
                ours,
            }
        })
        .collect()
}

/// The fitted five-link spring as a model.
fn improved(fit: &Fit) -> ImprovedModel {
    let named = fit.parameters.iter().zip(&fit.values);
    ImprovedModel {
        model: five_link::MODEL.name.to_owned(),
        parameters: named.map(|(p, value)| (p.name.to_owned(), *value)).collect(),
        structure: toml::Table::new(),
        effects: Vec::new(),
        law: None,
        force_zero_n: 0.0,
    }
}

/// The line between two neighbouring points of a branch.
struct Chord {
    /// Slope between the two points, N/mm.
    slope: f64,
    /// Travel since the branch began, mm, at both points.
    since_mm: [f64; 2],
}

fn chords(branch: &[(f64, f64)]) -> Vec<Chord> {
    let Some(begin) = branch.first() else {
        return Vec::new();
    };
    let chord = |w: &[(f64, f64)]| Chord {
        slope: (w[1].1 - w[0].1) / (w[1].0 - w[0].0),
        since_mm: [(w[0].0 - begin.0).abs(), (w[1].0 - begin.0).abs()],
    };
    branch.windows(2).map(chord).collect()
}

/// The fitted law of the transitions.
struct Transition {
    /// Columns: a, b, k, A, B, and c where it is fitted.
    fit: RegressionLine,
    travel_mm: f64,
    length_mm: f64,
    length_ci_mm: [f64; 2],
}

impl Transition {
    /// Stiffness outside the transitions, N/mm.
    fn rate(&self) -> Estimate {
        self.fit.columns[2]
    }

    /// Force A and B that the transitions at the lower and the upper end make, N.
    fn forces_n(&self) -> [Estimate; 2] {
        [self.fit.columns[3], self.fit.columns[4]]
    }

    /// Change of stiffness with deflection, N/mm2, where it is fitted.
    fn change(&self) -> Option<Estimate> {
        self.fit.columns.get(5).copied()
    }
}

/// The transitions, with a stiffness that changes with deflection where the points show one.
fn transition(points: &Points) -> Option<Transition> {
    let with = search(points, true);
    let shown = |t: &Transition| t.change().is_some_and(|c| c.times(-1.0).above(0.0) >= SURE);
    with.filter(shown).or_else(|| search(points, false))
}

/// The transition length with the smallest scatter; `changing` also fits the change of stiffness.
fn search(points: &Points, changing: bool) -> Option<Transition> {
    let both = || points.loading.iter().chain(&points.unloading);
    let (low, travel_mm) = span(both().map(|p| p.0));
    let (begin, top) = (points.loading.first()?.0, low + travel_mm);
    let force_n: Vec<f64> = both().map(|p| p.1).collect();
    let at = |length_mm: f64| {
        let row = |u: f64, up: bool| {
            let since = if up { u - begin } else { top - u };
            let fade = (-since / length_mm).exp();
            let [up, down] = if up { [1.0, 0.0] } else { [0.0, 1.0] };
            let mut row = vec![up, down, u, -up * fade, down * fade];
            row.extend(changing.then_some(0.5 * (u - low - 0.5 * travel_mm).powi(2)));
            row
        };
        let loading = points.loading.iter().map(|p| row(p.0, true));
        let design: Vec<_> = loading
            .chain(points.unloading.iter().map(|p| row(p.0, false)))
            .collect();
        line(&design, &force_n).map(|fit| (length_mm, fit))
    };
    let [short, long] = LENGTHS.map(|share| share * travel_mm);
    let tried = (0..=TRIED).map(|i| short * (long / short).powf(i as f64 / TRIED as f64));
    let fits: Vec<(f64, RegressionLine)> = tried.filter_map(at).collect();
    let (length_mm, fit) = fits
        .iter()
        .min_by(|a, b| a.1.scatter.total_cmp(&b.1.scatter))?
        .clone();
    // The length is one more parameter: F(1, n) is Student's t squared.
    let degrees = (fit.columns[0].degrees - 1.0).max(1.0);
    let allowed = fit.scatter * (1.0 + student_975(degrees).powi(2) / degrees).sqrt();
    let fair = fits.iter().filter(|(_, f)| f.scatter <= allowed).map(|(l, _)| *l);
    let (shortest, width) = span(fair);
    Some(Transition {
        fit,
        travel_mm,
        length_mm,
        length_ci_mm: [shortest, shortest + width],
    })
}

/// How the stiffness of a branch changes with the travel since it began, N/mm2.
fn softening_since(chords: &[Chord]) -> Option<Estimate> {
    let design: Vec<_> = chords
        .iter()
        .map(|c| vec![1.0, 0.5 * (c.since_mm[0] + c.since_mm[1])])
        .collect();
    let slopes: Vec<f64> = chords.iter().map(|c| c.slope).collect();
    line(&design, &slopes).map(|l| l.columns[1])
}

/// The ends of the loop: how much of the envelope's error is there, and how long the transitions are.
fn ends(
    all: &[(f64, f64)],
    residuals: &[f64],
    points: &Points,
    found: &Transition,
    out: &mut AggregateDiagnosis,
) {
    let (low, travel_mm) = span(all.iter().map(|p| p.0));
    let high = low + travel_mm;
    let square = |from: f64, to: f64| -> f64 {
        let inside = all
            .iter()
            .zip(residuals)
            .filter(|(p, _)| (from..=to).contains(&p.0));
        inside.map(|(_, r)| r * r).sum()
    };
    let total = square(low, high);
    let mut at_ends = 0.0;
    for (what, from, to) in [
        ("lower", low, low + END * travel_mm),
        ("upper", low + (1.0 - END) * travel_mm, high),
    ] {
        let share = square(from, to) / total;
        at_ends += share;
        out.location.push(Location {
            axis: Axis::DisplacementMm,
            from,
            to,
            direction: Branch::Both,
            share,
            words: format!(
                "{:.0} % of the envelope's squared error is at the {what} end, {from:.1} to {to:.1} mm, on both branches",
                100.0 * share
            ),
        });
    }
    let sure = found
        .forces_n()
        .iter()
        .map(|force| force.above(0.0))
        .fold(1.0, f64::min);
    // Both ends together must hold more of the error than 1.5 times their share of the travel.
    if sure >= SURE && at_ends >= 3.0 * END {
        out.effects.push(rounded_ends(points, found, at_ends, sure));
    }
}

/// The finding of a gradual transition; `at_ends` is the share of the envelope's squared error at the ends.
fn rounded_ends(points: &Points, found: &Transition, at_ends: f64, sure: f64) -> Finding {
    let chords: Vec<Chord> = [&points.loading, &points.unloading]
        .into_iter()
        .flat_map(|branch| chords(branch))
        .collect();
    let [lower_n, upper_n] = found.forces_n();
    let figure = |name: &str, value: f64, unit: &str, ci95| Value {
        name: name.to_owned(),
        value,
        unit: unit.to_owned(),
        ci95,
    };
    let mut parameters = vec![
        figure(
            "transition_length_mm",
            found.length_mm,
            "mm",
            Some(found.length_ci_mm),
        ),
        lower_n.named("force that the transition at the lower end takes away", "N"),
        upper_n.named("force that the transition at the upper end adds", "N"),
        figure(
            "share of the envelope's squared error at both ends",
            at_ends,
            "",
            None,
        ),
        found.rate().named("stiffness outside the transitions", "N/mm"),
    ];
    parameters.extend(softening_since(&chords).map(|s| {
        s.named(
            "softening: change of stiffness with travel along a branch",
            "N/mm\u{b2}",
        )
    }));
    let begin = chords.first().map_or(f64::NAN, |c| c.slope);
    let least = chords.iter().map(|c| c.slope).fold(f64::INFINITY, f64::min);
    let [shortest, longest] = found.length_ci_mm;
    Finding {
        group: Vec::new(),
        size_spread: None,
        gain: None,
        code: "presliding".to_owned(),
        confidence: sure,
        statement: format!(
            "Both ends of the loop are rounded: after a reversal the force moves gradually to the other branch, over about {:.0} mm \
             ({shortest:.0} to {longest:.0} mm), and the stiffness of a branch falls from {begin:.0} to {least:.0} N/mm. The envelope \
             lines have one slope and a step at each end: {:.0} % of their squared error is there.",
            found.length_mm,
            100.0 * at_ends
        ),
        parameters,
    }
}

/// A stiffness that falls with deflection on both branches, apart from the transitions.
fn softening(found: &Transition, out: &mut AggregateDiagnosis) {
    let Some(change) = found.change() else {
        if !out.effects.is_empty() {
            out.alternatives.push(Alternative {
                code: "geometric_stiffness".to_owned(),
                instead_of: "presliding".to_owned(),
                why: "each branch softens along its way; part of that may be the geometry of the linkage, and a dozen points cannot \
                      separate it from a long transition"
                    .to_owned(),
                test: "record loops of several amplitudes: a transition starts at each reversal, geometry follows the deflection"
                    .to_owned(),
            });
        }
        return;
    };
    let fall = change.times(-1.0);
    out.effects.push(Finding {
        group: Vec::new(),
        size_spread: None,
        gain: None,
        code: "geometric_stiffness".to_owned(),
        confidence: fall.above(0.0),
        statement: format!(
            "The spring softens with deflection: apart from the transitions its stiffness falls by {:.2} N/mm per mm, {:.0} N/mm over \
             the test, on both branches. The envelope lines have one slope.",
            fall.value,
            fall.value * found.travel_mm
        ),
        parameters: vec![
            change.named("change of stiffness with deflection", "N/mm\u{b2}"),
            found.rate().named("stiffness at mid travel", "N/mm"),
        ],
    });
}

fn why(code: &str) -> &'static str {
    match code {
        "rate_independent_friction"
        | "viscous_damping"
        | "stribeck"
        | "inertia"
        | "relaxation"
        | "channel_delay" => "a rate effect: one loop, loaded by hand point by point, at one unknown rate",
        "load_dependent_friction" | "coulomb_friction" => {
            "one amplitude and a dozen points do not separate the height of the loop from its slope"
        }
        "run_in" | "sensor_drift" | "warming" => "there is only one loop",
        "geometric_stiffness" => "a change of stiffness with deflection is within the scatter of the points",
        "presliding" => "a transition is within the scatter of the points",
        _ => "its effect is within the scatter of a dozen points",
    }
}

fn conclude(out: &mut AggregateDiagnosis, envelope_n: f64, ours_n: f64) {
    let misses = format!(
        "The envelope lines differ from the points by {envelope_n:.0} N RMS, the fitted five-link spring with preload by {ours_n:.0} N."
    );
    if out.effects.is_empty() {
        out.summary = format!("{misses} The points do not show which physics is missing.");
        return;
    }
    out.verdict = Verdict::MissingPhysics;
    let words: Vec<&str> = out
        .effects
        .iter()
        .map(|f| match f.code.as_str() {
            "presliding" => "the gradual transition after a reversal at both ends of the loop",
            _ => "a stiffness that falls with deflection",
        })
        .collect();
    out.summary = format!(
        "The envelope lacks {}. {misses} Rate effects are not testable.",
        words.join(" and ")
    );
}
