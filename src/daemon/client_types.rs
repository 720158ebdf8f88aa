//! The requests and answers of the HTTP interface, for the daemon, the command line and the API description.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::access::role::Role;
use crate::config::Bench;
use crate::control::RigStatus;
use crate::control::realtime::LoopHealth;
use crate::recording::Ending;
use crate::recording::run_file::RunListing;

/// Where a daemon listens: the content of `daemon.json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Endpoint {
    /// Address of the interface for this computer, such as `http://127.0.0.1:8000`.
    pub url: String,
    /// Process id of the daemon.
    pub pid: u32,
    /// Address of the page, if other computers reach it under another one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub page: Option<String>,
}

/// Why a request failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct Failure {
    /// What is wrong and where.
    pub error: String,
    /// What to do, if `error` does not say it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub what_to_do: String,
    /// Where in the text of a profile, if the error is at one place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<TextPlace>,
}

/// A place in a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct TextPlace {
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
}

/// Header in which a client says who it is: [`Caller`] as JSON in ASCII.
pub(crate) const CALLER_HEADER: &str = "leafbench-caller";

/// Who sends a request. An order without it is taken while nobody commands.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Caller {
    /// Chosen by the client, and the same in all its requests.
    pub id: String,
    /// Who it is, for people: `page of A. Technician`.
    pub name: String,
    /// The client keeps the command as long as it is there. Otherwise the order stands alone.
    #[serde(default)]
    pub stays: bool,
    /// Takes the command over from whoever has it.
    #[serde(default)]
    pub take_over: bool,
    /// Name of the token, which the daemon has checked: another person with the same id is another client.
    #[serde(skip)]
    pub person: String,
}

/// Signs a browser in.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct SignIn {
    /// The secret of a link, which works once; or a token.
    pub secret: String,
}

/// A browser is signed in. The answer also sets the cookie of the session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct SignedIn {
    /// Name of the token.
    pub name: String,
    /// What it allows.
    pub role: Role,
    /// Key of the session, for the header `Authorization: Bearer KEY` of orders.
    pub key: String,
}

/// A link that signs a browser in as the person who asked for it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct SignInLink {
    /// Address to open in a browser.
    pub url: String,
    /// How long it works, s. It works once.
    pub works_s: u64,
}

/// The client that commands the bench.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct CommanderStatus {
    /// Id of the client.
    pub id: String,
    /// Who it is, for people.
    pub name: String,
    /// Since when it commands, UTC, RFC 3339.
    pub since_utc: String,
}

/// The daemon and the bench at one moment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct Status {
    /// Version of leafbench.
    pub version: String,
    /// Name of the bench config.
    pub bench: String,
    /// Address of the link.
    pub link: String,
    /// Whether the link is open.
    pub link_open: bool,
    /// Folder of the run files.
    pub data_folder: String,
    /// Model of the next run's twin; empty if the twin is off.
    pub twin: String,
    /// Id of the diagnosis whose improved model the twin has; empty for the model of the bench file.
    #[serde(default)]
    pub twin_diagnosis: String,
    /// What makes the timing of the control loop worse than specified, one sentence each.
    pub degraded: Vec<String>,
    /// What a person should know before the next run: overdue calibrations, a disk that is nearly full.
    #[serde(default)]
    pub warnings: Vec<String>,
    /// What the page draws around the measured values.
    #[serde(default)]
    pub plot: PlotScale,
    /// A run was asked for and has not begun: its profile is being checked. A stop withdraws it.
    #[serde(default)]
    pub preparing: bool,
    /// Who commands the bench; `null` if the command is free. Everybody may stop it.
    #[serde(default)]
    pub commander: Option<CommanderStatus>,
    /// State of the rig and of the run under way.
    pub rig: RigStatus,
    /// Timing of the control loop.
    pub control_loop: LoopHealth,
    /// The run under way, or the newest run of this daemon.
    pub run: Option<RunProgress>,
}

/// What both sensors read over the last second, without calibration and tare.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct SensorReadings {
    /// Name of the bench.
    pub bench: String,
    /// Samples of the window, at most one second; 0 while the rig is not heard.
    pub samples: u32,
    /// Tick of the first of them.
    pub first_tick: u64,
    /// Tick of the last of them.
    pub last_tick: u64,
    pub force: CountsReading,
    pub displacement: CountsReading,
}

/// Counts of one sensor over the window.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct CountsReading {
    /// Mean of the valid samples.
    pub mean_counts: f64,
    /// Standard deviation of one sample.
    pub sigma_counts: f64,
    /// Samples without a valid reading.
    pub invalid: u32,
}

/// Limits of the bench and noise of its sensors, for the lines around the measured values.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct PlotScale {
    /// Upper force limit, N.
    pub force_max_n: f64,
    /// Lower force limit, N.
    pub force_min_n: f64,
    /// Upper displacement limit, mm.
    pub displacement_max_mm: f64,
    /// Lower displacement limit, mm.
    pub displacement_min_mm: f64,
    /// Standard deviation of the load cell's noise, N.
    pub noise_n: f64,
}

impl PlotScale {
    /// The lines of this bench.
    pub(super) fn of(bench: &Bench) -> PlotScale {
        let limits = &bench.limits;
        PlotScale {
            force_max_n: limits.force_max_n,
            force_min_n: limits.force_min_n,
            displacement_max_mm: limits.displacement_max_mm,
            displacement_min_mm: limits.displacement_min_mm,
            noise_n: bench.force_channel.noise_n,
        }
    }
}

/// How far a run is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum RunState {
    /// The rig is being armed.
    Arming,
    /// Samples are being recorded.
    Running,
    /// The run is over and its file is closed.
    Ended,
    /// The rig did not arm, so nothing was recorded.
    NeverStarted,
}

/// A run of this daemon.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct RunProgress {
    /// Id of the run.
    pub run_id: String,
    /// Name of the profile.
    pub profile: String,
    /// How far the run is.
    pub state: RunState,
    /// `completed`, `stopped` or `aborted`, once it is over.
    pub ending: Option<String>,
    /// Why the run ended; empty if it completed.
    pub cause: String,
    /// Number of recorded samples, once it is over.
    pub samples: u64,
    /// Number of missing samples, once it is over.
    pub lost: u64,
    /// Number of samples that the link delivered too late, once it is over.
    #[serde(default)]
    pub late: u64,
    /// Number of completed counted cycles, once it is over.
    pub cycles_completed: u32,
    /// Why samples are not on the disk, where they are and what to do; empty as long as all is well.
    pub disk_problem: String,
    /// Number of recorded samples that are not on the disk, once the run is over.
    #[serde(default)]
    pub samples_not_saved: u64,
    /// The last report of where twin and measurement differ; empty if they agree.
    #[serde(default)]
    pub model_mismatch: String,
}

impl RunProgress {
    /// A run that is about to start.
    pub(super) fn arming(run_id: String, profile: String) -> RunProgress {
        RunProgress {
            run_id,
            profile,
            state: RunState::Arming,
            ending: None,
            cause: String::new(),
            samples: 0,
            lost: 0,
            late: 0,
            cycles_completed: 0,
            disk_problem: String::new(),
            samples_not_saved: 0,
            model_mismatch: String::new(),
        }
    }

    /// The run ran to its end and every sample is on the disk, in one file.
    pub(crate) fn is_whole(&self) -> bool {
        let saved = self.disk_problem.is_empty() && self.samples_not_saved == 0;
        saved && self.ending.as_deref() == Some("completed")
    }

    /// The run has ended, or did not start at all.
    pub(crate) fn is_over(&self) -> bool {
        matches!(self.state, RunState::Ended | RunState::NeverStarted)
    }
}

/// What to run.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct StartRun {
    /// Name of a profile, or the text of a profile file. May be left out if a run is resumed.
    #[serde(default)]
    pub profile: Option<String>,
    /// Name of the specimen: that of the bench config, or one that begins with it (`NAME 7`). Without it, the specimen of the
    /// bench config, or that of the run to resume.
    #[serde(default)]
    pub specimen: Option<String>,
    /// Name of the operator, for the header of the recording.
    #[serde(default)]
    pub operator: Option<String>,
    /// Id of a run to resume. The new run begins at the cycle after the last complete one. Bench, rig, specimen and profile
    /// must be the same, and a run is resumed once.
    #[serde(default)]
    pub resume_run: Option<String>,
    /// Name of the person who answers for a start with an overdue calibration or another specimen than that of the bench. The
    /// name goes into the remarks of the recording.
    #[serde(default)]
    pub override_by: Option<String>,
}

/// What to check.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct PlanRequest {
    /// Name of a profile, or the text of a profile file.
    pub profile: String,
    /// The answer also has the course of command, force and displacement, for a drawing.
    #[serde(default)]
    pub course: bool,
}

/// A run that was started.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct Started {
    /// Id of the new run.
    pub run_id: String,
}

/// The answer to a request that was accepted.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct Accepted {
    /// What happens next.
    pub message: String,
}

/// Why to stop.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct StopRequest {
    /// Why the run is stopped: becomes the cause of the run's end.
    #[serde(default)]
    pub reason: Option<String>,
}

/// How far to jog.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct JogRequest {
    /// Step in mm, -2 to 2; positive loads the spring. 0 ends a jog.
    pub step_mm: f64,
    /// The step goes on with a jog, as while a button is held: it is refused if that jog is over, for example by a stop.
    #[serde(default)]
    pub goes_on: bool,
}

/// A request without content: `{}`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Nothing {}

/// A recorded run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct RunSummary {
    /// Id of the run.
    pub run_id: String,
    /// Start in UTC, RFC 3339.
    pub started_utc: String,
    /// Name of the profile.
    pub profile: String,
    /// Name of the specimen.
    pub specimen: String,
    /// Name of the operator; may be empty.
    #[serde(default)]
    pub operator: String,
    /// Number of samples in the file.
    pub samples: u64,
    /// Number of missing samples.
    pub lost: u64,
    /// Number of samples that the link delivered too late.
    #[serde(default)]
    pub late: u64,
    /// Number of completed counted cycles.
    pub cycles_completed: u32,
    /// `completed`, `stopped`, `aborted`, `open` while the run lasts, `incomplete` if samples are not on the disk, `damaged`
    /// if the file is not what was written, or `unreadable` if it cannot be opened.
    pub ending: String,
    /// Why the run ended; empty if it completed. For an incomplete or damaged run also how it ended.
    pub cause: String,
    /// What in the file is damaged; empty if all of it can be read.
    pub problem: String,
    /// Id of the run that this file continues after an error of the disk; empty otherwise.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub continues: String,
}

impl From<RunListing> for RunSummary {
    fn from(run: RunListing) -> RunSummary {
        let (mut ending, mut cause) = match &run.outcome {
            Some(outcome) => (ending_word(outcome.ending), outcome.cause.clone()),
            None => ("open", String::new()),
        };
        let told = [&run.problem, &run.unsaved];
        if let Some(at) = told.iter().position(|text| !text.is_empty()) {
            cause = ended_words(&ended_words(ending, &cause), &run.unsaved);
            ending = match (at, run.started_utc.as_str()) {
                (0, "") => "unreadable",
                (0, _) => "damaged",
                _ => "incomplete",
            };
            if ending == "unreadable" {
                cause.clear();
            }
        }
        RunSummary {
            ending: ending.to_owned(),
            cause,
            run_id: run.run_id,
            started_utc: run.started_utc,
            profile: run.profile_name,
            specimen: run.specimen,
            operator: run.operator,
            samples: run.samples,
            lost: run.lost,
            late: run.late,
            cycles_completed: run.cycles_completed,
            problem: run.problem,
            continues: run.continues,
        }
    }
}

/// The word for an ending in all answers.
pub(super) fn ending_word(ending: Ending) -> &'static str {
    match ending {
        Ending::Completed => "completed",
        Ending::Stopped => "stopped",
        Ending::Aborted => "aborted",
    }
}

/// How a run ended and why, in words: `stopped by an operator`, `aborted: the rig ended the run: force limit`, `completed`.
pub(crate) fn ended_words(ending: &str, cause: &str) -> String {
    match cause {
        "" => ending.to_owned(),
        // The cause begins with the word for the ending.
        cause
            if cause
                .strip_prefix(ending)
                .is_some_and(|rest| rest.starts_with(' ')) =>
        {
            cause.to_owned()
        }
        cause => format!("{ending}: {cause}"),
    }
}

/// A recorded run with its header and events.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct RunDetail {
    /// The same as in the list of runs.
    pub summary: RunSummary,
    /// Header of the recording.
    #[schema(value_type = Object)]
    pub header: serde_json::Value,
    /// Events in the order of time.
    #[schema(value_type = Vec<Object>)]
    pub events: Vec<serde_json::Value>,
}

/// A profile that can be started by name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct ProfileSummary {
    /// Name of the profile.
    pub name: String,
    /// The description from the profile file.
    pub description: String,
    /// Duration in s.
    pub duration_s: f64,
    /// Number of counted cycles.
    pub cycles: u32,
    /// Why the profile cannot be used; empty if it can be used.
    pub problem: String,
    /// Where the profile comes from.
    pub origin: ProfileOrigin,
    /// True for an own profile that stands in the place of a shipped one.
    pub replaces_shipped: bool,
    /// Path of the profile file.
    pub file: String,
}

/// Where a profile comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ProfileOrigin {
    /// The folder of profiles of the daemon: shipped with leafbench, or that of `--profiles`.
    Shipped,
    /// Saved by the technician, in the data folder.
    Own,
}

/// The text of a profile.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct ProfileText {
    /// Name of the profile.
    pub name: String,
    /// Where the profile comes from.
    pub origin: ProfileOrigin,
    /// Path of the profile file.
    pub file: String,
    /// Its text, TOML.
    pub text: String,
}

/// What to save.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct SaveProfile {
    /// The text of a profile file. It is saved under the name in it.
    pub text: String,
    /// Another profile of this name may be replaced. A shipped one stays as it is; the own one goes before it.
    #[serde(default)]
    pub replace: bool,
}

/// A text to take apart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct OutlineRequest {
    /// The text of a profile file.
    pub text: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_word_for_an_ending_is_said_once() {
        for (ending, cause, words) in [
            ("stopped", "stopped by an operator", "stopped by an operator"),
            (
                "stopped",
                "Stop button of the page",
                "stopped: Stop button of the page",
            ),
            (
                "aborted",
                "the rig ended the run: force limit",
                "aborted: the rig ended the run: force limit",
            ),
            ("completed", "", "completed"),
        ] {
            assert_eq!(ended_words(ending, cause), words);
        }
    }
}
