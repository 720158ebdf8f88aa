//! The baseline: a model with the physics that is known, and the candidates that may be missing.
//!
//! Known physics that is not built into the model is attached as effects and fitted with the model's own parameters. A model may
//! switch off friction that is not known (`Model::limit_friction`).

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::surrogate::Surrogate;
use crate::cancel::CancelFlag;
use crate::diagnose::error::BaselineError;
use crate::effect::law::ForceLaw;
use crate::effect::{self, EFFECTS, Effect, FORMS, PARTS, RIVAL_LAWS, Stage};
use crate::model::{BuildError, Model, Parameter, Plant};

/// The model that a diagnosis starts from.
#[derive(Clone)]
pub struct Baseline {
    /// One of the models that [`find_model`](crate::find_model) knows.
    pub model: &'static Model,
    /// Structure table of the model.
    pub structure: toml::Table,
    /// Start values of its parameters; the model's own where `None`.
    pub start: Option<Vec<f64>>,
    /// Codes of the known physics; the model's own list where `None`.
    pub known: Option<Vec<String>>,
}

impl Baseline {
    /// A model with an empty structure and its own start values and physics.
    pub fn of(model: &'static Model) -> Baseline {
        Baseline {
            model,
            structure: toml::Table::new(),
            start: None,
            known: None,
        }
    }
}

/// One effect in a structure, with its parameters and their bounds in this baseline.
#[derive(Clone)]
pub(in crate::diagnose) struct Attached {
    pub effect: &'static Effect,
    pub parameters: Vec<Parameter>,
    /// True for known physics of the baseline: it is never reported as missing.
    pub own: bool,
}

impl Attached {
    pub(in crate::diagnose) fn candidate(effect: &'static Effect) -> Attached {
        Attached {
            effect,
            parameters: effect.parameters.to_vec(),
            own: false,
        }
    }

    /// Holds its parameters at these values: a fit does not move them.
    pub(in crate::diagnose) fn hold(&mut self, values: &[f64]) {
        for (parameter, value) in self.parameters.iter_mut().zip(values) {
            parameter.bounds = [*value; 2];
        }
    }
}

/// The baseline ready to be fitted.
#[derive(Clone)]
pub(in crate::diagnose) struct Setup {
    pub model: &'static Model,
    pub structure: toml::Table,
    pub start: Vec<f64>,
    /// Effects of the baseline: known physics that the model lacks, later the general friction law too.
    pub extras: Vec<Attached>,
    /// General friction laws, for a baseline whose friction is load-dependent and has presliding; the usual one first.
    pub forms: Vec<Attached>,
    /// The one of them that is in use.
    pub form: Option<Attached>,
    /// Effects that may be missing.
    pub candidates: Vec<Attached>,
    /// Parts that a candidate may get.
    pub parts: Vec<Attached>,
    /// Freer laws that are only tried in the place of a named effect.
    pub rival_laws: Vec<Attached>,
    /// Replaces a slow model along the recordings.
    pub surrogate: Option<Surrogate>,
    /// A law that was read off the recordings, around the model.
    pub law: Option<ForceLaw>,
    /// Ends every fit.
    pub cancel: CancelFlag,
    /// Steps of the model so far, over all fits.
    steps: Arc<AtomicU64>,
}

impl Setup {
    pub(in crate::diagnose) fn new(baseline: &Baseline) -> Result<Setup, BaselineError> {
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
            .map(Effect::simplest)
            .filter_map(known_form)
            .collect();
        let missing = |list: &'static [Effect]| list.iter().filter(|e| !knows(e.code));
        let forms: Vec<Attached> = FORMS.iter().filter_map(known_form).collect();
        Ok(Setup {
            model,
            structure,
            start,
            extras,
            form: forms.first().cloned(),
            forms,
            candidates: missing(EFFECTS)
                .filter(|e| !e.only_rival)
                .map(Effect::simplest)
                .map(Attached::candidate)
                .collect(),
            parts: missing(PARTS).map(Attached::candidate).collect(),
            rival_laws: missing(RIVAL_LAWS).map(Attached::candidate).collect(),
            surrogate: None,
            law: None,
            cancel: CancelFlag::default(),
            steps: Arc::default(),
        })
    }

    /// Steps of the model so far. They measure the work of a diagnosis the same on every machine.
    pub(in crate::diagnose) fn steps(&self) -> u64 {
        self.steps.load(Ordering::Relaxed)
    }

    /// Called after every run of the model, so it is also where a cancelled diagnosis ends.
    pub(super) fn count_steps(&self, steps: usize) {
        self.cancel.unwind_if_cancelled();
        self.steps.fetch_add(steps as u64, Ordering::Relaxed);
    }
}

/// Builds the model with `attached` around it. `values` are the model's parameters, then one group per effect in the given order.
pub(in crate::diagnose) fn build(
    setup: &Setup,
    attached: &[Attached],
    values: &[f64],
    zero_n: f64,
) -> Result<Box<dyn Plant>, BuildError> {
    let (own, groups) = values.split_at(setup.model.parameters.len());
    let mut plant = setup.model.plant(own, &setup.structure)?;
    if let Some(law) = &setup.law {
        plant = law.attached(plant).map_err(|error| BuildError::Structure {
            model: setup.model.name,
            reason: error.to_string(),
        })?;
    }
    Ok(wrap(plant, attached, groups, zero_n))
}

/// Attaches effects, one group of values each, and the force zero to a plant. The zero comes before the faults of the channels.
pub(super) fn wrap(
    plant: Box<dyn Plant>,
    attached: &[Attached],
    values: &[f64],
    zero_n: f64,
) -> Box<dyn Plant> {
    let mut from = 0;
    let mut placed: Vec<(&'static Effect, &[f64])> = Vec::with_capacity(attached.len());
    for a in attached {
        let n = a.parameters.len();
        placed.push((a.effect, &values[from..from + n]));
        from += n;
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
    fn known_physics_is_not_a_candidate() {
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
        // Each part of the chain is printed once, so the text of the cause is not in the message.
        assert_eq!(error.to_string(), "known physics");
        let cause = std::error::Error::source(&error).expect("a cause").to_string();
        assert!(cause.contains("magnetism"), "{cause}");
    }
}
