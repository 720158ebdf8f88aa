//! The tables of `leafbench papers` as Markdown that also reads as plain text.

use std::fmt::{Result, Write};

use super::Papers;
use crate::identify::leaf_pack_rows::{AmplitudeReading, PARAMETERS, RowFit, TESTS, mount_index, mount_name};
use crate::identify::loop_points::FiveLinkComparison;
use crate::model::leaf_pack::{self, PackStructure};
use crate::papers::first::{self, LeafPackRerun, ReadingRerun, TanhRow};
use crate::papers::third::WagonRow;

/// All tables of the three papers.
pub(super) fn tables(papers: &Papers) -> String {
    let mut out = String::new();
    // Writing into a string cannot fail.
    let _ = first_paper(&mut out, &papers.first)
        .and_then(|()| second_paper(&mut out, &papers.second))
        .and_then(|()| third_paper(&mut out, &papers.third));
    out
}

fn first_paper(out: &mut String, rerun: &LeafPackRerun) -> Result {
    writeln!(out, "## 1. Kadziela, Manka, Uhl, Toso (2015): leaf pack\n")?;
    two_numbers(out, rerun)?;
    ranges(out)?;
    for reading in &rerun.readings {
        tanh_model(out, reading)?;
        for fit in &reading.fits {
            leaf_pack_fit(out, reading.reading, fit)?;
        }
    }
    if let [a, b] = rerun.readings.as_slice() {
        let (better, worse) = if a.misfit() <= b.misfit() { (a, b) } else { (b, a) };
        writeln!(
            out,
            "**The reading that the data favour**: {}. The largest error of its sets within the ranges is {:.1} times what is allowed \
             (3 % of peak force, 5 % of loop energy). With \"{}\" it is {:.1} times.\n",
            better.reading.name(),
            better.misfit(),
            worse.reading.name(),
            worse.misfit()
        )?;
    }
    Ok(())
}

fn two_numbers(out: &mut String, rerun: &LeafPackRerun) -> Result {
    writeln!(
        out,
        "### Tables 6 and 7: differential evolution on two figures\n\n\
         Friction between leaves only, tanh law, transition velocity {:.3} mm/s, static travel {:.1} mm with shackle and {:.1} mm \
         without; objective (9), settings of Table 5, friction coefficient -30 to 30 (its size acts), thickness correction -0.4 to \
         0.1 mm (the paper kept to 0.2).\n",
        rerun.statics.transition_velocity_mm_s, rerun.statics.travel_mm[0], rerun.statics.travel_mm[1]
    )?;
    writeln!(
        out,
        "| mounting | | friction coefficient | thickness mm | peak kN | loop J | loop at 0.1, J |\n|---|---|---|---|---|---|---|"
    )?;
    for two in &rerun.two_numbers {
        let name = mount_name(two.mounting);
        writeln!(
            out,
            "| {name} | target | | | {:.3} | {:.2} | |\n| | paper | {:.3} | {:+.3} | {:.3} | {:.3} | {:.3} |\n\
             | | ours | {:.3} | {:+.3} | {:.3} | {:.3} | {:.3} |",
            two.target.peak_force_n / 1e3,
            two.target.loop_energy_j,
            two.printed[0],
            two.printed[1],
            two.printed_reach.peak_force_n / 1e3,
            two.printed_reach.loop_energy_j,
            first::ROWS[0].simulated[mount_index(two.mounting)].loop_energy_j,
            two.found[0],
            two.found[1],
            two.reach.peak_force_n / 1e3,
            two.reach.loop_energy_j,
            two.unfitted_j,
        )?;
    }
    writeln!(
        out,
        "\nTwo parameters meet two figures, with a friction coefficient that no pair of steel leaves has.\n"
    )
}

/// The ranges of the fits, and the plausible ranges of the leaf-pack model.
fn ranges(out: &mut String) -> Result {
    writeln!(
        out,
        "### Ranges of the fits to Tables 2 and 3\n\n\
         \"Within the ranges\" below means the ranges of this table. They are for this page only. Some are wider than the plausible \
         ranges (`belief`) of the leaf-pack model, which `identify` and `diagnose` use for their warnings, because the paper does not \
         print what they depend on, for example the radii of the pins. So a set within the ranges can be outside the plausible range.\n\n\
         | parameter | meaning | range here | belief of the leaf-pack model |\n|---|---|---|---|"
    )?;
    for p in &PARAMETERS {
        let unit = if p.unit.is_empty() {
            String::new()
        } else {
            format!(" {}", p.unit)
        };
        let belief = model_belief(p.name).map_or("none".to_owned(), |[low, high]| {
            let same = [low, high] == p.bounds;
            if same {
                "the same".to_owned()
            } else {
                format!("{low} to {high}{unit}")
            }
        });
        let [low, high] = p.bounds;
        writeln!(
            out,
            "| `{}` | {} | {low} to {high}{unit} | {belief} |",
            p.name, p.what
        )?;
    }
    writeln!(out)
}

/// Believed range of the leaf-pack model for a parameter of the fits, in the unit of the fits.
fn model_belief(name: &str) -> Option<[f64; 2]> {
    let belief = |name: &str| {
        let parameter = leaf_pack::MODEL.parameters.iter().find(|p| p.name == name)?;
        Some(parameter.belief)
    };
    match name {
        "pin_friction_mm" => {
            let radius_mm = PackStructure::default().pin_radius_mm;
            Some(belief("pin_mu")?.map(|mu| mu * radius_mm))
        }
        "shackle_pivot_torque_nmm" | "rail_pivot_torque_nmm" => belief("pivot_torque_nmm"),
        name => belief(name),
    }
}

fn tanh_model(out: &mut String, reading: &ReadingRerun) -> Result {
    writeln!(
        out,
        "### Tables 2 and 3, {}\n\nThe paper's kind of model: friction between leaves only, tanh law, coefficient 0.1. The troughs of \
         the sines, {:.1} mm (shackle) and {:.1} mm (no shackle), follow from the paper's own simulated peaks.\n",
        reading.reading.name(),
        reading.tanh.trough_mm[0],
        reading.tanh.trough_mm[1]
    )?;
    writeln!(
        out,
        "| mounting | test | measured kN | paper | ours | measured J | paper | ours | at most |\n|---|---|---|---|---|---|---|---|---|"
    )?;
    for row in &reading.tanh.rows {
        writeln!(
            out,
            "| {} | {} | {:.3} | {:.3} | {:.3} | {:.3} | {:.3} | {:.3} | {:.3} |",
            mount_name(row.mounting),
            row.name,
            row.measured.peak_force_n / 1e3,
            row.simulated.peak_force_n / 1e3,
            row.ours.peak_force_n / 1e3,
            row.measured.loop_energy_j,
            row.simulated.loop_energy_j,
            row.ours.loop_energy_j,
            row.at_most_j
        )?;
    }
    let sines = || reading.tanh.rows.iter().filter(|r| r.name != TESTS[0].name);
    let times = |r: &TanhRow| r.simulated.loop_energy_j / r.at_most_j;
    writeln!(
        out,
        "\n\"At most\" is the loop energy of the same coefficient with rate-independent friction: no transition velocity gives more. \
         Our static rows fail as the paper's do, because the law fades at that speed. The paper's dynamic loops are not reproduced: \
         their energy is {:.0} to {:.0} times what a coefficient of 0.1 can lose between these leaves. It hardly grows from 1 to \
         2.5 Hz and grows with the stroke, so that it is dry friction and not damping. The paper does not print its cause; it says \
         that bushings, shackle and pusher had no friction.\n",
        sines().map(times).fold(f64::INFINITY, f64::min),
        sines().map(times).fold(0.0, f64::max)
    )
}

fn leaf_pack_fit(out: &mut String, reading: AmplitudeReading, fit: &RowFit) -> Result {
    let [peak, energy] = fit.worst_errors();
    writeln!(
        out,
        "#### Leaf pack fitted, {}: {}\n\nLargest error of peak force {:.1} %, of loop energy {:.1} %, {} evaluations.\n",
        reading.name(),
        fit.case.name(),
        100.0 * peak,
        100.0 * energy,
        fit.fit.evaluations
    )?;
    let values: Vec<String> = (fit.fit.parameters.iter().zip(&fit.fit.values).zip(&fit.fit.free))
        .filter(|(_, free)| **free)
        .map(|((p, v), _)| format!("{} {:.3}", p.name, v))
        .collect();
    writeln!(out, "{}\n", values.join(", "))?;
    writeln!(
        out,
        "| mounting | test | measured kN | ours | error % | measured J | ours | error % |\n|---|---|---|---|---|---|---|---|"
    )?;
    for row in &fit.rows {
        let [peak, energy] = row.errors();
        writeln!(
            out,
            "| {} | {} | {:.3} | {:.3} | {:+.1} | {:.3} | {:.3} | {:+.1} |",
            mount_name(row.mounting),
            row.name,
            row.measured.peak_force_n / 1e3,
            row.ours.peak_force_n / 1e3,
            100.0 * peak,
            row.measured.loop_energy_j,
            row.ours.loop_energy_j,
            100.0 * energy
        )?;
    }
    let [peak, energy] = fit.case.allowed();
    let allowed = format!(
        "{:.0} % of peak force and {:.0} % of loop energy",
        100.0 * peak,
        100.0 * energy
    );
    match fit.misses().as_slice() {
        [] => writeln!(out, "\nAll tests within {allowed}.")?,
        misses => writeln!(out, "\nOutside {allowed}: {}.", misses.join("; "))?,
    }
    let at_bound = fit.at_bounds();
    if !at_bound.is_empty() {
        writeln!(
            out,
            "At the end of their range or outside it: {}.",
            at_bound.join(", ")
        )?;
    }
    writeln!(out)
}

fn second_paper(out: &mut String, rerun: &FiveLinkComparison) -> Result {
    writeln!(
        out,
        "## 2. Chula thesis, chapter V: five-link with modified Dahl, Table 5-1\n\n\
         | model | RMS force error N | share of the envelope's |\n|---|---|---|"
    )?;
    for row in rerun.rows() {
        writeln!(
            out,
            "| {} | {:.1} | {:.3} |",
            row.model, row.rms_n, row.share_of_envelope
        )?;
    }
    writeln!(
        out,
        "\n| envelope parameter | printed | fitted | 95 % interval |\n|---|---|---|---|"
    )?;
    let fit = &rerun.fit;
    for ((p, value), ci) in fit.parameters.iter().zip(&fit.values).zip(&fit.ci95) {
        let interval = ci.map_or("none".to_owned(), |[a, b]| format!("{a:.3} to {b:.3}"));
        writeln!(out, "| {} | {:.3} | {value:.3} | {interval} |", p.name, p.start)?;
    }
    writeln!(
        out,
        "\nThere are eleven points: the fit shows what the model can do, not that its values are the spring's.\n"
    )
}

fn third_paper(out: &mut String, rows: &[WagonRow]) -> Result {
    writeln!(
        out,
        "## 3. Polach and Hajzman: finite segments, Tables 1 and 2\n\n\
         The curve is computed from the published optimum, which is then identified from the published start. f and r_f enter as a \
         product.\n"
    )?;
    for row in rows {
        writeln!(
            out,
            "### {}, {}: {} evaluations, misfit {:.4} -> {:.2e} mm per point, largest error {:.4} %\n\n\
             | parameter | start | published | ours | error % |\n|---|---|---|---|---|",
            row.spring,
            row.method,
            row.evaluations,
            row.misfit_start_mm,
            row.misfit_mm,
            100.0 * row.worst
        )?;
        for f in &row.figures {
            writeln!(
                out,
                "| {} | {:.5e} | {:.5e} | {:.5e} | {:+.4} |",
                f.name,
                f.start,
                f.published,
                f.identified,
                100.0 * f.error
            )?;
        }
        writeln!(out)?;
        for warning in &row.warnings {
            writeln!(out, "Warning: {warning}.")?;
        }
        writeln!(out)?;
    }
    Ok(())
}
