//! The plots of a diagnosis report: loops measured against model, before and after, and residuals with the located regions
//! marked.

use maud::{Markup, PreEscaped, html};

use super::figures::percent;
use super::html::legend;
use super::svg::{HALF, Ink, Plot, PlotCurve};
use crate::diagnose::diagnosis::{Axis, Curve, Diagnosis, DiscoveredLaw, Map};

/// The first screen: the loop with the largest baseline error, and the residuals over the first axis with a located region.
pub(super) fn at_a_glance(d: &Diagnosis) -> Markup {
    let worst = d
        .curves
        .iter()
        .max_by(|a, b| a.nrmse_baseline.total_cmp(&b.nrmse_baseline));
    html! {
        @if let (Some(curve), Some(map)) = (worst, located_map(d)) {
            div.pair.block {
                div {
                    (loop_plot(curve, &curve.baseline_n, Ink::Twin))
                    (legend(&[("measured", Ink::Measured), ("baseline, refitted", Ink::Twin)], file_name(&curve.name)))
                }
                div {
                    (map_plot(map, d))
                    (legend(
                        &[
                            ("measured minus baseline, loading", Ink::Loading),
                            ("unloading", Ink::Unloading),
                            ("improved", Ink::Improved),
                        ],
                        "",
                    ))
                }
            }
        }
    }
}

/// The residuals over the first axis with a located region, or over the first axis if nothing is located.
pub(super) fn located_map(d: &Diagnosis) -> Option<&Map> {
    let located = d
        .location
        .iter()
        .find_map(|l| d.maps.iter().find(|m| m.axis == l.axis));
    located.or(d.maps.first())
}

pub(super) fn loops(d: &Diagnosis) -> Markup {
    html! {
        h2 { "Loops" }
        (legend(
            &[
                ("measured", Ink::Measured),
                ("baseline, refitted", Ink::Twin),
                ("improved model", Ink::Improved),
            ],
            "",
        ))
        @for curve in &d.curves {
            div.block {
                h3 {
                    (file_name(&curve.name)) ": error " (percent(curve.nrmse_baseline, 3)) " before, "
                    (percent(curve.nrmse_improved, 3)) " after"
                }
                div.pair {
                    div { (loop_plot(curve, &curve.baseline_n, Ink::Twin)) }
                    div { (loop_plot(curve, &curve.improved_n, Ink::Improved)) }
                }
                @for remark in &curve.remarks {
                    p.quiet { (remark) }
                }
            }
        }
    }
}

pub(super) fn maps(d: &Diagnosis) -> Markup {
    html! {
        @if !d.maps.is_empty() {
            h2 { "Residuals" }
            p { "Mean of measured minus model force. Marked regions: where the diagnosis locates the difference." }
            (legend(
                &[
                    ("baseline, loading", Ink::Loading),
                    ("baseline, unloading", Ink::Unloading),
                    ("improved model, both", Ink::Improved),
                ],
                "",
            ))
            div.pair {
                @for map in &d.maps {
                    div.block { (map_plot(map, d)) }
                }
            }
        }
    }
}

/// A law over its axis, with two standard deviations on both sides.
pub(super) fn law_plot(found: &DiscoveredLaw) -> Markup {
    let law = &found.law;
    let values = |deviations: f64| {
        let value = move |(force, band): (&f64, &f64)| force + deviations * band;
        let values = law.force.iter().zip(&found.band).map(value);
        law.at.iter().copied().zip(values).collect()
    };
    let curves = [
        line(values(0.0), Ink::Improved),
        line(values(2.0), Ink::Twin),
        line(values(-2.0), Ink::Twin),
    ];
    let label = match (law.per_load, law.opposes_motion) {
        (false, false) => "force in N",
        (false, true) => "force against the motion in N",
        (true, false) => "force divided by load",
        (true, true) => "force against the motion divided by load",
    };
    html! {
        (plot(axis_label(law.axis), label, &curves, &[]))
        (legend(&[("the law", Ink::Improved), ("two standard deviations", Ink::Twin)], ""))
    }
}

/// The last part of a path.
fn file_name(name: &str) -> &str {
    name.rsplit(['/', '\\']).next().unwrap_or(name)
}

fn loop_plot(curve: &Curve, model_n: &[f64], ink: Ink) -> Markup {
    let points = |force: &[f64]| -> Vec<(f64, f64)> {
        curve
            .displacement_mm
            .iter()
            .copied()
            .zip(force.iter().copied())
            .collect()
    };
    let curves = [
        line(points(&curve.measured_n), Ink::Measured),
        line(points(model_n), ink),
    ];
    plot("displacement in mm", "force in N", &curves, &[])
}

/// Mean residuals over the axis of `map`, before and after, with the located regions marked.
pub(super) fn map_plot(map: &Map, d: &Diagnosis) -> Markup {
    let points = |values: &[Option<f64>]| -> Vec<(f64, f64)> {
        map.edges
            .windows(2)
            .zip(values)
            .filter_map(|(e, v)| v.map(|v| (0.5 * (e[0] + e[1]), v)))
            .collect()
    };
    let curves = [
        line(points(&map.loading_n), Ink::Loading),
        line(points(&map.unloading_n), Ink::Unloading),
        line(points(&map.improved_loading_n), Ink::Improved),
        line(points(&map.improved_unloading_n), Ink::Improved),
    ];
    let bands: Vec<(f64, f64)> = d
        .location
        .iter()
        .filter(|l| l.axis == map.axis)
        .map(|l| (l.from, l.to))
        .collect();
    plot(axis_label(map.axis), "residual in N", &curves, &bands)
}

/// One of two plots side by side. The page has the legend, so the plot has none.
pub(super) fn plot(x_label: &str, y_label: &str, curves: &[PlotCurve], bands: &[(f64, f64)]) -> Markup {
    let plot = Plot {
        title: "",
        legend: false,
        x_label,
        y_label,
        curves,
        bands,
        levels: &[],
        size: HALF,
    };
    PreEscaped(plot.render())
}

/// A curve without a name of its own.
pub(super) fn line(points: Vec<(f64, f64)>, ink: Ink) -> PlotCurve {
    PlotCurve {
        name: String::new(),
        points,
        ink,
    }
}

fn axis_label(axis: Axis) -> &'static str {
    match axis {
        Axis::DisplacementMm => "displacement in mm",
        Axis::ForceN => "force in N",
        Axis::VelocityMmS => "speed in mm/s",
        Axis::AccelerationMmS2 => "acceleration in mm/s\u{b2}",
        Axis::TimeS => "time in s",
        Axis::Cycle => "cycle",
        Axis::DistanceFromReversalMm => "travel since the last reversal in mm",
        Axis::FrequencyHz => "frequency in Hz",
    }
}
