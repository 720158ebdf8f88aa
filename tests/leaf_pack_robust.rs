//! The leaf pack as plant and as a model to fit: any motion gives a finite force, every plausible pack converges, the shipped
//! specimen files give the paper's figures.

use super::leaf_pack_duty::{all_sources, close, loop_j, pack, sine_row, static_row, values};
use crate::model::leaf_pack::{LeafPack, Mounting, PARAMETERS, PackStructure, Values};
use crate::model::{self, Plant};

#[test]
fn the_force_is_0_after_lift_off() {
    for mounting in [Mounting::Rail, Mounting::Shackle] {
        let mut p = pack(
            &PackStructure {
                mounting,
                ..PackStructure::default()
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

/// Jumps, noise and values that are not finite: the force is always finite, and the same input gives the same bits.
#[test]
fn any_motion_gives_a_finite_force() {
    for mounting in [Mounting::Rail, Mounting::Shackle] {
        let drive = || {
            let mut p = pack(
                &PackStructure {
                    mounting,
                    ..PackStructure::default()
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
        assert!(forces.iter().all(|f| f.is_finite() && *f >= 0.0));
        assert_eq!(unconverged, 0, "{mounting:?}");
        assert!(
            drive()
                .0
                .iter()
                .zip(&forces)
                .all(|(a, b)| a.to_bits() == b.to_bits())
        );
    }
}

/// Displacements far beyond any load frame, up to more than the length of the leaves: the force is finite, and the loop
/// afterwards is that of a fresh pack.
#[test]
fn the_pack_recovers_from_absurd_displacements() {
    for mounting in [Mounting::Rail, Mounting::Shackle] {
        let structure = PackStructure {
            mounting,
            ..PackStructure::default()
        };
        let fresh = pack(&structure, &all_sources()).step(5.0, 1e-3);
        for far_mm in [100.0, 150.0, 300.0, 2000.0] {
            let mut p = pack(&structure, &all_sources());
            let force = p.step(far_mm, 1e-3);
            p.step(-10.0, 1e-3);
            let back = p.step(5.0, 1e-3);
            assert!(force.is_finite() && back.is_finite());
            // The two differ by the width of a friction loop at most.
            assert!(
                (back / fresh - 1.0).abs() < 0.05,
                "{mounting:?} {far_mm} mm: {force:.0} N, at 5 mm {back:.1} N, fresh {fresh:.1} N"
            );
        }
    }
}

/// The state for drawing: four leaves with both sides, flatter under load, with contact forces that press.
#[test]
fn the_shape_flattens_under_load() {
    let mut p = pack(&PackStructure::default(), &values());
    let camber = |p: &LeafPack| {
        let shape = p.shape();
        assert_eq!(shape.leaves.len(), 4);
        assert_eq!(
            shape.leaves.iter().map(|l| l.stations.len() - 2).sum::<usize>(),
            p.segments()
        );
        assert!(
            shape
                .leaves
                .iter()
                .all(|l| l.stations.windows(2).all(|w| w[1].x_mm > w[0].x_mm))
        );
        assert!(shape.contacts.iter().all(|c| c.normal_n >= 0.0));
        shape.eyes_mm[1][1] - shape.clamp_mm[0]
    };
    let before = camber(&p);
    p.step(20.0, 1.0);
    let after = camber(&p);
    // The supports move by 1600 N / (1e6 N/mm).
    assert!(
        (before - after - 20.0).abs() < 5e-3,
        "camber {before:.3} -> {after:.3} mm"
    );
}

/// An identification tries any pack within the bounds: each can be clamped and loaded.
#[test]
fn every_plausible_pack_assembles() {
    for thickness_correction_mm in (-20..=20).map(|k| 0.05 * f64::from(k)) {
        for clamp_length_mm in [0.0, 37.0, 60.0, 88.0, 100.0, 119.0, 200.0] {
            let v = Values {
                thickness_correction_mm,
                clamp_length_mm,
                ..values()
            };
            let mut p = pack(&PackStructure::default(), &v);
            assert!(p.step(1.0, 1.0) > 20.0);
            assert_eq!(p.unconverged(), 0);
        }
    }
    let hard = PackStructure {
        contact_stiffness_n_per_mm: 1e7,
        ..PackStructure::default()
    };
    assert!(pack(&hard, &values()).step(1.0, 1.0) > 20.0);
    for segments in [0, 22, 44, 172, 344, 688] {
        let structure = PackStructure {
            segments,
            ..PackStructure::default()
        };
        assert!(pack(&structure, &values()).step(1.0, 1.0) > 20.0);
    }
    let mut cut = PackStructure::default();
    cut.leaves[1].length_mm = 870.0;
    assert!(pack(&cut, &values()).step(1.0, 1.0) > 20.0);
}

/// Values from the plausible ranges (friction coefficients up to twice that), both mountings, a static loop and a sine.
#[test]
fn every_plausible_pack_converges() {
    let mut seed = 11u64;
    let mut random = |[low, high]: [f64; 2]| {
        seed = seed
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        low + (high - low) * (seed >> 11) as f64 / (1u64 << 53) as f64
    };
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
        let structure = PackStructure {
            mounting,
            eye_offset_mm,
            ..PackStructure::default()
        };
        let mut p = pack(&structure, &v);
        let (force, _) = static_row(&mut p, 1.0);
        assert!(force > 500.0);
        assert_eq!(p.unconverged(), 0, "static loop, {mounting:?}: {v:?}");
        p.reset();
        sine_row(&mut p, 100);
        assert_eq!(p.unconverged(), 0, "sine, {mounting:?}: {v:?}");
    }
}

#[test]
fn the_list_of_models_builds_it_with_preload() {
    let m = model::find("leaf-pack").expect("listed");
    let mut values = m.start_values();
    values[m.parameter_index("preload_mm").expect("parameter")] = 4.0;
    let table: toml::Table = "mounting = \"rail\"\nsegments = 44".parse().expect("toml");
    let mut plant = m.plant(&values, &table).expect("builds");
    let preloaded = plant.step(0.0, 1e-3);
    assert!(preloaded > 250.0, "{preloaded:.1} N");
    plant.step(3.0, 1e-3);
    plant.reset();
    assert_eq!(plant.step(0.0, 1e-3).to_bits(), preloaded.to_bits());
    assert!(m.plant(&values, &"segmnts = 3".parse().expect("toml")).is_err());
}

/// A shipped specimen file with the figures that its comment gives: Tables 2 and 3 of the paper.
struct Shipped {
    text: &'static str,
    /// Lowest displacement of the sines, mm.
    trough_mm: f64,
    /// Peak force, N, and energy, J, of the static loop, and the error allowed of the energy.
    static_loop: (f64, f64, f64),
    /// Stroke, mm, peak force, N, and loop energy, J, of each 1 Hz sine.
    sines: [(f64, f64, f64); 3],
    /// Errors allowed of the peak forces and of the loop energies.
    within: (f64, f64),
}

const SHIPPED: [Shipped; 2] = [
    Shipped {
        text: include_str!("../bench-configs/specimens/samurai-leaf-pack-rail.toml"),
        trough_mm: 1.6,
        static_loop: (2_000.0, 6.047, 0.06),
        sines: [(6.0, 688.0, 0.665), (10.0, 1028.0, 1.609), (15.0, 1439.0, 3.316)],
        within: (0.04, 0.2),
    },
    Shipped {
        text: include_str!("../bench-configs/specimens/samurai-leaf-pack-shackle.toml"),
        trough_mm: 1.0,
        static_loop: (2_003.0, 8.907, 0.02),
        sines: [(6.0, 1029.0, 2.425), (10.0, 1479.0, 4.915), (15.0, 1954.0, 8.489)],
        within: (0.02, 0.11),
    },
];

fn plant_of(specimen_toml: &str) -> Box<dyn Plant> {
    let file: toml::Table = specimen_toml.parse().expect("toml");
    let m = model::find(file["model"]["name"].as_str().expect("name")).expect("model");
    let mut values = m.start_values();
    for (name, value) in file["model"]["parameters"].as_table().expect("parameters") {
        values[m.parameter_index(name).expect("parameter")] = value.as_float().expect("number");
    }
    m.plant(&values, file["model"]["structure"].as_table().expect("structure"))
        .expect("builds")
}

/// Points (mm, N) of a slow loop that turns where the force passes `peak_n`.
fn slow_loop(plant: &mut dyn Plant, peak_n: f64) -> Vec<(f64, f64)> {
    let mut points = vec![(0.0, 0.0)];
    let (mut d, mut sense) = (0.0, 0.1);
    while d > -0.05 && points.len() < 1000 {
        d += sense;
        let f = plant.step(d, 0.1);
        points.push((d, f));
        if f > peak_n {
            sense = -0.1;
        }
    }
    points
}

#[test]
fn specimen_files_give_the_figures_of_their_comments() {
    for shipped in SHIPPED {
        let mut p = plant_of(shipped.text);
        let (peak_n, energy_j, within) = shipped.static_loop;
        close(
            "static loop, J",
            loop_j(&slow_loop(&mut *p, peak_n)),
            energy_j,
            within,
        );
        for (stroke_mm, force_n, loop_energy_j) in shipped.sines {
            p.reset();
            let points: Vec<(f64, f64)> = (0..=400)
                .map(|k| {
                    let cosine = (f64::from(k) * 5e-3 * std::f64::consts::TAU).cos();
                    let d = shipped.trough_mm + 0.5 * stroke_mm * (1.0 - cosine);
                    (d, p.step(d, 5e-3))
                })
                .collect();
            let peak = points.iter().fold(0.0f64, |m, p| m.max(p.1));
            let (force_within, loop_within) = shipped.within;
            close(&format!("peak of {stroke_mm} mm, N"), peak, force_n, force_within);
            close(
                &format!("loop of {stroke_mm} mm, J"),
                loop_j(&points[200..]),
                loop_energy_j,
                loop_within,
            );
        }
    }
}
