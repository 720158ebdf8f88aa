//! Worlds: the equations that the truth of a case follows.
//!
//! In the world `own` the specimen is the distribution of Jenkins elements of `specimen`, and each hidden effect has one
//! formula, close to that of the library. In the other worlds (`foreign`) the friction of the specimen is another operator and
//! each hidden effect follows one of several laws, none of which is the formula of the library. A diagnosis that is right in
//! `own` only has learned the formulas and not the physics.

/// The equations of a specimen and of its hidden effects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum World {
    /// Jenkins elements, see `specimen`.
    #[default]
    Own,
    /// Play operators with Weibull weights (L. Prandtl 1928, A. Y. Ishlinskii 1944); the load is a factor outside.
    PrandtlIshlinskii,
    /// The differential equation of R. Bouc (1967) and Y. K. Wen (1976) for the friction force; its limit follows the load.
    BoucWen,
    /// Bristles of C. Canudas de Wit et al. (1995), elastic up to a share of the limit (P. Dupont et al. 2002), with a stiffness in
    /// N/mm that does not follow the load.
    Lugre,
    /// Leaves as Euler-Bernoulli cantilevers, with tip contacts that open and close and friction at every interface.
    Pack,
}

impl World {
    /// All worlds, in the order of the declaration.
    pub(crate) const ALL: [World; 5] = [
        World::Own,
        World::PrandtlIshlinskii,
        World::BoucWen,
        World::Lugre,
        World::Pack,
    ];

    /// Name for `--world` on the command line.
    pub(crate) fn key(self) -> &'static str {
        match self {
            World::Own => "own",
            World::PrandtlIshlinskii => "prandtl-ishlinskii",
            World::BoucWen => "bouc-wen",
            World::Lugre => "lugre",
            World::Pack => "pack",
        }
    }

    /// Range of the shape of its friction operator: power of the element lengths, exponent of the weights, exponent of the
    /// differential equation, damping of the bristles divided by their stiffness in ms, spread of the stick lengths.
    pub(super) fn shapes(self) -> [f64; 2] {
        match self {
            World::Own => [0.9, 1.15],
            World::PrandtlIshlinskii => [0.6, 2.0],
            World::BoucWen => [0.7, 2.5],
            World::Lugre => [0.05, 0.4],
            World::Pack => [1.5, 6.0],
        }
    }

    /// Codes of physics that a specimen has by itself, beyond preload, rate and friction.
    pub(super) fn also(self) -> &'static [&'static str] {
        match self {
            World::Pack => &["geometric_stiffness", "progressive_stiffness"],
            _ => &[],
        }
    }

    /// Random stream of case `number`. The streams of further recordings begin at bit 40, those of the worlds at bit 56.
    pub(super) fn stream(self, number: u64) -> u64 {
        number | (self as u64) << 56
    }
}

/// The law that a hidden effect follows, if its world is not [`World::Own`].
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct Law {
    /// Position in the list of laws of its code in `catalogue`.
    #[serde(skip)]
    pub number: usize,
    /// Name in that list.
    pub name: &'static str,
    /// Random number in [0, 1] that sets the exponent, the width or the length of the law.
    pub shape: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_streams_of_the_worlds_differ() {
        for (k, world) in World::ALL.into_iter().enumerate() {
            for other in &World::ALL[..k] {
                assert_ne!(world.key(), other.key());
                assert_ne!(world.stream(7), other.stream(7));
            }
        }
        assert_eq!(World::Own.stream(7), 7);
    }
}
