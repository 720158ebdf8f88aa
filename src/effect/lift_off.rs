//! Lost contact: there is no force below a displacement.
//!
//! ```text
//! F = F_in(x - c) for x > c,  F = 0 for x <= c
//! ```
//! c: `contact_mm`, displacement of the first contact. x: displacement, mm. F_in: force of the plant inside, N.
//! The zero of the plant is the point of first contact, so its preload is the force at first contact. The spring keeps its
//! state while the pusher is away. At the neutral value the contact is never lost and the plant keeps its own zero.
//! Source: unilateral contact (Signorini). Range: quasi-static; impact and rebound are not included.

use super::{Axis, Branch, Effect, LookAlike, Place, Stage, Wrap, wrapped};
use crate::model::{Parameter, Plant};

/// Contact displacement in mm that means: the contact is never lost.
const NEVER_MM: f64 = -1000.0;

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "lift_off",
    stage: Stage::Pusher,
    follows_path: true,
    parameters: &[Parameter {
        name: "contact_mm",
        unit: "mm",
        start: NEVER_MM,
        bounds: [NEVER_MM, 1000.0],
        belief: [-50.0, 50.0],
        what: "displacement below which the pusher does not touch the specimen",
    }],
    neutral: &[NEVER_MM],
    amplitudes: &[],
    kinks: &[(0, Axis::DisplacementMm)],
    shapes: &[],
    starts: |s| {
        [0.004, 0.012, 0.03, 0.06, 0.1, 0.16, 0.25]
            .map(|p| vec![s.displacement_at(p)])
            .to_vec()
    },
    statement: |v| {
        format!(
            "Below {:.2} mm the pusher does not touch the specimen and there is no force.",
            v[0]
        )
    },
    attach: |v, inside| {
        wrapped(
            LiftOff {
                contact_mm: v[0],
                away: false,
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: |v, s| {
        (v[0] > s.displacement_mm[0]).then(|| Place {
            axis: Axis::DisplacementMm,
            from: s.displacement_mm[0],
            to: v[0].min(s.displacement_mm[1]),
            branch: Branch::Both,
        })
    },
    confusable_with: &[LookAlike {
        code: "geometric_stiffness",
        why: "near zero load, a lost contact curves the start of the characteristic",
        test: "a slow ramp that starts 1 mm above the free height",
    }],
};

#[derive(Clone)]
struct LiftOff {
    contact_mm: f64,
    away: bool,
}

impl Wrap for LiftOff {
    fn reset(&mut self) {}

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        if self.contact_mm <= NEVER_MM {
            return inside.step(displacement_mm, dt_s);
        }
        let force_n = inside.step((displacement_mm - self.contact_mm).max(0.0), dt_s);
        self.away = displacement_mm <= self.contact_mm;
        if self.away { 0.0 } else { force_n }
    }

    fn carried_n(&self, inside_n: f64) -> f64 {
        if self.away { 0.0 } else { inside_n }
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
        let mut plant = (EFFECT.attach)(&[2.0], spring());
        assert_eq!(plant.step(1.9, 0.1), 0.0);
        assert!((plant.step(5.0, 0.1) - 340.0).abs() < 1e-9);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[2.0]);
    }
}
