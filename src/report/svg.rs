//! Plots as SVG text: curves over one pair of axes, with title and legend on request. The background is transparent and
//! the colours are readable on white and on near black.

use maud::html;
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// One line of a plot.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PlotCurve {
    /// Name in the legend; empty for none.
    pub name: String,
    /// Points in the order in which the line connects them. The line is broken at a point that is not finite.
    pub points: Vec<(f64, f64)>,
    pub ink: Ink,
}

/// Colour and line width of a curve, by what it shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ink {
    Measured,
    Twin,
    /// The model with the diagnosed effects added.
    Improved,
    /// An earlier cycle.
    Earlier,
    /// The branch with rising displacement.
    Loading,
    /// The branch with falling displacement.
    Unloading,
}

impl Ink {
    fn colour(self) -> RGBColor {
        match self {
            Ink::Measured | Ink::Loading => RGBColor(28, 113, 196),
            Ink::Twin | Ink::Unloading => RGBColor(222, 117, 26),
            Ink::Improved => RGBColor(22, 138, 84),
            Ink::Earlier => QUIET,
        }
    }

    /// Line width in px. The model's line is thinner than the measured line, so that both are visible where they agree.
    fn width(self) -> u32 {
        match self {
            Ink::Measured => 5,
            Ink::Loading | Ink::Unloading | Ink::Earlier => 3,
            Ink::Twin | Ink::Improved => 2,
        }
    }

    /// The colour as a CSS value.
    pub(crate) fn css(self) -> String {
        let RGBColor(r, g, b) = self.colour();
        format!("rgb({r},{g},{b})")
    }
}

impl PlotCurve {
    pub(crate) fn measured(name: &str, points: Vec<(f64, f64)>) -> PlotCurve {
        PlotCurve {
            name: name.to_owned(),
            points,
            ink: Ink::Measured,
        }
    }

    pub(crate) fn twin(name: &str, points: Vec<(f64, f64)>) -> PlotCurve {
        PlotCurve {
            name: name.to_owned(),
            points,
            ink: Ink::Twin,
        }
    }
}

/// Width and height of a plot that stands alone.
pub(crate) const LARGE: (u32, u32) = (860, 560);
/// Width and height of each of two plots side by side.
pub(crate) const HALF: (u32, u32) = (560, 380);
/// Axes and their text: the same grey reads on white and on near black.
const QUIET: RGBColor = RGBColor(118, 128, 136);
/// Background of marked regions.
const MARK: RGBColor = RGBColor(232, 180, 20);
/// Free space around the curves, as a fraction of their range.
const ROOM: f64 = 0.04;

/// Curves over one pair of axes, without title and legend, [`LARGE`].
pub(crate) fn xy_plot(x_label: &str, y_label: &str, curves: &[PlotCurve]) -> String {
    Plot {
        title: "",
        legend: false,
        x_label,
        y_label,
        curves,
        bands: &[],
        levels: &[],
        size: LARGE,
    }
    .render()
}

/// A picture that stands alone: with a title and a legend of the curves' names, [`LARGE`].
pub(crate) fn titled_plot(title: &str, x_label: &str, y_label: &str, curves: &[PlotCurve]) -> String {
    Plot {
        title,
        legend: true,
        x_label,
        y_label,
        curves,
        bands: &[],
        levels: &[],
        size: LARGE,
    }
    .render()
}

/// Curves over one pair of axes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plot<'a> {
    /// Printed above the plot; empty for none.
    pub title: &'a str,
    /// Lists the names of the curves above the plot. Curves with the same name share one entry, curves without a name have none.
    pub legend: bool,
    /// Quantity and unit of the abscissa.
    pub x_label: &'a str,
    /// Quantity and unit of the ordinate.
    pub y_label: &'a str,
    /// Drawn in this order: a later curve lies on an earlier one.
    pub curves: &'a [PlotCurve],
    /// Marked regions of the abscissa: from and to.
    pub bands: &'a [(f64, f64)],
    /// Shaded regions of the ordinate, such as noise about zero: from and to. They are always in view.
    pub levels: &'a [(f64, f64)],
    /// Width and height: [`LARGE`] or [`HALF`].
    pub size: (u32, u32),
}

/// The drawing surface of a plot.
type Area<'t> = DrawingArea<SVGBackend<'t>, Shift>;
/// Axes with their scales.
type Chart<'a, 't> = ChartContext<'a, SVGBackend<'t>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type DrawError<'t> = DrawingAreaErrorKind<<SVGBackend<'t> as DrawingBackend>::ErrorType>;
type Drawn<'t, T> = Result<T, DrawError<'t>>;

impl Plot<'_> {
    /// The plot as the text of one `<svg>` element.
    pub(crate) fn render(&self) -> String {
        let mut text = String::new();
        // Drawing into a string does not fail. If it ever does, the page shows the error and stays usable.
        match self.draw(&mut text).map_err(|error| format!("{error:?}")) {
            Ok(()) => text,
            Err(error) => html! { p { "This plot could not be drawn: " (error) } }.into_string(),
        }
    }

    fn draw<'t>(&self, text: &'t mut String) -> Drawn<'t, ()> {
        let curves: Vec<_> = self.curves.iter().map(|c| (c.ink, pieces(&c.points))).collect();
        let all = || curves.iter().flat_map(|(_, pieces)| pieces.iter().flatten());
        let shaded = || self.levels.iter().flat_map(|&(from, to)| [from, to]);
        let (x, y) = (
            range(all().map(|p| p.0)),
            range(all().map(|p| p.1).chain(shaded())),
        );
        let root = SVGBackend::with_string(text, self.size).into_drawing_area();
        let body = self.draw_head(&root)?;
        let mut chart = ChartBuilder::on(&body)
            .margin(12)
            .x_label_area_size(48)
            .y_label_area_size(72)
            .build_cartesian_2d(x.clone(), y.clone())?;
        self.draw_axes(&mut chart)?;
        for &(from, to) in self.bands {
            let (from, to) = (from.max(x.start), to.min(x.end));
            if from < to {
                let region = Rectangle::new([(from, y.start), (to, y.end)], MARK.mix(0.22).filled());
                chart.draw_series([region])?;
            }
        }
        for &(from, to) in self.levels {
            let region = Rectangle::new([(x.start, from), (x.end, to)], QUIET.mix(0.35).filled());
            chart.draw_series([region])?;
        }
        for (ink, pieces) in curves {
            let style = ink.colour().stroke_width(ink.width());
            for piece in pieces {
                // A line through one point has no length.
                match piece[..] {
                    [alone] => {
                        let dot = Circle::new(alone, ink.width(), ink.colour().filled());
                        chart.draw_series([dot])?;
                    }
                    _ => {
                        chart.draw_series(LineSeries::new(piece, style))?;
                    }
                }
            }
        }
        root.present()
    }

    fn draw_axes<'t>(&self, chart: &mut Chart<'_, 't>) -> Drawn<'t, ()> {
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(QUIET.mix(0.3))
            .axis_style(QUIET)
            .label_style(("sans-serif", 16, &QUIET))
            .axis_desc_style(("sans-serif", 17, &QUIET))
            .x_desc(self.x_label)
            .y_desc(self.y_label)
            .draw()
    }

    /// Draws title and legend at the top; returns the area that is left below them.
    fn draw_head<'t>(&self, root: &Area<'t>) -> Drawn<'t, Area<'t>> {
        let mut below = root.clone();
        if !self.title.is_empty() {
            let (head, rest) = below.split_vertically(TITLE_PX);
            let centred = Pos::new(HPos::Center, VPos::Center);
            let style = ("sans-serif", TITLE_TEXT_PX, &QUIET)
                .into_text_style(&head)
                .pos(centred);
            head.draw_text(self.title, &style, (self.size.0 as i32 / 2, TITLE_PX / 2 + 4))?;
            below = rest;
        }
        let entries = self.legend_entries();
        if !entries.is_empty() {
            let rows = legend_rows(&entries, self.size.0 as i32);
            let height = LEGEND_ROW_PX * (rows.last().map_or(0, |last| last.row) + 1) + 4;
            let (head, rest) = below.split_vertically(height);
            for (place, (name, ink)) in rows.iter().zip(&entries) {
                draw_legend_entry(&head, place, name, *ink)?;
            }
            below = rest;
        }
        Ok(below)
    }

    /// Name and ink of each entry, in the order of the curves.
    fn legend_entries(&self) -> Vec<(&str, Ink)> {
        let mut entries: Vec<(&str, Ink)> = Vec::new();
        for curve in self.curves.iter().filter(|c| self.legend && !c.name.is_empty()) {
            if !entries.iter().any(|(name, _)| *name == curve.name) {
                entries.push((&curve.name, curve.ink));
            }
        }
        entries
    }
}

/// Height of the title's strip and its text, in px of the plot.
const TITLE_PX: i32 = 34;
const TITLE_TEXT_PX: i32 = 20;
/// Height of one row of the legend, its text, and the width of an average character of it.
const LEGEND_ROW_PX: i32 = 24;
const LEGEND_TEXT_PX: i32 = 16;
const LEGEND_CHARACTER_PX: i32 = 8;
/// The legend begins at the left end of the abscissa. Length of a sample line, its distance to the text, and the distance between entries.
const LEGEND_LEFT_PX: i32 = 84;
const SAMPLE_PX: i32 = 28;
const SAMPLE_GAP_PX: i32 = 8;
const ENTRY_GAP_PX: i32 = 26;

/// Where an entry of the legend begins.
struct EntryPlace {
    x: i32,
    row: i32,
}

/// Sets the entries side by side; one that does not fit begins a new row.
fn legend_rows(entries: &[(&str, Ink)], width: i32) -> Vec<EntryPlace> {
    let (mut x, mut row) = (LEGEND_LEFT_PX, 0);
    let place = |(name, _): &(&str, Ink)| {
        let length = SAMPLE_PX + SAMPLE_GAP_PX + LEGEND_CHARACTER_PX * name.chars().count() as i32;
        if x > LEGEND_LEFT_PX && x + length > width {
            (x, row) = (LEGEND_LEFT_PX, row + 1);
        }
        let here = EntryPlace { x, row };
        x += length + ENTRY_GAP_PX;
        here
    };
    entries.iter().map(place).collect()
}

fn draw_legend_entry<'t>(area: &Area<'t>, place: &EntryPlace, name: &str, ink: Ink) -> Drawn<'t, ()> {
    let middle = LEGEND_ROW_PX * place.row + LEGEND_ROW_PX / 2 + 2;
    let line = [(place.x, middle), (place.x + SAMPLE_PX, middle)];
    area.draw(&PathElement::new(line, ink.colour().stroke_width(ink.width())))?;
    let style = ("sans-serif", LEGEND_TEXT_PX, &QUIET)
        .into_text_style(area)
        .pos(Pos::new(HPos::Left, VPos::Center));
    area.draw_text(name, &style, (place.x + SAMPLE_PX + SAMPLE_GAP_PX, middle))
}

/// The parts of a line between points that are not finite.
fn pieces(points: &[(f64, f64)]) -> Vec<Vec<(f64, f64)>> {
    let pieces = points.split(|(x, y)| !x.is_finite() || !y.is_finite());
    pieces.filter(|p| !p.is_empty()).map(<[_]>::to_vec).collect()
}

fn range(values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    });
    match high - low {
        span if span > 0.0 => low - ROOM * span..high + ROOM * span,
        0.0 => low - 1.0..high + 1.0,
        _ => 0.0..1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plot_has_both_curves_and_leaves_out_points_that_are_not_finite() {
        let svg = xy_plot(
            "x in mm",
            "y in N",
            &[
                PlotCurve::measured("a", vec![(0.0, 1.0), (1.0, f64::NAN), (2.0, 3.0)]),
                PlotCurve::twin("b", vec![(0.0, 1.0), (2.0, 2.0)]),
            ],
        );
        assert!(svg.starts_with("<svg") && svg.contains("x in mm"));
        assert!(svg.matches("<polyline").count() >= 2);
        assert!(svg.contains("#1C71C4") && svg.contains("#DE751A"), "both inks");
    }

    #[test]
    fn no_chord_is_drawn_across_what_was_not_measured() {
        let lines = |points: &[(f64, f64)]| {
            let svg = xy_plot("x", "y", &[PlotCurve::measured("", points.to_vec())]);
            (
                svg.matches("<polyline fill=\"none\" opacity=\"1\" stroke=\"#1C71C4\"")
                    .count(),
                svg.matches("<circle").count(),
            )
        };
        let gap = (f64::NAN, f64::NAN);
        let [a, b, c, d] = [(0.0, 1.0), (1.0, 2.0), (2.0, 3.0), (3.0, 1.0)];
        assert_eq!(lines(&[a, b, c, d]), (1, 0));
        assert_eq!(lines(&[a, b, gap, c, d]), (2, 0));
        assert_eq!(
            lines(&[gap, a, b, gap, gap, c, gap]),
            (1, 1),
            "a point alone is a dot"
        );
    }

    #[test]
    fn a_plot_without_curves_has_axes_and_no_curve() {
        let svg = xy_plot("x in mm", "y in N", &[]);
        assert!(svg.contains("x in mm") && svg.contains("y in N"), "{svg}");
        // The axes go from 0 to 1, and nothing is drawn in the inks of the curves.
        assert!(svg.contains("0.5") && !svg.contains("NaN"), "{svg}");
        assert!(!svg.contains("#1C71C4") && !svg.contains("#DE751A"), "{svg}");
    }

    #[test]
    fn title_and_legend_are_drawn_on_request_and_each_name_once() {
        let curves = [
            PlotCurve::measured("measured", vec![(0.0, 1.0), (2.0, 3.0)]),
            PlotCurve::twin("model <1>", vec![(0.0, 1.0), (2.0, 2.0)]),
            PlotCurve::twin("model <1>", vec![(0.0, 2.0), (2.0, 1.0)]),
        ];
        let plot = Plot {
            title: "Static loop",
            legend: true,
            x_label: "displacement in mm",
            y_label: "force in N",
            curves: &curves,
            bands: &[],
            levels: &[],
            size: HALF,
        };
        let svg = plot.render();
        for (text, times) in [("Static loop", 1), ("measured", 1), ("model &lt;1&gt;", 1)] {
            assert_eq!(svg.matches(text).count(), times, "{text}");
        }
        let plain = Plot {
            title: "",
            legend: false,
            ..plot
        }
        .render();
        assert!(!plain.contains("Static loop") && !plain.contains("measured"));
    }

    #[test]
    fn a_legend_entry_that_does_not_fit_begins_a_new_row() {
        let name = "n".repeat(30);
        let entries = [(name.as_str(), Ink::Measured); 3];
        let rows: Vec<i32> = legend_rows(&entries, 700).iter().map(|place| place.row).collect();
        assert_eq!(rows, [0, 0, 1]);
    }
    #[test]
    fn a_shaded_level_is_in_view_although_the_curves_lie_elsewhere() {
        let curves = [PlotCurve::twin("", vec![(1.0, 7.0), (2.0, 8.0)])];
        let plot = |levels: &[(f64, f64)]| {
            let plot = Plot {
                title: "",
                legend: false,
                x_label: "x in mm",
                y_label: "y in N",
                curves: &curves,
                bands: &[],
                levels,
                size: HALF,
            };
            plot.render()
        };
        let (plain, shaded) = (plot(&[]), plot(&[(-1.0, 1.0)]));
        assert_eq!(
            shaded.matches("<rect").count(),
            plain.matches("<rect").count() + 1
        );
        assert!(
            !plain.contains("0.0\n</text>") && shaded.contains("0.0\n</text>"),
            "{shaded}"
        );
    }
}
