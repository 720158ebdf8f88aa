//! The leaf pack identified from recordings that another leaf pack made: finer mesh, other steps, noise on the load cell. The
//! parameters must lie within their own 95 % intervals.

use leafbench::identify::Method;
use leafbench::identify::curve::{Initial, Weighting};
use leafbench::identify::{Control, CurveOptions, CurveProblem, Options, fit, least_squares};
use leafbench::model::leaf_pack::{LeafPack, Mounting, Structure, Values};
use leafbench::model::{self, Plant};
use leafbench::recording::Recording;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const NOISE_N: f64 = 2.0;
/// Samples of a recording, and steps between two of them.
const SAMPLES: usize = 240;
const FINER: usize = 3;

fn recording(structure: &Structure, truth: &Values, random: &mut ChaCha8Rng) -> Recording {
    let mut pack = LeafPack::new(structure, truth).expect("valid");
    let mut recording = Recording {
        name: "made".to_owned(),
        ..Recording::default()
    };
    // 0, up to 16 mm, down to 4, up to 20, down: every branch of the friction is seen.
    let corners = [0.0, 16.0, 4.0, 20.0, 2.0];
    let steps = SAMPLES * FINER;
    for i in 0..steps {
        let at = (corners.len() - 1) as f64 * i as f64 / steps as f64;
        let leg = at as usize;
        let x_mm = corners[leg] + (at - leg as f64) * (corners[leg + 1] - corners[leg]);
        let force_n = pack.step(x_mm, 0.05 / FINER as f64);
        if i % FINER == 0 {
            let normal = (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            recording.time_s.push(0.05 * (i / FINER) as f64);
            recording.displacement_mm.push(x_mm);
            recording.force_n.push(force_n + NOISE_N * normal);
        }
    }
    recording
}

/// Makes with 172 segments, fits with 84: `free` must come back.
fn comes_back(mounting: Mounting, truth: &Values, free: &[(&str, f64)], seed: u64) {
    let made = Structure {
        mounting,
        segments: 172,
        ..Structure::default()
    };
    let recording = recording(&made, truth, &mut ChaCha8Rng::seed_from_u64(seed));
    let fitted = Structure { segments: 84, ..made };
    let table = toml::Table::try_from(&fitted).expect("a table");
    let model = model::find("leaf-pack").expect("listed");
    let problem = CurveProblem::of_model(
        model,
        &table,
        &[recording],
        &CurveOptions {
            weighting: Weighting::Noise {
                force_n: NOISE_N,
                displacement_mm: 0.0,
            },
            initial: Initial::FromRest,
            ..CurveOptions::default()
        },
    )
    .expect("fair");
    let is_free = |name: &str| free.iter().any(|(f, _)| *f == name);
    let mut start = vec![
        truth.thickness_correction_mm,
        truth.clamp_length_mm,
        truth.interleaf_mu,
        truth.pin_mu,
        truth.pivot_torque_nmm,
        truth.rail_mu,
        truth.rail_constant_n,
        truth.board_mu,
        truth.shackle_angle_rad,
        truth.e_mpa,
        truth.preload_mm,
    ];
    let wanted = start.clone();
    for (name, value) in free {
        start[model.parameter_index(name).expect("listed")] = *value;
    }
    let options = Options {
        method: Method::LeastSquares(least_squares::Settings {
            relative_step: 1e-3,
            cost_tolerance: 1e-6,
            iterations: 12,
            ..least_squares::Settings::default()
        }),
        start: Some(start),
        fixed: model
            .parameters
            .iter()
            .filter(|p| !is_free(p.name))
            .map(|p| p.name.to_owned())
            .collect(),
        ..Options::default()
    };
    let found = fit(&problem, &options, &mut |_| Control::Continue).expect("fits");
    for (i, p) in model
        .parameters
        .iter()
        .enumerate()
        .filter(|(_, p)| is_free(p.name))
    {
        let [low, high] = found.ci95[i].expect("an interval");
        println!(
            "{}: {:.5} ({low:.5} to {high:.5}), made with {}",
            p.name, found.values[i], wanted[i]
        );
        assert!(
            low <= wanted[i] && wanted[i] <= high,
            "{} is outside of its own interval",
            p.name
        );
    }
}

#[test]
fn rail_from_another_mesh_and_step() {
    let truth = Values {
        interleaf_mu: 0.2,
        rail_mu: 0.15,
        ..Values::frictionless()
    };
    comes_back(
        Mounting::Rail,
        &truth,
        &[("thickness_correction_mm", 0.05), ("rail_mu", 0.05)],
        7,
    );
}

#[test]
fn shackle_from_another_mesh_and_step() {
    let truth = Values {
        interleaf_mu: 0.2,
        pin_mu: 0.2,
        board_mu: 0.4,
        ..Values::frictionless()
    };
    comes_back(
        Mounting::Shackle,
        &truth,
        &[("interleaf_mu", 0.1), ("shackle_angle_rad", 0.4)],
        8,
    );
}
