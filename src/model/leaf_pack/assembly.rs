//! Assembly: each leaf is a free arc and is then clamped onto the others, which gives the nip.
//!
//! The clamp holds the leaves flat. The leaves start as parallel arcs with the curvature of leaf 1 and take their own
//! curvatures in a few steps without friction and with free eyes. The contact forces that remain are the pre-stress.

use super::band::V3;
use super::beam::Beam;
use super::contact::{Contact, NormalLaw};
use super::geometry::{ContactChoice, Leaf, Mesh, PackStructure};
use super::parameters::Values;
use super::side::{Assembly, HalfPack, StepInfo};

/// Steps from parallel arcs to the leaves' own curvatures.
const NIP_STEPS: f64 = 4.0;
/// Shortest step, as a share of the whole change of curvature. The assembly fails below it.
const SHORTEST_STRIDE: f64 = 1e-3;
/// Newton iterations of one step.
const NIP_ITERATIONS: usize = 80;
/// Iterations that take the whole correction. Usually the contacts are found within them.
const WHOLE_ITERATIONS: usize = 14;
/// Residual below which no contact opens or closes, N.
const LINEAR_N: f64 = 1e-2;
/// Residual at which the assembly is in equilibrium, N.
const NIP_TOLERANCE_N: f64 = 1e-6;

/// A clamped side at rest, its eye free, before friction is switched on.
pub(super) fn clamped_side(structure: &PackStructure, values: &Values) -> Result<HalfPack, String> {
    let leaves = corrected_leaves(structure, values)?;
    let halves: Vec<f64> = leaves.iter().map(|l| 0.5 * l.length_mm).collect();
    let mesh = Mesh::new(&halves, 0.5 * values.clamp_length_mm, structure.segments)?;
    let mut side = HalfPack::new(parts(structure, values, &leaves, &mesh));
    take_own_curvatures(&mut side, &leaves)?;
    side.mu = values.interleaf_mu;
    start_slips(&mut side);
    side.note_strain();
    side.settled.copy_from_slice(&side.nodes);
    side.before.copy_from_slice(&side.nodes);
    side.older.copy_from_slice(&side.nodes);
    Ok(side)
}

/// The leaves with the thickness correction.
fn corrected_leaves(structure: &PackStructure, values: &Values) -> Result<Vec<Leaf>, String> {
    let leaves: Vec<Leaf> = structure
        .leaves
        .iter()
        .map(|leaf| Leaf {
            thickness_mm: leaf.thickness_mm + values.thickness_correction_mm,
            ..*leaf
        })
        .collect();
    match leaves.iter().position(|l| l.thickness_mm <= 0.0) {
        Some(i) => Err(format!(
            "leaf {} is {} mm thick after thickness_correction_mm = {}: enter a smaller correction",
            i + 1,
            leaves[i].thickness_mm,
            values.thickness_correction_mm
        )),
        None => Ok(leaves),
    }
}

/// From parallel arcs to the leaves' own curvatures, in shorter steps where the equilibrium is not found.
fn take_own_curvatures(side: &mut HalfPack, leaves: &[Leaf]) -> Result<(), String> {
    let depth = depths(leaves);
    let bend = |side: &mut HalfPack, share: f64| {
        for b in 0..side.beams.len() {
            let leaf = side.leaf_of[b];
            let (own, start) = (
                1.0 / leaves[leaf].radius_mm,
                1.0 / (leaves[0].radius_mm + depth[leaf]),
            );
            side.beams[b].set_curvature(start + share * (own - start));
        }
        settle(side)
    };
    let (mut done, mut stride) = (0.0, 1.0 / NIP_STEPS);
    while done < 1.0 {
        let goal = f64::min(done + stride, 1.0);
        side.settled.copy_from_slice(&side.nodes);
        if bend(side, goal) {
            done = goal;
        } else if stride > SHORTEST_STRIDE {
            side.nodes.copy_from_slice(&side.settled);
            stride *= 0.5;
        } else {
            return Err(
                "the clamped leaves have no equilibrium: check radius_mm and thickness_mm of the leaves"
                    .to_owned(),
            );
        }
    }
    Ok(())
}

/// Starts the friction of all contacts without force, at the present slip.
fn start_slips(side: &mut HalfPack) {
    for i in 0..side.contacts.len() {
        let c = side.contacts[i].contact;
        let (u, l) = (side.nodes[c.upper], side.nodes[c.lower]);
        let m = c.measure(&u, &l, [u[2].cos(), u[2].sin()]);
        side.contacts[i].slider.release(m.slip);
        side.contacts[i].slip_start_mm = m.slip;
        side.contacts[i].normal_n = side.normal_law.force(-m.gap).0;
    }
}

/// Newton's method to equilibrium with the eye free. Without friction the equilibrium is a minimum of energy. Where whole
/// corrections alternate between contacts, a correction that passes the minimum is shortened to it.
fn settle(side: &mut HalfPack) -> bool {
    let still = StepInfo {
        dt_s: 1.0,
        viscosity: 0.0,
        inertia: 0.0,
        clamp_acceleration: [0.0; 2],
    };
    let fixed = side.fixed;
    for k in 0..NIP_ITERATIONS {
        side.evaluate::<true>(&still);
        let residual = side.residual_n();
        if residual < NIP_TOLERANCE_N.max(side.rounding_n()) {
            return true;
        }
        side.scratch.copy_from_slice(&side.residual[fixed..]);
        if !residual.is_finite() || !side.band.factor() {
            return false;
        }
        side.band.solve(&mut side.scratch);
        let slope = descent(side);
        // A body turns by 0.05 rad per iteration at most.
        let turn = side.scratch.iter().fold(0.0f64, |m, r| m.max(r[2].abs()));
        let whole = (0.05 / turn).min(1.0);
        go(side, whole);
        if k < WHOLE_ITERATIONS || residual < LINEAR_N {
            continue;
        }
        side.evaluate::<false>(&still);
        let beyond = descent(side);
        if beyond < -0.5 * slope.abs() {
            let keep = (slope / (slope - beyond)).clamp(0.1, 1.0);
            go(side, whole * (keep - 1.0));
        }
    }
    false
}

/// Slope of the energy along the present correction, N mm.
fn descent(side: &HalfPack) -> f64 {
    let rest = &side.residual[side.fixed..];
    rest.iter()
        .zip(&side.scratch)
        .map(|(r, d)| r[0] * d[0] + r[1] * d[1] + r[2] * d[2])
        .sum()
}

/// Takes a share of the present correction.
fn go(side: &mut HalfPack, share: f64) {
    let fixed = side.fixed;
    for (node, d) in side.nodes[fixed..].iter_mut().zip(&side.scratch) {
        for i in 0..3 {
            node[i] -= share * d[i];
        }
    }
}

/// All parts of one side, the leaves as parallel arcs.
fn parts(structure: &PackStructure, values: &Values, leaves: &[Leaf], mesh: &Mesh) -> Assembly {
    let Bodies {
        nodes,
        beams,
        inner,
        leaf_of,
        contacts,
        reach,
    } = bodies(values, leaves, mesh);
    Assembly {
        fixed: leaves.len(),
        mass: masses(structure, leaves, &beams, &leaf_of),
        nodes,
        beams,
        inner,
        leaf_of,
        contacts,
        reach: envelope(reach),
        normal_law: match structure.contact_law {
            ContactChoice::Penalty => NormalLaw::Penalty(structure.contact_stiffness_n_per_mm),
            ContactChoice::Hertz => NormalLaw::hertz(values.e_mpa, structure.sphere_radius_mm),
        },
        slip_law: structure.slide_law(),
    }
}

/// Nodes, beams and contacts of one side, see [`HalfPack`].
struct Bodies {
    nodes: Vec<V3>,
    beams: Vec<Beam>,
    inner: Vec<usize>,
    leaf_of: Vec<usize>,
    contacts: Vec<Contact>,
    /// Number of bodies after each body that it can couple to.
    reach: Vec<usize>,
}

/// Bodies station by station. Within a station the lowest leaf comes first, so that leaf 1 with the eye is eliminated last.
fn bodies(values: &Values, leaves: &[Leaf], mesh: &Mesh) -> Bodies {
    let start_mm = 0.5 * values.clamp_length_mm;
    let depth = depths(leaves);
    let fixed = leaves.len();
    let clamped = (0..fixed).rev().map(|leaf| [start_mm, -depth[leaf], 0.0]);
    let mut out = Bodies {
        nodes: clamped.collect(),
        beams: vec![],
        inner: vec![],
        leaf_of: vec![],
        contacts: vec![],
        reach: vec![],
    };
    let mut last: Vec<usize> = (0..fixed).map(|leaf| fixed - 1 - leaf).collect();
    let mut from_mm = start_mm;
    for (k, &at_mm) in mesh.station_mm.iter().enumerate() {
        let next = mesh.leaves_at.get(k + 1).copied().unwrap_or(0);
        for leaf in (0..mesh.leaves_at[k]).rev() {
            let Leaf {
                thickness_mm,
                width_mm,
                ..
            } = leaves[leaf];
            let radius = leaves[0].radius_mm + depth[leaf];
            let angle = (at_mm - start_mm) / radius;
            let length_mm = at_mm - from_mm;
            let node = out.nodes.len();
            out.nodes.push([
                start_mm + radius * angle.sin(),
                leaves[0].radius_mm - radius * angle.cos(),
                angle,
            ]);
            out.beams.push(Beam::new(
                values.e_mpa,
                width_mm,
                thickness_mm,
                length_mm,
                1.0 / radius,
            ));
            out.inner.push(last[leaf]);
            last[leaf] = node;
            out.leaf_of.push(leaf);
            // To the same leaf's body at the next station, or at least to the end of this station.
            out.reach.push(if leaf < next { next } else { leaf });
            if leaf > 0 {
                out.contacts.push(contact(leaves, leaf, node));
            }
        }
        from_mm = at_mm;
    }
    out
}

/// Distance of each leaf's middle line below that of leaf 1 in the clamp, mm.
fn depths(leaves: &[Leaf]) -> Vec<f64> {
    let mut depth = vec![0.0];
    for pair in leaves.windows(2) {
        let above = depth[depth.len() - 1];
        depth.push(above + 0.5 * (pair[0].thickness_mm + pair[1].thickness_mm));
    }
    depth
}

fn contact(leaves: &[Leaf], leaf: usize, node: usize) -> Contact {
    let (own, above) = (&leaves[leaf], &leaves[leaf - 1]);
    let sphere = 0.5 * own.thickness_mm;
    let face = 0.5 * above.thickness_mm;
    Contact {
        lower: node,
        upper: node + 1,
        standoff: face + sphere,
        sphere,
        curvature: 1.0 / (above.radius_mm + face),
    }
}

/// Each row reaches at least as far as the row before it, because the elimination fills the band that far.
fn envelope(mut reach: Vec<usize>) -> Vec<usize> {
    let n = reach.len();
    let mut far = 0;
    for (b, r) in reach.iter_mut().enumerate() {
        far = far.max(b + *r).min(n - 1);
        *r = far - b;
    }
    reach
}

/// Masses and rotary inertias: each body has half of the beam before it and half of the beam after it.
fn masses(structure: &PackStructure, leaves: &[Leaf], beams: &[Beam], leaf_of: &[usize]) -> Vec<[f64; 2]> {
    let mut mass = vec![[0.0; 2]; beams.len()];
    let mut before: Vec<Option<usize>> = vec![None; leaves.len()];
    for (b, beam) in beams.iter().enumerate() {
        let leaf = &leaves[leaf_of[b]];
        let volume_mm3 = 0.5 * beam.length * leaf.thickness_mm * leaf.width_mm;
        let half = crate::units::inertia_force_n(structure.density_kg_m3 * 1e-9 * volume_mm3, 1.0);
        let rotary = half * (beam.length * beam.length / 12.0 + leaf.thickness_mm * leaf.thickness_mm / 12.0);
        for body in [Some(b), before[leaf_of[b]]].into_iter().flatten() {
            mass[body][0] += half;
            mass[body][1] += rotary;
        }
        before[leaf_of[b]] = Some(b);
    }
    mass
}
