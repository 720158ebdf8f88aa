//! One quantity: from its robust fit to values with intervals, and the questions that are asked about them.

use super::design::DesignTerm;
use super::estimate::EstimateScale;
use super::findings::{
    AgeSlope, AgeUnit, GroupLevel, LevelEffect, PooledValue, QuantityFindings, QuantityRole,
    SpecimenDeviation,
};
use super::levels::{Factor, level_effects};
use super::mixed_model::Contrast;
use super::outliers::{QuantityFits, RobustFit, mean_p, outlier_p, p_value};
use crate::effect::{EFFECTS, Stage};
use crate::identify::confidence::student_975;

/// Fewest specimens of a group in which one can be called different.
pub(super) const FEWEST_SPECIMENS: usize = 3;

impl QuantityRole {
    /// The role by the name of the quantity: the code of an effect, or a parameter.
    pub(super) fn of(quantity: &str) -> QuantityRole {
        match EFFECTS.iter().find(|effect| effect.code == quantity) {
            Some(effect) if effect.stage == Stage::Sensor => QuantityRole::InstrumentEffect,
            Some(_) => QuantityRole::Effect,
            None => QuantityRole::Parameter,
        }
    }
}

impl PooledValue {
    /// A difference: of logarithms as a fraction. `asked`: its p value counts as a question.
    pub(super) fn difference(contrast: &Contrast, scale: EstimateScale, asked: bool) -> PooledValue {
        let of = |x: f64| match scale {
            EstimateScale::Relative => x.exp_m1(),
            EstimateScale::Absolute => x,
        };
        PooledValue::of(contrast, of, asked.then(|| p_value(contrast)))
    }

    /// A value in the unit of the quantity.
    pub(super) fn level(contrast: &Contrast, scale: EstimateScale, p: Option<f64>) -> PooledValue {
        let of = |x: f64| match scale {
            EstimateScale::Relative => x.exp(),
            EstimateScale::Absolute => x,
        };
        PooledValue::of(contrast, of, p)
    }

    fn of(contrast: &Contrast, of: impl Fn(f64) -> f64, p: Option<f64>) -> PooledValue {
        let half = student_975(contrast.degrees) * contrast.std_error;
        PooledValue {
            value: of(contrast.estimate),
            low95: of(contrast.estimate - half),
            high95: of(contrast.estimate + half),
            degrees: contrast.degrees,
            p,
            adjusted_p: None,
            found: false,
        }
    }
}

/// Everything about one quantity. `reference_bench`: the bench against which the others are compared, if it was tested there.
pub(super) fn quantity_findings(fits: &QuantityFits, reference_bench: Option<&str>) -> QuantityFindings {
    let (robust, within) = (&fits.lab, &fits.within);
    let data = robust.design.of;
    let row = data.rows[0];
    let role = QuantityRole::of(&row.quantity);
    let of_specimens = role != QuantityRole::InstrumentEffect;
    let benches = (0..data.parts()).flat_map(|part| match of_specimens {
        true => level_effects(
            robust,
            Factor::Bench,
            &data.benches_of_part(part),
            reference_bench,
        ),
        false => instrument_effects(robust, part),
    });
    let operators: Vec<usize> = match robust.choice.operators {
        // Runs without an operator belong to nobody who could be named.
        true => (0..data.operators.names.len())
            .filter(|o| !data.operators.names[*o].is_empty())
            .collect(),
        false => Vec::new(),
    };
    let groups = 0..data.groups.len();
    QuantityFindings {
        quantity: row.quantity.clone(),
        unit: row.unit.clone(),
        scale: row.scale,
        role,
        runs: data.rows.len(),
        between_specimens: robust.fit.between_specimens(),
        run_to_run: robust.fit.run_to_run(),
        groups: groups.flat_map(|g| group_levels(fits, g, role)).collect(),
        benches: benches.collect(),
        operators: level_effects(within, Factor::Operator, &operators, None),
        slopes: if of_specimens { slopes(within) } else { Vec::new() },
        against_drawing: Vec::new(),
        specimen_deviations: (0..data.specimens.len())
            .map(|s| specimen_deviation(within, s, of_specimens))
            .collect(),
    }
}

/// Levels of an effect of the instruments on each bench of a part, which are compared with 0.
fn instrument_effects(robust: &RobustFit, part: usize) -> Vec<LevelEffect> {
    let data = robust.design.of;
    let effect = |bench: usize| {
        let contrast = robust.bench_level(bench)?;
        Some(LevelEffect {
            name: data.benches.names[bench].to_owned(),
            against: Vec::new(),
            effect: PooledValue::difference(&contrast, data.rows[0].scale, true),
        })
    };
    data.benches_of_part(part)
        .into_iter()
        .filter_map(effect)
        .collect()
}

impl RobustFit<'_, '_> {
    /// Mean of the quantity on a bench, over the groups that were tested in its part.
    pub(super) fn bench_level(&self, bench: usize) -> Option<Contrast> {
        let data = self.design.of;
        let groups = (0..data.groups.len()).filter(|g| data.groups[*g].part == data.part_of_bench[bench]);
        let groups: Vec<usize> = groups.collect();
        let share = 1.0 / groups.len() as f64;
        // Each group has a form error of its own.
        let form = groups
            .iter()
            .map(|g| share * share * data.form_variance_of(&data.rows_of_group(*g, None)));
        let form = form.sum();
        let mut weights = vec![(DesignTerm::Bench(bench), 1.0)];
        weights.extend(groups.into_iter().map(|g| (DesignTerm::Group(g), share)));
        let contrast = self.design.contrast(&self.fit, &weights)?;
        Some(contrast.with_form_variance(form))
    }
}

/// The level of a group and of its batches.
fn group_levels(fits: &QuantityFits, group: usize, role: QuantityRole) -> Vec<GroupLevel> {
    let batches = &fits.lab.design.of.groups[group].batches;
    let several = 0..if batches.len() > 1 { batches.len() } else { 0 };
    let all = std::iter::once(None).chain(several.map(Some));
    all.filter_map(|batch| group_level(fits, group, batch, role))
        .collect()
}

fn group_level(
    fits: &QuantityFits,
    group: usize,
    batch: Option<usize>,
    role: QuantityRole,
) -> Option<GroupLevel> {
    let robust = &fits.lab;
    let data = robust.design.of;
    let scale = data.rows[0].scale;
    let name = batch.map(|b| data.groups[group].batches[b]);
    let rows = data.rows_of_group(group, name);
    let shares = bench_shares(robust, &rows);
    let plain = level_weights(robust, group, batch, &rows);
    let form = data.form_variance_of(&rows);
    let contrast = |extra: &[(usize, f64)]| {
        let benches = extra.iter().map(|&(b, w)| (DesignTerm::Bench(b), w));
        let weights: Vec<_> = plain.iter().copied().chain(benches).collect();
        let contrast = robust.design.contrast(&robust.fit, &weights)?;
        Some(contrast.with_form_variance(form))
    };
    let is_effect = role == QuantityRole::Effect;
    // An effect counts on the benches where it was measured, a parameter at the mean of all.
    let level = contrast(if is_effect { &shares } else { &[] })?;
    let benches = data.benches_of_part(data.groups[group].part);
    let if_right = benches.iter().filter(|_| is_effect && benches.len() > 1);
    let if_right = if_right.filter_map(|b| contrast(&[(*b, 1.0)]));
    let least_sure = if_right
        .map(|on| match on.estimate * level.estimate > 0.0 {
            true => (p_value(&on), on),
            false => (1.0, on),
        })
        .max_by(|a, b| a.0.total_cmp(&b.0));
    let members = data.specimens.iter().enumerate();
    let members = members.filter(|(_, s)| s.group == group && name.is_none_or(|b| s.batch == b));
    let z = members.clone().map(|(s, _)| single_z(robust, s));
    Some(GroupLevel {
        family: data.groups[group].family.to_owned(),
        batch: name.map(str::to_owned),
        benches: shares
            .iter()
            .map(|(b, _)| data.benches.names[*b].to_owned())
            .collect(),
        specimens: members.count(),
        runs: rows.len(),
        on_least_sure_bench: least_sure.map(|(p, on)| PooledValue::level(&on, scale, Some(p))),
        level: PooledValue::level(&level, scale, is_effect.then(|| p_value(&level))),
        from_other_batches: batch
            .and_then(|b| from_other_batches(&fits.within, group, b, role != QuantityRole::InstrumentEffect)),
        largest_single_z: z.fold(0.0, |most, z| if z.abs() > f64::abs(most) { z } else { most }),
    })
}

/// Weights of the mean of a group or batch at the mean of the benches and at the mean age of its runs.
fn level_weights(
    robust: &RobustFit,
    group: usize,
    batch: Option<usize>,
    rows: &[usize],
) -> Vec<(DesignTerm, f64)> {
    let (design, data) = (&robust.design, robust.design.of);
    let mean =
        |values: &dyn Fn(usize) -> f64| rows.iter().map(|i| values(*i)).sum::<f64>() / rows.len() as f64;
    let cycles = mean(&|i| data.rows[i].age_cycles / 1000.0) - design.mean_age[0];
    let years = mean(&|i| data.years[i]) - design.mean_age[1];
    let mut weights = vec![(DesignTerm::Group(group), 1.0)];
    for (term, weight) in [(DesignTerm::Cycles(None), cycles), (DesignTerm::Years, years)] {
        if design.has(term) {
            weights.push((term, weight));
        }
    }
    weights.extend(batch.map(|b| (DesignTerm::Batch(group, b), 1.0)));
    weights
}

/// Share of the rows on each bench that has some, without those of outliers.
fn bench_shares(robust: &RobustFit, rows: &[usize]) -> Vec<(usize, f64)> {
    let data = robust.design.of;
    let aside = |i: &usize| {
        let outliers = robust.choice.outliers.iter();
        !outliers.map(|s| &data.specimens[*s]).any(|s| s.rows.contains(i))
    };
    let kept: Vec<usize> = rows.iter().copied().filter(aside).collect();
    let on = |bench: usize| kept.iter().filter(|i| data.benches.of_row[**i] == bench).count();
    let shares = (0..data.benches.names.len()).map(|b| (b, on(b) as f64 / kept.len().max(1) as f64));
    shares.filter(|(_, share)| *share > 0.0).collect()
}

/// A batch against the mean of the others. Two batches are one question, which the first of them asks.
fn from_other_batches(robust: &RobustFit, group: usize, batch: usize, asked: bool) -> Option<PooledValue> {
    let count = robust.design.of.groups[group].batches.len();
    if count < 2 || (count == 2 && batch == 1) {
        return None;
    }
    let others = (0..count).filter(|b| *b != batch);
    let others = others.map(|b| (DesignTerm::Batch(group, b), -1.0 / (count - 1) as f64));
    let weights: Vec<_> = others.chain([(DesignTerm::Batch(group, batch), 1.0)]).collect();
    let contrast = robust.design.contrast(&robust.fit, &weights)?;
    let data = robust.design.of;
    let contrast = Contrast {
        degrees: contrast.degrees.min(data.degrees_of_group[group]),
        ..contrast
    };
    let members = |of_batch: bool| {
        let specimens = data.specimens.iter().enumerate();
        let kept = specimens.filter(|(s, p)| p.group == group && !robust.choice.outliers.contains(s));
        let name = data.groups[group].batches[batch];
        kept.filter(|(_, p)| (p.batch == name) == of_batch).count().max(1) as f64
    };
    let (own, others) = (members(true), members(false));
    let tau = robust.fit.between_specimens() * data.unit_of_group[group];
    let of_specimens = tau * tau * (1.0 / own + 1.0 / others) / contrast.std_error.powi(2);
    let mut difference = PooledValue::difference(&contrast, data.rows[0].scale, false);
    difference.p = asked.then(|| mean_p(&contrast, own.min(others), of_specimens));
    Some(difference)
}

/// Mean of the rows of one specimen over its standard error with the form error: what this specimen alone says.
fn single_z(robust: &RobustFit, specimen: usize) -> f64 {
    let data = robust.design.of;
    let (mut w, mut sum) = (0.0, 0.0);
    for i in data.specimens[specimen].rows.clone() {
        let d = 1.0 / (robust.fit.variances.y + data.known_variance[i]);
        (w, sum) = (w + d, sum + d * data.y[i]);
    }
    let form = data.form_variance_of(&data.specimens[specimen].rows.clone().collect::<Vec<_>>());
    sum / w / (1.0 / w + form).sqrt()
}

/// The slopes that all families share, and the slope of each family with cycles where there are several.
fn slopes(robust: &RobustFit) -> Vec<AgeSlope> {
    let data = robust.design.of;
    let slope = |robust: &RobustFit, term: DesignTerm, per: AgeUnit, family: Option<&str>| {
        let contrast = robust.design.contrast(&robust.fit, &[(term, 1.0)])?;
        Some(AgeSlope {
            per,
            family: family.map(str::to_owned),
            slope: PooledValue::difference(&contrast, data.rows[0].scale, true),
        })
    };
    let shared = [
        (DesignTerm::Cycles(None), AgeUnit::ThousandCycles),
        (DesignTerm::Years, AgeUnit::Year),
    ];
    let mut slopes: Vec<AgeSlope> = shared
        .into_iter()
        .filter_map(|(term, per)| slope(robust, term, per, None))
        .collect();
    if data.groups.len() > 1 && robust.design.has(DesignTerm::Cycles(None)) {
        let mut choice = robust.choice.clone();
        choice.slope_of_each_group = true;
        let of_each = RobustFit::with(data, choice);
        for (g, group) in data.groups.iter().enumerate() {
            let term = DesignTerm::Cycles(Some(g));
            let of_group = of_each
                .as_ref()
                .and_then(|r| slope(r, term, AgeUnit::ThousandCycles, Some(group.family)));
            slopes.extend(of_group);
        }
    }
    slopes
}

fn specimen_deviation(robust: &RobustFit, specimen: usize, asked: bool) -> SpecimenDeviation {
    let data = robust.design.of;
    let own = &data.specimens[specimen];
    let effect = robust.specimen(specimen);
    let in_group = data.specimens.iter().filter(|s| s.group == own.group).count();
    let asked = asked && in_group >= FEWEST_SPECIMENS && effect.deletion.std_error.is_finite();
    let mut benches: Vec<usize> = data.benches.of_row[own.rows.clone()].to_vec();
    benches.sort_unstable();
    benches.dedup();
    let mut deviation = PooledValue::difference(&effect.predicted, data.rows[0].scale, false);
    deviation.p = asked.then(|| outlier_p(&effect.deletion));
    SpecimenDeviation {
        specimen: own.name.to_owned(),
        family: own.family.to_owned(),
        batch: own.batch.to_owned(),
        benches: benches
            .iter()
            .map(|b| data.benches.names[*b].to_owned())
            .collect(),
        runs: own.rows.len(),
        deviation,
        deletion_t: effect.deletion.estimate / effect.deletion.std_error,
        normal_p: asked.then(|| p_value(&effect.deletion)),
        worth_a_look: false,
    }
}
