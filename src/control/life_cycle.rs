//! Begin and end of a run: from the armed rig to the closed recording.

use super::detectors::Action;
use super::status::AT_ZERO_MM;
use super::{Activity, Channels, Rig, Run, Turn};
use crate::detector;
use crate::recording::{Ending, EventKind};
use crate::units::Mode;

/// A force at zero displacement above this share of the range is told (fault X5).
const ZERO_LOAD: f64 = 0.01;

impl Rig {
    /// Begins the ordered run. Its time starts when the first command is due. It starts from the mean of the window if the rig
    /// is still, else from the newest reading.
    pub(super) fn begin_run(&mut self, tick: u64, turn: &mut Turn) {
        let Activity::Arming { order, motion, .. } = std::mem::replace(&mut self.activity, Activity::Idle)
        else {
            return;
        };
        let mut order = *order;
        order.header.firmware = self.session.identity();
        order.header.force_channel = self.channels.force;
        order.header.displacement_channel = self.channels.displacement;
        let level = self.start_level(order.profile.mode);
        match Run::new(order, level, tick + self.lead_ticks) {
            Ok(mut run) => {
                run.motion = motion;
                if motion.is_none() {
                    turn.recorder.begin(&run.header);
                }
                let text = format!(
                    "run {} of profile {} starts",
                    run.header.run_id, run.header.profile_name
                );
                self.detectors.begin_run();
                self.activity = Activity::Running(Box::new(run));
                self.event(turn, EventKind::Start, text);
                self.check_zero(turn);
            }
            Err(error) => {
                self.notice = error.to_string();
                self.unload(turn.now_ns);
            }
        }
    }

    /// Tells of a force at zero displacement: the zero of a sensor has moved since the tare, or something presses on the specimen
    /// (fault X5).
    fn check_zero(&mut self, turn: &mut Turn) {
        let Some(at) = self.stillness.measure() else {
            return;
        };
        let limits = &self.config.limits;
        let range_n = limits.force_max_n.max(-limits.force_min_n);
        let at_zero = at.displacement_mm.abs() <= AT_ZERO_MM;
        if at_zero && at.force_n.abs() > ZERO_LOAD * range_n && detector::acts("X5") {
            let text = format!(
                "the load cell reads {:.1} N at zero displacement (limit {:.1} N, {:.0} % of its range): unload the specimen and tare, or check the load cell",
                at.force_n,
                ZERO_LOAD * range_n,
                100.0 * ZERO_LOAD
            );
            self.act(Action::Tell(text), turn);
        }
    }

    /// The mean of the window where the rig stands still and has stood there to the newest sample, else that sample: a mean
    /// over a motion is a place where the rig is not.
    fn start_level(&self, mode: Mode) -> f64 {
        let Some(newest) = &self.reading else { return 0.0 };
        let newest = Channels::feedback(mode, newest);
        let Some(still) = self.stillness.measure() else {
            return newest;
        };
        let (mean, sigma, largest_sigma) = match mode {
            Mode::Force => (still.force_n, still.force_sigma_n, self.config.still_sigma_n),
            Mode::Displacement => (
                still.displacement_mm,
                still.displacement_sigma_mm,
                self.config.still_sigma_mm,
            ),
        };
        if sigma <= largest_sigma && (newest - mean).abs() <= largest_sigma {
            mean
        } else {
            newest
        }
    }

    /// Closes the run as completed if `tick` is the last one of its profile, and asks the rig to unload.
    pub(super) fn finish_run_at(&mut self, tick: u64, turn: &mut Turn) {
        let Activity::Running(run) = &self.activity else {
            return;
        };
        if run.is_finished(tick) && !run.is_held() {
            self.close_run(Ending::Completed, "", turn);
            self.unload(turn.now_ns);
        }
    }

    /// Ends the profile; recording goes on until the rig is unloaded.
    pub(super) fn stop_run(&mut self, ending: Ending, cause: String, now_ns: u64) {
        if let Activity::Running(run) = std::mem::replace(&mut self.activity, Activity::Idle) {
            self.notice.clone_from(&cause);
            self.activity = Activity::Stopping {
                run,
                ending,
                cause,
                since_ns: now_ns,
            };
        }
    }

    /// Closes the recording of a run that was stopped.
    pub(super) fn close_stopped_run(&mut self, turn: &mut Turn) {
        if let Activity::Stopping { ending, cause, .. } = &mut self.activity {
            let (ending, cause) = (*ending, std::mem::take(cause));
            self.close_run(ending, &cause, turn);
        }
    }

    /// Ends the recording of the run under way. An empty cause means that the run is completed.
    pub(super) fn close_run(&mut self, ending: Ending, cause: &str, turn: &mut Turn) {
        if let Activity::Running(run) | Activity::Stopping { run, .. } = &self.activity
            && run.late_turns.count > 0
        {
            let late = run.late_turns;
            let text = format!(
                "{} turns of control were late in this run, the longest pause was {} ms",
                late.count, late.worst_ms
            );
            self.event(turn, EventKind::Link, text);
        }
        let text = if cause.is_empty() { "run completed" } else { cause };
        self.event(turn, EventKind::End, text.to_owned());
        if let Activity::Running(run) | Activity::Stopping { run, .. } = &self.activity
            && run.motion.is_none()
        {
            turn.recorder.end(&run.outcome(ending, cause));
        }
        if !cause.is_empty() {
            self.notice = cause.to_owned();
        }
        self.activity = Activity::Idle;
    }
}
