//! Plots of values with their intervals, one below the other with their names (a forest plot), as SVG text.

use maud::{Markup, PreEscaped, html};

use super::svg::Ink;

/// Values with intervals over one axis.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct IntervalPlot {
    /// Quantity and unit of the axis.
    pub x_label: String,
    pub rows: Vec<IntervalRow>,
    /// Draws a line at 0, which is then always in view.
    pub zero: bool,
}

/// One value of the plot.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct IntervalRow {
    pub name: String,
    pub value: f64,
    pub low: f64,
    pub high: f64,
    /// Limits of the value, each drawn as a short line across the row.
    pub limits: [Option<f64>; 2],
    /// [`FOUND`] for a finding, [`NOT_FOUND`] for others.
    pub ink: Ink,
}

/// Colour of a finding.
pub(super) const FOUND: Ink = Ink::Twin;
/// Colour of a value that is no finding.
pub(super) const NOT_FOUND: Ink = Ink::Measured;
/// Colour of a value that is worth a look.
pub(super) const DOUBTFUL: Ink = Ink::Improved;

/// Sizes in px of the plot.
const WIDTH: f64 = 560.0;
const ROW: f64 = 24.0;
const TOP: f64 = 8.0;
/// PlotAxis with its figures and its label.
const BELOW: f64 = 54.0;
const NAME_TEXT: f64 = 15.0;
/// Width of an average character of a name, and the most that names take.
const CHARACTER: f64 = 8.2;
const MOST_NAME: usize = 26;
const MARGIN: f64 = 14.0;
/// Half the length of the line of a limit.
const LIMIT: f64 = 9.0;
/// Number of steps of the axis.
const STEPS: f64 = 5.0;

/// A scale from values to px.
struct PlotAxis {
    low: f64,
    high: f64,
    left: f64,
}

impl PlotAxis {
    fn of(plot: &IntervalPlot) -> PlotAxis {
        let ends = plot.rows.iter().flat_map(|r| {
            let limits = r.limits.into_iter().flatten();
            [r.value, r.low, r.high].into_iter().chain(limits)
        });
        let ends = ends.filter(|v| v.is_finite()).chain(plot.zero.then_some(0.0));
        let (low, high) = ends.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(v), high.max(v))
        });
        let (low, high) = match high - low {
            span if span > 0.0 => (low - 0.05 * span, high + 0.05 * span),
            0.0 => (low - 1.0, high + 1.0),
            _ => (-1.0, 1.0),
        };
        let longest = plot.rows.iter().map(|r| shortened(&r.name).chars().count()).max();
        let left = 2.0 * MARGIN + CHARACTER * longest.unwrap_or(0) as f64;
        PlotAxis { low, high, left }
    }

    fn px(&self, value: f64) -> f64 {
        let share = (value.clamp(self.low, self.high) - self.low) / (self.high - self.low);
        self.left + share * (WIDTH - MARGIN - self.left)
    }

    /// Round values of the axis, with the digits to print them with.
    fn ticks(&self) -> (Vec<f64>, usize) {
        let wanted = (self.high - self.low) / STEPS;
        let power = 10f64.powf(wanted.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .map(|f| f * power)
            .into_iter()
            .find(|s| *s >= wanted);
        let step = step.unwrap_or(10.0 * power);
        let first = (self.low / step).ceil() as i64;
        let last = (self.high / step).floor() as i64;
        let digits = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
        ((first..=last).map(|i| i as f64 * step).collect(), digits)
    }
}

/// The name, cut if it is too long for the plot.
fn shortened(name: &str) -> String {
    match name.chars().count() > MOST_NAME {
        true => name.chars().take(MOST_NAME - 1).chain(['\u{2026}']).collect(),
        false => name.to_owned(),
    }
}

impl IntervalPlot {
    /// The plot as the text of one `<svg>` element.
    pub(super) fn render(&self) -> String {
        let axis = PlotAxis::of(self);
        let bottom = TOP + ROW * self.rows.len() as f64;
        let height = bottom + BELOW;
        let quiet = Ink::Earlier.css();
        let (ticks, digits) = axis.ticks();
        html! {
            svg xmlns="http://www.w3.org/2000/svg" viewBox={ "0 0 " (WIDTH) " " (height) } font-family="sans-serif" role="img"
                aria-label=(self.x_label) {
                @for tick in &ticks {
                    @let x = px(axis.px(*tick));
                    line x1=(x) x2=(x) y1=(TOP) y2=(bottom) stroke=(quiet) stroke-opacity="0.3" {}
                    text x=(x) y=(bottom + 20.0) text-anchor="middle" font-size="14" fill=(quiet) { (format!("{tick:.digits$}")) }
                }
                @if self.zero {
                    @let x = px(axis.px(0.0));
                    line x1=(x) x2=(x) y1=(TOP) y2=(bottom) stroke=(quiet) stroke-width="2" {}
                }
                text x=(px(0.5 * (axis.left + WIDTH - MARGIN))) y=(bottom + 44.0) text-anchor="middle" font-size="15" fill=(quiet) {
                    (self.x_label)
                }
                @for (number, row) in self.rows.iter().enumerate() {
                    (row.render(&axis, TOP + ROW * (number as f64 + 0.5)))
                }
            }
        }
        .into_string()
    }
}

impl IntervalRow {
    fn render(&self, axis: &PlotAxis, y: f64) -> Markup {
        let colour = self.ink.css();
        let [low, value, high] = [self.low, self.value, self.high].map(|v| px(axis.px(v)));
        html! {
            text x=(px(axis.left - MARGIN)) y=(px(y + 5.0)) text-anchor="end" font-size=(NAME_TEXT) fill=(Ink::Earlier.css()) {
                (shortened(&self.name))
            }
            @for limit in self.limits.into_iter().flatten() {
                @let x = px(axis.px(limit));
                line x1=(x) x2=(x) y1=(px(y - LIMIT)) y2=(px(y + LIMIT)) stroke=(Ink::Earlier.css()) stroke-width="2" {}
            }
            line x1=(low) x2=(high) y1=(px(y)) y2=(px(y)) stroke=(colour) stroke-width="3" {}
            circle cx=(value) cy=(px(y)) r="5" fill=(colour) {}
        }
    }
}

/// A place in the plot, to a tenth of a px.
fn px(value: f64) -> PreEscaped<String> {
    PreEscaped(format!("{value:.1}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(name: &str, value: f64) -> IntervalRow {
        IntervalRow {
            name: name.to_owned(),
            value,
            low: value - 0.5,
            high: value + 0.5,
            limits: [None; 2],
            ink: NOT_FOUND,
        }
    }

    #[test]
    fn a_row_lies_at_its_place_on_the_axis() {
        let plot = IntervalPlot {
            x_label: "x in %".to_owned(),
            rows: vec![row("A", 1.0), row("B <2>", 3.0)],
            zero: true,
        };
        let axis = PlotAxis::of(&plot);
        assert!((axis.low + 0.175).abs() < 1e-12 && (axis.high - 3.675).abs() < 1e-12);
        assert_eq!(axis.ticks(), (vec![0.0, 1.0, 2.0, 3.0], 0));
        let svg = plot.render();
        assert!(svg.contains(&format!("cx=\"{:.1}\"", axis.px(3.0))), "{svg}");
        assert!(svg.contains("B &lt;2&gt;") && svg.contains("x in %"));
        assert_eq!(svg.matches("<circle").count(), 2);
    }

    #[test]
    fn values_without_a_spread_or_without_an_interval_are_drawn() {
        let alone = IntervalRow {
            low: f64::NAN,
            high: f64::INFINITY,
            ..row("A", 2.0)
        };
        let plot = IntervalPlot {
            x_label: String::new(),
            rows: vec![alone],
            zero: false,
        };
        let axis = PlotAxis::of(&plot);
        assert_eq!((axis.low, axis.high), (1.0, 3.0));
        let empty = IntervalPlot {
            rows: Vec::new(),
            ..plot
        };
        assert!(empty.render().contains("<svg"));
    }

    #[test]
    fn limits_are_in_view_and_drawn_beside_the_value() {
        let limited = IntervalRow {
            limits: [None, Some(9.0)],
            ..row("A", 2.0)
        };
        let plot = IntervalPlot {
            x_label: String::new(),
            rows: vec![limited, row("B", 2.0)],
            zero: false,
        };
        let axis = PlotAxis::of(&plot);
        assert!(axis.high > 9.0);
        let x = format!("x1=\"{:.1}\" x2=\"{0:.1}\" y1=\"11.0\" y2=\"29.0\"", axis.px(9.0));
        assert_eq!(plot.render().matches(&x).count(), 1, "{}", plot.render());
    }

    #[test]
    fn a_long_name_is_cut() {
        assert_eq!(shortened("short"), "short");
        assert_eq!(shortened(&"x".repeat(40)).chars().count(), MOST_NAME);
    }
}
