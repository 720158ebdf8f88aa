//! The next test: the one that separates a finding from its rivals.
//!
//! The finding and its rivals are simulated over every test that the bench can run. A rival is refitted to the prediction, as far as
//! the recordings allow (T-criterion, Atkinson and Fedorov 1975, linearised). The measure of a
//! test is that of the diagnosis: the lack of log-likelihood of a rival after the samples of the test are added. The shortest
//! test that is sufficient for all rivals is chosen; if no test is sufficient, the one that comes nearest.

use std::ops::AddAssign;

use nalgebra::{DMatrix, DVector};

use super::test_profiles::{TestMotion, TestProfile, TestRange, test_profiles};
use crate::diagnose::conditioning::{LARGEST_AVERAGING, Track, median};
use crate::diagnose::diagnosis::NextTest;
use crate::diagnose::fitting::{
    FitContext, LINEARITY, LikelihoodScale, ModelStructure, Node, STEEPEST, build,
};
use crate::diagnose::judgement::{DISTINCT_POWER, distinguishable_lack};
use crate::identify::Residuals;
use crate::identify::jacobian::typical;
use crate::profile::ProfileLimits;

/// A test is worth running if this many repetitions would distinguish a rival. It is twice the number of tests that `--run-next`
/// runs by itself, because real tests gain about twice what is predicted here.
const REPETITIONS: f64 = 8.0;
/// A test is sufficient if the predicted lack is this many times the one that distinguishes, because noise reduces it.
const SUFFICIENT: f64 = 1.5;
/// Number of rivals that a test is chosen for; there are seldom more.
const RIVALS: usize = 3;
/// Share of a test's cycles that is fitted or compared; the rest is for reporting.
const COMPARED: f64 = 0.75;
/// Number of cycles of a long recording that are compared (`conditioning`): nine spread over it and about two at its ends.
const COMPARED_CYCLES: f64 = 11.0;
/// Number of reversals of a test whose displacement is taken as uncertain: all of a nest of small loops, the first of a long wave.
const REVERSALS: usize = 40;
/// Step of a difference quotient as a share of a parameter's typical size.
const RELATIVE_STEP: f64 = 1e-4;

/// What a test is to decide.
pub(super) struct Question<'n> {
    /// The chosen set.
    pub chosen: &'n Node,
    /// Code of the finding.
    pub code: &'static str,
    /// The set without it.
    pub without: Rival<'n>,
    /// Sets with other effects in its place.
    pub rivals: Vec<Rival<'n>>,
}

/// A set that could replace the chosen one.
pub(super) struct Rival<'n> {
    pub code: &'static str,
    pub node: &'n Node,
    /// Gain in log-likelihood that it lacks.
    pub lack: f64,
}

/// Noise and sampling of a recording, from the recordings at hand.
pub(super) struct ChannelNoise {
    force_n: f64,
    displacement_mm: f64,
    /// Error of the force by the load cell's linearity.
    linearity_n: f64,
    /// Mean slope of force over displacement.
    rate_n_per_mm: f64,
    pub sample_hz: f64,
    /// Number of points that a recording is thinned to.
    pub budget: f64,
}

impl ChannelNoise {
    pub(super) fn of(context: &FitContext<'_>) -> ChannelNoise {
        let tracks = &context.data.tracks;
        let of_tracks = |f: fn(&Track) -> f64| median(tracks.iter().map(f).collect());
        let [low, high] = context.span.displacement_mm;
        ChannelNoise {
            force_n: of_tracks(|t| t.noise_n),
            displacement_mm: of_tracks(|t| t.noise_mm),
            linearity_n: LINEARITY * context.data.force_range_n,
            rate_n_per_mm: context.data.force_range_n / (high - low).max(1e-9),
            sample_hz: tracks.iter().map(|t| t.sample_hz).fold(0.0, f64::max),
            budget: context.data.lengths.iter().copied().max().unwrap_or(1) as f64,
        }
    }

    /// The tests that the bench can run and that a recording of this sampling can show.
    pub(super) fn test_range(&self, context: &FitContext<'_>) -> TestRange {
        TestRange::new(
            context.span.displacement_mm,
            context.span.speed_mm_s,
            [self.sample_hz, self.budget],
            context.limits.as_ref(),
        )
    }

    /// Number of points of a motion that will be fitted or compared.
    fn counted(&self, motion: &TestMotion) -> f64 {
        let samples = motion.duration_s * self.sample_hz;
        COMPARED * samples.min(self.budget * compared_share(motion, samples > self.budget))
    }

    /// Root of the weight of every point of a motion: the number of samples that it stands for, divided by their variance.
    pub(super) fn weights(&self, motion: &TestMotion, force_n: &DVector<f64>) -> DVector<f64> {
        let samples = (motion.duration_s * self.sample_hz).max(1.0);
        let averaged = (samples / self.budget).clamp(1.0, LARGEST_AVERAGING * LARGEST_AVERAGING);
        let compared = COMPARED * compared_share(motion, samples > self.budget);
        let points = &motion.points;
        DVector::from_fn(points.len(), |k, _| {
            let Some(before) = k.checked_sub(1) else {
                return 0.0;
            };
            let dt_s = points[k].time_s - points[before].time_s;
            let dx = (points[k].displacement_mm - points[before].displacement_mm).abs();
            let slope = (force_n[k] - force_n[before]).abs() / dx.max(0.5 * self.displacement_mm).max(1e-9);
            let steep_n = slope.min(STEEPEST * self.rate_n_per_mm) * self.displacement_mm;
            let variance =
                ((self.force_n.powi(2) + steep_n.powi(2)) / averaged).max(self.linearity_n.powi(2));
            let bins = dt_s / motion.duration_s * samples.min(self.budget);
            (compared * bins / variance).sqrt()
        })
    }
}

/// Share of the cycles that is compared: only a part of many cycles, if the recording is thinned.
fn compared_share(motion: &TestMotion, thinned: bool) -> f64 {
    if thinned {
        (COMPARED_CYCLES / motion.cycles).min(1.0)
    } else {
        1.0
    }
}

/// Force of a structure over a motion, N; `None` where it is not finite.
pub(super) fn forces(
    context: &FitContext<'_>,
    structure: &ModelStructure<'_>,
    values: &[f64],
    motion: &TestMotion,
) -> Option<DVector<f64>> {
    forces_with_shift(context, structure, values, motion, None)
}

/// The same; `None` also where the force exceeds the limits of the bench.
pub(super) fn admissible_forces(
    context: &FitContext<'_>,
    structure: &ModelStructure<'_>,
    values: &[f64],
    motion: &TestMotion,
) -> Option<DVector<f64>> {
    let force_n = forces(context, structure, values, motion)?;
    let allowed = |l: &ProfileLimits| {
        force_n
            .iter()
            .all(|f| (l.force_min_n..=l.force_max_n).contains(f))
    };
    context.limits.as_ref().is_none_or(allowed).then_some(force_n)
}

/// The same as [`forces`] with one point of the motion (index) shifted by some mm.
fn forces_with_shift(
    context: &FitContext<'_>,
    structure: &ModelStructure<'_>,
    values: &[f64],
    motion: &TestMotion,
    shifted: Option<(usize, f64)>,
) -> Option<DVector<f64>> {
    let (zero_n, own) = values.split_last()?;
    let mut plant = build(context.setup, &structure.attached, own, *zero_n).ok()?;
    let mut before_s = 0.0;
    let force_n = motion.points.iter().enumerate().map(|(k, p)| {
        plant.told(&p.motion);
        let shift_mm = shifted.filter(|(at, _)| *at == k).map_or(0.0, |(_, mm)| mm);
        let force_n = plant.step(p.displacement_mm + shift_mm, p.time_s - before_s);
        before_s = p.time_s;
        force_n
    });
    let force_n = DVector::from_iterator(motion.points.len(), force_n);
    force_n.iter().all(|f| f.is_finite()).then_some(force_n)
}

/// Change of every weighted force when a reversal shifts by the noise of the displacement, one column per reversal: friction depends
/// on where the motion turned.
fn reversal_sensitivities(
    context: &FitContext<'_>,
    ours: (&ModelStructure<'_>, &[f64]),
    motion: &TestMotion,
    (truth, weights): (&DVector<f64>, &DVector<f64>),
    noise_mm: f64,
) -> Option<DMatrix<f64>> {
    let few = &motion.turns[..motion.turns.len().min(REVERSALS)];
    let mut columns = DMatrix::zeros(motion.points.len(), few.len());
    for (j, &at) in few.iter().enumerate() {
        let x = |k: usize| motion.points[k].displacement_mm;
        let farther_mm = noise_mm * (x(at) - x(at - 1)).signum();
        let mut change = forces_with_shift(context, ours.0, ours.1, motion, Some((at, farther_mm)))? - truth;
        // The error at the reversal itself is in its weight already.
        change[at] = 0.0;
        columns.set_column(j, &change.component_mul(weights));
    }
    Some(columns)
}

/// A rival with the information that the recordings give on its parameters.
pub(super) struct LinearisedRival<'a, 'n> {
    pub rival: &'n Rival<'n>,
    pub structure: ModelStructure<'a>,
    /// Sensitivities over the recordings, for a move of each parameter by its `scale`.
    pub known: DMatrix<f64>,
    scale: Vec<f64>,
}

impl<'a, 'n> LinearisedRival<'a, 'n> {
    pub(super) fn new(context: &FitContext<'a>, rival: &'n Rival<'n>) -> Option<Self> {
        let structure = ModelStructure::new(context.setup, context.data, rival.node.attached.clone());
        let fitted = structure.fitted(&rival.node.values)?;
        let (known, scale) = structure.sensitivities(&rival.node.values, &fitted);
        Some(LinearisedRival {
            rival,
            structure,
            known,
            scale,
        })
    }

    /// Change of the weighted forces over a motion (`here`) when each parameter moves by its `scale`.
    pub(super) fn jacobian(
        &self,
        context: &FitContext<'_>,
        motion: &TestMotion,
        weights: &DVector<f64>,
        here: &DVector<f64>,
    ) -> Option<DMatrix<f64>> {
        let values = &self.rival.node.values;
        let mut jacobian = DMatrix::zeros(motion.points.len(), values.len());
        for (n, p) in self.structure.parameters().iter().enumerate() {
            if context.setup.surrogate.as_ref().is_some_and(|s| s.is_fixed(n)) {
                continue;
            }
            let size = typical(values[n], p.belief, p.bounds);
            let mut moved = values.clone();
            let step = if moved[n] + RELATIVE_STEP * size <= p.bounds[1] {
                RELATIVE_STEP
            } else {
                -RELATIVE_STEP
            };
            moved[n] += step * size;
            let there = forces(context, &self.structure, &moved, motion)?.component_mul(weights);
            jacobian.set_column(n, &((there - here) * (self.scale[n] / (step * size))));
        }
        Some(jacobian)
    }

    /// Sum of squares between `truth` and this rival over a motion, after a refit to it and to the recordings.
    fn discrepancy(
        &self,
        context: &FitContext<'_>,
        motion: &TestMotion,
        (truth, weights): (&DVector<f64>, &DVector<f64>),
        reversals: &DMatrix<f64>,
    ) -> Option<f64> {
        let values = &self.rival.node.values;
        let here = forces(context, &self.structure, values, motion)?.component_mul(weights);
        let jacobian = self.jacobian(context, motion, weights, &here)?;
        let difference = truth.component_mul(weights) - here;
        // The recordings limit the moves of the parameters, the noise of the displacement those of the reversals.
        let (count, own) = (values.len(), reversals.ncols());
        let mut all = jacobian.resize_horizontally(count + own, 0.0);
        all.columns_mut(count, own).copy_from(reversals);
        let mut normal = all.tr_mul(&all);
        let known = self.known.tr_mul(&self.known);
        normal.view_mut((0, 0), (count, count)).add_assign(&known);
        for i in 0..count + own {
            let prior = if i < count { 1e-9 } else { 1.0 };
            normal[(i, i)] = normal[(i, i)] * (1.0 + 1e-9) + prior;
        }
        let moves = normal.cholesky()?.solve(&all.tr_mul(&difference));
        let (of_parameters, of_reversals) = (moves.rows(0, count), moves.rows(count, own));
        Some(
            (&difference - &all * &moves).norm_squared()
                + (&self.known * of_parameters).norm_squared()
                + of_reversals.norm_squared(),
        )
    }
}

/// What a test is predicted to bring.
struct ExpectedGain {
    /// Mean over the rivals of the predicted lack, in units of the lack that distinguishes.
    score: f64,
    /// Largest gain against a rival that the test is worth running for, and the index of that rival.
    gain: f64,
    against: usize,
    duration_s: f64,
}

/// The chosen set and its rivals, ready to be simulated over tests.
struct Comparison<'a, 'c, 'n> {
    context: &'c FitContext<'a>,
    likelihood: LikelihoodScale,
    noise: ChannelNoise,
    range: TestRange,
    chosen: ModelStructure<'a>,
    values: &'n [f64],
    without: LinearisedRival<'a, 'n>,
    rivals: Vec<LinearisedRival<'a, 'n>>,
}

impl<'a, 'c, 'n> Comparison<'a, 'c, 'n> {
    fn new(context: &'c FitContext<'a>, question: &'n Question<'n>) -> Option<Self> {
        let noise = ChannelNoise::of(context);
        Some(Comparison {
            likelihood: LikelihoodScale::of(context.data, &question.chosen.residuals),
            range: noise.test_range(context),
            chosen: context.structure(question.chosen.attached.clone()),
            values: &question.chosen.values,
            without: LinearisedRival::new(context, &question.without)?,
            rivals: question
                .rivals
                .iter()
                .take(RIVALS)
                .filter_map(|rival| LinearisedRival::new(context, rival))
                .collect(),
            context,
            noise,
        })
    }

    /// What a test would bring; `None` if the bench cannot run it, or if no rival is worth it.
    fn expected(&self, test: &TestProfile) -> Option<ExpectedGain> {
        let motion = test.motion(&self.range, self.context.limits.as_ref())?;
        let truth = admissible_forces(self.context, &self.chosen, self.values, &motion)?;
        let weights = self.noise.weights(&motion, &truth);
        let reversals = reversal_sensitivities(
            self.context,
            (&self.chosen, self.values),
            &motion,
            (&truth, &weights),
            self.noise.displacement_mm,
        )?;
        let gain = |rival: &LinearisedRival<'_, '_>| {
            let left = rival.discrepancy(self.context, &motion, (&truth, &weights), &reversals)?;
            Some(self.likelihood.gain(left))
        };
        let counted = self.context.data.counted() as f64 + self.noise.counted(&motion);
        let distinct = self
            .likelihood
            .gain(DISTINCT_POWER * self.likelihood.variance * counted);
        // The test shows more of the effect too, which raises the lack that distinguishes its rivals.
        let loss = self.without.rival.lack + gain(&self.without)?;
        let (mut scores, mut best): (Vec<f64>, Option<(usize, f64)>) = (Vec::new(), None);
        for (k, rival) in self.rivals.iter().enumerate() {
            let (gain, lack) = (gain(rival)?, rival.rival.lack);
            let needed = distinguishable_lack(rival.rival.node, loss, distinct);
            scores.push(((lack + gain) / needed).min(SUFFICIENT));
            let worth_it = lack + REPETITIONS * gain >= needed;
            if worth_it && best.is_none_or(|(_, most)| gain.total_cmp(&most).is_ge()) {
                best = Some((k, gain));
            }
        }
        let (against, gain) = best?;
        Some(ExpectedGain {
            score: scores.iter().sum::<f64>() / scores.len() as f64,
            gain,
            against,
            duration_s: motion.duration_s,
        })
    }
}

/// The best test to separate the chosen set from its rivals; `None` if no test is worth running.
pub(super) fn propose(context: &FitContext<'_>, question: &Question<'_>) -> Option<NextTest> {
    let comparison = Comparison::new(context, question)?;
    let tests = test_profiles(&comparison.range);
    let expected: Vec<(&TestProfile, ExpectedGain)> = tests
        .iter()
        .zip(context.parallel_map(&tests, |test| comparison.expected(test)))
        .filter_map(|(test, gain)| Some((test, gain?)))
        .collect();
    // The shortest sufficient test; if there is none, the one that comes nearest.
    let (sufficient, others): (Vec<_>, Vec<_>) =
        expected.into_iter().partition(|(_, e)| e.score >= SUFFICIENT);
    let (test, gain) = if sufficient.is_empty() {
        others
            .into_iter()
            .max_by(|(_, a), (_, b)| a.score.total_cmp(&b.score))
    } else {
        sufficient
            .into_iter()
            .min_by(|(_, a), (_, b)| a.duration_s.total_cmp(&b.duration_s))
    }?;
    let (code, other) = (question.code, comparison.rivals[gain.against].rival.code);
    let likelihood = comparison.likelihood;
    let separation_sigma = (2.0 * gain.gain * likelihood.variance * likelihood.correlation_time).sqrt();
    Some(NextTest {
        profile_toml: test.toml(&format!("Separates {code} from {other}.")),
        why: format!(
            "{code} and {other} differ by {separation_sigma:.0} times the noise over this profile, even after {other} is refitted"
        ),
        separation_sigma: Some(separation_sigma),
        duration_s: gain.duration_s,
    })
}
