//! The results of a blind test by world and family: is the diagnosis right where the truth follows other equations?

use std::fmt::Write;

use super::CaseScore;
use super::page::family_name;
use super::statistics::{Proportion, calibration_error};
use super::world_figures;
use crate::truth::{Family, World};

/// Results of one family in one world. A proportion is `None` where it has no meaning.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct WorldRow {
    pub world: World,
    /// `None` for all families together.
    pub family: Option<Family>,
    pub cases: usize,
    /// Exactly the hidden effects are named.
    pub exact: Option<Proportion>,
    /// Each hidden effect is named or an alternative.
    pub named: Option<Proportion>,
    /// An effect that is not there is named with a confidence of at least 0.9.
    pub wrong_and_sure: Proportion,
    /// Nothing is missing, where nothing is.
    pub adequate: Option<Proportion>,
    /// What is imperfect about the recordings is said.
    pub said: Option<Proportion>,
    /// `unknown`, where the library does not have the effect.
    pub unknown: Option<Proportion>,
    /// Expected calibration error of the confidence; `None` if nothing is named.
    pub calibration_error: Option<f64>,
}

/// One row for each family of each world, and one for each world.
pub(crate) fn rows(scores: &[CaseScore]) -> Vec<WorldRow> {
    let mut rows = Vec::new();
    for world in World::ALL {
        let of_world: Vec<&CaseScore> = scores.iter().filter(|s| s.world == world).collect();
        if of_world.is_empty() {
            continue;
        }
        for family in Family::ALL {
            let of_family = of_world.iter().filter(|s| s.label.family == family);
            rows.extend(row(world, Some(family), &of_family.copied().collect::<Vec<_>>()));
        }
        rows.extend(row(world, None, &of_world));
    }
    rows
}

fn row(world: World, family: Option<Family>, scores: &[&CaseScore]) -> Option<WorldRow> {
    let proportion = |counts: fn(Family) -> bool, holds: fn(&CaseScore) -> bool| {
        let counted = scores.iter().filter(|s| counts(s.label.family));
        Some(Proportion::of(counted.map(|s| holds(s)))).filter(|p| p.of > 0)
    };
    let owned: Vec<CaseScore> = scores.iter().map(|s| (*s).clone()).collect();
    (!scores.is_empty()).then(|| WorldRow {
        world,
        family,
        cases: scores.len(),
        exact: proportion(Family::is_in_library, CaseScore::exact),
        named: proportion(Family::is_in_library, |s| {
            s.named_or_alternative().iter().all(|n| *n)
        }),
        wrong_and_sure: Proportion::of(scores.iter().map(|s| s.is_wrong_and_sure())),
        adequate: proportion(Family::hides_nothing, CaseScore::is_adequate),
        said: proportion(|f| f == Family::Nuisance, CaseScore::says_its_nuisance),
        unknown: proportion(|f| f == Family::Outside, CaseScore::is_unknown),
        calibration_error: calibration_error(&owned).0,
    })
}

/// Headings of the table.
const HEADINGS: [&str; 10] = [
    "world",
    "family",
    "n",
    "exact",
    "named or an alternative",
    "wrong and sure",
    "adequate",
    "imperfection said",
    "unknown",
    "calibration error",
];

fn cells(row: &WorldRow) -> [String; 10] {
    let share = |p: &Option<Proportion>| p.map_or(String::new(), Proportion::in_percent);
    [
        row.world.key().to_owned(),
        row.family.map_or("all", family_name).to_owned(),
        row.cases.to_string(),
        share(&row.exact),
        share(&row.named),
        share(&Some(row.wrong_and_sure)),
        share(&row.adequate),
        share(&row.said),
        share(&row.unknown),
        row.calibration_error.map_or(String::new(), |e| format!("{e:.2}")),
    ]
}

/// The table for a terminal.
pub(crate) fn text(rows: &[WorldRow]) -> String {
    let table: Vec<[String; 10]> = std::iter::once(HEADINGS.map(str::to_owned))
        .chain(rows.iter().map(cells))
        .collect();
    let widths: Vec<usize> = (0..HEADINGS.len())
        .map(|c| table.iter().map(|r| r[c].len()).max().unwrap_or(0))
        .collect();
    let mut out = String::new();
    for row in &table {
        let line: Vec<String> = row
            .iter()
            .zip(&widths)
            .map(|(cell, w)| format!("{cell:w$}"))
            .collect();
        // Writing into a string cannot fail.
        let _ = writeln!(out, "{}", line.join("  ").trim_end());
    }
    out + "Shares in % with their 95 % intervals (Wilson).\n"
}

/// The table and the cases that are wrong and sure, as a page in Markdown. `hashes` are those over all sealed labels of each world.
pub(crate) fn markdown(seed: u64, hashes: &[(World, String)], scores: &[CaseScore]) -> String {
    let mut page = format!(
        "# Blind test of the diagnosis, by world\n\nSeed {seed}. SHA-256 over all sealed labels of a world, before its first diagnosis:\n\n"
    );
    for (world, hash) in hashes {
        page += &format!("- {}: `{hash}`\n", world.key());
    }
    page += "\nIn `own` each effect has one formula, close to that of the library. In the other worlds the friction of the specimen is\n\
             another operator, and each effect follows one of several laws that the library does not have. Shares with their 95 %\n\
             intervals (Wilson). Wrong and sure: an effect that is not there is named with a confidence of at least 0.9.\n\n";
    page += &world_figures::markdown(scores);
    page += "\n## By family\n\n";
    page += &format!(
        "| {} |\n|{}\n",
        HEADINGS.join(" | "),
        "---|".repeat(HEADINGS.len())
    );
    for row in rows(scores) {
        page += &format!("| {} |\n", cells(&row).join(" | "));
    }
    page += "\n## Wrong and sure\n\n| world | case | family | hidden | law or imperfection | strength | answered |\n|---|---|---|---|---|---|---|\n";
    for s in scores.iter().filter(|s| s.is_wrong_and_sure()) {
        let laws = s.label.hidden.iter().filter_map(|h| h.law.map(|l| l.name));
        let laws: Vec<&str> = laws.chain(s.label.nuisance).collect();
        page += &format!(
            "| {} | {} | {} | {} | {} | {} | {} |\n",
            s.world.key(),
            s.label.number,
            family_name(s.label.family),
            s.truth().join(", "),
            laws.join("; "),
            s.label.strength,
            s.answer.as_ref().map_or(String::new(), super::Answer::in_words)
        );
    }
    page
}

#[cfg(test)]
mod tests {
    use super::super::score::tests::score;
    use super::*;

    #[test]
    fn a_row_for_each_family_and_for_the_world() {
        let scores = [
            score(&["inertia"], &["inertia"], &[]),
            score(&["inertia"], &["relaxation"], &["inertia"]),
            score(&[], &[], &[]),
        ];
        let found = rows(&scores);
        assert_eq!(found.len(), 3);
        let single = &found[1];
        assert_eq!((single.family, single.cases), (Some(Family::Single), 2));
        let counts = |p: Option<Proportion>| p.map(|p| (p.yes, p.of));
        assert_eq!(counts(single.exact), Some((1, 2)));
        assert_eq!(counts(single.named), Some((2, 2)));
        assert_eq!(counts(Some(single.wrong_and_sure)), Some((1, 2)));
        assert_eq!(counts(single.adequate), None);
        assert_eq!(counts(found[0].adequate), Some((1, 1)));
        assert_eq!((found[2].family, found[2].cases), (None, 3));
        assert!(text(&found).contains("50 % (9 to 91)"), "{}", text(&found));
        let page = markdown(7, &[], &scores);
        assert!(
            page.contains("| own | 0 | one effect | inertia |  | 5 | relaxation or inertia |"),
            "{page}"
        );
    }

    #[test]
    fn what_is_not_wrong_is_neither_exact_truth_nor_a_false_alarm() {
        let mut beside = score(&[], &["channel_delay"], &[]);
        beside.label.family = Family::Nuisance;
        assert!(!beside.is_adequate() && beside.is_wrong_and_sure());
        beside.label.also = vec!["channel_delay"];
        assert!(beside.is_adequate() && !beside.is_wrong_and_sure());
    }
}
