//! Lost motion at a reversal.
//!
//! ```text
//! F = F_in(y)                y follows x behind a play of gap_mm: it moves only while pushed by either side
//! ```
//! Source: play operator, M. A. Krasnosel'skii and A. V. Pokrovskii, Systems with Hysteresis (1989). The force stands
//! still for gap_mm of travel after each reversal.

use super::{Axis, Branch, Effect, LookAlike, Place, Stage, Wrap, wrapped};
use crate::model::{Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "backlash",
    stage: Stage::Frame,
    what: "lost motion at a reversal",
    parameters: &[Parameter {
        name: "gap_mm",
        unit: "mm",
        start: 0.1,
        bounds: [0.0, 20.0],
        belief: [0.0, 3.0],
        what: "travel without effect after a reversal",
    }],
    neutral: &[0.0],
    amplitudes: &[],
    kinks: &[(0, Axis::DisplacementMm)],
    starts: |s| {
        [2e-4, 1e-3, 4e-3, 0.02]
            .map(|p| vec![(p * s.travel_mm()).clamp(0.003, 20.0)])
            .to_vec()
    },
    statement: |v| {
        format!(
            "After each reversal {:.3} mm of motion are lost before the force follows: play in an eye, a pin or the pusher's guide.",
            v[0]
        )
    },
    attach: |v, inside| {
        wrapped(
            Backlash {
                half_mm: 0.5 * v[0],
                at_mm: 0.0,
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: |v, _| {
        Some(Place {
            axis: Axis::DistanceFromReversalMm,
            from: 0.0,
            to: v[0],
            branch: Branch::Both,
        })
    },
    confusable_with: &[
        LookAlike {
            code: "presliding",
            why: "both take force away after each reversal",
            test: "reversal nests of 0.2 to 2 mm: play is used up at a fixed travel, friction turns round over a travel that grows with its own strength",
        },
        LookAlike {
            code: "coulomb_friction",
            why: "a loop that is wider by rate times play has the shape of friction",
            test: "reversals at two loads: play keeps its travel, friction its force",
        },
    ],
};

#[derive(Clone)]
struct Backlash {
    half_mm: f64,
    at_mm: f64,
}

impl Wrap for Backlash {
    fn reset(&mut self) {
        self.at_mm = 0.0;
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        self.at_mm = self
            .at_mm
            .clamp(displacement_mm - self.half_mm, displacement_mm + self.half_mm);
        inside.step(self.at_mm, dt_s)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::*;
    use super::EFFECT;

    #[test]
    fn neutral_values_change_nothing() {
        neutral_changes_nothing(&EFFECT);
    }

    #[test]
    fn force_by_hand() {
        // 0.5 mm of play: 5 mm pushes the spring to 4.75, back by 0.4 leaves it there.
        let mut plant = (EFFECT.attach)(&[0.5], spring());
        assert!((plant.step(5.0, 0.1) - 480.0).abs() < 1e-9);
        assert!((plant.step(4.6, 0.1) - 480.0).abs() < 1e-9);
        assert!((plant.step(4.0, 0.1) - 440.0).abs() < 1e-9);
    }

    #[test]
    fn parameters_come_back_from_clean_data() {
        comes_back(&EFFECT, &[0.3]);
    }
}
