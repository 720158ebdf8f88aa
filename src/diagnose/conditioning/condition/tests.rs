use super::super::splits::assign_splits;
use super::*;
use crate::recording::Flags;

fn one(recording: &Recording) -> Result<Track, ConditionError> {
    Ok(condition(std::slice::from_ref(recording), 3000)?.swap_remove(0))
}

/// A sine of 5 mm about 6 mm at 1 Hz with reproducible noise, force 80 N/mm.
fn sine(rate_hz: f64, seconds: f64, noise_mm: f64) -> Recording {
    let n = (rate_hz * seconds) as usize;
    let time_s: Vec<f64> = (0..n).map(|i| i as f64 / rate_hz).collect();
    let noise = |i: usize, k: f64| {
        use rand::{RngExt, SeedableRng};
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64((i as u64) << 8 | (10.0 * k) as u64);
        2.0 * random.random::<f64>() - 1.0
    };
    let clean: Vec<f64> = time_s
        .iter()
        .map(|t| 6.0 - 5.0 * (std::f64::consts::TAU * t).cos())
        .collect();
    Recording {
        name: "sine".to_owned(),
        force_n: clean
            .iter()
            .enumerate()
            .map(|(i, x)| 80.0 * x + noise(i, 1.3))
            .collect(),
        displacement_mm: clean
            .iter()
            .enumerate()
            .map(|(i, x)| x + noise_mm * noise(i, 1.0))
            .collect(),
        time_s,
        ..Recording::default()
    }
}

#[test]
fn noise_adds_no_travel() {
    for rate_hz in [20.0, 100.0, 1000.0] {
        let track = one(&sine(rate_hz, 10.0, 0.005)).expect("conditioned");
        let path: f64 = track
            .displacement_mm
            .windows(2)
            .map(|w| (w[1] - w[0]).abs())
            .sum();
        // Ten cycles of 20 mm, one sample short; the turning points have an error of some noise.
        assert!((path - 200.0).abs() < 0.4, "{rate_hz} Hz: {path}");
        assert!((track.frequency_hz - 1.0).abs() < 0.03);
        assert!(track.len() <= 3100, "{}", track.len());
    }
}

#[test]
fn noise_is_estimated_at_any_rate() {
    for rate_hz in [20.0, 1000.0] {
        let track = one(&sine(rate_hz, 20.0, 0.005)).expect("conditioned");
        // Uniform within 1 N: 1 / sqrt 3 = 0.577; few differences know it to a third.
        assert!(
            (0.4..0.8).contains(&track.noise_n),
            "{rate_hz}: {}",
            track.noise_n
        );
    }
}

/// All three recordings have a vibration of 23 Hz. It is found in the first alone: at 47 samples a second it is too fast, and the motion of
/// the third, of 4 Hz, is too fast for a window with five periods of it. In these two it counts as noise.
#[test]
fn a_vibration_that_is_subtracted_from_one_recording_is_noise_in_another() {
    let shaken = |rate_hz: f64, seconds: f64, faster: f64| {
        let mut r = sine(rate_hz, seconds, 0.001);
        for (x, t) in r.displacement_mm.iter_mut().zip(&mut r.time_s) {
            *t /= faster;
            *x += 0.016 * (std::f64::consts::TAU * 23.0 * *t).sin();
        }
        r
    };
    let recordings = [
        shaken(250.0, 40.0, 1.0),
        shaken(47.0, 40.0, 1.0),
        shaken(250.0, 40.0, 4.0),
    ];
    let tracks = condition(&recordings, 3000).expect("valid");
    assert!(tracks[0].noise_mm < 0.002, "{}", tracks[0].noise_mm);
    assert!(tracks[1].noise_mm > 0.008, "{}", tracks[1].noise_mm);
    assert!(tracks[2].noise_mm > 0.008, "{}", tracks[2].noise_mm);
}

#[test]
fn a_corner_stays_a_corner() {
    // Triangle of 0 to 10 mm in 10 s, sampled so that the corner falls between two samples.
    let time_s: Vec<f64> = (0..2000).map(|i| 0.0101 * f64::from(i)).collect();
    let displacement_mm: Vec<f64> = time_s
        .iter()
        .map(|t| if *t < 10.0 { *t } else { 20.0 - t })
        .collect();
    let recording = Recording {
        force_n: displacement_mm.iter().map(|x| 80.0 * x).collect(),
        time_s,
        displacement_mm,
        ..Recording::default()
    };
    let track = one(&recording).expect("conditioned");
    let top = track.displacement_mm.iter().copied().fold(0.0, f64::max);
    // A third of the travel between two samples; without the corner it would be half of it, always too low.
    assert!((top - 10.0).abs() < 0.0034, "{top}");
}

#[test]
fn clipped_displacement_is_masked_with_a_remark() {
    let mut recording = sine(200.0, 5.0, 0.0005);
    recording.displacement_mm.iter_mut().for_each(|x| *x = x.min(9.0));
    let track = one(&recording).expect("conditioned");
    assert!(
        track.remarks.iter().any(|r| r.contains("clips")),
        "{:?}",
        track.remarks
    );
    assert!(
        track
            .weight
            .iter()
            .zip(&track.force_n)
            .all(|(w, f)| *w == 0.0 || *f < 80.0 * 9.0 + 3.0)
    );
    // The sine is above 9 mm for less than a third of its time.
    let used = track.weight.iter().filter(|w| **w > 0.0).count();
    assert!(2 * used > track.weight.len(), "{used} of {}", track.weight.len());
}

#[test]
fn flagged_samples_are_left_out() {
    let mut recording = sine(200.0, 5.0, 0.0005);
    recording.force_n[500] = 1e7;
    recording.flags = Some(
        (0..recording.len())
            .map(|i| if i == 500 { Flags::SPIKE.bits() } else { 0 })
            .collect(),
    );
    let track = one(&recording).expect("conditioned");
    assert!(track.force_n.iter().all(|f| *f < 1e3));
    assert_eq!(track.remarks.len(), 1);
}

#[test]
fn bad_input_is_refused_with_its_row() {
    let refuse = |change: &dyn Fn(&mut Recording)| {
        let mut recording = sine(200.0, 5.0, 0.0005);
        change(&mut recording);
        one(&recording).expect_err("refused").to_string()
    };
    assert!(refuse(&|r| r.force_n[7] = f64::NAN).contains("row 9"));
    assert!(refuse(&|r| r.time_s[9] = 0.0).contains("row 11"));
    assert!(refuse(&|r| r.displacement_mm.fill(1.0)).contains("displacement"));
    assert!(refuse(&|r| r.force_n.truncate(3)).contains("row 5"));
    assert!(
        refuse(&|r| {
            for column in [&mut r.time_s, &mut r.displacement_mm, &mut r.force_n] {
                column.truncate(10);
            }
        })
        .contains("at least 20")
    );
}

#[test]
fn whole_cycles_are_held_out() {
    let mut tracks = vec![one(&sine(100.0, 12.0, 0.001)).expect("conditioned")];
    assign_splits(&mut tracks);
    let track = &tracks[0];
    for i in 1..track.len() {
        assert!(track.split[i] == track.split[i - 1] || track.cycle[i] != track.cycle[i - 1]);
    }
    for split in [Split::Fit, Split::Select, Split::Report] {
        assert!(track.split.contains(&split));
    }
}

/// The time of a sample is the tick of the rig, however late the controller saw it.
#[test]
fn late_samples_are_as_good_as_others() {
    let recording = sine(200.0, 5.0, 0.005);
    let late = Recording {
        flags: Some(vec![Flags::LATE.bits(); recording.len()]),
        ..recording.clone()
    };
    let [plain, late] = [&recording, &late].map(|r| one(r).expect("conditioned"));
    assert_eq!((plain.weight, plain.remarks), (late.weight, late.remarks));
}

/// A servo overshoots by 8 um and goes back before the motion goes on: no reversal by the band, but the specimen turned.
#[test]
fn motion_that_the_band_hides_is_kept_as_an_error() {
    let (rate_hz, back_mm) = (1000.0, 0.008);
    let time_s: Vec<f64> = (0..6000).map(|i| f64::from(i) / rate_hz).collect();
    let at_mm = |t: f64| match t {
        t if t < 2.0 => 10.0 * t,
        t if t < 2.5 => 20.0 - back_mm * (t - 2.0) / 0.5,
        t if t < 4.0 => 20.0 - back_mm,
        t => 20.0 - back_mm + 10.0 * (t - 4.0),
    };
    let noise = |i: usize| 5e-4 * f64::from(i as u32 % 3) - 5e-4;
    let displacement_mm: Vec<f64> = (0..time_s.len()).map(|i| at_mm(time_s[i]) + noise(i)).collect();
    let recording = Recording {
        force_n: displacement_mm.iter().map(|x| 80.0 * x).collect(),
        time_s,
        displacement_mm,
        ..Recording::default()
    };
    let track = one(&recording).expect("conditioned");
    let worst = |from_s: f64, to_s: f64| {
        let points = track.time_s.iter().zip(&track.hidden_mm);
        let within = points.filter(|(t, _)| (from_s..to_s).contains(*t));
        within.map(|(_, hidden_mm)| *hidden_mm).fold(0.0, f64::max)
    };
    // The noise is subtracted.
    let at_rest = [worst(2.6, 3.0), worst(3.0, 3.9)];
    assert!(
        at_rest.iter().all(|mm| (0.006..back_mm).contains(mm)),
        "{at_rest:?}"
    );
    assert_eq!((worst(0.5, 1.8), worst(4.2, 5.8)), (0.0, 0.0));
}

#[test]
fn a_recording_that_unloads_first_did_not_start_at_rest() {
    // A cycle that begins 0.1 mm above its lowest point: falling, or rising from rest.
    let from = |phase: f64| {
        let mut recording = sine(200.0, 6.0, 0.0005);
        for (t, (x, f)) in
            (recording.time_s.iter()).zip(recording.displacement_mm.iter_mut().zip(&mut recording.force_n))
        {
            *x = 5.0 - 5.0 * (std::f64::consts::TAU * t + phase).cos();
            *f = 80.0 * *x;
        }
        one(&recording).expect("conditioned")
    };
    let noted = |track: &Track| track.notes.iter().any(|n| n.kind == NoteKind::Start);
    let first = |track: &Track| {
        track
            .weight
            .iter()
            .position(|w| *w > 0.0)
            .map(|i| track.time_s[i])
    };
    let falling = from(-0.2);
    assert!(noted(&falling), "{:?}", falling.notes);
    // Compared after four fifths of the stroke in one direction.
    assert!(first(&falling) > Some(0.35), "{:?}", first(&falling));
    assert!(!noted(&from(0.0)));
}
