//! A story on a page: numbered steps with text, pictures side by side, a table and links.

use maud::{Markup, PreEscaped, html};

use super::diagnosis_plots::{located_map, map_plot};
use super::html::legend;
use super::svg::{HALF, Ink, Plot, PlotCurve};
use crate::diagnose::diagnosis::Diagnosis;

/// A part of a page that tells what happened, step by step.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StoryPart {
    pub title: String,
    /// The paragraph under the title: what the story is about.
    pub lead: String,
    /// In the order in which they are numbered, from 1.
    pub steps: Vec<StoryStep>,
}

/// One step of a [`StoryPart`].
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct StoryStep {
    pub title: String,
    /// One entry for each paragraph.
    pub text: Vec<String>,
    /// Pictures that stand side by side.
    pub pictures: Vec<StoryPicture>,
    pub table: Option<StoryTable>,
    /// What follows from the step, in strong print; empty for nothing.
    pub conclusion: String,
    /// Paths, from the page's folder, of the files that the step links to.
    pub files: Vec<String>,
}

/// A plot with its legend.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StoryPicture {
    /// The plot as `<svg>` text. It goes into the page without escaping.
    pub svg: String,
    /// Names of the curves with their colours.
    pub legend: Vec<(&'static str, Ink)>,
    /// What else is in the plot, in weak print.
    pub remark: String,
}

/// A table whose first column names the rows.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StoryTable {
    /// Headings of the columns.
    pub head: Vec<&'static str>,
    /// Cells of each row, as many as headings.
    pub rows: Vec<Vec<String>>,
}

impl StoryPart {
    /// The part as HTML.
    pub(super) fn render(&self) -> Markup {
        html! {
            h2 { (self.title) }
            p { (self.lead) }
            @for (index, step) in self.steps.iter().enumerate() { (step.render(index + 1)) }
        }
    }
}

impl StoryStep {
    fn render(&self, number: usize) -> Markup {
        html! {
            h3 { (number) ". " (self.title) }
            @for paragraph in &self.text { p { (paragraph) } }
            @if !self.pictures.is_empty() {
                div.pair {
                    @for picture in &self.pictures { (picture.render()) }
                }
            }
            @if let Some(table) = &self.table { (table.render()) }
            @if !self.conclusion.is_empty() { p { strong { (self.conclusion) } } }
            @if !self.files.is_empty() {
                p {
                    @for file in &self.files { a href=(file) { (file) } " " }
                }
            }
        }
    }
}

impl StoryPicture {
    fn render(&self) -> Markup {
        html! {
            div.block { (PreEscaped(&self.svg)) (legend(&self.legend, &self.remark)) }
        }
    }
}

impl StoryTable {
    fn render(&self) -> Markup {
        // The first column has words, the others have figures.
        let class = |column: usize| (column > 0).then_some("n");
        html! {
            table {
                tr {
                    @for (column, name) in self.head.iter().enumerate() { th class=[class(column)] { (name) } }
                }
                @for row in &self.rows {
                    tr {
                        @for (column, cell) in row.iter().enumerate() { td class=[class(column)] { (cell) } }
                    }
                }
            }
        }
    }
}

/// Force over displacement, without a legend of its own.
pub(crate) fn loop_picture(
    curves: &[PlotCurve],
    legend: &[(&'static str, Ink)],
    remark: &str,
) -> StoryPicture {
    picture("force in N", curves, &[], legend, remark)
}

/// Measured minus model force over displacement; the shaded region is twice the standard deviation `noise_n` to both sides.
pub(crate) fn residual_picture(
    curves: &[PlotCurve],
    noise_n: f64,
    legend: &[(&'static str, Ink)],
    remark: &str,
) -> StoryPicture {
    let noise = (-2.0 * noise_n, 2.0 * noise_n);
    picture("measured minus twin in N", curves, &[noise], legend, remark)
}

fn picture(
    y_label: &str,
    curves: &[PlotCurve],
    levels: &[(f64, f64)],
    legend: &[(&'static str, Ink)],
    remark: &str,
) -> StoryPicture {
    let plot = Plot {
        title: "",
        legend: false,
        x_label: "displacement in mm",
        y_label,
        curves,
        bands: &[],
        levels,
        size: HALF,
    };
    StoryPicture {
        svg: plot.render(),
        legend: legend.to_vec(),
        remark: remark.to_owned(),
    }
}

/// The residuals of a diagnosis over the first axis with a located region, which is marked; `None` without residuals.
pub(crate) fn located_picture(d: &Diagnosis) -> Option<StoryPicture> {
    let map = located_map(d)?;
    let marked = d.location.iter().any(|l| l.axis == map.axis);
    let remark = if marked { "marked: where they differ" } else { "" };
    Some(StoryPicture {
        svg: map_plot(map, d).into_string(),
        legend: vec![
            ("measured minus refitted model, loading", Ink::Loading),
            ("unloading", Ink::Unloading),
            ("loading and unloading, with what is named", Ink::Improved),
        ],
        remark: remark.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_numbered_escaped_and_keep_their_pictures() {
        let noisy = residual_picture(&[], 0.5, &[("before", Ink::Twin)], "grey: noise");
        assert!(noisy.svg.starts_with("<svg"), "{}", noisy.svg);
        let step = |title: &str| StoryStep {
            title: title.to_owned(),
            text: vec!["x & y".to_owned()],
            pictures: vec![noisy.clone()],
            table: Some(StoryTable {
                head: vec!["what", "before"],
                rows: vec![vec!["peak".to_owned(), "1 %".to_owned()]],
            }),
            conclusion: "so > that".to_owned(),
            files: vec!["a/b.csv".to_owned()],
        };
        let part = StoryPart {
            title: "T".to_owned(),
            lead: "l".to_owned(),
            steps: vec![step("one"), step("<two>")],
        };
        let page = part.render().into_string();
        for wanted in [
            "1. one",
            "2. &lt;two&gt;",
            "x &amp; y",
            "grey: noise",
            "<strong>so &gt; that</strong>",
            "href=\"a/b.csv\"",
            "<td class=\"n\">1 %</td>",
        ] {
            assert!(page.contains(wanted), "{wanted}: {page}");
        }
        assert_eq!(page.matches("<svg").count(), 2);
    }
}
