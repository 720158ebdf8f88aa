//! A law that was read off recordings: a force over one axis as a table, for physics that nobody has a formula for.
//!
//! ```text
//! F = F_in + s f(z)          or, per load,          F = F_in + s E f(z)
//! ```
//! f: the table, linear between its places and constant beyond its ends, N (a pure number per load). z: coordinate on the axis.
//! s: 1, or the drag of a contact over [`TURN_MM`], -1 to 1, where the force opposes the motion. E: load that the contacts carry,
//! N. F_in: force of the plant inside, N.
//! Source: additive model with one smooth term, Hastie and Tibshirani (1990). Range: what the recordings covered.

use super::motion::{Drag, Rates, Reversals};
use super::{Axis, Wrap, load_n, wrapped};
use crate::model::{Motion, Plant};

/// Travel after a reversal over which a force that opposes the motion changes its sign, mm.
const TURN_MM: f64 = 0.02;

/// A force over one axis. Places rise, both lists are of the same length.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceLaw {
    /// Axis that the force depends on.
    pub axis: Axis,
    /// True if the force opposes the motion, false if it is the same on both branches.
    pub opposes_motion: bool,
    /// True if the values are shares of the carried load, false if they are forces in N.
    pub per_load: bool,
    /// Places on the axis, in its unit.
    pub at: Vec<f64>,
    /// Force in N at each place, or force divided by load.
    pub force: Vec<f64>,
}

/// Why a law cannot be used.
#[derive(Debug, thiserror::Error, PartialEq)]
pub(crate) enum LawError {
    #[error("the law has {at} places and {force} values: give one value for each place, and at least two")]
    Count {
        /// Number of places.
        at: usize,
        /// Number of values.
        force: usize,
    },
    #[error("the places of the law do not rise at number {0}: sort them")]
    NotRising(usize),
    #[error("value number {0} of the law is not a finite number")]
    NotFinite(usize),
    #[error("a law over {0:?} cannot be stepped: use another axis")]
    Axis(Axis),
}

impl ForceLaw {
    /// Checks that the table can be stepped.
    pub(crate) fn check(&self) -> Result<(), LawError> {
        if self.at.len() != self.force.len() || self.at.len() < 2 {
            return Err(LawError::Count {
                at: self.at.len(),
                force: self.force.len(),
            });
        }
        let finite = self
            .at
            .iter()
            .zip(&self.force)
            .position(|(a, f)| !a.is_finite() || !f.is_finite());
        if let Some(i) = finite {
            return Err(LawError::NotFinite(i + 1));
        }
        if let Some(i) = self.at.windows(2).position(|w| w[1] <= w[0]) {
            return Err(LawError::NotRising(i + 2));
        }
        match self.axis {
            Axis::FrequencyHz | Axis::AccelerationMmS2 => Err(LawError::Axis(self.axis)),
            _ => Ok(()),
        }
    }

    /// Value of the table at a place.
    pub(crate) fn value(&self, place: f64) -> f64 {
        let above = self.at.partition_point(|at| *at <= place);
        if above == 0 {
            return self.force[0];
        }
        if above == self.at.len() {
            return self.force[above - 1];
        }
        let (low, high) = (self.at[above - 1], self.at[above]);
        let share = (place - low) / (high - low);
        self.force[above - 1] + share * (self.force[above] - self.force[above - 1])
    }

    /// A plant with this law around it.
    pub(crate) fn attached(&self, inside: Box<dyn Plant>) -> Result<Box<dyn Plant>, LawError> {
        self.check()?;
        Ok(wrapped(
            Lawful {
                law: self.clone(),
                rates: Rates::default(),
                drag: Drag::new(TURN_MM, 1.0),
                reversals: Reversals::default(),
                time_s: 0.0,
            },
            inside,
        ))
    }
}

#[derive(Clone)]
struct Lawful {
    law: ForceLaw,
    rates: Rates,
    drag: Drag,
    reversals: Reversals,
    time_s: f64,
}

impl Wrap for Lawful {
    fn reset(&mut self) {
        self.rates = Rates::default();
        self.drag.reset();
        self.reversals = Reversals::default();
        self.time_s = 0.0;
    }

    fn told(&mut self, motion: &Motion) {
        self.rates.tell(motion);
        self.drag.tell();
        self.reversals.tell(motion);
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        self.rates.step(displacement_mm, dt_s);
        self.reversals.step(displacement_mm);
        self.time_s += dt_s;
        let drag = self.drag.step(displacement_mm);
        let force_n = inside.step(displacement_mm, dt_s);
        let load_n = load_n(&**inside, force_n);
        let place = match self.law.axis {
            Axis::DisplacementMm => displacement_mm,
            Axis::ForceN => load_n,
            Axis::VelocityMmS => self.rates.velocity_mm_s.abs(),
            Axis::TimeS => self.time_s,
            Axis::Cycle => self.reversals.cycles() + 1.0,
            Axis::DistanceFromReversalMm => self.reversals.since_mm(displacement_mm),
            Axis::AccelerationMmS2 | Axis::FrequencyHz => 0.0,
        };
        let scale = if self.law.per_load { load_n } else { 1.0 };
        let sign = if self.law.opposes_motion { drag } else { 1.0 };
        force_n + sign * scale * self.law.value(place)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::*;
    use super::*;

    fn law(axis: Axis, opposes_motion: bool, per_load: bool) -> ForceLaw {
        ForceLaw {
            axis,
            opposes_motion,
            per_load,
            at: vec![0.0, 2.0, 4.0],
            force: vec![0.0, 10.0, 10.0],
        }
    }

    #[test]
    fn force_by_hand() {
        // The spring is 100 + 80 x. The table at 1 mm is 5 N, beyond its end 10 N.
        let mut plant = law(Axis::DisplacementMm, false, false)
            .attached(spring())
            .expect("sound");
        assert!((plant.step(1.0, 0.1) - 185.0).abs() < 1e-9);
        assert!((plant.step(9.0, 0.1) - 830.0).abs() < 1e-9);
        // Against the motion: minus on the way back.
        let mut plant = law(Axis::DisplacementMm, true, false)
            .attached(spring())
            .expect("sound");
        assert!((plant.step(3.0, 0.1) - 350.0).abs() < 1e-6);
        assert!((plant.step(1.0, 0.1) - 175.0).abs() < 1e-6);
        // Per load: 500 N times 10.
        let mut plant = law(Axis::DisplacementMm, false, true)
            .attached(spring())
            .expect("sound");
        assert!((plant.step(5.0, 0.1) - 11.0 * 500.0).abs() < 1e-6);
    }

    #[test]
    fn a_law_over_the_speed_uses_its_magnitude() {
        let mut plant = law(Axis::VelocityMmS, true, false)
            .attached(spring())
            .expect("sound");
        let up = (0..=20)
            .map(|i| plant.step(0.1 * f64::from(i), 0.1))
            .fold(0.0, |_, f| f);
        assert!((up - (100.0 + 160.0 + 5.0)).abs() < 0.05, "{up}");
    }

    #[test]
    fn a_law_that_cannot_be_stepped_is_refused() {
        let refused = |law: ForceLaw| law.check().expect_err("refused").to_string();
        let sound = law(Axis::TimeS, false, false);
        assert_eq!(sound.check(), Ok(()));
        let mut short = sound.clone();
        short.force.pop();
        assert!(refused(short).contains("3 places and 2 values"));
        let mut falls = sound.clone();
        falls.at[2] = 1.0;
        assert!(refused(falls).contains("number 3"));
        let mut gone = sound.clone();
        gone.force[1] = f64::NAN;
        assert!(refused(gone).contains("number 2"));
        assert!(refused(law(Axis::FrequencyHz, false, false)).contains("another axis"));
    }
}
