//! Lost contact: there is no force below a displacement.
//!
//! ```text
//! F = F_in(x - c) for x > c,  F = 0 for x <= c
//! ```
//! c: `contact_mm`, displacement of the first contact. x: displacement, mm. F_in: force of the plant inside, N.
//! The zero of the plant is the point of first contact, so its preload is the force at first contact. The spring keeps its
//! state while the pusher is away. At the neutral value the contact is never lost and the plant keeps its own zero.
//! A contact that closes softly, over a pad or at uneven points, has e = (u + sqrt(u^2 + w^2)) / 2 with u = x - c instead of u; w: `width_mm`.
//! Source: unilateral contact (Signorini). Range: quasi-static; impact and rebound are not included.

use super::{Axis, Branch, Effect, Kink, LookAlike, Place, Recorded, Stage, Wrap, wrapped};
use crate::model::{Parameter, Plant};

/// Contact displacement in mm that means: the contact is never lost.
const NEVER_MM: f64 = -1000.0;

/// Where the pusher does not touch the specimen, the force is at most this share of its range, because the zero of the channel is uncertain by
/// so much. Of 19 contacts in cases of five worlds that were looked at, it is 0.03 % at most before a zero is fitted, except for one that was
/// named far from its true place. Of 12 contacts that were named in packs and were not there, it is 0.2 % in one, and at least 0.6 % in the
/// others. At half, five cases that were run have the same answers; at double, one more of the 12 passes.
const MOST_FORCE: f64 = 2e-3;

/// Where the pusher does not touch, the force does not rise. The rise between the two lowest quarters below a contact may be this share of the
/// rise between the same lengths just above, and may be the noise. A zero of the channel changes no rise. The upper half is not judged: just
/// below a soft contact the force does rise. In packs that were looked at, the share was 0.02 at most for three contacts that were named
/// rightly, and 0.46 to 1.78 for six that were not there. At half, the same six are refused; at double, five of them.
const MOST_RISE: f64 = 0.3;

/// True if the recorded force rises below a displacement in mm, so that the pusher touches there.
fn rises_below(recorded: &Recorded<'_>, open_mm: f64) -> bool {
    let quarter_mm = 0.25 * (open_mm - recorded.span.displacement_mm[0]);
    let rise_n = |quarters_away: f64| {
        let force_n = |k: f64| {
            let from_mm = open_mm + (quarters_away + k) * quarter_mm;
            (recorded.force_n)([from_mm, from_mm + quarter_mm])
        };
        Some(force_n(1.0)? - force_n(0.0)?)
    };
    match (rise_n(-4.0), rise_n(0.0)) {
        (Some(below_n), Some(above_n)) => below_n > (MOST_RISE * above_n).max(recorded.noise_n),
        _ => false,
    }
}

/// The entry of [`super::EFFECTS`]. A contact that closes over a travel curves the characteristic as a stiffer specimen does. So no search
/// begins with it: it is compared with a curve that was named ([`super::RIVAL_LAWS`]).
pub(crate) const EFFECT: Effect = Effect {
    code: "lift_off",
    stage: Stage::Pusher,
    follows_path: true,
    only_rival: false,
    parameters: &[
        Parameter {
            name: "contact_mm",
            unit: "mm",
            start: NEVER_MM,
            bounds: [NEVER_MM, 1000.0],
            belief: [-50.0, 50.0],
            what: "displacement below which the pusher does not touch the specimen",
        },
        Parameter {
            name: "width_mm",
            unit: "mm",
            start: 0.0,
            bounds: [0.0, 20.0],
            belief: [0.0, 5.0],
            what: "travel over which the contact closes",
        },
    ],
    neutral: &[NEVER_MM, 0.0],
    amplitudes: &[],
    kinks: &[Kink::of(0, Axis::DisplacementMm)],
    shapes: &[],
    starts: |s| {
        let width_mm = (0.1 * s.travel_mm()).clamp(0.001, 20.0);
        [0.004, 0.03, 0.1, 0.25]
            .map(|share| vec![s.displacement_at(share), width_mm])
            .to_vec()
    },
    statement: |v| {
        format!(
            "The pusher touches the specimen from about {:.2} mm on. The contact closes softly, over about {:.2} mm.",
            v[0], v[1]
        )
    },
    attach: |v, inside| {
        wrapped(
            LiftOff {
                contact_mm: v[0],
                width_mm: v[1],
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
    // A contact that closes softly carries something below its middle, and none of it may be open in the recordings.
    plausible: |v, recorded| {
        let open_mm = v[0] - v.get(1).unwrap_or(&0.0);
        let most_n = MOST_FORCE * recorded.span.width(Axis::ForceN);
        let is_soft = v.len() > 1;
        let is_near_none = |force_n: f64| force_n.abs() <= most_n && !rises_below(recorded, open_mm);
        (recorded.force_below_n)(open_mm).map_or(is_soft, is_near_none)
    },
    confusable_with: &[LookAlike {
        code: "geometric_stiffness",
        why: "near zero load, a lost contact curves the start of the characteristic",
        test: "a slow ramp that starts 1 mm above the free height",
    }],
};

/// The contact that closes at once, which a search begins with ([`super::SIMPLEST_LAWS`]).
pub(super) const AT_ONCE: Effect = Effect {
    parameters: &[EFFECT.parameters[0]],
    neutral: &[NEVER_MM],
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
                width_mm: 0.0,
                away: false,
            },
            inside,
        )
    },
    ..EFFECT
};

#[derive(Clone)]
struct LiftOff {
    contact_mm: f64,
    /// Zero for a contact that closes at once.
    width_mm: f64,
    away: bool,
}

impl Wrap for LiftOff {
    fn reset(&mut self) {}

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        if self.contact_mm <= NEVER_MM {
            return inside.step(displacement_mm, dt_s);
        }
        let past_mm = displacement_mm - self.contact_mm;
        let pressed_mm = 0.5 * (past_mm + past_mm.hypot(self.width_mm));
        let force_n = inside.step(pressed_mm, dt_s);
        self.away = pressed_mm <= 0.0;
        if self.away { 0.0 } else { force_n }
    }

    fn carried_n(&self, inside_n: f64) -> f64 {
        if self.away { 0.0 } else { inside_n }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::*;
    use super::{AT_ONCE, EFFECT, Recorded};

    #[test]
    fn a_pusher_that_does_not_touch_measures_no_force() {
        // 40 N below the contact, of 2000 N: the pusher touches there.
        let touches = Recorded {
            force_below_n: &|mm| (mm > 0.0).then_some(40.0),
            ..ramp([20.0, 2000.0])
        };
        assert!(!(AT_ONCE.plausible)(&[0.3], &touches));
        assert!((AT_ONCE.plausible)(&[0.3], &ramp([20.0, 2000.0])));
        // Nothing was recorded where the soft contact is open.
        assert!((EFFECT.plausible)(&[0.3, 0.5], &touches));
    }

    /// A pack whose first leaf touches at 0.3 mm, and whose force at 0 is taken for a zero of the channel: 30 N/mm below, 60 above.
    #[test]
    fn a_force_that_rises_below_a_contact_is_no_zero() {
        let middle = |[from_mm, to_mm]: [f64; 2]| 0.5 * (from_mm + to_mm);
        let pack = |range: [f64; 2]| Some(30.0 * middle(range) + 30.0 * (middle(range) - 0.3).max(0.0));
        let contact = |range: [f64; 2]| Some(60.0 * (middle(range) - 0.3).max(0.0));
        // A pad that is pressed from 0.2 mm on.
        let pad = |range: [f64; 2]| Some(300.0 * (middle(range) - 0.2).max(0.0).powi(2));
        let plausible = |force_n| {
            (AT_ONCE.plausible)(
                &[0.3],
                &Recorded {
                    force_n,
                    ..ramp([20.0, 2000.0])
                },
            )
        };
        assert!(!plausible(&pack) && plausible(&contact) && plausible(&pad));
    }

    #[test]
    fn neutral_values_change_nothing() {
        neutral_changes_nothing(&AT_ONCE);
        neutral_changes_nothing(&EFFECT);
    }

    #[test]
    fn a_soft_contact_closes_over_its_width() {
        // At the first contact half of the width of 2 mm presses: 100 + 80 * 1 N. 10 mm beyond, (10 + sqrt(104)) / 2 mm press.
        let mut plant = (EFFECT.attach)(&[2.0, 2.0], spring());
        assert!((plant.step(2.0, 0.1) - 180.0).abs() < 1e-9);
        assert!((plant.step(12.0, 0.1) - (100.0 + 40.0 * (10.0 + 104f64.sqrt()))).abs() < 1e-9);
        // Where it closes at once it is the contact of the other law.
        let mut hard = (AT_ONCE.attach)(&[2.0], spring());
        let mut soft = (EFFECT.attach)(&[2.0, 0.001], spring());
        assert!((hard.step(5.0, 0.1) - soft.step(5.0, 0.1)).abs() < 1e-4);
    }

    #[test]
    fn force_by_hand() {
        let mut plant = (AT_ONCE.attach)(&[2.0], spring());
        assert_eq!(plant.step(1.9, 0.1), 0.0);
        assert!((plant.step(5.0, 0.1) - 340.0).abs() < 1e-9);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&AT_ONCE, &[2.0]);
    }
}
