//! The command line: the only part that knows all others. One file a command; a new one is a file and a line in [`COMMANDS`].

mod blind;
mod client;
mod daemon;
mod demo;
mod diagnose;
mod error;
mod export;
mod hold;
mod identify;
mod local;
mod mock_rig;
mod papers;
mod plan;
mod progress;
mod reset;
mod resume;
mod run;
mod run_next;
mod runs;
mod simulate;
mod status;
mod stop;
mod tare;
mod targets;
pub(crate) mod virtual_bench;

use std::io::Write;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::{Arg, ArgAction, ArgMatches};

pub(crate) use error::CliError;

/// A command of leafbench.
pub(crate) struct Command {
    /// As typed.
    pub name: &'static str,
    /// One sentence.
    pub what: &'static str,
    /// Adds its own arguments.
    pub arguments: fn(clap::Command) -> clap::Command,
    /// Does it.
    pub run: fn(&ArgMatches, &Output) -> Result<Done, CliError>,
}

/// All commands, in the order of a working day.
pub(crate) static COMMANDS: &[Command] = &[
    daemon::COMMAND,
    run::COMMAND,
    stop::COMMAND,
    hold::COMMAND,
    resume::COMMAND,
    reset::COMMAND,
    tare::COMMAND,
    status::COMMAND,
    runs::COMMAND,
    export::COMMAND,
    plan::COMMAND,
    simulate::COMMAND,
    identify::COMMAND,
    papers::COMMAND,
    mock_rig::COMMAND,
    diagnose::COMMAND,
    blind::COMMAND,
    demo::COMMAND,
];

/// How a command ended that did what it could.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Done {
    /// As asked for: exit code 0.
    Well,
    /// The run did not complete, a trip is predicted, or data are missing: exit code 1.
    Otherwise,
}

const EXIT_CODES: &str = "Exit codes: 0 done; 1 the run ended without completing, a trip is predicted or data are damaged; \
                          2 unusable input or usage; 3 no daemon; 4 the daemon refused";

/// Where results go: text for people, one JSON value for scripts. Progress and errors go to stderr.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Output {
    /// `--json`.
    pub json: bool,
}

impl Output {
    /// Prints a result. A reader that has gone (`| head`) is no error.
    pub(crate) fn result<T: serde::Serialize>(
        &self,
        value: &T,
        text: impl FnOnce() -> String,
    ) -> Result<(), CliError> {
        let line = if self.json {
            serde_json::to_string(value).map_err(|e| CliError::Internal(e.to_string()))?
        } else {
            text()
        };
        let _ = writeln!(std::io::stdout().lock(), "{}", line.trim_end());
        Ok(())
    }
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let matches = match command_line().try_get_matches() {
        Ok(matches) => matches,
        Err(error) => {
            // Help and version come this way too. A closed stdout is no error.
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { 2 } else { 0 });
        }
    };
    let Some((name, arguments)) = matches.subcommand() else {
        return ExitCode::from(2);
    };
    let output = Output {
        json: arguments.get_flag("json"),
    };
    let Some(command) = COMMANDS.iter().find(|c| c.name == name) else {
        return ExitCode::from(2);
    };
    match (command.run)(arguments, &output) {
        Ok(Done::Well) => ExitCode::SUCCESS,
        Ok(Done::Otherwise) => ExitCode::from(1),
        Err(error) => {
            report(&error, output);
            ExitCode::from(error.exit_code())
        }
    }
}

/// The whole chain of causes, outermost first.
fn report(error: &CliError, output: Output) {
    let text = crate::daemon::chain(error);
    let mut stderr = std::io::stderr().lock();
    let _ = match output.json {
        true => writeln!(stderr, "{}", serde_json::json!({ "error": text })),
        false => writeln!(stderr, "error: {text}"),
    };
}

fn command_line() -> clap::Command {
    let json = Arg::new("json")
        .long("json")
        .action(ArgAction::SetTrue)
        .global(true)
        .help("Results as JSON on stdout, errors as JSON on stderr");
    let top = clap::Command::new("leafbench")
        .about("Controls a leaf-spring test bench, records it, and steps a virtual twin beside it")
        .version(env!("CARGO_PKG_VERSION"))
        .subcommand_required(true)
        .arg_required_else_help(true)
        .after_help(EXIT_CODES)
        .arg(json);
    COMMANDS.iter().fold(top, |top, c| {
        top.subcommand((c.arguments)(clap::Command::new(c.name).about(c.what)))
    })
}

/// Sets `stop` at Ctrl-C. Where signals cannot be had, what was begun runs to its end: that is all it costs.
fn stop_on_ctrl_c(stop: Arc<AtomicBool>) {
    let listen = move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build();
        if let Ok(runtime) = runtime
            && runtime.block_on(tokio::signal::ctrl_c()).is_ok()
        {
            stop.store(true, Ordering::Relaxed);
        }
    };
    let _ = std::thread::Builder::new()
        .name("ctrl-c".to_owned())
        .spawn(listen);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent_and_every_command_has_a_sentence() {
        command_line().debug_assert();
        let mut names: Vec<_> = COMMANDS.iter().map(|c| c.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), COMMANDS.len());
        assert!(
            COMMANDS
                .iter()
                .all(|c| c.what.len() > 20 && !c.what.ends_with('.'))
        );
    }
}
