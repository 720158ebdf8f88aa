//! The whole pack as a plant: built, driven step by step, and never left without a finite force.

use super::assembly::clamped_side;
use super::band::V3;
use super::energy::{Energy, Source};
use super::friction::{Slider, SlipLaw};
use super::geometry::{FrictionChoice, Mounting, PackStructure};
use super::mounting::{Mount, MountForce, MountValues, Support};
use super::newton::{Frame, OuterGrip, eye_of};
use super::parameters::Values;
use super::side::{HalfPack, StepInfo};
use crate::model::Plant;

/// Residual at which a step has converged, N: some 1e-6 of the forces at work.
const TOLERANCE_N: f64 = 5e-4;
/// Most halvings of a step.
const HALVINGS: u32 = 9;
/// The path is resolved at least this finely, mm.
const LONGEST_STEP_MM: f64 = 1.0;
/// Farthest travel, as a share of the main leaf's length.
const REACH: f64 = 0.25;
/// Most parts of one step: a jump beyond is taken in coarser ones.
const MOST_PARTS: f64 = 300.0;

/// The leaf pack, ready to step.
#[derive(Debug, Clone)]
pub(crate) struct LeafPack {
    pub(super) structure: PackStructure,
    pub(super) values: Values,
    pub(super) sides: Vec<HalfPack>,
    pub(super) mounts: Vec<Mount>,
    /// Centre of the eye's pin in the frame of the last body, mm.
    pub(super) eye: [f64; 2],
    pub(super) frame: Frame,
    pub(super) board: Slider,
    pub(super) slide_law: SlipLaw,
    /// 2 where one side stands for both.
    pub(super) copies: f64,
    pub(super) step: StepInfo,
    pub(super) mount_forces: [MountForce; 2],
    pub(super) factor_grip: OuterGrip,
    pub(super) factors: bool,
    pub(super) factor_age: u32,
    pub(super) border_rows: [[V3; 2]; 2],
    pub(super) schur_inverse: [f64; 4],
    pub(super) last_increments_mm: [f64; 2],
    pub(super) energy: Energy,
    pub(super) stored_at_start_nmm: f64,
    pub(super) iterations: u64,
    pub(super) factorisations: u64,
    pub(super) tolerance_n: f64,
    pub(super) unconverged: u64,
    virgin: Box<(Vec<HalfPack>, Vec<Mount>)>,
    /// Pusher's travel from first touch of the unloaded pack, mm.
    travel_mm: f64,
    force_n: f64,
}

impl LeafPack {
    /// Assembles and clamps the pack and sets it on its mounting, at displacement 0.
    pub(crate) fn new(structure: &PackStructure, values: &Values) -> Result<Self, String> {
        structure.check()?;
        let side = clamped_side(structure, values)?;
        let eye = [0.0, structure.eye_offset_mm];
        let at = eye_of(&side, eye, 1.0, [0.0; 2]);
        let mirror = structure.mounting == Mounting::Rail && structure.mirror;
        let mount_values = mount_values(structure, values);
        let supports = match structure.mounting {
            Mounting::Rail => vec![Support::Rail { level: at[1] }; if mirror { 1 } else { 2 }],
            Mounting::Shackle => {
                let (sin, cos) = values.shackle_angle_rad.sin_cos();
                let length = structure.shackle_length_mm;
                let pivot = [at[0] + length * sin, at[1] + length * cos];
                vec![
                    Support::Shackle { pivot, length },
                    Support::Pin { at: [at[0], at[1]] },
                ]
            }
        };
        let mut mounts: Vec<Mount> = supports
            .into_iter()
            .map(|s| Mount::new(s, mount_values))
            .collect();
        for mount in &mut mounts {
            mount.relax(&at);
        }
        let sides = vec![side; mounts.len()];
        let mut pack = Self {
            structure: structure.clone(),
            values: *values,
            virgin: Box::new((sides.clone(), mounts.clone())),
            sides,
            mounts,
            eye,
            frame: Frame::default(),
            board: Slider::default(),
            slide_law: mount_values.slide_law,
            copies: if mirror { 2.0 } else { 1.0 },
            step: StepInfo {
                dt_s: 1.0,
                viscosity: 0.0,
                inertia: 0.0,
                frame_acceleration: [0.0; 2],
            },
            mount_forces: Default::default(),
            factor_grip: OuterGrip::default(),
            factors: false,
            factor_age: 0,
            border_rows: Default::default(),
            schur_inverse: [0.0; 4],
            last_increments_mm: [0.0; 2],
            energy: Energy::default(),
            stored_at_start_nmm: 0.0,
            iterations: 0,
            factorisations: 0,
            tolerance_n: TOLERANCE_N,
            unconverged: 0,
            travel_mm: 0.0,
            force_n: 0.0,
        };
        pack.set_tolerance_n(TOLERANCE_N);
        pack.start();
        Ok(pack)
    }

    /// What it was built from.
    pub(crate) fn structure(&self) -> &PackStructure {
        &self.structure
    }

    /// What it was built with.
    pub(crate) fn values(&self) -> &Values {
        &self.values
    }

    /// Steps since the last reset that did not converge even when halved, or went beyond any spring's reach: they end at the last equilibrium
    /// and its force.
    pub(crate) fn unconverged(&self) -> u64 {
        self.unconverged
    }

    /// Newton iterations and factorisations since the last reset.
    pub(crate) fn effort(&self) -> (u64, u64) {
        (self.iterations, self.factorisations)
    }

    /// Rigid segments of the whole pack.
    pub(crate) fn segments(&self) -> usize {
        let all: usize = self.sides.iter().map(|s| s.beams.len()).sum();
        if self.copies > 1.0 { 2 * all } else { all }
    }

    /// Sets the residual at which a step counts as converged, N (5e-4 unless set; never below what rounding leaves).
    pub(crate) fn set_tolerance_n(&mut self, tolerance_n: f64) {
        let rounding = self.sides.iter().map(HalfPack::rounding_n).fold(1e-9, f64::max);
        self.tolerance_n = tolerance_n.max(rounding);
    }

    /// Where the pusher is, mm: as given to the last step, unless that did not converge.
    pub(crate) fn displacement_mm(&self) -> f64 {
        self.travel_mm - self.values.preload_mm
    }

    /// Force of the pusher after the last step, N.
    pub(crate) fn force_n(&self) -> f64 {
        self.force_n
    }

    /// Clamp's displacement along the load and sideways, mm, from the unloaded pack.
    pub(crate) fn clamp_mm(&self) -> [f64; 2] {
        [self.frame.settled[1], self.frame.settled[0]]
    }

    fn start(&mut self) {
        self.frame = Frame::default();
        self.board = Slider::default();
        self.last_increments_mm = [0.0; 2];
        self.iterations = 0;
        self.factorisations = 0;
        self.unconverged = 0;
        self.factors = false;
        self.travel_mm = 0.0;
        self.force_n = 0.0;
        // The preload is ridden up to as any other motion, slowly; it is no part of the books.
        if self.values.preload_mm > 0.0 {
            self.travel(self.values.preload_mm, 10.0);
        } else {
            self.travel_mm = self.values.preload_mm;
        }
        for side in &mut self.sides {
            side.velocity.fill([0.0; 3]);
            side.acceleration.fill([0.0; 3]);
        }
        self.frame.velocity = [0.0; 2];
        self.frame.acceleration = [0.0; 2];
        self.energy = Energy::default();
        self.stored_at_start_nmm = self.stored_nmm();
    }

    /// Moves the pusher to `goal_mm` from first touch, in as many parts as the path asks for.
    pub(super) fn travel(&mut self, goal_mm: f64, dt_s: f64) {
        // Flat is at some 80 mm: beyond this the leaves would turn inside out and not come back.
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
                // The rest of the way would fail as well, and the caller has a clock to keep.
                self.unconverged += 1;
                return;
            }
            self.travel_mm = to;
        }
    }

    /// One step, halved where Newton's method fails. False if some part of it was given up.
    fn advance(&mut self, from: f64, to: f64, dt_s: f64, depth: u32) -> bool {
        if self.solve(to, to - from, dt_s, depth > 0) {
            self.commit(to - from);
            return true;
        }
        self.factors = false;
        for side in &mut self.sides {
            side.nodes.copy_from_slice(&side.settled);
        }
        self.frame.now = self.frame.settled;
        if depth >= HALVINGS {
            return false;
        }
        let middle = 0.5 * (from + to);
        let first = self.advance(from, middle, 0.5 * dt_s, depth + 1);
        // After a part that was given up, the rest is tried in one go only: the time is bounded.
        let rest = if first { depth + 1 } else { HALVINGS };
        self.advance(middle, to, 0.5 * dt_s, rest) && first
    }

    fn commit(&mut self, increment_mm: f64) {
        self.commit_motion();
        let mut interleaf = 0.0;
        for side in &mut self.sides {
            interleaf += side.commit(&self.step);
        }
        self.energy.book(Source::Interleaf, self.copies * interleaf);
        for k in 0..self.sides.len() {
            let force = self.mount_forces[k];
            self.commit_mount(k, &force);
        }
        let lost = self.board.dissipated_nmm;
        self.board
            .commit(self.slide_law, self.frame.now[0], self.frame.board.force);
        self.energy.book(Source::Board, self.board.dissipated_nmm - lost);
        self.frame.older = self.frame.before;
        self.frame.before = self.frame.settled;
        self.frame.settled = self.frame.now;
        self.energy.work_nmm += 0.5 * (self.force_n + self.frame.pusher_n) * increment_mm;
        self.force_n = self.frame.pusher_n;
        self.last_increments_mm = [increment_mm, self.last_increments_mm[0]];
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
        // A reading that is no number moves nothing.
        if displacement_mm.is_finite() && dt_s > 0.0 {
            self.travel(displacement_mm + self.values.preload_mm, dt_s);
        }
        self.force_n
    }

    fn boxed_clone(&self) -> Box<dyn Plant> {
        Box::new(self.clone())
    }
}

fn mount_values(structure: &PackStructure, values: &Values) -> MountValues {
    let velocity = structure.transition_velocity_mm_s;
    let (slide_law, turn_law) = match structure.friction_law {
        FrictionChoice::Presliding => (
            SlipLaw::Presliding(structure.tangential_stiffness_n_per_mm),
            SlipLaw::Presliding(structure.pin_stiffness_nmm_per_rad),
        ),
        FrictionChoice::Tanh => (
            SlipLaw::Tanh(velocity),
            SlipLaw::Tanh(velocity / structure.pin_radius_mm),
        ),
    };
    MountValues {
        stiffness: structure.support_stiffness_n_per_mm,
        rail_mu: values.rail_mu,
        rail_constant_n: values.rail_constant_n,
        pin_mu: values.pin_mu,
        pin_radius_mm: structure.pin_radius_mm,
        pivot_torque_nmm: values.pivot_torque_nmm,
        slide_law,
        turn_law,
    }
}
