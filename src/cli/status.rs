//! `leafbench status`.

use clap::Args;

use super::shared::client::DataArg;
use super::shared::progress::duration;
use super::{CliCommand, CliError, Done, Output};
use crate::control::Phase;
use crate::control::realtime::LoopHealth;
use crate::daemon::client_types::Status;
use crate::protocol::message::Cause;

/// Show what the bench is doing
#[derive(Debug, Args)]
pub(super) struct StatusArgs {
    #[command(flatten)]
    data: DataArg,
}

impl CliCommand for StatusArgs {
    const NAME: &'static str = "status";
    const EXAMPLES: &'static [&'static str] = &["leafbench status", "leafbench status --json"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let client = self.data.client()?;
        let status: Status = client.get("/api/status")?;
        output.result(&status, || text(&status, &client.page()))?;
        Ok(Done::Success)
    }
}

/// The phase in words, with what to do where the rig waits for a person.
fn phase_text(phase: Phase) -> &'static str {
    match phase {
        Phase::Connecting => "not connected",
        Phase::Ready => "ready",
        Phase::Arming => "arming",
        Phase::Running => "running",
        Phase::Held => "on hold: resume or stop",
        Phase::Unloading => "unloading",
        Phase::Interlocked => "interlocked: remove the cause, then `leafbench reset`",
    }
}

/// The word for a cause, as in docs/faults.md.
fn word(cause: &Cause) -> String {
    let value = serde_json::to_value(cause);
    let word = value.as_ref().ok().and_then(serde_json::Value::as_str);
    word.unwrap_or_default().to_owned()
}

/// The run under way or the last one, and what is wrong with its disk.
fn run_lines(s: &Status) -> Vec<String> {
    let mut lines = Vec::new();
    if let (Some(run), Some(profile)) = (&s.rig.run_id, &s.rig.profile) {
        lines.push(format!(
            "run           {run} ({profile}), cycle {} of {}, {} left",
            s.rig.cycles_completed,
            s.rig.cycles_total,
            duration(s.rig.remaining_s)
        ));
    } else if let Some(run) = &s.run {
        let ending = run.ending.as_deref().unwrap_or("not started");
        lines.push(format!(
            "last run      {} ({}), {ending} {}",
            run.run_id, run.profile, run.cause
        ));
    }
    let problem = s.run.as_ref().map(|run| &run.disk_problem);
    if let Some(problem) = problem.filter(|text| !text.is_empty()) {
        lines.push(format!("disk          {problem}"));
    }
    lines
}

/// The line of the control loop's punctuality.
fn control_loop(health: &LoopHealth) -> String {
    let skipped = match health.skipped_ms {
        0 => String::new(),
        ms => format!("; this computer was too slow for the mock rig, which stood still for {ms} ms"),
    };
    format!(
        "control loop  {} of {} turns late, worst {:.1} ms{skipped}",
        health.late_turns,
        health.turns,
        health.worst_lateness_us as f64 / 1000.0
    )
}

fn text(s: &Status, page: &str) -> String {
    let reading = |value: Option<f64>, digits: usize, unit: &str| {
        value.map_or("no reading".to_owned(), |v| format!("{v:.digits$} {unit}"))
    };
    let mut lines = vec![
        format!("bench         {} at {}, page {page}", s.bench, s.link),
        format!("state         {}", phase_text(s.rig.phase)),
        format!("force         {}", reading(s.rig.force_n, 1, "N")),
        format!("displacement  {}", reading(s.rig.displacement_mm, 3, "mm")),
    ];
    if s.preparing {
        lines.push(
            "preparing     a run: its profile is being checked; `leafbench stop` withdraws it".to_owned(),
        );
    }
    if s.rig.cause != Cause::None {
        lines.push(format!("cause         {}", word(&s.rig.cause)));
    }
    lines.extend(run_lines(s));
    lines.push(format!(
        "link          {}, {} samples, {} lost, {} late, {} frames refused, {} bus errors",
        if s.link_open { "open" } else { "closed" },
        s.rig.counters.samples,
        s.rig.counters.lost,
        s.rig.counters.late,
        s.rig.counters.frames_refused,
        s.rig.counters.bus_errors
    ));
    lines.push(control_loop(&s.control_loop));
    if !s.rig.notice.is_empty() {
        lines.push(format!("notice        {}", s.rig.notice));
    }
    lines.extend(s.degraded.iter().map(|d| format!("degraded      {d}")));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::RigStatus;

    fn status() -> Status {
        Status {
            version: String::new(),
            bench: "mock".to_owned(),
            link: "mock:".to_owned(),
            link_open: true,
            data_folder: String::new(),
            twin: String::new(),
            degraded: Vec::new(),
            warnings: Vec::new(),
            plot: crate::daemon::client_types::PlotScale::default(),
            preparing: false,
            rig: RigStatus::unknown(),
            control_loop: LoopHealth::default(),
            run: None,
        }
    }

    #[test]
    fn the_cause_of_a_latched_rig_is_named_as_in_the_documents() {
        let mut tripped = status();
        assert!(!text(&tripped, "").contains("cause"));
        tripped.rig.phase = Phase::Interlocked;
        tripped.rig.cause = Cause::LeaseLapsed;
        let said = text(&tripped, "");
        assert!(said.contains("\ncause         lease_lapsed\n"), "{said}");
    }

    #[test]
    fn a_run_that_is_being_prepared_is_shown() {
        let preparing = Status {
            preparing: true,
            ..status()
        };
        assert!(text(&preparing, "").contains("preparing     a run"));
    }
}
