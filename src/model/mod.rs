//! Models of the spring: displacement in, force out. `effect` has the physics that models leave out, `identify` the fit.
//!
//! A new model is one file and one line in [`MODELS`].

use std::any::Any;

use crate::nearest;

pub(crate) mod equivalent;
pub(crate) mod finite_segment;
pub(crate) mod five_link;
pub(crate) mod friction;
pub(crate) mod leaf_pack;
pub(crate) mod two_sided;

/// A model ready to step. It is always driven by displacement, also where the profile controls force. Same input, same bits.
pub trait Plant: Any + Send {
    /// Back to the virgin state at zero displacement.
    fn reset(&mut self);
    /// Moves to `displacement_mm` within `dt_s` and returns the force in N. Loading is positive.
    fn step(&mut self, displacement_mm: f64, dt_s: f64) -> f64;
    /// A copy with its state.
    fn boxed_clone(&self) -> Box<dyn Plant>;
    /// Copies this plant with its state into `copy`: without a new allocation where `copy` is of the same kind and the plant has
    /// code for it.
    fn copy_to(&self, copy: &mut Box<dyn Plant>) {
        *copy = self.boxed_clone();
    }
    /// Gives the motion just before a step, where the whole recording is known. A twin never gets it.
    fn told(&mut self, _motion: &Motion) {}
    /// Load in N that the contacts carried at the last step, without friction; `None` if the model does not compute it.
    fn carried_n(&self) -> Option<f64> {
        None
    }
    /// Load in N that friction is proportional to. It is the carried load, unless a part of that counts more: leaves that touch rub, and
    /// those that do not touch yet carry load without friction.
    fn pressing_n(&self) -> Option<f64> {
        self.carried_n()
    }
}

/// Motion at one instant, smoothed over samples before and after it. Differences of noisy samples would be much less accurate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    pub velocity_mm_s: f64,
    pub acceleration_mm_s2: f64,
    /// Displacement at the reversals before and after this instant, the lower first, in mm.
    pub reach_mm: [f64; 2],
}

/// A plant as its own type, if it is of that type.
pub(crate) fn as_kind<P: Plant>(plant: &mut Box<dyn Plant>) -> Option<&mut P> {
    let any: &mut dyn Any = plant.as_mut();
    any.downcast_mut()
}

impl Clone for Box<dyn Plant> {
    fn clone(&self) -> Self {
        self.boxed_clone()
    }
}

/// One parameter of a model, law or effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Name with its unit at the end, as in a config file: `rate_n_per_mm`.
    pub name: &'static str,
    /// Unit for people: `N/mm`; empty for a pure number.
    pub unit: &'static str,
    /// Value that a fit starts from.
    pub start: f64,
    /// Range within which the equations hold; a value outside is refused.
    pub bounds: [f64; 2],
    /// Plausible range for a leaf spring; a fitted value outside is a finding.
    pub belief: [f64; 2],
    /// What it is, in one line.
    pub what: &'static str,
}

impl Parameter {
    /// False where both bounds hold it at one value.
    pub(crate) fn is_free(&self) -> bool {
        self.bounds[0] < self.bounds[1]
    }

    /// True if a bound stops `value` outside the plausible range. A bound that is also the limit of that range is no finding.
    pub(crate) fn strained_by(&self, value: f64) -> bool {
        let near = 1e-3 * (self.belief[1] - self.belief[0]);
        let beyond = |side: usize, sign: f64| {
            sign * (self.bounds[side] - value) < near && sign * (self.bounds[side] - self.belief[side]) > near
        };
        beyond(0, -1.0) || beyond(1, 1.0)
    }
}

/// Why a model could not be built.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum BuildError {
    /// There is no model of this name.
    #[error("no model is called \"{name}\"{}: use one of {known}", nearest::question(meant.as_deref()))]
    UnknownModel {
        /// The name that was asked for.
        name: String,
        /// The name that is probably meant.
        meant: Option<String>,
        /// Names and descriptions of all models.
        known: String,
    },
    /// The model has no parameter of this name.
    #[error(
        "model {model} has no parameter \"{name}\"{}: use one of {known}",
        nearest::question_in(name, known)
    )]
    UnknownParameter {
        /// Name of the model.
        model: &'static str,
        /// The name that was asked for.
        name: String,
        /// Names of the model's parameters.
        known: String,
    },
    /// A value is not finite or outside its bounds.
    #[error("{name} = {value} of model {model} is outside {low} to {high}: enter a value within")]
    OutOfBounds {
        /// Name of the model.
        model: &'static str,
        /// Name of the parameter.
        name: String,
        /// The value that was given.
        value: f64,
        /// Lower bound of the parameter.
        low: f64,
        /// Upper bound of the parameter.
        high: f64,
    },
    /// The structure table (leaves, geometry, options) does not fit the model.
    #[error("structure of model {model}: {reason}")]
    Structure {
        /// Name of the model.
        model: &'static str,
        /// What is wrong, at which key, and what to do.
        reason: String,
    },
}

/// How a [`Model`] is built.
pub(crate) type BuildPlant =
    fn(values: &[f64], structure: &toml::Table) -> Result<Box<dyn Plant>, BuildError>;

/// Tells whether the physics with a code is known.
pub(crate) type Knows<'a> = dyn Fn(&str) -> bool + 'a;

/// Gives the structure entry for the friction that is known: [`Model::limit_friction`].
pub(crate) type LimitFriction = fn(&Knows<'_>) -> (&'static str, &'static str);

/// A model of the spring: name, parameters, physics, and how it is built.
pub struct Model {
    /// Name in files and on the command line.
    pub name: &'static str,
    /// What it is, with its source, as the error text for an unknown name shows it.
    pub what: &'static str,
    /// Parameters that a fit may change, in the order of the values that `build` takes.
    pub parameters: &'static [Parameter],
    /// Codes of physics (docs/formats.md) that the model already has.
    pub physics: &'static [&'static str],
    /// True where one run over all recordings takes about 0.1 s: a diagnosis then searches on a surrogate.
    pub slow: bool,
    /// Index of the parameter that is friction as a ratio of the carried load; the generalised friction law adds to it.
    pub friction_ratio: Option<usize>,
    /// Structure entry (key, value) that leaves the known friction in the model and switches the rest off.
    pub limit_friction: Option<LimitFriction>,
    /// Builds a plant from one value per parameter and the model's own structure table (geometry, options; may be empty).
    pub build: BuildPlant,
}

/// All models, by name.
pub(crate) static MODELS: &[Model] = &[
    equivalent::MODEL,
    finite_segment::MODEL,
    five_link::MODEL,
    leaf_pack::MODEL,
    two_sided::MODEL,
];

/// All models, sorted by name.
pub fn all() -> &'static [Model] {
    MODELS
}

/// The model called `name`.
pub fn find(name: &str) -> Result<&'static Model, BuildError> {
    MODELS
        .iter()
        .find(|m| m.name == name)
        .ok_or_else(|| BuildError::UnknownModel {
            name: name.to_owned(),
            meant: nearest::name(name, &MODELS.iter().map(|m| m.name).collect::<Vec<_>>()).map(str::to_owned),
            known: MODELS
                .iter()
                .map(|m| format!("\"{}\": {}", m.name, m.what))
                .collect::<Vec<_>>()
                .join("; "),
        })
}

impl Model {
    /// The start value of every parameter.
    pub fn start_values(&self) -> Vec<f64> {
        self.parameters.iter().map(|p| p.start).collect()
    }

    /// Index of a parameter by name.
    pub(crate) fn parameter_index(&self, name: &str) -> Result<usize, BuildError> {
        let names: Vec<&str> = self.parameters.iter().map(|p| p.name).collect();
        let index = names.iter().position(|known| *known == name);
        index.ok_or_else(|| BuildError::UnknownParameter {
            model: self.name,
            name: name.to_owned(),
            known: names.join(", "),
        })
    }

    /// Builds after checking that every value is finite and within bounds.
    pub fn plant(&self, values: &[f64], structure: &toml::Table) -> Result<Box<dyn Plant>, BuildError> {
        for (p, &value) in self.parameters.iter().zip(values) {
            let [low, high] = p.bounds;
            if !(value >= low && value <= high) {
                return Err(BuildError::OutOfBounds {
                    model: self.name,
                    name: p.name.to_owned(),
                    value,
                    low,
                    high,
                });
            }
        }
        (self.build)(values, structure)
    }
}

/// Numbers of a structure table in the order of `keys` (name, default); any other key is refused.
pub(crate) fn structure_numbers<const N: usize>(
    model: &'static str,
    structure: &toml::Table,
    keys: [(&str, f64); N],
) -> Result<[f64; N], BuildError> {
    let numbers = structure_numbers_beside(model, structure, &[], &keys)?;
    Ok(std::array::from_fn(|i| numbers[i]))
}

/// [`structure_numbers`] of a table that also has `others`: keys that the caller reads itself.
pub(crate) fn structure_numbers_beside(
    model: &'static str,
    structure: &toml::Table,
    others: &[&str],
    keys: &[(&str, f64)],
) -> Result<Vec<f64>, BuildError> {
    let refused = |reason| Err(BuildError::Structure { model, reason });
    let mut numbers: Vec<f64> = keys.iter().map(|k| k.1).collect();
    for (key, value) in structure {
        if others.contains(&key.as_str()) {
            continue;
        }
        let number = value.as_float().or_else(|| value.as_integer().map(|i| i as f64));
        match (keys.iter().position(|k| k.0 == key), number) {
            (Some(i), Some(number)) if number.is_finite() => numbers[i] = number,
            (Some(_), _) => {
                return refused(format!(
                    "{key} = {value} is not a finite number: enter a finite number"
                ));
            }
            (None, _) => {
                let known: Vec<&str> = others.iter().copied().chain(keys.iter().map(|k| k.0)).collect();
                return refused(format!(
                    "key \"{key}\" is unknown: use one of {}",
                    known.join(", ")
                ));
            }
        }
    }
    Ok(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_bound_outside_the_plausible_range_is_a_finding() {
        let rate = Parameter {
            name: "rate_n_per_mm",
            unit: "N/mm",
            start: 80.0,
            bounds: [0.1, 300.0],
            belief: [10.0, 300.0],
            what: "",
        };
        assert!(rate.strained_by(0.1), "at a bound far below the plausible range");
        assert!(!rate.strained_by(5.0), "implausible, but no bound stops it");
        assert!(
            !rate.strained_by(80.0) && !rate.strained_by(300.0),
            "the bound is the limit of the plausible range"
        );
    }
}
