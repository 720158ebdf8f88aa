//! Energy balance: work of the pusher, elastic energy, and the energy that each source of friction dissipated.

use super::LeafPack;
use super::mounting::{MountForce, PLACES, RAIL};
#[cfg(test)]
use super::newton::eye_of;

/// A source of friction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FrictionSource {
    /// Contacts between leaves.
    Interleaf,
    /// Pins: the part of the torque in proportion to the load.
    Pin,
    /// Pins: the constant torque.
    PivotTorque,
    /// Bearings on the rail: the part in proportion to the load.
    Rail,
    /// Bearings on the rail: the constant force.
    RailConstant,
    /// Pusher on the board.
    Board,
}

/// Work and losses since the last reset, N mm. Work minus losses is elastic and kinetic energy and structural damping.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Energy {
    /// Work of the pusher.
    pub work_nmm: f64,
    /// Energy dissipated by friction, in the order of [`FrictionSource`].
    pub dissipated_nmm: [f64; 6],
}

impl Energy {
    pub(super) fn add_loss(&mut self, source: FrictionSource, work_nmm: f64) {
        self.dissipated_nmm[source as usize] += work_nmm;
    }
}

impl LeafPack {
    /// Keeps the slips of a support after a converged step and adds their losses.
    pub(super) fn commit_mount(&mut self, k: usize, force: &MountForce) {
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
