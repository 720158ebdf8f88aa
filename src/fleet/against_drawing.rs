//! Specimens against the drawing of their family: out of tolerance, within, or undecided.
//!
//! A specimen is judged by its own value: the mean of its runs without the effects of benches and ageing, at 0 cycles. How specimens of
//! the family scatter does not enter, so a few runs are enough, and the law of that scatter need not be known.
//!
//! ```text
//! value    = l'b + g     l: group, batch, bench, 0 cycles; g: the specimen's own mean (mean-shift column)
//! variance = variance of that sum - tau^2 + f^2
//! ```
//! b: effects of the mixed model. tau^2 is taken off, as it is the scatter of the family and no error of this value. f^2: form error, which
//! the runs of a family share and which their mean keeps. If the mean of the family stands for the nominal, only the share of f counts that
//! differs between benches (`bench_form`), and the error of that mean, without the specimen, is in the variance.
//!
//! Decision rule: ISO 14253-1, non-conformity is proven if the value lies outside of the limit by more than a guard band. The guard band
//! is the quantile of Student's t times the standard error (guarded rejection of JCGM 106), at the level that Holm's correction leaves
//! (`questions`). The p value is the chance of a value so far outside from a specimen on the limit. The largest p value over all benches that
//! may be right counts (Berger 1982), as for the levels of families.

use rayon::prelude::*;

use super::design::DesignTerm;
use super::drawing::{Drawings, DrawnLimits};
use super::estimate::EstimateScale;
use super::findings::{DrawingJudgement, DrawingVerdict, PooledValue, QuantityFindings};
use super::mixed_model::Contrast;
use super::outliers::RobustFit;
use super::quantity::FEWEST_SPECIMENS;
use super::questions::FAMILY_WISE_ERROR;
use super::wording::named;
use crate::identify::confidence::{student_975, student_within};

/// Fewest judged specimens of a batch, family or bench of which can be said that it deviates as a whole.
const FEWEST_OF_WHOLE: usize = 3;

/// Judges the specimens whose drawing limits the quantity of these fits. The verdicts wait for [`conclude`].
pub(super) fn judged(lab: &RobustFit, drawings: &Drawings, reference: Option<&str>) -> Vec<DrawingJudgement> {
    let data = lab.design.of;
    let all = (0..data.specimens.len()).into_par_iter();
    let judged = all.filter_map(|specimen| {
        let limits = drawings.limits(data.specimens[specimen].family, &data.rows[0].quantity)?;
        judgement(lab, specimen, limits, reference)
    });
    judged.collect()
}

/// The value of a specimen if one bench is right.
struct OwnValue {
    bench: Option<usize>,
    contrast: Contrast,
}

fn judgement(
    lab: &RobustFit,
    specimen: usize,
    limits: &DrawnLimits,
    reference: Option<&str>,
) -> Option<DrawingJudgement> {
    let data = lab.design.of;
    let scale = data.rows[0].scale;
    let is_mean = limits.about_family_mean();
    let (nominal, values) = match is_mean {
        true => from_family_mean(lab, specimen, reference)?,
        false => (limits.nominal, if_bench_is_right(lab, specimen, reference)?),
    };
    let ends = [limits.at_least, limits.at_most].map(|end| Some(end?.at(nominal.unwrap_or(0.0))));
    let pooled = |end: f64| match scale {
        EstimateScale::Relative if end > 0.0 => end.ln(),
        EstimateScale::Relative => f64::NEG_INFINITY,
        EstimateScale::Absolute => end,
    };
    let low = ends[0].map_or(f64::NEG_INFINITY, pooled);
    let high = ends[1].map_or(f64::INFINITY, pooled);
    let p = |value: &OwnValue| outside_p(&value.contrast, low, high);
    let least_sure = values.iter().max_by(|a, b| p(a).total_cmp(&p(b)))?;
    let clearest = values.iter().min_by(|a, b| p(a).total_cmp(&p(b)))?;
    let several = values.len() > 1;
    let own = &data.specimens[specimen];
    let mut benches: Vec<usize> = data.benches.of_row[own.rows.clone()].to_vec();
    benches.sort_unstable();
    benches.dedup();
    let name = |bench: usize| data.benches.names[bench].to_owned();
    Some(DrawingJudgement {
        specimen: own.name.to_owned(),
        family: own.family.to_owned(),
        batch: own.batch.to_owned(),
        benches: benches.into_iter().map(name).collect(),
        runs: own.rows.len(),
        value: whichever_is_right(&values, scale, p(least_sure)),
        nominal,
        nominal_is_family_mean: is_mean,
        at_least: ends[0],
        at_most: ends[1],
        limits: limits.words.clone(),
        verdict: DrawingVerdict::Undecided,
        least_sure_bench: least_sure.bench.filter(|_| several).map(name),
        clearest_bench: clearest.bench.filter(|_| several).map(name),
        clearest_p: p(clearest),
        remark: None,
    })
}

/// The value at the mean of the benches, with the interval that holds whichever bench is right.
fn whichever_is_right(values: &[OwnValue], scale: EstimateScale, p: f64) -> PooledValue {
    let mean = values.iter().map(|v| v.contrast.estimate).sum::<f64>() / values.len() as f64;
    let ends = values.iter().map(|v| {
        let half = student_975(v.contrast.degrees) * v.contrast.std_error;
        [v.contrast.estimate - half, v.contrast.estimate + half]
    });
    let [low, high] = ends.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], [a, b]| {
        [low.min(a), high.max(b)]
    });
    let of = |x: f64| match scale {
        EstimateScale::Relative => x.exp(),
        EstimateScale::Absolute => x,
    };
    let degrees = values.iter().map(|v| v.contrast.degrees);
    PooledValue {
        value: of(mean),
        low95: of(low),
        high95: of(high),
        degrees: degrees.fold(f64::INFINITY, f64::min),
        p: Some(p),
        adjusted_p: None,
        found: false,
    }
}

/// Chance of a value as far outside of the limits, if the true value is on one of them: the tail beyond that limit, and the one
/// beyond the other.
fn outside_p(value: &Contrast, low: f64, high: f64) -> f64 {
    if !(value.std_error > 0.0 && value.std_error.is_finite()) {
        return 1.0;
    }
    let tail = |distance: f64| {
        let t = distance / value.std_error;
        let beyond = 0.5 * (1.0 - student_within(value.degrees, t.abs()));
        if t > 0.0 { beyond } else { 1.0 - beyond }
    };
    let outside = (value.estimate - high).max(low - value.estimate);
    (tail(outside) + tail(outside + (high - low))).min(1.0)
}

/// The value of a specimen at 0 cycles and at the time of its first run, for each bench that may be right.
fn if_bench_is_right(lab: &RobustFit, specimen: usize, reference: Option<&str>) -> Option<Vec<OwnValue>> {
    let alone = lab.setting_aside(specimen)?;
    let (design, data) = (&alone.design, alone.design.of);
    let own = &data.specimens[specimen];
    let batch = data.groups[own.group]
        .batches
        .iter()
        .position(|b| *b == own.batch)?;
    let first = data.years[own.rows.clone()]
        .iter()
        .copied()
        .fold(f64::INFINITY, f64::min);
    let mut weights = vec![
        (DesignTerm::Group(own.group), 1.0),
        (DesignTerm::Batch(own.group, batch), 1.0),
        (DesignTerm::Cycles(None), -design.mean_age[0]),
        (DesignTerm::Years, first - design.mean_age[1]),
    ];
    weights.extend(design.effects_of_specimen(specimen));
    let form = data.form_variance_of(&own.rows.clone().collect::<Vec<_>>());
    let value = |bench: usize| {
        let at_bench = [weights.as_slice(), &[(DesignTerm::Bench(bench), 1.0)]].concat();
        OwnValue {
            bench: Some(bench),
            contrast: alone.value_of(specimen, &at_bench).with_form_variance(form),
        }
    };
    Some(
        right_benches(lab, own.group, reference)
            .into_iter()
            .map(value)
            .collect(),
    )
}

/// The benches that may be right for a group: the reference, or all that are connected with those that tested it.
fn right_benches(lab: &RobustFit, group: usize, reference: Option<&str>) -> Vec<usize> {
    let data = lab.design.of;
    let benches = data.benches_of_part(data.groups[group].part);
    let right = benches
        .iter()
        .find(|b| Some(data.benches.names[**b]) == reference);
    right.map_or(benches.clone(), |right| vec![*right])
}

/// The mean of the family at 0 cycles without the specimen, in the unit of the quantity, and the specimen's value as if that mean were the
/// nominal. `None` if nothing else of its batch can be compared with it. The form error is shared with the family, save the part of it
/// that differs from bench to bench.
fn from_family_mean(
    lab: &RobustFit,
    specimen: usize,
    reference: Option<&str>,
) -> Option<(Option<f64>, Vec<OwnValue>)> {
    let alone = lab.setting_aside(specimen)?;
    let (design, data) = (&alone.design, alone.design.of);
    let own = &data.specimens[specimen];
    let members = data.specimens.iter().filter(|s| s.group == own.group).count();
    // An own mean that follows from its batch is no difference from others.
    if members < FEWEST_SPECIMENS || !design.has(DesignTerm::Outlier(specimen)) {
        return None;
    }
    let mut weights = vec![
        (DesignTerm::Group(own.group), 1.0),
        (DesignTerm::Cycles(None), -design.mean_age[0]),
    ];
    if let [right] = right_benches(lab, own.group, reference)[..] {
        weights.push((DesignTerm::Bench(right), 1.0));
    }
    let mean = alone.fit.contrast(&design.entries(&weights));
    let batch = data.groups[own.group]
        .batches
        .iter()
        .position(|b| *b == own.batch)?;
    let mut weights = vec![(DesignTerm::Batch(own.group, batch), 1.0)];
    weights.extend(design.effects_of_specimen(specimen));
    let form = data.form_variance_of(&own.rows.clone().collect::<Vec<_>>());
    let difference = alone.value_of(specimen, &weights);
    let contrast = Contrast {
        estimate: mean.estimate + difference.estimate,
        ..difference.with_form_variance(data.bench_form_share.powi(2) * form)
    };
    let in_unit = PooledValue::level(&mean, data.rows[0].scale, None).value;
    Some((
        Some(in_unit),
        vec![OwnValue {
            bench: None,
            contrast,
        }],
    ))
}

/// Gives all judgements their verdicts, after the questions are answered, and what explains them beside the specimen.
pub(super) fn conclude(quantities: &mut [QuantityFindings]) {
    let asked: usize = quantities.iter().map(|q| q.against_drawing.len()).sum();
    for quantity in quantities {
        for judgement in &mut quantity.against_drawing {
            judgement.verdict = verdict(judgement);
        }
        let remarks: Vec<Option<String>> = (quantity.against_drawing.iter())
            .map(|one| as_a_whole(one, &quantity.against_drawing).or_else(|| if_bench(one, asked)))
            .collect();
        for (judgement, remark) in quantity.against_drawing.iter_mut().zip(remarks) {
            judgement.remark = remark;
        }
    }
}

fn verdict(judgement: &DrawingJudgement) -> DrawingVerdict {
    let value = &judgement.value;
    let above = judgement.at_least.is_none_or(|low| low <= value.low95);
    let below = judgement.at_most.is_none_or(|high| value.high95 <= high);
    match value.found {
        true => DrawingVerdict::OutOfTolerance,
        false if above && below => DrawingVerdict::Within,
        false => DrawingVerdict::Undecided,
    }
}

impl DrawingJudgement {
    /// True if the value lies above the limits, if it is outside.
    pub(super) fn is_above(&self) -> bool {
        self.at_most.is_some_and(|high| self.value.value > high)
    }
}

/// What has the same excess as a whole: the family, the batch, or the bench that alone tested the specimen.
fn as_a_whole(one: &DrawingJudgement, all: &[DrawingJudgement]) -> Option<String> {
    if one.verdict != DrawingVerdict::OutOfTolerance {
        return None;
    }
    let out = |j: &DrawingJudgement| j.verdict == one.verdict && j.is_above() == one.is_above();
    let most_of = |belongs: &dyn Fn(&DrawingJudgement) -> bool| {
        let of: Vec<&DrawingJudgement> = all.iter().filter(|j| belongs(j)).collect();
        let count = of.iter().filter(|j| out(j)).count();
        (of.len() >= FEWEST_OF_WHOLE && 2 * count > of.len()).then(|| format!("{count} of the {}", of.len()))
    };
    let family = most_of(&|j| j.family == one.family).map(|share| {
        format!(
            "So are {share} specimens of family {}: check the drawing's limits and the calibration of the benches first.",
            one.family
        )
    });
    let batch = || {
        let share = most_of(&|j| j.family == one.family && j.batch == one.batch)?;
        Some(format!(
            "So are {share} specimens of batch {}: the batch as a whole explains it.",
            one.batch
        ))
    };
    let bench = || {
        let share = most_of(&|j| j.benches == one.benches).filter(|_| one.benches.len() == 1)?;
        Some(format!(
            "So are {share} specimens that were tested on bench {} alone: the bench may explain it; test some of them on another one.",
            named(&one.benches)
        ))
    };
    family.or_else(batch).or_else(bench)
}

/// The benches that decide whether an undecided specimen is out of tolerance. `asked`: number of judgements, for Bonferroni's correction.
fn if_bench(one: &DrawingJudgement, asked: usize) -> Option<String> {
    let (least, clearest) = (one.least_sure_bench.as_ref()?, one.clearest_bench.as_ref()?);
    let is_out_there = one.clearest_p * (asked as f64) < FAMILY_WISE_ERROR;
    (one.verdict == DrawingVerdict::Undecided && is_out_there).then(|| {
        format!("It is out of tolerance if bench {clearest} is right, but not surely if bench {least} is: check these benches.")
    })
}

/// Specimens whose drawing limits a quantity, but that were not judged in it, one sentence each quantity. `named_rows`: family, specimen
/// of all that the table has.
pub(super) fn not_judged(
    quantity: &str,
    drawings: &Drawings,
    specimens: &[(&str, &str)],
    judged: &[DrawingJudgement],
) -> Option<String> {
    let left_out = specimens.iter().filter(|(family, name)| {
        drawings.limits(family, quantity).is_some() && !judged.iter().any(|j| j.specimen == *name)
    });
    let names: Vec<&str> = left_out.map(|(_, name)| *name).collect();
    (!names.is_empty()).then(|| {
        format!(
            "{quantity} of {} was not judged by the drawing: there is no usable estimate, or neither a nominal nor another specimen to \
             compare with. Record more runs, or add a nominal to the drawing.",
            named(&names)
        )
    })
}

#[cfg(test)]
mod tests;
