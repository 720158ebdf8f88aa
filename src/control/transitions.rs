//! What control does when the rig changes its state or restarts.

use super::{Activity, Channels, Rig, Turn};
use crate::detector;
use crate::protocol::message::{Cause, NmtState, RequestCode, RigState};
use crate::recording::{Ending, EventKind};
use crate::units::NS_PER_S;

/// A delay of this computer this long ago can be why the rig ends a run: its lease, the queue of commands and the way of the
/// status are together shorter. Twice as long would blame this computer for a cable that was pulled a second later.
const RECENT_NS: u64 = NS_PER_S;

impl Rig {
    pub(super) fn on_state(&mut self, state: RigState, cause: Cause, turn: &mut Turn) {
        let before = self.state.replace(state);
        self.cause = cause;
        if before == Some(state) {
            return;
        }
        let text = match cause {
            Cause::None => format!("rig {state}"),
            cause => format!("rig {state}, cause {cause}"),
        };
        self.event(turn, EventKind::RigState, text);
        match (&mut self.activity, state) {
            (Activity::Running(run), RigState::Hold) => {
                run.hold(self.ticks.newest().unwrap_or(0));
                // A detector that asked for the hold has said why.
                if cause != Cause::None {
                    self.notice = format!("the rig holds ({cause}): resume or stop");
                } else if self.notice.is_empty() {
                    "the rig holds as it was asked to: resume or stop".clone_into(&mut self.notice);
                }
            }
            (Activity::Running(run), RigState::Armed) if run.is_held() => self.resume_run(turn),
            (Activity::Running(_), RigState::Unload | RigState::Tripped | RigState::Off) => {
                let text = self.why_the_rig_ended_it(cause);
                self.stop_run(Ending::Aborted, text, turn.now_ns);
            }
            (Activity::Arming { .. }, RigState::Tripped | RigState::Unload) => {
                self.notice = match cause {
                    Cause::None => "the rig did not arm and gives no cause: start again".to_owned(),
                    cause => format!("the rig did not arm ({cause}): remove the cause, then start again"),
                };
                self.activity = Activity::Idle;
            }
            _ => {}
        }
    }

    /// The cause of a run that the rig ended. A lease that lapsed because this computer was late is not the rig's fault.
    fn why_the_rig_ended_it(&self, cause: Cause) -> String {
        let lease_ms = u64::try_from(self.config.limits.lease_ms).unwrap_or(0);
        let gap_ms = self.recent_gap_ms();
        if cause == Cause::None {
            return "the rig ended the run and gives no cause: check the rig".to_owned();
        }
        if matches!(cause, Cause::LeaseLapsed | Cause::QueueDry) && 2 * gap_ms > lease_ms {
            return format!(
                "the rig ended the run: {cause}; control was delayed by {gap_ms} ms on this computer (lease {lease_ms} ms): end other programs or allow real-time priority"
            );
        }
        format!("the rig ended the run: {cause}")
    }

    /// The longest pause between two polls of late, ms: a pause of long ago did not end this run.
    pub(super) fn recent_gap_ms(&self) -> u64 {
        let now_ns = self.last_poll_ns.unwrap_or(0);
        let recent = |(at_ns, _): &(u64, u64)| now_ns.saturating_sub(*at_ns) <= RECENT_NS;
        self.long_gap.filter(recent).map_or(0, |(_, gap_ms)| gap_ms)
    }

    /// The rig is armed again after a hold.
    fn resume_run(&mut self, turn: &mut Turn) {
        let Activity::Running(run) = &mut self.activity else {
            return;
        };
        let level = self.reading.map_or(0.0, |r| Channels::feedback(run.mode(), &r));
        let first_tick = self.ticks.newest().unwrap_or(0) + self.lead_ticks;
        if let Err(error) = run.resume(first_tick, level) {
            let text = format!("the run cannot resume: {error}");
            self.next_request = Some(RequestCode::Unload);
            self.stop_run(Ending::Stopped, text, turn.now_ns);
        }
    }

    /// Takes the NMT state. One that does not belong to a motion shows a restart, also where the boot-up frame was lost.
    pub(super) fn on_heartbeat(&mut self, state: NmtState, turn: &mut Turn) {
        self.nmt = Some(state);
        self.confirm_abort_by_heartbeat(state);
        let restarted = match state {
            NmtState::BootUp => true,
            NmtState::PreOperational => !matches!(self.activity, Activity::Idle),
            NmtState::Stopped | NmtState::Operational => false,
        };
        if restarted {
            self.on_reboot(turn);
        }
    }

    pub(super) fn on_reboot(&mut self, turn: &mut Turn) {
        if !detector::acts("F2") {
            return;
        }
        let text = "the rig's firmware restarted: check the rig, then reset and start again";
        // Before the ticks are forgotten, because events have the time of the newest one.
        self.event(turn, EventKind::RigState, text.to_owned());
        if !matches!(self.activity, Activity::Idle) {
            self.fault = Some(text.to_owned());
        }
        match &self.activity {
            Activity::Running(_) => self.close_run(Ending::Aborted, text, turn),
            Activity::Stopping { cause, .. } => {
                let cause = format!("{text} (before that: {cause})");
                self.close_run(Ending::Aborted, &cause, turn);
            }
            Activity::Arming { .. } | Activity::Unloading { .. } => text.clone_into(&mut self.notice),
            // A rig that was just switched on is no restart.
            Activity::Idle if self.state.is_some() => text.clone_into(&mut self.notice),
            Activity::Idle => {}
        }
        self.activity = Activity::Idle;
        self.session.restart(turn.now_ns);
        self.forget_stream();
        self.state = None;
    }

    pub(super) fn forget_stream(&mut self) {
        self.ticks.restart();
        self.clock.restart();
        self.sample_counter.reset();
        self.status_counter.reset();
        self.stillness.clear();
        // A value of a rig that is not heard would look live.
        self.reading = None;
        self.detectors.forget_stream();
    }
}
