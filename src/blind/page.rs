//! The results of a blind test as plain text and as a page in Markdown.

use std::collections::BTreeSet;
use std::fmt::Write;

use super::requirements::{Requirement, requirements};
use super::statistics::{by_strength, confusion, reliability};
use super::{BlindRequest, CaseScore};
use crate::truth::{Family, limit};

/// Smallest strength of the cases in the confusion matrix.
const SHOWN_FROM: f64 = 2.0;

/// The reached value with its unit.
fn reached(requirement: &Requirement) -> String {
    match (requirement.reached, requirement.unit) {
        (None, _) => "no case".to_owned(),
        (Some(v), "%") => format!("{v:.1} %"),
        (Some(v), "s") => format!("{v:.2} s"),
        (Some(v), _) => format!("{v:.3}"),
    }
}

/// The table of requirements for a terminal.
pub(crate) fn text(request: &BlindRequest, scores: &[CaseScore]) -> String {
    let (drawn, look_alikes) = request.split(scores);
    let list = requirements(drawn, look_alikes);
    let width = list.iter().map(|r| r.what.len()).max().unwrap_or(0);
    let mut out = String::new();
    for r in &list {
        let met = match (r.reached, r.met) {
            (None, _) => "not measured",
            (_, true) => "met",
            (_, false) => "NOT MET",
        };
        let _ = writeln!(
            out,
            "{:width$}  {:>10}  (n = {:4})  {:32}  {met}",
            r.what,
            reached(r),
            r.count,
            r.required
        );
    }
    out
}

/// The page `docs/blind.md`.
pub(crate) fn markdown(request: &BlindRequest, hash: &str, scores: &[CaseScore]) -> String {
    let mut page = String::new();
    // Writing into a string cannot fail.
    let _ = write_page(&mut page, request, hash, scores);
    page
}

fn write_page(page: &mut String, request: &BlindRequest, hash: &str, all: &[CaseScore]) -> std::fmt::Result {
    let (scores, look_alikes) = request.split(all);
    let strength = request
        .strength
        .map_or(String::new(), |s| format!(" --strength {s}"));
    let kind = request
        .family
        .map_or(String::new(), |f| format!(" --kind {}", f.key()));
    writeln!(page, "# Blind test of the diagnosis\n")?;
    writeln!(
        page,
        "Made by `leafbench blind --cases {} --seed {}{strength}{kind}`. SHA-256 over all sealed labels, printed before the first\n\
         diagnosis:\n`{hash}`\n",
        request.cases, request.seed
    )?;
    writeln!(
        page,
        "The cases are made by `src/truth`, which shares no code with the diagnosis; a test checks this. A strength of 1 is the\n\
         detection limit: the part of an effect that no refit of the baseline absorbs has an RMS of {} sigma / sqrt(n), with n at\n\
         most {} effective samples for each branch of the motion. A run of fewer than 200 cases is not conclusive; this page\n\
         has {} cases{}.\n",
        limit::MULTIPLE,
        limit::SAMPLES_PER_BRANCH,
        scores.len(),
        match look_alikes.len() {
            0 => String::new(),
            n => format!(
                ". The rows of\n`--run-next` also use the next {n} cases with a look-alike of the same seed, because few cases need\nfurther tests"
            ),
        }
    )?;
    writeln!(
        page,
        "## Requirements\n\n| | required | reached | n | met |\n|---|---|---|---|---|"
    )?;
    for r in requirements(scores, look_alikes) {
        let met = if r.met { "yes" } else { "**no**" };
        writeln!(
            page,
            "| {} | {} | {} | {} | {met} |",
            r.what,
            r.required,
            reached(&r),
            r.count
        )?;
    }
    write_strengths(page, scores)?;
    write_settlings(page, all)?;
    write_reliability(page, scores)?;
    write_confusion(page, scores)?;
    write_wrong(page, scores)
}

fn write_strengths(page: &mut String, scores: &[CaseScore]) -> std::fmt::Result {
    writeln!(
        page,
        "\n## Right answers by kind and strength\n\n\
         An answer is right if it names exactly the hidden effects. Outside the library, the right answer is `unknown`. With a\n\
         look-alike, the hidden effect is named or is an alternative.\n\n\
         | kind | strength | right | of |\n|---|---|---|---|"
    )?;
    for ((family, strength), (right, all)) in by_strength(scores) {
        let strength = if strength == 0 {
            String::new()
        } else {
            strength.to_string()
        };
        writeln!(page, "| {} | {strength} | {right} | {all} |", family_name(family))?;
    }
    Ok(())
}

pub(super) fn family_name(family: Family) -> &'static str {
    match family {
        Family::None => "nothing hidden",
        Family::NoneNoisy => "nothing hidden, high noise",
        Family::Single => "one effect",
        Family::Pair => "two effects",
        Family::Confounded => "one effect with a look-alike, ramp and one sine",
        Family::Outside => "outside the library",
        Family::Concealed => "one effect, concealed by a tuned baseline",
        Family::Nuisance => "nothing hidden, imperfect instruments",
    }
}

/// One row for each case that needed further tests.
fn write_settlings(page: &mut String, scores: &[CaseScore]) -> std::fmt::Result {
    writeln!(
        page,
        "\n## Settled by further tests\n\n\
         Cases with a look-alike whose first answer named something other than exactly the hidden effect. `--run-next` records\n\
         the proposed profile with the specimen and the sensors of the case, adds the recording and repeats the diagnosis, with\n\
         {} tests at most. The bench has the speed of the shipped bench and a quarter more travel than was recorded. A case is\n\
         settled if the last answer names exactly the hidden effect and has no alternative. Any other last answer counts as not\n\
         settled, `unknown` too.\n\n\
         | case | strength | hidden | answers | tests | settled |\n|---|---|---|---|---|---|",
        super::settle::ROUNDS
    )?;
    for s in scores {
        let Some(tests) = &s.settling else { continue };
        let settled = match s.settled() {
            Some(true) => "yes".to_owned(),
            _ => format!("**no**: {}", tests.ended),
        };
        let (hidden, answers) = (s.truth().join(", "), tests.path.join("; "));
        writeln!(
            page,
            "| {} | {} | {hidden} | {answers} | {} | {settled} |",
            s.label.number,
            s.label.strength,
            tests.tests.join(", ")
        )?;
    }
    Ok(())
}

fn write_reliability(page: &mut String, scores: &[CaseScore]) -> std::fmt::Result {
    writeln!(
        page,
        "\n## Confidence against truth\n\n| confidence | named effects | mean confidence | share of true effects |\n|---|---|---|---|"
    )?;
    for b in reliability(scores) {
        writeln!(
            page,
            "| {:.1} to {:.1} | {} | {:.2} | {:.2} |",
            b.range[0], b.range[1], b.count, b.claimed, b.right
        )?;
    }
    Ok(())
}

fn write_confusion(page: &mut String, scores: &[CaseScore]) -> std::fmt::Result {
    let counts = confusion(scores, SHOWN_FROM);
    let rows: BTreeSet<&String> = counts.keys().map(|(t, _)| t).collect();
    let columns: BTreeSet<&String> = counts.keys().map(|(_, a)| a).collect();
    writeln!(
        page,
        "\n## Confusion matrix\n\nRows: hidden effect, strength {SHOWN_FROM} and up, without pairs. Columns: answer.\n"
    )?;
    let numbered: Vec<String> = columns.iter().map(|c| c.replace('_', " ")).collect();
    writeln!(page, "| | {} |", numbered.join(" | "))?;
    writeln!(page, "|---|{}", "---|".repeat(columns.len()))?;
    for truth in rows {
        let cells: Vec<String> = columns
            .iter()
            .map(|answer| match counts.get(&(truth.clone(), (*answer).clone())) {
                Some(n) if truth == *answer => format!("**{n}**"),
                Some(n) => n.to_string(),
                None => String::new(),
            })
            .collect();
        writeln!(page, "| {truth} | {} |", cells.join(" | "))?;
    }
    Ok(())
}

/// One row for each case without the right answer, strength 5 and up.
fn write_wrong(page: &mut String, scores: &[CaseScore]) -> std::fmt::Result {
    writeln!(
        page,
        "\n## Cases without the right answer, strength 5 and up\n\n| case | kind | strength | hidden | answered | alternatives |\n|---|---|---|---|---|---|"
    )?;
    for s in scores {
        let right = match s.label.family {
            Family::Outside => s.verdict() == crate::diagnose::Verdict::Unexplained,
            _ => s.exact(),
        };
        if right || (s.label.strength < 5.0 && !s.label.hidden.is_empty()) {
            continue;
        }
        let (named, others) = s.answer.as_ref().map_or_else(
            || (s.refused.clone().unwrap_or_default(), String::new()),
            |a| {
                let word = match a.codes().len() {
                    0 => a.word(),
                    _ => a.codes().join(", "),
                };
                (word, a.alternatives.join(", "))
            },
        );
        writeln!(
            page,
            "| {} | {} | {} | {} | {named} | {others} |",
            s.label.number,
            family_name(s.label.family),
            s.label.strength,
            s.truth().join(", ")
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::score::tests::score;
    use super::*;
    use crate::truth::World;

    #[test]
    fn text_and_page_have_every_requirement_and_the_confusion_matrix() {
        let scores = [
            score(&["inertia"], &["inertia"], &[]),
            score(&["inertia"], &["relaxation"], &["inertia"]),
        ];
        let request = BlindRequest {
            cases: 2,
            seed: 7,
            world: World::Own,
            strength: None,
            family: None,
            look_alikes: 0,
            threads: 1,
        };
        let page = markdown(&request, "abc", &scores);
        assert!(
            page.contains("--seed 7") && page.contains("`abc`") && page.contains("| inertia | **1** | 1 |")
        );
        assert!(page.contains("| 0 | one effect | 5 | inertia | relaxation | inertia |"));
        let text = text(&request, &scores);
        assert!(text.contains("50.0 %") && text.lines().count() == requirements(&scores, &[]).len());
    }
}
