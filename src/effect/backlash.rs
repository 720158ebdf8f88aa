//! Lost motion after a reversal.
//!
//! ```text
//! F(x) = F_in(y),  y = min(max(y, x - g / 2), x + g / 2)
//! ```
//! x: displacement, mm. y: displacement of the spring, mm. g: `gap_mm`. F_in: force of the plant inside, N.
//! The force stays constant for g of travel after each reversal.
//! Source: play operator, M. A. Krasnosel'skii and A. V. Pokrovskii, Systems with Hysteresis (1989).
//! Range: quasi-static. The impact when the gap closes is not included.

use super::wording::shown;
use super::{Axis, Branch, Effect, Kink, LookAlike, Place, Stage, Wrap, wrapped};
use crate::model::{Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "backlash",
    stage: Stage::Frame,
    follows_path: true,
    only_rival: false,
    parameters: &[Parameter {
        name: "gap_mm",
        unit: "mm",
        start: 0.1,
        bounds: [0.0, 20.0],
        belief: [0.0, 3.0],
        what: "travel after a reversal that does not move the specimen",
    }],
    neutral: &[0.0],
    amplitudes: &[],
    kinks: &[Kink::of(0, Axis::DisplacementMm)],
    shapes: &[],
    starts: |s| {
        [2e-4, 1e-3, 4e-3, 0.02]
            .map(|p| vec![(p * s.travel_mm()).clamp(0.003, 20.0)])
            .to_vec()
    },
    statement: |v| {
        format!(
            "After each reversal, {} mm of motion are lost before the force follows. Possible causes: play in an eye, in a pin or in the pusher guide.",
            shown(v[0], 3)
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
    plausible: super::always,
    confusable_with: &[
        LookAlike {
            code: "presliding",
            why: "both reduce the force change just after each reversal",
            test: "nested reversals of 0.2 to 2 mm: backlash ends at a fixed travel, presliding needs a travel that depends on the friction force",
        },
        LookAlike {
            code: "coulomb_friction",
            why: "backlash widens the loop by rate times gap, as a constant friction does",
            test: "reversals at two loads: backlash keeps its travel, friction keeps its force",
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
        // Gap 0.5 mm: 5 mm moves the spring to 4.75 mm. The first 0.4 mm of the way back do not move it.
        let mut plant = (EFFECT.attach)(&[0.5], spring());
        assert!((plant.step(5.0, 0.1) - 480.0).abs() < 1e-9);
        assert!((plant.step(4.6, 0.1) - 480.0).abs() < 1e-9);
        assert!((plant.step(4.0, 0.1) - 440.0).abs() < 1e-9);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[0.3]);
    }
}
