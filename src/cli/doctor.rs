//! `leafbench doctor`. The checks are in the folder beside this file: `computer` looks at the computer, `connection` at the link
//! and the bench file. Each is a small function of what it read, so that tests can give it another computer.

mod computer;
mod connection;
mod finding;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use super::shared::client::DATA_VARIABLE;
use super::shared::local::BenchArg;
use super::{CliCommand, CliError, Done, Output};
use crate::config::Bench;
use finding::{DoctorFinding, Grade, SystemRoot};

/// Check this computer for a real rig: permissions, clock, real-time rights, CAN or serial port, disk, calibrations
#[derive(Debug, Args)]
#[command(
    after_help = "Nothing is changed and the rig is not asked. A warning is what makes the bench worse than it could be; a problem keeps\n\
                  it from working or from being trusted. The rights are those of the user who types this command: type it as the\n\
                  user of the daemon (`sudo -u leafbench leafbench doctor`). Exit code 0: no problem, 1: at least one problem."
)]
pub(super) struct DoctorArgs {
    #[command(flatten)]
    bench: BenchArg,
    /// Address of the link to look at [default: from the bench file]
    #[arg(long, value_name = "ADDRESS")]
    link: Option<String>,
    /// Folder of the run files [default: from the bench file]
    #[arg(long, value_name = "DIR", env = DATA_VARIABLE)]
    data: Option<PathBuf>,
}

/// The result as JSON.
#[derive(Debug, Serialize)]
struct DoctorReport {
    bench: String,
    link: String,
    problems: usize,
    warnings: usize,
    findings: Vec<DoctorFinding>,
}

impl CliCommand for DoctorArgs {
    const NAME: &'static str = "doctor";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench doctor --bench bench-configs/benches/mock-vcan.toml --link can:can0",
        "leafbench doctor --link serial:/dev/ttyUSB0 --json",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let bench = self.bench.load()?;
        let link = self.link.unwrap_or_else(|| bench.link.address.clone());
        let folder = self.data.unwrap_or_else(|| bench.daemon.data_folder.clone());
        let findings = examine(&SystemRoot::real(), &bench, &link, &folder);
        let count = |grade| findings.iter().filter(|f| f.grade == grade).count();
        let report = DoctorReport {
            bench: bench.name.clone(),
            problems: count(Grade::Problem),
            warnings: count(Grade::Warning),
            link,
            findings,
        };
        output.result(&report, || text(&report))?;
        Ok(Done::success_if(report.problems == 0))
    }
}

/// All findings, in the order in which a technician connects a rig.
fn examine(root: &SystemRoot, bench: &Bench, link: &str, folder: &Path) -> Vec<DoctorFinding> {
    let today = jiff::Timestamp::now().to_zoned(jiff::tz::TimeZone::UTC).date();
    let mut findings = connection::link(root, link);
    findings.push(computer::monotonic_clock(root));
    findings.push(computer::time_of_day(root));
    findings.extend(computer::rights(root));
    findings.extend(computer::processors(root));
    findings.push(computer::disk(folder));
    findings.extend(connection::calibrations(bench, today));
    findings
}

fn text(report: &DoctorReport) -> String {
    let mut text = format!("bench {} at {}\n", report.bench, report.link);
    // Writing into a text does not fail.
    for finding in &report.findings {
        let place = match finding.place.as_str() {
            "" => String::new(),
            place => format!(" ({place})"),
        };
        let _ = writeln!(
            text,
            "{:<8} {:<16} {}{place}",
            finding.grade.word(),
            finding.subject,
            finding.what
        );
        if !finding.what_to_do.is_empty() {
            let _ = writeln!(text, "{:<26}-> {}", "", finding.what_to_do);
        }
    }
    let (problems, warnings) = (
        counted(report.problems, "problem"),
        counted(report.warnings, "warning"),
    );
    let _ = write!(text, "{problems}, {warnings}");
    text
}

/// A number and its noun.
fn counted(number: usize, noun: &str) -> String {
    let plural = if number == 1 { "" } else { "s" };
    format!("{number} {noun}{plural}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_has_what_where_and_what_to_do() {
        let report = DoctorReport {
            bench: "b".to_owned(),
            link: "can:can0".to_owned(),
            problems: 1,
            warnings: 0,
            findings: vec![
                DoctorFinding::ok("clock", "monotonic"),
                DoctorFinding::problem("CAN state", "bus-off", "restart it").at("can0"),
            ],
        };
        let said = text(&report);
        assert!(
            said.contains("\nproblem  CAN state        bus-off (can0)\n"),
            "{said}"
        );
        assert!(said.contains("-> restart it\n"), "{said}");
        assert!(said.ends_with("1 problem, 0 warnings"), "{said}");
    }

    /// With the mock rig in memory nothing of the link can be wrong, and every subject has at least one finding.
    #[test]
    fn the_shipped_bench_is_examined_in_full() {
        let bench = Bench::shipped().expect("built in");
        let folder = tempfile::tempdir().expect("a folder");
        let findings = examine(&SystemRoot::real(), &bench, "mock:", folder.path());
        for subject in [
            "link",
            "clock",
            "time of day",
            "real-time",
            "locked memory",
            "processors",
            "disk",
            "calibration",
        ] {
            assert!(findings.iter().any(|f| f.subject == subject), "{subject}");
        }
        assert!(
            findings
                .iter()
                .all(|f| f.grade == Grade::Ok || !f.what_to_do.is_empty())
        );
    }
}
