//! The figures of a diagnosis as files: each plot as SVG that stands alone, with title and legend, and the numbers behind it as
//! CSV of the same name.

use std::fmt::Write;

use super::diagnosis_plots::{
    axis_label, broken_at, file_name, law_curves, law_label, loop_points, map_curves, marked,
};
use super::svg::{Ink, LARGE, Plot, PlotCurve};
use crate::diagnose::diagnosis::{Curve, Diagnosis, DiscoveredLaw, Map};

/// Beginnings of the names of all figures.
pub(crate) const FIGURE_NAMES: [&str; 3] = ["loop-", "residual-", "law."];

/// Name and text of every file.
pub(crate) fn figure_files(d: &Diagnosis) -> Vec<(String, String)> {
    let mut files = Vec::new();
    for (i, curve) in d.curves.iter().enumerate() {
        let name = format!("loop-{}", i + 1);
        files.push((format!("{name}.svg"), loop_svg(curve)));
        files.push((format!("{name}.csv"), loop_csv(curve)));
    }
    for map in &d.maps {
        let name = format!("residual-{}", column(map));
        files.push((format!("{name}.svg"), map_svg(map, d)));
        files.push((format!("{name}.csv"), map_csv(map)));
    }
    if let Some(found) = &d.law {
        files.push(("law.svg".to_owned(), law_svg(found)));
        files.push(("law.csv".to_owned(), law_csv(found)));
    }
    files
}

/// The axis of a map as in `diagnosis.json`.
fn column(map: &Map) -> String {
    let value = serde_json::to_value(map.axis).ok();
    value
        .and_then(|v| v.as_str().map(str::to_owned))
        .unwrap_or_default()
}

fn render(title: &str, labels: [&str; 2], curves: &[PlotCurve], bands: &[(f64, f64)]) -> String {
    let plot = Plot {
        title,
        legend: true,
        x_label: labels[0],
        y_label: labels[1],
        curves,
        bands,
        levels: &[],
        size: LARGE,
    };
    plot.render()
}

fn loop_svg(curve: &Curve) -> String {
    let line = |name: &str, force: &[f64], ink| PlotCurve {
        name: name.to_owned(),
        points: loop_points(curve, force),
        ink,
    };
    let curves = [
        line("measured", &curve.measured_n, Ink::Measured),
        line("baseline, refitted", &curve.baseline_n, Ink::Twin),
        line("improved model", &curve.improved_n, Ink::Improved),
    ];
    render(
        file_name(&curve.name),
        ["displacement in mm", "force in N"],
        &curves,
        &[],
    )
}

/// `piece` counts the parts of the line, from 1: no line leads from one part to the next.
fn loop_csv(curve: &Curve) -> String {
    let mut text = "piece,time_s,displacement_mm,measured_n,baseline_n,improved_n\r\n".to_owned();
    let mut piece = 1;
    for i in 0..curve.time_s.len() {
        piece += u32::from(broken_at(curve, i));
        let columns = [
            &curve.time_s,
            &curve.displacement_mm,
            &curve.measured_n,
            &curve.baseline_n,
            &curve.improved_n,
        ];
        let cells: Vec<String> = columns.iter().map(|c| cell(c.get(i).copied())).collect();
        row(&mut text, &piece.to_string(), &cells);
    }
    text
}

fn map_svg(map: &Map, d: &Diagnosis) -> String {
    let names = [
        "baseline, loading",
        "baseline, unloading",
        "improved model",
        "improved model",
    ];
    let mut curves = map_curves(map);
    for (curve, name) in curves.iter_mut().zip(names) {
        name.clone_into(&mut curve.name);
    }
    let title = "Mean of measured minus model force";
    render(
        title,
        [axis_label(map.axis), "residual in N"],
        &curves,
        &marked(map, d),
    )
}

fn map_csv(map: &Map) -> String {
    let mut text = "from,to,loading_n,unloading_n,improved_loading_n,improved_unloading_n\r\n".to_owned();
    for (i, edges) in map.edges.windows(2).enumerate() {
        let columns = [
            &map.loading_n,
            &map.unloading_n,
            &map.improved_loading_n,
            &map.improved_unloading_n,
        ];
        let mut cells = vec![cell(edges.get(1).copied())];
        cells.extend(columns.iter().map(|c| cell(c.get(i).copied().flatten())));
        row(&mut text, &cell(edges.first().copied()), &cells);
    }
    text
}

fn law_svg(found: &DiscoveredLaw) -> String {
    let names = ["the law", "two standard deviations", "two standard deviations"];
    let mut curves = law_curves(found);
    for (curve, name) in curves.iter_mut().zip(names) {
        name.clone_into(&mut curve.name);
    }
    let title = "Law read off the recordings";
    render(
        title,
        [axis_label(found.law.axis), law_label(&found.law)],
        &curves,
        &[],
    )
}

fn law_csv(found: &DiscoveredLaw) -> String {
    let mut text = "at,force,standard_deviation\r\n".to_owned();
    for (i, at) in found.law.at.iter().enumerate() {
        let cells = [&found.law.force, &found.band].map(|c| cell(c.get(i).copied()));
        row(&mut text, &cell(Some(*at)), &cells);
    }
    text
}

/// A number to its last bit; empty where there is none.
fn cell(value: Option<f64>) -> String {
    value
        .filter(|v| v.is_finite())
        .map_or(String::new(), |v| v.to_string())
}

fn row(text: &mut String, first: &str, cells: &[String]) {
    // Writing to a text does not fail.
    let _ = write!(text, "{first},{}\r\n", cells.join(","));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve() -> Curve {
        Curve {
            name: "a.csv".to_owned(),
            time_s: vec![0.0, 1.0, 2.0, 3.0],
            displacement_mm: vec![0.0, 1.0, 2.0, 1.0],
            measured_n: vec![0.0, 70.0, 140.0, 60.0],
            baseline_n: vec![0.0, 71.0, 139.0, 61.0],
            improved_n: vec![0.0, 70.5, f64::NAN, 60.5],
            breaks: vec![2],
            remarks: Vec::new(),
            nrmse_baseline: 0.01,
            nrmse_improved: 0.005,
        }
    }

    #[test]
    fn the_numbers_of_a_loop_say_where_its_line_is_broken() {
        let csv = loop_csv(&curve());
        let rows: Vec<&str> = csv.lines().collect();
        assert_eq!(rows[2..4], ["1,1,1,70,71,70.5", "2,2,2,140,139,"]);
        let measured = loop_points(&curve(), &curve().measured_n);
        assert_eq!(measured.len(), 5, "four points and a break");
        assert!(measured[2].0.is_nan() && measured[3] == (2.0, 140.0));
        let svg = loop_svg(&curve());
        assert!(
            svg.contains("a.csv") && svg.contains("improved model"),
            "title and legend"
        );
    }
}
