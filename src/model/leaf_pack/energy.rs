//! Energy balance: work of the pusher, elastic energy, and the energy that each source of friction dissipated.

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
