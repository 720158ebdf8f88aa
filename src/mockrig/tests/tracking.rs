//! Tracking of the servo loop, and reproducibility from the seed.

use super::*;

#[test]
fn same_seed_same_bits() {
    let run = |seed| {
        let mut bench = TestRig::armed(&MockRigConfig {
            seed,
            ..MockRigConfig::default()
        });
        bench.sine(8.0, 6.0, 2.5);
        bench.run(2500);
        bench.samples
    };
    let first = run(3);
    assert_eq!(first, run(3));
    assert_ne!(first, run(4));
}

/// Amplitude and mean of the measured displacement over the last whole cycles against the commands.
#[test]
fn sines_are_tracked_before_any_correction() {
    for (amplitude, hz) in [(6.0, 1.0), (10.0, 1.0), (15.0, 1.0), (6.0, 2.5)] {
        let mut bench = default_bench();
        bench.sine(amplitude + 2.0, amplitude, hz);
        bench.run(5000);
        assert_eq!(bench.state, RigState::Running, "{:?}", bench.cause);
        let tail = &bench.samples[bench.samples.len() - 2000..];
        let high = tail.iter().map(|s| s.2).fold(f64::MIN, f64::max);
        let low = tail.iter().map(|s| s.2).fold(f64::MAX, f64::min);
        let (error, mean) = (
            0.5 * (high - low) / amplitude - 1.0,
            0.5 * (high + low) - amplitude - 2.0,
        );
        // Small enough that one correction brings it within 1 %.
        assert!(
            error.abs() < 0.03 && mean.abs() < 0.1,
            "{amplitude} mm {hz} Hz: amplitude {:+.2} %, mean {mean:+.3} mm",
            100.0 * error
        );
    }
}

#[test]
fn slow_force_ramp_is_tracked_within_two_newtons() {
    let mut bench = default_bench();
    let start = bench.tick;
    let ramp = move |tick: u64| {
        let t = (tick - start) as f64 * TICK_S;
        let force_n = (if t < 60.0 { t } else { 120.0 - t }) * 2000.0 / 60.0;
        (t <= 120.0).then_some(((force_n * 10.0).round() as i32, t >= 120.0))
    };
    bench.motion = Some((WireMode::Force, Box::new(ramp)));
    let mut worst = (0.0f64, 0.0);
    let mut peak = 0.0f64;
    for i in 0..120_000 {
        bench.step();
        let asked = ramp(bench.tick).map_or(0.0, |c| f64::from(c.0) * FORCE_N_PER_COUNT);
        let error = bench.rig.force_n() - asked;
        peak = peak.max(bench.samples.last().map_or(0.0, |s| s.1));
        if i > 100 && error.abs() > f64::abs(worst.0) {
            worst = (error, asked);
        }
    }
    assert!(worst.0.abs() < 2.0, "{:+.2} N at {:.0} N", worst.0, worst.1);
    assert!((peak - 2000.0).abs() < 5.0, "{peak:.1} N");
}
