//! Specimens against the drawing of their family: out of tolerance, within, or undecided.
//!
//! A specimen is judged by its own value: the mean of its runs without the effects of benches and ageing, at 0 cycles. How specimens of
//! the family scatter does not enter, so a few runs are enough, and nothing need be known about the law of that scatter.
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
            "{quantity} of {} was not judged by the drawing: it has no usable estimate there, or nothing to compare it with. Add runs, or a \
             nominal to the drawing.",
            named(&names)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::estimate::EstimateRow;
    use crate::fleet::findings::FleetFindings;
    use crate::fleet::tests::synthetic::SyntheticLab;
    use crate::fleet::{FleetOptions, pool};

    const SEED: u64 = 31;

    /// A lab of one bench error and of specimens that scatter by 2 %, of which S001, of family F2, is 12 % too stiff.
    fn lab() -> SyntheticLab {
        SyntheticLab {
            specimens: 24,
            runs: 144,
            rate_scatter: 0.02,
            force_gain: vec![0.0, 0.01, 0.0],
            outliers: vec![(1, 0.12)],
            ..SyntheticLab::default()
        }
    }

    fn rate_rows(lab: &SyntheticLab) -> Vec<EstimateRow> {
        let mut rows = lab.table(SEED);
        rows.retain(|row| row.quantity == "rate_n_per_mm");
        rows
    }

    fn against(rows: &[EstimateRow], drawings: &str) -> FleetFindings {
        let options = FleetOptions {
            drawings: Some(Drawings::read("drawings.toml", drawings).expect(drawings)),
            ..FleetOptions::default()
        };
        pool(rows, &options).expect("pooled")
    }

    fn judgement<'f>(findings: &'f FleetFindings, specimen: &str) -> &'f DrawingJudgement {
        let mut all = findings.quantities.iter().flat_map(|q| &q.against_drawing);
        all.find(|j| j.specimen == specimen).expect(specimen)
    }

    /// The true rate of S001.
    fn true_rate() -> f64 {
        let own = lab().rate_deviations(SEED)[1].1;
        lab().family_rates(SEED)[1] * own.exp()
    }

    fn verdict_of(limits: &str) -> DrawingVerdict {
        let text = format!("[family.F2.rate_n_per_mm]\n{limits}\n");
        judgement(&against(&rate_rows(&lab()), &text), "S001").verdict
    }

    #[test]
    fn the_chance_of_a_value_outside_is_that_of_its_distance_from_the_limit() {
        let p = |estimate: f64, low: f64, high: f64| {
            let value = Contrast {
                estimate,
                std_error: 0.5,
                degrees: 1e6,
            };
            outside_p(&value, low, high)
        };
        let none = f64::INFINITY;
        // One-sided tails of a normal law at 1.96 and at 0 standard errors.
        assert!((p(10.98, -none, 10.0) - 0.025).abs() < 1e-4);
        assert!((p(9.02, 10.0, none) - 0.025).abs() < 1e-4);
        assert!((p(10.0, -none, 10.0) - 0.5).abs() < 1e-9);
        assert!((p(9.02, -none, 10.0) - 0.975).abs() < 1e-4);
        // The other limit is 2 standard errors further: its tail at 3.96 comes on top, and at a width of 0 it is as large.
        assert!((p(10.98, 9.0, 10.0) - 0.025 - 3.7e-5).abs() < 1e-4);
        assert!((p(10.98, 10.0, 10.0) - 0.05).abs() < 1e-4);
        assert_eq!(
            outside_p(
                &Contrast {
                    estimate: 9.0,
                    std_error: 0.0,
                    degrees: 5.0
                },
                0.0,
                1.0
            ),
            1.0
        );
    }

    #[test]
    fn inside_outside_and_straddling_are_told() {
        let rate = true_rate();
        for (nominal, verdict) in [
            (rate, DrawingVerdict::Within),
            (rate / 1.12, DrawingVerdict::OutOfTolerance),
            (rate / 0.88, DrawingVerdict::OutOfTolerance),
            (rate / 1.07, DrawingVerdict::Undecided),
            (rate / 0.93, DrawingVerdict::Undecided),
        ] {
            let limits = format!("nominal = \"{nominal} N/mm\"\ntolerance = \"7 %\"");
            assert_eq!(verdict_of(&limits), verdict, "{limits}");
        }
    }

    #[test]
    fn one_sided_limits_ask_about_one_side() {
        let rate = true_rate();
        let limit = |key: &str, factor: f64| verdict_of(&format!("{key} = \"{} N/mm\"", factor * rate));
        assert_eq!(limit("at_most", 0.94), DrawingVerdict::OutOfTolerance);
        assert_eq!(limit("at_most", 1.06), DrawingVerdict::Within);
        assert_eq!(limit("at_most", 1.0), DrawingVerdict::Undecided);
        assert_eq!(limit("at_least", 0.94), DrawingVerdict::Within);
        assert_eq!(limit("at_least", 1.06), DrawingVerdict::OutOfTolerance);
    }

    #[test]
    fn the_mean_of_the_others_stands_for_a_nominal_that_is_missing() {
        let findings = against(
            &rate_rows(&lab()),
            "[family.F2.rate_n_per_mm]\ntolerance = \"7 %\"",
        );
        let out = judgement(&findings, "S001");
        assert_eq!(out.verdict, DrawingVerdict::OutOfTolerance);
        let nominal = out.nominal.expect("the mean");
        // Five others, each within some 2 % of the mean.
        assert!(
            (nominal / lab().family_rates(SEED)[1] - 1.0).abs() < 0.03,
            "{out:?}"
        );
        let deviation = lab().rate_deviations(SEED)[1].1.exp();
        assert!(
            (out.value.value / nominal / deviation - 1.0).abs() < 0.03,
            "{out:?}"
        );
        let said = &findings
            .findings
            .iter()
            .find(|f| f.subject == "S001")
            .expect("found")
            .sentence;
        assert!(said.contains(" above the mean of family F2, "), "{said}");
        assert!(
            said.contains("tolerance 7 %: out of tolerance (6 runs)."),
            "{said}"
        );
        // The same in the unit.
        let tolerance = format!("tolerance = \"{} N/mm\"", 0.07 * nominal);
        assert_eq!(verdict_of(&tolerance), DrawingVerdict::OutOfTolerance);
    }

    #[test]
    fn what_has_no_run_or_no_drawing_is_not_judged() {
        let mut rows = lab().table(SEED);
        rows.retain(|r| {
            r.quantity == "rate_n_per_mm" || r.quantity == "friction_ratio" && r.specimen != "S005"
        });
        let text =
            "[family.F2.friction_ratio]\nat_most = 0.9\n[family.F2.rate_n_per_mm]\nat_least = \"1 N/mm\"";
        let findings = against(&rows, text);
        let counts = findings.against_drawings.expect("judged");
        // Six specimens of F2, one without runs in friction; none of the other families.
        assert_eq!((counts.judged, counts.within), (11, 11));
        let said = findings.cannot_tell.join("\n");
        assert!(
            said.contains("friction_ratio of S005 was not judged by the drawing"),
            "{said}"
        );
        assert!(
            findings
                .findings
                .iter()
                .all(|f| f.kind != crate::fleet::findings::QuestionKind::Drawing)
        );
    }

    #[test]
    fn a_whole_family_or_batch_outside_is_said_to_be_the_cause() {
        let nominal = lab().family_rates(SEED)[0];
        let text = format!(
            "[family.F1.rate_n_per_mm]\nnominal = \"{} N/mm\"\ntolerance = \"3 %\"",
            0.8 * nominal
        );
        let findings = against(&rate_rows(&lab()), &text);
        let remark = judgement(&findings, "S000").remark.clone().expect("a remark");
        assert!(
            remark.starts_with("So are 6 of the 6 specimens of family F1"),
            "{remark}"
        );
        let mut of_batch = rate_rows(&lab());
        for row in of_batch.iter_mut().filter(|row| row.family == "F1") {
            let is_new = ["S000", "S004", "S008"].contains(&row.specimen.as_str());
            let factor = if is_new { 1.3 } else { 1.0 };
            row.batch = if is_new { "new" } else { "old" }.to_owned();
            row.estimate *= factor;
            row.std_error *= factor;
        }
        let text = format!("[family.F1.rate_n_per_mm]\nnominal = \"{nominal} N/mm\"\ntolerance = \"15 %\"");
        let findings = against(&of_batch, &text);
        let remark = judgement(&findings, "S004").remark.clone().expect("a remark");
        assert_eq!(
            remark,
            "So are 3 of the 3 specimens of batch new: the batch as a whole explains it."
        );
        assert_eq!(judgement(&findings, "S020").verdict, DrawingVerdict::Within);
    }

    #[test]
    fn an_excess_that_hangs_on_a_bench_is_said_to_hang_on_it() {
        // B2 reads 1 % high. If it is right, the specimen is above a limit that lies 0.4 % above its true value.
        let limits = format!(
            "[family.F2.rate_n_per_mm]\nat_most = \"{} N/mm\"",
            1.004 * true_rate()
        );
        let findings = against(&rate_rows(&lab()), &limits);
        let one = judgement(&findings, "S001");
        assert_eq!(
            (one.verdict, one.clearest_bench.as_deref()),
            (DrawingVerdict::Undecided, Some("B2"))
        );
        assert!(
            one.value.low95 < 1.004 * true_rate() && one.value.high95 > 1.008 * true_rate(),
            "{one:?}"
        );
        let options = FleetOptions {
            reference_bench: Some("B1".to_owned()),
            drawings: Some(Drawings::read("drawings.toml", &limits).expect("limits")),
            ..FleetOptions::default()
        };
        let with_reference = pool(&rate_rows(&lab()), &options).expect("pooled");
        let known = judgement(&with_reference, "S001");
        assert_eq!((&known.least_sure_bench, &known.remark), (&None, &None));
        assert!(
            known.value.high95 < one.value.high95 - 0.005 * true_rate(),
            "{known:?}"
        );
    }

    #[test]
    fn the_benches_that_decide_are_named() {
        let findings = against(
            &rate_rows(&lab()),
            "[family.F2.rate_n_per_mm]\nat_most = \"500 N/mm\"",
        );
        let undecided = DrawingJudgement {
            verdict: DrawingVerdict::Undecided,
            least_sure_bench: Some("B1".to_owned()),
            clearest_bench: Some("B2".to_owned()),
            clearest_p: 0.001,
            ..judgement(&findings, "S001").clone()
        };
        let said = if_bench(&undecided, 6).expect("a remark");
        assert!(
            said.starts_with("It is out of tolerance if bench B2 is right, but not surely if bench B1 is"),
            "{said}"
        );
        assert_eq!(if_bench(&undecided, 60), None, "one of many");
        let within = DrawingJudgement {
            verdict: DrawingVerdict::Within,
            ..undecided
        };
        assert_eq!(if_bench(&within, 6), None);
    }
}
