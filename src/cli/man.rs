//! `leafbench man`.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;

use super::{CliCommand, CliError, Done, Output};
use crate::recording::atomic_file;

/// Write the manual pages of all commands, for `man leafbench` and `man leafbench-run`
#[derive(Debug, Args)]
pub(super) struct ManArgs {
    /// Folder to write to; pages that are there already are replaced
    #[arg(long, value_name = "DIR", default_value = "man")]
    out: PathBuf,
}

/// The pages that were written.
#[derive(serde::Serialize)]
struct ManPages {
    pages: Vec<PathBuf>,
}

impl CliCommand for ManArgs {
    const NAME: &'static str = "man";
    const EXAMPLES: &'static [&'static str] = &["leafbench man --out man"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        std::fs::create_dir_all(&self.out).map_err(CliError::file(&self.out, "creating the folder"))?;
        let mut whole = super::command_line();
        // Gives the commands their names with the program before them.
        whole.build();
        let own = |command: &&clap::Command| command.get_name() != "help";
        let commands: Vec<&clap::Command> = whole.get_subcommands().filter(own).collect();
        // The parts of a command, such as `leafbench token add`.
        let parts = commands
            .iter()
            .flat_map(|command| command.get_subcommands().filter(own));
        let mut pages = Vec::new();
        for command in std::iter::once(&whole)
            .chain(commands.iter().copied())
            .chain(parts)
        {
            let man = clap_mangen::Man::new(command.clone());
            let path = self.out.join(man.get_filename());
            atomic_file::write(&path, |file| {
                man.render(file)?;
                file.flush()
            })
            .map_err(CliError::file(&path, "writing"))?;
            pages.push(path);
        }
        let written = ManPages { pages };
        output.result(&written, || {
            let count = written.pages.len();
            format!(
                "{count} pages in {}: man -l {}/leafbench.1",
                self.out.display(),
                self.out.display()
            )
        })?;
        Ok(Done::Success)
    }
}
