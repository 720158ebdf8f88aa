//! The shipped profiles: lengths, levels, counts, smoothness, and the result of the dry run.

use std::path::Path;

use crate::config::{Bench, Specimen};
use crate::profile::{Player, Profile, Slot};
use crate::twin::dry_run;

const RATE_HZ: f64 = 1000.0;
const SINES: [(&str, f64, f64); 4] = [
    ("sine-6mm-1hz", 6.0, 1.0),
    ("sine-10mm-1hz", 10.0, 1.0),
    ("sine-15mm-1hz", 15.0, 1.0),
    ("sine-6mm-2.5hz", 6.0, 2.5),
];

fn shipped(name: &str) -> Profile {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("bench-configs/profiles/{name}.toml"));
    Profile::from_toml(&std::fs::read_to_string(path).unwrap(), name).unwrap()
}

fn play(mut player: Player) -> Vec<Slot> {
    std::iter::from_fn(|| player.next()).collect()
}

#[test]
fn the_static_ramp_has_a_command_every_millisecond_and_exact_ends() {
    let slots = play(Player::new(&shipped("static-ramp"), 0.0, RATE_HZ).unwrap());
    assert_eq!(slots.len(), 120_000);
    assert_eq!(slots[59_999].command.value(), 2000.0);
    assert_eq!(slots[119_999].command.value(), 0.0);
    assert_eq!(
        play(Player::new(&shipped("static-ramp-12s"), 0.0, RATE_HZ).unwrap()).len(),
        12_000
    );
}

#[test]
fn the_sines_count_fifty_full_cycles_without_a_step() {
    for (name, amplitude, frequency_hz) in SINES {
        let slots = play(Player::new(&shipped(name), 0.0, RATE_HZ).unwrap());
        let per_cycle = (RATE_HZ / frequency_hz) as usize;
        for cycle in 1..=50 {
            let values: Vec<f64> = slots
                .iter()
                .filter(|s| s.cycle == cycle)
                .map(|s| s.command.value())
                .collect();
            assert_eq!(values.len(), per_cycle, "{name} cycle {cycle}");
            let peak = values.iter().fold(f64::MIN, |m, v| m.max(*v));
            let valley = values.iter().fold(f64::MAX, |m, v| m.min(*v));
            assert!(
                valley >= 5.0 - 1e-9,
                "{name}: the spring is loaded at its valley, {valley} mm"
            );
            // A quarter of a cycle is a whole number of ticks for all four profiles.
            assert!(
                (peak - valley - 2.0 * amplitude).abs() < 1e-9,
                "{name} cycle {cycle}"
            );
        }
        let segment: Vec<f64> = slots
            .iter()
            .filter(|s| s.segment == 3)
            .map(|s| s.command.value())
            .collect();
        let second = segment
            .windows(3)
            .fold(0.0, |m: f64, w| m.max((w[2] - 2.0 * w[1] + w[0]).abs()));
        // Tapers add less than a tenth to the acceleration of the sine.
        let own = amplitude * (std::f64::consts::TAU * frequency_hz / RATE_HZ).powi(2);
        assert!(second < 1.1 * own, "{name}: {second} against {own}");
    }
}

#[test]
fn an_interrupted_sine_resumes_with_the_cycles_that_remain() {
    for (name, _, frequency_hz) in SINES {
        let player = Player::new(&shipped(name), 0.0, RATE_HZ)
            .unwrap()
            .resume_at(41)
            .unwrap();
        let slots = play(player);
        let counted = slots.iter().filter(|s| s.cycle > 0).count();
        assert_eq!(counted, (10.0 * RATE_HZ / frequency_hz) as usize);
        assert_eq!(slots.iter().find(|s| s.cycle > 0).map(|s| s.cycle), Some(41));
        assert_eq!(slots.last().map(|s| s.command.value()), Some(0.0));
    }
}

#[test]
fn the_dry_run_predicts_no_trip_on_the_default_bench() {
    let bench =
        Bench::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/benches/mock.toml")).unwrap();
    let plant = bench.model.plant().unwrap();
    for (name, _, _) in SINES {
        let run = dry_run(&shipped(name), plant.as_ref(), &bench.profile_limits(), RATE_HZ).unwrap();
        assert!(
            run.predicted_trips.is_empty(),
            "{name}: {}",
            run.predicted_trips[0]
        );
        assert_eq!(run.cycles, 50);
        assert!(run.energy_j > 0.0, "{name}: {run:?}");
    }
}

#[test]
fn the_dry_run_predicts_that_a_softer_spring_moves_too_far() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs");
    let bench = Bench::load(&root.join("benches/mock.toml")).unwrap();
    let soft = Specimen::load(&root.join("specimens/chula-five-link.toml")).unwrap();
    let plant = soft.model.plant().unwrap();
    let run = dry_run(
        &shipped("static-ramp"),
        plant.as_ref(),
        &bench.profile_limits(),
        RATE_HZ,
    )
    .unwrap();
    // 2 kN at 33 N/mm with an offset of 499 N is 45 mm by the envelope alone; the geometry of the shackle adds to it.
    let names: Vec<_> = run.predicted_trips.iter().map(|t| t.worst.name).collect();
    assert_eq!(names, ["displacement_max_mm"]);
    assert!((run.peak_force_n - 2000.0).abs() < 0.1, "{run:?}");
}
