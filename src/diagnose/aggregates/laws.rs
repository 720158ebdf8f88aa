//! Laws of the loop energy over rate, load and stroke, fitted to peak forces and loop energies.
//!
//! ```text
//! rate    ln E = a_mount + p_mount ln F + q ln f        q = 0 where friction does not depend on the rate
//! stroke  ln E = c + e ln S                             e = 1 for constant friction, above where friction grows with load
//! load    E / S = 2 Fc (1 - r/(1+r)) + 2 r/(1+r) F_mean    level at no load: constant friction; slope: friction that grows with load
//! pairs   E(f2) / E(f1) - 1 = s (f2 / f1 - 1)           s: viscous share of the loss at f1, same stroke
//! ```
//! `F_mean` is halfway between the peak and the force at no stroke, from a line of peak force over stroke. The intervals come
//! from the scatter of the tests about these laws; tests that follow no law are not used as evidence.

use super::AggregateDiagnosis;
use super::regression::{Estimate, RegressionLine, line};
use super::table::{TableRow, mounts};
use crate::diagnose::diagnosis::{Alternative, Finding, Value};
use crate::identify::targets::Aggregate;

/// Exponent over the rate below which the loss hardly changes: 12 % per decade.
const FLAT: f64 = 0.05;
/// A share of the loss below this is small.
const SMALL: f64 = 0.1;
/// Confidence from which on a finding is reported.
const SURE: f64 = 0.95;

/// `ln E = a_mount + p_mount ln F + q ln f`; the last column is q, where the frequencies differ.
pub(super) fn power_law(
    rows: &[TableRow],
    of: impl Fn(&TableRow) -> Option<Aggregate>,
) -> Option<RegressionLine> {
    let mounts = mounts(rows);
    let frequencies = rows.iter().any(|r| r.frequency_hz != rows[0].frequency_hz);
    let (mut design, mut y) = (Vec::new(), Vec::new());
    for row in rows {
        let figures = of(row)?;
        let mut columns = vec![0.0; 2 * mounts.len()];
        let at = mounts.iter().position(|m| *m == row.mount)?;
        columns[2 * at] = 1.0;
        columns[2 * at + 1] = figures.peak_force_n.ln();
        if frequencies {
            columns.push(row.frequency_hz.ln());
        }
        design.push(columns);
        y.push(figures.loop_energy_j.ln());
    }
    line(&design, &y)
}

/// The exponent over the rate; `None` where all tests have the same rate.
fn rate_exponent(law: &RegressionLine) -> Option<&Estimate> {
    law.columns.last().filter(|_| law.columns.len() % 2 == 1)
}

fn is_flat(q: &Estimate) -> bool {
    q.ci95().iter().all(|v| v.abs() <= FLAT)
}

/// Friction that does not vanish at low speed. True where the measured loss does not depend on the rate.
pub(super) fn rate(
    rows: &[TableRow],
    measured: &RegressionLine,
    model: Option<&RegressionLine>,
    out: &mut AggregateDiagnosis,
) -> bool {
    let (Some(q), Some(qm)) = (rate_exponent(measured), model.and_then(rate_exponent)) else {
        return false;
    };
    if !is_flat(q) {
        return false;
    }
    let apart = qm.minus(q);
    let slow = rows
        .iter()
        .min_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    let (Some(slow), true) = (slow, apart.above(0.0) >= SURE) else {
        return true;
    };
    let model_j = slow.model.map_or(f64::NAN, |m| m.loop_energy_j);
    // The error of one test's ratio is the scatter of the tests about their law.
    let factor = Estimate {
        value: (slow.measured.loop_energy_j / model_j).ln(),
        error: measured.scatter,
        degrees: q.degrees,
    };
    let [low, high] = factor.ci95().map(f64::exp);
    let fastest = rows.iter().map(|r| r.frequency_hz).fold(0.0, f64::max);
    out.effects.push(Finding {
        group: Vec::new(),
        size_spread: None,
        gain: None,
        code: "rate_independent_friction".to_owned(),
        confidence: apart.above(0.0),
        statement: format!(
            "The model has too little friction at low speed. In the slowest test ({}, {}) the measured loss is {:.2} J, {:.0} times \
             the model's {model_j:.2} J. The measured loss hardly changes over a {:.0}-fold range of rate; the model's friction \
             falls to zero with the speed.",
            slow.mount,
            slow.name,
            slow.measured.loop_energy_j,
            factor.value.exp(),
            fastest / slow.frequency_hz
        ),
        parameters: vec![
            q.named("exponent of measured loss over rate", ""),
            qm.named("exponent of the model's loss over rate", ""),
            Value {
                name: "measured over model's loss in the slowest test".to_owned(),
                value: factor.value.exp(),
                unit: String::new(),
                ci95: Some([low, high]),
            },
        ],
    });
    true
}

/// Viscous damping, from tests of the same stroke at two rates. True where it is small.
pub(super) fn viscous(rows: &[TableRow], measured: &RegressionLine, out: &mut AggregateDiagnosis) -> bool {
    let mut shares: Vec<f64> = Vec::new();
    let mut changes: Vec<String> = Vec::new();
    let mut gain = 0.0;
    for (i, a) in rows.iter().enumerate() {
        for b in &rows[i + 1..] {
            let same = a.mount == b.mount && a.stroke_mm.is_some() && a.stroke_mm == b.stroke_mm;
            if !same || a.frequency_hz == b.frequency_hz {
                continue;
            }
            let (slow, fast) = if a.frequency_hz < b.frequency_hz {
                (a, b)
            } else {
                (b, a)
            };
            let change = fast.measured.loop_energy_j / slow.measured.loop_energy_j - 1.0;
            gain = fast.frequency_hz / slow.frequency_hz - 1.0;
            shares.push(change / gain);
            changes.push(format!("{:+.1} % ({})", 100.0 * change, a.mount));
        }
    }
    if shares.is_empty() {
        return false;
    }
    let n = shares.len() as f64;
    let degrees = measured.columns.first().map_or(1.0, |c| c.degrees);
    let share = Estimate {
        value: shares.iter().sum::<f64>() / n,
        error: measured.scatter * (2.0 / n).sqrt() / gain,
        degrees,
    };
    let missing = rows
        .iter()
        .filter_map(|r| r.model.map(|m| 1.0 - m.loop_energy_j / r.measured.loop_energy_j))
        .fold(0.0, f64::max);
    let most = share.ci95()[1];
    if most >= SMALL || missing <= most {
        return most < SMALL;
    }
    out.excluded.push(Finding {
        group: Vec::new(),
        size_spread: None,
        gain: None,
        code: "viscous_damping".to_owned(),
        confidence: share.times(-1.0).above(-SMALL.min(missing)),
        statement: format!(
            "Viscous damping does not explain the difference: the same stroke at a higher rate changes the measured loss by {}. At \
             most {:.1} % of the loss is viscous; the model lacks up to {:.0} % of it.",
            changes.join(", "),
            100.0 * most.max(0.0),
            100.0 * missing
        ),
        parameters: vec![share.times(100.0).named("viscous share of the loss at the lower rate", "%")],
    });
    true
}

/// Dependence of the loss on stroke and load, from the sines of one mounting.
pub(super) struct Strokes<'a> {
    mount: &'a str,
    /// Exponent of the loss over the stroke: measured, model.
    over_stroke: [Option<Estimate>; 2],
    /// Exponent of the loss over the peak force: measured, model.
    over_force: [Option<Estimate>; 2],
    /// Measured loss per mm over mean force: level at no load (J/mm) and slope (J/mm/N).
    over_load: Option<[Estimate; 2]>,
    /// Scatter of the loss per mm about a law of presliding (short strokes slide less: a line over 1 / S), over that about
    /// the law of load.
    presliding: Option<f64>,
    /// Mean loss per mm, J/mm.
    mean: f64,
}

impl<'a> Strokes<'a> {
    /// Exponents over stroke and over peak force (measured, model) and the slope over load, as values of a finding.
    fn exponents(&self, over_stroke: [Estimate; 2], over_force: [Estimate; 2]) -> Vec<Value> {
        let mut values = Vec::new();
        for (exponents, over) in [(over_stroke, "stroke"), (over_force, "peak force")] {
            for (exponent, whose) in exponents.iter().zip(["measured", "the model's"]) {
                let name = format!("exponent of {whose} loss over {over}, {}", self.mount);
                values.push(exponent.named(name, ""));
            }
        }
        values.extend(self.over_load.map(|[_, slope]| {
            slope
                .times(500.0)
                .named(format!("friction over load, {}", self.mount), "N/N")
        }));
        values
    }

    pub(super) fn new(rows: &[TableRow], mount: &'a str) -> Self {
        let sines: Vec<(f64, Aggregate, Option<Aggregate>)> = rows
            .iter()
            .filter(|r| r.mount == mount)
            .filter_map(|r| r.stroke_mm.map(|s| (s, r.measured, r.model)))
            .collect();
        let exponent = |points: Option<Vec<(f64, f64)>>| -> Option<Estimate> {
            let points = points?;
            let design: Vec<_> = points.iter().map(|(x, _)| vec![1.0, x.ln()]).collect();
            let y: Vec<f64> = points.iter().map(|(_, y)| y.ln()).collect();
            line(&design, &y).map(|l| l.columns[1])
        };
        let picked = |f: &dyn Fn(f64, Aggregate) -> (f64, f64)| -> [Option<Estimate>; 2] {
            let measured = sines.iter().map(|(s, m, _)| Some(f(*s, *m))).collect();
            let model = sines.iter().map(|(s, _, m)| m.map(|m| f(*s, m))).collect();
            [exponent(measured), exponent(model)]
        };
        let loss_per_mm: Vec<f64> = sines.iter().map(|(s, m, _)| m.loop_energy_j / s).collect();
        Strokes {
            mount,
            over_stroke: picked(&|s, t| (s, t.loop_energy_j)),
            over_force: picked(&|_, t| (t.peak_force_n, t.loop_energy_j)),
            over_load: over_load(&sines, &loss_per_mm).map(|l| [l.columns[0], l.columns[1]]),
            presliding: over_load(&sines, &loss_per_mm).and_then(|load| {
                let design: Vec<_> = sines.iter().map(|(s, _, _)| vec![1.0, 1.0 / s]).collect();
                Some(line(&design, &loss_per_mm)?.scatter / load.scatter)
            }),
            mean: loss_per_mm.iter().sum::<f64>() / loss_per_mm.len().max(1) as f64,
        }
    }
}

fn over_load(sines: &[(f64, Aggregate, Option<Aggregate>)], loss_per_mm: &[f64]) -> Option<RegressionLine> {
    let strokes: Vec<_> = sines.iter().map(|(s, _, _)| vec![1.0, *s]).collect();
    let peaks: Vec<f64> = sines.iter().map(|(_, m, _)| m.peak_force_n).collect();
    let start_n = line(&strokes, &peaks)?.columns[0].value;
    let means: Vec<_> = peaks.iter().map(|p| vec![1.0, 0.5 * (p + start_n)]).collect();
    line(&means, loss_per_mm)
}

/// Friction that grows with load: the loss grows faster than the stroke, and faster than the model's.
pub(super) fn load(strokes: &[Strokes<'_>], out: &mut AggregateDiagnosis) {
    let (mut parameters, mut least, mut missing) = (Vec::new(), f64::INFINITY, 0.0f64);
    let mut forces = Vec::new();
    for s in strokes {
        let ([Some(e), Some(em)], [Some(p), Some(pm)]) = (s.over_stroke, s.over_force) else {
            continue;
        };
        least = least.min(e.above(1.0));
        missing = missing.max(e.minus(&em).above(0.0));
        forces.push((p.value, pm.value));
        parameters.extend(s.exponents([e, em], [p, pm]));
    }
    if forces.is_empty() || least < SURE || missing < SURE {
        return;
    }
    let list = |f: fn(&(f64, f64)) -> f64| {
        let words: Vec<String> = forces.iter().map(|p| format!("{:.2}", f(p))).collect();
        words.join(" and ")
    };
    out.effects.push(Finding {
        group: Vec::new(),
        size_spread: None,
        gain: None,
        code: "load_dependent_friction".to_owned(),
        confidence: least.min(missing),
        statement: format!(
            "Friction grows with load: the measured loss rises with the peak force to the power {}, the model's to the power {}. With \
             constant friction the loss would be proportional to the stroke; the measured loss rises faster than the stroke on \
             every mounting.",
            list(|p| p.0),
            list(|p| p.1)
        ),
        parameters,
    });
    // Two degrees of freedom on either side: 19 is Fisher's F at 95 %.
    if strokes
        .iter()
        .filter_map(|s| s.presliding)
        .all(|ratio| ratio * ratio < 19.0)
    {
        out.alternatives.push(Alternative {
            code: "presliding".to_owned(),
            instead_of: "load_dependent_friction".to_owned(),
            why: "short strokes that hardly slide also lose less energy per mm, and that law fits these tests nearly as well"
                .to_owned(),
            test: "record the loops: they show the transition after each reversal".to_owned(),
        });
    }
}

/// Friction that does not depend on load.
pub(super) fn constant(strokes: &[Strokes<'_>], out: &mut AggregateDiagnosis) {
    let grows = out.effects.iter().any(|f| f.code == "load_dependent_friction");
    let levels: Vec<(&Strokes<'_>, Estimate)> = strokes
        .iter()
        .filter_map(|s| s.over_load.map(|[level, _]| (s, level)))
        .collect();
    let has = |level: &Estimate| level.above(0.0) >= SURE;
    if !grows || !levels.iter().any(|(_, level)| has(level)) {
        return;
    }
    let mut parameters = Vec::new();
    for (s, level) in &levels {
        let share = level.times(100.0 / s.mean);
        parameters.push(
            level
                .times(500.0)
                .named(format!("friction at no load, {}", s.mount), "N"),
        );
        parameters.push(share.named(
            format!("share of the loss that is there at no load, {}", s.mount),
            "%",
        ));
    }
    let with: Vec<&(&Strokes<'_>, Estimate)> = levels.iter().filter(|(_, level)| has(level)).collect();
    let without: Vec<&str> = levels
        .iter()
        .filter(|(_, l)| !has(l))
        .map(|(s, _)| s.mount)
        .collect();
    let names: Vec<&str> = with.iter().map(|(s, _)| s.mount).collect();
    let confidence = with.iter().map(|(_, level)| level.above(0.0)).fold(1.0, f64::min);
    let contrast = match without.as_slice() {
        [] => String::new(),
        none => format!(
            " The tests with {} show none, so that it belongs to the mounting and not to the leaves.",
            none.join(" and ")
        ),
    };
    let level = with[0].1.times(500.0);
    out.effects.push(Finding {
        group: Vec::new(),
        size_spread: None,
        gain: None,
        code: "coulomb_friction".to_owned(),
        confidence,
        statement: format!(
            "Part of the friction with {} does not depend on load: about {:.0} N remain at no load, in addition to the friction \
             that grows with it.{contrast}",
            names.join(" and "),
            level.value
        ),
        parameters,
    });
}
