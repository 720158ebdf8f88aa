//! Takes back a doubtful name beside a sure one: the law of the sure effect is known only in part, and what its formula misses looks like a
//! further effect.

use super::alternatives::JudgedEffect;
use super::rest::Rest;
use super::trust::{confidence_in, confidence_in_any};
use crate::diagnose::course::Split;
use crate::diagnose::fitting::{Data, FitContext, Node};
use crate::diagnose::search::SearchResult;

/// Confidence from which a name is sure enough to have an error of form that looks like another effect. At half, right names would be taken
/// back beside a doubtful one; at double, none.
const SURE_NAME: f64 = 0.85;
/// A further name is not given beside a sure one if it would be below this confidence without its rivals. Of 320 cases of four worlds that were
/// looked at, seven had a name below it, without an alternative, beside a sure one: in six it was wrong, in one it was the pack's own stiffening.
/// Beside a less sure name, 7 of 9 were right. At half, none of the seven is taken back; at double, right names are.
const DOUBTFUL_NAME: f64 = 0.45;

/// A doubtful name stays if the mean square on selecting cycles, or the noise if that is larger, would rise by more than this factor without
/// it. In two cases it would rise fivefold (a Coulomb friction that was there) and 2.5-fold (a compliance that was not); in two others by less
/// than 5 %. At half, no name would be taken back; at double, one of the two would stay.
const MOST_RISE: f64 = 1.5;

/// A name that is not given.
pub(super) struct Doubtful {
    /// Place in the chosen set.
    pub place: usize,
    pub code: &'static str,
    /// Confidence that it would have, 0 to 1.
    pub confidence: f64,
}

/// The least sure of several names, if it is doubtful and another one is sure.
pub(super) fn doubtful(
    context: &FitContext<'_>,
    search: &SearchResult,
    judged: &[JudgedEffect],
    rest: &Rest,
) -> Option<Doubtful> {
    if judged.len() < 2 {
        return None;
    }
    let sure = |j: &JudgedEffect| confidence_in(context, search, j, judged, rest);
    if judged.iter().all(|j| sure(j) < SURE_NAME) {
        return None;
    }
    // A rival, or a group, is no reason: then the doubt is which of them it is.
    let is_one = |j: &JudgedEffect| confidence_in_any(context, search, j, judged, rest);
    let each = judged.iter().map(|j| (j, is_one(j)));
    let (least, _) = each
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .filter(|(_, confidence)| *confidence < DOUBTFUL_NAME)?;
    let (place, confidence) = (least.place, sure(least));
    Some(Doubtful {
        place,
        code: search.nodes[search.chosen].attached[place].effect.code,
        confidence,
    })
}

/// True if a set explains selecting cycles so much worse than another that what it lacks is no error of form.
pub(super) fn is_much_worse(data: &Data, with: &Node, without: &Node) -> bool {
    let noise = data.count(Split::Select) as f64;
    without.select > MOST_RISE * with.select.max(noise)
}

/// The names that are not given, as the end of a summary.
pub(super) fn in_words(doubtful: &[Doubtful]) -> String {
    let each = doubtful.iter().map(|d| {
        format!(
            " A further effect, {}, would be named with {:.0} %: what the laws above miss can look like it, so it is not named.",
            d.code.replace('_', " "),
            100.0 * d.confidence
        )
    });
    each.collect()
}
