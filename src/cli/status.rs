//! `leafbench status`.

use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};

use super::shared::client::DataArg;
use super::shared::progress::duration;
use super::{CliCommand, CliError, Done, Output};
use crate::control::realtime::LoopHealth;
use crate::control::{Phase, ZeroRemedy};
use crate::daemon::client_types::{Status, ended_words};
use crate::protocol::message::Cause;

/// Pause between two looks while waiting.
const LOOK_PERIOD: Duration = Duration::from_millis(100);

/// Show what the bench is doing
#[derive(Debug, Args)]
pub(super) struct StatusArgs {
    /// Wait until the bench is in this state, also for a daemon that is not there yet; exit code 1 if it does not come
    #[arg(long, value_name = "STATE", value_enum)]
    wait: Option<AwaitedState>,
    /// Longest time to wait, in s
    #[arg(
        long,
        value_name = "SECONDS",
        requires = "wait",
        default_value_t = 60,
        value_parser = clap::value_parser!(u64).range(0..=86_400)
    )]
    timeout: u64,
    #[command(flatten)]
    data: DataArg,
}

/// What `--wait` can wait for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum AwaitedState {
    /// The rig is at rest and takes a run
    Ready,
}

impl CliCommand for StatusArgs {
    const NAME: &'static str = "status";
    const EXAMPLES: &'static [&'static str] =
        &["leafbench status", "leafbench status --wait ready --timeout 30"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let deadline = Instant::now() + Duration::from_secs(self.timeout);
        loop {
            let asked = self.ask();
            let is_late = Instant::now() >= deadline;
            match asked {
                Err(CliError::NoDaemon { .. }) if self.wait.is_some() && !is_late => {}
                Err(error) => return Err(error),
                Ok((status, page)) => {
                    if let Some(unmet) = self.unmet(&status, is_late) {
                        match unmet {
                            Unmet::NotYet => {}
                            Unmet::InVain(why) => {
                                output.result(&status, || {
                                    format!("{}\nNOT READY: {why}", text(&status, &page))
                                })?;
                                return Ok(Done::Negative);
                            }
                        }
                    } else {
                        output.result(&status, || text(&status, &page))?;
                        return Ok(Done::Success);
                    }
                }
            }
            std::thread::sleep(LOOK_PERIOD);
        }
    }
}

/// The state that was asked for is not there.
enum Unmet {
    /// It may come.
    NotYet,
    /// It does not come, or not in time; why.
    InVain(String),
}

impl StatusArgs {
    /// The status, and the address of the page.
    fn ask(&self) -> Result<(Status, String), CliError> {
        let client = self.data.client()?;
        Ok((client.get("/api/status")?, client.page()))
    }

    /// Whether the bench is not in the state that was asked for.
    fn unmet(&self, status: &Status, is_late: bool) -> Option<Unmet> {
        let AwaitedState::Ready = self.wait?;
        match status.rig.phase {
            Phase::Ready if !status.preparing => None,
            // A person must come: no time brings it to rest.
            Phase::Interlocked => Some(Unmet::InVain(phase_text(Phase::Interlocked).to_owned())),
            phase if is_late => Some(Unmet::InVain(format!(
                "after {} s the bench is {}",
                self.timeout,
                if status.preparing {
                    "preparing a run"
                } else {
                    phase_text(phase)
                }
            ))),
            _ => Some(Unmet::NotYet),
        }
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

/// The line of a rig at rest away from zero: where it stands, and the command that helps.
fn zero_line(off_zero: &str, remedy: ZeroRemedy) -> String {
    let command = match remedy {
        ZeroRemedy::ReturnToZero => "`leafbench zero`",
        ZeroRemedy::Reset => "`leafbench reset`, then `leafbench zero`",
        ZeroRemedy::Tare => "`leafbench tare`",
    };
    format!("not at zero   {off_zero} Run {command}")
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
        let ended = ended_words(run.ending.as_deref().unwrap_or("not started"), &run.cause);
        lines.push(format!("last run      {} ({}), {ended}", run.run_id, run.profile));
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
        value.map_or("no reading".to_owned(), |v| {
            format!("{v:.digits$} {unit} from the tared zero")
        })
    };
    let mut lines = vec![
        format!("bench         {} at {}, page {page}", s.bench, s.link),
        format!("state         {}", phase_text(s.rig.phase)),
        format!("force         {}", reading(s.rig.force_n, 1, "N")),
        format!("displacement  {}", reading(s.rig.displacement_mm, 3, "mm")),
    ];
    lines.extend(s.rig.zero_remedy.map(|remedy| zero_line(&s.rig.off_zero, remedy)));
    if s.preparing {
        lines.push(
            "preparing     a run: its profile is being checked; `leafbench stop` withdraws it".to_owned(),
        );
    }
    if let Some(commander) = &s.commander {
        lines.push(format!(
            "command       {}, since {}",
            commander.name, commander.since_utc
        ));
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
            twin_diagnosis: String::new(),
            degraded: Vec::new(),
            warnings: Vec::new(),
            plot: crate::daemon::client_types::PlotScale::default(),
            preparing: false,
            commander: None,
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
    fn a_rig_away_from_zero_is_said_with_the_command_that_helps() {
        let mut bench = status();
        bench.rig.phase = Phase::Ready;
        (bench.rig.force_n, bench.rig.displacement_mm) = (Some(18.0), Some(0.3));
        let said = text(&bench, "");
        assert!(
            said.contains("\nforce         18.0 N from the tared zero\n"),
            "{said}"
        );
        assert!(
            said.contains("\ndisplacement  0.300 mm from the tared zero\n"),
            "{said}"
        );
        assert!(!said.contains("not at zero"), "{said}");
        bench.rig.off_zero = "The rig stands at 18.0 N and 0.300 mm.".to_owned();
        let mut line = |remedy| {
            bench.rig.zero_remedy = Some(remedy);
            let said = text(&bench, "");
            let line = said.lines().find(|l| l.starts_with("not at zero"));
            line.map(str::to_owned).unwrap_or_default()
        };
        assert_eq!(
            line(ZeroRemedy::ReturnToZero),
            "not at zero   The rig stands at 18.0 N and 0.300 mm. Run `leafbench zero`"
        );
        assert!(line(ZeroRemedy::Tare).ends_with("Run `leafbench tare`"));
        assert!(line(ZeroRemedy::Reset).ends_with("Run `leafbench reset`, then `leafbench zero`"));
    }

    #[test]
    fn an_interlock_and_the_end_of_the_time_end_the_wait_for_a_ready_bench() {
        let waiting = |wait| StatusArgs {
            wait,
            timeout: 5,
            data: DataArg {
                folder: std::path::PathBuf::new(),
            },
        };
        let unmet = |status: &Status, late| match waiting(Some(AwaitedState::Ready)).unmet(status, late) {
            None => "ready".to_owned(),
            Some(Unmet::NotYet) => "not yet".to_owned(),
            Some(Unmet::InVain(why)) => why,
        };
        let mut bench = status();
        bench.rig.phase = Phase::Running;
        assert_eq!(unmet(&bench, false), "not yet");
        assert_eq!(unmet(&bench, true), "after 5 s the bench is running");
        assert!(
            waiting(None).unmet(&bench, false).is_none(),
            "nothing is waited for"
        );
        bench.rig.phase = Phase::Ready;
        assert_eq!(unmet(&bench, true), "ready");
        bench.preparing = true;
        assert_eq!(unmet(&bench, false), "not yet");
        bench.rig.phase = Phase::Interlocked;
        assert!(unmet(&bench, false).contains("leafbench reset"));
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
