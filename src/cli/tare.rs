//! `leafbench tare`.

use super::client::{Client, data_argument};
use super::{Command, Done};
use crate::control::TareReport;
use crate::daemon::client_types::Nothing;

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "tare",
    what: "Take the present readings as zero; refused while the rig moves or is too far from zero",
    arguments: |command| command.arg(data_argument()),
    run: |matches, output| {
        let report: TareReport = Client::of(matches)?.post("/api/tare", &Nothing {})?;
        output.result(&report, || text(&report))?;
        Ok(Done::Well)
    },
};

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
