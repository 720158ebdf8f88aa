//! What people ask of control: start, stop, hold, resume, reset, tare.

use super::{Activity, Phase, Rig, RunOrder};
use crate::protocol::message::{Cause, RequestCode, RigState};
use crate::recording::{Ending, Flags};

/// Why a request is refused. Nothing has moved.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum Refusal {
    /// No rig is connected. The text says why, if it is known.
    #[error("the rig is not connected{0}: check the link and the rig's power")]
    NotConnected(String),
    /// A run is under way.
    #[error("run {0} is under way: stop it or wait for its end")]
    Busy(String),
    /// The rig is latched.
    #[error("the rig is interlocked ({0:?}): remove the cause, then reset")]
    Interlocked(Cause),
    /// The request is not possible in this phase.
    #[error("{what} is not possible while the bench is {phase:?}: check the bench with `leafbench status`")]
    Phase {
        /// The request that was refused.
        what: &'static str,
        /// The phase of the bench.
        phase: Phase,
    },
    /// A channel gives no valid reading.
    #[error("{0} gives no valid reading: check sensor and cable")]
    Sensor(&'static str),
    /// The rig moves or a channel is noisy.
    #[error(
        "the rig is not still enough for a tare: the {what} has a standard deviation of {sigma:.4} {unit} (limit {limit:.4} {unit}): wait, or find the cause of the noise"
    )]
    NotStill {
        /// Name of the channel.
        what: &'static str,
        /// Standard deviation over the window, in `unit`.
        sigma: f64,
        /// Largest value allowed, in `unit`.
        limit: f64,
        /// Unit of the channel.
        unit: &'static str,
    },
    /// The tare would hide too much.
    #[error(
        "a tare of {value:.3} {unit} on the {what} exceeds its limit of {limit:.3} {unit}: unload the rig or check the sensor"
    )]
    TareTooLarge {
        /// Name of the channel.
        what: &'static str,
        /// New tare, in `unit`.
        value: f64,
        /// Largest value allowed, in `unit`.
        limit: f64,
        /// Unit of the channel.
        unit: &'static str,
    },
    /// The window of samples is not full yet.
    #[error("a tare needs half a second of valid samples without a gap: wait and try again")]
    TooEarly,
}

/// The tare before and after.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
pub(crate) struct TareReport {
    /// Tare of the load cell before, N.
    pub force_old_n: f64,
    /// Tare of the load cell now, N.
    pub force_new_n: f64,
    /// Standard deviation of the load cell over the window, N.
    pub force_sigma_n: f64,
    /// Tare of the LVDT before, mm.
    pub displacement_old_mm: f64,
    /// Tare of the LVDT now, mm.
    pub displacement_new_mm: f64,
    /// Standard deviation of the LVDT over the window, mm.
    pub displacement_sigma_mm: f64,
}

impl Rig {
    /// Starts a run: arms the rig, then plays the profile from the present position.
    pub(crate) fn start(&mut self, order: RunOrder) -> Result<(), Refusal> {
        match self.phase() {
            Phase::Ready => {}
            Phase::Connecting => return Err(self.not_connected()),
            Phase::Interlocked => return Err(Refusal::Interlocked(self.cause)),
            _ => return Err(Refusal::Busy(self.status().run_id.unwrap_or_default())),
        }
        let reading = self.reading.ok_or_else(|| self.not_connected())?;
        if reading.flags.contains(Flags::FORCE_INVALID) {
            return Err(Refusal::Sensor("the load cell"));
        }
        if reading.flags.contains(Flags::DISPLACEMENT_INVALID) {
            return Err(Refusal::Sensor("the LVDT"));
        }
        self.notice.clear();
        self.next_request = Some(RequestCode::Arm);
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

    /// Ends the run under way: the rig unloads, the data are kept. Without a run the rig unloads too.
    pub(crate) fn stop(&mut self, cause: &str, now_ns: u64) -> Result<(), Refusal> {
        self.next_request = Some(RequestCode::Unload);
        match &self.activity {
            Activity::Running(_) => self.stop_run(Ending::Stopped, cause.to_owned(), now_ns),
            Activity::Arming(_) => self.activity = Activity::Unloading,
            _ if matches!(
                self.state,
                Some(RigState::Armed | RigState::Running | RigState::Hold)
            ) => {}
            _ => {
                self.next_request = None;
                return Err(Refusal::Phase {
                    what: "stop",
                    phase: self.phase(),
                });
            }
        }
        Ok(())
    }

    /// Keeps the position. The firmware unloads by itself after the hold time-out.
    pub(crate) fn hold(&mut self) -> Result<(), Refusal> {
        match self.phase() {
            Phase::Running => {
                self.next_request = Some(RequestCode::Hold);
                Ok(())
            }
            phase => Err(Refusal::Phase { what: "hold", phase }),
        }
    }

    /// Goes on after a hold. A sine tapers in again and repeats the cycle that was interrupted.
    pub(crate) fn resume(&mut self) -> Result<(), Refusal> {
        match self.phase() {
            Phase::Held => {
                self.next_request = Some(RequestCode::Resume);
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
                self.next_request = Some(RequestCode::Reset);
                Ok(())
            }
            phase => Err(Refusal::Phase { what: "reset", phase }),
        }
    }

    /// Takes the mean of the last half second as zero on both channels. Refused during a run, while the rig moves, and if
    /// the tare exceeds the limit of the bench.
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
