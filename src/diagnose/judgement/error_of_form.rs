//! How much of what an effect explains may be the error of form of the other laws.
//!
//! A spring's curve or a friction law depends on the path of the displacement alone. If its form is wrong, the error depends on the path alone,
//! too, and an effect of speed or time can hardly explain it. So a law of the path counts only against effects of the path.

use super::alternatives::JudgedEffect;
use crate::diagnose::fitting::Node;
use crate::diagnose::search::SearchResult;

/// Share of what an effect explains that the error of its form may leave: a law that is 17 % off in shape. Of 160 cases of five worlds
/// (seed 626262) 6 have a wrong name that is sure, instead of 9 without it. At half: 6 too; at a third: 8. At double: 5, but 2 of 69
/// right names are no longer sure. In 80 packs (seed 3883214968) the search chose 23 effects of speed or time beside effects of the path, and
/// 22 were hidden there, or an imperfection that acts like them. With this share of the effects of the path, four of the 22 had less than 10 %
/// trust and were not named; eight had less than 50 %.
const FORM_SHARE: f64 = 0.03;
/// The same share of what the laws of free shape explain. It is smaller, because a free shape follows a foreign law better than one formula
/// does. In cases of two worlds that were looked at (seed 910159277), 4 of 115 names of the path are wrong and sure, 4 too at double, and
/// 6 without it; at double a name that is right in half of the cases gets a confidence of 5 %.
const FREE_FORM_SHARE: f64 = 0.0015;
/// The same share for an effect of speed or time that the search beside the path confirmed or found. It is not zero, because a foreign friction
/// may depend on the speed itself. In 240 cases of four worlds that were looked at (seed 3883214968), 23 such effects had less than 90 % trust
/// with the share above. 16 of them were hidden there. Four of the other seven stood for the hidden effect; three did not, and have 48 to 55 %
/// trust. At half, two of the three have 65 % and more; at double, five of the 16 have less than 50 %.
const BESIDE_PATH_SHARE: f64 = 0.0003;
/// An effect whose trust is below this is not named: the error of form of the laws beside it may be nine times what it explains.
pub(super) const LEAST_TRUST: f64 = 0.1;

/// The laws of free shape beside the effects.
#[derive(Clone, Copy)]
pub(super) struct FreeLaws {
    /// Gain in log-likelihood that they bring before any effect is named.
    pub gain: f64,
    /// True if the search beside the path confirmed the effects of speed and time, or found them.
    pub path_given_away: bool,
}

impl FreeLaws {
    /// Beside the sets of a search; `refitted` is the baseline with its own friction law.
    pub(super) fn of(search: &SearchResult, refitted: &Node, path_given_away: bool) -> FreeLaws {
        let of_free_shape = refitted.cost() - search.nodes[0].cost();
        FreeLaws {
            gain: search.likelihood.gain(of_free_shape).max(0.0),
            path_given_away,
        }
    }

    /// The same laws with the full share for every effect. An effect must pass this to be named at all: in a random motion that was looked at,
    /// with nothing hidden, a drift was confirmed beside the path, and its gain is 0.01 % of the gain of these laws.
    pub(super) fn in_full(self) -> FreeLaws {
        FreeLaws {
            path_given_away: false,
            ..self
        }
    }
}

/// Factor of the confidence in an effect, 0 to 1: a part of what it explains may be the error of form of the other effects in the set, `all`,
/// or of the laws of free shape.
pub(super) fn trust_beside(effect: &JudgedEffect, all: &[JudgedEffect], laws: FreeLaws) -> f64 {
    let others = all.iter().filter(|j| j.place != effect.place);
    let alike = others.filter(|j| effect.follows_path || !j.follows_path);
    let of_effects = alike.map(|j| j.loss.max(0.0)).sum::<f64>();
    let share_of_laws = match laws.path_given_away && !effect.follows_path {
        true => BESIDE_PATH_SHARE,
        false => FREE_FORM_SHARE,
    };
    let form_error = FORM_SHARE * of_effects + share_of_laws * laws.gain;
    let own = effect.loss.max(f64::MIN_POSITIVE);
    own / (own + form_error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::judgement::alternatives::tests::effect as of_path;

    const NO_LAWS: FreeLaws = FreeLaws {
        gain: 0.0,
        path_given_away: false,
    };

    fn effect(place: usize, follows_path: bool, loss: f64) -> JudgedEffect {
        JudgedEffect {
            follows_path,
            ..of_path(place, loss)
        }
    }

    #[test]
    fn a_small_effect_beside_a_large_one_may_be_its_error_of_form() {
        let pair = [effect(0, true, 1000.0), effect(1, true, 30.0)];
        assert_eq!(trust_beside(&pair[1], &pair, NO_LAWS), 0.5);
        assert!(trust_beside(&pair[0], &pair, NO_LAWS) > 0.999);
    }

    #[test]
    fn an_effect_of_speed_is_no_error_of_form_of_a_curve() {
        // A delay beside leaves that touch one after the other, as in a pack that was looked at.
        let [leaves, delay] = [effect(0, true, 269_000.0), effect(1, false, 424.0)];
        let damping = effect(2, false, 424.0 / FORM_SHARE);
        assert_eq!(trust_beside(&delay, &[leaves], NO_LAWS), 1.0);
        assert_eq!(trust_beside(&delay, &[damping], NO_LAWS), 0.5);
    }

    #[test]
    fn the_laws_of_free_shape_count_less_where_the_path_was_given_away() {
        let laws = |path_given_away| FreeLaws {
            gain: 80_000.0,
            path_given_away,
        };
        for (follows_path, path_given_away, trust) in [
            (true, false, 0.25),
            (true, true, 0.25),
            (false, false, 0.25),
            (false, true, 0.625),
        ] {
            let alone = [effect(0, follows_path, 40.0)];
            let found = trust_beside(&alone[0], &alone, laws(path_given_away));
            assert!((found - trust).abs() < 1e-12, "{found}, not {trust}");
        }
    }
}
