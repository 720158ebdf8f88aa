//! The figures that are asked of every world, one row each, then a row of all worlds together.

use super::CaseScore;
use super::statistics::{Proportion, calibration_error, median};
use crate::truth::{Family, World};

/// What is measured and what is asked, one for each column after the world.
pub(crate) const ASKED: [(&str, &str); 11] = [
    ("exact, one effect, strength 5 and up", "90 %, own 97 %"),
    ("exact, two effects, strength 5 and up", "75 %"),
    ("named or an alternative, strength 2 and up", "93 %"),
    ("wrong and sure", "at most 2 %"),
    ("adequate, nothing hidden", "95 %"),
    ("imperfection of the instruments said", "95 %"),
    ("unknown, outside the library", "95 %"),
    ("unknown, or named by a mechanism of the library", ""),
    ("located, median overlap", "0.7"),
    ("outside: error over noise, median", "at most 1.5"),
    ("calibration error", "at most 0.05"),
];

/// The figures of one world, in the order of [`ASKED`]; empty where no case counts.
pub(crate) fn cells(scores: &[CaseScore], world: World) -> Vec<String> {
    let of_world: Vec<CaseScore> = scores.iter().filter(|s| s.world == world).cloned().collect();
    figures(&of_world)
}

/// The figures of some cases, in the order of [`ASKED`].
fn figures(scores: &[CaseScore]) -> Vec<String> {
    let counted = |counts: &dyn Fn(&CaseScore) -> bool, holds: &dyn Fn(&CaseScore) -> bool| {
        let cases = scores.iter().filter(|s| counts(s));
        Proportion::of(cases.map(holds)).in_percent()
    };
    let strong = |s: &CaseScore, from: f64| s.label.strength >= from;
    let one = |s: &CaseScore| matches!(s.label.family, Family::Single | Family::Concealed);
    let outside = |s: &CaseScore| s.label.family == Family::Outside;
    let each = scores
        .iter()
        .filter(|s| s.label.family.is_in_library() && strong(s, 2.0))
        .flat_map(CaseScore::named_or_alternative);
    let overlaps = scores
        .iter()
        .filter(|s| strong(s, 2.0))
        .flat_map(CaseScore::overlaps);
    let errors = scores
        .iter()
        .filter(|s| outside(s))
        .filter_map(|s| s.answer.as_ref());
    let value = |(value, _): (Option<f64>, usize)| value.map_or(String::new(), |v| format!("{v:.2}"));
    vec![
        counted(&|s| one(s) && strong(s, 5.0), &CaseScore::exact),
        counted(
            &|s| s.label.family == Family::Pair && strong(s, 5.0),
            &CaseScore::exact,
        ),
        Proportion::of(each).in_percent(),
        counted(&|_| true, &CaseScore::is_wrong_and_sure),
        counted(&|s| s.label.family.hides_nothing(), &CaseScore::is_adequate),
        counted(
            &|s| s.label.family == Family::Nuisance,
            &CaseScore::says_its_nuisance,
        ),
        counted(&outside, &CaseScore::is_unknown),
        counted(&outside, &CaseScore::is_unknown_or_its_mechanism),
        value(median(overlaps.collect())),
        value(median(errors.map(|a| a.heldout).collect())),
        value(calibration_error(scores)),
    ]
}

/// The table in Markdown: a row for each world that has cases.
pub(crate) fn markdown(scores: &[CaseScore]) -> String {
    let (what, asked): (Vec<&str>, Vec<&str>) = ASKED.into_iter().unzip();
    let mut page = format!(
        "| world | {} |\n|{}\n| asked | {} |\n",
        what.join(" | "),
        "---|".repeat(ASKED.len() + 1),
        asked.join(" | ")
    );
    let has_cases = |world: &World| scores.iter().any(|s| s.world == *world);
    let worlds: Vec<World> = World::ALL.into_iter().filter(has_cases).collect();
    for world in &worlds {
        page += &format!("| {} | {} |\n", world.key(), cells(scores, *world).join(" | "));
    }
    if worlds.len() > 1 {
        page += &format!("| all worlds | {} |\n", figures(scores).join(" | "));
    }
    page
}

#[cfg(test)]
mod tests {
    use super::super::score::tests::score;
    use super::*;

    #[test]
    fn figures_by_hand() {
        let mut weak = score(&["inertia"], &[], &[]);
        weak.label.strength = 1.0;
        let mut outside = score(&["inertia"], &["inertia"], &[]);
        outside.label.family = Family::Outside;
        outside.label.hidden[0].code = "magnetic_catch";
        let scores = [
            score(&["inertia"], &["inertia"], &[]),
            score(&["inertia"], &["relaxation"], &["inertia"]),
            weak,
            score(&[], &[], &[]),
            outside,
        ];
        let found = cells(&scores, World::Own);
        assert_eq!(found.len(), ASKED.len());
        assert_eq!(found[0], "50 % (9 to 91)", "the weak case does not count");
        assert_eq!(found[1], "", "no pair");
        assert_eq!(found[2], "100 % (34 to 100)");
        assert_eq!(found[3], "40 % (12 to 77)");
        assert_eq!(found[4], "100 % (21 to 100)");
        assert_eq!(found[6], "0 % (0 to 79)");
        assert_eq!(found[9], "1.05");
        assert_eq!(cells(&scores, World::Pack)[0], "");
        assert_eq!(markdown(&scores).lines().count(), 4, "one world needs no sum");
        let mut elsewhere = score(&["inertia"], &["relaxation"], &[]);
        elsewhere.world = World::Pack;
        let page = markdown(&[&scores[..], &[elsewhere]].concat());
        let last = page.lines().last().expect("a row");
        assert!(last.starts_with("| all worlds | 33 % (6 to 79) |"), "{last}");
    }
}
