//! Cost of a step of the finite-segment spring, of one evaluation and of one fit: five recordings of 3000 samples.

use std::hint::black_box;

use crate::identify::curve::Initial;
use crate::identify::{CurveProblem, FitControl, FitOptions, Residuals, fit};
use crate::model::{self, finite_segment};
use crate::recording::Recording;
use criterion::{Criterion, Throughput};

const SAMPLES: usize = 3000;

fn motion(i: usize) -> f64 {
    5.0 + 3.0 * (std::f64::consts::TAU * i as f64 / 300.0).sin()
}

pub fn step(c: &mut Criterion) {
    let mut group = c.benchmark_group("model step");
    group.throughput(Throughput::Elements(SAMPLES as u64));
    let build = |name: &str, values: Option<&[f64]>, structure: &str| {
        let model = model::find(name).expect("listed");
        let structure = structure.parse().expect("valid TOML");
        let start = model.start_values();
        let plant = model.plant(values.unwrap_or(&start), &structure);
        plant.expect("published values are within bounds")
    };
    let grp = Some(finite_segment::GRP_OPTIMUM.as_slice());
    for (name, mut plant) in [
        ("equivalent", build("equivalent", None, "")),
        ("five-link", build("five-link", None, "")),
        ("finite-segment, test stand", build("finite-segment", grp, "")),
        (
            "finite-segment, links",
            build("finite-segment", grp, "link_length_mm = 200.0"),
        ),
    ] {
        group.bench_function(name, |b| {
            b.iter(|| {
                (0..SAMPLES)
                    .map(|i| plant.step(black_box(motion(i)), 1e-3))
                    .sum::<f64>()
            });
        });
    }
    group.finish();
}

pub fn refit(c: &mut Criterion) {
    let structure = toml::Table::new();
    let mut group = c.benchmark_group("equivalent, 5 x 3000 samples");
    let model = model::find("equivalent").expect("listed");
    let mut recordings = Vec::new();
    for k in 1..=5 {
        let mut plant = model
            .plant(&[35.0, 76.0, 0.13, 0.45], &structure)
            .expect("within bounds");
        let x = |i: usize| motion(i) * (0.8 + 0.1 * f64::from(k));
        recordings.push(Recording {
            name: format!("sine {k}"),
            time_s: (0..SAMPLES).map(|i| i as f64 / 300.0).collect(),
            displacement_mm: (0..SAMPLES).map(x).collect(),
            // A repeatable roughness of a newton stands for noise: exact data would converge in fewer steps.
            force_n: (0..SAMPLES)
                .map(|i| plant.step(x(i), 1.0 / 300.0) + (i as f64 * 12.9898).sin())
                .collect(),
            ..Recording::default()
        });
    }
    let problem =
        CurveProblem::of_model(model, &structure, &recordings, Initial::FromRest).expect("long enough");
    let values = model.start_values();
    let mut out = vec![0.0; problem.count()];
    group.bench_function("one evaluation", |b| {
        b.iter(|| problem.evaluate(black_box(&values), &mut out));
    });
    for (name, intervals) in [("fit with intervals", true), ("fit", false)] {
        let options = FitOptions {
            intervals,
            ..FitOptions::default()
        };
        group.bench_function(name, |b| {
            b.iter(|| fit(&problem, &options, &mut |_| FitControl::Continue))
        });
    }
    group.finish();
}
