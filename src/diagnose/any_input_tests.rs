//! Any recordings of the contract's form give a diagnosis or an error that says what to do, never a panic.

use std::panic::{AssertUnwindSafe, catch_unwind};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::fitting::{fitted_input, input};
use super::*;

/// Number of drawn inputs, and which of them go through the fit of the baseline and through the whole diagnosis: these take 20 ms
/// and a second.
const CASES: u64 = 10_000;
const FITTED: u64 = 20;
const DIAGNOSED: u64 = 500;

/// A number between powers of ten.
fn power(random: &mut ChaCha8Rng, from: f64, to: f64) -> f64 {
    10f64.powf(from + (to - from) * random.random::<f64>())
}

fn whole(random: &mut ChaCha8Rng, below: usize) -> usize {
    (random.random::<f64>() * below as f64) as usize
}

/// Rising times: even, uneven, with pauses, with a change of the rate.
fn times(random: &mut ChaCha8Rng, n: usize) -> Vec<f64> {
    let interval_s = power(random, -4.0, 1.0);
    let form = whole(random, 4);
    let mut time_s = if random.random::<bool>() {
        0.0
    } else {
        power(random, -3.0, 5.0)
    };
    (0..n)
        .map(|i| {
            let share: f64 = random.random();
            time_s += match form {
                0 => interval_s,
                1 => interval_s * (0.01 + share),
                2 if share < 0.05 => interval_s * power(random, 0.0, 4.0),
                3 if i > n / 2 => 20.0 * interval_s,
                _ => interval_s,
            };
            time_s
        })
        .collect()
}

/// A column of some form, with its own size, offset, noise, and sometimes steps of a converter.
fn column(random: &mut ChaCha8Rng, n: usize) -> Vec<f64> {
    let (form, size, period) = (
        whole(random, 8),
        power(random, -5.0, 5.0),
        2.0 + power(random, 0.0, 2.5),
    );
    let offset = if random.random::<bool>() {
        0.0
    } else {
        size * power(random, -2.0, 3.0)
    };
    let noise = size * [0.0, 1e-5, 1e-3, 0.1][whole(random, 4)];
    let step = size * [0.0, 0.0, 1e-3, 0.2][whole(random, 4)];
    let mut walk = 0.0;
    (0..n)
        .map(|i| {
            let share: f64 = random.random();
            let turns = i as f64 / period;
            walk += share - 0.5;
            let value = match form {
                0 => 0.0,
                1 => (std::f64::consts::TAU * turns).sin(),
                2 => 1.0 - (2.0 * turns.fract() - 1.0).abs(),
                3 => walk,
                4 => i as f64 / n as f64,
                5 => f64::from(u8::from(share < 0.5)),
                6 => (3.0 * (std::f64::consts::TAU * turns).sin()).clamp(-1.0, 2.0),
                _ => share,
            };
            let value = offset + size * value + noise * (random.random::<f64>() - 0.5);
            if step > 0.0 {
                (value / step).round() * step
            } else {
                value
            }
        })
        .collect()
}

/// A recording; in two of three the force is that of a spring with friction.
fn recording(random: &mut ChaCha8Rng) -> Recording {
    let n = [1, 2, 19, 20, 21, 30, 60, 150, 400][whole(random, 9)];
    let displacement_mm = column(random, n);
    let mut force_n = column(random, n);
    if random.random::<f64>() < 0.67 {
        let (rate, friction) = (power(random, -1.0, 3.0), 0.3 * random.random::<f64>());
        let noise = [0.0, 1e-4, 1e-2][whole(random, 3)];
        let most = displacement_mm.iter().fold(1e-9f64, |m, x| m.max(x.abs()));
        for i in 0..n {
            let up = i > 0 && displacement_mm[i] > displacement_mm[i - 1];
            let drag = if up { 1.0 + friction } else { 1.0 - friction };
            force_n[i] = rate * (displacement_mm[i] * drag + noise * most * (random.random::<f64>() - 0.5));
        }
    }
    let some = |random: &mut ChaCha8Rng| random.random::<f64>() < 0.15;
    Recording {
        name: "any".to_owned(),
        time_s: times(random, n),
        cycle: some(random).then(|| (0..n).map(|_| whole(random, 5) as u32).collect()),
        flags: some(random).then(|| (0..n).map(|_| [0, 0, 0, 1, 4, 200][whole(random, 6)]).collect()),
        displacement_mm,
        force_n,
        ..Recording::default()
    }
}

/// Runs one case as far as its number asks; true if it was conditioned.
fn run(number: u64) -> bool {
    let mut random = ChaCha8Rng::seed_from_u64(number);
    let files = 1 + whole(&mut random, 3);
    let recordings: Vec<Recording> = (0..files).map(|_| recording(&mut random)).collect();
    let options = DiagnoseOptions {
        points: 20 + whole(&mut random, 150),
        threads: 1,
        ..DiagnoseOptions::default()
    };
    let baseline = Baseline::of(crate::model::find("equivalent").expect("listed"));
    if number.is_multiple_of(DIAGNOSED) {
        let _ = diagnose(&recordings, &baseline, &options, &mut |_, _| {}).map_err(says_what_to_do);
    }
    let tracks = conditioning::tracks(&recordings, options.points_of_each(recordings.len()))
        .map_err(DiagnoseError::from);
    let (data, run) = match tracks.and_then(|tracks| input(tracks, &options)) {
        Ok(input) => input,
        Err(error) => {
            says_what_to_do(error);
            return false;
        }
    };
    for track in &data.tracks {
        let columns = [
            &track.time_s,
            &track.displacement_mm,
            &track.force_n,
            &track.weight,
        ];
        for column in columns {
            assert!(column.len() == track.len() && column.iter().all(|v| v.is_finite()));
        }
        assert!(track.notes.iter().all(|n| n.size.value.is_finite()));
    }
    if number.is_multiple_of(FITTED) {
        let mut setup = Setup::new(&baseline).expect("valid");
        let _ = fitted_input(&mut setup, (data, run), &recordings, &options).map_err(says_what_to_do);
    }
    true
}

/// An error ends in an order.
fn says_what_to_do(error: DiagnoseError) {
    let text = error.to_string();
    assert!(text.contains(": "), "{text}");
}

#[test]
fn any_input_gives_a_diagnosis_or_a_clear_error() {
    let mut conditioned = 0;
    for number in 0..CASES {
        match catch_unwind(AssertUnwindSafe(|| run(number))) {
            Ok(usable) => conditioned += u64::from(usable),
            Err(_) => panic!("case {number} panics"),
        }
    }
    // Short and constant columns are refused; if all were, nothing would be tested.
    assert!(conditioned > CASES / 5, "{conditioned}");
}
