//! `leafbench zero`.

use std::sync::atomic::Ordering;
use std::time::Duration;

use clap::Args;

use super::shared::client::CommandArgs;
use super::shared::ctrl_c::ctrl_c_flag;
use super::{CliCommand, CliError, Done, Output};
use crate::control::Phase;
use crate::daemon::client_types::{Accepted, Nothing, Status};

/// Time between two looks at the rig.
const LOOK_PERIOD: Duration = Duration::from_millis(100);

/// Return to the tared zero of the LVDT at 2 mm/s or less, with all limits on, and wait for its end; Ctrl-C stops
#[derive(Debug, Args)]
pub(super) struct ZeroArgs {
    #[command(flatten)]
    command: CommandArgs,
}

impl CliCommand for ZeroArgs {
    const NAME: &'static str = "zero";
    const EXAMPLES: &'static [&'static str] = &["leafbench zero", "leafbench zero --json"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let client = self.command.to_the_end()?;
        let stop = ctrl_c_flag();
        let _: Accepted = client.post("/api/zero", &Nothing {})?;
        let mut stopped = false;
        let status = loop {
            let status: Status = client.get("/api/status")?;
            let at_rest = matches!(
                status.rig.phase,
                Phase::Ready | Phase::Interlocked | Phase::Connecting
            );
            if at_rest {
                break status;
            }
            if !stopped && stop.load(Ordering::Relaxed) {
                client.stop(Some("Ctrl-C of leafbench zero".to_owned()))?;
                stopped = true;
            }
            std::thread::sleep(LOOK_PERIOD);
        };
        output.result(&status.rig, || text(&status))?;
        let rig = &status.rig;
        Ok(Done::success_if(
            !stopped && rig.phase == Phase::Ready && rig.off_zero.is_empty(),
        ))
    }
}

fn text(status: &Status) -> String {
    let rig = &status.rig;
    let (Some(force_n), Some(displacement_mm)) = (rig.force_n, rig.displacement_mm) else {
        return format!("no reading; {}", rig.notice);
    };
    match (rig.off_zero.is_empty(), rig.phase) {
        (_, Phase::Interlocked) => format!("interlocked: {}. {}", rig.interlock(), rig.off_zero),
        (true, _) => format!("at zero: {force_n:.1} N, {displacement_mm:.3} mm"),
        (false, _) => rig.off_zero.clone(),
    }
}
