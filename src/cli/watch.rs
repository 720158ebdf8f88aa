//! `leafbench watch`.

use std::sync::atomic::AtomicU32;
use std::time::Duration;

use clap::Args;

use super::run::{self, EndedRun};
use super::shared::client::{Client, DataArg};
use super::{CliCommand, CliError, Done, Output};
use crate::daemon::client_types::{RunProgress, Status};

/// Pause between two looks at a run that is being prepared.
const POLL_PERIOD: Duration = Duration::from_millis(150);

/// Follow the run under way to its end, as `run` does; Ctrl-C leaves the run as it is
#[derive(Debug, Args)]
#[command(
    after_help = "If the last run is over, its end is printed. The exit code is that of `leafbench run`."
)]
pub(super) struct WatchArgs {
    #[command(flatten)]
    data: DataArg,
}

impl CliCommand for WatchArgs {
    const NAME: &'static str = "watch";
    const EXAMPLES: &'static [&'static str] = &["leafbench watch", "leafbench watch --json"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let client = self.data.client()?;
        let run = newest_run(&client)?;
        if !output.json && !run.is_over() {
            eprintln!(
                "run {} ({}); page: {}; Ctrl-C leaves the run as it is",
                run.run_id,
                run.profile,
                client.page()
            );
        }
        // Nobody counts up: Ctrl-C ends this process, and the daemon goes on.
        let ended = run::wait(&client, &run.run_id, &AtomicU32::new(0), output)?;
        let ended = EndedRun::of(&client, ended)?;
        output.result(&ended, || ended.text())?;
        Ok(ended.done())
    }
}

/// The run under way, or the last one. Waits for a run that is being prepared.
fn newest_run(client: &Client) -> Result<RunProgress, CliError> {
    loop {
        let status: Status = client.get("/api/status")?;
        match (status.preparing, status.run) {
            (false, Some(run)) => return Ok(run),
            (true, Some(run)) if !run.is_over() => return Ok(run),
            (true, _) => std::thread::sleep(POLL_PERIOD),
            (false, None) => {
                return Err(CliError::Refused(
                    "no run was started since the daemon began: `leafbench run PROFILE` starts one, `leafbench runs` lists the \
                     earlier ones"
                        .to_owned(),
                ));
            }
        }
    }
}
