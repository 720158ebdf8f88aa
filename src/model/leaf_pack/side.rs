//! One side of the pack, from the clamp to the eye: bodies, beams and contacts, their residual and their tangent.
//!
//! The coordinates move with the clamp: x outward along the pack, y towards the eyes, the clamp's edge at rest. So a side does
//! not depend on how the clamp moves. Only its last body, which carries the eye, meets the support (see `mounting`).

use super::band::{BlockBand, M3, V3};
use super::beam::{Beam, BeamForce, Strain};
use super::contact::{Contact, Measure, NormalLaw};
use super::slip_law::{Slider, SlipLaw, SlipResponse, SlipState};

/// Time step and inertia terms of one step.
#[derive(Debug, Clone, Copy)]
pub(super) struct StepInfo {
    pub dt_s: f64,
    /// xi / dt of the structural damping, a pure number.
    pub viscosity: f64,
    /// Acceleration per displacement within the step, 1/s2; 0 when quasi-static.
    pub inertia: f64,
    /// Acceleration of the clamp sideways and along the load, mm/s2.
    pub clamp_acceleration: [f64; 2],
}

/// A contact with its state at the last converged step.
#[derive(Debug, Clone)]
pub(super) struct ContactState {
    pub contact: Contact,
    pub slider: Slider,
    pub normal_n: f64,
    /// Slip right after assembly, mm.
    pub slip_start_mm: f64,
}

/// Slip and forces of a contact at the present estimate.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ContactEstimate {
    slip_mm: f64,
    friction_n: f64,
    normal_n: f64,
}

/// The parts of one side, ready for [`HalfPack::new`].
pub(super) struct Assembly {
    pub nodes: Vec<V3>,
    pub fixed: usize,
    pub beams: Vec<Beam>,
    pub inner: Vec<usize>,
    pub leaf_of: Vec<usize>,
    pub contacts: Vec<Contact>,
    pub reach: Vec<usize>,
    pub mass: Vec<[f64; 2]>,
    pub normal_law: NormalLaw,
    pub slip_law: SlipLaw,
}

/// One side of the pack, ready to solve.
#[derive(Debug, Clone)]
pub(super) struct HalfPack {
    /// Nodes: first those in the clamp (fixed, one per leaf), then the bodies in the order of elimination.
    pub nodes: Vec<V3>,
    /// Number of fixed nodes, which is the number of leaves.
    pub fixed: usize,
    pub beams: Vec<Beam>,
    /// Inner node of each body's beam.
    pub inner: Vec<usize>,
    pub leaf_of: Vec<usize>,
    pub contacts: Vec<ContactState>,
    estimates: Vec<ContactEstimate>,
    pub normal_law: NormalLaw,
    pub slip_law: SlipLaw,
    pub mu: f64,
    /// Masses (N s2/mm) and rotary inertia (N s2 mm) of the bodies.
    pub mass: Vec<[f64; 2]>,
    pub strain: Vec<Strain>,
    pub residual: Vec<V3>,
    /// Right-hand sides and solutions, one triple per body.
    pub scratch: Vec<V3>,
    /// Sum of the bodies' inertia forces, N.
    pub inertia_n: [f64; 2],
    /// Columns of the clamp's motion (sideways, along the load), solved by the factors.
    pub border: Vec<[V3; 2]>,
    pub states: Vec<SlipState>,
    /// Stick-slip states of the contacts at the last factorisation.
    pub factor_states: Vec<SlipState>,
    pub band: BlockBand,
    /// Nodes at the last converged step, one step before, and two steps before.
    pub settled: Vec<V3>,
    pub before: Vec<V3>,
    pub older: Vec<V3>,
    pub velocity: Vec<V3>,
    pub acceleration: Vec<V3>,
    /// Known part of each body's inertia term in this step, mm/s2 and rad/s2.
    pub inertia_base: Vec<V3>,
    trig: Vec<[f64; 2]>,
}

impl HalfPack {
    pub(super) fn new(build: Assembly) -> Self {
        let bodies = build.beams.len();
        let contacts = build.contacts.len();
        let nodes = build.nodes;
        Self {
            fixed: build.fixed,
            beams: build.beams,
            inner: build.inner,
            leaf_of: build.leaf_of,
            contacts: build
                .contacts
                .into_iter()
                .map(|contact| ContactState {
                    contact,
                    slider: Slider::default(),
                    normal_n: 0.0,
                    slip_start_mm: 0.0,
                })
                .collect(),
            normal_law: build.normal_law,
            slip_law: build.slip_law,
            mu: 0.0,
            estimates: vec![ContactEstimate::default(); contacts],
            mass: build.mass,
            strain: vec![[0.0; 3]; bodies],
            residual: vec![[0.0; 3]; nodes.len()],
            scratch: vec![[0.0; 3]; bodies],
            inertia_n: [0.0; 2],
            border: vec![[[0.0; 3]; 2]; bodies],
            states: vec![SlipState::Free; contacts],
            factor_states: vec![SlipState::Free; contacts],
            band: BlockBand::new(build.reach),
            settled: nodes.clone(),
            before: nodes.clone(),
            older: nodes.clone(),
            velocity: vec![[0.0; 3]; bodies],
            acceleration: vec![[0.0; 3]; bodies],
            inertia_base: vec![[0.0; 3]; bodies],
            trig: vec![[1.0, 0.0]; nodes.len()],
            nodes,
        }
    }

    /// Index of the node that carries the eye.
    pub(super) fn tip(&self) -> usize {
        self.nodes.len() - 1
    }

    /// Residual force of every body (clamp nodes have their reaction), stick-slip states, and with `TANGENT` the tangent.
    pub(super) fn evaluate<const TANGENT: bool>(&mut self, step: &StepInfo) {
        self.residual.fill([0.0; 3]);
        for (trig, node) in self.trig.iter_mut().zip(&self.nodes).skip(self.fixed) {
            *trig = cos_sin(node[2]);
        }
        if TANGENT {
            self.band.clear();
        }
        self.add_beams::<TANGENT>(step);
        self.add_contacts::<TANGENT>(step);
        if step.inertia > 0.0 {
            self.add_inertia::<TANGENT>(step);
        }
        if TANGENT {
            self.factor_states.copy_from_slice(&self.states);
        }
    }

    #[inline]
    fn beam_force(&self, b: usize, viscosity: f64) -> BeamForce {
        let inner = self.inner[b];
        let (a, z) = (&self.nodes[inner], &self.nodes[b + self.fixed]);
        self.beams[b].force(a, z, self.trig[inner], &self.strain[b], viscosity)
    }

    fn add_beams<const TANGENT: bool>(&mut self, step: &StepInfo) {
        for b in 0..self.beams.len() {
            let f = self.beam_force(b, step.viscosity);
            let inner = self.inner[b];
            add(&mut self.residual[inner], &f.inner);
            add(&mut self.residual[b + self.fixed], &f.outer);
            if TANGENT {
                let [aa, ab, bb] = self.beams[b].tangent(&f, step.viscosity);
                self.band.add(b, b, &bb);
                if inner >= self.fixed {
                    let a = inner - self.fixed;
                    self.band.add(a, a, &aa);
                    self.band.add(a, b, &ab);
                    self.band.add(b, a, &transpose(&ab));
                }
            }
        }
    }

    /// Gap, normal force, its stiffness and the friction response of contact `i`.
    #[inline]
    fn contact_response(&self, i: usize, dt_s: f64) -> (Measure, f64, f64, SlipResponse) {
        let state = &self.contacts[i];
        let c = &state.contact;
        let m = c.measure(&self.nodes[c.upper], &self.nodes[c.lower], self.trig[c.upper]);
        let (n, by_d) = self.normal_law.force(-m.gap);
        let r = state.slider.respond(self.slip_law, m.slip, self.mu * n, dt_s);
        (m, n, by_d, r)
    }

    fn add_contacts<const TANGENT: bool>(&mut self, step: &StepInfo) {
        for i in 0..self.contacts.len() {
            let (m, n, by_d, mut r) = self.contact_response(i, step.dt_s);
            // A closed contact without friction must differ from an open one, because its tangent does.
            self.states[i] = if n > 0.0 && r.state == SlipState::Free {
                SlipState::Smooth
            } else {
                r.state
            };
            self.estimates[i] = ContactEstimate {
                slip_mm: m.slip,
                friction_n: r.force,
                normal_n: n,
            };
            if TANGENT && self.factor_states[i].reversed(r.state) {
                r = r.stuck(self.slip_law);
                self.states[i] = r.state;
            }
            if n <= 0.0 {
                continue;
            }
            let Contact {
                lower,
                upper,
                curvature,
                ..
            } = self.contacts[i].contact;
            let (on_upper, on_lower) = m.forces(n, r.force);
            add(&mut self.residual[upper], &on_upper);
            add(&mut self.residual[lower], &on_lower);
            if TANGENT {
                let [uu, ul, lu, ll] = m.tangent(curvature, n, by_d, self.mu, &r);
                let (u, l) = (upper - self.fixed, lower - self.fixed);
                self.band.add(u, u, &uu);
                self.band.add(u, l, &ul);
                self.band.add(l, u, &lu);
                self.band.add(l, l, &ll);
            }
        }
    }

    fn add_inertia<const TANGENT: bool>(&mut self, step: &StepInfo) {
        let c = step.inertia;
        self.inertia_n = [0.0; 2];
        for b in 0..self.beams.len() {
            let [m, j] = self.mass[b];
            let (now, then, base) = (
                &self.nodes[b + self.fixed],
                &self.settled[b + self.fixed],
                &self.inertia_base[b],
            );
            let [fx, fy] = step.clamp_acceleration;
            let r = &mut self.residual[b + self.fixed];
            let x = m * (c * (now[0] - then[0]) + base[0] + fx);
            let y = m * (c * (now[1] - then[1]) + base[1] + fy);
            r[0] += x;
            r[1] += y;
            self.inertia_n[0] += x;
            self.inertia_n[1] += y;
            r[2] += j * (c * (now[2] - then[2]) + base[2]);
            if TANGENT {
                self.band
                    .add(b, b, &[m * c, 0.0, 0.0, 0.0, m * c, 0.0, 0.0, 0.0, j * c]);
            }
        }
    }

    /// Residual that rounding alone leaves, N: the stiffest element times the last digit of the farthest coordinate.
    pub(super) fn rounding_n(&self) -> f64 {
        let far: f64 = self
            .nodes
            .iter()
            .map(|n| n[0].abs() + n[1].abs())
            .fold(0.0, f64::max);
        let stiff = self
            .beams
            .iter()
            .map(|b| b.axial + 12.0 * b.bending / (b.length * b.length))
            .fold(0.0, f64::max);
        8.0 * f64::EPSILON * far * stiff
    }

    /// Greatest residual force of a body, N; moments count with a lever of 10 mm.
    pub(super) fn residual_n(&self) -> f64 {
        let mut worst = 0.0f64;
        for r in &self.residual[self.fixed..] {
            let here = r[0].abs().max(r[1].abs()).max(0.1 * r[2].abs());
            // A NaN must reach the caller.
            if here > worst || here.is_nan() {
                worst = here;
            }
        }
        worst
    }

    /// Keeps the last evaluation as the converged step and returns the energy that the contacts dissipated, N mm.
    pub(super) fn commit(&mut self, step: &StepInfo) -> f64 {
        let mut work = 0.0;
        for (state, estimate) in self.contacts.iter_mut().zip(&self.estimates) {
            let so_far = state.slider.dissipated_nmm;
            state
                .slider
                .commit(self.slip_law, estimate.slip_mm, estimate.friction_n);
            work += state.slider.dissipated_nmm - so_far;
            state.normal_n = estimate.normal_n;
        }
        if step.viscosity > 0.0 {
            self.note_strain();
        }
        std::mem::swap(&mut self.older, &mut self.before);
        std::mem::swap(&mut self.before, &mut self.settled);
        self.settled.copy_from_slice(&self.nodes);
        work
    }

    /// Keeps the strains for the damping of the next step.
    pub(super) fn note_strain(&mut self) {
        for b in 0..self.beams.len() {
            self.strain[b] = self.beam_force(b, 0.0).strain;
        }
    }

    /// Elastic energy of beams, contacts and presliding, N mm.
    #[cfg(test)]
    pub(super) fn stored_nmm(&self) -> f64 {
        let beams: f64 = (0..self.beams.len())
            .map(|b| self.beams[b].energy_nmm(&self.beam_force(b, 0.0).strain))
            .sum();
        let contacts: f64 = (0..self.contacts.len())
            .map(|i| {
                let m = self.contact_response(i, 1.0).0;
                self.normal_law.energy_nmm(-m.gap) + self.contacts[i].slider.stored_nmm(self.slip_law)
            })
            .sum();
        beams + contacts
    }
}

/// (cos, sin): a series for the usual angles of a leaf, the standard library beyond 0.5 rad.
#[inline]
fn cos_sin(angle: f64) -> [f64; 2] {
    if angle.abs() > 0.5 {
        let (s, c) = angle.sin_cos();
        return [c, s];
    }
    // Taylor series to the 15th and 14th power: the next terms are below 1e-18.
    let q = angle * angle;
    let s = 1.0 / 6_227_020_800.0 - q / 1_307_674_368_000.0;
    let s = 1.0 / 362_880.0 - q * (1.0 / 39_916_800.0 - q * s);
    let s = 1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0 - q * (1.0 / 5_040.0 - q * s)));
    let c = 1.0 / 479_001_600.0 - q / 87_178_291_200.0;
    let c = 1.0 / 40_320.0 - q * (1.0 / 3_628_800.0 - q * c);
    let c = 1.0 - q * (0.5 - q * (1.0 / 24.0 - q * (1.0 / 720.0 - q * c)));
    [c, angle * s]
}

#[inline]
pub(super) fn add(t: &mut V3, v: &V3) {
    t[0] += v[0];
    t[1] += v[1];
    t[2] += v[2];
}

fn transpose(m: &M3) -> M3 {
    [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]]
}

#[cfg(test)]
mod tests {
    use super::super::assembly::clamped_side;
    use super::super::geometry::PackStructure;
    use super::super::parameters::Values;
    use super::*;

    const LENGTH: f64 = 400.0;
    const EI: f64 = 207_000.0 * 50.0 * 6.15 * 6.15 * 6.15 / 12.0;

    /// A single flat leaf clamped in the middle, `segments` a side.
    fn cantilever(segments: usize) -> HalfPack {
        let mut structure = PackStructure {
            segments: 2 * segments,
            ..PackStructure::default()
        };
        structure.leaves.truncate(1);
        structure.leaves[0].length_mm = 2.0 * LENGTH;
        structure.leaves[0].radius_mm = 1e12;
        clamped_side(
            &structure,
            &Values {
                clamp_length_mm: 0.0,
                ..Values::frictionless()
            },
        )
        .expect("valid")
    }

    /// The free end's node in equilibrium under a force and a moment, applied in steps.
    fn load(side: &mut HalfPack, force: [f64; 2], moment: f64, steps: usize) -> V3 {
        let still = StepInfo {
            dt_s: 1.0,
            viscosity: 0.0,
            inertia: 0.0,
            clamp_acceleration: [0.0; 2],
        };
        let tip = side.tip();
        for k in 1..=steps {
            let share = k as f64 / steps as f64;
            for iteration in 0.. {
                side.evaluate::<true>(&still);
                add(
                    &mut side.residual[tip],
                    &[-share * force[0], -share * force[1], -share * moment],
                );
                if side.residual_n() < 1e-6 + side.rounding_n() {
                    break;
                }
                assert!(iteration < 60, "no equilibrium at {share}");
                assert!(side.band.factor());
                let fixed = side.fixed;
                side.band.solve(&mut side.residual[fixed..]);
                for (node, d) in side.nodes[fixed..].iter_mut().zip(&side.residual[fixed..]) {
                    for i in 0..3 {
                        node[i] -= d[i];
                    }
                }
            }
        }
        side.nodes[tip]
    }

    #[test]
    fn the_series_agrees_with_sin_cos() {
        for k in -60..=60 {
            let angle = 0.01 * f64::from(k);
            let [c, s] = cos_sin(angle);
            assert!((c - angle.cos()).abs() < 3e-16 && (s - angle.sin()).abs() < 3e-16);
        }
    }

    /// Euler-Bernoulli: P L^3 / (3 E I), exact at the nodes for any number of elements.
    #[test]
    fn a_cantilever_deflects_as_euler_bernoulli() {
        for segments in [1, 2, 5, 20, 100] {
            let tip = load(&mut cantilever(segments), [0.0, 1.0], 0.0, 1);
            let wanted = 1.0 * LENGTH.powi(3) / (3.0 * EI);
            // Second order of a slope of 4e-4, and 1e-6 N of residual.
            assert!(
                (tip[1] / wanted - 1.0).abs() < 1e-5,
                "{segments} segments: {} against {wanted} mm",
                tip[1]
            );
        }
    }

    /// Elastica under a dead end load; P L^2 / (E I) = 1, 5, 10: Mattiasson (1981), Int. J. Numer. Meth. Eng. 17, 145.
    #[test]
    fn elastica_converges_with_the_square_of_the_mesh() {
        for (alpha, down, short) in [
            (1.0, 0.301_72, 0.056_43),
            (5.0, 0.713_79, 0.387_63),
            (10.0, 0.810_61, 0.555_00),
        ] {
            let mut last = f64::INFINITY;
            for segments in [5, 10, 40] {
                let tip = load(
                    &mut cantilever(segments),
                    [0.0, alpha * EI / LENGTH.powi(2)],
                    0.0,
                    10,
                );
                let error = (tip[1] / LENGTH - down)
                    .abs()
                    .max((1.0 - tip[0] / LENGTH - short).abs());
                assert!(
                    error < last,
                    "alpha {alpha}, {segments} segments: error {error:.1e} after {last:.1e}"
                );
                last = error.max(5e-6);
            }
            // Five printed digits, the mesh's 1/40 squared, and the leaf's own stretch of 1e-5.
            assert!(last < 5e-4, "alpha {alpha}: {last:.1e}");
        }
    }

    /// M = 2 pi E I / L bends the leaf to a full circle: its end is back at the clamp.
    #[test]
    fn an_end_moment_bends_the_leaf_to_a_circle() {
        for segments in [10, 20, 80] {
            let tip = load(
                &mut cantilever(segments),
                [0.0, 0.0],
                std::f64::consts::TAU * EI / LENGTH,
                20,
            );
            let miss = tip[0].hypot(tip[1]) / LENGTH;
            // Constant curvature, no shear: the angles of an element are exact and all chords are too short by the same
            // (1/24) (2 pi / n)^2, so the polygon still closes.
            assert!(
                miss < 1e-6 && (tip[2] - std::f64::consts::TAU).abs() < 1e-6,
                "{segments} segments: {miss:.1e} of the length, {} rad",
                tip[2]
            );
        }
    }
}
