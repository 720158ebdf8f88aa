//! `leafbench token`: adds, lists and removes tokens.

use std::path::Path;

use clap::{Args, Subcommand};
use serde::Serialize;

use super::shared::client::DataArg;
use super::{CliCommand, CliError, Done, Output};
use crate::daemon::access::role::Role;
use crate::daemon::access::tokens::TokenList;

/// Say who may use the bench: add, list and remove tokens; a running daemon takes it over at once
#[derive(Debug, Args)]
#[command(
    after_help = "Run it as the user of the daemon, or as root. The owner of the data folder needs no token of their own: \
                  commands find the file `token` there by themselves."
)]
pub(super) struct TokenArgs {
    #[command(subcommand)]
    action: TokenAction,
}

#[derive(Debug, Subcommand)]
enum TokenAction {
    /// Make a token for a person or a program, and print it: it is shown this once and stored nowhere
    Add {
        /// Name of the person or program, as it will stand in the audit log
        name: String,
        /// What the token allows
        #[arg(long, value_enum)]
        role: Role,
        #[command(flatten)]
        data: DataArg,
    },
    /// Show the names and roles of all tokens
    List {
        #[command(flatten)]
        data: DataArg,
    },
    /// Remove a token: its sessions end too
    Remove {
        /// Name of the token
        name: String,
        #[command(flatten)]
        data: DataArg,
    },
}

/// A new token.
#[derive(Serialize)]
struct MadeToken<'t> {
    name: &'t str,
    role: Role,
    token: &'t str,
}

/// A token without its secret.
#[derive(Serialize)]
struct ShownToken {
    name: String,
    role: Role,
    since_utc: String,
}

impl CliCommand for TokenArgs {
    const NAME: &'static str = "token";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench token add meyer --role operate",
        "leafbench token list",
        "leafbench token remove meyer",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        match self.action {
            TokenAction::Add { name, role, data } => add(&data.folder, &name, role, output)?,
            TokenAction::List { data } => list(&data.folder, output)?,
            TokenAction::Remove { name, data } => {
                TokenList::remove(&data.folder, &name)?;
                output.result(&serde_json::json!({ "removed": name }), || {
                    format!("token {name} removed")
                })?;
            }
        }
        Ok(Done::Success)
    }
}

fn add(folder: &Path, name: &str, role: Role, output: &Output) -> Result<(), CliError> {
    if !folder.is_dir() {
        return Err(CliError::Input(format!(
            "{} is no data folder: start the daemon once, or give its folder with --data",
            folder.display()
        )));
    }
    let secret = TokenList::add(folder, name, role)?;
    let token = secret.reveal();
    output.note(&format!(
        "the token of {name} is below, and is shown this once; {name} pastes it into the page, or stores it in \
         ~/.config/leafbench/token with mode 0600"
    ));
    output.result(&MadeToken { name, role, token }, || token.to_owned())
}

fn list(folder: &Path, output: &Output) -> Result<(), CliError> {
    let shown: Vec<ShownToken> = TokenList::read(folder)?
        .tokens
        .into_iter()
        .map(|token| ShownToken {
            name: token.name,
            role: token.role,
            since_utc: token.since_utc,
        })
        .collect();
    output.result(&shown, || {
        if shown.is_empty() {
            return "no tokens; the owner of the data folder needs none".to_owned();
        }
        let line = |t: &ShownToken| format!("{:<20} {:<11} since {}", t.name, t.role.word(), t.since_utc);
        shown.iter().map(line).collect::<Vec<_>>().join("\n")
    })
}
