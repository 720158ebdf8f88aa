//! The test that would tell a set of effects from what it could be instead.
//!
//! Both are simulated over every test that the bench can run; a rival may refit itself to the prediction, as far as the
//! recordings at hand let it (T-criterion, Atkinson and Fedorov 1975, linearised). What a test would bring counts as it will
//! be judged: against the lack that the verdict asks for once the test's own samples are there. The test that brings all
//! rivals furthest wins, the shortest of those that settle it.

use std::ops::AddAssign;

use nalgebra::{DMatrix, DVector};

use super::diagnosis::NextTest;
use super::problem::ModelStructure;
use super::select::{FitContext, Node, Worth};
use super::trial::{Course, Reach, Trial, trials};
use super::verdict::{ALIKE, told_apart};
use crate::identify::Residuals;
use crate::identify::jacobian::typical;
use crate::profile::ProfileLimits;

/// A test is worth the bench's time where as many like it would settle a rival: twice what `--run-next` runs by itself,
/// because tests were seen to bring about twice what is promised here.
const WORTH_IT: f64 = 8.0;
/// A rival is settled for certain where this many times what is asked for is promised: the noise takes a part of it.
const AMPLE: f64 = 1.5;
/// Rivals that a test is chosen for; there are seldom more.
const RIVALS: usize = 3;
/// Share of a test's cycles that is fitted or compared, not kept for reporting.
const COMPARED: f64 = 0.75;
/// Averaging in a bin never counts for more samples than this (`condition` says the same), and cycles are judged up to here.
const AVERAGED: f64 = 16.0;
const JUDGED_CYCLES: f64 = 11.0;
/// Turns of a test whose places are taken as uncertain: those of a nest, and the first of a long wave, which all are alike.
const TURNS: usize = 40;
/// Finest share of the range of force that a sample is believed to (`problem` says the same).
const LINEARITY: f64 = 2e-4;

/// What a test is to tell.
pub(super) struct Question<'n> {
    pub chosen: &'n Node,
    /// The finding that is in question.
    pub code: &'static str,
    /// The set without it.
    pub without: Rival<'n>,
    /// What it could be instead.
    pub rivals: Vec<Rival<'n>>,
}

/// Something that could stand in place of a finding.
pub(super) struct Rival<'n> {
    pub code: &'static str,
    pub node: &'n Node,
    /// Gain in log-likelihood that it lacks.
    pub lack: f64,
}

/// What a sample is believed to.
struct ChannelNoise {
    force_n: f64,
    displacement_mm: f64,
    finest_n: f64,
    rate_n_per_mm: f64,
    sample_hz: f64,
    /// Points that a recording is thinned to.
    budget: f64,
}

impl ChannelNoise {
    fn of(bench: &FitContext<'_>) -> ChannelNoise {
        let median =
            |f: fn(&super::Track) -> f64| super::smoothing::median(bench.data.tracks.iter().map(f).collect());
        let [low, high] = bench.span.displacement_mm;
        ChannelNoise {
            force_n: median(|t| t.noise_n),
            displacement_mm: median(|t| t.noise_mm),
            finest_n: LINEARITY * bench.data.force_range_n,
            rate_n_per_mm: bench.data.force_range_n / (high - low).max(1e-9),
            sample_hz: bench.data.tracks.iter().map(|t| t.sample_hz).fold(0.0, f64::max),
            budget: bench.data.lengths.iter().copied().max().unwrap_or(1) as f64,
        }
    }

    /// Points that a course will count for.
    fn counted(&self, course: &Course) -> f64 {
        let samples = course.duration_s * self.sample_hz;
        COMPARED * samples.min(self.budget * judged(course, samples > self.budget))
    }

    /// Root of the weight of every point of a course: samples that it stands for over their variance.
    fn weights(&self, course: &Course, force_n: &DVector<f64>) -> DVector<f64> {
        let samples = (course.duration_s * self.sample_hz).max(1.0);
        let averaged = (samples / self.budget).clamp(1.0, AVERAGED);
        let judged = COMPARED * judged(course, samples > self.budget);
        let points = &course.points;
        DVector::from_fn(points.len(), |k, _| {
            let Some(before) = k.checked_sub(1) else {
                return 0.0;
            };
            let dt_s = points[k].time_s - points[before].time_s;
            let dx = (points[k].displacement_mm - points[before].displacement_mm).abs();
            let slope = (force_n[k] - force_n[before]).abs() / dx.max(0.5 * self.displacement_mm).max(1e-9);
            let steep_n = slope.min(100.0 * self.rate_n_per_mm) * self.displacement_mm;
            let variance = ((self.force_n.powi(2) + steep_n.powi(2)) / averaged).max(self.finest_n.powi(2));
            let bins = dt_s / course.duration_s * samples.min(self.budget);
            (judged * bins / variance).sqrt()
        })
    }
}

/// Share of the cycles that is judged: of many, a few are picked.
fn judged(course: &Course, thinned: bool) -> f64 {
    if thinned {
        (JUDGED_CYCLES / course.cycles).min(1.0)
    } else {
        1.0
    }
}

/// A structure over a course.
fn forces(
    bench: &FitContext<'_>,
    structure: &ModelStructure<'_>,
    values: &[f64],
    course: &Course,
) -> Option<DVector<f64>> {
    moved(bench, structure, values, course, None)
}

/// The same with one point of the course that many mm elsewhere.
fn moved(
    bench: &FitContext<'_>,
    structure: &ModelStructure<'_>,
    values: &[f64],
    course: &Course,
    elsewhere: Option<(usize, f64)>,
) -> Option<DVector<f64>> {
    let (zero_n, own) = values.split_last()?;
    let mut plant = super::baseline::build(bench.setup, &structure.attached, own, *zero_n).ok()?;
    let mut before_s = 0.0;
    let force_n = course.points.iter().enumerate().map(|(k, p)| {
        plant.told(&p.motion);
        let off_mm = elsewhere.filter(|(at, _)| *at == k).map_or(0.0, |(_, mm)| mm);
        let force_n = plant.step(p.displacement_mm + off_mm, p.time_s - before_s);
        before_s = p.time_s;
        force_n
    });
    let force_n = DVector::from_iterator(course.points.len(), force_n);
    force_n.iter().all(|f| f.is_finite()).then_some(force_n)
}

/// What a turn that lies a noise of the displacement farther does to every weighted force after it, one column a turn: where
/// the motion turned is known no better, and friction remembers it.
fn turns(
    bench: &FitContext<'_>,
    ours: (&ModelStructure<'_>, &[f64]),
    course: &Course,
    (truth, weights): (&DVector<f64>, &DVector<f64>),
    noise_mm: f64,
) -> Option<DMatrix<f64>> {
    let few = &course.turns[..course.turns.len().min(TURNS)];
    let mut columns = DMatrix::zeros(course.points.len(), few.len());
    for (j, &at) in few.iter().enumerate() {
        let x = |k: usize| course.points[k].displacement_mm;
        let farther_mm = noise_mm * (x(at) - x(at - 1)).signum();
        let mut off = moved(bench, ours.0, ours.1, course, Some((at, farther_mm)))? - truth;
        // What is measured at the turn itself is weighed already.
        off[at] = 0.0;
        columns.set_column(j, &off.component_mul(weights));
    }
    Some(columns)
}

/// A rival with what the recordings say of its parameters.
struct Opponent<'a, 'n> {
    rival: &'n Rival<'n>,
    structure: ModelStructure<'a>,
    /// Sensitivities of the recordings, and the move of each parameter that they are for.
    known: DMatrix<f64>,
    scale: Vec<f64>,
}

impl<'a, 'n> Opponent<'a, 'n> {
    fn new(bench: &FitContext<'a>, rival: &'n Rival<'n>) -> Option<Self> {
        let structure = ModelStructure::new(bench.setup, bench.data, rival.node.attached.clone());
        let fitted = structure.fitted(&rival.node.values)?;
        let (known, scale) = structure.sensitivities(&rival.node.values, &fitted);
        Some(Opponent {
            rival,
            structure,
            known,
            scale,
        })
    }

    /// Sum of squares that is left between `truth` and this over a course, after a refit to it and to all that is known.
    fn left(
        &self,
        bench: &FitContext<'_>,
        course: &Course,
        (truth, weights): (&DVector<f64>, &DVector<f64>),
        turns: &DMatrix<f64>,
    ) -> Option<f64> {
        let values = &self.rival.node.values;
        let run = |values: &[f64]| {
            let force_n = forces(bench, &self.structure, values, course)?;
            Some(force_n.component_mul(weights))
        };
        let here = run(values)?;
        let mut jacobian = DMatrix::zeros(course.points.len(), values.len());
        for (n, p) in self.structure.parameters().iter().enumerate() {
            if bench.setup.surrogate.as_ref().is_some_and(|s| s.holds(n)) {
                continue;
            }
            let size = typical(values[n], p.belief, p.bounds);
            let mut moved = values.clone();
            let step = if moved[n] + 1e-4 * size <= p.bounds[1] {
                1e-4
            } else {
                -1e-4
            };
            moved[n] += step * size;
            jacobian.set_column(n, &((run(&moved)? - &here) * (self.scale[n] / (step * size))));
        }
        let difference = truth.component_mul(weights) - here;
        // The parameters may move as far as the recordings let them, the turns as far as the noise of the displacement.
        let (count, own) = (values.len(), turns.ncols());
        let mut all = jacobian.resize_horizontally(count + own, 0.0);
        all.columns_mut(count, own).copy_from(turns);
        let mut normal = all.tr_mul(&all);
        let known = self.known.tr_mul(&self.known);
        normal.view_mut((0, 0), (count, count)).add_assign(&known);
        for i in 0..count + own {
            let free = if i < count { 1e-9 } else { 1.0 };
            normal[(i, i)] = normal[(i, i)] * (1.0 + 1e-9) + free;
        }
        let moves = normal.cholesky()?.solve(&all.tr_mul(&difference));
        let (of_parameters, of_turns) = (moves.rows(0, count), moves.rows(count, own));
        Some(
            (&difference - &all * &moves).norm_squared()
                + (&self.known * of_parameters).norm_squared()
                + of_turns.norm_squared(),
        )
    }
}

/// What a test would bring.
struct Promise {
    /// Mean over the rivals of how near each comes to being settled.
    score: f64,
    /// Largest gain against one of those that it is worth running for, and which.
    gain: f64,
    against: usize,
    duration_s: f64,
}

/// The most telling test between the set chosen and its rivals; `None` where none tells enough.
pub(super) fn propose(bench: &FitContext<'_>, question: &Question<'_>) -> Option<NextTest> {
    let (chosen, name) = (question.chosen, question.code);
    let ours = ModelStructure::new(bench.setup, bench.data, chosen.attached.clone());
    let opponents: Vec<Opponent<'_, '_>> = question
        .rivals
        .iter()
        .take(RIVALS)
        .filter_map(|rival| Opponent::new(bench, rival))
        .collect();
    let without = Opponent::new(bench, &question.without)?;
    let (noise, worth) = (ChannelNoise::of(bench), Worth::of(bench.data, &chosen.residuals));
    let reach = Reach::new(
        bench.span.displacement_mm,
        bench.span.speed_mm_s,
        [noise.sample_hz, noise.budget],
        bench.limits.as_ref(),
    );
    let trials = trials(&reach);
    let judge = |trial: &Trial| {
        let course = trial.course(&reach, bench.limits.as_ref())?;
        let truth = forces(bench, &ours, &chosen.values, &course)?;
        let allowed = |l: &ProfileLimits| truth.iter().all(|f| (l.force_min_n..=l.force_max_n).contains(f));
        if !bench.limits.as_ref().is_none_or(allowed) {
            return None;
        }
        let weights = noise.weights(&course, &truth);
        let told = (&truth, &weights);
        let turns = turns(
            bench,
            (&ours, &chosen.values),
            &course,
            told,
            noise.displacement_mm,
        )?;
        let gain = |o: &Opponent<'_, '_>| Some(worth.gain(o.left(bench, &course, told, &turns)?));
        let counted = bench.data.counted() as f64 + noise.counted(&course);
        let alike = worth.gain(ALIKE * worth.spread * counted);
        // More of the effect is seen too, and with it more asked of what could stand in its place.
        let loss = question.without.lack + gain(&without)?;
        let mut each: Vec<(f64, f64, bool)> = Vec::with_capacity(opponents.len());
        for o in &opponents {
            let (gain, lack) = (gain(o)?, o.rival.lack);
            let asked = told_apart(o.rival.node, loss, alike);
            each.push((
                ((lack + gain) / asked).min(AMPLE),
                gain,
                lack + WORTH_IT * gain >= asked,
            ));
        }
        let (against, &(_, gain, _)) = each
            .iter()
            .enumerate()
            .filter(|(_, (_, _, worth_it))| *worth_it)
            .max_by(|(_, a), (_, b)| a.1.total_cmp(&b.1))?;
        Some(Promise {
            score: each.iter().map(|e| e.0).sum::<f64>() / each.len() as f64,
            gain,
            against,
            duration_s: course.duration_s,
        })
    };
    let promised: Vec<(&Trial, Promise)> = trials
        .iter()
        .zip(bench.side_by_side(&trials, judge))
        .filter_map(|(trial, promise)| Some((trial, promise?)))
        .collect();
    // The shortest of those that settle it; where none does, the one that comes nearest.
    let (settling, others): (Vec<_>, Vec<_>) = promised.into_iter().partition(|(_, p)| p.score >= AMPLE);
    let (trial, promise) = if settling.is_empty() {
        others
            .into_iter()
            .max_by(|(_, a), (_, b)| a.score.total_cmp(&b.score))
    } else {
        settling
            .into_iter()
            .min_by(|(_, a), (_, b)| a.duration_s.total_cmp(&b.duration_s))
    }?;
    let other = opponents[promise.against].rival.code;
    let separation_sigma = (2.0 * promise.gain * worth.spread * worth.correlation).sqrt();
    Some(NextTest {
        profile_toml: trial.toml(&format!("Tells {name} from {other}.")),
        why: format!(
            "over this profile {name} and {other} differ by {separation_sigma:.0} times the noise, after {other} has been refitted to all that is known"
        ),
        separation_sigma,
        duration_s: promise.duration_s,
    })
}
