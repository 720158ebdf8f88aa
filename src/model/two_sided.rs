//! Two-sided device: a spring, a viscous damper and ten Maxwell-slip elements between two joints. It pushes and pulls.
//!
//! ```text
//! F = F_0 + k x + c v + sum s_i z_i,   dz_i = dx / l_i held within [-1, 1]
//! ```
//! x: displacement, mm. v: speed, mm/s. F_0: `offset_n`. k: `rate_n_per_mm`. c: `damping_n_s_per_mm`. s_i: `slip_i_n`, force at which
//! an element slides, N. z_i: its state, 0 where the motion starts. l_i: its travel until it slides, mm, spaced by a constant
//! factor from the structure key `shortest_mm` to `longest_mm`.
//! Source: W. D. Iwan (1966); F. Al-Bender, V. Lampaert, J. Swevers (2005) for the name. Friction does not follow the load, so this
//! is no model of a leaf spring. A diagnosis writes it for a device that a leaf spring cannot be.

use super::friction::elements::Elements;
use super::{BuildError, Model, Motion, Parameter, Plant, structure_numbers_beside};

pub(crate) const NAME: &str = "two-sided";
/// Number of elements.
pub(crate) const ELEMENTS: usize = 10;
/// Keys of the structure table with their defaults, mm.
const LENGTHS: [(&str, f64); 2] = [("shortest_mm", 0.05), ("longest_mm", 12.5)];

const fn slip(name: &'static str) -> Parameter {
    Parameter {
        name,
        unit: "N",
        start: 0.0,
        bounds: [0.0, 1e6],
        belief: [0.0, 1e5],
        what: "force at which this element slides",
    }
}

/// The entry of [`super::MODELS`].
pub(crate) const MODEL: Model = Model {
    name: NAME,
    what: "spring, viscous damper and ten Maxwell-slip elements; pushes and pulls",
    parameters: &[
        Parameter {
            name: "offset_n",
            unit: "N",
            start: 0.0,
            bounds: [-1e6, 1e6],
            belief: [-1e5, 1e5],
            what: "force at no displacement and no friction",
        },
        Parameter {
            name: "rate_n_per_mm",
            unit: "N/mm",
            start: 80.0,
            bounds: [-1e5, 1e5],
            belief: [-1e3, 1e4],
            what: "rate of the spring; below zero for a mechanism that snaps through",
        },
        Parameter {
            name: "damping_n_s_per_mm",
            unit: "N s/mm",
            start: 0.0,
            bounds: [0.0, 1e4],
            belief: [0.0, 1e2],
            what: "force divided by speed",
        },
        slip("slip_0_n"),
        slip("slip_1_n"),
        slip("slip_2_n"),
        slip("slip_3_n"),
        slip("slip_4_n"),
        slip("slip_5_n"),
        slip("slip_6_n"),
        slip("slip_7_n"),
        slip("slip_8_n"),
        slip("slip_9_n"),
    ],
    physics: &["coulomb_friction", "presliding", "viscous_damping"],
    slow: false,
    friction_ratio: None,
    limit_friction: None,
    build: |values, structure| Ok(Box::new(TwoSided::from_structure(values, structure)?)),
};

/// Lengths in mm, the shortest first.
pub(crate) fn lengths_mm(shortest_mm: f64, longest_mm: f64) -> [f64; ELEMENTS] {
    std::array::from_fn(|i| {
        let share = i as f64 / (ELEMENTS - 1) as f64;
        shortest_mm * (longest_mm / shortest_mm).powf(share)
    })
}

/// The structure table for these lengths.
pub(crate) fn structure(shortest_mm: f64, longest_mm: f64) -> toml::Table {
    let lengths = [shortest_mm, longest_mm];
    let keys = LENGTHS.iter().zip(lengths);
    keys.map(|((key, _), mm)| ((*key).to_owned(), mm.into()))
        .collect()
}

/// The model ready to step.
#[derive(Clone)]
struct TwoSided {
    offset_n: f64,
    rate_n_per_mm: f64,
    damping_n_s_per_mm: f64,
    slips_n: [f64; ELEMENTS],
    elements: Elements<ELEMENTS>,
    /// `None` before the first step: there the elements are at rest wherever the device is.
    displacement_mm: Option<f64>,
    /// Speed for the next step where the recording gives it, mm/s.
    velocity_mm_s: Option<f64>,
}

impl TwoSided {
    fn from_structure(values: &[f64], structure: &toml::Table) -> Result<Self, BuildError> {
        let refused = |reason: String| BuildError::Structure { model: NAME, reason };
        let &[offset_n, rate_n_per_mm, damping_n_s_per_mm, ref slips_n @ ..] = values else {
            return Err(refused(
                "values are missing: give one for each parameter".to_owned(),
            ));
        };
        let slips_n = <[f64; ELEMENTS]>::try_from(slips_n)
            .map_err(|_| refused(format!("{} slip forces given: give {ELEMENTS}", slips_n.len())))?;
        let lengths = structure_numbers_beside(NAME, structure, &[], &LENGTHS)?;
        let (shortest_mm, longest_mm) = (lengths[0], lengths[1]);
        if !(shortest_mm > 0.0 && longest_mm >= shortest_mm) {
            return Err(refused(format!(
                "shortest_mm = {shortest_mm}, longest_mm = {longest_mm}: both must be above 0, the longest not below the shortest"
            )));
        }
        Ok(TwoSided {
            offset_n,
            rate_n_per_mm,
            damping_n_s_per_mm,
            slips_n,
            elements: Elements::new(lengths_mm(shortest_mm, longest_mm)),
            displacement_mm: None,
            velocity_mm_s: None,
        })
    }
}

impl Plant for TwoSided {
    fn reset(&mut self) {
        self.displacement_mm = None;
        self.elements.reset();
    }

    fn step(&mut self, displacement_mm: f64, dt_s: f64) -> f64 {
        let travel_mm = displacement_mm - self.displacement_mm.unwrap_or(displacement_mm);
        self.displacement_mm = Some(displacement_mm);
        let between = if dt_s > 0.0 { travel_mm / dt_s } else { 0.0 };
        let speed = self.velocity_mm_s.take().unwrap_or(between);
        let states = self.elements.advance(travel_mm);
        let slips_n: f64 = states.iter().zip(&self.slips_n).map(|(z, s)| z * s).sum();
        self.offset_n + self.rate_n_per_mm * displacement_mm + self.damping_n_s_per_mm * speed + slips_n
    }

    fn told(&mut self, motion: &Motion) {
        self.velocity_mm_s = Some(motion.velocity_mm_s);
    }

    fn boxed_clone(&self) -> Box<dyn Plant> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plant() -> Box<dyn Plant> {
        let mut values = vec![5.0, 2.0, 0.5];
        values.extend([0.0; ELEMENTS]);
        values[3] = 10.0;
        MODEL.plant(&values, &structure(0.5, 5.0)).expect("sound")
    }

    #[test]
    fn force_by_hand() {
        let mut plant = plant();
        // At rest where it starts: 5 + 2 * 3 N. Then 0.25 mm at 1 mm/s: half of 10 N and 0.5 N more.
        assert!((plant.step(3.0, 0.01) - 11.0).abs() < 1e-12);
        assert!((plant.step(3.25, 0.25) - (5.0 + 6.5 + 0.5 + 5.0)).abs() < 1e-12);
        // Back by 1 mm: it slides the other way.
        assert!((plant.step(2.25, 1.0) - (5.0 + 4.5 - 0.5 - 10.0)).abs() < 1e-12);
    }

    #[test]
    fn lengths_that_cannot_be_are_refused() {
        let values = MODEL.start_values();
        let refused = MODEL.plant(&values, &structure(2.0, 1.0)).err().expect("refused");
        assert!(refused.to_string().contains("longest_mm"));
    }
}
