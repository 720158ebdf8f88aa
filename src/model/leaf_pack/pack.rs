//! The whole pack as a plant: built, driven step by step, always with a finite force. It has the entry in the list of models.
//!
//! A step whose equilibrium is not found ends at the last equilibrium and returns its force.

use super::assembly::clamped_side;
use super::band::V3;
use super::clamp::{Clamp, OuterStates, eye_of};
use super::energy::{Energy, FrictionSource};
use super::geometry::{Mounting, PackStructure};
use super::mounting::{Mount, MountForce, MountValues, PLACES, RAIL, Support};
use super::parameters::{PARAMETERS, Values};
use super::side::{HalfPack, StepInfo};
use super::slip_law::{Slider, SlipLaw};
use crate::model::{BuildError, Model, Plant};

/// Residual at which a step has converged, N: some 1e-6 of the forces in the pack.
const TOLERANCE_N: f64 = 5e-4;
/// Most halvings of a step that does not converge.
const HALVINGS: u32 = 9;
/// Longest part of a step that is solved at once, mm.
const LONGEST_STEP_MM: f64 = 1.0;
/// Greatest travel, as a share of the length of leaf 1.
const REACH: f64 = 0.25;
/// Most parts of one step: a longer jump has longer parts.
const MOST_PARTS: f64 = 300.0;

/// The leaf pack, ready to step.
#[derive(Debug, Clone)]
pub(crate) struct LeafPack {
    pub(super) structure: PackStructure,
    pub(super) values: Values,
    pub(super) sides: Vec<HalfPack>,
    pub(super) mounts: Vec<Mount>,
    /// Centre of the eye's pin in the axes of the last body, mm.
    pub(super) eye: [f64; 2],
    pub(super) clamp: Clamp,
    pub(super) board: Slider,
    pub(super) slide_law: SlipLaw,
    /// 2 where one side is solved for both, else 1.
    pub(super) copies: f64,
    pub(super) step: StepInfo,
    pub(super) mount_forces: [MountForce; 2],
    pub(super) factor_states: OuterStates,
    /// True while the factors of the last tangent can be used.
    pub(super) factors: bool,
    /// Steps since the last factorisation.
    pub(super) factor_age: u32,
    pub(super) border_rows: [[V3; 2]; 2],
    pub(super) schur_inverse: [f64; 4],
    pub(super) last_increments_mm: [f64; 2],
    pub(super) energy: Energy,
    pub(super) tolerance_n: f64,
    /// Steps since the last reset that did not converge or went beyond [`REACH`].
    unconverged: u64,
    virgin: Box<(Vec<HalfPack>, Vec<Mount>)>,
    /// Travel of the pusher from first contact with the unloaded pack, mm.
    travel_mm: f64,
    force_n: f64,
}

impl LeafPack {
    /// Assembles and clamps the pack and sets it on its mounting, at displacement 0.
    pub(crate) fn new(structure: &PackStructure, values: &Values) -> Result<Self, String> {
        structure.check()?;
        let side = clamped_side(structure, values)?;
        let eye = [0.0, structure.eye_offset_mm];
        let mounts = mounts_at(&eye_of(&side, eye, 1.0, [0.0; 2]), structure, values);
        let sides = vec![side; mounts.len()];
        let mut pack = Self {
            structure: structure.clone(),
            values: *values,
            virgin: Box::new((sides.clone(), mounts.clone())),
            sides,
            mounts,
            eye,
            clamp: Clamp::default(),
            board: Slider::default(),
            slide_law: structure.slide_law(),
            copies: if mirrored(structure) { 2.0 } else { 1.0 },
            step: StepInfo {
                dt_s: 1.0,
                viscosity: 0.0,
                inertia: 0.0,
                clamp_acceleration: [0.0; 2],
            },
            mount_forces: Default::default(),
            factor_states: OuterStates::default(),
            factors: false,
            factor_age: 0,
            border_rows: Default::default(),
            schur_inverse: [0.0; 4],
            last_increments_mm: [0.0; 2],
            energy: Energy::default(),
            tolerance_n: TOLERANCE_N,
            unconverged: 0,
            travel_mm: 0.0,
            force_n: 0.0,
        };
        pack.set_tolerance_n(TOLERANCE_N);
        pack.start();
        Ok(pack)
    }

    /// Sets the residual at which a step has converged, N (default 5e-4), but never below the rounding error.
    pub(crate) fn set_tolerance_n(&mut self, tolerance_n: f64) {
        let rounding = self.sides.iter().map(HalfPack::rounding_n).fold(1e-9, f64::max);
        self.tolerance_n = tolerance_n.max(rounding);
    }

    /// Displacement of the pusher, mm: that of the last step, unless the step did not converge.
    pub(crate) fn displacement_mm(&self) -> f64 {
        self.travel_mm - self.values.preload_mm
    }

    /// Force of the pusher after the last step, N.
    pub(crate) fn force_n(&self) -> f64 {
        self.force_n
    }

    /// Clamp's displacement along the load and sideways, mm, from the unloaded pack.
    pub(crate) fn clamp_mm(&self) -> [f64; 2] {
        [self.clamp.settled[1], self.clamp.settled[0]]
    }

    fn start(&mut self) {
        self.clamp = Clamp::default();
        self.board = Slider::default();
        self.last_increments_mm = [0.0; 2];
        self.unconverged = 0;
        self.factors = false;
        self.travel_mm = 0.0;
        self.force_n = 0.0;
        // The preload is reached by a slow motion that is not part of the energy balance.
        if self.values.preload_mm > 0.0 {
            self.travel(self.values.preload_mm, 10.0);
        } else {
            self.travel_mm = self.values.preload_mm;
        }
        for side in &mut self.sides {
            side.velocity.fill([0.0; 3]);
            side.acceleration.fill([0.0; 3]);
        }
        self.clamp.velocity = [0.0; 2];
        self.clamp.acceleration = [0.0; 2];
        self.energy = Energy::default();
    }

    /// Moves the pusher to `goal_mm` from first contact, in parts of at most [`LONGEST_STEP_MM`].
    pub(super) fn travel(&mut self, goal_mm: f64, dt_s: f64) {
        // The leaves are flat at some 80 mm. Far beyond that they would snap through and not come back.
        let reach_mm = REACH * self.structure.leaves[0].length_mm;
        if goal_mm > reach_mm {
            self.unconverged += 1;
        }
        let goal_mm = goal_mm.min(reach_mm);
        let from = self.travel_mm;
        let parts = ((goal_mm - from).abs() / LONGEST_STEP_MM)
            .ceil()
            .clamp(1.0, MOST_PARTS);
        let mut k = 0.0;
        while k < parts {
            k += 1.0;
            let to = from + (goal_mm - from) * k / parts;
            if !self.advance(self.travel_mm, to, dt_s / parts, 0) {
                // The rest of the path would also fail, and the caller waits in real time.
                self.unconverged += 1;
                return;
            }
            self.travel_mm = to;
        }
    }

    /// One step, halved where Newton's method fails. False if a part of it was skipped.
    fn advance(&mut self, from: f64, to: f64, dt_s: f64, depth: u32) -> bool {
        if self.solve(to, to - from, dt_s, depth > 0) {
            self.commit(to - from);
            return true;
        }
        self.factors = false;
        for side in &mut self.sides {
            side.nodes.copy_from_slice(&side.settled);
        }
        self.clamp.now = self.clamp.settled;
        if depth >= HALVINGS {
            return false;
        }
        let middle = 0.5 * (from + to);
        let first = self.advance(from, middle, 0.5 * dt_s, depth + 1);
        // After a skipped part the rest is tried once, without halving, so that the time is bounded.
        let rest = if first { depth + 1 } else { HALVINGS };
        self.advance(middle, to, 0.5 * dt_s, rest) && first
    }

    fn commit(&mut self, increment_mm: f64) {
        self.commit_motion();
        let mut interleaf = 0.0;
        for side in &mut self.sides {
            interleaf += side.commit(&self.step);
        }
        self.energy
            .add_loss(FrictionSource::Interleaf, self.copies * interleaf);
        for k in 0..self.sides.len() {
            let force = self.mount_forces[k];
            self.commit_mount(k, &force);
        }
        let lost = self.board.dissipated_nmm;
        self.board
            .commit(self.slide_law, self.clamp.now[0], self.clamp.board.force);
        self.energy
            .add_loss(FrictionSource::Board, self.board.dissipated_nmm - lost);
        self.clamp.older = self.clamp.before;
        self.clamp.before = self.clamp.settled;
        self.clamp.settled = self.clamp.now;
        self.energy.work_nmm += 0.5 * (self.force_n + self.clamp.pusher_n) * increment_mm;
        self.force_n = self.clamp.pusher_n;
        self.last_increments_mm = [increment_mm, self.last_increments_mm[0]];
    }

    /// Keeps the slips of a support after a converged step and adds their losses.
    fn commit_mount(&mut self, k: usize, force: &MountForce) {
        let mount = &mut self.mounts[k];
        for place in 0..PLACES {
            let law = mount.law(place);
            let slider = &mut mount.sliders[place];
            let before = slider.dissipated_nmm;
            slider.commit(law, force.slip[place], force.friction[place]);
            let work = self.copies * (slider.dissipated_nmm - before);
            let constant = work * force.constant_share[place];
            let (by_load, fixed) = if place == RAIL {
                (FrictionSource::Rail, FrictionSource::RailConstant)
            } else {
                (FrictionSource::Pin, FrictionSource::PivotTorque)
            };
            self.energy.add_loss(by_load, work - constant);
            self.energy.add_loss(fixed, constant);
        }
    }
}

impl Plant for LeafPack {
    fn reset(&mut self) {
        let (sides, mounts) = &*self.virgin;
        self.sides.clone_from(sides);
        self.mounts.clone_from(mounts);
        self.start();
    }

    fn step(&mut self, displacement_mm: f64, dt_s: f64) -> f64 {
        // A displacement that is not a finite number does not move the pusher.
        if displacement_mm.is_finite() && dt_s > 0.0 {
            self.travel(displacement_mm + self.values.preload_mm, dt_s);
        }
        self.force_n
    }

    fn boxed_clone(&self) -> Box<dyn Plant> {
        Box::new(self.clone())
    }
}

/// The entry of [`crate::model::MODELS`].
pub(crate) const MODEL: Model = Model {
    name: "leaf-pack",
    what: "leaves of rigid segments and beam elements, clamped with nip, in contact with friction (Kadziela et al. 2015)",
    parameters: PARAMETERS,
    physics: &[
        "rate_independent_friction",
        "load_dependent_friction",
        "coulomb_friction",
        "presliding",
        "progressive_stiffness",
        "geometric_stiffness",
        "lift_off",
    ],
    slow: true,
    friction_ratio: None,
    limit_friction: None,
    build,
};

fn build(values: &[f64], structure: &toml::Table) -> Result<Box<dyn Plant>, BuildError> {
    let refuse = |reason| BuildError::Structure {
        model: MODEL.name,
        reason,
    };
    let structure = PackStructure::from_table(structure).map_err(refuse)?;
    let values = Values::from_slice(values).ok_or_else(|| {
        refuse(format!(
            "{} values given for {} parameters: give one for each",
            values.len(),
            PARAMETERS.len()
        ))
    })?;
    Ok(Box::new(LeafPack::new(&structure, &values).map_err(refuse)?))
}

/// True where one side is solved for both.
fn mirrored(structure: &PackStructure) -> bool {
    structure.mounting == Mounting::Rail && structure.mirror
}

/// Supports of all solved sides with the unloaded eye at `eye`, without friction force.
fn mounts_at(eye: &V3, structure: &PackStructure, values: &Values) -> Vec<Mount> {
    let supports = match structure.mounting {
        Mounting::Rail => {
            let sides = if mirrored(structure) { 1 } else { 2 };
            vec![Support::Rail { level: eye[1] }; sides]
        }
        Mounting::Shackle => {
            let (sin, cos) = values.shackle_angle_rad.sin_cos();
            let length = structure.shackle_length_mm;
            let pivot = [eye[0] + length * sin, eye[1] + length * cos];
            vec![
                Support::Shackle { pivot, length },
                Support::Pin { at: [eye[0], eye[1]] },
            ]
        }
    };
    let mount_values = mount_values(structure, values);
    supports
        .into_iter()
        .map(|support| {
            let mut mount = Mount::new(support, mount_values);
            mount.relax(eye);
            mount
        })
        .collect()
}

fn mount_values(structure: &PackStructure, values: &Values) -> MountValues {
    let turn_velocity_rad_s = structure.transition_velocity_mm_s / structure.pin_radius_mm;
    MountValues {
        stiffness: structure.support_stiffness_n_per_mm,
        rail_mu: values.rail_mu,
        rail_constant_n: values.rail_constant_n,
        pin_mu: values.pin_mu,
        pin_radius_mm: structure.pin_radius_mm,
        pivot_torque_nmm: values.pivot_torque_nmm,
        slide_law: structure.slide_law(),
        turn_law: structure.slip_law(structure.pin_stiffness_nmm_per_rad, turn_velocity_rad_s),
    }
}

/// Figures of the solver for tests and benchmarks.
#[cfg(any(test, feature = "benchmarks"))]
impl LeafPack {
    /// Steps since the last reset that ended at the last equilibrium, because they did not converge even when halved or went
    /// beyond a quarter of the length of leaf 1.
    pub(crate) fn unconverged(&self) -> u64 {
        self.unconverged
    }

    /// Rigid segments of the whole pack, both sides.
    pub(crate) fn segments(&self) -> usize {
        let all: usize = self.sides.iter().map(|s| s.beams.len()).sum();
        if self.copies > 1.0 { 2 * all } else { all }
    }
}

#[cfg(test)]
impl LeafPack {
    /// Work and losses since the last reset.
    pub(crate) fn energy(&self) -> Energy {
        self.energy
    }

    /// Elastic energy beyond that after a reset, N mm.
    pub(crate) fn stored_nmm(&self) -> f64 {
        let mut start = self.clone();
        crate::model::Plant::reset(&mut start);
        self.elastic_nmm() - start.elastic_nmm()
    }

    /// Elastic energy of leaves, contacts, supports and pusher, N mm.
    fn elastic_nmm(&self) -> f64 {
        let mut sum = 0.0;
        for (k, (side, mount)) in self.sides.iter().zip(&self.mounts).enumerate() {
            let eye = eye_of(side, self.eye, self.sense(k), self.clamp.settled);
            sum += side.stored_nmm() + mount.stored_nmm(&eye);
        }
        let push = self.clamp.pusher_n;
        self.copies * sum
            + 0.5 * push * push / self.structure.support_stiffness_n_per_mm
            + self.board.stored_nmm(self.slide_law)
    }
}
