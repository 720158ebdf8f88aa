//! What the demo conceals in the specimen of the mock rig, and what the diagnosis says of it.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::cli::CliError;
use crate::config::Bench;
use crate::diagnose::diagnosis::{Diagnosis, Value};
use crate::effect;
use crate::model::Parameter;

/// Seed of the size. It was chosen before the first run, and no other one was tried.
pub(super) const SEED: u64 = 2026;
/// A helper leaf that takes up contact. The force it adds keeps the spring against the pusher, so that nothing else is missing
/// than this: friction or relaxation beside no preload would also lift the pusher off at the end of a test.
const CODE: &str = "progressive_stiffness";
/// Parameters with the smallest and the largest draw. Rate: 14 to 28 % of the shipped spring's. Knee: within the travel of
/// every test, and so that the largest force stays below the limit of the bench.
const SIZES: [(&str, [f64; 2]); 3] = [
    ("extra_rate_n_per_mm", [10.0, 20.0]),
    ("knee_mm", [10.0, 16.0]),
    ("width_mm", [0.3, 1.0]),
];

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
    /// What it is, in words.
    #[serde(skip)]
    pub what: &'static str,
    pub unit: &'static str,
    pub value: f64,
}

impl Concealed {
    /// Draws the size of the effect.
    pub(super) fn draw(seed: u64) -> Result<Concealed, CliError> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let sizes = SIZES.map(|(name, [low, high])| (name, random.random_range(low..high)));
        let effect = effect::find(CODE).map_err(|e| CliError::Internal(e.to_string()))?;
        let drawn = |p: &Parameter| sizes.iter().find(|(name, _)| *name == p.name).map(|s| s.1);
        let values: Vec<f64> = effect
            .parameters
            .iter()
            .map(|p| drawn(p).unwrap_or(p.start))
            .collect();
        let parameters = effect.parameters.iter().filter_map(|p| {
            Some(ConcealedParameter {
                name: p.name,
                what: p.what,
                unit: p.unit,
                value: drawn(p)?,
            })
        });
        let parameters = parameters.collect();
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
                format!("The answer is right in part: {concealed} was concealed; named: {others}.")
            }
            NameCheck::LookAlike => format!(
                "The answer is wrong: {concealed} was concealed and is among the look-alikes only; named: {others}."
            ),
            NameCheck::NothingNamed => {
                format!("The answer is missing: {concealed} was concealed, and nothing is named.")
            }
            NameCheck::Wrong => format!("The answer is wrong: {concealed} was concealed; named: {others}."),
        }
    }
}

/// A code such as `progressive_stiffness` as words.
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
            assert_eq!(drawn.parameters.len(), SIZES.len(), "{drawn:?}");
            for (parameter, (name, [low, high])) in drawn.parameters.iter().zip(SIZES) {
                assert_eq!(parameter.name, name);
                assert!((low..high).contains(&parameter.value), "{drawn:?}");
            }
            let knee = format!("{:.2} mm", drawn.parameters[1].value);
            assert!(drawn.statement.contains(&knee), "{drawn:?}");
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
