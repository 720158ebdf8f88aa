//! Known parameters come back: from the third paper's curves, and from synthetic recordings within their own intervals.

use crate::identify::curve::{Initial, Weighting};
use crate::identify::{CurveOptions, CurveProblem, FitControl, FitOptions, Method, fit, least_squares};
use crate::model::{self, Plant};
use crate::papers::{second, third};
use crate::recording::Recording;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Figure of issue and paper: within 1 %, in fewer than 400 evaluations, f and r_f judged as a product.
#[test]
fn third_paper_identified_back_from_its_start() {
    for row in third::rerun(2).expect("the published values are within bounds") {
        println!(
            "{} by {}: {} evaluations, {:.4} -> {:.2e} mm a point",
            row.spring, row.method, row.evaluations, row.misfit_start_mm, row.misfit_mm
        );
        for f in &row.figures {
            println!(
                "  {:16} {:12.5e} -> {:12.5e}, published {:12.5e}: {:+.4} %",
                f.name,
                f.start,
                f.identified,
                f.published,
                100.0 * f.error
            );
        }
        for warning in &row.fit.warnings {
            println!("  {warning}");
        }
        if row.method == "least squares" {
            assert!(
                row.worst < 0.01,
                "{} misses by {:.3} %",
                row.spring,
                100.0 * row.worst
            );
            assert!(row.evaluations < 400, "{} took {}", row.spring, row.evaluations);
        }
        let product = row
            .fit
            .warnings
            .iter()
            .any(|w| w.to_string().contains("only the product f * r_f_mm"));
        assert!(product, "the product must be named: {:?}", row.fit.warnings);
    }
}

/// Figure: RMS force error at most a third of that of the thesis' own envelope lines.
#[test]
fn second_paper_table_5_1() {
    let rerun = second::rerun(2).expect("the printed values are within bounds");
    for row in &rerun.rows {
        println!(
            "{:30} RMS {:6.1} N, {:.3} of the envelope's",
            row.model, row.rms_n, row.share_of_envelope
        );
    }
    for ((p, value), ci) in rerun
        .fit
        .parameters
        .iter()
        .zip(&rerun.fit.values)
        .zip(&rerun.fit.ci95)
    {
        println!("  {:22} {value:10.3} {} {ci:?}", p.name, p.unit);
    }
    for warning in &rerun.fit.warnings {
        println!("  {warning}");
    }
    assert!(rerun.rows[3].share_of_envelope < 1.0 / 3.0);
}

/// Standard deviation of the load cell in N and of the LVDT in mm. Noise of the displacement biases what is seen at reversals
/// (the model follows it as path): at 1 um and 300 Hz the intervals of presliding hold 85 % instead of 95.
const NOISE: (f64, f64) = (2.0, 0.0005);

/// Sum of twelve uniform numbers: normal enough for two standard deviations.
fn normal(random: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

/// A recording of `motion` over `duration_s`, 3000 samples with noise on both channels; the plant is stepped seven times finer.
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

/// The card's five: a slow ramp and four sines.
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

/// Fits `model` to recordings made from `truth`, 20 seeds, and says how often each 95 % interval holds the truth.
fn coverage(model: &str, truth: &[f64], scale: f64, fixed: &[&str]) -> Vec<(&'static str, usize)> {
    let model = model::find(model).expect("listed");
    let structure = toml::Table::new();
    let options = CurveOptions {
        weighting: Weighting::Noise {
            force_n: NOISE.0,
            displacement_mm: NOISE.1,
        },
        initial: Initial::FromRest,
        smoothing: 0,
        ..CurveOptions::default()
    };
    let fit_options = FitOptions {
        fixed: fixed.iter().map(|&name| name.to_owned()).collect(),
        threads: 2,
        ..FitOptions::default()
    };
    let mut held: Vec<(&'static str, usize)> = model
        .parameters
        .iter()
        .filter(|p| !fixed.contains(&p.name))
        .map(|p| (p.name, 0))
        .collect();
    for seed in 0..20 {
        let mut plant = model.plant(truth, &structure).expect("within bounds");
        let recordings = five_recordings(plant.as_mut(), scale, seed);
        let problem = CurveProblem::of_model(model, &structure, &recordings, &options).expect("long enough");
        let fit = fit(&problem, &fit_options, &mut |_| FitControl::Continue).expect("starts");
        assert!(fit.converged(), "seed {seed}: {:?}", fit.ending);
        if seed == 0 {
            println!(
                "{}: {} evaluations, worth {:.0} samples",
                model.name, fit.evaluations, fit.effective_samples
            );
            for (i, p) in fit.parameters.iter().enumerate() {
                println!(
                    "  {:22} {:12.6} true {:12.6} {:?}",
                    p.name, fit.values[i], truth[i], fit.ci95[i]
                );
            }
        }
        for (name, count) in &mut held {
            let i = fit
                .parameters
                .iter()
                .position(|p| p.name == *name)
                .expect("its own");
            let inside = fit.ci95[i].is_some_and(|[low, high]| low <= truth[i] && truth[i] <= high);
            *count += usize::from(inside);
        }
    }
    println!("  of 20: {held:?}");
    held
}

#[test]
fn equivalent_comes_back_within_its_own_intervals() {
    for (name, held) in coverage("equivalent", &[35.0, 76.0, 0.13, 0.45], 1.0, &[]) {
        // 95 % of 20 is 19; over 200 seeds 94 to 96 % were held. Fewer than 16 happen once in 400 by chance.
        assert!(held >= 16, "{name}: {held} of 20");
    }
}

#[test]
fn five_link_comes_back_within_its_own_intervals() {
    // Lines that stay above zero: no sample is lost to a spring that is not touched.
    let truth = [27.4, 420.0, 24.0, 30.0, 60.0, 1.0, 3.0];
    for (name, held) in coverage("five-link", &truth, 2.0, &["mu"]) {
        assert!(held >= 16, "{name}: {held} of 20");
    }
}

/// The cores change the time, never a bit.
#[test]
fn same_bits_on_any_number_of_threads() {
    let model = model::find("equivalent").expect("listed");
    let structure = toml::Table::new();
    let mut plant = model
        .plant(&[35.0, 76.0, 0.13, 0.45], &structure)
        .expect("within bounds");
    let recordings = five_recordings(plant.as_mut(), 1.0, 1);
    let problem = CurveProblem::of_model(model, &structure, &recordings[3..], &CurveOptions::default())
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
