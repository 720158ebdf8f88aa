//! Slow motions without a recording: the return to the tared zero, and jogs. Each is a run of one ramp in displacement
//! control, so that lease, limits and detectors are the same as in a test.

use super::run::JOG_KEEP_S;
use super::{Activity, Refusal, Rig, RunOrder, SlowMotion};
use crate::profile::{Block, Level, Profile, Segment};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::{FirmwareIdentity, Header, SensorIdentity};
use crate::units::Mode;

/// Speed of the return to zero, mm/s, unless the bench unloads more slowly.
const ZERO_MM_S: f64 = 2.0;
/// Speed of a jog, mm/s.
const JOG_MM_S: f64 = 0.5;
/// Longest step of one jog, mm: 4 s of motion.
const JOG_STEP_MAX_MM: f64 = 2.0;
/// Shortest ramp, s.
const RAMP_LEAST_S: f64 = 0.1;

impl Rig {
    /// Returns to the tared zero of the LVDT, slowly and within the limits. Then the rig unloads.
    pub(crate) fn zero(&mut self) -> Result<(), Refusal> {
        let reading = self.may_move()?;
        let speed_mm_s = ZERO_MM_S.min(self.config.limits.unload_velocity_mm_s);
        let ramp = ramp(Level::Absolute(0.0), reading.displacement_mm, speed_mm_s);
        self.arm(
            self.unrecorded("return to zero", vec![ramp]),
            Some(SlowMotion::Zero),
        );
        Ok(())
    }

    /// Moves by `step_mm` from where the last jog was commanded to, or from where the rig stands. The rig then keeps its
    /// position for [`JOG_KEEP_S`], unless another jog follows. A step of 0 ends a jog where it is.
    pub(crate) fn jog(&mut self, step_mm: f64) -> Result<(), Refusal> {
        if step_mm.is_nan() || step_mm.abs() > JOG_STEP_MAX_MM {
            return Err(Refusal::JogTooLong {
                step_mm,
                limit_mm: JOG_STEP_MAX_MM,
            });
        }
        let from_mm = match &self.activity {
            Activity::Running(run) if run.motion == Some(SlowMotion::Jog) && !run.is_held() => {
                run.newest_level()
            }
            Activity::Arming {
                motion: Some(SlowMotion::Jog),
                ..
            } => {
                if step_mm == 0.0 {
                    self.unload(self.last_poll_ns.unwrap_or(0));
                    return Ok(());
                }
                None
            }
            // Nothing is to be ended.
            _ if step_mm == 0.0 => return Ok(()),
            _ => {
                self.may_move()?;
                None
            }
        };
        let from_mm = from_mm.or(self.reading.map(|r| r.displacement_mm)).unwrap_or(0.0);
        self.check_travel(from_mm + step_mm, step_mm)?;
        let order = self.unrecorded("jog", jog_segments(step_mm));
        match &mut self.activity {
            Activity::Running(run) => run
                .turn_to(order.profile)
                .map_err(|e| Refusal::Motion(e.to_string())),
            Activity::Arming { order: waiting, .. } => {
                **waiting = order;
                Ok(())
            }
            _ => {
                self.arm(order, Some(SlowMotion::Jog));
                Ok(())
            }
        }
    }

    /// [`Rig::jog`], but only if a jog is under way: a button that is still held after a stop moves nothing again.
    pub(crate) fn jog_on(&mut self, step_mm: f64) -> Result<(), Refusal> {
        let under_way = match &self.activity {
            Activity::Running(run) => run.motion == Some(SlowMotion::Jog),
            Activity::Arming { motion, .. } => *motion == Some(SlowMotion::Jog),
            _ => false,
        };
        match under_way || step_mm == 0.0 {
            true => self.jog(step_mm),
            false => Err(Refusal::NoJog),
        }
    }

    /// A jog may lead back into the limits of travel, but not out of them.
    fn check_travel(&self, target_mm: f64, step_mm: f64) -> Result<(), Refusal> {
        let limits = &self.config.limits;
        let (min_mm, max_mm) = (limits.displacement_min_mm, limits.displacement_max_mm);
        let leaves = (step_mm > 0.0 && target_mm > max_mm) || (step_mm < 0.0 && target_mm < min_mm);
        match leaves {
            true => Err(Refusal::JogBeyondTravel {
                target_mm,
                min_mm,
                max_mm,
            }),
            false => Ok(()),
        }
    }

    /// The order of a motion in displacement control that nobody records.
    fn unrecorded(&self, name: &str, segments: Vec<Segment>) -> RunOrder {
        RunOrder {
            header: Header {
                run_id: String::new(),
                started_utc: String::new(),
                specimen: String::new(),
                operator: String::new(),
                profile_name: name.to_owned(),
                profile_toml: String::new(),
                bench_toml: String::new(),
                bench_sha256: String::new(),
                firmware: FirmwareIdentity::default(),
                program_version: String::new(),
                sample_rate_hz: f64::from(SAMPLE_RATE_HZ),
                force_channel: self.channels.force,
                displacement_channel: self.channels.displacement,
                force_sensor: SensorIdentity::default(),
                displacement_sensor: SensorIdentity::default(),
                twin: String::new(),
                first_cycle: 1,
                resumes_run: String::new(),
                cycles_planned: 0,
                duration_planned_s: 0.0,
                remarks: Vec::new(),
                continues: String::new(),
            },
            profile: Profile {
                name: name.to_owned(),
                description: String::new(),
                mode: Mode::Displacement,
                blocks: vec![Block { repeat: 1, segments }],
                accept: Vec::new(),
            },
            first_cycle: 1,
        }
    }
}

fn ramp(to: Level, distance_mm: f64, speed_mm_s: f64) -> Segment {
    Segment::Ramp {
        to,
        duration_s: (distance_mm.abs() / speed_mm_s).max(RAMP_LEAST_S),
    }
}

/// The step, then the time in which the next one may follow.
fn jog_segments(step_mm: f64) -> Vec<Segment> {
    let keep = Segment::Hold {
        duration_s: JOG_KEEP_S,
    };
    match step_mm == 0.0 {
        true => vec![keep],
        false => vec![ramp(Level::Relative(step_mm), step_mm, JOG_MM_S), keep],
    }
}
