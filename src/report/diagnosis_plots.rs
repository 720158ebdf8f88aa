//! The plots of a diagnosis report: loops measured against model, before and after, and residuals with the located regions
//! marked.

use maud::{Markup, PreEscaped, html};

use super::figures::percent;
use super::html::legend;
use super::svg::{HALF, Ink, Plot, PlotCurve};
use crate::diagnose::diagnosis::{Axis, Curve, Diagnosis, DiscoveredLaw, Map};
use crate::effect::law::ForceLaw;

/// A point that breaks a line.
const BREAK: (f64, f64) = (f64::NAN, f64::NAN);

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
    html! {
        (plot(axis_label(found.law.axis), law_label(&found.law), &law_curves(found), &[]))
        (legend(&[("the law", Ink::Improved), ("two standard deviations", Ink::Twin)], ""))
    }
}

/// The law, then two standard deviations above and below it.
pub(super) fn law_curves(found: &DiscoveredLaw) -> [PlotCurve; 3] {
    let law = &found.law;
    let values = |deviations: f64| {
        let value = move |(force, band): (&f64, &f64)| force + deviations * band;
        let values = law.force.iter().zip(&found.band).map(value);
        law.at.iter().copied().zip(values).collect()
    };
    [
        line(values(0.0), Ink::Improved),
        line(values(2.0), Ink::Twin),
        line(values(-2.0), Ink::Twin),
    ]
}

pub(super) fn law_label(law: &ForceLaw) -> &'static str {
    match (law.per_load, law.opposes_motion) {
        (false, false) => "force in N",
        (false, true) => "force against the motion in N",
        (true, false) => "force divided by load",
        (true, true) => "force against the motion divided by load",
    }
}

/// The last part of a path.
pub(super) fn file_name(name: &str) -> &str {
    name.rsplit(['/', '\\']).next().unwrap_or(name)
}

fn loop_plot(curve: &Curve, model_n: &[f64], ink: Ink) -> Markup {
    let curves = [
        line(loop_points(curve, &curve.measured_n), Ink::Measured),
        line(loop_points(curve, model_n), ink),
    ];
    plot("displacement in mm", "force in N", &curves, &[])
}

/// True if points between this one and the one before are not there, or are masked.
pub(super) fn broken_at(curve: &Curve, index: usize) -> bool {
    curve.breaks.binary_search(&index).is_ok()
}

/// Force over displacement, broken where points are missing: no chord is drawn that was not measured.
pub(super) fn loop_points(curve: &Curve, force_n: &[f64]) -> Vec<(f64, f64)> {
    let points = curve.displacement_mm.iter().zip(force_n).enumerate();
    points
        .flat_map(|(i, (x, force))| {
            let gap = broken_at(curve, i).then_some(BREAK);
            gap.into_iter().chain([(*x, *force)])
        })
        .collect()
}

/// Mean residuals over the axis of `map`, before and after, with the located regions marked.
pub(super) fn map_plot(map: &Map, d: &Diagnosis) -> Markup {
    plot(
        axis_label(map.axis),
        "residual in N",
        &map_curves(map),
        &marked(map, d),
    )
}

/// Baseline loading and unloading, then improved loading and unloading, broken at bins without a point.
pub(super) fn map_curves(map: &Map) -> [PlotCurve; 4] {
    let points = |values: &[Option<f64>]| -> Vec<(f64, f64)> {
        let bins = map.edges.windows(2).zip(values);
        bins.map(|(e, v)| v.map_or(BREAK, |v| (0.5 * (e[0] + e[1]), v)))
            .collect()
    };
    [
        line(points(&map.loading_n), Ink::Loading),
        line(points(&map.unloading_n), Ink::Unloading),
        line(points(&map.improved_loading_n), Ink::Improved),
        line(points(&map.improved_unloading_n), Ink::Improved),
    ]
}

/// The located regions on the axis of a map.
pub(super) fn marked(map: &Map, d: &Diagnosis) -> Vec<(f64, f64)> {
    let located = d.location.iter().filter(|l| l.axis == map.axis);
    located.map(|l| (l.from, l.to)).collect()
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

pub(super) fn axis_label(axis: Axis) -> &'static str {
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
