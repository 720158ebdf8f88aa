//! Models of the spring: displacement in, force out. What a model leaves out is in `effect`; fitting is in `identify`.
//!
//! A new model is one file and one line in [`MODELS`].

pub(crate) mod equivalent;
pub(crate) mod finite_segment;
pub(crate) mod five_link;
pub(crate) mod friction;
pub(crate) mod leaf_pack;

/// A model ready to step. Always driven by displacement, whatever the rig controls; same input, same bits.
pub trait Plant: Send {
    /// Back to the virgin state at zero displacement.
    fn reset(&mut self);
    /// Moves to `displacement_mm` within `dt_s` and returns the force in N. Loading is positive.
    fn step(&mut self, displacement_mm: f64, dt_s: f64) -> f64;
    /// A copy with its state.
    fn boxed_clone(&self) -> Box<dyn Plant>;
    /// Told just before a step where the motion is known with hindsight, as in a recording. A twin is never told.
    fn told(&mut self, _motion: &Motion) {}
    /// Load in N that the contacts carried at the last step, friction left out; `None` where the model cannot say.
    fn carried_n(&self) -> Option<f64> {
        None
    }
}

/// The motion at one instant, seen with hindsight: no difference of noisy samples comes near it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Speed in mm/s.
    pub velocity_mm_s: f64,
    /// Acceleration in mm/s2.
    pub acceleration_mm_s2: f64,
    /// Turning points before and after, the lower first, in mm.
    pub reach_mm: [f64; 2],
}

impl Clone for Box<dyn Plant> {
    fn clone(&self) -> Self {
        self.boxed_clone()
    }
}

/// One parameter of a model, law or effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Name with its unit at the end, as it stands in a config file: `rate_n_per_mm`.
    pub name: &'static str,
    /// Unit for people: `N/mm`; empty for a pure number.
    pub unit: &'static str,
    /// Value that a fit starts from.
    pub start: f64,
    /// The equations hold within these bounds.
    pub bounds: [f64; 2],
    /// A person would believe values within these; outside is a finding.
    pub belief: [f64; 2],
    /// One sentence: what it is.
    pub what: &'static str,
}

impl Parameter {
    /// Does a bound hold a value where nobody believes it? Bounds that are those of belief are no finding.
    pub fn strained_by(&self, value: f64) -> bool {
        let near = 1e-3 * (self.belief[1] - self.belief[0]);
        let beyond = |side: usize, sign: f64| {
            sign * (self.bounds[side] - value) < near && sign * (self.bounds[side] - self.belief[side]) > near
        };
        beyond(0, -1.0) || beyond(1, 1.0)
    }
}

/// Why a model could not be built.
#[derive(Debug, thiserror::Error, PartialEq)]
pub(crate) enum BuildError {
    /// No model of this name.
    #[error("no model is called \"{name}\": use one of {known}")]
    UnknownModel {
        /// As asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// A parameter is not one of the model's.
    #[error("model {model} has no parameter \"{name}\": it has {known}")]
    UnknownParameter {
        /// The model.
        model: &'static str,
        /// As given.
        name: String,
        /// What there is.
        known: String,
    },
    /// A value is not finite or outside its bounds.
    #[error("{name} = {value} of model {model} is outside {low} to {high}: enter a value within")]
    OutOfBounds {
        /// The model.
        model: &'static str,
        /// The parameter.
        name: String,
        /// As given.
        value: f64,
        /// Lower bound.
        low: f64,
        /// Upper bound.
        high: f64,
    },
    /// The structure table (leaves, geometry, options) does not fit the model.
    #[error("structure of model {model}: {reason}")]
    Structure {
        /// The model.
        model: &'static str,
        /// What is wrong and what to do.
        reason: String,
    },
}

/// How a [`Model`] is built.
pub(crate) type BuildPlant =
    fn(values: &[f64], structure: &toml::Table) -> Result<Box<dyn Plant>, BuildError>;

/// Tells whether the physics with a code is known.
pub(crate) type Knows<'a> = dyn Fn(&str) -> bool + 'a;

/// See [`Model::limit_friction`].
pub(crate) type LimitFriction = fn(&Knows<'_>) -> (&'static str, &'static str);

/// One entry of [`MODELS`].
pub(crate) struct Model {
    /// Name in files and on the command line.
    pub name: &'static str,
    /// One sentence with the source.
    pub what: &'static str,
    /// What a fit may move, in the order that `build` takes.
    pub parameters: &'static [Parameter],
    /// Codes of physics (contracts.md) that the model already has.
    pub physics: &'static [&'static str],
    /// True where one run over all recordings takes about 0.1 s: a diagnosis then searches on a surrogate.
    pub slow: bool,
    /// Index of the parameter that is friction as a ratio of the carried load; the generalised friction law adds to it.
    pub friction_ratio: Option<usize>,
    /// Structure entry (key, value) that leaves the known friction in the model and switches the rest off.
    pub limit_friction: Option<LimitFriction>,
    /// Builds a plant from one value a parameter and the model's own structure table (geometry, options; may be empty).
    pub build: BuildPlant,
}

/// All models, by name.
pub(crate) static MODELS: &[Model] = &[
    equivalent::MODEL,
    finite_segment::MODEL,
    five_link::MODEL,
    leaf_pack::MODEL,
];

/// The model called `name`.
pub(crate) fn find(name: &str) -> Result<&'static Model, BuildError> {
    MODELS
        .iter()
        .find(|m| m.name == name)
        .ok_or_else(|| BuildError::UnknownModel {
            name: name.to_owned(),
            known: MODELS.iter().map(|m| m.name).collect::<Vec<_>>().join(", "),
        })
}

impl Model {
    /// Every parameter at its start.
    pub(crate) fn start_values(&self) -> Vec<f64> {
        self.parameters.iter().map(|p| p.start).collect()
    }

    /// Index of a parameter by name.
    pub(crate) fn parameter_index(&self, name: &str) -> Result<usize, BuildError> {
        self.parameters
            .iter()
            .position(|p| p.name == name)
            .ok_or_else(|| BuildError::UnknownParameter {
                model: self.name,
                name: name.to_owned(),
                known: self
                    .parameters
                    .iter()
                    .map(|p| p.name)
                    .collect::<Vec<_>>()
                    .join(", "),
            })
    }

    /// Builds after checking that every value is finite and within bounds.
    pub(crate) fn plant(
        &self,
        values: &[f64],
        structure: &toml::Table,
    ) -> Result<Box<dyn Plant>, BuildError> {
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
    let known = || keys.iter().map(|k| k.0).collect::<Vec<_>>().join(", ");
    let mut numbers = keys.map(|k| k.1);
    for (key, value) in structure {
        let number = value.as_float().or_else(|| value.as_integer().map(|i| i as f64));
        match (keys.iter().position(|k| k.0 == key), number) {
            (Some(i), Some(number)) if number.is_finite() => numbers[i] = number,
            (Some(_), _) => {
                return Err(BuildError::Structure {
                    model,
                    reason: format!("{key} = {value} is not a finite number: enter one"),
                });
            }
            (None, _) => {
                return Err(BuildError::Structure {
                    model,
                    reason: format!("key \"{key}\" is unknown: use {}", known()),
                });
            }
        }
    }
    Ok(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bound_where_nobody_believes_holds_a_value_and_one_of_belief_does_not() {
        let rate = Parameter {
            name: "rate_n_per_mm",
            unit: "N/mm",
            start: 80.0,
            bounds: [0.1, 300.0],
            belief: [10.0, 300.0],
            what: "",
        };
        assert!(rate.strained_by(0.1), "at a bound far below what is believed");
        assert!(!rate.strained_by(5.0), "not believed, but no bound holds it");
        assert!(
            !rate.strained_by(80.0) && !rate.strained_by(300.0),
            "bound and belief are one"
        );
    }
}
