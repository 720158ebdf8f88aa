//! The page of `leafbench fleet report`: what was found as sentences, and for each kind of question one plot a quantity, with the table
//! behind it.

use maud::{Markup, PreEscaped, html};

use super::coverage;
use super::fleet_tables::{BENCHES, DRAWINGS, GROUPS, OPERATORS, SLOPES, SPECIMENS};
use super::html::{document, legend};
use super::interval_plot::{DOUBTFUL, FOUND, IntervalPlot, IntervalRow, NOT_FOUND};
use super::svg::Ink;
use crate::fleet::estimate::EstimateScale;
use crate::fleet::findings::{
    AgeUnit, DrawingJudgement, DrawingVerdict, FleetFindings, GroupLevel, PooledValue, QuantityFindings,
    QuantityRole, SpecimenDeviation,
};
use crate::fleet::predict::coverage::FleetCoverage;

/// Most rows of a plot: those that deviate most. The table has all of them.
const MOST_ROWS: usize = 40;

/// The page as HTML text. `table` is the name of the table of estimates; with `predictions` the page says how often they were right.
pub(crate) fn page(findings: &FleetFindings, table: &str, predictions: Option<&FleetCoverage>) -> String {
    let quantities = &findings.quantities;
    let body = html! {
        h1 { "Fleet report" }
        p { (lead(findings, table)) }
        (found(findings))
        (list("Worth a look", "These specimens deviate, but not by enough to be sure.", &findings.worth_a_look))
        (list("What this table cannot tell", "", &findings.cannot_tell))
        (legend(&[("found", FOUND), ("worth a look", DOUBTFUL), ("not different, as far as these runs can tell", NOT_FOUND)],
            "Lines are 95 % intervals of one value alone; what counts as found is corrected for all questions."))
        (section("Does a bench read differently?", BENCHES, quantities, bench_plot))
        (section("Does an operator measure differently?", OPERATORS, quantities, operator_plot))
        (section("What do families and batches have?", GROUPS, quantities, group_plot))
        (section("Does it change with cycles?", SLOPES, quantities, |q| slope_plot(q, AgeUnit::ThousandCycles)))
        (section("Does it change with time?", SLOPES, quantities, |q| slope_plot(q, AgeUnit::Year)))
        (section("Does a specimen differ from its family?", SPECIMENS, quantities, specimen_plot))
        (against_drawings(findings))
        @if let Some(predictions) = predictions {
            h2 { "Were the runs as predicted from those before them?" }
            (coverage::section(predictions))
        }
    };
    document("Fleet report", include_str!("loops.css"), &body)
}

fn lead(findings: &FleetFindings, table: &str) -> String {
    format!(
        "{table}: {} estimates of {} specimens in {} families, from {} benches and {} named operators. {} questions were asked; {}.",
        findings.rows,
        findings.specimens,
        findings.families,
        findings.benches,
        findings.operators,
        findings.questions,
        findings.sureness()
    )
}

fn found(findings: &FleetFindings) -> Markup {
    let causes = findings.bench_causes.iter().map(|c| c.sentence.as_str());
    let sentences: Vec<&str> = (findings.findings.iter().map(|f| f.sentence.as_str()))
        .chain(causes)
        .collect();
    html! {
        h2 { "Findings" }
        @if sentences.is_empty() { p { "Nothing was found." } }
        ul { @for sentence in sentences { li { (sentence) } } }
    }
}

/// A list under its heading; nothing if it is empty.
fn list(title: &str, lead: &str, sentences: &[String]) -> Markup {
    html! {
        @if !sentences.is_empty() {
            h2 { (title) }
            @if !lead.is_empty() { p { (lead) } }
            ul { @for sentence in sentences { li { (sentence) } } }
        }
    }
}

/// The plots of one question side by side; nothing if no quantity has one.
fn section(
    question: &str,
    table: &str,
    quantities: &[QuantityFindings],
    plot: impl Fn(&QuantityFindings) -> Option<IntervalPlot>,
) -> Markup {
    let plots: Vec<IntervalPlot> = quantities.iter().filter_map(plot).collect();
    html! {
        @if !plots.is_empty() {
            h2 { (question) }
            p { "The figures are in " a href=(table) { (table) } "." }
            div.pair {
                @for plot in &plots { div { (PreEscaped(plot.render())) } }
            }
        }
    }
}

/// Factor from a difference to what the plot shows, and its unit.
fn difference_scale(quantity: &QuantityFindings) -> (f64, &str) {
    match quantity.scale {
        EstimateScale::Relative => (100.0, "%"),
        EstimateScale::Absolute => (1.0, &quantity.unit),
    }
}

fn row(name: &str, value: &PooledValue, factor: f64) -> IntervalRow {
    IntervalRow {
        name: name.to_owned(),
        value: factor * value.value,
        low: factor * value.low95,
        high: factor * value.high95,
        limits: [None; 2],
        ink: if value.found { FOUND } else { NOT_FOUND },
    }
}

/// A plot about 0 of rows in the unit of a difference; `None` without rows.
fn differences(quantity: &QuantityFindings, what: &str, rows: Vec<IntervalRow>) -> Option<IntervalPlot> {
    let (_, unit) = difference_scale(quantity);
    (!rows.is_empty()).then(|| IntervalPlot {
        x_label: format!("{} {what} in {unit}", quantity.quantity),
        rows,
        zero: true,
    })
}

fn bench_plot(quantity: &QuantityFindings) -> Option<IntervalPlot> {
    let (factor, _) = difference_scale(quantity);
    let rows = quantity.benches.iter().map(|b| row(&b.name, &b.effect, factor));
    let what = match quantity.role {
        QuantityRole::InstrumentEffect => "on each bench",
        _ => "against the other benches",
    };
    differences(quantity, what, rows.collect())
}

fn operator_plot(quantity: &QuantityFindings) -> Option<IntervalPlot> {
    let (factor, _) = difference_scale(quantity);
    let rows = quantity.operators.iter().map(|o| row(&o.name, &o.effect, factor));
    differences(quantity, "against the other operators", rows.collect())
}

fn group_plot(quantity: &QuantityFindings) -> Option<IntervalPlot> {
    let name = |group: &GroupLevel| match &group.batch {
        Some(batch) if batch.is_empty() => format!("{} / no batch", group.family),
        Some(batch) => format!("{} / {batch}", group.family),
        None => group.family.clone(),
    };
    let is_found = |group: &GroupLevel| {
        group.level.found || group.from_other_batches.as_ref().is_some_and(|value| value.found)
    };
    let rows = quantity.groups.iter().map(|group| IntervalRow {
        ink: if is_found(group) { FOUND } else { NOT_FOUND },
        ..row(&name(group), &group.level, 1.0)
    });
    (quantity.role != QuantityRole::InstrumentEffect).then(|| IntervalPlot {
        x_label: format!("{} in {}", quantity.quantity, quantity.unit),
        rows: rows.take(MOST_ROWS).collect(),
        zero: quantity.role == QuantityRole::Effect,
    })
}

fn slope_plot(quantity: &QuantityFindings, per: AgeUnit) -> Option<IntervalPlot> {
    let (factor, _) = difference_scale(quantity);
    let slopes = quantity.slopes.iter().filter(|s| s.per == per);
    let rows = slopes.map(|s| row(s.family.as_deref().unwrap_or("all families"), &s.slope, factor));
    let rows = rows.take(MOST_ROWS).collect();
    differences(quantity, &format!("per {}", per.word()), rows)
}

fn specimen_plot(quantity: &QuantityFindings) -> Option<IntervalPlot> {
    let (factor, _) = difference_scale(quantity);
    let asked = |s: &&SpecimenDeviation| s.deviation.p.is_some();
    let mut specimens: Vec<&SpecimenDeviation> = quantity.specimen_deviations.iter().filter(asked).collect();
    specimens.sort_by(|a, b| b.deletion_t.abs().total_cmp(&a.deletion_t.abs()));
    let what = match specimens.len() > MOST_ROWS {
        true => format!("against the family, the {MOST_ROWS} clearest,"),
        false => "against the family".to_owned(),
    };
    specimens.truncate(MOST_ROWS);
    specimens.sort_by(|a, b| a.deviation.value.total_cmp(&b.deviation.value));
    let ink = |s: &SpecimenDeviation| -> Ink {
        match (s.deviation.found, s.worth_a_look) {
            (true, _) => FOUND,
            (false, true) => DOUBTFUL,
            (false, false) => NOT_FOUND,
        }
    };
    let rows = specimens.into_iter().map(|s| IntervalRow {
        ink: ink(s),
        ..row(&s.specimen, &s.deviation, factor)
    });
    differences(quantity, &what, rows.collect())
}

/// What the drawings say: counts, a plot for each quantity, and a row for each value that is not within.
fn against_drawings(findings: &FleetFindings) -> Markup {
    let judged = findings
        .quantities
        .iter()
        .flat_map(|quantity: &QuantityFindings| {
            let of_quantity = quantity.against_drawing.iter();
            of_quantity.map(move |judgement| (quantity, judgement))
        });
    let is_doubtful = |(_, j): &(&QuantityFindings, &DrawingJudgement)| j.verdict != DrawingVerdict::Within;
    let mut doubtful: Vec<_> = judged.filter(is_doubtful).collect();
    doubtful.sort_by(|(_, a), (_, b)| a.value.p.unwrap_or(1.0).total_cmp(&b.value.p.unwrap_or(1.0)));
    let figure = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.4}"));
    html! {
        @if let Some(counts) = &findings.against_drawings {
            (section("Is a specimen within the tolerance of its drawing?", DRAWINGS, &findings.quantities, drawing_plot))
            p { (counts.sentence()) " The short lines across a row are its limits. Undecided values have the colour of what is worth a look. All values are at 0 cycles, without the errors of the benches." }
            @if !doubtful.is_empty() {
                table {
                    tr {
                        @for head in ["Specimen", "Quantity", "Value", "95 % interval", "At least", "At most", "Verdict", ""] { th { (head) } }
                    }
                    @for (quantity, judgement) in doubtful.into_iter().take(MOST_ROWS) {
                        tr {
                            td { (judgement.specimen) }
                            td { (quantity.quantity) @if quantity.unit != "1" { " in " (quantity.unit) } }
                            td { (figure(Some(judgement.value.value))) }
                            td { (figure(Some(judgement.value.low95))) " to " (figure(Some(judgement.value.high95))) }
                            td { (figure(judgement.at_least)) }
                            td { (figure(judgement.at_most)) }
                            td { (judgement.verdict.words()) }
                            td { (judgement.remark.as_deref().unwrap_or_default()) }
                        }
                    }
                }
            }
        }
    }
}

/// Values with their limits: in percent of the nominal where all have one, else in the unit.
fn drawing_plot(quantity: &QuantityFindings) -> Option<IntervalPlot> {
    let mut judged: Vec<&DrawingJudgement> = quantity.against_drawing.iter().collect();
    judged.sort_by(|a, b| a.value.p.unwrap_or(1.0).total_cmp(&b.value.p.unwrap_or(1.0)));
    let what = match judged.len() > MOST_ROWS {
        true => format!(", the {MOST_ROWS} clearest"),
        false => String::new(),
    };
    judged.truncate(MOST_ROWS);
    let in_percent = judged
        .iter()
        .all(|j| j.nominal.is_some_and(|nominal| nominal > 0.0));
    let row = |j: &DrawingJudgement| {
        let of = |value: f64| match j.nominal {
            Some(nominal) if in_percent => 100.0 * (value / nominal - 1.0),
            _ => value,
        };
        IntervalRow {
            name: j.specimen.clone(),
            value: of(j.value.value),
            low: of(j.value.low95),
            high: of(j.value.high95),
            limits: [j.at_least, j.at_most].map(|limit| limit.map(of)),
            ink: match j.verdict {
                DrawingVerdict::OutOfTolerance => FOUND,
                DrawingVerdict::Within => NOT_FOUND,
                DrawingVerdict::Undecided => DOUBTFUL,
            },
        }
    };
    let mut rows: Vec<IntervalRow> = judged.into_iter().map(row).collect();
    rows.sort_by(|a, b| a.value.total_cmp(&b.value));
    let unit = match in_percent {
        true => "from the nominal in %",
        false => &format!("in {}", quantity.unit),
    };
    (!rows.is_empty()).then(|| IntervalPlot {
        x_label: format!("{} {unit}{what}", quantity.quantity),
        rows,
        zero: in_percent,
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::fleet::findings::{AgeSlope, DrawingCounts, FleetFinding, LevelEffect, QuestionKind};

    fn value(value: f64, found: bool) -> PooledValue {
        PooledValue {
            value,
            low95: value - 0.002,
            high95: value + 0.002,
            degrees: 20.0,
            p: Some(0.001),
            adjusted_p: Some(0.01),
            found,
        }
    }

    fn rate() -> QuantityFindings {
        let bench = LevelEffect {
            name: "B, \"2\"".to_owned(),
            against: vec!["B1".to_owned(), "B3".to_owned()],
            effect: value(0.01, true),
        };
        let group = GroupLevel {
            family: "F1".to_owned(),
            batch: None,
            benches: vec!["B1".to_owned()],
            specimens: 2,
            runs: 4,
            level: value(80.0, false),
            on_least_sure_bench: None,
            from_other_batches: None,
            largest_single_z: 2.0,
        };
        let specimen = SpecimenDeviation {
            specimen: "S<1>".to_owned(),
            family: "F1".to_owned(),
            batch: String::new(),
            benches: vec!["B1".to_owned()],
            runs: 2,
            deviation: value(-0.03, false),
            deletion_t: -5.0,
            normal_p: Some(1e-5),
            worth_a_look: true,
        };
        QuantityFindings {
            quantity: "rate_n_per_mm".to_owned(),
            unit: "N/mm".to_owned(),
            scale: EstimateScale::Relative,
            role: QuantityRole::Parameter,
            runs: 4,
            between_specimens: 0.01,
            run_to_run: 0.003,
            groups: vec![group],
            benches: vec![bench],
            operators: Vec::new(),
            slopes: vec![AgeSlope {
                per: AgeUnit::ThousandCycles,
                family: None,
                slope: value(0.0, false),
            }],
            specimen_deviations: vec![specimen],
            against_drawing: vec![judgement()],
        }
    }

    fn judgement() -> DrawingJudgement {
        DrawingJudgement {
            specimen: "S<1>".to_owned(),
            family: "F1".to_owned(),
            batch: String::new(),
            benches: vec!["B1".to_owned()],
            runs: 2,
            value: PooledValue {
                low95: 76.0,
                high95: 76.6,
                ..value(76.3, false)
            },
            nominal: Some(80.0),
            nominal_is_family_mean: false,
            at_least: Some(76.0),
            at_most: None,
            limits: "at least 95 % of the nominal".to_owned(),
            verdict: DrawingVerdict::Undecided,
            least_sure_bench: None,
            clearest_bench: None,
            clearest_p: 0.5,
            remark: Some("It is close.".to_owned()),
        }
    }

    /// Findings about one quantity, with a name that needs escaping.
    pub(in crate::report) fn findings() -> FleetFindings {
        FleetFindings {
            rows: 4,
            specimens: 2,
            families: 1,
            benches: 3,
            operators: 0,
            questions: 3,
            family_wise_error: 0.05,
            findings: vec![FleetFinding {
                kind: QuestionKind::Bench,
                quantity: "rate_n_per_mm".to_owned(),
                subject: "B2".to_owned(),
                adjusted_p: 0.01,
                sentence: "Bench <B2> reads higher.".to_owned(),
            }],
            against_drawings: Some(DrawingCounts {
                judged: 1,
                undecided: 1,
                ..DrawingCounts::default()
            }),
            worth_a_look: vec!["Specimen S<1> differs.".to_owned()],
            bench_causes: Vec::new(),
            cannot_tell: Vec::new(),
            quantities: vec![rate()],
        }
    }

    #[test]
    fn a_page_says_what_was_found_and_has_a_plot_for_each_question() {
        let page = page(&findings(), "estimates.csv", None);
        assert!(page.contains("Bench &lt;B2&gt; reads higher.") && page.contains("S&lt;1&gt;"));
        assert!(page.contains("at most 5 %") && page.contains("href=\"specimens.csv\""));
        // Benches, families, cycles, specimens and drawings; no operators and no years.
        assert_eq!(page.matches("<svg").count(), 5);
        assert!(page.contains("href=\"drawings.csv\"") && page.contains("1 undecided"));
        assert!(
            page.contains("<td>76.0000 to 76.6000</td><td>76.0000</td><td>-</td><td>undecided</td>"),
            "{page}"
        );
        assert!(!page.contains("operator measure") && !page.contains("cannot tell"));
        assert!(!page.contains("<script") && !page.contains("src="));
    }

    #[test]
    fn a_page_without_findings_says_so() {
        let mut nothing = findings();
        nothing.findings.clear();
        assert!(page(&nothing, "estimates.csv", None).contains("Nothing was found."));
    }

    #[test]
    fn the_colour_says_what_was_found() {
        let quantity = &findings().quantities[0];
        let inks = |plot: Option<IntervalPlot>| plot.expect("a plot").rows[0].ink;
        assert_eq!(inks(bench_plot(quantity)), FOUND);
        assert_eq!(inks(specimen_plot(quantity)), DOUBTFUL);
        assert_eq!(inks(group_plot(quantity)), NOT_FOUND);
        assert_eq!(inks(drawing_plot(quantity)), DOUBTFUL);
    }

    #[test]
    fn a_report_without_drawings_does_not_speak_of_them() {
        let mut without = findings();
        without.against_drawings = None;
        without.quantities[0].against_drawing.clear();
        let page = page(&without, "estimates.csv", None);
        assert_eq!(page.matches("<svg").count(), 4);
        assert!(!page.contains("drawing"));
    }

    #[test]
    fn limits_are_plotted_in_percent_of_the_nominal() {
        let mut quantity = findings().quantities.remove(0);
        let plot = drawing_plot(&quantity).expect("a plot");
        let limit = plot.rows[0].limits[0].expect("a limit");
        assert!((limit + 5.0).abs() < 1e-9 && plot.x_label.ends_with("from the nominal in %"));
        quantity.against_drawing[0].nominal = None;
        let plot = drawing_plot(&quantity).expect("a plot");
        assert!(plot.rows[0].limits == [Some(76.0), None] && plot.x_label.ends_with("in N/mm"));
    }
}
