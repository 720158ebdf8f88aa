//! Plots as SVG text. Colours come from the page's style, so that light and dark fit.

use plotters::prelude::*;

/// One line of a plot.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PlotCurve {
    /// For the legend.
    pub name: String,
    /// Points in order.
    pub points: Vec<(f64, f64)>,
    /// Which of the report's colours.
    pub ink: Ink,
}

/// Colours of a report: readable on white and on near black.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ink {
    /// What the sensors say.
    Measured,
    /// What the model says.
    Twin,
    /// What an improved model says.
    Improved,
    /// The branch on which the displacement rises.
    Loading,
    /// The branch on which it falls.
    Unloading,
    /// What was before, behind what matters.
    Faint,
}

impl Ink {
    fn colour(self) -> RGBColor {
        match self {
            Ink::Measured | Ink::Loading => RGBColor(28, 113, 196),
            Ink::Twin | Ink::Unloading => RGBColor(222, 117, 26),
            Ink::Improved => RGBColor(22, 138, 84),
            Ink::Faint => QUIET,
        }
    }

    /// A twin that fits lies on the measurement: the thin line stays visible on the wide one.
    fn width(self) -> u32 {
        match self {
            Ink::Measured => 5,
            Ink::Loading | Ink::Unloading => 3,
            Ink::Twin | Ink::Improved | Ink::Faint => 2,
        }
    }

    /// As CSS has it.
    pub(crate) fn css(self) -> String {
        let RGBColor(r, g, b) = self.colour();
        format!("rgb({r},{g},{b})")
    }
}

impl PlotCurve {
    /// A measured curve.
    pub(crate) fn measured(name: &str, points: Vec<(f64, f64)>) -> PlotCurve {
        PlotCurve {
            name: name.to_owned(),
            points,
            ink: Ink::Measured,
        }
    }

    /// The twin's curve.
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
/// Of one of two that stand side by side.
pub(crate) const HALF: (u32, u32) = (560, 380);
/// Axes and their text: the same grey reads on white and on near black.
const QUIET: RGBColor = RGBColor(118, 128, 136);
/// Behind what is to be looked at.
const MARK: RGBColor = RGBColor(232, 180, 20);
/// Free space around the curves.
const ROOM: f64 = 0.04;

/// Curves over one pair of axes. Points that are not finite are left out.
pub(crate) fn xy_plot(x_label: &str, y_label: &str, curves: &[PlotCurve]) -> String {
    let plot = Plot {
        x_label,
        y_label,
        curves,
        bands: &[],
        size: LARGE,
    };
    plot.render()
}

/// A picture that stands alone: with a title, and a legend of the curves' names.
pub(crate) fn titled_plot(title: &str, x_label: &str, y_label: &str, curves: &[PlotCurve]) -> String {
    let plot = Plot {
        x_label,
        y_label,
        curves,
        bands: &[],
        size: LARGE,
    };
    plot.render_with(Some(title))
}

/// A plot with regions of the abscissa marked.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plot<'a> {
    /// Under the abscissa.
    pub x_label: &'a str,
    /// Beside the ordinate.
    pub y_label: &'a str,
    /// What is drawn.
    pub curves: &'a [PlotCurve],
    /// Regions to mark, from and to.
    pub bands: &'a [(f64, f64)],
    /// [`LARGE`] or [`HALF`].
    pub size: (u32, u32),
}

impl Plot<'_> {
    /// As SVG text.
    pub(crate) fn render(&self) -> String {
        self.render_with(None)
    }

    /// With a title, the plot also gets a legend.
    fn render_with(&self, title: Option<&str>) -> String {
        let mut text = String::new();
        let drawn = self.draw(title, &mut text);
        // Drawing into a string has nothing that can fail; a defect shows in the page instead of ending the report.
        drawn.map_or_else(
            |error| {
                format!(
                    "<p>This plot could not be drawn: {}</p>",
                    super::html::escape(&error)
                )
            },
            |()| text,
        )
    }

    fn draw(&self, title: Option<&str>, text: &mut String) -> Result<(), String> {
        let finite = |points: &[(f64, f64)]| -> Vec<(f64, f64)> {
            points
                .iter()
                .copied()
                .filter(|(x, y)| x.is_finite() && y.is_finite())
                .collect()
        };
        let curves: Vec<_> = self.curves.iter().map(|c| (c, finite(&c.points))).collect();
        let all = || curves.iter().flat_map(|(_, points)| points);
        let (x, y) = (range(all().map(|p| p.0)), range(all().map(|p| p.1)));
        let root = SVGBackend::with_string(text, self.size).into_drawing_area();
        let failed = |e: DrawingAreaErrorKind<_>| format!("{e:?}");
        let mut builder = ChartBuilder::on(&root);
        if let Some(title) = title {
            builder.caption(title, ("sans-serif", 19, &QUIET));
        }
        let mut chart = builder
            .margin(12)
            .x_label_area_size(48)
            .y_label_area_size(72)
            .build_cartesian_2d(x.clone(), y.clone())
            .map_err(failed)?;
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
            .map_err(failed)?;
        for &(from, to) in self.bands {
            let (from, to) = (from.max(x.start), to.min(x.end));
            if from < to {
                let region = Rectangle::new([(from, y.start), (to, y.end)], MARK.mix(0.22).filled());
                chart.draw_series([region]).map_err(failed)?;
            }
        }
        for (curve, points) in curves {
            let style = curve.ink.colour().stroke_width(curve.ink.width());
            chart
                .draw_series(LineSeries::new(points, style))
                .map_err(failed)?
                .label(curve.name.as_str())
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 24, y)], style));
        }
        if title.is_some() {
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::UpperLeft)
                .margin(16)
                .legend_area_size(32)
                .label_font(("sans-serif", 16, &QUIET))
                .draw()
                .map_err(failed)?;
        }
        root.present().map_err(failed)?;
        Ok(())
    }
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
    fn a_plot_has_both_curves_and_survives_wild_points() {
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
    fn a_titled_plot_names_its_curves() {
        let curve = PlotCurve::measured("Table 5-1", vec![(0.0, 1.0), (2.0, 3.0)]);
        let svg = titled_plot("A loop", "x in mm", "y in N", &[curve]);
        assert!(
            ["A loop", "Table 5-1", "x in mm", "y in N"]
                .iter()
                .all(|word| svg.contains(word))
        );
    }

    #[test]
    fn an_empty_plot_is_a_plot() {
        assert!(xy_plot("x", "y", &[]).contains("</svg>"));
    }
}
