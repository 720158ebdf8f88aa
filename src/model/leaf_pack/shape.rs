//! The state for drawing: place of each leaf, force and stick-slip state of each contact.
//!
//! Axes of the load frame: x sideways from the middle of the unloaded pack, y along the load, positive in the direction of
//! loading; the clamp's middle of leaf 1 is at (0, 0) when unloaded, the eyes at positive y.

use super::LeafPack;
use super::clamp::eye_of;
use super::mounting::Support;
use super::side::HalfPack;
use super::slip_law::SlipState;

/// A point of a leaf's middle line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Station {
    /// Place sideways, mm.
    pub x_mm: f64,
    /// Place along the load, mm.
    pub y_mm: f64,
    /// Direction of the middle line, rad.
    pub angle_rad: f64,
}

/// One leaf from its left end to its right end.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LeafShape {
    pub thickness_mm: f64,
    /// Points of the middle line, left to right.
    pub stations: Vec<Station>,
}

/// One contact between two leaves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ContactShape {
    /// Place, sideways, mm.
    pub x_mm: f64,
    /// Place along the load, mm.
    pub y_mm: f64,
    /// Index of the upper of the two leaves, from 0.
    pub upper_leaf: usize,
    /// Normal force, N; 0 where the leaves are apart.
    pub normal_n: f64,
    /// Friction force, N.
    pub friction_n: f64,
    /// Slip since assembly, mm.
    pub slip_mm: f64,
    /// Stick or slip at this state.
    pub state: SlipState,
}

/// The whole pack at one state.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PackShape {
    /// Leaves, first the one with the eyes.
    pub leaves: Vec<LeafShape>,
    /// Contacts of both sides.
    pub contacts: Vec<ContactShape>,
    /// Pin centres of the left and the right eye, mm.
    pub eyes_mm: [[f64; 2]; 2],
    /// Pivot of the shackle in the load frame, if there is one, mm.
    pub pivot_mm: Option<[f64; 2]>,
    /// Half of the clamped length, mm.
    pub clamp_half_mm: f64,
    /// Clamp's displacement along the load and sideways, mm.
    pub clamp_mm: [f64; 2],
    /// Displacement of the pusher from first contact, mm, and its force, N.
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
            Support::Shackle { pivot, .. } => Some(pivot),
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
        let [w, v] = self.clamp.settled;
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
            .zip(&side.states)
            .map(|(contact, &state)| {
                let (u, l) = (
                    side.nodes[contact.contact.upper],
                    side.nodes[contact.contact.lower],
                );
                let (x_mm, y_mm) = self.place(0.5 * (u[0] + l[0]), 0.5 * (u[1] + l[1]), sense);
                ContactShape {
                    x_mm,
                    y_mm,
                    upper_leaf: side.leaf_of[contact.contact.upper - side.fixed],
                    normal_n: contact.normal_n,
                    friction_n: contact.slider.force,
                    slip_mm: contact.slider.slip - contact.slip_start_mm,
                    state,
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
