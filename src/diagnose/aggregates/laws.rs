//! What peak forces and loop energies say about rate, load and stroke.
//!
//! ```text
//! rate    ln E = a_mount + p_mount ln F + q ln f        q = 0 where friction does not know the rate
//! stroke  ln E = c + e ln S                             e = 1 for constant friction, above where friction grows with load
//! load    E / S = 2 Fc (1 - r/(1+r)) + 2 r/(1+r) F_mean    its level at no load is the constant share, its slope the rest
//! pairs   E(f2) / E(f1) - 1 = s (f2 / f1 - 1)           s: viscous share of the loss at f1, same stroke
//! ```
//! `F_mean` is halfway between the peak and the force at no stroke, from a line of peak force over stroke. The intervals come
//! from the scatter of the rows about these laws; rows that follow none of them are refused as evidence.

use super::AggregateDiagnosis;
use super::regression::{Estimate, RegressionLine, line};
use super::rows::mounts;
use super::table::TableRow;
use crate::diagnose::diagnosis::{Alternative, Finding, Value};
use crate::papers::first::Two;

/// Exponent over the rate below which the loss "hardly changes": 12 % a decade.
const FLAT: f64 = 0.05;
/// Share of the loss that is small.
const SMALL: f64 = 0.1;
/// Confidence that a finding needs.
const SURE: f64 = 0.95;

/// `ln E = a_mount + p_mount ln F + q ln f`; the last column is q, where the frequencies differ.
pub(super) fn power_law(rows: &[TableRow], of: impl Fn(&TableRow) -> Option<Two>) -> Option<RegressionLine> {
    let mounts = mounts(rows);
    let frequencies = rows.iter().any(|r| r.frequency_hz != rows[0].frequency_hz);
    let (mut design, mut y) = (Vec::new(), Vec::new());
    for row in rows {
        let two = of(row)?;
        let mut columns = vec![0.0; 2 * mounts.len()];
        let at = mounts.iter().position(|m| *m == row.mount)?;
        columns[2 * at] = 1.0;
        columns[2 * at + 1] = two.peak_n.ln();
        if frequencies {
            columns.push(row.frequency_hz.ln());
        }
        design.push(columns);
        y.push(two.loop_j.ln());
    }
    line(&design, &y)
}

/// The exponent over the rate; none where all rows have the same.
fn rate_exponent(law: &RegressionLine) -> Option<&Estimate> {
    law.columns.last().filter(|_| law.columns.len() % 2 == 1)
}

fn is_flat(q: &Estimate) -> bool {
    q.ci95().iter().all(|v| v.abs() <= FLAT)
}

/// Friction that does not vanish at low speed. True where the measured loss does not know the rate.
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
    let model_j = slow.model.map_or(f64::NAN, |m| m.loop_j);
    // One row's ratio is as sure as the rows are about their law.
    let factor = Estimate {
        value: (slow.measured.loop_j / model_j).ln(),
        error: measured.scatter,
        spare: q.spare,
    };
    let [low, high] = factor.ci95().map(f64::exp);
    let fastest = rows.iter().map(|r| r.frequency_hz).fold(0.0, f64::max);
    out.effects.push(Finding {
        gain: None,
        code: "rate_independent_friction".to_owned(),
        confidence: apart.above(0.0),
        statement: format!(
            "Friction is missing at low speed: in the slowest test ({}, {}) the model loses {model_j:.2} J where {:.2} J were measured, \
             {:.0} times as much. The measured loss hardly changes while the rate rises {:.0} times; the model's friction dies away \
             as the speed goes to zero.",
            slow.mount,
            slow.name,
            slow.measured.loop_j,
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

/// Viscous damping, from tests of one stroke at two rates. True where it is small.
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
            let change = fast.measured.loop_j / slow.measured.loop_j - 1.0;
            gain = fast.frequency_hz / slow.frequency_hz - 1.0;
            shares.push(change / gain);
            changes.push(format!("{:+.1} % with {}", 100.0 * change, a.mount));
        }
    }
    if shares.is_empty() {
        return false;
    }
    let n = shares.len() as f64;
    let spare = measured.columns.first().map_or(1.0, |c| c.spare);
    let share = Estimate {
        value: shares.iter().sum::<f64>() / n,
        error: measured.scatter * (2.0 / n).sqrt() / gain,
        spare,
    };
    let missing = rows
        .iter()
        .filter_map(|r| r.model.map(|m| 1.0 - m.loop_j / r.measured.loop_j))
        .fold(0.0, f64::max);
    let most = share.ci95()[1];
    if most >= SMALL || missing <= most {
        return most < SMALL;
    }
    out.excluded.push(Finding {
        gain: None,
        code: "viscous_damping".to_owned(),
        confidence: share.times(-1.0).above(-SMALL.min(missing)),
        statement: format!(
            "Viscous damping is not what is missing: the same stroke at a higher rate changes the measured loss by {}. At most {:.1} % \
             of the loss is viscous; up to {:.0} % is missing.",
            changes.join(", "),
            100.0 * most.max(0.0),
            100.0 * missing
        ),
        parameters: vec![share.times(100.0).named("viscous share of the loss at the lower rate", "%")],
    });
    true
}

/// What the sines of one mounting say about stroke and load.
pub(super) struct Strokes<'a> {
    mount: &'a str,
    /// Exponent of the loss over the stroke: measured, model.
    over_stroke: [Option<Estimate>; 2],
    /// Exponent of the loss over the peak force: measured, model.
    over_force: [Option<Estimate>; 2],
    /// Loss a mm over mean force, measured: level at no load (J/mm) and slope (J/mm/N).
    over_load: Option<[Estimate; 2]>,
    /// Scatter of the loss a mm about a law of turning (short strokes slide less: a line over 1 / S), over that about load.
    turning: Option<f64>,
    /// Loss a mm at the middle of the rows, J/mm.
    middle: f64,
}

impl<'a> Strokes<'a> {
    pub(super) fn new(rows: &[TableRow], mount: &'a str) -> Self {
        let sines: Vec<(f64, Two, Option<Two>)> = rows
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
        let picked = |f: &dyn Fn(f64, Two) -> (f64, f64)| -> [Option<Estimate>; 2] {
            let measured = sines.iter().map(|(s, m, _)| Some(f(*s, *m))).collect();
            let model = sines.iter().map(|(s, _, m)| m.map(|m| f(*s, m))).collect();
            [exponent(measured), exponent(model)]
        };
        let a_mm: Vec<f64> = sines.iter().map(|(s, m, _)| m.loop_j / s).collect();
        Strokes {
            mount,
            over_stroke: picked(&|s, t| (s, t.loop_j)),
            over_force: picked(&|_, t| (t.peak_n, t.loop_j)),
            over_load: over_load(&sines, &a_mm).map(|l| [l.columns[0], l.columns[1]]),
            turning: over_load(&sines, &a_mm).and_then(|load| {
                let design: Vec<_> = sines.iter().map(|(s, _, _)| vec![1.0, 1.0 / s]).collect();
                Some(line(&design, &a_mm)?.scatter / load.scatter)
            }),
            middle: a_mm.iter().sum::<f64>() / a_mm.len().max(1) as f64,
        }
    }
}

fn over_load(sines: &[(f64, Two, Option<Two>)], a_mm: &[f64]) -> Option<RegressionLine> {
    let strokes: Vec<_> = sines.iter().map(|(s, _, _)| vec![1.0, *s]).collect();
    let peaks: Vec<f64> = sines.iter().map(|(_, m, _)| m.peak_n).collect();
    let start_n = line(&strokes, &peaks)?.columns[0].value;
    let means: Vec<_> = peaks.iter().map(|p| vec![1.0, 0.5 * (p + start_n)]).collect();
    line(&means, a_mm)
}

/// Friction that grows with the load: the loss grows faster than the stroke, and faster than the model's.
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
        parameters.extend([
            e.named(format!("exponent of measured loss over stroke, {}", s.mount), ""),
            em.named(
                format!("exponent of the model's loss over stroke, {}", s.mount),
                "",
            ),
            p.named(
                format!("exponent of measured loss over peak force, {}", s.mount),
                "",
            ),
            pm.named(
                format!("exponent of the model's loss over peak force, {}", s.mount),
                "",
            ),
        ]);
        if let Some([_, slope]) = s.over_load {
            parameters.push(
                slope
                    .times(500.0)
                    .named(format!("friction over load, {}", s.mount), "N/N"),
            );
        }
    }
    if forces.is_empty() || least < SURE || missing < SURE {
        return;
    }
    let list = |f: fn(&(f64, f64)) -> f64| {
        let words: Vec<String> = forces.iter().map(|p| format!("{:.2}", f(p))).collect();
        words.join(" and ")
    };
    out.effects.push(Finding {
        gain: None,
        code: "load_dependent_friction".to_owned(),
        confidence: least.min(missing),
        statement: format!(
            "Friction grows with the load: the measured loss goes with the peak force to the power {}, the model's with {}. Constant \
             friction would give a loss in proportion to the stroke; measured, it grows faster on every mounting.",
            list(|p| p.0),
            list(|p| p.1)
        ),
        parameters,
    });
    // Two spare points on either side: 19 is Fisher's F at 95 %.
    if strokes
        .iter()
        .filter_map(|s| s.turning)
        .all(|ratio| ratio * ratio < 19.0)
    {
        out.alternatives.push(Alternative {
            code: "presliding".to_owned(),
            instead_of: "load_dependent_friction".to_owned(),
            why: "a short stroke that hardly slides loses less a mm as well, and these rows follow that law nearly as well".to_owned(),
            test: "record the loops: the transition after a reversal is then seen, not inferred".to_owned(),
        });
    }
}

/// A share of the friction that is there without load.
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
        let share = level.times(100.0 / s.middle);
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
            " With {} there is none: it is the mounting's, not the leaves'.",
            none.join(" and ")
        ),
    };
    let level = with[0].1.times(500.0);
    out.effects.push(Finding {
        gain: None,
        code: "coulomb_friction".to_owned(),
        confidence,
        statement: format!(
            "The mounting with {} has a share of friction that does not depend on the load: about {:.0} N would be left at no load, \
             beside the friction that grows with it.{contrast}",
            names.join(" and "),
            level.value
        ),
        parameters,
    });
}
