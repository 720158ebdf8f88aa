//! Sealed cases, and the controls that must fail to find anything.

use leafbench::blind::{Request, baseline, examine, figures, run};
use leafbench::diagnose::{Diagnosis, Options, Verdict, diagnose};
use leafbench::recording::Recording;
use leafbench::truth::Case;

/// Thinned out: these tests ask what is found, not how exactly.
const POINTS: usize = 500;

fn ask(recordings: &[Recording], case: &Case) -> Diagnosis {
    let options = Options {
        points: POINTS,
        threads: 0,
    };
    diagnose(recordings, &baseline(&case.start), &options, &mut |_, _| {}).expect("sound recordings")
}

fn codes(d: &Diagnosis) -> Vec<&str> {
    d.effects.iter().map(|e| e.code.as_str()).collect()
}

/// Same specimen, motion and sensors: what is found with the effect is not found without.
#[test]
fn an_effect_that_is_removed_is_not_found() {
    let (with, without) = Case::pair_of_controls("coulomb_friction", 3, 40.0).expect("visible");
    let found = ask(&with.recordings, &with);
    assert_ne!(found.verdict, Verdict::Adequate, "{}", found.summary);
    let nothing = ask(&without.recordings, &without);
    assert_eq!(nothing.verdict, Verdict::Adequate, "{}", nothing.summary);
}

/// The baseline's own force with its residuals in another order has no structure left: nothing may be named.
#[test]
fn shuffled_residuals_hold_no_physics() {
    let case = Case::single("viscous_damping", 4, 40.0).expect("visible");
    let found = ask(&case.recordings, &case);
    assert_ne!(found.verdict, Verdict::Adequate, "{}", found.summary);
    let shuffled: Vec<Recording> = found
        .curves
        .iter()
        .map(|c| {
            let n = c.time_s.len();
            // A step without common factor visits every sample once, far from its neighbours.
            let step = (n * 5 / 8..n).find(|s| common_factor(*s, n) == 1).unwrap_or(1);
            let force_n = (0..n)
                .map(|k| {
                    let from = (k * step + n / 3) % n;
                    c.baseline_n[k] + c.measured_n[from] - c.baseline_n[from]
                })
                .collect();
            Recording {
                name: c.name.clone(),
                time_s: c.time_s.clone(),
                displacement_mm: c.displacement_mm.clone(),
                force_n,
                ..Recording::default()
            }
        })
        .collect();
    let nothing = ask(&shuffled, &case);
    assert!(codes(&nothing).is_empty(), "{}", nothing.summary);
}

fn common_factor(a: usize, b: usize) -> usize {
    if b == 0 { a } else { common_factor(b, a % b) }
}

/// The same case examined twice gives the same answer, on one core or two.
#[test]
fn an_examination_repeats() {
    let case = Case::single("sensor_drift", 6, 20.0).expect("visible");
    let (once, again) = (examine(&case, 1), examine(&case, 2));
    assert_eq!(once.map(|d| d.summary), again.map(|d| d.summary));
}

/// The figures over 60 sealed cases of a fixed seed. It asks for honesty first: few false alarms, few wrong names.
#[test]
#[ignore = "takes minutes: cargo test --release --test blind -- --ignored"]
fn sixty_sealed_cases() {
    let request = Request {
        cases: 60,
        seed: 20_261,
        strength: None,
        threads: std::thread::available_parallelism().map_or(1, usize::from),
    };
    let marks = run(&request, &mut |seals| assert_eq!(seals.len(), 60), &|_| {}).expect("seals open");
    assert!(
        marks.iter().all(|m| m.refused.is_none()),
        "every case is a sound recording"
    );
    let missed: Vec<String> = figures::figures(&marks)
        .iter()
        .filter(|f| !f.met)
        .map(|f| format!("{}: {:?}, asked {}", f.what, f.reached, f.asked))
        .collect();
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}
