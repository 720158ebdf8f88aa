//! Every force by hand, on a spring with 100 N preload and 80 N/mm.

use super::super::catalogue::find;
use super::*;

pub(crate) fn plain() -> TruthSpecimen {
    TruthSpecimen {
        preload_n: 100.0,
        rate_n_per_mm: 80.0,
        friction_ratio: 0.1,
        presliding_mm: 0.3,
        power: 1.0,
        form: Form::Gradual,
        bushing_n: 0.0,
        range_n: 2000.0,
        world: World::Own,
        build: 0.0,
    }
}

pub(crate) fn sine(frequency_hz: f64, cycles: f64) -> Programme {
    Programme::Sine {
        mean_mm: 10.0,
        amplitude_mm: 6.0,
        frequency_hz,
        cycles,
    }
}

/// A ramp and two sines, with their sampling times.
pub(crate) fn programme() -> Vec<(Programme, Vec<f64>)> {
    let times = |motion: &Programme, rate: f64| -> Vec<f64> {
        (0..(motion.duration_s() * rate) as usize)
            .map(|k| k as f64 / rate)
            .collect()
    };
    let ramp = Programme::Ramp {
        top_mm: 20.0,
        branch_s: 20.0,
        hold_s: 5.0,
    };
    [(ramp, 20.0), (sine(1.0, 4.0), 200.0), (sine(2.5, 6.0), 200.0)]
        .into_iter()
        .map(|(m, rate)| (m.clone(), times(&m, rate)))
        .collect()
}

fn frictionless() -> TruthSpecimen {
    TruthSpecimen {
        friction_ratio: 0.0,
        ..plain()
    }
}

fn hidden(code: &'static str, size: f64, place: f64) -> Hidden {
    assert!(find(code).is_some());
    Hidden {
        code,
        size,
        place,
        width: 2.0,
        law: None,
    }
}

/// Force in N of the frictionless spring in the 1 Hz sine, `after_s` after the approach of 0.5 s.
fn with(h: Hidden, after_s: f64) -> f64 {
    // Samples at 200 Hz up to that time.
    let times: Vec<f64> = (1..=(200.0 * (0.5 + after_s)).round() as usize)
        .map(|k| k as f64 / 200.0)
        .collect();
    *frictionless()
        .forces(&[h], &sine(1.0, 8.0), &times)
        .last()
        .expect("times")
}

#[test]
fn the_friction_of_the_steady_loop_reverses_exponentially() {
    // Power 1: gamma(2) lengths give r = 2 exp(-s / p) - 1 after a full reversal; 64 elements have an error of about 1 %.
    let ramp = Programme::Ramp {
        top_mm: 10.0,
        branch_s: 10.0,
        hold_s: 0.0,
    };
    let specimen = plain();
    let times: Vec<f64> = (0..=2000).map(|k| 0.01 * f64::from(k)).collect();
    let forces = specimen.forces(&[], &ramp, &times);
    for (t, f) in times
        .iter()
        .zip(&forces)
        .filter(|(t, _)| **t > 10.0 && **t < 18.0)
    {
        let x = ramp.at_mm(*t);
        let wanted = (100.0 + 80.0 * x) * (1.0 + 0.1 * (2.0 * (-(10.0 - x) / 0.3).exp() - 1.0));
        assert!(
            (f - wanted).abs() < 0.015 * 0.1 * 900.0,
            "at {t} s: {f} against {wanted}"
        );
    }
}

#[test]
fn forces_far_along_a_branch_are_those_of_dry_friction() {
    let times: Vec<f64> = (1..=400).map(|k| 0.005 * f64::from(k)).collect();
    let forces = plain().forces(&[], &sine(1.0, 8.0), &times);
    // 0.75 s: upwards through the mean; 1.25 s: downwards.
    assert!((forces[149] - 900.0 * 1.1).abs() < 0.1 && (forces[249] - 900.0 * 0.9).abs() < 0.1);
}

#[test]
fn the_friction_reverses_at_the_true_turning_point_at_any_sampling_rate() {
    let sharp = TruthSpecimen {
        form: Form::Sharp,
        ..plain()
    };
    let motion = sine(1.0, 2.0);
    let fine: Vec<f64> = (1..=4000).map(|k| 2.5e-4 * f64::from(k + 100)).collect();
    let coarse: Vec<f64> = fine.iter().copied().skip(7).step_by(160).collect();
    let dense = sharp.forces(&[], &motion, &fine);
    for (k, f) in sharp.forces(&[], &motion, &coarse).iter().enumerate() {
        // The friction is 96 N or more; a turning point that is late by one step would change the force by that.
        assert!((f - dense[7 + 160 * k]).abs() < 1.0, "sample {k}");
    }
}

#[test]
fn forces_by_hand() {
    use std::f64::consts::TAU;
    let close = |a: f64, b: f64, tolerance: f64| assert!((a - b).abs() < tolerance, "{a} against {b}");
    // Upwards through the mean: 10 mm, 6 * 2 pi mm/s, 900 N.
    let speed = 6.0 * TAU;
    close(
        with(hidden("viscous_damping", 0.5, 0.0), 0.25),
        900.0 + 0.5 * speed,
        0.01,
    );
    close(with(hidden("coulomb_friction", 20.0, 0.0), 0.25), 920.0, 1e-6);
    close(with(hidden("coulomb_friction", 20.0, 0.0), 0.75), 880.0, 1e-6);
    close(
        with(hidden("progressive_stiffness", 30.0, 8.0), 0.25),
        960.0,
        1e-6,
    );
    close(with(hidden("sensor_drift", 60.0, 0.0), 0.25), 900.75, 1e-6);
    close(with(hidden("sensor_saturation", 0.6, 0.0), 0.25), 800.0, 1e-6);
    close(with(hidden("lift_off", 2.0, 0.0), 0.25), 740.0, 1e-6);
    close(with(hidden("lift_off", 5.0, 0.0), 0.0), 0.0, 1e-12);
    // The specimen follows half a gap behind. 2 mm/kN: 80 N/mm in series with 500 N/mm.
    close(with(hidden("backlash", 1.0, 0.0), 0.25), 860.0, 1e-6);
    close(
        with(hidden("series_compliance", 2.0, 0.0), 0.25),
        100.0 + 80.0 * (10.0 - 0.2) / 1.16,
        1e-6,
    );
    // The force of 5 ms before, at full speed.
    close(
        with(hidden("channel_delay", 5.0, 0.0), 0.25),
        900.0 - 80.0 * 0.005 * speed,
        0.1,
    );
    // Peak: full acceleration downwards; 10 kg times 237 mm/s2 is 2.37 N. The differences have an error of 1e-3.
    close(
        with(hidden("inertia", 10.0, 0.0), 0.5),
        1380.0 - 0.01 * 6.0 * TAU * TAU,
        1e-2,
    );
    let link = 3.0 * frictionless().top_mm();
    let swung = link * link * (1.0 - (10.0 / link).cos());
    close(
        with(hidden("geometric_stiffness", 0.5, 0.0), 0.25),
        900.0 + 0.5 * swung,
        1e-6,
    );
    close(with(hidden("ripple", 5.0, 8.0), 0.25), 905.0, 1e-4);
    // Local friction in its middle; Stribeck friction that does not fade (1e6 mm/s) and that has faded (1 mm/s).
    close(with(hidden("local_friction", 0.1, 10.0), 0.25), 990.0, 0.5);
    close(with(hidden("stribeck", 0.1, 1e6), 0.25), 990.0, 1e-3);
    close(with(hidden("stribeck", 0.1, 1.0), 0.25), 900.0, 1e-3);
}

#[test]
fn only_relaxation_changes_the_force_in_a_hold() {
    let ramp = Programme::Ramp {
        top_mm: 10.0,
        branch_s: 10.0,
        hold_s: 20.0,
    };
    let times: Vec<f64> = (0..=280).map(|k| 0.1 * f64::from(k)).collect();
    let forces = frictionless().forces(&[hidden("relaxation", 8.0, 4.0)], &ramp, &times);
    let arm = |k: usize| forces[k] - 900.0;
    // After 4 s of hold, 1/e is left; the error is rounding only.
    assert!((arm(160) / arm(120) - (-1.0f64).exp()).abs() < 1e-9);
    let still = plain().forces(&[], &ramp, &times);
    assert!((still[160] - still[120]).abs() < 1e-9);
}

#[test]
fn cycles_count_for_run_in_and_strength_loss() {
    // Upwards through the mean in the eighth cycle, after almost the whole change.
    let times: Vec<f64> = (1..=1550).map(|k| 0.005 * f64::from(k)).collect();
    let last = |h: Hidden| {
        *frictionless()
            .forces(&[h], &sine(1.0, 8.0), &times)
            .last()
            .expect("times")
    };
    let ran = last(hidden("run_in", 0.1, 0.5));
    // 7 cycles: 1 - exp(-14).
    assert!((ran - 990.0).abs() < 0.1, "{ran}");
    let lost = last(hidden("strength_loss", 0.2, 3.0));
    let middle = (10.0 / frictionless().top_mm() - 0.45) / 0.25;
    assert!(
        (lost - 900.0 * (1.0 - 0.2 * (-middle * middle).exp())).abs() < 0.1,
        "{lost}"
    );
}

#[test]
fn a_smoothed_friction_fades_in_a_slow_ramp_and_the_hidden_friction_remains() {
    let smoothed = TruthSpecimen {
        form: Form::Smoothed { speed_mm_s: 10.0 },
        ..plain()
    };
    let ramp = Programme::Ramp {
        top_mm: 10.0,
        branch_s: 100.0,
        hold_s: 0.0,
    };
    // 0.1 mm/s against 10: a hundredth of 90 N.
    let force = |s: &TruthSpecimen, h: &[Hidden]| s.forces(h, &ramp, &[50.0])[0] - 500.0;
    assert!(force(&smoothed, &[]) < 1.0);
    let bare = TruthSpecimen {
        friction_ratio: 0.0,
        ..smoothed
    };
    assert!((force(&bare, &[hidden("rate_independent_friction", 0.1, 10.0)]) - 50.0).abs() < 0.1);
}

#[test]
fn same_input_same_bits() {
    let programme = programme();
    let run = || -> Vec<f64> {
        programme
            .iter()
            .flat_map(|(m, t)| plain().forces(&[hidden("backlash", 0.3, 0.0)], m, t))
            .collect()
    };
    assert_eq!(run(), run());
}
