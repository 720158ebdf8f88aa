//! `leafbench diagnose --targets`: tests of which only peak force and loop energy are known, or the points of one loop.

use std::path::{Path, PathBuf};

use super::{DiagnoseJob, files, improved_bench, verdict_text};
use crate::cli::shared::progress::Progress;
use crate::cli::{CliError, Done};
use crate::config::Bench;
use crate::diagnose::Baseline;
use crate::diagnose::aggregates::{AggregateDiagnosis, TableReader, TableRow, diagnose_table};
use crate::identify::targets::{Aggregate, LoopTarget, TargetProblem};
use crate::identify::{FitControl, FitOptions, IdentifyError, fit};
use crate::regular_file::{self, TABLE_MAX_BYTES};
use crate::report::aggregates::page;

/// Reads the tables, diagnoses them, writes the files and prints the result.
pub(super) fn run(paths: &[PathBuf], job: &DiagnoseJob<'_>) -> Result<Done, CliError> {
    let mut reader = TableReader::default();
    for path in paths {
        let table = regular_file::read(path, TABLE_MAX_BYTES).map_err(CliError::file(path, "reading"))?;
        reader
            .read(table.as_slice(), &path.display().to_string())
            .map_err(|e| CliError::Aggregates(e.into()))?;
    }
    let mut bar = Progress::new("diagnose", job.output.json);
    let diagnosis = diagnose_table(
        reader.finish(),
        &mut |rows| simulate(rows, job.baseline),
        0,
        &mut |share| bar.show_share(share, ""),
    );
    bar.finish();
    let diagnosis = diagnosis.map_err(CliError::Aggregates)?;
    files::write(job.folder, &files_of(&diagnosis, job.bench)?)?;
    job.output.result(&diagnosis, || text(&diagnosis, job.folder))?;
    Ok(Done::Success)
}

/// Peak force and loop energy of every row on the baseline, whose parameters are first fitted to the rows.
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

fn files_of(diagnosis: &AggregateDiagnosis, bench: &Bench) -> Result<Vec<files::NamedFile>, CliError> {
    let mut named = vec![
        (files::DIAGNOSIS.to_owned(), Some(files::json(diagnosis)?)),
        (files::REPORT.to_owned(), Some(page(diagnosis))),
        // Tables have no next test: the one of an earlier diagnosis of recordings would mislead.
        (files::NEXT_TEST.to_owned(), None),
    ];
    // One bench file for each mounting; the first is also the one that scripts read.
    for (i, (mount, model)) in diagnosis.improved.iter().enumerate() {
        let toml = improved_bench(bench, model).to_toml();
        if i == 0 {
            named.push((files::IMPROVED.to_owned(), Some(toml.clone())));
        }
        named.push((format!("improved-{}.toml", file_name_part(mount)), Some(toml)));
    }
    Ok(named)
}

/// The name of a mounting as part of a file name. It comes from a table, so it may not lead out of the folder.
fn file_name_part(mount: &str) -> String {
    let allowed = |c: char| c.is_alphanumeric() || "-_.".contains(c);
    mount.chars().map(|c| if allowed(c) { c } else { '-' }).collect()
}

fn text(d: &AggregateDiagnosis, folder: &Path) -> String {
    let mut lines = vec![format!("{}: {}", verdict_text(d.verdict), d.summary)];
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
        lines.push(format!("  not missing: {}: {}", f.code, f.statement));
    }
    lines.extend(
        d.alternatives
            .iter()
            .map(|a| format!("  or {} instead of {}: {}", a.code, a.instead_of, a.why)),
    );
    lines.extend(d.location.iter().map(|l| format!("  where: {}", l.words)));
    lines.extend(d.alarms.iter().map(|a| format!("  alarm: {a}")));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_of_a_mounting_does_not_lead_out_of_the_folder() {
        assert_eq!(file_name_part("shackle front"), "shackle-front");
        assert_eq!(file_name_part("x/../../etc/passwd"), "x-..-..-etc-passwd");
    }
}
