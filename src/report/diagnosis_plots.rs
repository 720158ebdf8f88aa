//! The plots of a diagnosis' report: loops measured against model before and after, residual maps with the located region marked.

use std::fmt::Write;

use super::diagnosis::file_name;
use super::html::escape;
use super::svg::{HALF, Ink, Plot, PlotCurve};
use crate::diagnose::diagnosis::{Axis, Curve, Diagnosis, Map};

/// For the first screen: the loop that the baseline misses most, and the map on which the difference was located.
pub(super) fn at_a_glance(page: &mut String, d: &Diagnosis) -> std::fmt::Result {
    let worst = d
        .curves
        .iter()
        .max_by(|a, b| a.nrmse_baseline.total_cmp(&b.nrmse_baseline));
    let located = d
        .location
        .iter()
        .find_map(|l| d.maps.iter().find(|m| m.axis == l.axis));
    let (Some(curve), Some(map)) = (worst, located.or(d.maps.first())) else {
        return Ok(());
    };
    writeln!(
        page,
        "<div class=\"pair block\"><div>{}<p class=\"legend\">{}{} <span class=\"quiet\">{}</span></p></div>\
         <div>{}<p class=\"legend\">{}{}{}</p></div></div>",
        loop_plot(curve, &curve.baseline_n, Ink::Twin),
        entry("measured", Ink::Measured),
        entry("baseline, refitted", Ink::Twin),
        escape(file_name(&curve.name)),
        map_plot(map, d),
        entry("measured minus baseline, loading", Ink::Loading),
        entry("unloading", Ink::Unloading),
        entry("improved", Ink::Improved),
    )
}

fn entry(name: &str, ink: Ink) -> String {
    format!("<span><i style=\"background:{}\"></i>{name}</span>", ink.css())
}

pub(super) fn legend(page: &mut String, entries: &[(&str, Ink)]) -> std::fmt::Result {
    write!(page, "<p class=\"legend\">")?;
    for (name, ink) in entries {
        page.push_str(&entry(name, *ink));
    }
    writeln!(page, "</p>")
}

pub(super) fn loops(page: &mut String, d: &Diagnosis) -> std::fmt::Result {
    writeln!(page, "<h2>Loops</h2>")?;
    legend(
        page,
        &[
            ("measured", Ink::Measured),
            ("baseline, refitted", Ink::Twin),
            ("improved model", Ink::Improved),
        ],
    )?;
    for curve in &d.curves {
        writeln!(
            page,
            "<div class=\"block\"><h3>{}: error {:.3} % before, {:.3} % after</h3>",
            escape(file_name(&curve.name)),
            100.0 * curve.nrmse_baseline,
            100.0 * curve.nrmse_improved
        )?;
        writeln!(
            page,
            "<div class=\"pair\"><div>{}</div><div>{}</div></div>",
            loop_plot(curve, &curve.baseline_n, Ink::Twin),
            loop_plot(curve, &curve.improved_n, Ink::Improved)
        )?;
        for remark in &curve.remarks {
            writeln!(page, "<p class=\"quiet\">{}</p>", escape(remark))?;
        }
        writeln!(page, "</div>")?;
    }
    Ok(())
}

fn loop_plot(curve: &Curve, model_n: &[f64], ink: Ink) -> String {
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
    Plot {
        title: "",
        legend: false,
        x_label: "displacement in mm",
        y_label: "force in N",
        curves: &curves,
        bands: &[],
        size: HALF,
    }
    .render()
}

fn line(points: Vec<(f64, f64)>, ink: Ink) -> PlotCurve {
    PlotCurve {
        name: String::new(),
        points,
        ink,
    }
}

pub(super) fn maps(page: &mut String, d: &Diagnosis) -> std::fmt::Result {
    if d.maps.is_empty() {
        return Ok(());
    }
    writeln!(
        page,
        "<h2>Residuals</h2>\n<p>Mean of measured minus model. Marked: where the diagnosis locates the difference.</p>"
    )?;
    legend(
        page,
        &[
            ("baseline, loading", Ink::Loading),
            ("baseline, unloading", Ink::Unloading),
            ("improved model, both", Ink::Improved),
        ],
    )?;
    writeln!(page, "<div class=\"pair\">")?;
    for map in &d.maps {
        writeln!(page, "<div class=\"block\">{}</div>", map_plot(map, d))?;
    }
    writeln!(page, "</div>")
}

fn map_plot(map: &Map, d: &Diagnosis) -> String {
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
    Plot {
        title: "",
        legend: false,
        x_label: axis_label(map.axis),
        y_label: "residual in N",
        curves: &curves,
        bands: &bands,
        size: HALF,
    }
    .render()
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
