//! Line plots as SVG text.

use plotters::prelude::*;

/// One curve of a plot.
#[derive(Debug, Clone)]
pub struct Curve {
    /// What the legend calls it.
    pub name: String,
    /// x and y in the axes' units; a NaN lifts the pen.
    pub points: Vec<(f64, f64)>,
    /// Red, green, blue.
    pub colour: (u8, u8, u8),
    /// Width of the line in px.
    pub width: u32,
}

/// Colour of what was measured.
pub const MEASURED: (u8, u8, u8) = (31, 78, 121);
/// Colour of the twin or model.
pub const MODEL: (u8, u8, u8) = (214, 90, 24);
/// Most points that a curve is drawn with: finer than a screen shows, small enough to open at once.
const MAX_POINTS: usize = 4000;

/// Why a plot could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("plot \"{title}\" cannot be drawn: {reason}")]
pub struct PlotError {
    title: String,
    reason: String,
}

/// A plot of curves over common axes, `size` in px. Axis labels carry their unit.
pub fn lines(
    title: &str,
    x_label: &str,
    y_label: &str,
    curves: &[Curve],
    size: (u32, u32),
) -> Result<String, PlotError> {
    let mut text = String::new();
    draw(&mut text, title, x_label, y_label, curves, size).map_err(|reason| PlotError {
        title: title.to_owned(),
        reason,
    })?;
    Ok(text)
}

fn draw(
    text: &mut String,
    title: &str,
    x_label: &str,
    y_label: &str,
    curves: &[Curve],
    size: (u32, u32),
) -> Result<(), String> {
    let said = |e: &dyn std::fmt::Display| e.to_string();
    let root = SVGBackend::with_string(text, size).into_drawing_area();
    root.fill(&WHITE).map_err(|e| said(&e))?;
    let (x, y) = (extent(curves, |p| p.0), extent(curves, |p| p.1));
    let mut chart = ChartBuilder::on(&root)
        .caption(title, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(64)
        .build_cartesian_2d(x.0..x.1, y.0..y.1)
        .map_err(|e| said(&e))?;
    chart
        .configure_mesh()
        .x_desc(x_label)
        .y_desc(y_label)
        .label_style(("sans-serif", 13))
        .axis_desc_style(("sans-serif", 14))
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(225, 225, 225))
        .draw()
        .map_err(|e| said(&e))?;
    for curve in curves {
        let (r, g, b) = curve.colour;
        let style = RGBColor(r, g, b).stroke_width(curve.width);
        let mut named = false;
        for piece in thinned(&curve.points).split(|p| !(p.0.is_finite() && p.1.is_finite())) {
            if piece.is_empty() {
                continue;
            }
            let drawn = chart
                .draw_series(LineSeries::new(piece.iter().copied(), style))
                .map_err(|e| said(&e))?;
            if !std::mem::replace(&mut named, true) {
                drawn
                    .label(&curve.name)
                    .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 22, y)], style));
            }
        }
    }
    if curves.len() > 1 {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperLeft)
            .background_style(WHITE.mix(0.85))
            .border_style(RGBColor(200, 200, 200))
            .label_font(("sans-serif", 13))
            .draw()
            .map_err(|e| said(&e))?;
    }
    root.present().map_err(|e| said(&e))
}

/// Range of one coordinate over all curves with a margin; never empty.
fn extent(curves: &[Curve], of: fn(&(f64, f64)) -> f64) -> (f64, f64) {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for value in curves
        .iter()
        .flat_map(|c| &c.points)
        .map(of)
        .filter(|v| v.is_finite())
    {
        low = low.min(value);
        high = high.max(value);
    }
    if low > high {
        return (0.0, 1.0);
    }
    let margin = 0.04 * (high - low).max(1e-9 * high.abs()).max(1e-9);
    (low - margin, high + margin)
}

/// Every n-th point, the last one always.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let step = points.len().div_ceil(MAX_POINTS).max(1);
    let mut kept: Vec<_> = points.iter().step_by(step).copied().collect();
    if !(points.len() + step - 1).is_multiple_of(step) {
        kept.extend(points.last());
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plot_is_one_svg_with_its_labels_and_lifts_the_pen_at_nan() {
        let curve = Curve {
            name: "measured".into(),
            points: vec![
                (0.0, 0.0),
                (1.0, 2.0),
                (f64::NAN, f64::NAN),
                (2.0, 1.0),
                (3.0, 0.0),
            ],
            colour: MEASURED,
            width: 2,
        };
        let svg = lines("Loop", "displacement / mm", "force / N", &[curve], (640, 400)).expect("draws");
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
        assert!(svg.contains("displacement / mm") && svg.contains("force / N"));
        assert_eq!(
            svg.matches("<polyline").count() - svg.matches("stroke=\"#E1E1E1\"").count() > 1,
            true
        );
    }

    #[test]
    fn long_curves_are_thinned_and_keep_their_end() {
        let points: Vec<_> = (0..100_001).map(|i| (f64::from(i), 0.0)).collect();
        let kept = thinned(&points);
        assert!(kept.len() <= MAX_POINTS + 1);
        assert_eq!(kept.last(), points.last());
    }

    #[test]
    fn nothing_to_draw_is_still_a_plot() {
        assert!(lines("empty", "x", "y", &[], (100, 100)).is_ok());
    }
}
