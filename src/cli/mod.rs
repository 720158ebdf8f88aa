//! The command line: the only module that uses all others.
//!
//! Each command is one file, which holds a struct with the command's arguments and its [`CliCommand`]; `diagnose` and
//! `calibrate` are folders, because they have several steps. A new command is one file and one line in [`COMMANDS`]. What several commands use (errors,
//! progress, Ctrl-C, the client of the daemon, the files of this computer, the virtual bench) is in `shared`.

mod archive;
mod audit;
mod blind;
mod calibrate;
mod certificate;
mod completions;
pub(crate) mod daemon;
mod demo;
pub(crate) mod diagnose;
mod doctor;
mod export;
mod fleet;
mod hold;
pub(crate) mod identify;
mod import;
mod jog;
pub(crate) mod lab;
mod man;
mod mock_rig;
mod new;
mod open;
mod papers;
mod plan;
mod reset;
mod result;
mod resume;
mod rig_check;
mod run;
mod runs;
mod shared;
mod simulate;
mod status;
mod stop;
mod tare;
mod token;
mod verify;
mod watch;
mod zero;

use std::io::Write;
use std::process::ExitCode;

use clap::{ArgMatches, Args};

pub(crate) use diagnose::inputs as diagnose_inputs;
pub(crate) use diagnose::steps as bench_diagnosis;
pub(crate) use shared::error::CliError;
pub(crate) use shared::local;
pub(crate) use shared::virtual_bench;

/// A command of leafbench: a struct with one field for each argument. The struct's doc comment is the command's sentence in the
/// help; the fields' doc comments, types and attributes are the arguments.
trait CliCommand: Args {
    /// Name of the command on the command line.
    const NAME: &'static str;
    /// Complete command lines for the end of the help; they use the shipped profiles and benches only.
    const EXAMPLES: &'static [&'static str];

    /// Executes the command.
    fn run(self, output: &Output) -> Result<Done, CliError>;
}

/// One line of [`COMMANDS`].
struct CommandEntry {
    name: &'static str,
    examples: &'static [&'static str],
    add_arguments: fn(clap::Command) -> clap::Command,
    run: fn(&ArgMatches, &Output) -> Result<Done, CliError>,
}

impl CommandEntry {
    const fn of<C: CliCommand>() -> CommandEntry {
        CommandEntry {
            name: C::NAME,
            examples: C::EXAMPLES,
            add_arguments: C::augment_args,
            run: parse_and_run::<C>,
        }
    }

    /// The command with its arguments; its help ends with its notes, if it has any, and its examples.
    fn command(&self) -> clap::Command {
        let command = (self.add_arguments)(clap::Command::new(self.name));
        let notes = command
            .get_after_help()
            .map_or(String::new(), |notes| format!("{notes}\n\n"));
        command.after_help(format!("{notes}Examples:\n  {}", self.examples.join("\n  ")))
    }
}

fn parse_and_run<C: CliCommand>(matches: &ArgMatches, output: &Output) -> Result<Done, CliError> {
    let command = C::from_arg_matches(matches).map_err(|e| CliError::Internal(e.to_string()))?;
    command.run(output)
}

/// All commands, in the order of a working day.
static COMMANDS: &[CommandEntry] = &[
    CommandEntry::of::<daemon::DaemonArgs>(),
    CommandEntry::of::<open::OpenArgs>(),
    CommandEntry::of::<run::RunArgs>(),
    CommandEntry::of::<watch::WatchArgs>(),
    CommandEntry::of::<stop::StopArgs>(),
    CommandEntry::of::<hold::HoldArgs>(),
    CommandEntry::of::<resume::ResumeArgs>(),
    CommandEntry::of::<reset::ResetArgs>(),
    CommandEntry::of::<tare::TareArgs>(),
    CommandEntry::of::<zero::ZeroArgs>(),
    CommandEntry::of::<jog::JogArgs>(),
    CommandEntry::of::<status::StatusArgs>(),
    CommandEntry::of::<runs::RunsArgs>(),
    CommandEntry::of::<result::ResultArgs>(),
    CommandEntry::of::<certificate::CertificateArgs>(),
    CommandEntry::of::<export::ExportArgs>(),
    CommandEntry::of::<import::ImportArgs>(),
    CommandEntry::of::<archive::ArchiveArgs>(),
    CommandEntry::of::<verify::VerifyArgs>(),
    CommandEntry::of::<new::NewArgs>(),
    CommandEntry::of::<plan::PlanArgs>(),
    CommandEntry::of::<simulate::SimulateArgs>(),
    CommandEntry::of::<identify::IdentifyArgs>(),
    CommandEntry::of::<papers::PapersArgs>(),
    CommandEntry::of::<mock_rig::MockRigArgs>(),
    CommandEntry::of::<rig_check::RigCheckArgs>(),
    CommandEntry::of::<doctor::DoctorArgs>(),
    CommandEntry::of::<token::TokenArgs>(),
    CommandEntry::of::<audit::AuditArgs>(),
    CommandEntry::of::<calibrate::CalibrateArgs>(),
    CommandEntry::of::<diagnose::DiagnoseArgs>(),
    CommandEntry::of::<fleet::FleetArgs>(),
    CommandEntry::of::<blind::BlindArgs>(),
    CommandEntry::of::<lab::LabArgs>(),
    CommandEntry::of::<demo::DemoArgs>(),
    CommandEntry::of::<completions::CompletionsArgs>(),
    CommandEntry::of::<man::ManArgs>(),
];

/// How a command ended that met no error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Done {
    /// The result is as wanted: exit code 0.
    Success,
    /// The run did not complete or did not keep its limits, a trip is predicted, a fit did not converge, data are damaged, or the computer has a problem: exit
    /// code 1.
    Negative,
}

impl Done {
    fn success_if(condition: bool) -> Done {
        if condition { Done::Success } else { Done::Negative }
    }
}

const EXIT_CODES: &str = "Exit codes: 0 done; 1 the run ended without completing or did not keep its limits, a trip is \
                          predicted, a fit did not converge, data are damaged or `doctor` found a problem; \
                          2 unusable input or usage; 3 no daemon; 4 the daemon refused";

/// Where results go: text for people, one JSON value for scripts. Progress and errors go to stderr.
#[derive(Debug, Clone, Copy, Args)]
pub(crate) struct Output {
    /// Results as JSON on stdout, errors as JSON on stderr
    #[arg(long, global = true, display_order = 900)]
    pub json: bool,
}

impl Output {
    /// Prints a result. A closed stdout (`| head`) is not an error.
    fn result<T: serde::Serialize>(&self, value: &T, text: impl FnOnce() -> String) -> Result<(), CliError> {
        let line = if self.json {
            serde_json::to_string(value).map_err(|e| CliError::Internal(e.to_string()))?
        } else {
            text()
        };
        let _ = writeln!(std::io::stdout().lock(), "{}", line.trim_end());
        Ok(())
    }

    /// The error with all its causes, outermost first.
    fn error(&self, error: &CliError) {
        self.error_text(&crate::daemon::chain(error), error.exit_code());
    }

    fn error_text(&self, text: &str, exit_code: u8) {
        let mut stderr = std::io::stderr().lock();
        let _ = match self.json {
            true => writeln!(
                stderr,
                "{}",
                serde_json::json!({ "error": text, "exit_code": exit_code })
            ),
            false => writeln!(stderr, "error: {text}"),
        };
    }

    /// A line for people on stderr, beside the result; scripts get none.
    fn note(&self, text: &str) {
        if !self.json {
            eprintln!("note: {text}");
        }
    }
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    end_with_the_first_panic();
    let matches = match command_line().try_get_matches() {
        Ok(matches) => matches,
        Err(error) => {
            return refused_arguments(&error);
        }
    };
    let Some((name, arguments)) = matches.subcommand() else {
        return ExitCode::from(2);
    };
    let output = Output {
        json: arguments.get_flag("json"),
    };
    let Some(entry) = COMMANDS.iter().find(|c| c.name == name) else {
        return ExitCode::from(2);
    };
    match (entry.run)(arguments, &output) {
        Ok(Done::Success) => ExitCode::SUCCESS,
        Ok(Done::Negative) => ExitCode::from(1),
        Err(error) => {
            output.error(&error);
            ExitCode::from(error.exit_code())
        }
    }
}

/// Ends the process at the first panic: otherwise the daemon could renew the rig's lease and control nothing. Without a lease the rig
/// unloads by itself.
pub(crate) fn end_with_the_first_panic() {
    let report = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        report(panic);
        std::process::abort();
    }));
}

/// Prints why the arguments cannot be used. Help and version come this way too.
fn refused_arguments(error: &clap::Error) -> ExitCode {
    // The arguments were not understood, so it is only known that the word is among them.
    let json = std::env::args_os().any(|argument| argument == "--json");
    match (error.use_stderr(), json) {
        (true, true) => {
            let text = error.to_string();
            let text = text.trim().trim_start_matches("error: ");
            Output { json }.error_text(text, UNUSABLE);
        }
        // A closed stdout is not an error.
        _ => {
            let _ = error.print();
        }
    }
    ExitCode::from(if error.use_stderr() { UNUSABLE } else { 0 })
}

/// Exit code of unusable input or usage.
const UNUSABLE: u8 = 2;
/// Name of the program.
const PROGRAM: &str = "leafbench";

fn command_line() -> clap::Command {
    Output::augment_args(clap::Command::new(PROGRAM))
        .about("Controls a leaf-spring test bench, records it, and steps a virtual twin beside it")
        .version(env!("CARGO_PKG_VERSION"))
        .subcommand_required(true)
        .arg_required_else_help(true)
        .after_help(EXIT_CODES)
        .subcommands(COMMANDS.iter().map(CommandEntry::command))
}

/// Why the program would not take these words of a command line, for the tests of the documents.
#[cfg(test)]
pub(crate) fn refusal(words: &[String]) -> Option<String> {
    let parsed = command_line().try_get_matches_from(words);
    parsed.err().map(|error| error.to_string())
}

/// Names of all commands, for the tests of their help.
#[cfg(test)]
pub(crate) fn command_names() -> impl Iterator<Item = &'static str> {
    COMMANDS.iter().map(|c| c.name)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::daemon::library::Library;

    #[test]
    fn the_command_line_is_consistent_and_every_command_has_a_sentence() {
        command_line().debug_assert();
        let mut names: Vec<_> = COMMANDS.iter().map(|c| c.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), COMMANDS.len());
        for command in command_line().get_subcommands() {
            let about = command.get_about().map(ToString::to_string).unwrap_or_default();
            assert!(
                about.len() > 20 && !about.ends_with('.') && !about.contains('\n'),
                "{}: {about:?}",
                command.get_name()
            );
            for argument in command.get_arguments() {
                assert!(argument.get_help().is_some(), "{} {argument}", command.get_name());
            }
        }
    }

    /// Every example parses; its profiles and the files below `bench-configs` are shipped.
    #[test]
    fn every_command_has_examples_that_work() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let profiles = Library::open(&root.join("bench-configs/profiles")).expect("shipped");
        for entry in COMMANDS {
            assert!(!entry.examples.is_empty(), "{}", entry.name);
            for example in entry.examples {
                // Quotes are for the shell.
                let example = example.replace('"', "");
                let words = example.split_whitespace();
                let matches = command_line()
                    .try_get_matches_from(words.clone())
                    .unwrap_or_else(|e| panic!("{example}: {e}"));
                let (name, arguments) = matches.subcommand().expect("required");
                assert_eq!(name, entry.name, "{example}");
                if let Ok(Some(profile)) = arguments.try_get_one::<String>("profile") {
                    profiles.find(profile).expect("a shipped profile");
                }
                for file in words.filter(|w| w.starts_with("bench-configs/")) {
                    assert!(root.join(file).is_file(), "{example}: {file}");
                }
            }
        }
    }
}
