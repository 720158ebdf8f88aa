//! `leafbench completions`.

use clap::Args;
use clap_complete::Shell;

use super::{CliCommand, CliError, Done, Output};

/// Print the script with which a shell completes commands and options
#[derive(Debug, Args)]
#[command(
    after_help = "bash: leafbench completions bash > ~/.local/share/bash-completion/completions/leafbench\n\
                        zsh:  leafbench completions zsh > _leafbench, in a folder of $fpath\n\
                        fish: leafbench completions fish > ~/.config/fish/completions/leafbench.fish"
)]
pub(super) struct CompletionsArgs {
    /// The shell that completes
    #[arg(value_name = "SHELL", value_enum)]
    shell: Shell,
}

/// The script, for `--json`.
#[derive(serde::Serialize)]
struct CompletionScript {
    shell: String,
    script: String,
}

impl CliCommand for CompletionsArgs {
    const NAME: &'static str = "completions";
    const EXAMPLES: &'static [&'static str] = &["leafbench completions bash"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let mut script = Vec::new();
        let mut command = super::command_line();
        clap_complete::generate(self.shell, &mut command, super::PROGRAM, &mut script);
        let script = String::from_utf8(script).map_err(|e| CliError::Internal(e.to_string()))?;
        let printed = CompletionScript {
            shell: self.shell.to_string(),
            script,
        };
        output.result(&printed, || printed.script.clone())?;
        Ok(Done::Success)
    }
}
