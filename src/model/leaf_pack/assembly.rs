//! Assembly: each leaf as its own free arc, then clamped onto the others, which gives the nip.
//!
//! The clamp holds the leaves flat. The leaves start out as parallel arcs of leaf 1's curvature and take their own
//! curvatures in a few steps without friction, the eyes free: what is left between the tips is the pre-stress.

use super::band::V3;
use super::beam::Beam;
use super::contact::{Contact, NormalLaw};
use super::friction::SlipLaw;
use super::geometry::{FrictionChoice, Leaf, Mesh, NormalChoice, PackStructure};
use super::parameters::Values;
use super::side::{HalfPack, StepInfo};

/// Steps from parallel arcs to the leaves' own curvatures.
const NIP_STEPS: f64 = 4.0;
/// Share of the way below which the assembly is given up.
const SHORTEST_STRIDE: f64 = 1e-3;
/// Newton iterations of one of them.
const NIP_ITERATIONS: usize = 80;
/// Those of them that take the whole correction: mostly the contacts are found by then.
const WHOLE_ITERATIONS: usize = 14;
/// Residual below which no contact opens or closes any more, N.
const LINEAR_N: f64 = 1e-2;
/// Residual at which the assembly counts as in equilibrium, N.
const NIP_TOLERANCE_N: f64 = 1e-6;

/// The parts of one side, ready for [`HalfPack::new`].
pub(super) struct Assembly {
    pub nodes: Vec<V3>,
    pub fixed: usize,
    pub beams: Vec<Beam>,
    pub inner: Vec<usize>,
    pub leaf_of: Vec<usize>,
    pub contacts: Vec<Contact>,
    pub contact_count: usize,
    pub reach: Vec<usize>,
    pub mass: Vec<[f64; 2]>,
    pub normal_law: NormalLaw,
    pub slip_law: SlipLaw,
}

/// A clamped side at rest, its eye free, before friction is switched on.
pub(super) fn clamped_side(structure: &PackStructure, values: &Values) -> Result<HalfPack, String> {
    let leaves: Vec<Leaf> = structure
        .leaves
        .iter()
        .map(|leaf| Leaf {
            thickness_mm: leaf.thickness_mm + values.thickness_correction_mm,
            ..*leaf
        })
        .collect();
    if let Some(i) = leaves.iter().position(|l| l.thickness_mm <= 0.0) {
        return Err(format!(
            "leaf {} is {} mm thick after the correction: correct less",
            i + 1,
            leaves[i].thickness_mm
        ));
    }
    let halves: Vec<f64> = leaves.iter().map(|l| 0.5 * l.length_mm).collect();
    let mesh = Mesh::new(&halves, 0.5 * values.clamp_length_mm, structure.segments)?;
    let mut side = HalfPack::new(parts(structure, values, &leaves, &mesh));
    let depth = depths(&leaves);
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
        if bend(&mut side, goal) {
            done = goal;
        } else if stride > SHORTEST_STRIDE {
            side.nodes.copy_from_slice(&side.settled);
            stride *= 0.5;
        } else {
            return Err(
                "the leaves found no equilibrium when clamped: check radii and thicknesses".to_owned(),
            );
        }
    }
    side.mu = values.interleaf_mu;
    for i in 0..side.contacts.len() {
        let c = side.contacts[i].contact;
        let (u, l) = (side.nodes[c.upper], side.nodes[c.lower]);
        let m = c.measure(&u, &l, [u[2].cos(), u[2].sin()]);
        side.contacts[i].slider.release(m.slip);
        side.contacts[i].slip_start_mm = m.slip;
        side.contacts[i].normal_n = side.normal_law.force(-m.gap).0;
    }
    side.note_strain();
    side.settled.copy_from_slice(&side.nodes);
    side.before.copy_from_slice(&side.nodes);
    side.older.copy_from_slice(&side.nodes);
    Ok(side)
}

/// Newton's method to equilibrium with the eye free. Without friction there is an energy to descend: where whole
/// corrections go to and fro between contacts, one that runs past the energy's minimum is shortened to it.
fn settle(side: &mut HalfPack) -> bool {
    let still = StepInfo {
        dt_s: 1.0,
        viscosity: 0.0,
        inertia: 0.0,
        frame_acceleration: [0.0; 2],
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
        // No body turns by more than this in one go.
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

/// How steeply the energy falls along the correction at hand.
fn descent(side: &HalfPack) -> f64 {
    let rest = &side.residual[side.fixed..];
    rest.iter()
        .zip(&side.scratch)
        .map(|(r, d)| r[0] * d[0] + r[1] * d[1] + r[2] * d[2])
        .sum()
}

/// Takes a share of the correction at hand.
fn go(side: &mut HalfPack, share: f64) {
    let fixed = side.fixed;
    for (node, d) in side.nodes[fixed..].iter_mut().zip(&side.scratch) {
        for i in 0..3 {
            node[i] -= share * d[i];
        }
    }
}

fn parts(structure: &PackStructure, values: &Values, leaves: &[Leaf], mesh: &Mesh) -> Assembly {
    let start_mm = 0.5 * values.clamp_length_mm;
    let depth = depths(leaves);
    let fixed = leaves.len();
    // Within a station the lowest leaf comes first, so that leaf 1 with the eye is eliminated last.
    let mut nodes: Vec<V3> = (0..fixed)
        .rev()
        .map(|leaf| [start_mm, -depth[leaf], 0.0])
        .collect();
    let (mut beams, mut inner, mut leaf_of, mut contacts, mut reach) =
        (vec![], vec![], vec![], vec![], vec![]);
    let mut last: Vec<usize> = (0..fixed).map(|leaf| fixed - 1 - leaf).collect();
    let mut from_mm = start_mm;
    for (k, &at_mm) in mesh.station_mm.iter().enumerate() {
        let here = mesh.leaves_at[k];
        let next = mesh.leaves_at.get(k + 1).copied().unwrap_or(0);
        for leaf in (0..here).rev() {
            let Leaf {
                thickness_mm,
                width_mm,
                ..
            } = leaves[leaf];
            let node = nodes.len();
            let radius = leaves[0].radius_mm + depth[leaf];
            let angle = (at_mm - start_mm) / radius;
            nodes.push([
                start_mm + radius * angle.sin(),
                leaves[0].radius_mm - radius * angle.cos(),
                angle,
            ]);
            beams.push(Beam::new(
                values.e_mpa,
                width_mm,
                thickness_mm,
                at_mm - from_mm,
                1.0 / radius,
            ));
            inner.push(last[leaf]);
            last[leaf] = node;
            leaf_of.push(leaf);
            // To the same leaf's body at the next station, or at least to the end of this one.
            reach.push(if leaf < next { next } else { leaf });
            if leaf > 0 {
                contacts.push(contact(leaves, leaf, node));
            }
        }
        from_mm = at_mm;
    }
    let reach = envelope(reach);
    let slip_law = match structure.friction_law {
        FrictionChoice::Presliding => SlipLaw::Presliding(structure.tangential_stiffness_n_per_mm),
        FrictionChoice::Tanh => SlipLaw::Tanh(structure.transition_velocity_mm_s),
    };
    let normal_law = match structure.contact_law {
        NormalChoice::Penalty => NormalLaw::Penalty(structure.contact_stiffness_n_per_mm),
        NormalChoice::Hertz => NormalLaw::hertz(values.e_mpa, structure.sphere_radius_mm),
    };
    Assembly {
        fixed,
        mass: masses(structure, leaves, &beams, &leaf_of),
        contact_count: contacts.len(),
        nodes,
        beams,
        inner,
        leaf_of,
        contacts,
        reach,
        normal_law,
        slip_law,
    }
}

/// How far each leaf's middle lies below leaf 1's in the clamp, mm.
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

/// A row reaches at least to where the row before it did: elimination fills the band that far.
fn envelope(mut reach: Vec<usize>) -> Vec<usize> {
    let n = reach.len();
    let mut far = 0;
    for (b, r) in reach.iter_mut().enumerate() {
        far = far.max(b + *r).min(n - 1);
        *r = far - b;
    }
    reach
}

/// Each body has half the mass of the beam before and of the one after it.
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
