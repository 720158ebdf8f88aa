//! `leafbench fleet report`: what the estimates of many runs say together.

use std::path::{Path, PathBuf};

use clap::Args;

use super::source::EstimateSource;
use crate::cli::shared::local;
use crate::cli::{CliError, Done, Output};
use crate::fleet::drawing::Drawings;
use crate::fleet::findings::FleetFindings;
use crate::fleet::predict::coverage::coverage;
use crate::fleet::{FleetError, FleetOptions, pool};
use crate::regular_file::{self, WRITTEN_MAX_BYTES};
use crate::report::{fleet, fleet_tables};

/// Pool the estimates of many runs: print what was found, and write a page with plots and tables
#[derive(Debug, Args)]
pub(super) struct FleetReportArgs {
    #[command(flatten)]
    source: EstimateSource,
    /// Folder to write fleet.html, fleet.json and the tables to
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// The bench that counts as right [default: each bench is compared with the others]
    #[arg(long, value_name = "BENCH")]
    reference_bench: Option<String>,
    /// Count differences between operators as scatter from run to run
    #[arg(long)]
    ignore_operators: bool,
    /// What the drawings of the families allow (TOML); each specimen is judged by it [default: specimens are compared with their family]
    #[arg(long, value_name = "FILE")]
    drawings: Option<PathBuf>,
    /// Predict each run from the runs before it, too, and show how often that was right; takes longer
    #[arg(long)]
    coverage: bool,
    /// Replace the files if they are there already
    #[arg(long)]
    force: bool,
}

impl FleetReportArgs {
    pub(super) fn run(self, output: &Output) -> Result<Done, CliError> {
        let estimates = self.source.load()?;
        let options = FleetOptions {
            reference_bench: self.reference_bench,
            ignore_operators: self.ignore_operators,
            drawings: self.drawings.as_deref().map(drawings).transpose()?,
        };
        let findings = pool(&estimates.rows, &options)?;
        let predictions = self.coverage.then(|| coverage(&estimates.rows));
        let page = fleet::page(&findings, &self.source.shown(), predictions.as_ref());
        let written = write(&findings, page, &self.out, self.force)?;
        output.result(&findings, || {
            let left_out = estimates.left_out.iter();
            let left_out: String = left_out.map(|reason| format!("\nLEFT OUT: {reason}")).collect();
            format!(
                "{}\n\nwritten: {}{left_out}",
                sentences(&findings),
                written.display()
            )
        })?;
        Ok(Done::Success)
    }
}

/// The drawings of a file.
fn drawings(path: &Path) -> Result<Drawings, CliError> {
    let text = regular_file::read_text(path, WRITTEN_MAX_BYTES).map_err(CliError::file(path, "reading"))?;
    Ok(Drawings::read(&path.display().to_string(), &text).map_err(FleetError::from)?)
}

/// Writes page, JSON and tables; returns the page.
fn write(findings: &FleetFindings, page: String, folder: &Path, force: bool) -> Result<PathBuf, CliError> {
    let json = serde_json::to_string_pretty(findings).map_err(|e| CliError::Internal(e.to_string()))?;
    let mut files = vec![("fleet.html", page), ("fleet.json", json)];
    files.extend(fleet_tables::tables(findings));
    local::write_files(folder, &files, force)?;
    Ok(folder.join(files[0].0))
}

/// The findings for people.
fn sentences(findings: &FleetFindings) -> String {
    let mut text = match findings.findings.is_empty() {
        true => format!("Nothing was found ({} questions).\n", findings.questions),
        false => format!(
            "Found ({} questions; {}):\n",
            findings.questions,
            findings.sureness()
        ),
    };
    let found = findings.findings.iter().map(|f| &f.sentence);
    let causes = findings.bench_causes.iter().map(|c| &c.sentence);
    for sentence in found.chain(causes) {
        text += &format!("- {sentence}\n");
    }
    if let Some(counts) = &findings.against_drawings {
        text += &format!(
            "\n{} Each of them is in {}.\n",
            counts.sentence(),
            fleet_tables::DRAWINGS
        );
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
    use crate::fleet::estimate::read_estimates;

    fn findings() -> FleetFindings {
        pooled(&FleetOptions::default())
    }

    fn pooled(options: &FleetOptions) -> FleetFindings {
        let file = shipped("estimates.csv");
        let text = std::fs::read_to_string(&file).expect("shipped");
        let rows = read_estimates("estimates.csv", text.as_bytes()).expect("a table");
        pool(&rows, options).expect("pooled")
    }

    fn shipped(name: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("examples").join(name)
    }

    #[test]
    fn the_shipped_drawings_find_the_specimen_that_is_too_stiff() {
        let options = FleetOptions {
            drawings: Some(drawings(&shipped("drawings.toml")).expect("drawings")),
            ..FleetOptions::default()
        };
        let findings = pooled(&options);
        let said = sentences(&findings);
        let out = findings.against_drawings.expect("judged").out_of_tolerance;
        assert_eq!(said.matches(": out of tolerance (").count(), out, "{said}");
        assert!(said.contains("- S010: rate_n_per_mm 2"), "{said}");
        assert!(
            said.contains("Against the drawings") && said.contains("drawings.csv"),
            "{said}"
        );
        let unknown = drawings(Path::new("no-such-drawings.toml")).expect_err("no file");
        assert!(unknown.to_string().contains("no-such-drawings.toml"), "{unknown}");
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
        let page = write(&findings, "page".to_owned(), &out, false).expect("written");
        assert!(page.is_file());
        assert_eq!(std::fs::read_dir(&out).expect("listed").count(), 8);
        let json: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(out.join("fleet.json")).expect("written"))
                .expect("JSON");
        assert_eq!(json["benches"], 3);
        assert_eq!(json["bench_causes"][0]["error"], "force_gain");
        let refused = write(&findings, "page".to_owned(), &out, false).expect_err("there already");
        assert!(refused.to_string().contains("is there already"));
        write(&findings, "page".to_owned(), &out, true).expect("replaced");
    }
}
