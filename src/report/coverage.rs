//! The page of `leafbench fleet coverage`: the share of the runs inside their predicted intervals over the level of the intervals.

use maud::{Markup, PreEscaped, html};

use super::fleet_tables::cell;
use super::html::{document, legend};
use super::svg::{HALF, Ink, Plot, PlotCurve};
use crate::fleet::predict::coverage::{FleetCoverage, PredictedRun, QuantityCoverage, ShareInside};

/// Steps of the level in a plot.
const STEPS: u32 = 50;
/// Columns of the table of runs.
const COLUMNS: &str = "run_id,specimen,family,bench,quantity,unit,estimate,predicted,low50,high50,low95,high95,degrees,\
                       runs_of_specimen,runs_of_family,level,inside50,inside95\n";

/// The page as HTML text. `source` is the name of the table or archive.
pub(crate) fn page(found: &FleetCoverage, source: &str) -> String {
    let body = html! {
        h1 { "Coverage of predictions" }
        p { (source) ": each run is predicted from the runs that began before it." }
        (section(found))
    };
    document("Coverage of predictions", include_str!("loops.css"), &body)
}

/// Figures and plots, for this page and for the fleet report.
pub(super) fn section(found: &FleetCoverage) -> Markup {
    let all = &found.all;
    let plot = |of: &QuantityCoverage| {
        let runs = found
            .runs
            .iter()
            .filter(|run| of.quantity.is_empty() || run.predicted.quantity == of.quantity);
        share_plot(of.name(), runs)
    };
    html! {
        p {
            "Inside 95 %: " (all.shares[1].words()) ". With earlier runs of the specimen: " (all.seen95.words())
            ". Without: " (all.unseen95.words()) ". " (found.not_predicted) " estimates had too few runs before them."
        }
        table {
            thead { tr { th { "Quantity" } th { "Inside 50 %" } th { "Inside 95 %" } } }
            tbody { @for of in std::iter::once(all).chain(&found.quantities) { tr {
                td { (of.name()) }
                @for share in &of.shares { td { (share.words()) } }
            } } }
        }
        (legend(&[("runs inside", Ink::Measured), ("a prediction that is right", Ink::Earlier)],
            "Above the straight line the intervals are too wide, below it too narrow."))
        div.pair { @for of in std::iter::once(all).chain(&found.quantities) { div { (PreEscaped(plot(of))) } } }
    }
}

/// Share of the runs inside over the level of the interval.
fn share_plot<'p>(name: &str, runs: impl Iterator<Item = &'p PredictedRun>) -> String {
    let levels: Vec<f64> = runs.map(|run| run.level).collect();
    let at = |step: u32| {
        let level = f64::from(step) / f64::from(STEPS);
        let share = ShareInside::of(level, levels.iter().copied());
        (
            100.0 * level,
            100.0 * share.inside as f64 / share.of.max(1) as f64,
        )
    };
    let curves = [
        PlotCurve {
            name: "right".to_owned(),
            points: vec![(0.0, 0.0), (100.0, 100.0)],
            ink: Ink::Earlier,
        },
        PlotCurve::measured("inside", (0..=STEPS).map(at).collect()),
    ];
    Plot {
        title: name,
        legend: false,
        x_label: "level of the interval in %",
        y_label: "runs inside in %",
        curves: &curves,
        bands: &[],
        levels: &[],
        size: HALF,
    }
    .render()
}

/// One row for each quantity of each run.
pub(crate) fn table(found: &FleetCoverage) -> String {
    let row = |run: &PredictedRun| {
        let p = &run.predicted;
        let [low50, high50] = p.interval(0.5);
        let names = [
            &run.run_id,
            &run.specimen,
            &run.family,
            &run.bench,
            &p.quantity,
            &p.unit,
        ]
        .map(|n| cell(n));
        let numbers = [
            run.estimate,
            p.predicted,
            low50,
            high50,
            p.low95,
            p.high95,
            p.degrees,
        ]
        .map(|v| v.to_string());
        format!(
            "{},{},{},{},{},{},{}\n",
            names.join(","),
            numbers.join(","),
            p.runs_of_specimen,
            p.runs_of_family,
            run.level,
            run.level <= 0.5,
            run.level <= 0.95
        )
    };
    std::iter::once(COLUMNS.to_owned())
        .chain(found.runs.iter().map(row))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::estimate::read_estimates;
    use crate::fleet::predict::coverage::coverage;

    #[test]
    fn the_page_has_a_plot_for_each_quantity_and_one_for_all() {
        let text = include_str!("../../examples/estimates.csv");
        let found = coverage(&read_estimates("estimates.csv", text.as_bytes()).expect("shipped"));
        let page = page(&found, "a<b.csv");
        assert_eq!(page.matches("<svg").count(), 1 + found.quantities.len());
        assert!(page.contains("a&lt;b.csv") && page.contains(&found.all.shares[1].words()));
        let table = table(&found);
        assert_eq!(table.lines().count(), 1 + found.runs.len());
        let cells = |line: &str| line.split(',').count();
        assert!(table.lines().all(|line| cells(line) == cells(COLUMNS)), "{table}");
    }
}
