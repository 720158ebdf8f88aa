//! Friction laws that the model `equivalent` chooses by name: how far the contacts are dragged along after a step.
//!
//! ```text
//! T = friction_ratio * N * r
//! ```
//! T friction force, N; N carried load, N; r drag ratio from -1 to 1, where -1 and 1 are full sliding. A law gives r from
//! slip, time step and speed. The ratio and the load are the model's.
//!
//! A new law is one file and one line in [`LAWS`]. [`elements`] is not a law; laws, effects and the diagnosis use it.
//! The leaf pack has its own law type (`leaf_pack/slip_law.rs`), because its implicit step also needs the derivatives of
//! the friction force by slip and by friction limit.

pub(crate) mod elements;
mod none;
mod presliding;
mod sharp;
mod tanh;

/// A friction law with its state. Same input, same bits.
pub(crate) trait DragLaw: Send {
    /// Slips by `slip_mm` within `dt_s` and returns the drag ratio, -1 to 1. `velocity_mm_s` is the speed where it is known
    /// from the whole recording; without it a law that needs the speed takes slip over time.
    fn drag(&mut self, slip_mm: f64, dt_s: f64, velocity_mm_s: Option<f64>) -> f64;
    /// Back to the virgin state.
    fn reset(&mut self);
    /// A copy with its state.
    fn boxed_clone(&self) -> Box<dyn DragLaw>;
}

impl Clone for Box<dyn DragLaw> {
    fn clone(&self) -> Self {
        self.boxed_clone()
    }
}

/// A number that a law reads from the structure table. It must be above 0.
pub(crate) struct LawKey {
    /// Name with its unit at the end, as in the file: `transition_velocity_mm_s`.
    pub name: &'static str,
    /// Unit for people: `mm/s`.
    pub unit: &'static str,
    /// Value where the file does not give one.
    pub default: f64,
}

/// One entry of [`LAWS`].
pub(crate) struct FrictionLaw {
    /// Name in the structure table: `friction = "presliding"`.
    pub name: &'static str,
    /// What it does, with its source, as the error text for an unknown name shows it.
    pub what: &'static str,
    /// Numbers of the structure table that only this law reads.
    pub keys: &'static [LawKey],
    /// Builds the law at rest from the model's `presliding_mm` and one number a key.
    build: fn(presliding_mm: f64, numbers: &[f64]) -> Box<dyn DragLaw>,
}

/// All laws. The first one is the default.
pub(crate) static LAWS: &[FrictionLaw] = &[presliding::LAW, sharp::LAW, tanh::LAW, none::LAW];

/// No friction: what a model takes whose friction is in a general law around it, or zero.
pub(crate) fn without() -> Box<dyn DragLaw> {
    (none::LAW.build)(0.0, &[])
}

/// The law that a structure table names, or the default. The error says what is wrong and which names exist.
pub(crate) fn chosen(name: Option<&toml::Value>) -> Result<&'static FrictionLaw, String> {
    let Some(name) = name else {
        return Ok(&LAWS[0]);
    };
    LAWS.iter()
        .find(|law| name.as_str() == Some(law.name))
        .ok_or_else(|| {
            let known: Vec<String> = LAWS
                .iter()
                .map(|law| format!("\"{}\" ({})", law.name, law.what))
                .collect();
            format!("friction = {name} is unknown: use one of {}", known.join(", "))
        })
}

/// Names and defaults of the keys of all laws, those of `law` first. A key of another law is allowed and has no effect, so
/// that one file runs with each law.
pub(crate) fn keys_for(law: &FrictionLaw) -> impl Iterator<Item = (&'static str, f64)> {
    let others = LAWS.iter().filter(move |other| other.name != law.name);
    law.keys
        .iter()
        .chain(others.flat_map(|other| other.keys))
        .map(|key| (key.name, key.default))
}

impl FrictionLaw {
    /// The law at rest. `numbers` has one number a key and may go on.
    pub(crate) fn at_rest(&self, presliding_mm: f64, numbers: &[f64]) -> Result<Box<dyn DragLaw>, String> {
        for (key, number) in self.keys.iter().zip(numbers) {
            if *number <= 0.0 {
                return Err(format!(
                    "{} = {number} with friction = \"{}\": enter a number above 0 {}",
                    key.name, self.name, key.unit
                ));
            }
        }
        Ok((self.build)(presliding_mm, &numbers[..self.keys.len()]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_rest(law: &FrictionLaw) -> Box<dyn DragLaw> {
        let defaults: Vec<f64> = law.keys.iter().map(|key| key.default).collect();
        law.at_rest(0.05, &defaults).expect("defaults are valid")
    }

    /// Full sliding is a ratio of 1, a copy goes on as its original does, and a reset gives back the virgin state.
    #[test]
    fn all_laws_keep_the_common_rules() {
        for law in LAWS {
            let mut friction = at_rest(law);
            let first = friction.drag(0.01, 1e-3, None);
            // 20 mm at 100 mm/s is full sliding for every law that has friction.
            let last = (0..200).fold(0.0, |_, _| friction.drag(0.1, 1e-3, None));
            let full = if law.name == "none" { 0.0 } else { 1.0 };
            assert!((last - full).abs() < 1e-6, "{}: {last}", law.name);
            let mut copy = friction.boxed_clone();
            assert_eq!(
                copy.drag(-0.01, 1e-3, None),
                friction.drag(-0.01, 1e-3, None),
                "{}",
                law.name
            );
            friction.reset();
            assert_eq!(friction.drag(0.01, 1e-3, None), first, "{}", law.name);
        }
    }

    #[test]
    fn names_and_keys_are_unique() {
        for (i, law) in LAWS.iter().enumerate() {
            assert!(
                LAWS[..i].iter().all(|other| other.name != law.name),
                "{}",
                law.name
            );
            let mut names: Vec<&str> = keys_for(law).map(|key| key.0).collect();
            let all = names.len();
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), all, "{names:?}");
        }
    }

    #[test]
    fn an_unknown_name_lists_all_laws() {
        let error = chosen(Some(&"magnetic".into())).err().expect("no such law");
        assert!(LAWS.iter().all(|law| error.contains(law.name)), "{error}");
        assert!(error.contains("friction = \"magnetic\" is unknown"), "{error}");
        assert!(chosen(Some(&5.into())).is_err());
    }

    /// The other laws give the same loop at any speed; tanh does not (Kadziela et al. 2015, section 7.5).
    #[test]
    fn only_tanh_depends_on_speed() {
        for law in LAWS {
            let end = |dt_s: f64| {
                let mut friction = at_rest(law);
                (0..100).fold(0.0, |_, _| friction.drag(0.01, dt_s, None))
            };
            assert_eq!(end(1e-3) == end(10.0), law.name != "tanh", "{}", law.name);
        }
    }
}
