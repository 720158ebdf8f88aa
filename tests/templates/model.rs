//! Template of a model: a cubic spring without friction.
//!
//! ```text
//! F = k x + c x^3            k rate_n_per_mm, N/mm; c cubic_n_per_mm3, N/mm3; x displacement, mm
//! ```
//! Source: put author, year and equation here. Range: no friction, no memory, no lift-off.

use crate::model::{BuildError, Model, Parameter, Plant};

/// The entry of [`MODELS`](crate::model::MODELS).
pub(crate) const MODEL: Model = Model {
    name: "cubic",
    what: "cubic spring without friction",
    parameters: &[
        Parameter {
            name: "rate_n_per_mm",
            unit: "N/mm",
            start: 80.0,
            bounds: [0.1, 1000.0],
            belief: [10.0, 300.0],
            what: "spring rate at zero displacement",
        },
        Parameter {
            name: "cubic_n_per_mm3",
            unit: "N/mm3",
            start: 0.0,
            bounds: [0.0, 10.0],
            belief: [0.0, 1.0],
            what: "growth of the rate with the square of the displacement, divided by 3",
        },
    ],
    physics: &[],
    slow: false,
    friction_ratio: None,
    limit_friction: None,
    build: |values, structure| {
        if let Some(key) = structure.keys().next() {
            return Err(BuildError::Structure {
                model: "cubic",
                reason: format!("key \"{key}\" is unknown: the model has no structure, remove it"),
            });
        }
        let &[rate_n_per_mm, cubic_n_per_mm3] = values else {
            return Err(BuildError::Structure {
                model: "cubic",
                reason: format!("{} values given for 2 parameters: give one each", values.len()),
            });
        };
        Ok(Box::new(Cubic {
            rate_n_per_mm,
            cubic_n_per_mm3,
        }))
    },
};

#[derive(Debug, Clone)]
struct Cubic {
    rate_n_per_mm: f64,
    cubic_n_per_mm3: f64,
}

impl Plant for Cubic {
    fn reset(&mut self) {}

    fn step(&mut self, displacement_mm: f64, _dt_s: f64) -> f64 {
        self.rate_n_per_mm * displacement_mm + self.cubic_n_per_mm3 * displacement_mm.powi(3)
    }

    fn boxed_clone(&self) -> Box<dyn Plant> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::MODEL;

    #[test]
    fn force_by_hand() {
        let mut plant = MODEL
            .plant(&[80.0, 0.5], &toml::Table::new())
            .expect("within bounds");
        // 80 * 4 + 0.5 * 64.
        assert!((plant.step(4.0, 0.1) - 352.0).abs() < 1e-9);
    }

    #[test]
    fn a_structure_key_is_refused_by_name() {
        let structure = toml::Table::from_iter([("leaves".to_owned(), 4.into())]);
        let error = MODEL.plant(&[80.0, 0.5], &structure).err().expect("refused");
        assert!(error.to_string().contains("\"leaves\""), "{error}");
    }
}
