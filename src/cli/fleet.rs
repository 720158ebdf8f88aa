//! `leafbench fleet`: what a table of estimates of many runs says together; `estimate` writes the table.

mod estimate;

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::shared::local;
use super::{CliCommand, CliError, Done, Output};
use crate::fleet::estimate::read_estimates;
use crate::fleet::findings::FleetFindings;
use crate::fleet::{FleetOptions, pool};
use crate::recording::atomic_file;
use crate::regular_file::{self, TABLE_MAX_BYTES};
use crate::report::{fleet, fleet_tables};

/// Compare benches, operators, families, batches and specimens over many runs
#[derive(Debug, Args)]
pub(super) struct FleetArgs {
    #[command(subcommand)]
    action: FleetAction,
}

#[derive(Debug, Subcommand)]
enum FleetAction {
    Estimate(estimate::EstimateArgs),
    /// Pool a table of estimates: print what was found, and write a page with plots and tables
    Report(FleetReportArgs),
}

/// The arguments of `leafbench fleet report`.
#[derive(Debug, Args)]
struct FleetReportArgs {
    /// Table of estimates (CSV), one row for each quantity of each run
    #[arg(value_name = "TABLE")]
    table: PathBuf,
    /// Folder to write fleet.html, fleet.json and the tables to
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// The bench that counts as right [default: each bench is compared with the others]
    #[arg(long, value_name = "BENCH")]
    reference_bench: Option<String>,
    /// Count differences between operators as scatter from run to run
    #[arg(long)]
    ignore_operators: bool,
    /// Replace the files if they are there already
    #[arg(long)]
    force: bool,
}

impl CliCommand for FleetArgs {
    const NAME: &'static str = "fleet";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench fleet estimate leafbench-data/runs --specimens specimens.csv --out estimates.csv",
        "leafbench fleet report examples/estimates.csv --out fleet-report",
        "leafbench fleet report examples/estimates.csv --out fleet-report --reference-bench B1",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        match self.action {
            FleetAction::Estimate(estimate) => estimate.run(output),
            FleetAction::Report(report) => report.run(output),
        }
    }
}

impl FleetReportArgs {
    fn run(self, output: &Output) -> Result<Done, CliError> {
        let name = self.table.display().to_string();
        let text = regular_file::read_text(&self.table, TABLE_MAX_BYTES)
            .map_err(CliError::file(&self.table, "reading"))?;
        let rows = read_estimates(&name, text.as_bytes())?;
        let options = FleetOptions {
            reference_bench: self.reference_bench,
            ignore_operators: self.ignore_operators,
        };
        let findings = pool(&rows, &options)?;
        let shown = self
            .table
            .file_name()
            .map_or(name.clone(), |f| f.to_string_lossy().into_owned());
        let written = write(&findings, &shown, &self.out, self.force)?;
        output.result(&findings, || {
            format!("{}\n\nwritten: {}", sentences(&findings), written.display())
        })?;
        Ok(Done::Success)
    }
}

/// Writes page, JSON and tables; returns the page.
fn write(findings: &FleetFindings, table: &str, folder: &Path, force: bool) -> Result<PathBuf, CliError> {
    let json = serde_json::to_string_pretty(findings).map_err(|e| CliError::Internal(e.to_string()))?;
    let page = fleet::page(findings, table);
    let mut files = vec![("fleet.html", page), ("fleet.json", json)];
    files.extend(fleet_tables::tables(findings));
    let files: Vec<(PathBuf, String)> = files
        .into_iter()
        .map(|(name, text)| (folder.join(name), text))
        .collect();
    let paths: Vec<&PathBuf> = files.iter().map(|(path, _)| path).collect();
    local::require_new(&paths, force)?;
    std::fs::create_dir_all(folder).map_err(CliError::file(folder, "creating the folder"))?;
    for (path, text) in &files {
        atomic_file::write(path, |sink| sink.write_all(text.as_bytes()))
            .map_err(CliError::file(path, "writing"))?;
    }
    Ok(files[0].0.clone())
}

/// The findings for people.
fn sentences(findings: &FleetFindings) -> String {
    let mut text = match findings.findings.is_empty() {
        true => format!("Nothing was found ({} questions).\n", findings.questions),
        false => format!(
            "Found ({} questions; the chance that one finding or more is wrong is at most {:.0} %):\n",
            findings.questions,
            100.0 * findings.family_wise_error
        ),
    };
    let found = findings.findings.iter().map(|f| &f.sentence);
    let causes = findings.bench_causes.iter().map(|c| &c.sentence);
    for sentence in found.chain(causes) {
        text += &format!("- {sentence}\n");
    }
    for (title, sentences) in [
        ("Worth a look, but not sure:", &findings.worth_a_look),
        ("This table cannot tell:", &findings.cannot_tell),
    ] {
        if !sentences.is_empty() {
            text += &format!("\n{title}\n");
            sentences.iter().for_each(|s| text += &format!("- {s}\n"));
        }
    }
    text.trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn findings() -> FleetFindings {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/estimates.csv");
        let text = std::fs::read_to_string(&file).expect("shipped");
        let rows = read_estimates("estimates.csv", text.as_bytes()).expect("a table");
        pool(&rows, &FleetOptions::default()).expect("pooled")
    }

    #[test]
    fn the_shipped_example_has_what_its_page_says() {
        let said = sentences(&findings());
        for part in [
            "- Bench B2 reads rate_n_per_mm higher than the mean of benches B1 and B3 by 1.",
            "- Bench B3 has channel_delay: 1.5",
            "friction_ratio grows per 1000 cycles by 0.2",
            "- Specimen S010 has rate_n_per_mm above",
            "- Bench B2: an error of its force fits",
        ] {
            assert!(said.contains(part), "{part}: {said}");
        }
    }

    #[test]
    fn all_files_are_written_once_and_replaced_by_force_only() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path().join("report");
        let findings = findings();
        let page = write(&findings, "estimates.csv", &out, false).expect("written");
        assert!(page.is_file());
        assert_eq!(std::fs::read_dir(&out).expect("listed").count(), 7);
        let json: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(out.join("fleet.json")).expect("written"))
                .expect("JSON");
        assert_eq!(json["benches"], 3);
        assert_eq!(json["bench_causes"][0]["error"], "force_gain");
        let refused = write(&findings, "estimates.csv", &out, false).expect_err("there already");
        assert!(refused.to_string().contains("is there already"));
        write(&findings, "estimates.csv", &out, true).expect("replaced");
    }
}
