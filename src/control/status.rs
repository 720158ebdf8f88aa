//! What control tells of itself, and the requests that people make of it: start, stop, hold, resume, reset, tare.

use super::{Activity, Rig, RunOrder};
use crate::protocol::message::{Cause, RequestCode, RigState};
use crate::recording::{Ending, FirmwareIdentity};

/// What the bench is doing, for people and scripts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Phase {
    /// No rig is heard, or the hello is not through.
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
    /// Latched: someone must reset.
    Interlocked,
}

/// Counts since the program started.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema,
)]
pub(crate) struct Counters {
    /// Samples taken.
    pub samples: u64,
    /// Samples that the rig's ticks say are missing.
    pub lost: u64,
    /// Frames with a wrong CRC, shape or meaning.
    pub frames_refused: u64,
    /// Frames repeated, late or out of sequence.
    pub frames_out_of_sequence: u64,
    /// CAN error frames or broken serial packets.
    pub bus_errors: u64,
    /// Commands that the link did not take at once.
    pub send_failures: u64,
    /// Emergency frames.
    pub emergencies: u64,
    /// Polls of control that came more than 5 ms after the one before.
    pub late_polls: u64,
    /// Longest pause between two polls in ms.
    pub worst_poll_gap_ms: u64,
}

/// The bench at one moment.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
pub(crate) struct RigStatus {
    /// What it is doing.
    pub phase: Phase,
    /// State of the firmware.
    #[schema(value_type = Option<String>)]
    pub rig_state: Option<RigState>,
    /// First cause of a latched state.
    #[schema(value_type = String)]
    pub cause: Cause,
    /// Newest notice for people: why something was refused or ended; empty where all is well.
    pub notice: String,
    /// Newest force in N.
    pub force_n: Option<f64>,
    /// Newest displacement in mm.
    pub displacement_mm: Option<f64>,
    /// Tare in N and mm.
    pub tare_force_n: f64,
    /// Tare in mm.
    pub tare_displacement_mm: f64,
    /// Run under way.
    pub run_id: Option<String>,
    /// Its profile.
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
    /// What the rig said at the hello.
    #[schema(value_type = Object)]
    pub firmware: FirmwareIdentity,
    /// Counts.
    pub counters: Counters,
}

impl RigStatus {
    /// Nothing heard yet.
    pub(crate) fn unknown() -> Self {
        RigStatus {
            phase: Phase::Connecting,
            rig_state: None,
            cause: Cause::None,
            notice: String::new(),
            force_n: None,
            displacement_mm: None,
            tare_force_n: 0.0,
            tare_displacement_mm: 0.0,
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

/// Why a request is refused. Nothing moved.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum Refusal {
    /// No rig.
    #[error("the rig is not connected{0}: check the link and the rig's power")]
    NotConnected(String),
    /// A run is under way.
    #[error("run {0} is under way: stop it or wait for its end")]
    Busy(String),
    /// The rig is latched.
    #[error("the rig is interlocked ({0:?}): remove the cause, then reset")]
    Interlocked(Cause),
    /// Not possible in this phase.
    #[error("{what} is not possible while the bench is {phase:?}")]
    Phase {
        /// The request.
        what: &'static str,
        /// The phase.
        phase: Phase,
    },
    /// A channel gives no valid reading.
    #[error("{0} gives no valid reading: check sensor and cable")]
    Sensor(&'static str),
    /// The rig moves or a channel is noisy.
    #[error(
        "not still enough for a tare: {what} has a spread of {sigma:.4} {unit} (limit {limit:.4}): wait, or look for the cause"
    )]
    NotStill {
        /// Channel.
        what: &'static str,
        /// Spread.
        sigma: f64,
        /// Limit.
        limit: f64,
        /// Unit.
        unit: &'static str,
    },
    /// The tare would hide too much.
    #[error(
        "a tare of {value:.3} {unit} on the {what} is above its limit {limit:.3}: unload the rig or check the sensor"
    )]
    TareTooLarge {
        /// Channel.
        what: &'static str,
        /// Tare asked for.
        value: f64,
        /// Limit.
        limit: f64,
        /// Unit.
        unit: &'static str,
    },
    /// Samples have not filled the window yet.
    #[error("half a second of samples is needed for a tare: try again")]
    TooEarly,
}

/// What a tare did.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
pub(crate) struct TareReport {
    /// Load cell before, N.
    pub force_old_n: f64,
    /// Load cell now, N.
    pub force_new_n: f64,
    /// Spread of the load cell, N.
    pub force_sigma_n: f64,
    /// LVDT before, mm.
    pub displacement_old_mm: f64,
    /// LVDT now, mm.
    pub displacement_new_mm: f64,
    /// Spread of the LVDT, mm.
    pub displacement_sigma_mm: f64,
}

impl Rig {
    /// What the bench is doing.
    pub(crate) fn phase(&self) -> Phase {
        match &self.activity {
            Activity::Arming(_) => Phase::Arming,
            Activity::Running(run) if run.is_held() => Phase::Held,
            Activity::Running(_) => Phase::Running,
            Activity::Stopping { .. } | Activity::Unloading => Phase::Unloading,
            Activity::Idle if !self.session.is_open() => Phase::Connecting,
            Activity::Idle => match self.state {
                Some(RigState::Tripped) => Phase::Interlocked,
                Some(RigState::Off) => Phase::Ready,
                None => Phase::Connecting,
                Some(_) => Phase::Unloading,
            },
        }
    }

    /// Everything that people want to see, at once.
    pub(crate) fn status(&self) -> RigStatus {
        let mut status = RigStatus::unknown();
        self.status_into(&mut status);
        status
    }

    /// [`Rig::status`] into buffers that are there already: the control thread allocates nothing.
    pub(crate) fn status_into(&self, status: &mut RigStatus) {
        let run = match &self.activity {
            Activity::Running(run) | Activity::Stopping { run, .. } => Some(run),
            _ => None,
        };
        let newest = self.ticks.newest().unwrap_or(0);
        status.phase = self.phase();
        status.rig_state = self.state;
        status.cause = self.cause;
        match self.session.error() {
            Some(error) => status.notice = error.to_string(),
            None => status.notice.clone_from(&self.notice),
        }
        status.force_n = self.reading.map(|r| r.force_n);
        status.displacement_mm = self.reading.map(|r| r.displacement_mm);
        status.tare_force_n = self.channels.force.tare;
        status.tare_displacement_mm = self.channels.displacement.tare;
        assign(&mut status.run_id, run.map(|r| r.header.run_id.as_str()));
        assign(&mut status.profile, run.map(|r| r.header.profile_name.as_str()));
        status.elapsed_s = run.map_or(0.0, |r| r.time_s(newest).max(0.0));
        status.remaining_s = run.map_or(0.0, |r| r.remaining_s(newest));
        status.cycles_completed = run.map_or(0, |r| r.cycles_completed());
        status.cycles_total = run.map_or(0, |r| r.cycles_total());
        status.queue_ms = self.queue_ms;
        status.firmware = self.session.identity();
        status.counters = self.counters;
    }

    /// Starts a run: arms the rig, then plays the profile from where the rig stands.
    pub(crate) fn start(&mut self, order: RunOrder) -> Result<(), Refusal> {
        match self.phase() {
            Phase::Ready => {}
            Phase::Connecting => return Err(self.not_connected()),
            Phase::Interlocked => return Err(Refusal::Interlocked(self.cause)),
            _ => return Err(Refusal::Busy(self.status().run_id.unwrap_or_default())),
        }
        let reading = self.reading.ok_or_else(|| self.not_connected())?;
        if reading.flags.has(crate::recording::Flags::FORCE_INVALID) {
            return Err(Refusal::Sensor("the load cell"));
        }
        if reading.flags.has(crate::recording::Flags::DISPLACEMENT_INVALID) {
            return Err(Refusal::Sensor("the LVDT"));
        }
        self.notice.clear();
        self.ask = Some(RequestCode::Arm);
        self.activity = Activity::Arming(Box::new(order));
        Ok(())
    }

    fn not_connected(&self) -> Refusal {
        Refusal::NotConnected(
            self.session
                .error()
                .map(|e| format!(" ({e})"))
                .unwrap_or_default(),
        )
    }

    /// Ends the run under way: the rig unloads, the data are kept. Without a run it unloads all the same.
    pub(crate) fn stop(&mut self, cause: &str, now_ns: u64) -> Result<(), Refusal> {
        self.ask = Some(RequestCode::Unload);
        match &self.activity {
            Activity::Running(_) => self.wind_down(Ending::Stopped, cause.to_owned(), now_ns),
            Activity::Arming(_) => self.activity = Activity::Unloading,
            _ if matches!(
                self.state,
                Some(RigState::Armed | RigState::Running | RigState::Hold)
            ) => {}
            _ => {
                self.ask = None;
                return Err(Refusal::Phase {
                    what: "stop",
                    phase: self.phase(),
                });
            }
        }
        Ok(())
    }

    /// Keeps the position; the firmware unloads by itself when nobody comes back.
    pub(crate) fn hold(&mut self) -> Result<(), Refusal> {
        match self.phase() {
            Phase::Running => {
                self.ask = Some(RequestCode::Hold);
                Ok(())
            }
            phase => Err(Refusal::Phase { what: "hold", phase }),
        }
    }

    /// Goes on after a hold: cycles taper in again at the one that was cut.
    pub(crate) fn resume(&mut self) -> Result<(), Refusal> {
        match self.phase() {
            Phase::Held => {
                self.ask = Some(RequestCode::Resume);
                Ok(())
            }
            phase => Err(Refusal::Phase {
                what: "resume",
                phase,
            }),
        }
    }

    /// Clears the latch. Never resumes motion.
    pub(crate) fn reset(&mut self) -> Result<(), Refusal> {
        match self.phase() {
            Phase::Interlocked => {
                self.notice.clear();
                self.ask = Some(RequestCode::Reset);
                Ok(())
            }
            phase => Err(Refusal::Phase { what: "reset", phase }),
        }
    }

    /// Takes the mean of the last half second as zero on both channels. Refused while a run is under way, while the
    /// rig moves, and where it would hide more than the bench allows.
    pub(crate) fn tare(&mut self) -> Result<TareReport, Refusal> {
        match self.phase() {
            Phase::Ready | Phase::Interlocked => {}
            Phase::Connecting => return Err(self.not_connected()),
            phase => return Err(Refusal::Phase { what: "tare", phase }),
        }
        let still = self.stillness.measure().ok_or(Refusal::TooEarly)?;
        let c = &self.config;
        check_still("load cell", still.force_sigma_n, c.still_sigma_n, "N")?;
        check_still("LVDT", still.displacement_sigma_mm, c.still_sigma_mm, "mm")?;
        let force_new_n = self.channels.force.tare + still.force_n;
        let displacement_new_mm = self.channels.displacement.tare + still.displacement_mm;
        check_tare("load cell", force_new_n, c.tare_limit_n, "N")?;
        check_tare("LVDT", displacement_new_mm, c.tare_limit_mm, "mm")?;
        let report = TareReport {
            force_old_n: self.channels.force.tare,
            force_new_n,
            force_sigma_n: still.force_sigma_n,
            displacement_old_mm: self.channels.displacement.tare,
            displacement_new_mm,
            displacement_sigma_mm: still.displacement_sigma_mm,
        };
        self.channels.force.tare = force_new_n;
        self.channels.displacement.tare = displacement_new_mm;
        self.stillness.clear();
        Ok(report)
    }
}

/// Takes over a text into the buffer that is there.
fn assign(slot: &mut Option<String>, text: Option<&str>) {
    match (slot.as_mut(), text) {
        (Some(there), Some(text)) => {
            there.clear();
            there.push_str(text);
        }
        (_, text) => *slot = text.map(str::to_owned),
    }
}

fn check_still(what: &'static str, sigma: f64, limit: f64, unit: &'static str) -> Result<(), Refusal> {
    if sigma <= limit {
        Ok(())
    } else {
        Err(Refusal::NotStill {
            what,
            sigma,
            limit,
            unit,
        })
    }
}

fn check_tare(what: &'static str, value: f64, limit: f64, unit: &'static str) -> Result<(), Refusal> {
    if value.abs() <= limit {
        Ok(())
    } else {
        Err(Refusal::TareTooLarge {
            what,
            value,
            limit,
            unit,
        })
    }
}
