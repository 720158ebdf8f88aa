//! `leafbench papers`.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::shared::progress::Progress;
use super::{CliCommand, CliError, Done, Output};
use crate::papers::first::{self, AmplitudeReading, Choice};
use crate::papers::{second, third};
use crate::report::svg::{PlotCurve, xy_plot};

/// Rerun what the three papers report and print their figures beside ours
#[derive(Debug, Args)]
pub(super) struct PapersArgs {
    /// What the first paper's "amplitude" means
    #[arg(long, value_enum, default_value_t = AmplitudeOption::Both)]
    amplitude: AmplitudeOption,
    /// Lowest displacement of the first paper's sines in mm, 0 to 8 [default: fitted]
    #[arg(long, value_name = "MM", value_parser = trough_in_mm)]
    trough_mm: Option<f64>,
    /// Cores to use, 0 for all; the figures do not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Also write the page papers.md and its plots there
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

/// Readings of the word "amplitude" that are run.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum AmplitudeOption {
    /// The whole stroke
    Whole,
    /// Half of the stroke
    Half,
    /// One after the other
    Both,
}

fn trough_in_mm(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|mm| (0.0..=8.0).contains(mm))
        .ok_or_else(|| "enter the sines' lowest displacement in mm, 0 to 8".to_owned())
}

/// Everything that was run.
struct Papers {
    first: first::LeafPackRerun,
    second: second::FiveLinkRerun,
    third: Vec<third::WagonRow>,
}

impl CliCommand for PapersArgs {
    const NAME: &'static str = "papers";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench papers",
        "leafbench papers --amplitude whole --out docs",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let choice = self.choice();
        let mut progress = Progress::new("papers", output.json);
        let mut watch = |step: &str, share: f64| {
            progress.show_share(share, step);
            true
        };
        let papers = Papers {
            first: first::rerun(&choice, &mut watch)?,
            second: second::rerun(choice.threads)?,
            third: third::rerun(choice.threads)?,
        };
        progress.finish();
        if let Some(folder) = &self.out {
            write_page(&papers, folder)?;
        }
        output.result(&json(&papers), || text(&papers))?;
        Ok(Done::Success)
    }
}

impl PapersArgs {
    fn choice(&self) -> Choice {
        Choice {
            readings: match self.amplitude {
                AmplitudeOption::Whole => vec![AmplitudeReading::Whole],
                AmplitudeOption::Half => vec![AmplitudeReading::Half],
                AmplitudeOption::Both => vec![AmplitudeReading::Whole, AmplitudeReading::Half],
            },
            trough_mm: self.trough_mm,
            threads: self.threads,
            ..Choice::default()
        }
    }
}

/// The tables, as Markdown that reads as plain text too.
fn text(papers: &Papers) -> String {
    let mut out = String::new();
    // Writing into a string cannot fail.
    let _ = first_text(&mut out, &papers.first)
        .and_then(|()| second_text(&mut out, &papers.second))
        .and_then(|()| third_text(&mut out, &papers.third));
    out
}

fn first_text(out: &mut String, rerun: &first::LeafPackRerun) -> std::fmt::Result {
    writeln!(out, "## 1. Kadziela, Manka, Uhl, Toso (2015): leaf pack\n")?;
    two_numbers_text(out, rerun)?;
    for reading in &rerun.readings {
        own_text(out, reading)?;
        for fit in &reading.fits {
            fit_text(out, reading.reading, fit)?;
        }
    }
    if let [a, b] = rerun.readings.as_slice() {
        let (better, worse) = if a.misfit() <= b.misfit() { (a, b) } else { (b, a) };
        writeln!(
            out,
            "**Which reading the data favour**: {}. Its believable sets miss the worst row by {:.1} times what is allowed \
             (3 % of peak force, 5 % of loop energy), those of \"{}\" by {:.1} times.\n",
            better.reading.name(),
            better.misfit(),
            worse.reading.name(),
            worse.misfit()
        )?;
    }
    Ok(())
}

fn two_numbers_text(out: &mut String, rerun: &first::LeafPackRerun) -> std::fmt::Result {
    writeln!(
        out,
        "### Tables 6 and 7: differential evolution on two numbers\n\n\
         tanh friction between leaves alone, transition velocity {:.3} mm/s, static travel {:.1} mm with shackle and {:.1} mm \
         without; objective (9), settings of Table 5, friction coefficient -30 to 30 (its size acts), thickness -0.4 to \
         0.1 mm (the paper kept to 0.2).\n",
        rerun.statics.transition_velocity_mm_s, rerun.statics.travel_mm[0], rerun.statics.travel_mm[1]
    )?;
    writeln!(
        out,
        "| mounting | | friction coefficient | thickness mm | peak kN | loop J | loop at 0.1, J |\n|---|---|---|---|---|---|---|"
    )?;
    for two in &rerun.two_numbers {
        let name = first::mount_name(two.mounting);
        writeln!(
            out,
            "| {name} | target | | | {:.3} | {:.2} | |\n| | paper | {:.3} | {:+.3} | {:.3} | {:.3} | {:.3} |\n\
             | | ours | {:.3} | {:+.3} | {:.3} | {:.3} | {:.3} |",
            two.target.peak_n / 1e3,
            two.target.loop_j,
            two.printed[0],
            two.printed[1],
            two.printed_reach.peak_n / 1e3,
            two.printed_reach.loop_j,
            first::ROWS[0].simulated[first::column(two.mounting)].loop_j,
            two.found[0],
            two.found[1],
            two.reach.peak_n / 1e3,
            two.reach.loop_j,
            two.unfitted_j,
        )?;
    }
    writeln!(
        out,
        "\nTwo numbers are met by two parameters, at a coefficient that no pair of steel leaves has.\n"
    )
}

fn own_text(out: &mut String, reading: &first::ReadingRerun) -> std::fmt::Result {
    writeln!(
        out,
        "### Tables 2 and 3, {}\n\nThe paper's kind of model: tanh friction between leaves, mu 0.1, nothing else. Troughs at \
         {:.1} mm (shackle) and {:.1} mm (no shackle), from the paper's own simulated peaks.\n",
        reading.reading.name(),
        reading.own.trough_mm[0],
        reading.own.trough_mm[1]
    )?;
    writeln!(
        out,
        "| mounting | row | measured kN | paper | ours | measured J | paper | ours | at most |\n|---|---|---|---|---|---|---|---|---|"
    )?;
    for row in &reading.own.rows {
        writeln!(
            out,
            "| {} | {} | {:.3} | {:.3} | {:.3} | {:.3} | {:.3} | {:.3} | {:.3} |",
            first::mount_name(row.mounting),
            row.name,
            row.measured.peak_n / 1e3,
            row.simulated.peak_n / 1e3,
            row.ours.peak_n / 1e3,
            row.measured.loop_j,
            row.simulated.loop_j,
            row.ours.loop_j,
            row.at_most_j
        )?;
    }
    let sines = || reading.own.rows.iter().filter(|r| r.name != first::ROWS[0].name);
    let times = |r: &first::OwnRow| r.simulated.loop_j / r.at_most_j;
    writeln!(
        out,
        "\n\"At most\" is the loop of the same coefficient with friction that knows no rate: no transition velocity leaves more. \
         The static rows fail as the paper's do: the law fades at that speed. The paper's dynamic loops are not reproduced: they \
         are {:.0} to {:.0} times what 0.1 can lose between these leaves. They hardly grow from 1 to 2.5 Hz and go with the \
         stroke, so it is dry friction and no damping; what makes it is not printed (bushings, shackle and pusher were left \
         without friction, the paper says).\n",
        sines().map(times).fold(f64::INFINITY, f64::min),
        sines().map(times).fold(0.0, f64::max)
    )
}

fn fit_text(out: &mut String, reading: AmplitudeReading, fit: &first::PhysicsFit) -> std::fmt::Result {
    writeln!(
        out,
        "#### Physics on, {}: {}\n\nWorst peak force {:.1} %, worst loop energy {:.1} %, {} evaluations.\n",
        reading.name(),
        fit.case.name,
        100.0 * fit.judged.peak,
        100.0 * fit.judged.energy,
        fit.fit.evaluations
    )?;
    let values: Vec<String> = (fit.fit.parameters.iter().zip(&fit.fit.values).zip(&fit.fit.free))
        .filter(|(_, free)| **free)
        .map(|((p, v), _)| format!("{} {:.3}", p.name, v))
        .collect();
    writeln!(out, "{}\n", values.join(", "))?;
    writeln!(
        out,
        "| mounting | row | measured kN | ours | error % | measured J | ours | error % |\n|---|---|---|---|---|---|---|---|"
    )?;
    for row in &fit.rows {
        let [peak, energy] = row.errors();
        writeln!(
            out,
            "| {} | {} | {:.3} | {:.3} | {:+.1} | {:.3} | {:.3} | {:+.1} |",
            first::mount_name(row.mounting),
            row.name,
            row.measured.peak_n / 1e3,
            row.ours.peak_n / 1e3,
            100.0 * peak,
            row.measured.loop_j,
            row.ours.loop_j,
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
        [] => writeln!(out, "\nAll rows within {allowed}.")?,
        misses => writeln!(out, "\nBeyond {allowed}: {}.", misses.join("; "))?,
    }
    let at_bound = fit.at_bounds();
    if !at_bound.is_empty() {
        writeln!(out, "The rows push against: {}.", at_bound.join(", "))?;
    }
    writeln!(out)
}

fn second_text(out: &mut String, rerun: &second::FiveLinkRerun) -> std::fmt::Result {
    writeln!(
        out,
        "## 2. Chula thesis, chapter V: five-link with modified Dahl, Table 5-1\n\n\
         | model | RMS force error N | share of the envelope's |\n|---|---|---|"
    )?;
    for row in &rerun.rows {
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
    for ((p, value), ci) in rerun
        .fit
        .parameters
        .iter()
        .zip(&rerun.fit.values)
        .zip(&rerun.fit.ci95)
    {
        let interval = ci.map_or("none".to_owned(), |[a, b]| format!("{a:.3} to {b:.3}"));
        writeln!(out, "| {} | {:.3} | {value:.3} | {interval} |", p.name, p.start)?;
    }
    writeln!(
        out,
        "\nEleven points: the fit shows what the model can do, not that its values are the spring's.\n"
    )
}

fn third_text(out: &mut String, rows: &[third::WagonRow]) -> std::fmt::Result {
    writeln!(
        out,
        "## 3. Polach and Hajzman: finite segments, Tables 1 and 2\n\n\
         The curve of the published optimum, identified back from the published start; f and r_f enter as a product.\n"
    )?;
    for row in rows {
        writeln!(
            out,
            "### {}, {}: {} evaluations, misfit {:.4} -> {:.2e} mm a point, worst parameter {:.4} %\n\n\
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
    }
    Ok(())
}

/// `papers.md` and one plot a fit of the first paper and one for the second.
fn write_page(papers: &Papers, folder: &Path) -> Result<(), CliError> {
    std::fs::create_dir_all(folder).map_err(CliError::file(folder, "making the folder"))?;
    let mut page = String::from(
        "# What the papers report, run again\n\nMade by `leafbench papers --out docs`. Measured figures are the papers'; \
         everything under \"ours\" comes from the models of this program.\n\n",
    );
    page += &text(papers);
    page += "## Plots\n\n";
    let mut plots = Vec::new();
    for reading in &papers.first.readings {
        let word = if reading.reading == AmplitudeReading::Whole {
            "whole"
        } else {
            "half"
        };
        for (i, fit) in reading.fits.iter().enumerate() {
            for (mounting, points) in fit.case.mounts.iter().zip(&fit.curves) {
                let mount = first::mount_name(*mounting);
                let name = format!("papers-1-{word}-{}-{}.svg", i + 1, mount.replace(' ', "-"));
                let what = format!(
                    "{}, {}: pass of the {mount} mounting",
                    reading.reading.name(),
                    fit.case.name
                );
                let svg = xy_plot(
                    "displacement in mm",
                    "force in N",
                    &[PlotCurve::twin("model", points.clone())],
                );
                plots.push((name, what, svg));
            }
        }
    }
    let measured = PlotCurve::measured("Table 5-1", second::TABLE_5_1.to_vec());
    for row in &papers.second.rows {
        let points = second::TABLE_5_1.iter().zip(&row.force_n).map(|(p, f)| (p.0, *f));
        let model = PlotCurve::twin(row.model, points.collect());
        let name = format!("papers-2-{}.svg", row.model.replace(' ', "-"));
        let svg = xy_plot("deflection in mm", "force in N", &[measured.clone(), model]);
        plots.push((name, format!("Table 5-1 (blue) and {} (orange)", row.model), svg));
    }
    for (name, what, svg) in plots {
        let _ = writeln!(page, "![{what}]({name})\n\n{what}\n");
        let path = folder.join(name);
        std::fs::write(&path, svg).map_err(CliError::file(&path, "writing"))?;
    }
    let path = folder.join("papers.md");
    std::fs::write(&path, page).map_err(CliError::file(&path, "writing"))
}

fn json(papers: &Papers) -> serde_json::Value {
    use serde_json::json;
    let two = |t: first::Two| json!({ "peak_n": t.peak_n, "loop_j": t.loop_j });
    let fit = |f: &first::PhysicsFit| {
        let values: serde_json::Map<_, _> = (f.fit.parameters.iter().zip(&f.fit.values).zip(&f.fit.free))
            .filter(|(_, free)| **free)
            .map(|((p, v), _)| (p.name.to_owned(), json!(v)))
            .collect();
        let rows: Vec<_> = f
            .rows
            .iter()
            .map(|r| json!({ "mounting": first::mount_name(r.mounting), "row": r.name, "measured": two(r.measured), "ours": two(r.ours) }))
            .collect();
        json!({ "case": f.case.name, "values": values, "rows": rows, "worst_peak": f.judged.peak,
                "worst_energy": f.judged.energy, "evaluations": f.fit.evaluations, "at_bounds": f.at_bounds() })
    };
    let readings: Vec<_> = papers
        .first
        .readings
        .iter()
        .map(|r| {
            let own: Vec<_> = r
                .own
                .rows
                .iter()
                .map(|o| json!({ "mounting": first::mount_name(o.mounting), "row": o.name, "measured": two(o.measured), "paper": two(o.simulated), "ours": two(o.ours), "at_most_j": o.at_most_j }))
                .collect();
            json!({ "reading": r.reading.name(), "misfit": r.misfit(), "own_model": own,
                    "fits": r.fits.iter().map(fit).collect::<Vec<_>>() })
        })
        .collect();
    let pairs: Vec<_> = papers
        .first
        .two_numbers
        .iter()
        .map(|t| json!({ "mounting": first::mount_name(t.mounting), "printed": t.printed, "found": t.found, "target": two(t.target), "reach": two(t.reach) }))
        .collect();
    let second: Vec<_> = papers
        .second
        .rows
        .iter()
        .map(|r| json!({ "model": r.model, "rms_n": r.rms_n, "share_of_envelope": r.share_of_envelope }))
        .collect();
    let third: Vec<_> = papers
        .third
        .iter()
        .map(|r| {
            let figures: Vec<_> = r
                .figures
                .iter()
                .map(|f| json!({ "name": f.name, "published": f.published, "identified": f.identified }))
                .collect();
            json!({ "spring": r.spring, "method": r.method, "evaluations": r.evaluations, "worst": r.worst, "figures": figures })
        })
        .collect();
    json!({ "first": { "transition_velocity_mm_s": papers.first.statics.transition_velocity_mm_s,
                       "two_numbers": pairs, "readings": readings },
            "second": second, "third": third })
}
