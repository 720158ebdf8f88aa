//! The state of the bench as people and scripts see it.

use std::fmt::Write as _;

use super::run::JOG_KEEP_S;
use super::{Activity, Rig, SlowMotion};
use crate::protocol::message::{Cause, NmtState, RigState};
use crate::protocol::wire_enum::as_words;
use crate::recording::{FirmwareIdentity, Flags};

/// A rig within this distance of the tared zero is at zero, mm: five times the way of an unload that begins there (six ticks
/// at 5 mm/s). A sine profile of 6 mm is then off by less than 3 % of its amplitude at its start.
pub(super) const AT_ZERO_MM: f64 = 0.15;
/// A force up to this is none, N, on a bench whose unload ends at less.
const AT_ZERO_N: f64 = 5.0;

/// What the bench is doing, for people and scripts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Phase {
    /// No rig answers, or the hello is not complete.
    Connecting,
    /// A run may start.
    Ready,
    /// Pressure is being switched on.
    Arming,
    /// A run is under way.
    Running,
    /// The run is on hold.
    Held,
    /// The rig unloads.
    Unloading,
    /// The rig is latched by a fault and needs a reset.
    Interlocked,
}

impl std::fmt::Display for Phase {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        as_words(self, f)
    }
}

/// What brings a rig at rest to zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ZeroRemedy {
    /// A slow return to the tared zero.
    ReturnToZero,
    /// A reset of the interlock, then the return.
    Reset,
    /// A tare: there is a force at zero displacement.
    Tare,
}

impl ZeroRemedy {
    /// The second sentence of [`RigStatus::off_zero`].
    fn words(self) -> &'static str {
        match self {
            ZeroRemedy::ReturnToZero => {
                "An unload ends as soon as the force is small: return to zero before the next test."
            }
            ZeroRemedy::Reset => "The pressure is off: remove the cause, reset, then return to zero.",
            ZeroRemedy::Tare => {
                "There is a force at zero displacement: check that nothing presses on the specimen, then tare."
            }
        }
    }
}

/// Counts since the program started.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema,
)]
pub(crate) struct Counters {
    /// Number of samples received.
    pub samples: u64,
    /// Samples missing according to the rig's ticks.
    pub lost: u64,
    /// Samples that the link delivered too late.
    #[serde(default)]
    pub late: u64,
    /// Samples in which a channel gives no valid reading.
    #[serde(default)]
    pub flagged: u64,
    /// Frames with a wrong CRC, shape or meaning.
    pub frames_refused: u64,
    /// Frames repeated, late or out of sequence.
    pub frames_out_of_sequence: u64,
    /// CAN error frames or broken serial packets.
    pub bus_errors: u64,
    /// Frames lost in this computer's receive queue.
    #[serde(default)]
    pub receive_overflows: u64,
    /// Commands that the link refused at first; they are sent again.
    pub send_failures: u64,
    /// Emergency frames received.
    pub emergencies: u64,
    /// Polls of control that came more than 5 ms after the one before.
    pub late_polls: u64,
    /// Longest pause between two polls in ms.
    pub worst_poll_gap_ms: u64,
}

/// The bench at one moment.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
pub(crate) struct RigStatus {
    /// What the bench is doing.
    pub phase: Phase,
    /// State of the firmware.
    #[schema(value_type = Option<String>)]
    pub rig_state: Option<RigState>,
    /// First cause of a latched state.
    #[schema(value_type = String)]
    pub cause: Cause,
    /// Fault that the host found and latched until a reset; empty if there is none.
    #[serde(default)]
    pub fault: String,
    /// Newest notice: why something was refused or ended; empty if all is well.
    pub notice: String,
    /// Newest force in N; `null` while the rig is not heard or the load cell gives no valid reading.
    pub force_n: Option<f64>,
    /// Newest displacement in mm; `null` while the rig is not heard or the LVDT gives no valid reading.
    pub displacement_mm: Option<f64>,
    /// Tare of the load cell in N.
    pub tare_force_n: f64,
    /// Tare of the LVDT in mm.
    pub tare_displacement_mm: f64,
    /// What moves the rig without a recording, if anything does.
    #[serde(default)]
    pub motion: Option<SlowMotion>,
    /// Seconds until the rig unloads by itself, while it keeps its position with the pressure on.
    #[serde(default)]
    pub hold_left_s: Option<f64>,
    /// Where the rig is at rest and why not at zero, with what to do; empty at zero and while the pressure is on.
    #[serde(default)]
    pub off_zero: String,
    /// What brings the rig to zero; `null` where `off_zero` is empty.
    #[serde(default)]
    pub zero_remedy: Option<ZeroRemedy>,
    /// Identifier of the run under way.
    pub run_id: Option<String>,
    /// Name of the profile of that run.
    pub profile: Option<String>,
    /// Seconds into the run.
    pub elapsed_s: f64,
    /// Seconds that the profile still takes.
    pub remaining_s: f64,
    /// Counted cycles completed.
    pub cycles_completed: u32,
    /// Counted cycles of the profile.
    pub cycles_total: u32,
    /// Commands queued in the rig, ms.
    pub queue_ms: u8,
    /// Identity of the firmware, read at the hello.
    #[schema(value_type = Object)]
    pub firmware: FirmwareIdentity,
    /// Counters of samples, frames and errors.
    pub counters: Counters,
}

impl RigStatus {
    /// What the bench is latched by: the rig's cause, the host's fault, or both.
    pub(crate) fn interlock(&self) -> String {
        match (self.rig_state, self.fault.is_empty()) {
            (Some(RigState::Tripped), true) => self.cause.to_string(),
            (Some(RigState::Tripped), false) => format!("{}; {}", self.cause, self.fault),
            _ => self.fault.clone(),
        }
    }

    /// What moves the rig, as the subject of a sentence.
    pub(crate) fn under_way(&self) -> String {
        match (&self.run_id, self.motion) {
            (_, Some(motion)) => motion.words().to_owned(),
            (Some(run), None) => format!("run {run}"),
            (None, None) => "an unload of the rig".to_owned(),
        }
    }

    /// The status before anything is received.
    pub(crate) fn unknown() -> Self {
        RigStatus {
            phase: Phase::Connecting,
            rig_state: None,
            cause: Cause::None,
            fault: String::new(),
            notice: String::new(),
            force_n: None,
            displacement_mm: None,
            tare_force_n: 0.0,
            tare_displacement_mm: 0.0,
            motion: None,
            hold_left_s: None,
            off_zero: String::new(),
            zero_remedy: None,
            run_id: None,
            profile: None,
            elapsed_s: 0.0,
            remaining_s: 0.0,
            cycles_completed: 0,
            cycles_total: 0,
            queue_ms: 0,
            firmware: FirmwareIdentity::default(),
            counters: Counters::default(),
        }
    }
}

impl Rig {
    /// What the bench is doing.
    pub(crate) fn phase(&self) -> Phase {
        match &self.activity {
            Activity::Arming { .. } => Phase::Arming,
            Activity::Running(run) if run.is_held() => Phase::Held,
            Activity::Running(_) => Phase::Running,
            Activity::Stopping { .. } | Activity::Unloading { .. } => Phase::Unloading,
            Activity::Idle if !self.session.is_owned() => Phase::Connecting,
            Activity::Idle => match self.state {
                None => Phase::Connecting,
                Some(RigState::Tripped) => Phase::Interlocked,
                Some(RigState::Off) if self.fault.is_some() => Phase::Interlocked,
                Some(RigState::Off) if self.nmt == Some(NmtState::Operational) => Phase::Ready,
                Some(RigState::Off) => Phase::Connecting,
                Some(_) => Phase::Unloading,
            },
        }
    }

    /// The whole status.
    pub(crate) fn status(&self) -> RigStatus {
        let mut status = RigStatus::unknown();
        self.status_into(&mut status);
        status
    }

    /// [`Rig::status`] into existing buffers, so that the control thread does not allocate.
    pub(crate) fn status_into(&self, status: &mut RigStatus) {
        let run = match &self.activity {
            Activity::Running(run) | Activity::Stopping { run, .. } => Some(run),
            _ => None,
        };
        let newest = self.ticks.newest().unwrap_or(0);
        status.phase = self.phase();
        status.rig_state = self.state;
        status.cause = self.cause;
        status.fault.clear();
        status.fault.push_str(self.fault.as_deref().unwrap_or_default());
        match self.session.error() {
            Some(error) => status.notice = error.to_string(),
            None => status.notice.clone_from(&self.notice),
        }
        let valid = |invalid: Flags| self.reading.filter(|r| !r.flags.contains(invalid));
        status.force_n = valid(Flags::FORCE_INVALID).map(|r| r.force_n);
        status.displacement_mm = valid(Flags::DISPLACEMENT_INVALID).map(|r| r.displacement_mm);
        status.tare_force_n = self.channels.force.tare;
        status.tare_displacement_mm = self.channels.displacement.tare;
        status.zero_remedy = self.zero_remedy();
        self.off_zero_into(status.zero_remedy, &mut status.off_zero);
        status.motion = match &self.activity {
            Activity::Arming { motion, .. } => *motion,
            _ => run.and_then(|r| r.motion),
        };
        status.hold_left_s = self.hold_left_s();
        let recorded = run.filter(|r| r.motion.is_none());
        assign(&mut status.run_id, recorded.map(|r| r.header.run_id.as_str()));
        assign(
            &mut status.profile,
            recorded.map(|r| r.header.profile_name.as_str()),
        );
        status.elapsed_s = run.map_or(0.0, |r| r.time_s(newest).max(0.0));
        status.remaining_s = run.map_or(0.0, |r| r.remaining_s(newest));
        status.cycles_completed = run.map_or(0, |r| r.cycles_completed());
        status.cycles_total = run.map_or(0, |r| r.cycles_total());
        status.queue_ms = self.queue_ms;
        status.firmware = self.session.identity();
        status.counters = self.counters;
    }
}

impl Rig {
    /// Seconds until a hold of the firmware, or the pause after a jog, becomes an unload.
    fn hold_left_s(&self) -> Option<f64> {
        let Activity::Running(run) = &self.activity else {
            return None;
        };
        let newest = self.ticks.newest()?;
        let left_s = match run.held_s(newest) {
            Some(held_s) => f64::from(self.config.limits.hold_timeout_ms) / 1000.0 - held_s,
            None => Some(run.remaining_s(newest))
                .filter(|left| run.motion == Some(SlowMotion::Jog) && *left <= JOG_KEEP_S)?,
        };
        Some(left_s.max(0.0))
    }

    /// What brings the rig to zero, if it stands elsewhere without pressure.
    fn zero_remedy(&self) -> Option<ZeroRemedy> {
        let (phase @ (Phase::Ready | Phase::Interlocked), Some(at)) = (self.phase(), &self.reading) else {
            return None;
        };
        let far = at.displacement_mm.abs() > AT_ZERO_MM;
        let loaded = at.force_n.abs() > self.config.limits.unloaded_force_n.abs().max(AT_ZERO_N);
        if !at.flags.is_empty() || !(far || loaded) {
            return None;
        }
        Some(match (far, phase) {
            (true, Phase::Ready) => ZeroRemedy::ReturnToZero,
            (true, _) => ZeroRemedy::Reset,
            (false, _) => ZeroRemedy::Tare,
        })
    }

    /// Says where the rig stands, if there is something that brings it to zero.
    fn off_zero_into(&self, remedy: Option<ZeroRemedy>, text: &mut String) {
        text.clear();
        let (Some(remedy), Some(at)) = (remedy, &self.reading) else {
            return;
        };
        let (force_n, displacement_mm) = (at.force_n, at.displacement_mm);
        // Writing into a text does not fail.
        let _ = write!(
            text,
            "The rig stands at {force_n:.1} N and {displacement_mm:.3} mm. "
        );
        text.push_str(remedy.words());
    }
}

/// Copies a text into the existing buffer.
fn assign(slot: &mut Option<String>, text: Option<&str>) {
    match (slot.as_mut(), text) {
        (Some(buffer), Some(text)) => {
            buffer.clear();
            buffer.push_str(text);
        }
        (_, text) => *slot = text.map(str::to_owned),
    }
}
