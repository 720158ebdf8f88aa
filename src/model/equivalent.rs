//! Equivalent spring: preload, linear spring and load-proportional friction. It has no geometry.
//!
//! ```text
//! E(x) = max(0, preload + rate * (x - datum))
//! F    = E(x) * (1 + friction_ratio * r)
//! ```
//! x displacement and datum, mm; E carried load, N; rate in N/mm; F force, N; r drag ratio of the contacts from -1 to 1, by
//! the friction law that the structure key `friction` names (see [`super::friction`]; default "presliding"). The other
//! laws have less physics. They are for baselines that lack physics which a diagnosis is to find.
//!
//! The friction is a ratio of the carried load because the measured loss grows with the square of the peak force (loop
//! energies of Kadziela et al. 2015, Tables 2 and 3). With the law "presliding" a closed cycle of stroke S inside the contact
//! has `loop energy = 2 * friction_ratio * E_mean * (S * (2 - q) - 2 * presliding * q)`, `q = 1 - exp(-S / presliding)`.
//!
//! It holds for small rotations of the leaves and one linear rate. The force is never tensile: below the displacement where
//! E reaches zero the pusher has left the spring.

use super::friction::{self, DragLaw};
use super::{BuildError, Knows, Model, Motion, Parameter, Plant, as_kind, structure_numbers_beside};

const NAME: &str = "equivalent";

/// The entry of [`super::MODELS`].
pub(crate) const MODEL: Model = Model {
    name: NAME,
    what: "preload, linear spring and load-proportional friction",
    parameters: &[
        Parameter {
            name: "preload_n",
            unit: "N",
            start: 0.0,
            bounds: [0.0, 20_000.0],
            belief: [0.0, 2_000.0],
            what: "force that the spring carries at the datum, without friction",
        },
        Parameter {
            name: "rate_n_per_mm",
            unit: "N/mm",
            start: 80.0,
            bounds: [0.1, 10_000.0],
            belief: [10.0, 300.0],
            what: "spring rate without friction",
        },
        Parameter {
            name: "friction_ratio",
            unit: "",
            start: 0.1,
            bounds: [0.0, 0.95],
            belief: [0.0, 0.25],
            what: "friction force in proportion to the carried load",
        },
        Parameter {
            name: "presliding_mm",
            unit: "mm",
            start: 0.5,
            bounds: [1e-3, 50.0],
            belief: [0.01, 5.0],
            what: "travel after a reversal over which the friction reverses (to 1/e of the remainder)",
        },
    ],
    physics: &[
        "rate_independent_friction",
        "load_dependent_friction",
        "presliding",
    ],
    slow: false,
    friction_ratio: Some(2),
    limit_friction: Some(known_friction),
    build: |values, structure| Ok(Box::new(Equivalent::from_structure(values, structure)?)),
};

/// Structure entry that leaves the known friction in the model: see [`Model::limit_friction`].
fn known_friction(knows: &Knows<'_>) -> (&'static str, &'static str) {
    let load = knows("load_dependent_friction");
    let any = load || knows("presliding") || knows("rate_independent_friction");
    let option = if !any || (!load && knows("coulomb_friction")) {
        "none"
    } else if !knows("rate_independent_friction") && !knows("presliding") {
        "tanh"
    } else if knows("presliding") {
        "presliding"
    } else {
        "sharp"
    };
    ("friction", option)
}

/// Structure of a model whose friction fades below a speed of `transition_mm_s`, in mm/s.
pub(crate) fn rate_dependent_friction(transition_mm_s: f64) -> toml::Table {
    toml::Table::from_iter([
        ("friction".to_owned(), "tanh".into()),
        ("transition_velocity_mm_s".to_owned(), transition_mm_s.into()),
    ])
}

fn refused(reason: String) -> BuildError {
    BuildError::Structure { model: NAME, reason }
}

/// The model ready to step.
#[derive(Clone)]
pub(crate) struct Equivalent {
    preload_n: f64,
    rate_n_per_mm: f64,
    friction_ratio: f64,
    /// Displacement that carries the preload.
    datum_mm: f64,
    displacement_mm: f64,
    /// Speed for the next step where the recording gives it, mm/s.
    velocity_mm_s: Option<f64>,
    law: Box<dyn DragLaw>,
    carried_n: f64,
}

impl Equivalent {
    /// From values in the order of [`MODEL`]'s parameters. The structure table may have `friction`,
    /// `datum_mm` and the keys of the friction laws.
    fn from_structure(values: &[f64], structure: &toml::Table) -> Result<Self, BuildError> {
        let &[preload_n, rate_n_per_mm, friction_ratio, presliding_mm] = values else {
            return Err(refused(format!(
                "{} values given for 4 parameters: give one for each",
                values.len()
            )));
        };
        let law = friction::chosen(structure.get("friction")).map_err(refused)?;
        let keys: Vec<(&str, f64)> = std::iter::once(("datum_mm", 0.0))
            .chain(friction::keys_for(law))
            .collect();
        let numbers = structure_numbers_beside(NAME, structure, &["friction"], &keys)?;
        let mut law = law.at_rest(presliding_mm, &numbers[1..]).map_err(refused)?;
        if friction_ratio == 0.0 {
            law = friction::without();
        }
        Ok(Equivalent {
            preload_n,
            rate_n_per_mm,
            friction_ratio,
            datum_mm: numbers[0],
            displacement_mm: 0.0,
            velocity_mm_s: None,
            law,
            carried_n: 0.0,
        })
    }
}

impl Plant for Equivalent {
    fn reset(&mut self) {
        self.displacement_mm = 0.0;
        self.law.reset();
    }

    fn step(&mut self, displacement_mm: f64, dt_s: f64) -> f64 {
        let slip_mm = displacement_mm - self.displacement_mm;
        self.displacement_mm = displacement_mm;
        let drag = self.law.drag(slip_mm, dt_s, self.velocity_mm_s.take());
        self.carried_n = (self.preload_n + self.rate_n_per_mm * (displacement_mm - self.datum_mm)).max(0.0);
        self.carried_n * (1.0 + self.friction_ratio * drag)
    }

    fn told(&mut self, motion: &Motion) {
        self.velocity_mm_s = Some(motion.velocity_mm_s);
    }

    fn carried_n(&self) -> Option<f64> {
        Some(self.carried_n)
    }

    fn boxed_clone(&self) -> Box<dyn Plant> {
        Box::new(self.clone())
    }

    fn copy_to(&self, copy: &mut Box<dyn Plant>) {
        match as_kind::<Self>(copy) {
            Some(copy) => *copy = self.clone(),
            None => *copy = self.boxed_clone(),
        }
    }
}

#[cfg(test)]
impl Equivalent {
    /// With the default friction law; `datum_mm` is the displacement that carries the preload.
    pub(crate) fn new(values: &[f64], datum_mm: f64) -> Result<Self, BuildError> {
        let structure = toml::Table::from_iter([("datum_mm".to_owned(), datum_mm.into())]);
        Equivalent::from_structure(values, &structure)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spring() -> Equivalent {
        Equivalent::new(&[50.0, 80.0, 0.12, 0.4], 0.0).expect("four values")
    }

    /// Loop energy in N mm over `count` steps a branch, between 2 and 8 mm, after three cycles of settling.
    fn loop_energy_nmm(count: usize) -> f64 {
        let mut plant = spring();
        let (low, high) = (2.0, 8.0);
        let mut energy = 0.0;
        let mut x0 = low;
        let mut f0 = plant.step(low, 1e-3);
        for cycle in 0..4 {
            for branch in 0..2 {
                for i in 1..=count {
                    let part = i as f64 / count as f64;
                    let x = if branch == 0 {
                        low + 6.0 * part
                    } else {
                        high - 6.0 * part
                    };
                    let f = plant.step(x, 1e-3);
                    if cycle == 3 {
                        energy += 0.5 * (f + f0) * (x - x0);
                    }
                    (x0, f0) = (x, f);
                }
            }
        }
        energy
    }

    #[test]
    fn force_by_hand() {
        // E(5) = 50 + 400 = 450 N; after 12.5 lengths all elements slide: 450 * 1.12.
        let mut spring = spring();
        assert!((spring.step(5.0, 1e-3) - 504.0).abs() < 1e-9);
        // Back by one length, r = 2 exp(-1) - 1: 32 elements are within 0.2 % of the friction.
        let back_n = 418.0 * (1.0 + 0.12 * (2.0 * (-1f64).exp() - 1.0));
        assert!((spring.step(4.6, 1e-3) - back_n).abs() < 2e-3 * 418.0 * 0.12);
    }

    /// Masing (1926): a nested loop ends where it began, and the branch then continues unchanged.
    #[test]
    fn nested_loops_close() {
        let (mut nested, mut straight) = (spring(), spring());
        for x in [6.0, 3.0, 4.0] {
            nested.step(x, 1e-3);
            straight.step(x, 1e-3);
        }
        let before_n = straight.step(4.1, 1e-3);
        for x in [4.1, 3.9, 4.05, 3.95, 4.1] {
            nested.step(x, 1e-3);
        }
        assert!((nested.step(4.1, 1e-3) - before_n).abs() < 1e-9);
        assert!((nested.step(4.3, 1e-3) - straight.step(4.3, 1e-3)).abs() < 1e-9);
    }

    #[test]
    fn the_structure_chooses_the_friction_law() {
        let force_n = |friction: &str, dt_s: f64| {
            let structure = toml::Table::from_iter([("friction".to_owned(), friction.into())]);
            let mut plant = MODEL.plant(&[50.0, 80.0, 0.12, 0.4], &structure)?;
            plant.step(4.9, dt_s);
            Ok::<f64, BuildError>(plant.step(5.0, dt_s))
        };
        assert_eq!(force_n("none", 0.1), Ok(450.0));
        // More than 20 reversal lengths after the start: full sliding to 1e-8.
        assert!((force_n("sharp", 0.1).expect("built") - 504.0).abs() < 1e-6);
        assert!((force_n("tanh", 0.1).expect("built") - 450.0 * (1.0 + 0.12 * 0.2f64.tanh())).abs() < 1e-9);
        assert!((force_n("presliding", 0.1).expect("built") - 504.0).abs() < 1e-3);
        let error = force_n("magnetic", 0.1).expect_err("no such law").to_string();
        assert!(
            error.contains("model equivalent") && error.contains("\"sharp\""),
            "{error}"
        );
    }

    #[test]
    fn structure_keys_are_checked() {
        let error = |text: &str| {
            let structure: toml::Table = text.parse().expect("valid TOML");
            let built = MODEL.plant(&[50.0, 80.0, 0.12, 0.4], &structure);
            built.err().map(|error| error.to_string())
        };
        let unknown = error("frction = \"none\"").expect("a key that does not exist");
        for key in ["frction", "friction", "datum_mm", "transition_velocity_mm_s"] {
            assert!(unknown.contains(key), "{unknown}");
        }
        assert!(error("friction = \"tanh\"\ntransition_velocity_mm_s = 0").is_some());
        // A key of another law has no effect, so that one file runs with each law.
        assert_eq!(error("friction = \"none\"\ntransition_velocity_mm_s = 0"), None);
        assert_eq!(
            error("friction = \"tanh\"\ntransition_velocity_mm_s = 3\ndatum_mm = 1"),
            None
        );
    }

    #[test]
    fn friction_option_follows_the_known_physics() {
        for (known, option) in [
            (&["viscous_damping"][..], "none"),
            (&["coulomb_friction"], "none"),
            (&["load_dependent_friction"], "tanh"),
            (&["load_dependent_friction", "rate_independent_friction"], "sharp"),
            (&["load_dependent_friction", "presliding"], "presliding"),
        ] {
            let found = known_friction(&|code| known.contains(&code));
            assert_eq!(found, ("friction", option), "{known:?}");
        }
    }

    #[test]
    fn loop_energy_matches_the_closed_form() {
        let carried_mean = 50.0 + 80.0 * 5.0;
        let r = 1.0 - (-6.0f64 / 0.4).exp();
        let expected = 2.0 * 0.12 * carried_mean * (6.0 * (2.0 - r) - 0.8 * r);
        // 32 elements: their mean length is 0.5 % too short, and the length is 15 % of the loop energy.
        let found = loop_energy_nmm(6000);
        assert!(
            (found / expected - 1.0).abs() < 1e-3,
            "{found} against {expected}"
        );
    }

    #[test]
    fn state_does_not_depend_on_the_step_size() {
        let (mut coarse, mut fine) = (spring(), spring());
        for target in [7.0, 3.0, 9.5, -2.0, 4.0] {
            let from = fine.displacement_mm;
            let expected = coarse.step(target, 1.0);
            let mut force_n = 0.0;
            for i in 1..=500 {
                force_n = fine.step(from + (target - from) * f64::from(i) / 500.0, 1e-3);
            }
            // The elements are exact over any step: rounding only.
            assert!((force_n - expected).abs() < 1e-9, "{force_n} against {expected}");
        }
    }

    #[test]
    fn never_pulls_and_carries_nothing_after_lift_off() {
        let mut plant = spring();
        plant.step(5.0, 1e-3);
        for i in 0..200 {
            let x = 5.0 - 0.05 * f64::from(i);
            let force_n = plant.step(x, 1e-3);
            assert!(force_n >= 0.0);
            assert_eq!(force_n == 0.0, x <= -0.625, "at {x} mm");
        }
    }
}
