//! The figures as plain text and as a page in Markdown.

use std::collections::BTreeSet;
use std::fmt::Write;

use super::figures::{Figure, by_strength, confusion, figures, reliability};
use super::{BlindRequest, Mark};
use crate::truth::{Family, limit};

/// Strength from which the confusion matrix counts.
const SHOWN_FROM: f64 = 2.0;

fn reached(f: &Figure) -> String {
    match (f.reached, f.unit) {
        (None, _) => "no case".to_owned(),
        (Some(v), "%") => format!("{v:.1} %"),
        (Some(v), "s") => format!("{v:.2} s"),
        (Some(v), _) => format!("{v:.3}"),
    }
}

/// The table for a terminal.
pub(crate) fn text(request: &BlindRequest, marks: &[Mark]) -> String {
    let (drawn, look_alikes) = request.split(marks);
    let list = figures(drawn, look_alikes);
    let width = list.iter().map(|f| f.what.len()).max().unwrap_or(0);
    let mut out = String::new();
    for f in &list {
        let met = if f.met { "met" } else { "NOT MET" };
        let _ = writeln!(
            out,
            "{:width$}  {:>10}  (n = {:4})  {:32}  {met}",
            f.what,
            reached(f),
            f.count,
            f.asked
        );
    }
    out
}

/// The page kept under `docs/`.
pub(crate) fn markdown(request: &BlindRequest, seal: &str, marks: &[Mark]) -> String {
    let mut page = String::new();
    // Writing into a string cannot fail.
    let _ = write_page(&mut page, request, seal, marks);
    page
}

fn write_page(page: &mut String, request: &BlindRequest, seal: &str, all: &[Mark]) -> std::fmt::Result {
    let (marks, look_alikes) = request.split(all);
    let strength = request
        .strength
        .map_or(String::new(), |s| format!(" --strength {s}"));
    let kind = request
        .family
        .map_or(String::new(), |f| format!(" --kind {}", f.key()));
    writeln!(page, "# Proof on concealed effects\n")?;
    writeln!(
        page,
        "`leafbench blind --cases {} --seed {}{strength}{kind}`; SHA-256 over all sealed labels, taken before the first diagnosis:\n`{seal}`\n",
        request.cases, request.seed
    )?;
    writeln!(
        page,
        "The truth shares no code with the diagnosis (`src/truth`, held by a test). A strength of 1 is the detection limit: the\n\
         part of an effect that no refit of the baseline absorbs has an RMS of {} sigma / sqrt(n), n at most {} effective samples\n\
         for each branch of the motion. Anything under 200 cases is an anecdote; this page stands on {}{}.\n",
        limit::MULTIPLE,
        limit::SAMPLES_PER_BRANCH,
        marks.len(),
        match look_alikes.len() {
            0 => String::new(),
            n => format!(
                ", and\nits rows of `--run-next` on {n} more with a look-alike, the next of the same seed: few have anything to settle"
            ),
        }
    )?;
    writeln!(
        page,
        "## Figures\n\n| | asked for | reached | n | met |\n|---|---|---|---|---|"
    )?;
    for f in figures(marks, look_alikes) {
        let met = if f.met { "yes" } else { "**no**" };
        writeln!(
            page,
            "| {} | {} | {} | {} | {met} |",
            f.what,
            f.asked,
            reached(&f),
            f.count
        )?;
    }
    write_strengths(page, marks)?;
    write_settlings(page, all)?;
    write_reliability(page, marks)?;
    write_confusion(page, marks)?;
    write_wrong(page, marks)
}

fn write_strengths(page: &mut String, marks: &[Mark]) -> std::fmt::Result {
    writeln!(
        page,
        "\n## Right answers by kind and strength\n\nRight: the exact set; `unknown` for outsiders; named or an alternative for confounded cases.\n\n\
         | kind | strength | right | of |\n|---|---|---|---|"
    )?;
    for ((family, strength), (right, all)) in by_strength(marks) {
        let strength = if strength == 0 {
            String::new()
        } else {
            strength.to_string()
        };
        writeln!(page, "| {} | {strength} | {right} | {all} |", family_name(family))?;
    }
    Ok(())
}

fn family_name(family: Family) -> &'static str {
    match family {
        Family::None => "nothing hidden",
        Family::NoneNoisy => "nothing hidden, high noise",
        Family::Single => "one effect",
        Family::Pair => "two effects",
        Family::Confounded => "one with a look-alike, poor programme",
        Family::Outside => "outside the library",
        Family::Concealed => "one, concealed by a tuned baseline",
    }
}

/// Every case that had something to settle, test by test.
fn write_settlings(page: &mut String, marks: &[Mark]) -> std::fmt::Result {
    writeln!(
        page,
        "\n## Settled by the tests it asks for\n\n\
         Cases with a look-alike whose first answer was neither the true effect alone nor none at all. What `--run-next` does:\n\
         the profile that the diagnosis proposes is played on the case's own specimen and sensors, its recording is added, the\n\
         diagnosis judges again, {} tests at most. The bench is as fast as the shipped one and allows a quarter more travel than\n\
         was recorded. Settled: at the end the true effect is named, it alone, and nothing is left that it could be instead.\n\
         What is wrong and sure of it, or `unknown`, counts as not settled.\n\n\
         | case | strength | hidden | answers | tests | settled |\n|---|---|---|---|---|---|",
        super::settle::ROUNDS
    )?;
    for m in marks {
        let Some(s) = &m.settling else { continue };
        let settled = match m.settled() {
            Some(true) => "yes".to_owned(),
            _ => format!("**no**: {}", s.ended),
        };
        let (hidden, answers) = (m.truth().join(", "), s.path.join("; "));
        writeln!(
            page,
            "| {} | {} | {hidden} | {answers} | {} | {settled} |",
            m.label.number,
            m.label.strength,
            s.tests.join(", ")
        )?;
    }
    Ok(())
}

fn write_reliability(page: &mut String, marks: &[Mark]) -> std::fmt::Result {
    writeln!(
        page,
        "\n## Confidence against truth\n\n| confidence | claims | mean confidence | right |\n|---|---|---|---|"
    )?;
    for b in reliability(marks) {
        writeln!(
            page,
            "| {:.1} to {:.1} | {} | {:.2} | {:.2} |",
            b.range[0], b.range[1], b.count, b.claimed, b.right
        )?;
    }
    Ok(())
}

fn write_confusion(page: &mut String, marks: &[Mark]) -> std::fmt::Result {
    let counts = confusion(marks, SHOWN_FROM);
    let rows: BTreeSet<&String> = counts.keys().map(|(t, _)| t).collect();
    let columns: BTreeSet<&String> = counts.keys().map(|(_, a)| a).collect();
    writeln!(
        page,
        "\n## Confusion matrix\n\nRows: what was hidden (strength {SHOWN_FROM} and up, pairs left out); columns: what was answered.\n"
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

/// Every case that was not answered right, so that it can be looked at.
fn write_wrong(page: &mut String, marks: &[Mark]) -> std::fmt::Result {
    writeln!(
        page,
        "\n## Cases that were not exact, strength 5 and up\n\n| case | kind | strength | hidden | answered | alternatives |\n|---|---|---|---|---|---|"
    )?;
    for m in marks {
        let right = match m.label.family {
            Family::Outside => m.verdict() == crate::diagnose::Verdict::Unexplained,
            _ => m.exact(),
        };
        if right || (m.label.strength < 5.0 && !m.label.hidden.is_empty()) {
            continue;
        }
        let (named, others) = m.answer.as_ref().map_or_else(
            || (m.refused.clone().unwrap_or_default(), String::new()),
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
            m.label.number,
            family_name(m.label.family),
            m.label.strength,
            m.truth().join(", ")
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::score::tests::mark;
    use super::*;

    #[test]
    fn text_and_page_carry_every_figure_and_the_matrix() {
        let marks = [
            mark(&["inertia"], &["inertia"], &[]),
            mark(&["inertia"], &["relaxation"], &["inertia"]),
        ];
        let request = BlindRequest {
            cases: 2,
            seed: 7,
            strength: None,
            family: None,
            look_alikes: 0,
            threads: 1,
        };
        let page = markdown(&request, "abc", &marks);
        assert!(
            page.contains("--seed 7") && page.contains("`abc`") && page.contains("| inertia | **1** | 1 |")
        );
        assert!(page.contains("| 0 | one effect | 5 | inertia | relaxation | inertia |"));
        let text = text(&request, &marks);
        assert!(text.contains("50.0 %") && text.lines().count() == figures(&marks, &[]).len());
    }
}
