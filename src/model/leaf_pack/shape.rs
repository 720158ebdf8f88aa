//! The state for drawing: where each leaf lies, what presses where, what slides.
//!
//! World frame of the rig: x sideways from the middle of the unloaded pack, y along the load, positive downwards as the
//! pusher moves; the clamp's middle of leaf 1 is at (0, 0) when unloaded, the eyes at positive y.

use super::LeafPack;
use super::friction::Grip;
use super::newton::eye_of;
use super::side::HalfPack;

/// A station of a leaf's middle line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Station {
    /// Sideways, mm.
    pub x_mm: f64,
    /// Along the load, mm.
    pub y_mm: f64,
    /// Direction of the middle line, rad.
    pub angle_rad: f64,
}

/// One leaf from its left end to its right one.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LeafShape {
    /// Thickness, mm.
    pub thickness_mm: f64,
    /// Middle line.
    pub stations: Vec<Station>,
}

/// One contact between two leaves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ContactShape {
    /// Place, sideways, mm.
    pub x_mm: f64,
    /// Place along the load, mm.
    pub y_mm: f64,
    /// Upper of the two leaves, counted from 0.
    pub upper_leaf: usize,
    /// Normal force, N; 0 where the leaves are apart.
    pub normal_n: f64,
    /// Friction force, N.
    pub friction_n: f64,
    /// Slip since assembly, mm.
    pub slip_mm: f64,
    /// What it does now.
    pub grip: Grip,
}

/// The whole pack.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PackShape {
    /// Leaves from the one with the eyes on.
    pub leaves: Vec<LeafShape>,
    /// Contacts of both sides.
    pub contacts: Vec<ContactShape>,
    /// Pin centres, left and right.
    pub eyes_mm: [[f64; 2]; 2],
    /// Pivot of the shackle in the frame, if there is one.
    pub pivot_mm: Option<[f64; 2]>,
    /// Half of the clamped length, mm.
    pub clamp_half_mm: f64,
    /// Clamp's displacement along the load and sideways, mm.
    pub clamp_mm: [f64; 2],
    /// Pusher's displacement, mm, from first touch, and its force, N.
    pub pusher: [f64; 2],
}

impl LeafPack {
    /// The state after the last step.
    pub(crate) fn shape(&self) -> PackShape {
        let right = (0, 1.0);
        let left = (self.sides.len() - 1, -1.0);
        let leaves = (0..self.sides[0].fixed)
            .map(|leaf| {
                let mut stations: Vec<Station> = self.half_leaf(leaf, left.0, left.1);
                stations.reverse();
                stations.extend(self.half_leaf(leaf, right.0, right.1));
                let thickness_mm =
                    self.structure.leaves[leaf].thickness_mm + self.values.thickness_correction_mm;
                LeafShape {
                    thickness_mm,
                    stations,
                }
            })
            .collect();
        let mut contacts = self.half_contacts(left.0, left.1);
        contacts.extend(self.half_contacts(right.0, right.1));
        let pivot_mm = self.mounts.iter().find_map(|m| match m.support {
            super::mounting::Support::Shackle { pivot, .. } => Some(pivot),
            _ => None,
        });
        PackShape {
            leaves,
            contacts,
            eyes_mm: [self.eye_mm(left.0, left.1), self.eye_mm(right.0, right.1)],
            pivot_mm,
            clamp_half_mm: 0.5 * self.values.clamp_length_mm,
            clamp_mm: self.clamp_mm(),
            pusher: [self.displacement_mm() + self.values.preload_mm, self.force_n()],
        }
    }

    fn place(&self, x: f64, y: f64, sense: f64) -> (f64, f64) {
        let [w, v] = self.frame.settled;
        (sense * x + w, y + v)
    }

    fn half_leaf(&self, leaf: usize, side: usize, sense: f64) -> Vec<Station> {
        let side = &self.sides[side];
        let clamp = side.fixed - 1 - leaf;
        let bodies = (0..side.beams.len())
            .filter(|b| side.leaf_of[*b] == leaf)
            .map(|b| b + side.fixed);
        std::iter::once(clamp)
            .chain(bodies)
            .map(|n| {
                let [x, y, angle] = side.nodes[n];
                let (x_mm, y_mm) = self.place(x, y, sense);
                Station {
                    x_mm,
                    y_mm,
                    angle_rad: sense * angle,
                }
            })
            .collect()
    }

    fn half_contacts(&self, side: usize, sense: f64) -> Vec<ContactShape> {
        let side: &HalfPack = &self.sides[side];
        side.contacts
            .iter()
            .zip(&side.grip)
            .map(|(state, &grip)| {
                let (u, l) = (side.nodes[state.contact.upper], side.nodes[state.contact.lower]);
                let (x_mm, y_mm) = self.place(0.5 * (u[0] + l[0]), 0.5 * (u[1] + l[1]), sense);
                ContactShape {
                    x_mm,
                    y_mm,
                    upper_leaf: side.leaf_of[state.contact.upper - side.fixed],
                    normal_n: state.normal_n,
                    friction_n: state.slider.force,
                    slip_mm: state.slider.slip - state.slip_start_mm,
                    grip,
                }
            })
            .collect()
    }

    fn eye_mm(&self, side: usize, sense: f64) -> [f64; 2] {
        let [x, y, _] = eye_of(&self.sides[side], self.eye, 1.0, [0.0; 2]);
        let (x, y) = self.place(x, y, sense);
        [x, y]
    }
}
