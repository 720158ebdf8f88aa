//! Sealed cases, and the controls that must fail to find anything.

use crate::blind::{BlindRequest, baseline, examine, figures, page, run};
use crate::diagnose::{DiagnoseOptions, Diagnosis, Verdict, diagnose};
use crate::recording::Recording;
use crate::truth::Case;
use rand::SeedableRng;
use rand::seq::SliceRandom;

/// Thinned out: these tests ask what is found, not how exactly.
const POINTS: usize = 500;

fn ask(recordings: &[Recording], case: &Case) -> Diagnosis {
    let options = DiagnoseOptions {
        points: POINTS,
        threads: 0,
        limits: None,
    };
    diagnose(recordings, &baseline(&case.start), &options, &mut |_, _| {}).expect("sound recordings")
}

fn codes(d: &Diagnosis) -> Vec<&str> {
    d.effects.iter().map(|e| e.code.as_str()).collect()
}

/// Same specimen, motion and sensors: what is found with the effect is not found without.
#[test]
fn an_effect_that_is_removed_is_not_found() {
    let (with, without) = Case::with_and_without("coulomb_friction", 3, 40.0).expect("visible");
    let found = ask(&with.recordings, &with);
    assert_ne!(found.verdict, Verdict::Adequate, "{}", found.summary);
    let nothing = ask(&without.recordings, &without);
    assert_eq!(nothing.verdict, Verdict::Adequate, "{}", nothing.summary);
}

/// What the effect adds, in another order, has no structure left: nothing may be named.
#[test]
fn shuffled_residuals_hold_no_physics() {
    let (with, without) = Case::with_and_without("viscous_damping", 4, 40.0).expect("visible");
    let found = ask(&with.recordings, &with);
    assert_ne!(found.verdict, Verdict::Adequate, "{}", found.summary);
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(4);
    let shuffled: Vec<Recording> = with
        .recordings
        .iter()
        .zip(without.recordings)
        .map(|(with, mut without)| {
            assert_eq!(with.time_s, without.time_s, "the same motion and sensors");
            let mut added: Vec<f64> = with
                .force_n
                .iter()
                .zip(&without.force_n)
                .map(|(a, b)| a - b)
                .collect();
            // A force that is the same all over the recording is no residual in another order, but an offset.
            let mean = added.iter().sum::<f64>() / added.len() as f64;
            added.iter_mut().for_each(|a| *a -= mean);
            added.shuffle(&mut random);
            without.force_n.iter_mut().zip(added).for_each(|(f, a)| *f += a);
            without
        })
        .collect();
    let nothing = ask(&shuffled, &with);
    assert!(codes(&nothing).is_empty(), "{}", nothing.summary);
}

/// The same case examined twice gives the same answer, on one core or two.
#[test]
fn an_examination_repeats() {
    let case = Case::single("sensor_drift", 6, 20.0).expect("visible");
    let (once, again) = (
        examine(&case, &case.recordings, 1),
        examine(&case, &case.recordings, 2),
    );
    assert_eq!(once.map(|d| d.summary), again.map(|d| d.summary));
}

/// The figures over 60 sealed cases of a fixed seed, asked for what the 400 of `docs/blind.md` are asked for. 60 are an
/// anecdote: a case more or less is 8 % of the singles. Calibration and time are printed only: too few, too noisy.
#[test]
fn sixty_sealed_cases() {
    let request = BlindRequest {
        cases: 60,
        seed: 20_261,
        strength: None,
        family: None,
        look_alikes: 0,
        threads: std::thread::available_parallelism().map_or(1, usize::from),
    };
    let marks = run(&request, &mut |seals| assert_eq!(seals.len(), 60), &|_| {}).expect("seals open");
    assert!(
        marks.iter().all(|m| m.refused.is_none()),
        "every case is a sound recording"
    );
    let found = figures::figures(&marks, &[]);
    for f in &found {
        println!("{}: {:?} of {}, asked {}", f.what, f.reached, f.count, f.asked);
    }
    let reached = |what: &str| {
        let figure = found.iter().find(|f| f.what.starts_with(what)).expect("a row");
        figure.reached.expect("cases bear on it")
    };
    println!("{}", page::text(&request, &marks));
    assert!(reached("exact set, single") >= 95.0);
    assert!(reached("exact set, two") >= 80.0);
    assert!(reached("true effect named") >= 95.0);
    assert!(reached("`unknown` on effects inside") <= 5.0);
    assert!(reached("located interval") >= 0.7);
    assert!(reached("held-out error") <= 1.15);
    assert!(reached("false alarms") <= 2.0);
    assert!(reached("`unknown` on effects outside") >= 90.0);
    assert!(reached("95 % intervals") >= 90.0);
}
