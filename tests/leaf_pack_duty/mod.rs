//! Duty and helpers of the leaf pack's tests: Table 1 geometry, clamp 100 mm, no eye offset, interleaf mu 0.3, no other friction.

use crate::model::Plant;
use crate::model::leaf_pack::{LeafPack, Mounting, PackStructure, Values, graded_path};

pub const REFERENCE_MU: f64 = 0.3;

pub fn values() -> Values {
    Values {
        interleaf_mu: REFERENCE_MU,
        ..Values::frictionless()
    }
}

pub fn shackle(angle_deg: f64) -> (PackStructure, Values) {
    let structure = PackStructure {
        mounting: Mounting::Shackle,
        ..PackStructure::default()
    };
    (
        structure,
        Values {
            shackle_angle_rad: angle_deg.to_radians(),
            ..values()
        },
    )
}

pub fn pack(structure: &PackStructure, values: &Values) -> LeafPack {
    LeafPack::new(structure, values).expect("valid pack")
}

/// Loop energy in J of (displacement mm, force N) points.
pub fn loop_j(points: &[(f64, f64)]) -> f64 {
    points
        .windows(2)
        .map(|w| 0.5e-3 * (w[0].1 + w[1].1) * (w[1].0 - w[0].0))
        .sum()
}

/// Peak force (N) and loop energy (J) of 0 -> 26 -> 0 mm.
pub fn static_row(pack: &mut LeafPack, longest_mm: f64) -> (f64, f64) {
    static_loop(pack, 26.0, longest_mm)
}

/// Peak force (N) and loop energy (J) of 0 -> stroke -> 0 mm in 120 s.
pub fn static_loop(pack: &mut LeafPack, stroke_mm: f64, longest_mm: f64) -> (f64, f64) {
    let path = graded_path(&[0.0, stroke_mm, 0.0], longest_mm);
    let points: Vec<(f64, f64)> = pack
        .static_path(&path, 120.0)
        .iter()
        .map(|p| (p.displacement_mm, p.force_n))
        .collect();
    (points.iter().fold(0.0, |m, p| m.max(p.1)), loop_j(&points))
}

/// Peak force (N) and energy (J) of the second cycle 2 -> 8 -> 2 mm at 1 Hz, `rate` steps a second.
pub fn sine_row(pack: &mut LeafPack, rate: usize) -> (f64, f64) {
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

/// Asserts that `got` is within a relative error of `wanted`.
pub fn close(what: &str, got: f64, wanted: f64, relative: f64) {
    let error = got / wanted - 1.0;
    assert!(
        error.abs() <= relative,
        "{what}: {got} against {wanted} ({:+.2} %), allowed {relative}",
        100.0 * error
    );
}

/// Values with every source of friction.
pub fn all_sources() -> Values {
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
