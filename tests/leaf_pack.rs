//! The leaf pack against published and independent figures: stiffness, forces and loops of both mountings, energy, symmetry,
//! limits of the models, and each source of friction by itself. Each test prints its error.
//!
//! The reference figures are those of an independent planar corotational script and of MuJoCo 4.0.0 on the same duty:
//! Table 1 geometry, clamp 100 mm, no eye offset, interleaf mu 0.3, everything else frictionless.

use leafbench::model::leaf_pack::{
    Dynamics, FrictionChoice, LeafPack, Mounting, NormalChoice, PARAMETERS, Source, Structure, Values,
    graded_path,
};
use leafbench::model::{self, Plant};

const REFERENCE_MU: f64 = 0.3;

fn values() -> Values {
    Values {
        interleaf_mu: REFERENCE_MU,
        ..Values::frictionless()
    }
}

fn shackle(angle_deg: f64) -> (Structure, Values) {
    let structure = Structure {
        mounting: Mounting::Shackle,
        ..Structure::default()
    };
    (
        structure,
        Values {
            shackle_angle_rad: angle_deg.to_radians(),
            ..values()
        },
    )
}

fn pack(structure: &Structure, values: &Values) -> LeafPack {
    LeafPack::new(structure, values).expect("valid pack")
}

fn loop_j(points: &[(f64, f64)]) -> f64 {
    points
        .windows(2)
        .map(|w| 0.5e-3 * (w[0].1 + w[1].1) * (w[1].0 - w[0].0))
        .sum()
}

/// Peak force (N) and loop energy (J) of 0 -> 26 -> 0 mm.
fn static_row(pack: &mut LeafPack, longest_mm: f64) -> (f64, f64) {
    static_loop(pack, 26.0, longest_mm)
}

fn static_loop(pack: &mut LeafPack, stroke_mm: f64, longest_mm: f64) -> (f64, f64) {
    let path = graded_path(&[0.0, stroke_mm, 0.0], longest_mm);
    let points: Vec<(f64, f64)> = pack
        .static_path(&path, 120.0)
        .iter()
        .map(|p| (p.displacement_mm, p.force_n))
        .collect();
    (points.iter().fold(0.0, |m, p| m.max(p.1)), loop_j(&points))
}

/// Peak force (N) and energy (J) of the second cycle 2 -> 8 -> 2 mm at 1 Hz, `rate` steps a second.
fn sine_row(pack: &mut LeafPack, rate: usize) -> (f64, f64) {
    let mut points = Vec::new();
    for k in 0..=2 * rate {
        let t_s = k as f64 / rate as f64;
        let d = 5.0 - 3.0 * (t_s * std::f64::consts::TAU).cos();
        let f = pack.step(d, 1.0 / rate as f64);
        if k >= rate {
            points.push((d, f));
        }
    }
    (points.iter().fold(0.0, |m, p| m.max(p.1)), loop_j(&points))
}

fn close(what: &str, got: f64, wanted: f64, relative: f64) {
    let error = got / wanted - 1.0;
    println!("{what}: {got:.5} against {wanted:.5} ({:+.2} %)", 100.0 * error);
    assert!(
        error.abs() <= relative,
        "{what}: {got} against {wanted}, allowed {relative}"
    );
}

/// The reference's table of stiffness over clamp length. It comes out to 0.1 % with E = 210 GPa; at the 207 GPa of the
/// other rows every entry is 1.4 % softer, as it must be: the table was evidently made with 210.
#[test]
fn frictionless_stiffness_over_clamp_length() {
    let table = [
        (0.0, 55.1),
        (40.0, 62.1),
        (60.0, 66.0),
        (80.0, 70.4),
        (100.0, 75.1),
        (120.0, 80.2),
        (140.0, 85.8),
        (150.0, 88.8),
    ];
    for (clamp_length_mm, wanted) in table {
        let v = Values {
            clamp_length_mm,
            e_mpa: 210_000.0,
            ..Values::frictionless()
        };
        let mut pack = pack(&Structure::default(), &v);
        let (one, two) = (pack.step(1.0, 1.0), pack.step(2.0, 1.0));
        close(
            &format!("rate at clamp {clamp_length_mm} mm, N/mm"),
            two - one,
            wanted,
            0.01,
        );
    }
}

#[test]
fn nip_preloads_at_the_tips() {
    let pack = pack(&Structure::default(), &values());
    let shape = pack.shape();
    // The tip contact of each pair is its outermost one.
    for (upper_leaf, wanted) in [(0, 127.0), (1, 318.0), (2, 439.0)] {
        let tip = shape
            .contacts
            .iter()
            .filter(|c| c.upper_leaf == upper_leaf)
            .max_by(|a, b| a.x_mm.total_cmp(&b.x_mm))
            .expect("contacts");
        close(
            &format!("nip of leaf {} N", upper_leaf + 2),
            tip.normal_n,
            wanted,
            0.01,
        );
    }
}

#[test]
fn forces_and_loops_of_the_rail() {
    let mut p = pack(&Structure::default(), &values());
    let (f, e) = static_row(&mut p, 1.0);
    close("static peak, N (script)", f, 1920.0, 0.005);
    close("static loop, J (script)", e, 1.193, 0.01);
    close("static peak, N (MuJoCo)", f, 1867.0, 0.04);
    close("static loop, J (MuJoCo)", e, 1.147, 0.04);
    p.reset();
    let (f, e) = sine_row(&mut p, 1000);
    close("sine peak, N (script)", f, 606.5, 0.005);
    close("sine loop, J (script)", e, 0.172, 0.01);
    close("sine peak, N (MuJoCo)", f, 594.0, 0.04);
    close("sine loop, J (MuJoCo)", e, 0.167, 0.04);
    close("sine peak, N (Exudyn)", f, 601.0, 0.011);
    assert_eq!(p.unconverged(), 0);
}

#[test]
fn forces_and_loops_of_the_shackle() {
    for (angle, statics, sine) in [
        (20.0, (2120.0, 1.332), (714.0, 0.196)),
        (26.0, (2211.0, 1.393), (759.0, 0.206)),
    ] {
        let (s, v) = shackle(angle);
        let mut p = pack(&s, &v);
        let (f, e) = static_row(&mut p, 1.0);
        close(&format!("static peak at {angle} deg, N"), f, statics.0, 0.005);
        close(&format!("static loop at {angle} deg, J"), e, statics.1, 0.01);
        if angle == 26.0 {
            close("static peak, N (MuJoCo)", f, 2230.0, 0.04);
            close("static loop, J (MuJoCo)", e, 1.380, 0.04);
        }
        p.reset();
        let (f, e) = sine_row(&mut p, 500);
        close(&format!("sine peak at {angle} deg, N"), f, sine.0, 0.005);
        close(&format!("sine loop at {angle} deg, J"), e, sine.1, 0.01);
        assert_eq!(p.unconverged(), 0);
    }
}

/// Step, mesh and both contact stiffnesses: the figures that every tool's loop energy hangs on.
#[test]
fn static_row_is_converged() {
    let base = Structure::default();
    let (f0, e0) = static_row(&mut pack(&base, &values()), 1.0);
    let finer = [
        ("step / 4", base.clone(), 0.25),
        (
            "mesh x 2",
            Structure {
                segments: 172,
                ..base.clone()
            },
            1.0,
        ),
        (
            "tangential stiffness x 5",
            Structure {
                tangential_stiffness_n_per_mm: 1e6,
                ..base.clone()
            },
            1.0,
        ),
        (
            "normal stiffness x 2",
            Structure {
                contact_stiffness_n_per_mm: 4e5,
                ..base.clone()
            },
            1.0,
        ),
        (
            "Hertz contact",
            Structure {
                contact_law: NormalChoice::Hertz,
                ..base
            },
            1.0,
        ),
    ];
    for (what, structure, step) in finer {
        let (f, e) = static_row(&mut pack(&structure, &values()), step);
        close(&format!("{what}: peak"), f0, f, 0.001);
        close(&format!("{what}: loop"), e0, e, 0.01);
    }
}

/// Work in = stored + dissipated, with every source on, in both mountings.
#[test]
fn energy_balances() {
    for mounting in [Mounting::Rail, Mounting::Shackle] {
        let structure = Structure {
            mounting,
            ..Structure::default()
        };
        let mut p = pack(&structure, &all_sources());
        p.set_tolerance_n(1e-5);
        let steps = 6000;
        for k in 1..=2 * steps {
            let there = k as f64 / steps as f64;
            p.step(10.0 * if there <= 1.0 { there } else { 2.0 - there }, 1e-3);
        }
        let e = p.energy();
        let error = (e.work_nmm - e.stored_nmm - e.lost_nmm()) / (e.work_nmm + e.stored_nmm);
        println!(
            "{mounting:?}: work {:.3} stored {:.3} lost {:.3} N mm, error {error:.1e}",
            e.work_nmm,
            e.stored_nmm,
            e.lost_nmm()
        );
        // Trapezoids of 1.7 um: their error falls with the square of the step.
        assert!(error.abs() < 1e-6);
    }
}

fn all_sources() -> Values {
    Values {
        interleaf_mu: 0.2,
        pin_mu: 0.2,
        pivot_torque_nmm: 2000.0,
        rail_mu: 0.1,
        rail_constant_n: 10.0,
        board_mu: 0.3,
        ..Values::frictionless()
    }
}

/// Switches one source off: its own entry in the books goes to zero, and the loop shrinks by what that entry was.
fn share_of(source: Source, mounting: Mounting, off: Values) {
    let structure = Structure {
        mounting,
        ..Structure::default()
    };
    let cycle = |values: &Values| {
        let mut p = pack(&structure, values);
        let turns = [4.0, 12.0, 4.0, 12.0, 4.0];
        p.static_path(&graded_path(&turns[..3], 0.25), 1.0);
        let before = p.energy();
        p.static_path(&graded_path(&turns[2..], 0.25), 1.0);
        let after = p.energy();
        let lost: Vec<f64> = after
            .dissipated_nmm
            .iter()
            .zip(before.dissipated_nmm)
            .map(|(a, b)| a - b)
            .collect();
        (after.work_nmm - before.work_nmm, lost)
    };
    let (work_on, lost_on) = cycle(&all_sources());
    let (work_off, lost_off) = cycle(&off);
    let share = lost_on[source as usize];
    println!("{source:?} on {mounting:?}: loop {work_on:.1} -> {work_off:.1} N mm, its share {share:.1}");
    assert!(share > 0.0);
    assert_eq!(lost_off[source as usize], 0.0);
    // What remains changes a little because the other contacts carry less: 3 % of the whole loop covers it.
    assert!((work_on - work_off - share).abs() < 0.03 * work_on);
    for (k, (on, off)) in lost_on.iter().zip(&lost_off).enumerate() {
        if k != source as usize {
            assert!(
                (on - off).abs() <= 0.05 * on.abs() + 0.02 * work_on,
                "source {k}: {on} -> {off}"
            );
        }
    }
}

#[test]
fn switching_off_interleaf_friction_takes_its_share() {
    share_of(
        Source::Interleaf,
        Mounting::Rail,
        Values {
            interleaf_mu: 0.0,
            ..all_sources()
        },
    );
    share_of(
        Source::Interleaf,
        Mounting::Shackle,
        Values {
            interleaf_mu: 0.0,
            ..all_sources()
        },
    );
}

#[test]
fn switching_off_pin_friction_takes_its_share() {
    share_of(
        Source::Pin,
        Mounting::Rail,
        Values {
            pin_mu: 0.0,
            ..all_sources()
        },
    );
    share_of(
        Source::Pin,
        Mounting::Shackle,
        Values {
            pin_mu: 0.0,
            ..all_sources()
        },
    );
}

#[test]
fn switching_off_pivot_torque_takes_its_share() {
    share_of(
        Source::PivotTorque,
        Mounting::Rail,
        Values {
            pivot_torque_nmm: 0.0,
            ..all_sources()
        },
    );
    share_of(
        Source::PivotTorque,
        Mounting::Shackle,
        Values {
            pivot_torque_nmm: 0.0,
            ..all_sources()
        },
    );
}

#[test]
fn switching_off_rail_friction_takes_its_share() {
    share_of(
        Source::Rail,
        Mounting::Rail,
        Values {
            rail_mu: 0.0,
            ..all_sources()
        },
    );
}

#[test]
fn switching_off_constant_rail_friction_takes_its_share() {
    share_of(
        Source::RailConstant,
        Mounting::Rail,
        Values {
            rail_constant_n: 0.0,
            ..all_sources()
        },
    );
}

#[test]
fn switching_off_board_friction_takes_its_share() {
    share_of(
        Source::Board,
        Mounting::Shackle,
        Values {
            board_mu: 0.0,
            ..all_sources()
        },
    );
}

/// The full model of two sides does what the mirrored one does.
#[test]
fn both_sides_mirror_each_other() {
    let mut half = pack(&Structure::default(), &all_sources());
    let mut full = pack(
        &Structure {
            mirror: false,
            ..Structure::default()
        },
        &all_sources(),
    );
    assert_eq!((half.segments(), full.segments()), (84, 84));
    let mut worst = 0.0f64;
    for d in graded_path(&[0.0, 12.0, 3.0, 9.0], 1.0) {
        worst = worst.max((half.step(d, 0.1) - full.step(d, 0.1)).abs());
    }
    let shape = full.shape();
    let lean =
        (shape.eyes_mm[0][0] + shape.eyes_mm[1][0]).abs() + (shape.eyes_mm[0][1] - shape.eyes_mm[1][1]).abs();
    println!("mirrored against full: {worst:.1e} N, eyes {lean:.1e} mm");
    // Both stop at 5e-4 N residual a body.
    assert!(worst < 0.05 && lean < 1e-9);
}

#[test]
fn slow_dynamics_is_the_static_path() {
    for mounting in [Mounting::Rail, Mounting::Shackle] {
        let still = Structure {
            mounting,
            ..Structure::default()
        };
        let moving = Structure {
            dynamics: Dynamics::Full,
            ..still.clone()
        };
        let (f, e) = static_row(&mut pack(&still, &values()), 1.0);
        let (f_slow, e_slow) = static_row(&mut pack(&moving, &values()), 1.0);
        close(&format!("{mounting:?}: slow peak, N"), f_slow, f, 1e-4);
        close(&format!("{mounting:?}: slow loop, J"), e_slow, e, 1e-3);
    }
}

/// At 2.5 Hz the moving mass shows: at the upper turning point the force falls by mass times acceleration.
#[test]
fn inertia_lowers_the_peak_by_mass_times_acceleration() {
    let still = Structure {
        clamp_mass_kg: 20.0,
        ..Structure::default()
    };
    let moving = Structure {
        dynamics: Dynamics::Full,
        ..still.clone()
    };
    let v = Values {
        preload_mm: 3.0,
        ..Values::frictionless()
    };
    let w = 2.5 * std::f64::consts::TAU;
    let top = |structure: &Structure| {
        let mut p = pack(structure, &v);
        let forces: Vec<f64> = (1..=2000)
            .map(|k| p.step(3.0 - 3.0 * (w * f64::from(k) * 5e-4).cos(), 5e-4))
            .collect();
        // Tops at 0.2 s and then every 0.4 s: the mean keeps what rings from the start small.
        [399, 1199, 1999].iter().map(|k| forces[*k]).sum::<f64>() / 3.0
    };
    let drop = top(&still) - top(&moving);
    let clamp_alone = 20.0 * w * w * 3.0 * 1e-3;
    println!("peak falls by {drop:.2} N; the clamp's mass alone gives {clamp_alone:.2} N");
    // The leaves (7 kg, most of it moving less than the clamp) add to it.
    assert!(drop > clamp_alone && drop < 1.35 * clamp_alone);
}

/// Eq. (4): damping forces in proportion to speed, so the loop of a frictionless pack grows with frequency, from nothing.
#[test]
fn structural_damping_is_viscous() {
    let damped = Structure {
        structural_damping_s: 1e-4,
        ..Structure::default()
    };
    let lost = |frequency_hz: f64| {
        let mut p = pack(
            &damped,
            &Values {
                preload_mm: 2.0,
                ..Values::frictionless()
            },
        );
        let points: Vec<(f64, f64)> = (0..=2000)
            .map(|k| {
                let t_s = f64::from(k) * 1e-3 / frequency_hz;
                let d = 3.0 - 3.0 * (t_s * frequency_hz * std::f64::consts::TAU).cos();
                (d, p.step(d, 1e-3 / frequency_hz))
            })
            .collect();
        loop_j(&points[1000..])
    };
    let (slow, fast) = (lost(0.1), lost(1.0));
    println!("loop at 0.1 Hz {slow:.3e} J, at 1 Hz {fast:.3e} J");
    assert!(slow > 0.0);
    close("ratio of the loops", fast / slow, 10.0, 0.02);
}

/// The reference's rows at clamp 88 mm: presliding keeps 1.021 J of the 120 s loop, tanh with 1 mm/s 0.0085 J, and 0.052 J
/// at 1 Hz. Its static stroke is not given: 24.5 mm is the one that gives its presliding loop.
#[test]
fn the_tanh_law_loses_the_slow_loop() {
    let tanh = Structure {
        friction_law: FrictionChoice::Tanh,
        ..Structure::default()
    };
    let v = Values {
        clamp_length_mm: 88.0,
        ..values()
    };
    let (_, e) = static_loop(&mut pack(&Structure::default(), &v), 24.5, 0.5);
    close("static loop, presliding, J", e, 1.021, 0.02);
    let (_, e) = static_loop(&mut pack(&tanh, &v), 24.5, 0.5);
    close("static loop with 1 mm/s transition, J", e, 0.0085, 0.05);
    let (_, e) = sine_row(&mut pack(&tanh, &v), 1000);
    close("1 Hz loop with 1 mm/s transition, J", e, 0.052, 0.03);
}

#[test]
fn a_pusher_that_lifts_off_feels_nothing() {
    for mounting in [Mounting::Rail, Mounting::Shackle] {
        let mut p = pack(
            &Structure {
                mounting,
                ..Structure::default()
            },
            &all_sources(),
        );
        assert!(p.step(6.0, 0.1) > 300.0);
        assert_eq!(p.step(-3.0, 0.1), 0.0);
        assert_eq!(p.step(-3.1, 0.1), 0.0);
        let again = p.step(6.0, 0.1);
        assert!(again > 300.0, "{again}");
        assert_eq!(p.unconverged(), 0);
    }
}

/// Jumps, noise and nonsense: a finite force always, and the same bits from the same input.
#[test]
fn no_motion_breaks_it() {
    for mounting in [Mounting::Rail, Mounting::Shackle] {
        let drive = || {
            let mut p = pack(
                &Structure {
                    mounting,
                    ..Structure::default()
                },
                &all_sources(),
            );
            let mut seed = 7u64;
            let mut random = || {
                seed = seed
                    .wrapping_mul(6364136223846793005)
                    .wrapping_add(1442695040888963407);
                (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
            };
            let mut forces = Vec::new();
            for k in 0..2000 {
                let noise = 4e-3 * random();
                let jump = if k % 100 == 99 { 30.0 * random() } else { 0.0 };
                forces.push(p.step(8.0 + jump + noise, 1e-3));
            }
            for odd in [f64::NAN, f64::INFINITY, -500.0, 0.0, 60.0, 5.0] {
                forces.push(p.step(odd, 1e-3));
            }
            (forces, p.unconverged())
        };
        let (forces, unconverged) = drive();
        println!("{mounting:?}: {unconverged} steps not converged");
        assert!(forces.iter().all(|f| f.is_finite() && *f >= 0.0));
        assert_eq!(unconverged, 0);
        assert!(
            drive()
                .0
                .iter()
                .zip(&forces)
                .all(|(a, b)| a.to_bits() == b.to_bits())
        );
    }
}

/// A very thick leaf: the pack gives no more than its supports do.
#[test]
fn a_rigid_leaf_leaves_the_supports_stiffness() {
    let mut s = Structure {
        support_stiffness_n_per_mm: 100.0,
        ..Structure::default()
    };
    s.leaves.truncate(1);
    s.leaves[0].thickness_mm = 300.0;
    let mut p = pack(&s, &Values::frictionless());
    let rate = p.step(1.0, 1.0) - p.step(0.0, 1.0);
    // Two eyes in parallel, in series with the pusher; the leaf itself has some 2e6 N/mm.
    close(
        "rate of a rigid leaf, N/mm",
        rate,
        1.0 / (1.0 / 200.0 + 1.0 / 100.0),
        0.001,
    );
}

/// A single flat leaf pressed in the middle: 48 E I / L^3 with L the free length between the eyes.
#[test]
fn a_single_flat_leaf_is_a_beam() {
    for segments in [2, 10, 80] {
        let mut s = Structure {
            segments,
            ..Structure::default()
        };
        s.leaves.truncate(1);
        s.leaves[0].radius_mm = 1e9;
        let v = Values {
            clamp_length_mm: 0.0,
            ..Values::frictionless()
        };
        let mut p = pack(&s, &v);
        p.set_tolerance_n(1e-7);
        let inertia = 50.0 * 6.15f64.powi(3) / 12.0;
        let wanted = 48.0 * 207_000.0 * inertia / 880f64.powi(3);
        // Nothing but the second order of a slope of 2e-5 and the supports' 1e6 N/mm.
        close(
            &format!("rate with {segments} segments, N/mm"),
            p.step(0.005, 1.0) / 0.005,
            wanted,
            1e-4,
        );
    }
}

/// What an identification asks for: every pack within the bounds can be clamped and loaded.
#[test]
fn every_plausible_pack_assembles() {
    let mut count = 0;
    for thickness_correction_mm in (-20..=20).map(|k| 0.05 * f64::from(k)) {
        for clamp_length_mm in [0.0, 37.0, 60.0, 88.0, 100.0, 119.0, 200.0] {
            let v = Values {
                thickness_correction_mm,
                clamp_length_mm,
                ..values()
            };
            let mut p = pack(&Structure::default(), &v);
            assert!(p.step(1.0, 1.0) > 20.0);
            assert_eq!(p.unconverged(), 0);
            count += 1;
        }
    }
    let hard = Structure {
        contact_stiffness_n_per_mm: 1e7,
        ..Structure::default()
    };
    assert!(pack(&hard, &values()).step(1.0, 1.0) > 20.0);
    for segments in [0, 22, 44, 172, 344, 688] {
        let structure = Structure {
            segments,
            ..Structure::default()
        };
        assert!(pack(&structure, &values()).step(1.0, 1.0) > 20.0);
    }
    let mut cut = Structure::default();
    cut.leaves[1].length_mm = 870.0;
    assert!(pack(&cut, &values()).step(1.0, 1.0) > 20.0);
    println!("{count} packs");
}

/// Values anywhere within belief (friction up to its bound of belief, twice over), both mountings, a row and a sine.
#[test]
fn any_believable_pack_converges() {
    let mut seed = 11u64;
    let mut random = |[low, high]: [f64; 2]| {
        seed = seed
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        low + (high - low) * (seed >> 11) as f64 / (1u64 << 53) as f64
    };
    let (mut steps, mut unconverged) = (0, 0);
    for k in 0..60 {
        let mounting = if k % 2 == 0 {
            Mounting::Rail
        } else {
            Mounting::Shackle
        };
        let drawn: Vec<f64> = PARAMETERS
            .iter()
            .map(|p| random(p.belief) * if p.name.ends_with("_mu") { 2.0 } else { 1.0 })
            .collect();
        let v = Values::from_slice(&drawn).expect("one a parameter");
        let eye_offset_mm = random([-20.0, 20.0]);
        let structure = Structure {
            mounting,
            eye_offset_mm,
            ..Structure::default()
        };
        let mut p = pack(&structure, &v);
        let (force, _) = static_row(&mut p, 1.0);
        assert!(force > 500.0);
        let row = p.unconverged();
        p.reset();
        sine_row(&mut p, 100);
        steps += 69 + 200;
        unconverged += row + p.unconverged();
        if row + p.unconverged() > 0 {
            println!("{mounting:?}: {row} and {} steps of {v:?}", p.unconverged());
        }
    }
    println!("{unconverged} of {steps} steps did not converge");
    assert_eq!(unconverged, 0);
}

#[test]
fn it_is_in_the_list_of_models() {
    let m = model::find("leaf-pack").expect("listed");
    let mut values = m.start_values();
    values[m.parameter_index("preload_mm").expect("parameter")] = 4.0;
    let table: toml::Table = "mounting = \"rail\"\nsegments = 44".parse().expect("toml");
    let mut plant = m.plant(&values, &table).expect("builds");
    let preloaded = plant.step(0.0, 1e-3);
    println!("force at a reading of zero with 4 mm preload: {preloaded:.1} N");
    assert!(preloaded > 250.0);
    plant.step(3.0, 1e-3);
    plant.reset();
    assert_eq!(plant.step(0.0, 1e-3).to_bits(), preloaded.to_bits());
    assert!(m.plant(&values, &"segmnts = 3".parse().expect("toml")).is_err());
}
