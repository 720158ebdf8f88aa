//! "Did you mean": the name that a mistyped one most likely stands for.

/// Most letters that may be wrong, missing, too many or swapped.
const MOST_TYPOS: usize = 2;
/// Least likeness (Jaro-Winkler, 0 to 1) of a name that differs by more than that. Names that only share a few letters are below.
const LEAST_LIKENESS: f64 = 0.85;

/// The name that is meant, if one is much like `wanted`: two typos, a part of the name, or the same beginning.
pub(crate) fn name<'a>(wanted: &str, known: &[&'a str]) -> Option<&'a str> {
    let lower = wanted.to_lowercase();
    let part = || {
        let mut having = known.iter().filter(|name| name.to_lowercase().contains(&lower));
        // A part of several names says nothing.
        having
            .next()
            .filter(|_| having.next().is_none() && !lower.is_empty())
    };
    let alike = || {
        let likeness = |name: &str| strsim::jaro_winkler(&lower, &name.to_lowercase());
        let best = known.iter().max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
        best.filter(|name| likeness(name) >= LEAST_LIKENESS)
    };
    typed_wrong(wanted, known).or_else(|| part().or_else(alike).copied())
}

/// The name that differs from `wanted` by two typos at most. Names that are all alike, such as run ids, need this rule.
pub(crate) fn typed_wrong<'a>(wanted: &str, known: &[&'a str]) -> Option<&'a str> {
    let typos = |name: &str| strsim::osa_distance(&wanted.to_lowercase(), &name.to_lowercase());
    let best = known.iter().min_by_key(|name| typos(name))?;
    let most = MOST_TYPOS.min(wanted.chars().count() / 2);
    (typos(best) <= most).then_some(*best)
}

/// `: did you mean NAME?` for an error, or nothing.
pub(crate) fn question(meant: Option<&str>) -> String {
    meant.map_or(String::new(), |name| format!(": did you mean {name}?"))
}

/// [`question`] about a list with commas, as errors have it. A field for the name that is meant would make all errors larger.
pub(crate) fn question_in(wanted: &str, list: &str) -> String {
    question(name(wanted, &list.split(", ").collect::<Vec<_>>()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mistyped_name_is_recognised_and_another_word_is_not() {
        let known = [
            "ramp-hold-steps",
            "sine-6mm-1hz",
            "static-ramp",
            "static-ramp-12s",
            "table",
        ];
        for (wanted, meant) in [
            ("static-rmp", Some("static-ramp")),
            ("Static-Ramp", Some("static-ramp")),
            ("static_ramp", Some("static-ramp")),
            ("statci-ramp", Some("static-ramp")),
            ("sine-6mm", Some("sine-6mm-1hz")),
            ("6mm", Some("sine-6mm-1hz")),
            ("no-such-profile", None),
            ("xy", None),
            ("", None),
        ] {
            assert_eq!(name(wanted, &known), meant, "{wanted}");
        }
    }

    #[test]
    fn run_ids_of_one_day_are_not_taken_for_each_other() {
        let runs = ["20261123t091621-abcd", "20261123t101500-wxyz"];
        assert_eq!(typed_wrong("20261123t091621-abcf", &runs), Some(runs[0]));
        assert_eq!(typed_wrong("20261123t081500-mnop", &runs), None);
    }
}
