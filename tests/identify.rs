//! Known parameters are found again: from the curves of Polach and Hajzman, and from synthetic recordings within their own
//! intervals.

use crate::identify::curve::Initial;
use crate::identify::{CurveProblem, FitControl, FitOptions, Method, Residuals, fit, least_squares};
use crate::model::{self, BuildError, Parameter, Plant};
use crate::papers::{second, third};
use crate::recording::Recording;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Within 1 %, in fewer than 400 evaluations, f and r_f as a product.
#[test]
fn third_paper_identified_back_from_its_start() {
    let rows = third::rerun(2).expect("the published values are within bounds");
    assert_eq!(rows.len(), 4, "two springs by two methods");
    for row in rows {
        if row.method == "least squares" {
            assert!(
                row.worst < 0.01,
                "{} misses by {:.3} %: {:?}",
                row.spring,
                100.0 * row.worst,
                row.figures
            );
            assert!(row.evaluations < 400, "{} took {}", row.spring, row.evaluations);
        }
        let product = row
            .warnings
            .iter()
            .any(|w| w.to_string().contains("only the product f * r_f_mm"));
        assert!(product, "the product must be named: {:?}", row.warnings);
    }
}

/// The RMS force error is at most a third of that of the thesis' own envelope lines.
#[test]
fn second_paper_table_5_1() {
    let rerun = second::rerun(2).expect("the printed values are within bounds");
    assert!(rerun.preloaded.share_of_envelope < 1.0 / 3.0, "{rerun:?}");
}

/// Standard deviation of the load cell in N and of the LVDT in mm. Displacement noise biases what is seen at reversals, because
/// the model follows it as path: at 1 um and 300 Hz the intervals of presliding hold 85 % instead of 95.
const NOISE: (f64, f64) = (2.0, 0.0005);

fn normal(random: &mut ChaCha8Rng) -> f64 {
    random.sample(StandardNormal)
}

/// Recordings whose residuals are divided by the noise instead of the range of force: a true model has variance 1.
struct NoiseWeighted<'a> {
    problem: CurveProblem<'a>,
    /// Range over noise, one per recording.
    factors: Vec<f64>,
}

impl<'a> NoiseWeighted<'a> {
    fn new(problem: CurveProblem<'a>, recordings: &[Recording]) -> Self {
        let range = |column: &[f64]| {
            let ends = (f64::INFINITY, f64::NEG_INFINITY);
            let (low, high) = column.iter().fold(ends, |(l, h), v| (v.min(l), v.max(h)));
            high - low
        };
        let factor = |recording: &Recording| {
            let force_n = range(&recording.force_n);
            let rate = force_n / range(&recording.displacement_mm);
            force_n / NOISE.0.hypot(rate * NOISE.1)
        };
        NoiseWeighted {
            problem,
            factors: recordings.iter().map(factor).collect(),
        }
    }
}

impl Residuals for NoiseWeighted<'_> {
    fn parameters(&self) -> &[Parameter] {
        self.problem.parameters()
    }
    fn count(&self) -> usize {
        self.problem.count()
    }
    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        self.problem.evaluate(values, out)?;
        let mut rest = out;
        for (length, factor) in self.stretches().into_iter().zip(&self.factors) {
            let (stretch, after) = rest.split_at_mut(length);
            stretch.iter_mut().for_each(|residual| *residual *= factor);
            rest = after;
        }
        Ok(())
    }
    fn stretches(&self) -> Vec<usize> {
        self.problem.stretches()
    }
}

/// A recording of `motion` over `duration_s`: 3000 samples with noise on both channels; the plant takes seven steps per sample.
fn record(
    plant: &mut dyn Plant,
    name: &str,
    duration_s: f64,
    motion: impl Fn(f64) -> f64,
    random: &mut ChaCha8Rng,
) -> Recording {
    const FINER: usize = 7;
    let dt_s = duration_s / 3000.0;
    let mut recording = Recording {
        name: name.to_owned(),
        ..Recording::default()
    };
    plant.reset();
    for i in 0..3000 * FINER {
        let t = i as f64 * dt_s / FINER as f64;
        let force_n = plant.step(motion(t), dt_s / FINER as f64);
        if i % FINER == 0 {
            recording.time_s.push(t);
            recording
                .displacement_mm
                .push(motion(t) + NOISE.1 * normal(random));
            recording.force_n.push(force_n + NOISE.0 * normal(random));
        }
    }
    recording
}

/// A slow ramp and four sines.
fn five_recordings(plant: &mut dyn Plant, scale: f64, seed: u64) -> Vec<Recording> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut recordings = vec![record(
        plant,
        "ramp",
        120.0,
        |t| scale * 24.0 * (1.0 - (t / 60.0 - 1.0).abs()),
        &mut random,
    )];
    for (stroke_mm, frequency_hz) in [(6.0, 1.0), (10.0, 1.0), (15.0, 1.0), (6.0, 2.5)] {
        let motion = |t: f64| {
            scale * (2.0 + 0.5 * stroke_mm * (1.0 - (std::f64::consts::TAU * frequency_hz * t).cos()))
        };
        recordings.push(record(plant, "sine", 10.0, motion, &mut random));
    }
    recordings
}

/// Fits `model` to recordings made from `truth`, 20 seeds, and counts how often each 95 % interval holds the truth.
fn coverage(model: &str, truth: &[f64], scale: f64, fixed: &[&str]) -> Vec<(&'static str, usize)> {
    let model = model::find(model).expect("listed");
    let structure = toml::Table::new();
    let fit_options = FitOptions {
        fixed: fixed.iter().map(|&name| name.to_owned()).collect(),
        threads: 2,
        ..FitOptions::default()
    };
    let free = model.parameters.iter().enumerate();
    let mut held: Vec<(usize, usize)> = free
        .filter(|(_, p)| !fixed.contains(&p.name))
        .map(|(i, _)| (i, 0))
        .collect();
    for seed in 0..20 {
        let mut plant = model.plant(truth, &structure).expect("within bounds");
        let recordings = five_recordings(plant.as_mut(), scale, seed);
        let problem = CurveProblem::of_model(model, &structure, &recordings, Initial::FromRest)
            .map(|problem| NoiseWeighted::new(problem, &recordings))
            .expect("long enough");
        let fit = fit(&problem, &fit_options, &mut |_| FitControl::Continue).expect("starts");
        assert!(fit.converged(), "seed {seed}: {:?}", fit.ending);
        for (i, count) in &mut held {
            let inside = fit.ci95[*i].is_some_and(|[low, high]| low <= truth[*i] && truth[*i] <= high);
            *count += usize::from(inside);
        }
    }
    held.into_iter()
        .map(|(i, count)| (model.parameters[i].name, count))
        .collect()
}

#[test]
fn equivalent_comes_back_within_its_own_intervals() {
    for (name, held) in coverage("equivalent", &[35.0, 76.0, 0.13, 0.45], 1.0, &[]) {
        // 95 % of 20 is 19. Fewer than 16 happen once in 400 by chance.
        assert!(held >= 16, "{name}: {held} of 20");
    }
}

#[test]
fn five_link_comes_back_within_its_own_intervals() {
    // Envelope lines above zero: the pusher touches the spring in every sample.
    let truth = [27.4, 420.0, 24.0, 30.0, 60.0, 1.0, 3.0];
    for (name, held) in coverage("five-link", &truth, 2.0, &["mu"]) {
        assert!(held >= 16, "{name}: {held} of 20");
    }
}

/// The number of threads does not change the result.
#[test]
fn same_bits_on_any_number_of_threads() {
    let model = model::find("equivalent").expect("listed");
    let structure = toml::Table::new();
    let mut plant = model
        .plant(&[35.0, 76.0, 0.13, 0.45], &structure)
        .expect("within bounds");
    let recordings = five_recordings(plant.as_mut(), 1.0, 1);
    let problem = CurveProblem::of_model(model, &structure, &recordings[3..], Initial::ReplayFirstCycle)
        .expect("long enough");
    let methods = [
        Method::LeastSquares(least_squares::LeastSquaresSettings {
            screened: 9,
            starts: 2,
            ..Default::default()
        }),
        Method::DifferentialEvolution(Default::default()),
    ];
    for method in methods {
        let with = |threads| {
            let options = FitOptions {
                method,
                threads,
                ..FitOptions::default()
            };
            fit(&problem, &options, &mut |_| FitControl::Continue).expect("starts")
        };
        let one = with(1);
        for threads in [2, 3, 8] {
            assert_eq!(with(threads), one);
        }
    }
}
