//! The baseline: a model with the physics it is said to have, and what is left as candidates.
//!
//! Codes that are known but not built into the model are attached as effects and fitted with the baseline's own
//! parameters; friction of `equivalent` that is not known is switched off by its structure option.

use super::surrogate::Surrogate;
use crate::effect::{self, EFFECTS, Effect, EffectError, FORMS, Stage};
use crate::model::{BuildError, Model, Parameter, Plant};

/// What the diagnosis starts from.
#[derive(Clone)]
pub(crate) struct Baseline {
    /// The model.
    pub model: &'static Model,
    /// Its structure table.
    pub structure: toml::Table,
    /// Its parameters; the model's starts where `None`.
    pub start: Option<Vec<f64>>,
    /// Codes of the physics that it has; the model's own list where `None`.
    pub known: Option<Vec<String>>,
}

impl Baseline {
    /// A model as it is, with an empty structure.
    pub(crate) fn of(model: &'static Model) -> Baseline {
        Baseline {
            model,
            structure: toml::Table::new(),
            start: None,
            known: None,
        }
    }
}

/// Why a baseline cannot be used.
#[derive(Debug, thiserror::Error, PartialEq)]
pub(crate) enum BaselineError {
    /// The model refuses its structure or start.
    #[error("the baseline cannot be built: {0}")]
    Build(#[from] BuildError),
    /// A known code is not one of contracts.md.
    #[error("known physics: {0}")]
    Known(#[from] EffectError),
}

/// One effect in a structure, with the bounds that hold for it here.
#[derive(Clone)]
pub(super) struct Attached {
    pub effect: &'static Effect,
    pub parameters: Vec<Parameter>,
    /// Part of the baseline: its own known physics in another form, never named as missing.
    pub own: bool,
}

impl Attached {
    pub(super) fn candidate(effect: &'static Effect) -> Attached {
        Attached {
            effect,
            parameters: effect.parameters.to_vec(),
            own: false,
        }
    }
}

/// The baseline ready to be fitted.
#[derive(Clone)]
pub(super) struct Setup {
    pub model: &'static Model,
    pub structure: toml::Table,
    pub start: Vec<f64>,
    /// Known physics that had to be attached.
    pub extras: Vec<Attached>,
    /// The baseline's own friction in a freer form, where it has one that turns round gradually.
    pub form: Option<Attached>,
    /// What may be missing.
    pub candidates: Vec<Attached>,
    /// Stands for the model along the recordings, where that is slow.
    pub surrogate: Option<Surrogate>,
}

impl Setup {
    pub(super) fn new(baseline: &Baseline) -> Result<Setup, BaselineError> {
        let model = baseline.model;
        let built_in = |code: &str| model.physics.contains(&code);
        let known: Vec<String> = match &baseline.known {
            Some(codes) => codes.clone(),
            None => model.physics.iter().map(|c| (*c).to_owned()).collect(),
        };
        for code in &known {
            if code != "unknown" {
                effect::find(code)?;
            }
        }
        let knows = |code: &str| known.iter().any(|k| k == code);
        let mut structure = baseline.structure.clone();
        if let (Some(limit), Some(_)) = (model.limit_friction, &baseline.known) {
            let (key, option) = limit(&knows);
            structure.entry(key).or_insert_with(|| option.into());
        }
        let start = baseline.start.clone().unwrap_or_else(|| model.start_values());
        model.plant(&start, &structure)?;
        let known_form = |effect: &'static Effect| {
            let parameters = (effect.if_known)(effect, &knows)?;
            Some(Attached {
                effect,
                parameters,
                own: true,
            })
        };
        let extras = EFFECTS
            .iter()
            .filter(|e| knows(e.code) && !built_in(e.code))
            .filter_map(known_form)
            .collect();
        let candidates = EFFECTS
            .iter()
            .filter(|e| !knows(e.code))
            .map(Attached::candidate)
            .collect();
        let form = FORMS.iter().find_map(known_form);
        Ok(Setup {
            model,
            structure,
            start,
            extras,
            form,
            candidates,
            surrogate: None,
        })
    }
}

/// Builds the baseline with `attached` around it; `values` are the model's, then one group an effect in the order given.
/// The zero of the force channel comes before what is wrong with the channel.
pub(super) fn build(
    setup: &Setup,
    attached: &[Attached],
    values: &[f64],
    zero_n: f64,
) -> Result<Box<dyn Plant>, BuildError> {
    let (own, groups) = values.split_at(setup.model.parameters.len());
    let plant = setup.model.plant(own, &setup.structure)?;
    Ok(wrap(plant, attached, groups, zero_n))
}

/// Puts `attached`, one group of values each, and the zero around a plant.
pub(super) fn wrap(
    plant: Box<dyn Plant>,
    attached: &[Attached],
    values: &[f64],
    zero_n: f64,
) -> Box<dyn Plant> {
    let mut at = 0;
    let mut placed: Vec<(&'static Effect, &[f64])> = Vec::with_capacity(attached.len());
    for a in attached {
        let n = a.parameters.len();
        placed.push((a.effect, &values[at..at + n]));
        at += n;
    }
    placed.sort_by_key(|(e, _)| (e.stage, e.code));
    let (faults, physics): (Vec<_>, Vec<_>) = placed.into_iter().partition(|(e, _)| e.stage == Stage::Sensor);
    let around = |plant, list: Vec<(&'static Effect, &[f64])>| {
        list.into_iter()
            .fold(plant, |inside, (effect, values)| (effect.attach)(values, inside))
    };
    around(effect::with_zero(zero_n, around(plant, physics)), faults)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setup(known: Option<&[&str]>) -> Setup {
        let mut baseline = Baseline::of(crate::model::find("equivalent").expect("listed"));
        baseline.known = known.map(|k| k.iter().map(|c| (*c).to_owned()).collect());
        Setup::new(&baseline).expect("valid")
    }

    fn friction(setup: &Setup) -> Option<&str> {
        setup.structure.get("friction").and_then(toml::Value::as_str)
    }

    #[test]
    fn what_is_known_is_no_candidate() {
        let setup = setup(None);
        assert_eq!(friction(&setup), None);
        for code in setup.model.physics {
            assert!(setup.candidates.iter().all(|c| c.effect.code != *code), "{code}");
        }
        assert!(setup.form.is_some());
    }

    #[test]
    fn known_physics_is_built_in_or_attached() {
        for (known, option, extras) in [
            (&["viscous_damping"][..], "none", 1),
            (&["coulomb_friction"], "none", 1),
            (&["load_dependent_friction"], "tanh", 0),
            (
                &["load_dependent_friction", "coulomb_friction", "presliding"],
                "presliding",
                1,
            ),
        ] {
            let setup = setup(Some(known));
            assert_eq!(friction(&setup), Some(option), "{known:?}");
            assert_eq!(setup.extras.len(), extras, "{known:?}");
        }
    }

    #[test]
    fn a_friction_option_of_the_user_stays() {
        let mut baseline = Baseline::of(crate::model::find("equivalent").expect("listed"));
        baseline.known = Some(vec!["viscous_damping".to_owned()]);
        baseline.structure.insert("friction".to_owned(), "sharp".into());
        assert_eq!(friction(&Setup::new(&baseline).expect("valid")), Some("sharp"));
    }

    #[test]
    fn an_unknown_code_is_refused_by_name() {
        let mut baseline = Baseline::of(crate::model::find("equivalent").expect("listed"));
        baseline.known = Some(vec!["magnetism".to_owned()]);
        let error = Setup::new(&baseline).err().expect("refused");
        assert!(error.to_string().contains("magnetism"));
    }
}
