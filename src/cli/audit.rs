//! `leafbench audit`: reads and checks the audit log.

use std::path::Path;

use clap::{Args, Subcommand};

use super::shared::client::DataArg;
use super::{CliCommand, CliError, Done, Output};
use crate::daemon::audit::chain::{self, AuditEntry};
use crate::daemon::audit::{self, AUDIT_FILE};

/// Show who did what on the bench, or check that nobody changed the log of it
#[derive(Debug, Args)]
#[command(
    after_help = "Each line of the log has the hash of the line before. Somebody who may write the data folder can write the whole \
                  log again: keep the hash that `verify` prints in another place, and give it to a later check with --hash."
)]
pub(super) struct AuditArgs {
    #[command(subcommand)]
    action: AuditAction,
}

#[derive(Debug, Subcommand)]
enum AuditAction {
    /// Show the newest entries
    Show {
        /// Number of entries
        #[arg(long, value_name = "N", default_value_t = 30)]
        last: usize,
        #[command(flatten)]
        data: DataArg,
    },
    /// Check every line; exit code 1 if one was changed, removed or moved
    Verify {
        /// Hash that an earlier check printed: the log must still have the line with it
        #[arg(long, value_name = "HASH")]
        hash: Option<String>,
        #[command(flatten)]
        data: DataArg,
    },
}

impl CliCommand for AuditArgs {
    const NAME: &'static str = "audit";
    const EXAMPLES: &'static [&'static str] = &["leafbench audit show --last 10", "leafbench audit verify"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        match self.action {
            AuditAction::Show { last, data } => show(&data.folder, last, output),
            AuditAction::Verify { hash, data } => verify(&data.folder, hash.as_deref(), output),
        }
    }
}

fn read(folder: &Path) -> Result<(String, chain::ChainEnd), CliError> {
    audit::read(folder).map_err(CliError::file(&folder.join(AUDIT_FILE), "reading"))
}

fn show(folder: &Path, last: usize, output: &Output) -> Result<Done, CliError> {
    let (text, _) = read(folder)?;
    let skipped = text.lines().count().saturating_sub(last);
    let entries = chain::entries(text.lines().skip(skipped));
    output.result(&entries, || {
        entries.iter().map(line).collect::<Vec<_>>().join("\n")
    })?;
    Ok(Done::Success)
}

/// One entry for people.
fn line(entry: &AuditEntry) -> String {
    let deed = &entry.deed;
    let times = if entry.times > 1 {
        format!(" ({} times)", entry.times)
    } else {
        String::new()
    };
    let status = if deed.status > 0 {
        format!(" -> {}", deed.status)
    } else {
        String::new()
    };
    let client = if deed.client.is_empty() {
        String::new()
    } else {
        format!(" ({})", deed.client)
    };
    let detail = if deed.detail.is_empty() {
        String::new()
    } else {
        format!(": {}", deed.detail)
    };
    format!(
        "{}  {}{client}  {}{times}{status}{detail}",
        entry.time_utc, deed.who, deed.what
    )
}

fn verify(folder: &Path, hash: Option<&str>, output: &Output) -> Result<Done, CliError> {
    let (text, end) = read(folder)?;
    let mut check = chain::check(&text, &end);
    if let Some(hash) = hash
        && !chain::has_hash(&text, hash)
    {
        check.problems.push(format!(
            "no line has the hash {hash}: the log was written again, or is another one"
        ));
    }
    output.result(&check, || match check.problems.as_slice() {
        [] => format!(
            "{} entries, none changed; hash of the last one: {}",
            check.lines, check.hash
        ),
        problems => problems.join("\n"),
    })?;
    Ok(Done::success_if(check.problems.is_empty()))
}
