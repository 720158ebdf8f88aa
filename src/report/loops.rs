//! The page with measured loops and the twin beside them.

use super::html::Page;
use super::svg::{self, Curve, MEASURED, MODEL, PlotError};

/// One run on the page.
#[derive(Debug, Clone, Default)]
pub struct LoopSection {
    /// Heading: the profile's name.
    pub title: String,
    /// Displacement in mm, force in N, twin force in N (NaN where it was off), a row a sample.
    pub samples: Vec<[f64; 3]>,
    /// The same over the last counted cycle; empty where the profile has no counted cycles.
    pub last_cycle: Vec<[f64; 3]>,
    /// Caption under the plots.
    pub caption: String,
}

/// The page: `summary` is a table of one row a run.
pub fn page(
    title: &str,
    lead: &str,
    head: &[&str],
    summary: &[Vec<String>],
    sections: &[LoopSection],
) -> Result<String, PlotError> {
    let mut page = Page::new(title, lead);
    page.table(head, summary);
    for section in sections {
        page.heading(&section.title);
        page.figure(&plot("whole run", &section.samples)?, &section.caption);
        if !section.last_cycle.is_empty() {
            page.figure(
                &plot("mean loop over counted cycles", &section.last_cycle)?,
                "Mean by phase.",
            );
        }
    }
    Ok(page.finish())
}

fn plot(title: &str, samples: &[[f64; 3]]) -> Result<String, PlotError> {
    let curve = |name: &str, column: usize, colour, width| Curve {
        name: name.to_owned(),
        points: samples.iter().map(|s| (s[0], s[column])).collect(),
        colour,
        width,
    };
    let curves = [curve("measured", 1, MEASURED, 2), curve("twin", 2, MODEL, 1)];
    svg::lines(title, "displacement / mm", "force / N", &curves, (620, 420))
}
