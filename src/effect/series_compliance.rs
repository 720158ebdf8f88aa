//! Compliance of load frame, board or fixture between specimen and LVDT.
//!
//! ```text
//! F = F_in(x - C F)
//! ```
//! C: `compliance_mm_per_kn` / 1000, mm/N. x: displacement, mm. F_in: force of the plant inside, N. Each step solves this
//! equation on copies of the plant inside: two secant steps, then within a bracket if they have not met it.
//! A joint that closes deforms by C (F - s (e(F - F_c) - e(-F_c))) with e(u) = (u + sqrt(u^2 + w^2)) / 2: a gap or a soft layer is closed
//! at a force. F_c: `closes_at_n`. w: `width_n`. s: `closed_share`, 0 for a linear joint.
//! Where F_in jumps (dry friction that reverses at once, or that reverses after the noise band of a LVDT), no displacement of the
//! specimen meets the equation. The specimen then sticks before the jump, and F is what the compliance carries.
//! Source: two springs in series. Range: massless fixture. With a linear spring inside, a linear joint only
//! lowers the rate and no recording can show it.

use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Parameter, Plant};

/// The entry of [`super::EFFECTS`]. A joint that closes curves the characteristic as a stiffer specimen does. So no search begins with it: it
/// is compared with a curve that was named ([`super::RIVAL_LAWS`]).
pub(crate) const EFFECT: Effect = Effect {
    code: "series_compliance",
    stage: Stage::Frame,
    follows_path: true,
    only_rival: false,
    parameters: &[
        Parameter {
            name: "compliance_mm_per_kn",
            unit: "mm/kN",
            start: 0.1,
            bounds: [0.0, 50.0],
            belief: [0.0, 5.0],
            what: "deformation of the fixture for each kN",
        },
        Parameter {
            name: "closes_at_n",
            unit: "N",
            start: 500.0,
            bounds: [1.0, 100_000.0],
            belief: [5.0, 50_000.0],
            what: "force at which a gap or a soft layer in the fixture is closed",
        },
        Parameter {
            name: "width_n",
            unit: "N",
            start: 100.0,
            bounds: [1.0, 100_000.0],
            belief: [1.0, 50_000.0],
            what: "range of force over which it closes",
        },
        Parameter {
            name: "closed_share",
            unit: "",
            start: 0.0,
            bounds: [0.0, 0.98],
            belief: [0.0, 0.98],
            what: "share of the compliance that is gone when it has closed",
        },
    ],
    neutral: &[0.0, 500.0, 100.0, 0.0],
    amplitudes: &[0],
    kinks: &[],
    shapes: &[],
    starts: |s| {
        let force_n = |share: f64| (share * s.force_n[1]).clamp(1.0, 100_000.0);
        [[0.15, 0.1], [0.4, 0.1], [0.3, 0.5]]
            .map(|[at, width]| vec![0.05, force_n(at), force_n(width), 0.8])
            .to_vec()
    },
    statement: |v| {
        format!(
            "A part between specimen and LVDT deforms by {:.3} mm for each kN. From about {:.0} N on it is closed and deforms by {:.3} mm for each \
             kN. Possible causes: load frame, board or fixture.",
            v[0],
            v[1],
            v[0] * (1.0 - v[3])
        )
    },
    attach: |v, inside| wrapped(SeriesCompliance::of(FixtureJoint::of(v)), inside),
    if_known: super::unchanged,
    place: everywhere,
    plausible: |v, recorded| {
        let joint = if v.len() == 1 {
            FixtureJoint::linear(v[0])
        } else {
            FixtureJoint::of(v)
        };
        let span = &recorded.span;
        let [from_mm, to_mm] = span.force_n.map(|force_n| joint.deformation_mm(force_n));
        to_mm - from_mm <= MOST_OF_TRAVEL * span.travel_mm()
    },
    confusable_with: &[
        LookAlike {
            code: "geometric_stiffness",
            why: "a seat that deforms curves the characteristic as geometry does",
            test: "a second LVDT between board and frame: it measures the deformation of the seat",
        },
        LookAlike {
            code: "progressive_stiffness",
            why: "a seat that closes under load stiffens the characteristic as a helper leaf does",
            test: "a second LVDT between board and frame: it measures the deformation of the seat",
        },
    ],
};

/// A fixture takes at most this share of the travel that the LVDT sees: a softer one is seen to move, and it changes a recording as another
/// friction law does. Of 33 compliances of sealed cases of five worlds, all took less (14 % at most); of 13 linear ones that were named and
/// were not there, nine took 17 to 48 %. At half, four that are there would not be named; at double, five of the nine would.
const MOST_OF_TRAVEL: f64 = 0.15;

/// The linear joint, which a search begins with ([`super::SIMPLEST_LAWS`]).
pub(super) const LINEAR: Effect = Effect {
    parameters: &[EFFECT.parameters[0]],
    neutral: &[0.0],
    starts: |_| vec![vec![0.05]],
    statement: |v| {
        format!(
            "A part between specimen and LVDT deforms by {:.3} mm for each kN. Possible causes: load frame, board or fixture.",
            v[0]
        )
    },
    attach: |v, inside| wrapped(SeriesCompliance::of(FixtureJoint::linear(v[0])), inside),
    ..EFFECT
};

/// Deformation over force of what is between specimen and LVDT.
#[derive(Clone, Copy)]
struct FixtureJoint {
    /// Compliance at small forces; of [`JointLaw::Closes`], far below the force at which it closes.
    mm_per_n: f64,
    law: JointLaw,
}

/// How the compliance of a joint changes with the force. Forces in N.
#[derive(Clone, Copy)]
enum JointLaw {
    Linear,
    Closes { at_n: f64, width_n: f64, share: f64 },
}

impl FixtureJoint {
    /// From the parameters of the effect.
    fn of(values: &[f64]) -> FixtureJoint {
        if values[3] == 0.0 {
            return FixtureJoint::linear(values[0]);
        }
        FixtureJoint {
            mm_per_n: 1e-3 * values[0],
            law: JointLaw::Closes {
                at_n: values[1],
                width_n: values[2],
                share: values[3],
            },
        }
    }

    fn linear(mm_per_kn: f64) -> FixtureJoint {
        FixtureJoint {
            mm_per_n: 1e-3 * mm_per_kn,
            law: JointLaw::Linear,
        }
    }

    fn deformation_mm(&self, force_n: f64) -> f64 {
        self.mm_per_n
            * match self.law {
                JointLaw::Linear => force_n,
                JointLaw::Closes { at_n, width_n, share } => {
                    force_n - share * (corner(force_n - at_n, width_n) - corner(-at_n, width_n))
                }
            }
    }

    /// Slope of the deformation over the force.
    fn slope_mm_per_n(&self, force_n: f64) -> f64 {
        self.mm_per_n
            * match self.law {
                JointLaw::Linear => 1.0,
                JointLaw::Closes { at_n, width_n, share } => {
                    let past_n = force_n - at_n;
                    1.0 - 0.5 * share * (1.0 + past_n / past_n.hypot(width_n))
                }
            }
    }

    /// Force in N at a deformation.
    fn force_n(&self, deformation_mm: f64) -> f64 {
        let linear_n = deformation_mm / self.mm_per_n;
        match self.law {
            JointLaw::Linear => linear_n,
            JointLaw::Closes { at_n, width_n, share } => {
                // The corner squared away: ((1 - s / 2) u - r)^2 = (s / 2)^2 (u^2 + w^2), whose larger root has the sign of the corner.
                let half = 0.5 * share;
                let right_n = linear_n - at_n - share * corner(-at_n, width_n);
                let (a, b) = (1.0 - share, (1.0 - half) * right_n);
                let c = right_n * right_n - (half * width_n).powi(2);
                at_n + (b + (b * b - a * c).max(0.0).sqrt()) / a
            }
        }
    }
}

/// Rises from 0 with a corner of a width at 0, then in proportion: the hyperbola.
fn corner(u: f64, width: f64) -> f64 {
    0.5 * (u + u.hypot(width))
}

/// Secant steps of every solution. The number is fixed, because a convergence test that decides at every point would make the
/// derivatives of a fit discontinuous.
const SECANT_STEPS: usize = 2;
/// Most steps of a solution: 40 bisections shorten a bracket of 1 mm to less than the tolerance.
const MOST_STEPS: usize = 44;
/// A solution is met to this displacement in mm: a millionth of what a LVDT resolves.
const TOLERANCE_MM: f64 = 1e-8;
/// Smallest distance in mm of two displacements that a rate is computed from; below it rounding counts.
const LEAST_CHORD_MM: f64 = 1e-7;

#[derive(Clone)]
struct SeriesCompliance {
    joint: FixtureJoint,
    force_n: f64,
    specimen_mm: f64,
    rate_n_per_mm: f64,
    trials: Trials,
}

/// The plant that the last trial was made on. Its state does not matter before a trial, so no copy of the compliance has it.
#[derive(Default)]
struct Trials(Option<Box<dyn Plant>>);

impl Clone for Trials {
    fn clone(&self) -> Self {
        Trials(None)
    }
}

/// A trial of the equation.
#[derive(Clone, Copy)]
struct Trial {
    /// Displacement of the specimen.
    specimen_mm: f64,
    /// Force of the plant inside there.
    force_n: f64,
    /// What the specimen would have to move further, mm. It falls as the specimen moves.
    short_mm: f64,
}

impl SeriesCompliance {
    fn of(joint: FixtureJoint) -> SeriesCompliance {
        SeriesCompliance {
            joint,
            force_n: 0.0,
            specimen_mm: 0.0,
            rate_n_per_mm: 100.0,
            trials: Trials::default(),
        }
    }

    /// Trials on both sides of the solution, `None` on a side where there was none, and the last one.
    fn solve(
        &mut self,
        displacement_mm: f64,
        mut force_at: impl FnMut(f64) -> f64,
    ) -> ([Option<Trial>; 2], Trial) {
        let joint = self.joint;
        let mut trial = |specimen_mm: f64| {
            let force_n = force_at(specimen_mm);
            Trial {
                specimen_mm,
                force_n,
                short_mm: displacement_mm - joint.deformation_mm(force_n) - specimen_mm,
            }
        };
        // Share of the displacement step that reaches the specimen, from the last known rate.
        let share = 1.0 / (1.0 + joint.slope_mm_per_n(self.force_n) * self.rate_n_per_mm);
        let step_mm = displacement_mm - joint.deformation_mm(self.force_n) - self.specimen_mm;
        let mut last = trial(self.specimen_mm + share * step_mm);
        let mut bracket = [None, None];
        for step in 0..MOST_STEPS {
            bracket[usize::from(last.short_mm < 0.0)] = Some(last);
            let width_mm = width_mm(bracket);
            if step >= SECANT_STEPS && (last.short_mm.abs() < TOLERANCE_MM || width_mm < TOLERANCE_MM) {
                break;
            }
            let slope_mm_per_n = joint.slope_mm_per_n(last.force_n);
            let secant_mm = last.specimen_mm + last.short_mm / (1.0 + slope_mm_per_n * self.rate_n_per_mm);
            let next_mm = match bracket {
                _ if step < SECANT_STEPS => secant_mm,
                // Bisections between the secants: a jump within the bracket misleads every secant.
                [Some(low), Some(high)] if step % 2 == 0 || !between(secant_mm, low, high) => {
                    0.5 * (low.specimen_mm + high.specimen_mm)
                }
                [Some(_), Some(_)] => secant_mm,
                // The force rises with the displacement, so a step by all that is missing is too long.
                _ => last.specimen_mm + last.short_mm,
            };
            let next = trial(next_mm);
            let chord_mm = next.specimen_mm - last.specimen_mm;
            let rate_n_per_mm = (next.force_n - last.force_n) / chord_mm;
            if rate_n_per_mm.is_finite() && rate_n_per_mm > 0.0 && chord_mm.abs() > LEAST_CHORD_MM {
                self.rate_n_per_mm = rate_n_per_mm;
            }
            last = next;
        }
        (bracket, last)
    }
}

fn between(specimen_mm: f64, low: Trial, high: Trial) -> bool {
    specimen_mm > low.specimen_mm && specimen_mm < high.specimen_mm
}

/// Width of a bracket in mm; infinite where a side is open.
fn width_mm(bracket: [Option<Trial>; 2]) -> f64 {
    match bracket {
        [Some(low), Some(high)] => (high.specimen_mm - low.specimen_mm).abs(),
        _ => f64::INFINITY,
    }
}

impl Wrap for SeriesCompliance {
    fn reset(&mut self) {
        self.force_n = 0.0;
        self.specimen_mm = 0.0;
        self.rate_n_per_mm = 100.0;
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        if self.joint.mm_per_n <= 0.0 {
            return inside.step(displacement_mm, dt_s);
        }
        let mut trial = self.trials.0.take().unwrap_or_else(|| inside.boxed_clone());
        let (bracket, last) = self.solve(displacement_mm, |x| {
            inside.copy_to(&mut trial);
            trial.step(x, dt_s)
        });
        match bracket {
            [Some(low), Some(high)] if last.short_mm.abs() > TOLERANCE_MM => {
                // A jump: the specimen stays on the side that it comes from.
                let from_below =
                    (self.specimen_mm - low.specimen_mm).abs() <= (self.specimen_mm - high.specimen_mm).abs();
                self.specimen_mm = if from_below { low } else { high }.specimen_mm;
                inside.step(self.specimen_mm, dt_s);
                let carried_n = self.joint.force_n(displacement_mm - self.specimen_mm);
                self.force_n = carried_n.clamp(low.force_n.min(high.force_n), low.force_n.max(high.force_n));
            }
            _ => {
                // The last trial was this step.
                std::mem::swap(inside, &mut trial);
                self.specimen_mm = last.specimen_mm;
                self.force_n = last.force_n;
            }
        }
        self.trials.0 = Some(trial);
        self.force_n
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::*;
    use super::{EFFECT, Effect, FixtureJoint, LINEAR};

    #[test]
    fn neutral_values_change_nothing() {
        neutral_changes_nothing(&EFFECT);
        neutral_changes_nothing(&LINEAR);
    }

    #[test]
    fn a_fixture_takes_a_small_part_of_the_travel() {
        // 2000 N over 20 mm: 1 mm/kN takes 10 %, 2 mm/kN 20 %. A seat that is loose up to 200 N takes 0.6 mm.
        let recorded = ramp([20.0, 2000.0]);
        assert!((LINEAR.plausible)(&[1.0], &recorded) && !(LINEAR.plausible)(&[2.0], &recorded));
        assert!((EFFECT.plausible)(&[3.0, 200.0, 1.0, 0.98], &recorded));
    }

    #[test]
    fn force_by_hand() {
        // 80 N/mm behind 2 mm/kN: x_s = (5 - 0.002 * 100) / 1.16, F = 100 + 80 x_s.
        let mut plant = (LINEAR.attach)(&[2.0], spring());
        // The secant method ends within 1e-9 mm.
        assert!((plant.step(5.0, 0.1) - (100.0 + 80.0 * 4.8 / 1.16)).abs() < 1e-6);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&LINEAR, &[1.3]);
        parameters_are_recovered(&EFFECT, &[1.3, 400.0, 80.0, 0.7]);
    }

    #[test]
    fn a_joint_that_closes_keeps_a_fifth_of_its_compliance_past_the_corner() {
        let joint = FixtureJoint::of(&[2.0, 500.0, 1.0, 0.8]);
        // 500 N at 2 mm/kN, then 1000 N at 0.4 mm/kN; a corner of 1 N leaves less than 0.002 mm.
        assert!((joint.deformation_mm(1500.0) - 1.4).abs() < 2e-3);
        for force_n in [-200.0, 0.0, 100.0, 499.0, 500.0, 501.0, 3000.0] {
            let back_n = joint.force_n(joint.deformation_mm(force_n));
            assert!((back_n - force_n).abs() < 1e-6, "{force_n} N: {back_n} N");
            let step_mm = joint.deformation_mm(force_n + 1e-3) - joint.deformation_mm(force_n - 1e-3);
            assert!((step_mm / 2e-3 - joint.slope_mm_per_n(force_n)).abs() < 1e-9);
        }
    }

    #[test]
    fn without_a_closed_share_it_is_the_linear_joint() {
        let mut linear = (LINEAR.attach)(&[2.0], spring());
        let mut closing = (EFFECT.attach)(&[2.0, 500.0, 100.0, 0.0], spring());
        for (dt_s, x) in motion() {
            assert_eq!(linear.step(x, dt_s), closing.step(x, dt_s));
        }
    }

    /// Forces of a spring with friction inside behind 2 mm/kN, over two cycles of 1 Hz at 1 kHz.
    fn stepped_at_1_khz(friction: &Effect, values: &[f64]) -> Vec<f64> {
        let mut plant = (LINEAR.attach)(&[2.0], (friction.attach)(values, spring()));
        (0..2000)
            .map(|i| {
                let angle = std::f64::consts::TAU * 1e-3 * f64::from(i);
                plant.step(6.0 * (1.0 - angle.cos()), 1e-3)
            })
            .collect()
    }

    /// Between its turning points the motion never goes back, so neither may the force; and no step is steeper than the compliance.
    fn never_chatters(forces_n: &[f64]) {
        for (i, pair) in forces_n.windows(2).enumerate().skip(500) {
            let rises = i % 1000 < 499;
            let falls = (501..999).contains(&(i % 1000));
            let step_n = pair[1] - pair[0];
            assert!(
                !(rises && step_n < -1e-4),
                "sample {i}: falls by {step_n} N while loading"
            );
            assert!(
                !(falls && step_n > 1e-4),
                "sample {i}: rises by {step_n} N while unloading"
            );
        }
    }

    #[test]
    fn friction_that_waits_for_the_noise_band_does_not_chatter() {
        never_chatters(&stepped_at_1_khz(
            &super::super::coulomb_friction::EFFECT,
            &[30.0, 0.05, 1.0],
        ));
        let mut ratios = [0.0; 18];
        (ratios[0], ratios[3]) = (0.03, 0.05);
        never_chatters(&stepped_at_1_khz(&super::super::friction_form::FORM, &ratios));
    }

    #[test]
    fn the_equation_holds_at_every_step_where_the_force_has_no_jump() {
        // F = 100 + 80 (x - 0.002 F), so F = (100 + 80 x) / 1.16.
        let mut plant = (LINEAR.attach)(&[2.0], spring());
        for (dt_s, x) in motion() {
            let expected_n = (100.0 + 80.0 * x) / 1.16;
            assert!((plant.step(x, dt_s) - expected_n).abs() < 1e-5, "{x}");
        }
    }
}
