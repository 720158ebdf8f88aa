//! What people ask of control: start, stop, hold, resume, reset, tare.

use super::physical_limits::channel_beyond_its_counts;
use super::{Activity, Channels, Phase, Reading, Rig, RunOrder, SlowMotion};
use crate::link::Link;
use crate::protocol::message::{RequestCode, RigState};
use crate::recording::{Ending, Flags};

/// Why a request is refused. Nothing has moved.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum Refusal {
    /// No rig is connected. The text says why, if it is known.
    #[error("the rig is not connected{0}: check the link and the rig's power")]
    NotConnected(String),
    /// A run or another motion is under way; the text says which.
    #[error("{0} is under way: stop it or wait for its end")]
    Busy(String),
    /// Rig or host are latched by a fault.
    #[error("the rig is interlocked ({0}): remove the cause, then reset")]
    Interlocked(String),
    /// The CAN controller is error passive.
    #[error("the CAN controller is error passive: check bit rate, termination and wiring, then start again")]
    ErrorPassive,
    /// The request is not possible in this phase.
    #[error("{what} is not possible while the bench is {phase}: check the bench with `leafbench status`")]
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
    /// With this tare the limits exceed what the counts of a channel can carry.
    #[error(
        "with a tare of {force_n:.1} N and {displacement_mm:.3} mm the limits of the {channel} exceed the range of its counts: unload the rig, or narrow the limits in the bench file"
    )]
    LimitsBeyondCounts {
        /// Name of the channel.
        channel: &'static str,
        /// New tare of the load cell, N.
        force_n: f64,
        /// New tare of the LVDT, mm.
        displacement_mm: f64,
    },
    /// A jog is longer than a single step may be.
    #[error("a jog of {step_mm:.3} mm is more than one step may be ({limit_mm:.1} mm): jog in smaller steps")]
    JogTooLong {
        /// The step that was asked for, mm.
        step_mm: f64,
        /// Largest step, mm.
        limit_mm: f64,
    },
    /// A jog would end outside the limits of travel.
    #[error(
        "a jog to {target_mm:.3} mm would leave the limits of travel ({min_mm:.1} to {max_mm:.1} mm): jog the other way"
    )]
    JogBeyondTravel {
        /// Where the jog would end, mm.
        target_mm: f64,
        /// Lower limit of travel, mm.
        min_mm: f64,
        /// Upper limit of travel, mm.
        max_mm: f64,
    },
    /// A step was to go on with a jog that is over.
    #[error("the jog is over: release the button, check the bench, then begin again")]
    NoJog,
    /// A motion cannot be played.
    #[error("the motion is not possible: {0}")]
    Motion(String),
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
        self.may_move()?;
        self.arm(order, None);
        Ok(())
    }

    /// The newest reading, if a motion may begin now.
    pub(super) fn may_move(&self) -> Result<Reading, Refusal> {
        match self.phase() {
            Phase::Ready => {}
            Phase::Connecting => return Err(self.not_connected()),
            Phase::Interlocked => return Err(Refusal::Interlocked(self.status().interlock())),
            _ => return Err(Refusal::Busy(self.status().under_way())),
        }
        let reading = self.reading.ok_or_else(|| self.not_connected())?;
        if self.error_passive {
            return Err(Refusal::ErrorPassive);
        }
        if reading.flags.contains(Flags::FORCE_INVALID) {
            return Err(Refusal::Sensor("the load cell"));
        }
        if reading.flags.contains(Flags::DISPLACEMENT_INVALID) {
            return Err(Refusal::Sensor("the LVDT"));
        }
        Ok(reading)
    }

    /// Asks the rig to arm; the order begins once it is armed.
    pub(super) fn arm(&mut self, order: RunOrder, motion: Option<SlowMotion>) {
        self.notice.clear();
        self.next_request = Some(RequestCode::Arm);
        self.activity = Activity::Arming {
            order: Box::new(order),
            motion,
            since_ns: self.last_poll_ns.unwrap_or(0),
        };
    }

    fn not_connected(&self) -> Refusal {
        Refusal::NotConnected(
            self.session
                .error()
                .map(|e| format!(" ({e})"))
                .unwrap_or_default(),
        )
    }

    /// Unloads the rig, in every phase. A run under way ends and its data are kept; one that is still arming never begins.
    pub(crate) fn stop(&mut self, cause: &str, now_ns: u64, link: &mut Link) {
        match &self.activity {
            Activity::Running(_) => {
                self.session.forget_request();
                self.next_request = Some(RequestCode::Unload);
                self.stop_run(Ending::Stopped, cause.to_owned(), now_ns);
            }
            Activity::Arming { .. } => {
                cause.clone_into(&mut self.notice);
                self.unload(now_ns);
            }
            // The rig is asked to unload already.
            Activity::Stopping { .. } | Activity::Unloading { .. } => {}
            Activity::Idle => match self.state {
                Some(RigState::Off | RigState::Tripped | RigState::Unload) => {}
                Some(_) if self.session.is_owned() => self.unload(now_ns),
                // The state is unknown, or another program owns the rig: NMT stop needs neither state nor session.
                _ => self.abort(now_ns, link),
            },
        }
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
                // What it said was about the hold.
                self.notice.clear();
                self.next_request = Some(RequestCode::Resume);
                Ok(())
            }
            phase => Err(Refusal::Phase {
                what: "resume",
                phase,
            }),
        }
    }

    /// Clears the latches of host and rig. Never resumes motion.
    pub(crate) fn reset(&mut self) -> Result<(), Refusal> {
        match self.phase() {
            Phase::Interlocked => {
                self.notice.clear();
                self.fault = None;
                if self.state == Some(RigState::Tripped) {
                    self.next_request = Some(RequestCode::Reset);
                }
                Ok(())
            }
            phase => Err(Refusal::Phase { what: "reset", phase }),
        }
    }

    /// Takes the mean of the last half second as zero on both channels, and moves the firmware's limits with it. Refused during a run, while the rig moves, and if
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
        let channels = tared(self.channels, force_new_n, displacement_new_mm);
        let limits = c.limits.in_counts(&channels);
        if let Some(channel) = channel_beyond_its_counts(&limits) {
            return Err(Refusal::LimitsBeyondCounts {
                channel,
                force_n: force_new_n,
                displacement_mm: displacement_new_mm,
            });
        }
        let report = TareReport {
            force_old_n: self.channels.force.tare,
            force_new_n,
            force_sigma_n: still.force_sigma_n,
            displacement_old_mm: self.channels.displacement.tare,
            displacement_new_mm,
            displacement_sigma_mm: still.displacement_sigma_mm,
        };
        self.channels = channels;
        // The rig holds its limits in counts without tare, so a tare moves them there.
        self.session.set_limits(limits);
        self.stillness.clear();
        Ok(report)
    }
}

fn tared(channels: Channels, force_n: f64, displacement_mm: f64) -> Channels {
    let mut channels = channels;
    channels.force.tare = force_n;
    channels.displacement.tare = displacement_mm;
    channels
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
