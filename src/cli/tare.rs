//! `leafbench tare`.

use clap::Args;

use super::shared::client::CommandArgs;
use super::{CliCommand, CliError, Done, Output};
use crate::control::TareReport;
use crate::daemon::client_types::Nothing;

/// Take the present readings as zero; refused while the rig moves or is too far from zero
#[derive(Debug, Args)]
pub(super) struct TareArgs {
    #[command(flatten)]
    command: CommandArgs,
}

impl CliCommand for TareArgs {
    const NAME: &'static str = "tare";
    const EXAMPLES: &'static [&'static str] = &["leafbench tare", "leafbench tare --json"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let report: TareReport = self.command.for_one_order()?.post("/api/tare", &Nothing {})?;
        output.result(&report, || text(&report))?;
        Ok(Done::Success)
    }
}

fn text(r: &TareReport) -> String {
    format!(
        "force         tare {:.2} N -> {:.2} N (spread {:.3} N)\ndisplacement  tare {:.4} mm -> {:.4} mm (spread {:.5} mm)",
        r.force_old_n,
        r.force_new_n,
        r.force_sigma_n,
        r.displacement_old_mm,
        r.displacement_new_mm,
        r.displacement_sigma_mm
    )
}
