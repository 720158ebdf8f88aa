//! Findings from the points of one loop (Table 5-1 of the Chula thesis), against the thesis' envelope lines.
//!
//! ```text
//! loading    F = a + k u + c u'^2 / 2 - A exp(-s/L)       u displacement, u' from mid travel, s travel since the branch began
//! unloading  F = b + k u + c u'^2 / 2 + B exp(-s/L)
//! ```
//! `A`, `B` and `L` are the transitions at the two ends; `c` the stiffness that changes with deflection, left out where the
//! points do not show it. `L` is searched on a grid, its interval is where the fit is not worse than Fisher's F allows.

use super::regression::{Estimate, RegressionLine, line};
use super::table::{Points, TargetsTable};
use super::{AggregateDiagnosis, Compared, Errors, FitErrors, not_testable};
use crate::diagnose::diagnosis::{
    Alternative, Axis, Branch, Finding, ImprovedModel, Location, Value, Verdict,
};
use crate::identify::{Fit, IdentifyError, confidence::student_975};
use crate::model::five_link;
use crate::papers::second::{FiveLinkRerun, rerun_over};

/// Fewer points on a branch have no chords to compare.
const LEAST: usize = 4;
/// An envelope that misses by this share of the force range is adequate for points read off by hand.
const ADEQUATE: f64 = 0.015;
/// Transition lengths that are tried, as shares of the travel.
const LENGTHS: [f64; 2] = [0.01, 1.0];
const TRIED: usize = 120;
/// Part of the travel at either end that counts as the end.
const END: f64 = 0.17;
const SURE: f64 = 0.95;

pub(super) fn diagnose(table: &TargetsTable, threads: usize) -> Result<AggregateDiagnosis, IdentifyError> {
    let Points { loading, unloading } = &table.points;
    let all: Vec<(f64, f64)> = loading.iter().chain(unloading).copied().collect();
    let rerun = rerun_over(&all, loading.len(), threads)?;
    let [envelope, ours] = [&rerun.rows[0], &rerun.rows[3]];
    let range_n = span(all.iter().map(|p| p.1)).1.max(f64::MIN_POSITIVE);
    let mut out = blank(table, &all, &rerun, range_n);
    if envelope.rms_n < ADEQUATE * range_n {
        out.verdict = Verdict::Adequate;
        out.summary = format!(
            "The envelope lines give the points within {:.0} N RMS.",
            envelope.rms_n
        );
        return Ok(out);
    }
    let residuals: Vec<f64> = all.iter().zip(&envelope.force_n).map(|(p, f)| p.1 - f).collect();
    let enough = loading.len() >= LEAST && unloading.len() >= LEAST;
    if let Some(found) = enough.then(|| transition(&table.points)).flatten() {
        ends(&all, &residuals, &table.points, &found, &mut out);
        softening(&found, &mut out);
    }
    out.not_testable = not_testable(&out.effects, &out.excluded, why);
    conclude(&mut out, envelope.rms_n, ours.rms_n);
    Ok(out)
}

fn span(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
        (l.min(v), h.max(v))
    });
    (low, high - low)
}

fn blank(
    table: &TargetsTable,
    all: &[(f64, f64)],
    rerun: &FiveLinkRerun,
    range_n: f64,
) -> AggregateDiagnosis {
    let error = |i: usize| Errors {
        nrmse_train: Some(rerun.rows[i].rms_n / range_n),
        ..Errors::default()
    };
    let branch = |i: usize| {
        if i < table.points.loading.len() {
            "loading"
        } else {
            "unloading"
        }
    };
    let model = |k: usize, i: usize| Some([all[i].0, rerun.rows[k].force_n[i]]);
    AggregateDiagnosis {
        verdict: Verdict::Unexplained,
        summary: String::new(),
        effects: Vec::new(),
        alternatives: Vec::new(),
        location: Vec::new(),
        fit: FitErrors {
            baseline: error(0),
            improved: error(3),
            ..FitErrors::default()
        },
        next_test: None,
        excluded: Vec::new(),
        alarms: rerun.fit.warnings.iter().map(ToString::to_string).collect(),
        alarm_figures: Vec::new(),
        not_testable: not_testable(&[], &[], why),
        columns: ["displacement in mm".to_owned(), "force in N".to_owned()],
        models: [0, 1, 3].map(|k: usize| rerun.rows[k].model.to_owned()),
        rows: (0..all.len())
            .map(|i| Compared {
                name: format!("{} at {:.1} mm", branch(i), all[i].0),
                measured: [all[i].0, all[i].1],
                model: model(0, i),
                optimum: model(1, i),
                ours: model(3, i),
            })
            .collect(),
        parameters: (rerun
            .fit
            .parameters
            .iter()
            .zip(&rerun.fit.values)
            .zip(&rerun.fit.ci95))
        .map(|((p, value), ci95)| Value {
            name: p.name.to_owned(),
            value: *value,
            unit: p.unit.to_owned(),
            ci95: *ci95,
        })
        .collect(),
        improved: vec![("loop".to_owned(), improved(&rerun.fit))],
        remarks: table.remarks.clone(),
    }
}

/// The five-link spring as the points have it.
fn improved(fit: &Fit) -> ImprovedModel {
    let named = fit.parameters.iter().zip(&fit.values);
    ImprovedModel {
        model: five_link::MODEL.name.to_owned(),
        parameters: named.map(|(p, value)| (p.name.to_owned(), *value)).collect(),
        structure: toml::Table::new(),
        effects: Vec::new(),
        force_zero_n: 0.0,
    }
}

/// Between two neighbours of a branch.
struct Chord {
    slope: f64,
    /// Travel since the branch began.
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

struct Transition {
    /// Columns: a, b, k, A, B, and c where it was asked for.
    fit: RegressionLine,
    travel_mm: f64,
    length_mm: f64,
    length_ci_mm: [f64; 2],
}

impl Transition {
    /// Stiffness where the transitions are over, N/mm.
    fn rate(&self) -> Estimate {
        self.fit.columns[2]
    }

    /// What the transition at the lower and the upper end hides of the branch, N.
    fn hidden_n(&self) -> [Estimate; 2] {
        [self.fit.columns[3], self.fit.columns[4]]
    }

    /// Change of stiffness with deflection, N/mm2, where it was asked for.
    fn change(&self) -> Option<Estimate> {
        self.fit.columns.get(5).copied()
    }
}

/// With the stiffness that changes with deflection where the points show one beside the transition.
fn transition(points: &Points) -> Option<Transition> {
    let with = search(points, true);
    let shown = |t: &Transition| t.change().is_some_and(|c| c.times(-1.0).above(0.0) >= SURE);
    with.filter(shown).or_else(|| search(points, false))
}

fn search(points: &Points, bent: bool) -> Option<Transition> {
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
            row.extend(bent.then_some(0.5 * (u - low - 0.5 * travel_mm).powi(2)));
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
    // The length is one parameter more: F(1, n) is Student's t squared.
    let spare = (fit.columns[0].spare - 1.0).max(1.0);
    let allowed = fit.scatter * (1.0 + student_975(spare).powi(2) / spare).sqrt();
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

/// Both ends: where the envelope misses, and how long the transition is.
fn ends(
    all: &[(f64, f64)],
    residuals: &[f64],
    points: &Points,
    found: &Transition,
    out: &mut AggregateDiagnosis,
) {
    let (low, travel_mm) = span(all.iter().map(|p| p.0));
    let square = |from: f64, to: f64| -> f64 {
        let inside = all
            .iter()
            .zip(residuals)
            .filter(|(p, _)| (from..=to).contains(&p.0));
        inside.map(|(_, r)| r * r).sum()
    };
    let total = square(low, low + travel_mm);
    let mut place = |what: &str, from: f64, to: f64| {
        let share = square(from, to) / total;
        out.location.push(Location {
            axis: Axis::DisplacementMm,
            from,
            to,
            direction: Branch::Both,
            share,
            words: format!(
                "{:.0} % of the envelope's error lies at the {what} end, {from:.1} to {to:.1} mm, on both branches",
                100.0 * share
            ),
        });
        share
    };
    let lower = place("lower", low, low + END * travel_mm);
    let upper = place("upper", low + (1.0 - END) * travel_mm, low + travel_mm);
    let hidden = found.hidden_n();
    let sure = hidden.iter().map(|h| h.above(0.0)).fold(1.0, f64::min);
    // Ends that held no more than their part of the travel would be no ends.
    if sure < SURE || lower + upper < 3.0 * END {
        return;
    }
    let [a, b] = found.length_ci_mm;
    let chords: Vec<Chord> = [&points.loading, &points.unloading]
        .into_iter()
        .flat_map(|branch| chords(branch))
        .collect();
    let mut parameters = vec![
        Value {
            name: "transition_length_mm".to_owned(),
            value: found.length_mm,
            unit: "mm".to_owned(),
            ci95: Some(found.length_ci_mm),
        },
        hidden[0].named("force that the transition at the lower end takes away", "N"),
        hidden[1].named("force that the transition at the upper end adds", "N"),
        share_of_ends(lower + upper),
        found
            .rate()
            .named("stiffness where the transitions are over", "N/mm"),
    ];
    let softer = softening_since(&chords);
    parameters.extend(softer.map(|s| {
        s.named(
            "softening: change of stiffness with travel along a branch",
            "N/mm\u{b2}",
        )
    }));
    let begin = chords.first().map_or(f64::NAN, |c| c.slope);
    let least = chords.iter().map(|c| c.slope).fold(f64::INFINITY, f64::min);
    out.effects.push(Finding {
        gain: None,
        code: "presliding".to_owned(),
        confidence: sure,
        statement: format!(
            "Both ends of the loop are round: after a reversal the spring turns to the other branch gradually, over about {:.0} mm ({a:.0} to \
             {b:.0} mm), so that either branch softens from {begin:.0} to {least:.0} N/mm. The envelope lines have one slope and jump at the \
             ends: {:.0} % of their error lies there.",
            found.length_mm,
            100.0 * (lower + upper)
        ),
        parameters,
    });
}

fn share_of_ends(share: f64) -> Value {
    Value {
        name: "share of the envelope's squared error at both ends".to_owned(),
        value: share,
        unit: String::new(),
        ci95: None,
    }
}

/// A stiffness that falls with deflection on both branches, beyond the transition.
fn softening(found: &Transition, out: &mut AggregateDiagnosis) {
    let Some(change) = found.change() else {
        if !out.effects.is_empty() {
            out.alternatives.push(Alternative {
                code: "geometric_stiffness".to_owned(),
                instead_of: "presliding".to_owned(),
                why: "the branches soften along their way; a part of that may be the linkage's geometry, which a dozen points do not tell \
                      from a long transition"
                    .to_owned(),
                test: "loops of several amplitudes: a transition starts at each reversal, geometry stays with the deflection".to_owned(),
            });
        }
        return;
    };
    let fall = change.times(-1.0);
    out.effects.push(Finding {
        gain: None,
        code: "geometric_stiffness".to_owned(),
        confidence: fall.above(0.0),
        statement: format!(
            "The spring softens as it goes down: beyond the transition its stiffness falls by {:.2} N/mm with each mm, {:.0} N/mm over the \
             test, on both branches. The envelope has one slope.",
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
        | "channel_delay" => {
            "rate effects: one loop, loaded by hand point by point; no rate was told or changed"
        }
        "load_dependent_friction" | "coulomb_friction" => {
            "one amplitude and a dozen points: the loop's height and its slope are not told apart by them"
        }
        "run_in" | "sensor_drift" => "one loop has no second one to compare with",
        "geometric_stiffness" => {
            "the chords' slopes do not say beyond their scatter whether stiffness changes with deflection"
        }
        "presliding" => "the chords' slopes do not show a transition beyond their scatter",
        _ => "a dozen points do not show it beyond their scatter",
    }
}

fn conclude(out: &mut AggregateDiagnosis, envelope_n: f64, ours_n: f64) {
    let misses = format!(
        "The envelope lines miss the points by {envelope_n:.0} N RMS, the five-link spring with transition, bent stiffness and preload by {ours_n:.0} N."
    );
    if out.effects.is_empty() {
        out.summary = format!("{misses} The points do not say by which physics.");
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
