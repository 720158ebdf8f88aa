//! One sine at one frequency yields groups, not names; and what it leaves open has a next test, also where no effect is named.

use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;

use crate::diagnose::{Baseline, DiagnoseOptions, Diagnosis, Verdict, diagnose};
use crate::profile::{Profile, ProfileLimits, check};
use crate::recording::Recording;

/// A name from this confidence on is sure.
const SURE: f64 = 0.9;
const SAMPLE_HZ: f64 = 200.0;
/// Steps of the specimen in a sample.
const PARTS: usize = 6;

/// Limits of a bench on which all loops of these tests can run.
const LIMITS: ProfileLimits = ProfileLimits {
    force_min_n: -200.0,
    force_max_n: 5000.0,
    displacement_min_mm: -5.0,
    displacement_max_mm: 45.0,
    velocity_max_mm_s: 150.0,
    acceleration_max_mm_s2: 3000.0,
};

/// What the specimen or its channels have beside preload, rate and friction.
#[derive(Clone, Copy)]
enum Hidden {
    Nothing,
    /// Viscous damping, N s/mm.
    Damping(f64),
    /// Force behind the displacement, s.
    Delay(f64),
    /// Rate in N/mm of each of three relaxing arms.
    Arms(f64),
    /// N/mm beyond 19 mm.
    Knee(f64),
    /// Friction in N that acts near 15 mm only: no effect of the library.
    LocalFriction(f64),
    /// Force that waves along the travel, N: no effect of the library.
    Ripple(f64),
}

use Hidden::*;

/// Loops in steady state: mean and amplitude in mm, frequency in Hz, number of cycles.
fn sine([mean_mm, amplitude_mm, hz, cycles]: [f64; 4], hidden: Hidden, seed: u64) -> Recording {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rate_n_per_mm = rng.random_range(60.0..85.0);
    let preload_n = rng.random_range(80.0..200.0);
    let ratio = rng.random_range(0.07..0.13);
    let step_s = 1.0 / (SAMPLE_HZ * PARTS as f64);
    let delay_s = if let Delay(s) = hidden { s } else { 0.0 };
    let at_mm = |t: f64| mean_mm + amplitude_mm * (TAU * hz * t).sin();
    let lengths: Vec<f64> = (0..16)
        .map(|i| 0.5 * (-(1.0 - (f64::from(i) + 0.5) / 16.0).ln()).powf(1.0 / 1.2))
        .collect();
    let (mut plays, mut arms_mm) = (vec![0.0; lengths.len()], [0.0; 3]);
    // Two cycles pass before the first sample.
    let begin_s = -2.0 / hz;
    let mut before_mm = at_mm(begin_s - delay_s);
    let mut recording = Recording {
        name: "sine.csv".to_owned(),
        ..Recording::default()
    };
    for step in 0..((cycles + 2.0) / hz / step_s) as usize {
        let time_s = begin_s + step as f64 * step_s;
        let x_mm = at_mm(time_s - delay_s);
        let by_mm = x_mm - before_mm;
        before_mm = x_mm;
        for (play, length_mm) in plays.iter_mut().zip(&lengths) {
            *play = f64::clamp(*play + by_mm / length_mm, -1.0, 1.0);
        }
        let state = plays.iter().sum::<f64>() / plays.len() as f64;
        let mut load_n = preload_n + rate_n_per_mm * x_mm;
        let speed = by_mm / step_s;
        if let Knee(n_per_mm) = hidden {
            load_n += n_per_mm * (x_mm - 19.0).max(0.0);
        }
        for (arm_mm, tau_s) in arms_mm.iter_mut().zip([0.4, 3.0, 25.0]) {
            *arm_mm = *arm_mm * f64::exp(-step_s / tau_s) + by_mm;
        }
        let added_n = match hidden {
            Damping(n_s_per_mm) => n_s_per_mm * speed,
            Arms(n_per_mm) => n_per_mm * arms_mm.iter().sum::<f64>(),
            LocalFriction(n) => n * (-((x_mm - 15.0) / 1.5).powi(2)).exp() * state,
            Ripple(n) => n * (TAU * x_mm / 2.5).sin(),
            _ => 0.0,
        };
        if time_s >= 0.0 && step % PARTS == 0 {
            let noise: [f64; 2] = [rng.sample(StandardNormal), rng.sample(StandardNormal)];
            recording.time_s.push(time_s);
            recording.displacement_mm.push(at_mm(time_s) + 0.002 * noise[0]);
            recording
                .force_n
                .push(load_n * (1.0 + ratio * state) + added_n + noise[1]);
        }
    }
    recording
}

fn diagnosed(recordings: &[Recording]) -> Diagnosis {
    let baseline = Baseline::of(&crate::model::equivalent::MODEL);
    let options = DiagnoseOptions {
        threads: 1,
        limits: Some(LIMITS),
        ..DiagnoseOptions::default()
    };
    diagnose(recordings, &baseline, &options, &mut |_, _| {}).expect("sound data")
}

/// The diagnosis of one sine of ten cycles.
fn of_one_sine(hidden: Hidden, seed: u64) -> Diagnosis {
    diagnosed(&[sine([17.0, 10.0, 1.0, 10.0], hidden, seed)])
}

fn named(d: &Diagnosis) -> Vec<(&str, f64, Vec<&str>)> {
    d.effects
        .iter()
        .map(|e| {
            (
                e.code.as_str(),
                e.confidence,
                e.group.iter().map(String::as_str).collect(),
            )
        })
        .collect()
}

/// The next test is a profile that a bench with these limits accepts.
fn is_runnable(d: &Diagnosis) {
    let next = d
        .next_test
        .as_ref()
        .unwrap_or_else(|| panic!("no next test: {:?}, {:?}", d.no_next_test, d.not_testable));
    let profile = Profile::from_toml(&next.profile_toml, "next-test.toml").expect("a profile");
    let violations = check::violations(&profile, &LIMITS, 0.0, 1000.0).expect("it can be played");
    assert!(violations.is_empty(), "{}", next.profile_toml);
    assert!(next.duration_s > 0.0 && next.why.len() > 40, "{}", next.why);
}

/// Before, a relaxation was drift, damping and constant friction, two of them sure; a local friction was two stiffnesses, both sure.
#[test]
fn a_wrong_name_is_not_sure() {
    let cases = [
        (Arms(1.0), "relaxation"),
        (LocalFriction(12.5), "unknown"),
        (Arms(1.4), "relaxation"),
    ];
    let failures: Vec<String> = cases
        .par_iter()
        .enumerate()
        .filter_map(|(k, &(hidden, truth))| {
            let d = of_one_sine(hidden, 711 + k as u64);
            let wrong = d.effects.iter().any(|e| e.code != truth && e.confidence >= SURE);
            println!("{truth}: {:?} {:?}", d.verdict, named(&d));
            wrong.then(|| format!("{truth}: {:?}", named(&d)))
        })
        .collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Damping and a delay change the loop of one sine in the same way. A second frequency tells them apart.
#[test]
fn damping_and_delay_are_one_group_until_a_second_frequency_is_recorded() {
    let one = of_one_sine(Damping(0.3), 721);
    let [finding] = one.effects.as_slice() else {
        panic!("{:?}", named(&one));
    };
    for code in ["viscous_damping", "channel_delay"] {
        assert!(finding.group.iter().any(|c| c == code), "{:?}", named(&one));
    }
    assert_eq!(finding.group[0], finding.code);
    assert!(finding.confidence < SURE, "{:?}", named(&one));
    assert!(finding.statement.starts_with("One of: "), "{}", finding.statement);
    assert!(one.summary.contains("one of"), "{}", one.summary);
    assert!(one.settled().is_none());
    is_runnable(&one);
    let waves = [
        [17.0, 10.0, 1.0, 10.0],
        [17.0, 10.0, 0.1, 4.0],
        [17.0, 4.0, 3.0, 20.0],
    ];
    let more = diagnosed(&waves.map(|wave| sine(wave, Damping(0.3), 721)));
    let sure = |d: &Diagnosis| {
        d.effects
            .iter()
            .any(|e| e.code == "viscous_damping" && e.confidence >= SURE)
    };
    assert!(
        sure(&more) && more.effects[0].group.is_empty(),
        "{:?}",
        named(&more)
    );
}

/// Where the shape of the loop decides, one sine is enough.
#[test]
fn what_the_shape_of_the_loop_determines_stays_sure() {
    let cases = [
        (Knee(20.0), "progressive_stiffness"),
        (Delay(4e-3), "channel_delay"),
    ];
    let failures: Vec<String> = cases
        .par_iter()
        .enumerate()
        .filter_map(|(k, &(hidden, code))| {
            let d = of_one_sine(hidden, 731 + k as u64);
            let right = matches!(d.effects.as_slice(), [e] if e.code == code && e.confidence >= SURE);
            (!right).then(|| format!("{code}: {:?}", named(&d)))
        })
        .collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn the_unknown_has_a_next_test_that_separates_its_axes() {
    let d = of_one_sine(Ripple(12.0), 741);
    assert_eq!(d.verdict, Verdict::Unexplained, "{:?}", named(&d));
    is_runnable(&d);
    let next = d.next_test.as_ref().expect("checked");
    assert!(
        next.why.contains("go together") && next.separation_sigma.is_none(),
        "{}",
        next.why
    );
    // Three means, sizes and speeds tie no axis to another.
    let mut several: Vec<Recording> = [
        [17.0, 14.0, 1.0, 8.0],
        [8.0, 5.0, 0.1, 4.0],
        [25.0, 6.0, 0.4, 8.0],
    ]
    .map(|wave| sine(wave, Ripple(12.0), 741))
    .into();
    for (k, recording) in several.iter_mut().enumerate() {
        recording.name = format!("sine-{k}.csv");
    }
    let d = diagnosed(&several);
    assert_eq!(d.verdict, Verdict::Unexplained, "{:?}", named(&d));
    assert!(d.next_test.is_none(), "{:?}", d.next_test);
    assert!(
        d.no_next_test.as_ref().is_some_and(|why| why.contains("inspect")),
        "{:?}",
        d.no_next_test
    );
}

#[test]
fn what_an_adequate_recording_cannot_show_has_a_next_test_or_a_reason_why_not() {
    // What cannot be shown differs from draw to draw. No motion tells a compliance in series from softer leaves, so alone it has no test;
    // the reason is also in the words that `words` has on record.
    let mut tests = 0;
    for seed in 751..757 {
        let d = of_one_sine(Nothing, seed);
        assert_eq!(d.verdict, Verdict::Adequate, "{:?}", named(&d));
        assert!(d.settled().is_some(), "such a test is no condition of the answer");
        let unseen: Vec<&str> = d.not_testable.iter().map(|n| n.code.as_str()).collect();
        match (unseen.as_slice(), &d.no_next_test) {
            ([], none) => assert!(none.is_none(), "{none:?}"),
            (["series_compliance"], Some(why)) => {
                assert!(
                    why.contains("cannot show series compliance, and no profile"),
                    "{why}"
                );
            }
            _ => {
                is_runnable(&d);
                let next = d.next_test.as_ref().expect("checked");
                let inertia = !unseen.contains(&"inertia") || next.why.contains("cannot show inertia");
                assert!(inertia && next.why.contains("cannot show"), "{}", next.why);
                tests += 1;
            }
        }
    }
    assert!(tests >= 3, "{tests}");
}
