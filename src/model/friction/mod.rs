//! Friction laws: slip and normal force in, friction force out. Where the slip comes from is the model's business.
//!
//! A new law is one file and one line in [`LAWS`].

use super::{BuildError, Parameter};

pub(crate) mod coulomb;
pub(crate) mod dahl;
pub(crate) mod elements;
pub(crate) mod maxwell_slip;
pub(crate) mod tanh;

/// A friction law with its state. Same input, same bits.
pub trait FrictionLaw: Send {
    /// Name as in [`LAWS`].
    fn name(&self) -> &'static str;
    /// What a fit may move, in the order that `build` takes.
    fn parameters(&self) -> &'static [Parameter];
    /// Slips to the position `slip_mm` within `dt_s` under `normal_n` (negative counts as open) and returns the force
    /// in N that resists; positive resists rising slip.
    fn force(&mut self, slip_mm: f64, dt_s: f64, normal_n: f64) -> f64;
    /// Back to the virgin state at zero slip.
    fn reset(&mut self);
    /// A copy with its state.
    fn boxed_clone(&self) -> Box<dyn FrictionLaw>;
}

impl Clone for Box<dyn FrictionLaw> {
    fn clone(&self) -> Self {
        self.boxed_clone()
    }
}

/// One entry of [`LAWS`].
pub(crate) struct Law {
    /// Name in files.
    pub name: &'static str,
    /// One sentence with the source.
    pub what: &'static str,
    /// What a fit may move, in the order that `build` takes.
    pub parameters: &'static [Parameter],
    /// Builds the law from one checked value a parameter.
    build: fn(values: &[f64]) -> Option<Box<dyn FrictionLaw>>,
}

/// All laws, by name.
pub(crate) static LAWS: &[Law] = &[coulomb::LAW, dahl::LAW, maxwell_slip::LAW, tanh::LAW];

/// The law called `name`.
pub(crate) fn find(name: &str) -> Option<&'static Law> {
    LAWS.iter().find(|law| law.name == name)
}

impl Law {
    /// Builds after checking that every value is finite and within bounds.
    pub(crate) fn law(&self, values: &[f64]) -> Result<Box<dyn FrictionLaw>, BuildError> {
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
        (self.build)(values).ok_or_else(|| BuildError::Structure {
            model: self.name,
            reason: format!(
                "{} values given for {} parameters: give one each",
                values.len(),
                self.parameters.len()
            ),
        })
    }
}

/// The coefficient that all laws begin with.
const COEFFICIENT: Parameter = Parameter {
    name: "friction_coefficient",
    unit: "",
    start: 0.15,
    bounds: [0.0, 20.0],
    belief: [0.02, 0.6],
    what: "friction force in proportion to the normal force",
};

/// The transition length of the laws that have one.
const PRESLIDING: Parameter = Parameter {
    name: "presliding_mm",
    unit: "mm",
    start: 0.05,
    bounds: [1e-6, 50.0],
    belief: [1e-3, 5.0],
    what: "slip after a reversal over which the friction turns round",
};

#[cfg(test)]
mod tests {
    use super::*;

    /// Every law over the list: unique sorted names, full sliding at mu N, an open contact carries nothing, and a
    /// clone goes on as its original does.
    #[test]
    fn all_laws_keep_the_common_rules() {
        assert!(LAWS.windows(2).all(|w| w[0].name < w[1].name));
        for law in LAWS {
            let values: Vec<f64> = law.parameters.iter().map(|p| p.start).collect();
            let mut friction = law.law(&values).expect("start values are within bounds");
            assert_eq!(friction.name(), law.name);
            let mut force_n = 0.0;
            for i in 1..=2000 {
                force_n = friction.force(0.01 * f64::from(i), 1e-3, 1000.0);
            }
            // 20 mm at 10 mm/s is full sliding for every law at its start values.
            assert!((force_n - 150.0).abs() < 1e-6, "{}: {force_n}", law.name);
            let mut copy = friction.boxed_clone();
            assert_eq!(
                copy.force(19.9, 1e-3, 500.0),
                friction.force(19.9, 1e-3, 500.0),
                "{}",
                law.name
            );
            assert_eq!(friction.force(25.0, 1e-3, -5.0), 0.0, "{}", law.name);
            assert!(law.law(&vec![f64::NAN; values.len()]).is_err());
            assert!(law.law(&values[1..]).is_err());
        }
    }

    /// The laws without a rate give the same loop at any speed; tanh does not (Kadziela 2015, section 4).
    #[test]
    fn only_tanh_depends_on_speed() {
        for law in LAWS {
            let values: Vec<f64> = law.parameters.iter().map(|p| p.start).collect();
            let peak = |dt_s: f64| {
                let mut friction = law.law(&values).expect("start values are within bounds");
                (1..=100).fold(0.0, |_, i| friction.force(0.01 * f64::from(i), dt_s, 100.0))
            };
            assert_eq!(peak(1e-3) == peak(10.0), law.name != "tanh", "{}", law.name);
        }
    }
}
