//! The fit that outlier specimens do not spoil: a specimen that does not belong to its family gets a mean of its own (mean-shift outlier
//! model), so that it enlarges neither the scatter between specimens nor the interval of another one.
//!
//! The search starts from a set without doubtful specimens, judged by medians, so that two outliers cannot hide each other. It takes
//! back those that the fit without them does not confirm, and sets aside others that it does. A heavy-tailed law for the specimens
//! in place of this would hide the outliers that the report has to name.
//!
//! How specimens of a family scatter is not known to be normal, and a skewed law has specimens at five standard deviations that are no
//! outliers. So the p value of an outlier is that of Laplace's law, whose tails fall as exponentials, where that is the larger one. A fit
//! within benches sets aside what a normal law would not have: an outlier enlarges the scatter that it is measured in, and being set
//! aside is no finding.

use super::design::{Design, DesignChoice, DesignTerm};
use super::mixed_model::{Contrast, MixedFit, SpecimenEffect};
use super::quantity_data::QuantityData;
use crate::identify::confidence::student_within;
use statrs::function::gamma::gamma_ur;

/// Robust z value from which a specimen is doubtful at first. It costs only fits: every doubt is tested.
const DOUBTFUL: f64 = 3.0;
/// Standard deviation of a normal law over its median absolute deviation.
pub(super) const SIGMA_OF_MEDIAN: f64 = 1.4826;
/// Chance that a quantity without outliers has one set aside (Bonferroni over its specimens).
const SET_ASIDE_AT: f64 = 0.05;
/// At most one of so many specimens of a group is set aside: more are no outliers but another family.
const ONE_IN: usize = 3;

/// Shape of a gamma law from which its tails are those of a normal law within a factor of 2 at four standard deviations.
const NORMAL_SHAPE: f64 = 1000.0;

/// A fit with its outliers.
pub(super) struct RobustFit<'d, 'r> {
    pub design: Design<'d, 'r>,
    pub fit: MixedFit,
    pub choice: DesignChoice,
}

/// The fits of one quantity.
pub(super) struct QuantityFits<'d, 'r> {
    /// One bench effect for all families: benches against each other, and levels.
    pub lab: RobustFit<'d, 'r>,
    /// Bench effects of each family: batches, specimens, operators and ageing.
    pub within: RobustFit<'d, 'r>,
}

/// Two-sided p value of a t statistic.
pub(super) fn p_value(contrast: &Contrast) -> f64 {
    if contrast.std_error <= 0.0 {
        return 1.0;
    }
    1.0 - student_within(contrast.degrees, (contrast.estimate / contrast.std_error).abs())
}

/// p value of a specimen's deviation from its family: of Student's t or of Laplace's law, whichever is larger. The second is that of
/// an exponential law over the mean of as many others as there are degrees of freedom.
pub(super) fn outlier_p(deletion: &Contrast) -> f64 {
    if deletion.std_error <= 0.0 {
        return 1.0;
    }
    let t = (deletion.estimate / deletion.std_error).abs();
    let laplace = (1.0 + std::f64::consts::SQRT_2 * t / deletion.degrees).powf(-deletion.degrees);
    p_value(deletion).max(laplace)
}

/// p value of a mean over `specimens` specimens, which bring the share `of_specimens` of its variance: of Student's t or of the gamma law
/// with the skewness that specimens of an exponential law give the mean, whichever is larger.
pub(super) fn mean_p(mean: &Contrast, specimens: f64, of_specimens: f64) -> f64 {
    let student = p_value(mean);
    if mean.std_error <= 0.0 || of_specimens <= 0.0 {
        return student;
    }
    let t = (mean.estimate / mean.std_error).abs();
    // Skewness of the mean of m exponential deviations: 2 / sqrt(m); of a gamma law: 2 / sqrt(shape).
    let shape = specimens / of_specimens.min(1.0).powi(3);
    // With a large shape the gamma law is normal, and Student's t has the wider tails.
    if shape > NORMAL_SHAPE {
        return student;
    }
    student.max(gamma_ur(shape, shape + t * shape.sqrt()))
}

impl<'d, 'r> RobustFit<'d, 'r> {
    /// Fits and sets outliers aside. `None` if there are too few rows.
    pub(super) fn of(data: &'d QuantityData<'r>, operators: bool) -> Option<RobustFit<'d, 'r>> {
        RobustFit::search(
            data,
            DesignChoice {
                operators,
                ..DesignChoice::default()
            },
        )
    }

    /// The same with a bench effect of each group: for what is compared within a family.
    pub(super) fn within_benches(data: &'d QuantityData<'r>, operators: bool) -> Option<RobustFit<'d, 'r>> {
        RobustFit::search(
            data,
            DesignChoice {
                operators,
                bench_of_each_group: true,
                ..DesignChoice::default()
            },
        )
    }

    fn search(data: &'d QuantityData<'r>, choice: DesignChoice) -> Option<RobustFit<'d, 'r>> {
        let plain = RobustFit::with(data, choice)?;
        // Within benches few specimens share a cell, and an outlier makes its neighbours doubtful: it is named before they are.
        if plain.choice.bench_of_each_group && plain.strongest(&[]).is_some() {
            return Some(plain.improved());
        }
        let doubtful = plain.doubtful();
        // A design that the doubtful specimens leave too few rows is not better.
        let start = match plain.with_outliers(doubtful) {
            Some(fit) => fit,
            None => plain,
        };
        Some(start.improved())
    }

    /// Takes specimens back and sets others aside, one at a time, until each has the reason that it needs.
    fn improved(self) -> RobustFit<'d, 'r> {
        let mut here = self;
        let mut taken_back = Vec::new();
        for _ in 0..2 * here.design.of.specimens.len() {
            let (weakest, mut next) = here.weakest_and_confirmed();
            taken_back.extend(weakest);
            match here.strongest(&taken_back) {
                _ if weakest.is_some() => {}
                Some(strongest) => next.push(strongest),
                None => break,
            };
            let Some(fit) = here.with_outliers(next) else {
                break;
            };
            here = fit;
        }
        here
    }

    /// Fits one design.
    pub(super) fn with(data: &'d QuantityData<'r>, choice: DesignChoice) -> Option<RobustFit<'d, 'r>> {
        let design = Design::of(data, &choice);
        let fit = design.data.fit()?;
        Some(RobustFit { design, fit, choice })
    }

    fn with_outliers(&self, mut outliers: Vec<usize>) -> Option<RobustFit<'d, 'r>> {
        outliers.sort_unstable();
        let choice = DesignChoice {
            outliers,
            ..self.choice.clone()
        };
        RobustFit::with(self.design.of, choice)
    }

    /// The same fit with a mean of its own for a specimen, so that it moves neither the mean of its family nor the scatter.
    pub(super) fn setting_aside(&self, specimen: usize) -> Option<RobustFit<'d, 'r>> {
        let mut outliers = self.choice.outliers.clone();
        outliers.retain(|s| *s != specimen);
        outliers.push(specimen);
        self.with_outliers(outliers)
    }

    /// A sum of effects that holds the mean of a specimen, which is set aside: without the scatter of its family.
    pub(super) fn value_of(&self, specimen: usize, weights: &[(DesignTerm, f64)]) -> Contrast {
        let data = self.design.of;
        let unit = data.unit_of_group[data.specimens[specimen].group];
        self.fit
            .contrast_of_known(&self.design.entries(weights), unit * unit)
    }

    /// What is known about a specimen: about the outlier's own mean, or about its random effect.
    pub(super) fn specimen(&self, specimen: usize) -> SpecimenEffect {
        let data = self.design.of;
        let unit = data.unit_of_group[data.specimens[specimen].group];
        let tau2 = self.fit.variances.x * unit * unit;
        match self.own_mean(specimen) {
            Some(own) => SpecimenEffect {
                // The scatter of the family is no uncertainty of where this specimen is.
                predicted: Contrast {
                    std_error: (own.std_error.powi(2) - tau2).max(0.0).sqrt(),
                    ..own
                },
                deletion: own,
            },
            None => {
                let effect = self.fit.specimen(&self.design.data, specimen);
                SpecimenEffect {
                    predicted: effect.predicted.times(unit),
                    deletion: effect.deletion.times(unit),
                }
            }
        }
    }

    /// p value by which a specimen is set aside.
    fn set_aside_p(&self, deletion: &Contrast) -> f64 {
        match self.choice.bench_of_each_group {
            true => p_value(deletion),
            false => outlier_p(deletion),
        }
    }

    /// The mean-shift of a specimen that is set aside.
    fn own_mean(&self, specimen: usize) -> Option<Contrast> {
        self.design
            .contrast(&self.fit, &[(DesignTerm::Outlier(specimen), 1.0)])
    }

    /// Specimens whose deviation from the median of their group is large against the median deviation of all.
    fn doubtful(&self) -> Vec<usize> {
        let specimens = &self.design.of.specimens;
        let z = |s: usize| {
            let deletion = self.specimen(s).deletion;
            deletion.estimate / deletion.std_error
        };
        let mut z: Vec<f64> = (0..specimens.len()).map(z).collect();
        for group in 0..self.design.of.groups.len() {
            let members: Vec<usize> = self.members(group).collect();
            let middle = median(members.iter().map(|s| z[*s]).collect());
            members.iter().for_each(|s| z[*s] -= middle);
        }
        let scale = SIGMA_OF_MEDIAN * median(z.iter().map(|z| z.abs()).collect());
        let mut doubtful: Vec<usize> = (0..z.len()).filter(|s| z[*s].abs() > DOUBTFUL * scale).collect();
        doubtful.sort_by(|a, b| z[*b].abs().total_cmp(&z[*a].abs()));
        let mut chosen: Vec<usize> = Vec::new();
        for specimen in doubtful {
            if self.has_room(specimen, &chosen) {
                chosen.push(specimen);
            }
        }
        chosen
    }

    fn members(&self, group: usize) -> impl Iterator<Item = usize> {
        let specimens = self.design.of.specimens.iter().enumerate();
        specimens.filter(move |(_, s)| s.group == group).map(|(i, _)| i)
    }

    /// True if another specimen of this one's group may be set aside.
    fn has_room(&self, specimen: usize, outliers: &[usize]) -> bool {
        let specimens = &self.design.of.specimens;
        let group = specimens[specimen].group;
        let aside = outliers.iter().filter(|s| specimens[**s].group == group).count();
        (aside + 1) * ONE_IN <= self.members(group).count()
    }

    /// Largest p value of a specimen that is set aside.
    fn level(&self) -> f64 {
        SET_ASIDE_AT / self.design.of.specimens.len() as f64
    }

    /// The specimen set aside with the least reason for it, if that is too little, and the others. One at a time: a specimen beside an
    /// outlier looks doubtful because of it, and hides it if both are set aside.
    fn weakest_and_confirmed(&self) -> (Option<usize>, Vec<usize>) {
        let p = |s: usize| self.own_mean(s).map_or(1.0, |own| self.set_aside_p(&own));
        let aside = &self.choice.outliers;
        let weakest = aside
            .iter()
            .map(|s| (*s, p(*s)))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let weakest = weakest.filter(|(_, p)| *p > self.level()).map(|(s, _)| s);
        let others = aside.iter().copied().filter(|s| Some(*s) != weakest);
        (weakest, others.collect())
    }

    /// The specimen of the fit that has the most reason to be set aside, if that is enough.
    fn strongest(&self, taken_back: &[usize]) -> Option<usize> {
        let aside = &self.choice.outliers;
        let all = (0..self.design.of.specimens.len())
            .filter(|s| !aside.contains(s) && !taken_back.contains(s) && self.has_room(*s, aside));
        let p = all.map(|s| (s, self.set_aside_p(&self.specimen(s).deletion)));
        let strongest = p.min_by(|a, b| a.1.total_cmp(&b.1))?;
        (strongest.1 < self.level()).then_some(strongest.0)
    }
}

/// The middle value; 0 without values.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: the mean of one specimen is exponential, exp(-(1 + t)); without a share of specimens Student's law is left.
    #[test]
    fn a_mean_of_few_specimens_has_the_tail_of_their_law() {
        let contrast = Contrast {
            estimate: 5.0,
            std_error: 1.0,
            degrees: 1e6,
        };
        assert!((mean_p(&contrast, 1.0, 1.0) - (-6.0f64).exp()).abs() < 1e-9);
        let normal = p_value(&contrast);
        assert!((mean_p(&contrast, 2.0, 0.0) - normal).abs() < 1e-15);
        let (two, ten) = (mean_p(&contrast, 2.0, 1.0), mean_p(&contrast, 10.0, 1.0));
        assert!((-6.0f64).exp() > two && two > ten && ten > normal);
        assert!(mean_p(&contrast, 5.0, 0.3) < ten);
    }
}
