//! Stiffness that rises beyond a deflection, as when a helper leaf touches.
//!
//! ```text
//! F = F_in + k u_0 (e(x - x_k) / u_0)^p + k_2 e(x - x_2) + k_3 e(x - x_3),  e(u) = (u + sqrt(u^2 + w^2)) / 2,  u_0 = 5 mm
//! ```
//! k: `extra_rate_n_per_mm`. x_k: `knee_mm`. w: `width_mm`, width of the knee. p: `exponent`. x: displacement, mm. F_in: force of the plant
//! inside, N. For w = 0 and p = 1 the first term is k max(0, x - x_k). k_2, x_2: a further leaf that touches, `second_rate_n_per_mm` and
//! `second_knee_mm`; none with a rate of 0. k_3, x_3: the same of a third, as in a pack of four leaves. Leaves that do not touch yet do not rub:
//! friction that is in proportion to the load counts the added force g times, `friction_gain`.
//! Source: bilinear stiffness of Polach and Hajzman, eq. 1, here as a force over displacement and with a hyperbolic knee.
//! A power above 1 is a contact that grows, as of a leaf that rolls onto the next or a rubber stop. Range: up to three knees; of the
//! friction of a model itself, which is inside, the gain changes nothing.

use super::power::power_of;
use super::{Axis, Branch, Effect, Kink, LookAlike, Place, Stage, Wrap, with_more_load, wrapped};
use crate::model::{Parameter, Plant};

/// Travel past the knee at which the added force is `extra_rate_n_per_mm` times the travel for every exponent, mm.
const REFERENCE_MM: f64 = 5.0;

/// Index of the first parameter of a further leaf.
const FURTHER: usize = 5;

/// Rate in N/mm and knee in mm of each further leaf.
fn further_of(values: &[f64]) -> impl Iterator<Item = [f64; 2]> {
    let given = values.get(FURTHER..).unwrap_or_default();
    given.chunks_exact(2).map(|leaf| [leaf[0], leaf[1]])
}

/// The same of every leaf that touches, the first included.
fn leaves_of(values: &[f64]) -> impl Iterator<Item = [f64; 2]> {
    let all = std::iter::once([values[0], values[1]]).chain(further_of(values));
    all.filter(|[rate, _]| *rate > 0.0)
}

/// A rate that a further leaf adds, and where it touches.
const fn further(names: [&'static str; 2]) -> [Parameter; 2] {
    [
        Parameter {
            name: names[0],
            unit: "N/mm",
            start: 0.0,
            bounds: [0.0, 1000.0],
            belief: [0.0, 150.0],
            what: "rate that a further leaf adds",
        },
        Parameter {
            name: names[1],
            unit: "mm",
            start: 5.0,
            bounds: [-1000.0, 1000.0],
            belief: [-100.0, 100.0],
            what: "displacement at which this leaf touches",
        },
    ]
}

const SECOND: [Parameter; 2] = further(["second_rate_n_per_mm", "second_knee_mm"]);
const THIRD: [Parameter; 2] = further(["third_rate_n_per_mm", "third_knee_mm"]);

/// Power of the travel from which a knee is no corner: over ten times the travel, the added rate changes by a quarter.
const NO_CORNER: f64 = 1.1;
/// At twice the width from a knee, the rate has all but 5 % of its turn behind it or ahead.
const KNEE: Kink = Kink {
    reach: |v| (v[3] < NO_CORNER).then_some(2.0 * v[2]),
    ..Kink::of(1, Axis::DisplacementMm)
};
const SECOND_KNEE: Kink = Kink { position: 6, ..KNEE };
const THIRD_KNEE: Kink = Kink { position: 8, ..KNEE };

/// A leaf that touches low in the travel adds at most this share of the rate above the knee: three times the rate below. What nearly begins
/// to be a spring there was not in contact before. Of 158 knees that were named in cases that were looked at, those of leaves added up to
/// 66 %, one beside a soft fixture 78 %; five contacts that close added 75 to 100 %. At half, more than a quarter of the leaves would be
/// contacts; at double, no knee is.
const MOST_OF_RATE: f64 = 0.75;
/// Share of the travel that is low: a bump stop near the end may well add nearly all of the rate. Those five contacts closed within the first
/// 3 %. At half or double, the same five are contacts.
const LOW_IN_THE_TRAVEL: f64 = 0.15;

/// The entry of [`super::EFFECTS`], with three knees of any width. A search begins with one ([`super::SIMPLEST_LAWS`]) and adds further ones
/// where they explain more ([`super::GROWN_LAWS`]).
pub(crate) const EFFECT: Effect = Effect {
    code: "progressive_stiffness",
    stage: Stage::Specimen,
    follows_path: true,
    only_rival: false,
    parameters: &[
        Parameter {
            name: "extra_rate_n_per_mm",
            unit: "N/mm",
            start: 5.0,
            bounds: [0.0, 1000.0],
            belief: [0.0, 150.0],
            what: "rate that is added beyond the knee",
        },
        Parameter {
            name: "knee_mm",
            unit: "mm",
            start: 5.0,
            bounds: [-1000.0, 1000.0],
            belief: [-100.0, 100.0],
            what: "displacement at which the helper leaf touches",
        },
        Parameter {
            name: "width_mm",
            unit: "mm",
            start: 0.3,
            bounds: [0.001, 5.0],
            belief: [0.001, 3.0],
            what: "width of the transition at the knee",
        },
        Parameter {
            name: "exponent",
            unit: "",
            start: 1.0,
            bounds: [1.0, 3.0],
            belief: [1.0, 3.0],
            what: "power of the travel beyond the knee: 1 for a constant added rate",
        },
        Parameter {
            name: "friction_gain",
            unit: "",
            start: 1.0,
            bounds: [1.0, 1000.0],
            belief: [1.0, 1000.0],
            what: "friction of the added force, in multiples of the friction that the same force has before the knee",
        },
        SECOND[0],
        SECOND[1],
        THIRD[0],
        THIRD[1],
    ],
    neutral: &[0.0, 5.0, 0.3, 1.0, 1.0, 0.0, 5.0, 0.0, 5.0],
    amplitudes: &[0, 5, 7],
    kinks: &[KNEE, SECOND_KNEE, THIRD_KNEE],
    shapes: &[3, 4],
    starts: |s| {
        PLACES
            .map(|p| {
                let knee_mm = s.displacement_at(p);
                vec![1.0, knee_mm, 0.2, 1.1, 1.1, 0.0, knee_mm, 0.0, knee_mm]
            })
            .to_vec()
    },
    statement: |v| {
        let mut knees: Vec<[f64; 2]> = leaves_of(v).collect();
        knees.sort_by(|a, b| a[1].total_cmp(&b[1]));
        let [first, others @ ..] = knees.as_slice() else {
            return "The spring is nowhere stiffer.".to_owned();
        };
        let others: String = others
            .iter()
            .map(|[rate, knee_mm]| format!(", beyond {knee_mm:.2} mm by another {rate:.1} N/mm"))
            .collect();
        let cause = match others.is_empty() {
            true => "a helper leaf touches there",
            false => "leaves touch one after the other",
        };
        format!(
            "Beyond {:.2} mm the spring is stiffer by {:.1} N/mm{others}. Possible cause: {cause}.",
            first[1], first[0]
        )
    },
    attach: |v, inside| {
        wrapped(
            ProgressiveStiffness {
                extra_rate_n_per_mm: v[0],
                knee_mm: v[1],
                width_mm: v[2],
                exponent: v[3],
                friction_gain: v.get(4).copied().unwrap_or(1.0),
                further: {
                    let mut leaves = further_of(v);
                    std::array::from_fn(|_| leaves.next())
                },
                extra_n: 0.0,
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: |v, s| {
        let further = further_of(v).filter(|[rate, _]| *rate > 0.0);
        let knee_mm = further.map(|[_, knee_mm]| knee_mm).fold(v[1], f64::min);
        (knee_mm < s.displacement_mm[1]).then(|| Place {
            axis: Axis::DisplacementMm,
            from: knee_mm.max(s.displacement_mm[0]),
            to: s.displacement_mm[1],
            branch: Branch::Both,
        })
    },
    plausible: |v, recorded| {
        let span = &recorded.span;
        let before = |knee_mm: f64| (knee_mm - span.displacement_mm[0]) / span.travel_mm();
        let mean_n_per_mm = span.width(Axis::ForceN) / span.travel_mm();
        let added: f64 = leaves_of(v)
            .map(|[rate, knee_mm]| rate * (1.0 - before(knee_mm)))
            .sum();
        let above_n_per_mm = |knee_mm: f64| {
            let up_to_it = leaves_of(v).filter(|[_, other_mm]| *other_mm <= knee_mm);
            mean_n_per_mm - added + up_to_it.map(|[rate, _]| rate).sum::<f64>()
        };
        leaves_of(v).all(|[rate, knee_mm]| {
            before(knee_mm) > LOW_IN_THE_TRAVEL || rate <= MOST_OF_RATE * above_n_per_mm(knee_mm)
        })
    },
    confusable_with: &[
        LookAlike {
            code: "geometric_stiffness",
            why: "within a short travel, a knee and a smooth curve look the same",
            test: "a slow ramp over the whole travel: a knee has a fixed position, a smooth curve continues",
        },
        LookAlike {
            code: "series_compliance",
            why: "a seat that closes under load stiffens the characteristic as a helper leaf does",
            test: "a second LVDT between board and frame: it measures the deformation of the seat",
        },
        LookAlike {
            code: "lift_off",
            why: "a contact that closes over a travel stiffens the characteristic as a helper leaf does",
            test: "a slow ramp that starts 1 mm above the free height",
        },
    ],
};

/// One knee, which a search begins with ([`super::SIMPLEST_LAWS`]): the friction of the added force is that of the rest.
pub(super) const ONE_KNEE: Effect = Effect {
    parameters: EFFECT.parameters.split_at(4).0,
    neutral: EFFECT.neutral.split_at(4).0,
    amplitudes: &[0],
    kinks: &[KNEE],
    shapes: &[3],
    starts: |s| PLACES.map(|p| vec![1.0, s.displacement_at(p), 0.2, 1.1]).to_vec(),
    ..EFFECT
};

/// One knee with friction of its own ([`super::GROWN_LAWS`]).
pub(super) const ONE_LEAF: Effect = Effect {
    parameters: EFFECT.parameters.split_at(5).0,
    neutral: EFFECT.neutral.split_at(5).0,
    amplitudes: &[0],
    kinks: &[KNEE],
    ..EFFECT
};

/// Width of the knees of leaves that touch one after the other: the tip of a leaf meets the next at once. Pieces of any width follow every
/// smooth curve.
const SHARP: Parameter = Parameter {
    bounds: [0.001, 0.5],
    ..EFFECT.parameters[2]
};
/// Power of the travel beyond each of these knees: a leaf that bears has a constant rate.
const STRAIGHT: Parameter = Parameter {
    bounds: [1.0, 1.0],
    ..EFFECT.parameters[3]
};

/// Two leaves that touch ([`super::GROWN_LAWS`]).
pub(super) const TWO_LEAVES: Effect = Effect {
    parameters: THREE_LEAVES.parameters.split_at(7).0,
    neutral: EFFECT.neutral.split_at(7).0,
    amplitudes: &[0, 5],
    kinks: &[KNEE, SECOND_KNEE],
    shapes: &[4],
    ..EFFECT
};

/// Three leaves that touch ([`super::GROWN_LAWS`]).
pub(super) const THREE_LEAVES: Effect = Effect {
    parameters: &[
        EFFECT.parameters[0],
        EFFECT.parameters[1],
        SHARP,
        STRAIGHT,
        EFFECT.parameters[4],
        SECOND[0],
        SECOND[1],
        THIRD[0],
        THIRD[1],
    ],
    neutral: EFFECT.neutral,
    amplitudes: EFFECT.amplitudes,
    kinks: EFFECT.kinks,
    shapes: &[4],
    ..EFFECT
};

/// A further knee alone ([`super::PARTS`]).
pub(super) const FURTHER_KNEE: Effect = Effect {
    parameters: &SECOND,
    neutral: &[0.0, 5.0],
    amplitudes: &[0],
    kinks: &[Kink::of(1, Axis::DisplacementMm)],
    shapes: &[],
    starts: |s| {
        let low = LOW_PLACES.iter();
        low.chain(&PLACES)
            .map(|p| vec![1.0, s.displacement_at(*p)])
            .collect()
    },
    attach: |v, inside| (ONE_KNEE.attach)(&[v[0], v[1], 0.2, 1.0], inside),
    place: |v, s| {
        (v[1] < s.displacement_mm[1]).then(|| Place {
            axis: Axis::DisplacementMm,
            from: v[1].max(s.displacement_mm[0]),
            to: s.displacement_mm[1],
            branch: Branch::Both,
        })
    },
    ..EFFECT
};

/// Shares of the recorded range where a search begins with a knee.
const PLACES: [f64; 8] = [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9];
/// Where a further knee begins, too: the first leaves of packs touch at 2 to 15 % of the travel.
const LOW_PLACES: [f64; 3] = [0.03, 0.06, 0.12];

#[derive(Clone)]
struct ProgressiveStiffness {
    extra_rate_n_per_mm: f64,
    knee_mm: f64,
    width_mm: f64,
    exponent: f64,
    friction_gain: f64,
    /// Rate in N/mm and knee in mm of each further leaf that touches.
    further: [Option<[f64; 2]>; 2],
    extra_n: f64,
}

impl ProgressiveStiffness {
    fn engaged_mm(&self, past_mm: f64) -> f64 {
        0.5 * (past_mm + (past_mm * past_mm + self.width_mm * self.width_mm).sqrt())
    }
}

impl Wrap for ProgressiveStiffness {
    fn reset(&mut self) {}

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let engaged_mm = self.engaged_mm(displacement_mm - self.knee_mm);
        self.extra_n =
            self.extra_rate_n_per_mm * REFERENCE_MM * power_of(engaged_mm / REFERENCE_MM, self.exponent);
        for [rate_n_per_mm, knee_mm] in self.further.into_iter().flatten() {
            self.extra_n += rate_n_per_mm * self.engaged_mm(displacement_mm - knee_mm);
        }
        let force_n = inside.step(displacement_mm, dt_s);
        with_more_load(&**inside, force_n, self.extra_n)
    }

    fn carried_n(&self, inside_n: f64) -> f64 {
        inside_n + self.extra_n
    }

    fn pressing_n(&self, inside_n: f64) -> f64 {
        inside_n + self.friction_gain * self.extra_n
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::*;
    use super::{EFFECT, ONE_KNEE, ONE_LEAF};

    #[test]
    fn neutral_values_change_nothing() {
        neutral_changes_nothing(&EFFECT);
    }

    #[test]
    fn force_by_hand() {
        // 3 mm past a knee of 4 mm width, 10 N/mm: 10 * (3 + 5) / 2 = 40 N over the spring.
        let mut plant = (ONE_KNEE.attach)(&[10.0, 2.0, 4.0, 1.0], spring());
        assert!((plant.step(5.0, 0.1) - 540.0).abs() < 1e-9);
        // The same with two leaves of 1.5 and 0.5 N/mm that touch there, too.
        let mut plant = (EFFECT.attach)(&[10.0, 2.0, 4.0, 1.0, 1.0, 1.5, 2.0, 0.5, 2.0], spring());
        assert!((plant.step(5.0, 0.1) - 548.0).abs() < 1e-9);
    }

    #[test]
    fn a_leaf_that_touches_rubs_more_than_one_that_does_not() {
        // 3 mm past the knee: the spring has 500 N, the leaf 30 N, which the friction of 0.1 counts 4 times.
        let pack = || (ONE_LEAF.attach)(&[10.0, 2.0, 0.001, 1.0, 4.0], spring());
        let friction = crate::effect::load_dependent_friction::EFFECT;
        let mut rubbed = (friction.attach)(&[0.1, 0.1, 1.0], pack());
        for displacement_mm in [3.0, 4.0] {
            rubbed.step(displacement_mm, 0.1);
        }
        let force_n = rubbed.step(5.0, 0.1);
        let by_hand_n = 530.0 + 0.1 * (500.0 + 4.0 * 30.0);
        assert!((force_n - by_hand_n).abs() < 1e-3, "{force_n}");
    }

    #[test]
    fn a_leaf_leaves_a_spring_below_its_knee_and_a_contact_that_closes_does_not() {
        // 3080 N over 22 mm: 140 N/mm in the mean.
        let recorded = ramp([22.0, 3080.0]);
        let plausible =
            |added_n_per_mm, knee_mm| (ONE_KNEE.plausible)(&[added_n_per_mm, knee_mm, 0.2, 1.0], &recorded);
        assert!(plausible(100.0, 1.1) && !plausible(120.0, 1.1));
        // Three leaves: with 30 N/mm more from 1.1 mm on, 52 N/mm are left below it; with 75 more, 9.
        let leaves = |second_n_per_mm| {
            let values = [100.0, 12.0, 0.2, 1.0, 1.0, second_n_per_mm, 1.1, 20.0, 6.0];
            (EFFECT.plausible)(&values, &recorded)
        };
        assert!(leaves(30.0) && !leaves(75.0));
        // A bump stop: 50 N/mm up to 18 mm, then 550.
        assert!(plausible(500.0, 18.0));
    }

    #[test]
    fn the_sentence_names_each_leaf_that_touches() {
        let said = (EFFECT.statement)(&[10.0, 6.0, 0.3, 1.0, 1.0, 5.0, 2.0]);
        assert!(
            said.starts_with(
                "Beyond 2.00 mm the spring is stiffer by 5.0 N/mm, beyond 6.00 mm by another 10.0 N/mm."
            ),
            "{said}"
        );
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&ONE_KNEE, &[12.0, 7.0, 0.4, 1.3]);
    }
}
