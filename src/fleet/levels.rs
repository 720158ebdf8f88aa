//! Which bench or operator deviates: each level of a factor against the mean of the others.
//!
//! One bench that reads high makes the others look low against the mean of all. So the level that deviates most is taken out of the mean
//! before the others are judged, and so on as long as three are left (step-down). Of two levels nobody can say which one is wrong.

use super::design::DesignTerm;
use super::findings::{LevelEffect, PooledValue};
use super::mixed_model::Contrast;
use super::outliers::{RobustFit, p_value};

/// A factor whose levels are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Factor {
    Bench,
    Operator,
}

/// Chance that a level of a factor without effect is taken out of the mean of the others (Bonferroni over the levels left). It decides
/// only what the others are compared with: what is found is decided by the correction over all questions.
const TAKEN_OUT_AT: f64 = 0.05;

impl Factor {
    fn term(self, level: usize) -> DesignTerm {
        match self {
            Factor::Bench => DesignTerm::Bench(level),
            Factor::Operator => DesignTerm::Operator(level),
        }
    }
}

impl RobustFit<'_, '_> {
    /// A level against the mean of others; `None` if it cannot be told. Benches sample and move differently, so the error of a model is
    /// not the same on all of them. It counts where the difference comes from: in the specimens that were tested on several benches.
    pub(super) fn level_against(&self, factor: Factor, level: usize, others: &[usize]) -> Option<Contrast> {
        let share = -1.0 / others.len() as f64;
        let others = others.iter().map(|o| (factor.term(*o), share));
        let weights: Vec<_> = others.chain([(factor.term(level), 1.0)]).collect();
        let contrast = self.design.contrast(&self.fit, &weights)?;
        let data = self.design.of;
        let travelling = (0..data.specimens.len()).filter(|s| factor == Factor::Bench && data.travels(*s));
        let rows: Vec<usize> = travelling
            .flat_map(|s| data.specimens[s].rows.clone())
            .filter(|i| data.benches.of_row[*i] == level)
            .collect();
        let form = data.bench_form_share.powi(2) * data.form_variance_of(&rows);
        Some(contrast.with_form_variance(form))
    }
}

/// The effects of some levels of a factor. With a reference among them, each other one is compared with it alone.
pub(super) fn level_effects(
    robust: &RobustFit,
    factor: Factor,
    levels: &[usize],
    reference: Option<&str>,
) -> Vec<LevelEffect> {
    let data = robust.design.of;
    let names = match factor {
        Factor::Bench => &data.benches.names,
        Factor::Operator => &data.operators.names,
    };
    let effect = |level: usize, others: &[usize]| {
        let contrast = robust.level_against(factor, level, others)?;
        Some(LevelEffect {
            name: names[level].to_owned(),
            against: others.iter().map(|o| names[*o].to_owned()).collect(),
            effect: PooledValue::difference(&contrast, data.rows[0].scale, true),
        })
    };
    let without = |left: &[usize], level: usize| -> Vec<usize> {
        left.iter().copied().filter(|l| *l != level).collect()
    };
    if let Some(&right) = levels.iter().find(|l| Some(names[**l]) == reference) {
        let others = without(levels, right).into_iter();
        return others.filter_map(|level| effect(level, &[right])).collect();
    }
    let mut left = levels.to_vec();
    let mut effects = Vec::new();
    while left.len() > 2 {
        let judged = |level: &usize| {
            let contrast = robust.level_against(factor, *level, &without(&left, *level))?;
            Some((
                *level,
                p_value(&contrast),
                (contrast.estimate / contrast.std_error).abs(),
            ))
        };
        // Two p values that are 0 to the rounding are told by their t.
        let clearest = left
            .iter()
            .filter_map(judged)
            .min_by(|a, b| (a.1.total_cmp(&b.1)).then(b.2.total_cmp(&a.2)));
        let Some((level, ..)) = clearest.filter(|(_, p, _)| p * (left.len() as f64) < TAKEN_OUT_AT) else {
            break;
        };
        left = without(&left, level);
        effects.extend(effect(level, &left));
    }
    match left[..] {
        [] | [_] => {}
        [a, b] => effects.extend(effect(a, &[b])),
        _ => effects.extend(left.iter().filter_map(|l| effect(*l, &without(&left, *l)))),
    }
    effects
}
