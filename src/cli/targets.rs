//! `leafbench diagnose --targets`: tests of which only peak force and loop energy are known, or the points of one loop.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::ArgMatches;

use super::progress::{Progress, ProgressMark};
use super::{CliError, Done, Output, diagnose};
use crate::config::Bench;
use crate::diagnose::Baseline;
use crate::diagnose::aggregates::{AggregateDiagnosis, TableReader, TableRow, diagnose_table};
use crate::identify::targets::{Aggregate, LoopTarget, TargetProblem};
use crate::identify::{FitControl, FitOptions, IdentifyError, fit};
use crate::report::aggregates::page;

/// Reads the tables, diagnoses, writes and tells.
pub(super) fn run(
    matches: &ArgMatches,
    bench: &Bench,
    baseline: &Baseline,
    output: &Output,
) -> Result<Done, CliError> {
    let paths: Vec<&PathBuf> = matches
        .get_many("targets")
        .map(Iterator::collect)
        .unwrap_or_default();
    let mut reader = TableReader::default();
    for path in paths {
        let file = File::open(path).map_err(CliError::file(path, "reading"))?;
        reader
            .read(file, &path.display().to_string())
            .map_err(|e| CliError::Aggregates(e.into()))?;
    }
    let mut bar = Progress::new("diagnose", output.json);
    let begun = Instant::now();
    let diagnosis = diagnose_table(
        reader.finish(),
        &mut |rows| simulate(rows, baseline),
        0,
        &mut |share| {
            let elapsed_s = begun.elapsed().as_secs_f64();
            if share > 0.0 {
                bar.show(ProgressMark {
                    elapsed_s,
                    remaining_s: elapsed_s * (1.0 - share) / share,
                    cycles: 0,
                    cycles_total: 0,
                });
            }
        },
    );
    bar.finish();
    let diagnosis = diagnosis.map_err(CliError::Aggregates)?;
    let folder = diagnose::out_folder(matches);
    write_all(&folder, &diagnosis, bench)?;
    output.result(&diagnosis, || text(&diagnosis, &folder))?;
    Ok(Done::Well)
}

/// The baseline, its own parameters refitted to the rows, over their motions.
fn simulate(rows: &[TableRow], baseline: &Baseline) -> Result<Vec<Aggregate>, IdentifyError> {
    let targets = rows.iter().filter_map(|r| {
        Some(LoopTarget {
            motion: r.motion?,
            measured: r.measured,
        })
    });
    let factory = |values: &[f64]| baseline.model.plant(values, &baseline.structure);
    let problem = TargetProblem::new(
        baseline.model.parameters.to_vec(),
        Box::new(factory),
        targets.collect(),
    );
    let options = FitOptions {
        start: baseline.start.clone(),
        ..FitOptions::default()
    };
    let fit = fit(&problem, &options, &mut |_| FitControl::Continue)?;
    Ok(problem.measure(&fit.values)?)
}

fn write_all(folder: &Path, diagnosis: &AggregateDiagnosis, bench: &Bench) -> Result<(), CliError> {
    std::fs::create_dir_all(folder).map_err(CliError::file(folder, "making the folder"))?;
    let json = serde_json::to_string_pretty(diagnosis).map_err(|e| CliError::Internal(e.to_string()))?;
    let mut files = vec![
        ("diagnosis.json".to_owned(), json),
        ("report.html".to_owned(), page(diagnosis)),
    ];
    // One bench config a mounting; the first also by the name that scripts know.
    for (i, (mount, model)) in diagnosis.improved.iter().enumerate() {
        let toml = diagnose::improved_bench(bench, model).to_toml();
        if i == 0 {
            files.push(("improved.toml".to_owned(), toml.clone()));
        }
        files.push((format!("improved-{}.toml", mount.replace(' ', "-")), toml));
    }
    for (name, text) in files {
        let path = folder.join(name);
        std::fs::write(&path, text).map_err(CliError::file(&path, "writing"))?;
    }
    Ok(())
}

fn text(d: &AggregateDiagnosis, folder: &Path) -> String {
    let mut lines = vec![format!("{}: {}", diagnose::word(d.verdict), d.summary)];
    for f in &d.effects {
        lines.push(format!(
            "  {} ({:.1} % sure): {}",
            f.code,
            100.0 * f.confidence,
            f.statement
        ));
        for v in &f.parameters {
            let interval = v
                .ci95
                .map_or(String::new(), |[a, b]| format!(" ({a:.3} to {b:.3})"));
            lines.push(format!("      {}: {:.3} {}{interval}", v.name, v.value, v.unit));
        }
    }
    for f in &d.excluded {
        lines.push(format!("  not {}: {}", f.code, f.statement));
    }
    lines.extend(
        d.alternatives
            .iter()
            .map(|a| format!("  or {} instead of {}: {}", a.code, a.instead_of, a.why)),
    );
    lines.extend(d.location.iter().map(|l| format!("  where: {}", l.words)));
    lines.extend(d.alarms.iter().map(|a| format!("  look at: {a}")));
    let [model, optimum, ours] = &d.models;
    lines.push(format!(
        "  {:<28}{:>20}{model:>32}{optimum:>32}{ours:>32}",
        "", "measured"
    ));
    let pair = |p: Option<[f64; 2]>| p.map_or("-".to_owned(), |[a, b]| format!("{a:.1} {b:.3}"));
    for row in &d.rows {
        lines.push(format!(
            "  {:<28}{:>20}{:>32}{:>32}{:>32}",
            row.name,
            pair(Some(row.measured)),
            pair(row.model),
            pair(row.optimum),
            pair(row.ours)
        ));
    }
    let codes: Vec<&str> = d.not_testable.iter().map(|n| n.code.as_str()).collect();
    if !codes.is_empty() {
        lines.push(format!("  not testable: {}", codes.join(", ")));
    }
    lines.extend(d.remarks.iter().map(|r| format!("  {r}")));
    let improved = if d.improved.is_empty() {
        ""
    } else {
        ", improved.toml"
    };
    lines.push(format!(
        "  {}: report.html, diagnosis.json{improved}",
        folder.display()
    ));
    lines.join("\n")
}
