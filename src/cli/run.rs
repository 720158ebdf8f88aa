//! `leafbench run`.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use clap::{Arg, ArgMatches};

use super::client::{Client, data_argument};
use super::progress::{Progress, ProgressMark};
use super::{CliError, Command, Done, Output};
use crate::daemon::client_types::{Accepted, RunProgress, RunState, StartRun, Started, Status, StopRequest};

/// The daemon is asked this often.
const POLL_PERIOD: Duration = Duration::from_millis(150);

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "run",
    what: "Run a profile on the rig and wait for its end; Ctrl-C stops the run and unloads the rig",
    arguments,
    run,
};

fn arguments(command: clap::Command) -> clap::Command {
    let text =
        |name: &'static str, help: &'static str| Arg::new(name).long(name).value_name("TEXT").help(help);
    command
        .arg(
            Arg::new("profile")
                .value_name("PROFILE")
                .required_unless_present("resume")
                .help("Name of a profile, or a profile file (.toml)"),
        )
        .arg(
            Arg::new("resume")
                .long("resume")
                .value_name("RUN")
                .help("Go on with this interrupted run at the cycle after its last complete one"),
        )
        .arg(text("specimen", "Specimen [default: the bench's]"))
        .arg(text("operator", "Who runs the test"))
        .arg(data_argument())
}

fn run(matches: &ArgMatches, output: &Output) -> Result<Done, CliError> {
    let client = Client::of(matches)?;
    let order = order(matches)?;
    let interrupts = interrupts();
    let started: Started = client.post("/api/run", &order)?;
    if !output.json {
        eprintln!("run {} started; page: {}", started.run_id, client.page());
    }
    let ended = wait(&client, &started.run_id, &interrupts, output)?;
    output.result(&ended, || text(&ended))?;
    Ok(if ended.ending.as_deref() == Some("completed") {
        Done::Well
    } else {
        Done::Otherwise
    })
}

fn order(matches: &ArgMatches) -> Result<StartRun, CliError> {
    let argument = |name: &str| matches.get_one::<String>(name).cloned();
    let profile = match argument("profile") {
        // The daemon may run in another folder: it gets the file's text.
        Some(path) if path.ends_with(".toml") => {
            Some(std::fs::read_to_string(&path).map_err(CliError::file(path.as_ref(), "reading"))?)
        }
        name => name,
    };
    Ok(StartRun {
        profile,
        specimen: argument("specimen"),
        operator: argument("operator"),
        resume_run: argument("resume"),
    })
}

/// Counts Ctrl-C from now on instead of ending this process.
pub(super) fn interrupts() -> Arc<AtomicU32> {
    let count = Arc::new(AtomicU32::new(0));
    let counter = Arc::clone(&count);
    // Where no thread can be had Ctrl-C ends this process as usual; the run goes on.
    let _ = std::thread::Builder::new()
        .name("ctrl-c".to_owned())
        .spawn(move || {
            let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else {
                return;
            };
            runtime.block_on(async {
                while tokio::signal::ctrl_c().await.is_ok() {
                    counter.fetch_add(1, Ordering::Relaxed);
                }
            });
        });
    count
}

/// Follows a run to its end; Ctrl-C stops it.
pub(super) fn wait(
    client: &Client,
    run_id: &str,
    interrupts: &AtomicU32,
    output: &Output,
) -> Result<RunProgress, CliError> {
    let mut progress: Option<Progress> = None;
    let mut stop_asked = false;
    loop {
        std::thread::sleep(POLL_PERIOD);
        let pressed = interrupts.load(Ordering::Relaxed);
        if pressed > 0 && !stop_asked {
            stop_asked = true;
            eprintln!(
                "\nCtrl-C: the run is being stopped, the rig unloads (press again to leave that to the daemon)"
            );
            let reason = Some("stopped by Ctrl-C in leafbench run".to_owned());
            // Refused where the run has just ended: then the next look says so.
            let _ = client.post::<Accepted>("/api/stop", &StopRequest { reason });
        } else if pressed > 1 {
            return Err(CliError::Refused(format!(
                "left while run {run_id} was being stopped"
            )));
        }
        let status: Status = client.get("/api/status").map_err(|e| match e {
            CliError::NoDaemon { .. } => CliError::DaemonGone,
            other => other,
        })?;
        let Some(run) = status.run.filter(|run| run.run_id == run_id) else {
            return Err(CliError::Refused(format!(
                "the daemon has gone on from run {run_id}: see `leafbench runs`"
            )));
        };
        if run.is_over() {
            if let Some(progress) = progress {
                progress.finish();
            }
            return Ok(run);
        }
        if status.rig.run_id.as_deref() == Some(run_id) {
            let bar = progress.get_or_insert_with(|| Progress::new(&run.profile, output.json));
            bar.show(ProgressMark {
                elapsed_s: status.rig.elapsed_s,
                remaining_s: status.rig.remaining_s,
                cycles: status.rig.cycles_completed,
                cycles_total: status.rig.cycles_total,
            });
        }
    }
}

fn text(run: &RunProgress) -> String {
    if run.state == RunState::NeverStarted {
        return format!("run {} did not start: {}", run.run_id, run.cause);
    }
    let mut lines = vec![format!(
        "run {} {}",
        run.run_id,
        run.ending.as_deref().unwrap_or("ended")
    )];
    if !run.cause.is_empty() {
        lines.push(format!("cause    {}", run.cause));
    }
    lines.push(format!(
        "samples  {}, {} lost; {} counted cycles",
        run.samples, run.lost, run.cycles_completed
    ));
    if !run.disk_problem.is_empty() {
        lines.push(format!(
            "disk     the run file is not complete: {}",
            run.disk_problem
        ));
    }
    lines.push(format!("CSV      leafbench export {}", run.run_id));
    lines.join("\n")
}
