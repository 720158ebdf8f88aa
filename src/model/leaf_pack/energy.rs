//! The books: work of the pusher, elastic energy, and what each source of friction took.

use super::LeafPack;
use super::mounting::{MountForce, PLACES, RAIL};
use super::newton::eye_of;

/// A source of friction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Source {
    /// Between leaves.
    Interleaf,
    /// Pins, in proportion to their load.
    Pin,
    /// Pins, constant torque.
    PivotTorque,
    /// Bearings on the rail, in proportion to their load.
    Rail,
    /// Bearings on the rail, constant.
    RailConstant,
    /// Pusher on the board.
    Board,
}

/// The books since the last reset, N mm. What is missing in work = stored + lost went into inertia and damping.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Energy {
    /// Done by the pusher.
    pub work_nmm: f64,
    /// Elastic energy beyond that of the assembled pack.
    pub stored_nmm: f64,
    /// Lost in friction, by [`Source`].
    pub dissipated_nmm: [f64; 6],
}

impl Energy {
    /// Lost in all sources together, N mm.
    pub(crate) fn lost_nmm(&self) -> f64 {
        self.dissipated_nmm.iter().sum()
    }

    /// Lost in one source, N mm.
    pub(crate) fn of(&self, source: Source) -> f64 {
        self.dissipated_nmm[source as usize]
    }

    pub(super) fn book(&mut self, source: Source, work_nmm: f64) {
        self.dissipated_nmm[source as usize] += work_nmm;
    }
}

impl LeafPack {
    /// Work, stored energy and losses since the last reset.
    pub(crate) fn energy(&self) -> Energy {
        Energy {
            stored_nmm: self.stored_nmm() - self.stored_at_start_nmm,
            ..self.energy
        }
    }

    /// Elastic energy of everything that gives, N mm.
    pub(super) fn stored_nmm(&self) -> f64 {
        let mut sum = 0.0;
        for (k, (side, mount)) in self.sides.iter().zip(&self.mounts).enumerate() {
            let eye = eye_of(side, self.eye, self.sense(k), self.frame.settled);
            sum += side.stored_nmm() + mount.evaluate(&eye, 1.0, &Default::default()).stored_nmm;
            for (place, slider) in mount.sliders.iter().enumerate() {
                sum += slider.stored_nmm(mount.law(place));
            }
        }
        let push = self.frame.pusher_n;
        self.copies * sum
            + 0.5 * push * push / self.structure.support_stiffness_n_per_mm
            + self.board.stored_nmm(self.slide_law)
    }

    /// Takes over the slips of a support after a converged step.
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
                (Source::Rail, Source::RailConstant)
            } else {
                (Source::Pin, Source::PivotTorque)
            };
            self.energy.book(by_load, work - constant);
            self.energy.book(fixed, constant);
        }
    }
}
