//! Kinds of cases, and their order in a run.

use super::World;

/// Kind of case: what is hidden, and how.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Family {
    /// Nothing is hidden.
    None,
    /// Nothing is hidden; the sensors are ten times noisier.
    NoneNoisy,
    /// One effect of the library is hidden.
    Single,
    /// Two effects of the library are hidden.
    Pair,
    /// One effect that has a look-alike is hidden, and the programme is only a ramp and one sine.
    Confounded,
    /// One effect that the library does not have is hidden.
    Outside,
    /// One effect of the library is hidden, and the baseline is tuned so that its peak force and loop energy match.
    Concealed,
    /// Nothing is hidden; the instruments are imperfect.
    Nuisance,
}

/// Families of 20 successive cases: 20 % without an effect, 40 % single, 15 % pairs, 5 % confounded, 10 % outside the
/// library, 10 % concealed.
const ROUND: [Family; 20] = {
    use Family::{Concealed, Confounded, None, NoneNoisy, Outside, Pair, Single};
    [
        Single, None, Single, Pair, Outside, Single, Concealed, None, Single, Pair, Single, Confounded,
        Single, NoneNoisy, Single, Outside, Pair, Single, None, Concealed,
    ]
};

/// Families of 20 successive cases in a world other than `own`: 15 % without an effect, 20 % with imperfect instruments,
/// 40 % single, 10 % pairs, 15 % outside the library.
const FOREIGN_ROUND: [Family; 20] = {
    use Family::{None, Nuisance, Outside, Pair, Single};
    [
        Single, None, Nuisance, Outside, Single, Pair, Single, Nuisance, Single, None, Outside, Single,
        Nuisance, Single, Pair, Single, None, Outside, Nuisance, Single,
    ]
};

impl Family {
    /// True if nothing is hidden in its cases, even if the instruments are imperfect.
    pub(crate) fn hides_nothing(self) -> bool {
        matches!(self, Family::None | Family::NoneNoisy | Family::Nuisance)
    }

    /// True if the library has what is hidden in its cases.
    pub(crate) fn is_in_library(self) -> bool {
        !self.hides_nothing() && self != Family::Outside
    }

    /// All families, in the order of the declaration.
    pub(crate) const ALL: [Family; 8] = [
        Family::None,
        Family::NoneNoisy,
        Family::Single,
        Family::Pair,
        Family::Confounded,
        Family::Outside,
        Family::Concealed,
        Family::Nuisance,
    ];

    /// Family of case `number` of a world, the same in every run.
    pub(crate) fn of(world: World, number: u64) -> Family {
        let round = match world {
            World::Own => &ROUND,
            _ => &FOREIGN_ROUND,
        };
        round[(number % round.len() as u64) as usize]
    }

    /// Name for `--kind` on the command line.
    pub(crate) fn key(self) -> &'static str {
        match self {
            Family::None => "none",
            Family::NoneNoisy => "none-noisy",
            Family::Single => "single",
            Family::Pair => "pair",
            Family::Confounded => "confounded",
            Family::Outside => "outside",
            Family::Concealed => "concealed",
            Family::Nuisance => "nuisance",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_round_has_every_family_in_its_share() {
        let count = |f: Family| ROUND.iter().filter(|r| **r == f).count();
        assert_eq!(count(Family::None) + count(Family::NoneNoisy), 4);
        assert_eq!(
            (
                count(Family::Single),
                count(Family::Pair),
                count(Family::Confounded)
            ),
            (8, 3, 1)
        );
        assert!(
            Family::ALL
                .iter()
                .all(|f| ROUND.contains(f) || FOREIGN_ROUND.contains(f))
        );
    }
}
