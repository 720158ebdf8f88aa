//! What travels over the HTTP interface, for the daemon, the command line and the API description alike.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::control::RigStatus;
use crate::control::realtime::LoopHealth;

/// Where a daemon listens; the content of `daemon.json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Endpoint {
    /// `http://127.0.0.1:PORT`.
    pub url: String,
    /// Its process.
    pub pid: u32,
}

/// Why a request failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct Failure {
    /// What is wrong, and where.
    pub error: String,
    /// What to do, where it is not in `error`.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub what_to_do: String,
}

/// The daemon and the bench at one moment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct Status {
    /// Version of leafbench.
    pub version: String,
    /// Bench config's name.
    pub bench: String,
    /// Address of the link.
    pub link: String,
    /// The link is open.
    pub link_open: bool,
    /// Folder of the run files.
    pub data_folder: String,
    /// Model of the twin; empty where it is off.
    pub twin: String,
    /// What keeps control from its full precision, one sentence each.
    pub degraded: Vec<String>,
    /// Rig and control.
    pub rig: RigStatus,
    /// The control loop.
    pub control_loop: LoopHealth,
    /// The run under way, or the newest of this daemon.
    pub run: Option<RunProgress>,
}

/// How far a run is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum RunState {
    /// The rig is being armed.
    Arming,
    /// Samples are being recorded.
    Running,
    /// It is over and its file closed.
    Ended,
    /// The rig did not arm: nothing was recorded.
    NeverStarted,
}

/// A run of this daemon.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct RunProgress {
    /// Id.
    pub run_id: String,
    /// Profile's name.
    pub profile: String,
    /// How far.
    pub state: RunState,
    /// `completed`, `stopped` or `aborted`, once it is over.
    pub ending: Option<String>,
    /// Why it ended; empty where completed.
    pub cause: String,
    /// Samples recorded, once it is over.
    pub samples: u64,
    /// Samples missing, once it is over.
    pub lost: u64,
    /// Counted cycles completed, once it is over.
    pub cycles_completed: u32,
    /// Why the run file could not be written; empty where all is well.
    pub disk_problem: String,
    /// Where twin and measurement part, as last told; empty where they agree.
    #[serde(default)]
    pub model_mismatch: String,
}

/// What to run.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct StartRun {
    /// Name of a profile, or a profile file's text. May be left out where a run is resumed.
    #[serde(default)]
    pub profile: Option<String>,
    /// Specimen; the bench's where left out.
    #[serde(default)]
    pub specimen: Option<String>,
    /// Operator.
    #[serde(default)]
    pub operator: Option<String>,
    /// Run to go on with at the cycle after its last complete one.
    #[serde(default)]
    pub resume_run: Option<String>,
}

/// What to check.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct PlanRequest {
    /// Name of a profile, or a profile file's text.
    pub profile: String,
}

/// A run that was started.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct Started {
    /// Its id.
    pub run_id: String,
}

/// A request was taken.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct Accepted {
    /// What happens now.
    pub message: String,
}

/// Why to stop.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct StopRequest {
    /// Who or what asks; goes into the run's cause.
    #[serde(default)]
    pub reason: Option<String>,
}

/// No particulars: `{}`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Nothing {}

/// A recorded run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct RunSummary {
    /// Id.
    pub run_id: String,
    /// Start, UTC, RFC 3339.
    pub started_utc: String,
    /// Profile's name.
    pub profile: String,
    /// Specimen's name.
    pub specimen: String,
    /// Samples in the file.
    pub samples: u64,
    /// Samples missing.
    pub lost: u64,
    /// Counted cycles completed.
    pub cycles_completed: u32,
    /// `completed`, `stopped`, `aborted`, or `open` while it lasts.
    pub ending: String,
    /// Why it ended; empty where completed.
    pub cause: String,
    /// Why the file cannot be read; empty where it can.
    pub problem: String,
}

/// A recorded run with its particulars.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct RunDetail {
    /// As in the list.
    pub summary: RunSummary,
    /// Head of the recording.
    #[schema(value_type = Object)]
    pub header: serde_json::Value,
    /// Events in order.
    #[schema(value_type = Vec<Object>)]
    pub events: Vec<serde_json::Value>,
}

/// A profile that can be started by name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct ProfileSummary {
    /// Name.
    pub name: String,
    /// One sentence.
    pub description: String,
    /// Length in s.
    pub duration_s: f64,
    /// Counted cycles.
    pub cycles: u32,
    /// Why it cannot be used; empty where it can.
    pub problem: String,
}
