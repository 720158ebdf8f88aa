//! What the demo conceals in the specimen of the mock rig, and what the diagnosis says of it.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::cli::CliError;
use crate::config::Bench;
use crate::diagnose::diagnosis::{Diagnosis, Value};
use crate::effect;

/// Seed of the size. It was fixed before the demo was run for the first time.
pub(super) const SEED: u64 = 2026;
/// Dry friction of bushings that are worn or too tight. Clamped rubber or bronze bushings of such a spring have tens of newtons.
const CODE: &str = "coulomb_friction";
/// Friction in N, from the smallest to the largest draw: 2 to 5 % of the 2 kN of the static test.
const FRICTION_N: [f64; 2] = [40.0, 100.0];
/// Travel in mm over which the friction reverses.
const TRANSITION_MM: [f64; 2] = [0.05, 0.2];

/// An effect that the mock rig's specimen has, and of which neither twin nor diagnosis is told.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Concealed {
    /// Code of physics (docs/formats.md).
    pub code: &'static str,
    /// A sentence for a technician.
    pub statement: String,
    /// Name, unit and value of each parameter that was drawn.
    pub parameters: Vec<ConcealedParameter>,
}

/// One parameter of the concealed effect.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct ConcealedParameter {
    pub name: &'static str,
    pub unit: &'static str,
    pub value: f64,
}

impl Concealed {
    /// Draws the size of the effect.
    pub(super) fn draw(seed: u64) -> Result<Concealed, CliError> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut parameter = |name, unit, [low, high]: [f64; 2]| ConcealedParameter {
            name,
            unit,
            value: random.random_range(low..high),
        };
        let parameters = vec![
            parameter("friction_n", "N", FRICTION_N),
            parameter("transition_mm", "mm", TRANSITION_MM),
        ];
        let effect = effect::find(CODE).map_err(|e| CliError::Internal(e.to_string()))?;
        let drawn = |name| parameters.iter().find(|p| p.name == name).map(|p| p.value);
        let values: Vec<f64> = effect
            .parameters
            .iter()
            .map(|p| drawn(p.name).unwrap_or(p.start))
            .collect();
        Ok(Concealed {
            code: effect.code,
            statement: (effect.statement)(&values),
            parameters,
        })
    }

    /// The bench with this effect in its specimen; its model stays without.
    pub(super) fn in_bench(&self, bench: &Bench) -> Bench {
        let parameters: Vec<(&str, f64)> = self.parameters.iter().map(|p| (p.name, p.value)).collect();
        bench.clone().with_concealed_effect(self.code, &parameters)
    }

    /// What the diagnosis found for a parameter, if it names this effect.
    pub(super) fn found<'d>(&self, name: &str, d: &'d Diagnosis) -> Option<&'d Value> {
        let effect = d.effects.iter().find(|e| e.code == self.code)?;
        effect.parameters.iter().find(|p| p.name == name)
    }
}

/// The concealed name compared with the named ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum NameCheck {
    /// It is named, and nothing else.
    Right,
    /// It is named, and other names beside it that were not concealed.
    RightAndMore,
    /// Others are named, and it could replace one of them.
    LookAlike,
    /// Nothing is named.
    NothingNamed,
    /// Only others are named.
    Wrong,
}

impl NameCheck {
    /// Compares the concealed code with the codes of the named effects and those of their look-alikes.
    pub(super) fn of(concealed: &str, named: &[&str], look_alikes: &[&str]) -> NameCheck {
        match named {
            [] => NameCheck::NothingNamed,
            [name] if *name == concealed => NameCheck::Right,
            names if names.contains(&concealed) => NameCheck::RightAndMore,
            _ if look_alikes.contains(&concealed) => NameCheck::LookAlike,
            _ => NameCheck::Wrong,
        }
    }

    /// The comparison as a sentence. `named` has at least one name, unless nothing is named.
    pub(super) fn words(self, concealed: &str, named: &[&str]) -> String {
        let concealed = spaced(concealed);
        let others: Vec<String> = named.iter().map(|code| spaced(code)).collect();
        let others = others.join(" and ");
        match self {
            NameCheck::Right => {
                format!("The answer is right: {concealed} was concealed, and it alone is named.")
            }
            NameCheck::RightAndMore => {
                format!("The answer is right in part: {concealed} was concealed, but {others} are named.")
            }
            NameCheck::LookAlike => format!(
                "The answer is wrong: {others} is named. {concealed}, which was concealed, is among its look-alikes only."
            ),
            NameCheck::NothingNamed => {
                format!("The answer is missing: {concealed} was concealed, and nothing is named.")
            }
            NameCheck::Wrong => {
                format!("The answer is wrong: {concealed} was concealed, and {others} is named.")
            }
        }
    }
}

/// A code such as `coulomb_friction` as words.
pub(super) fn spaced(code: &str) -> String {
    code.replace('_', " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_is_within_its_range_and_depends_on_the_seed_alone() {
        for seed in 0..50 {
            let drawn = Concealed::draw(seed).expect("in the library");
            assert_eq!(drawn, Concealed::draw(seed).expect("in the library"));
            assert_ne!(drawn, Concealed::draw(seed + 1).expect("in the library"));
            let [friction, transition] = drawn.parameters.as_slice() else {
                panic!("{drawn:?}")
            };
            assert!(
                (FRICTION_N[0]..FRICTION_N[1]).contains(&friction.value),
                "{drawn:?}"
            );
            assert!(
                (TRANSITION_MM[0]..TRANSITION_MM[1]).contains(&transition.value),
                "{drawn:?}"
            );
            assert!(
                drawn.statement.contains(&format!("{:.1} N", friction.value)),
                "{drawn:?}"
            );
        }
    }

    #[test]
    fn the_effect_is_in_the_specimen_and_not_in_the_model() {
        let bench = Bench::shipped().expect("built in");
        let rig = Concealed::draw(1).expect("in the library").in_bench(&bench);
        assert_eq!(rig.model, bench.model);
        assert_eq!(
            rig.specimen.model.effects.len(),
            bench.specimen.model.effects.len() + 1
        );
        // The names of the parameters are those of the effect: otherwise the specimen could not be built.
        assert!(rig.specimen.model.plant().is_ok());
    }

    #[test]
    fn a_wrong_answer_is_called_wrong() {
        let check = |named: &[&str], look_alikes: &[&str]| NameCheck::of("backlash", named, look_alikes);
        assert_eq!(check(&["backlash"], &["inertia"]), NameCheck::Right);
        assert_eq!(check(&["backlash", "inertia"], &[]), NameCheck::RightAndMore);
        assert_eq!(check(&["inertia"], &["backlash"]), NameCheck::LookAlike);
        assert_eq!(check(&["inertia"], &["stribeck"]), NameCheck::Wrong);
        assert_eq!(check(&[], &["backlash"]), NameCheck::NothingNamed);
        let said = NameCheck::Wrong.words("backlash", &["run_in"]);
        assert!(said.contains("wrong") && said.contains("run in") && said.contains("backlash"));
    }
}
