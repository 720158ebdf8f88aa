//! Kinds of cases, and the order in which a run goes through them.

/// What kind of case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Family {
    /// Nothing is hidden.
    None,
    /// Nothing is hidden and the sensors are ten times noisier.
    NoneNoisy,
    /// One effect of the library.
    Single,
    /// Two.
    Pair,
    /// One, on a programme of a ramp and one sine, with a look-alike.
    Confounded,
    /// One that no library has.
    Outside,
    /// One, behind a baseline tuned so that peak force and loop energy match.
    Concealed,
}

/// Order in which a run goes through the families: 20 % none, 40 % single, 15 % pairs, 5 % confounded, 10 % each the others.
const ROUND: [Family; 20] = {
    use Family::{Concealed, Confounded, None, NoneNoisy, Outside, Pair, Single};
    [
        Single, None, Single, Pair, Outside, Single, Concealed, None, Single, Pair, Single, Confounded,
        Single, NoneNoisy, Single, Outside, Pair, Single, None, Concealed,
    ]
};

impl Family {
    /// All of them.
    pub(crate) const ALL: [Family; 7] = [
        Family::None,
        Family::NoneNoisy,
        Family::Single,
        Family::Pair,
        Family::Confounded,
        Family::Outside,
        Family::Concealed,
    ];

    /// What case `number` of every run is drawn for.
    pub(crate) fn of(number: u64) -> Family {
        ROUND[(number % ROUND.len() as u64) as usize]
    }

    /// Name on the command line.
    pub(crate) fn key(self) -> &'static str {
        match self {
            Family::None => "none",
            Family::NoneNoisy => "none-noisy",
            Family::Single => "single",
            Family::Pair => "pair",
            Family::Confounded => "confounded",
            Family::Outside => "outside",
            Family::Concealed => "concealed",
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
        assert!(Family::ALL.iter().all(|f| ROUND.contains(f)));
    }
}
