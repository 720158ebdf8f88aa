//! What control does when the rig changes its state or reboots, when a detector acts, and when the stream is silent.

use std::sync::atomic::Ordering;

use super::limits::Action;
use super::{Activity, Channels, DEAD_STREAM_NS, Rig, Turn};
use crate::protocol::message::{Cause, RequestCode, RigState};
use crate::recording::{Ending, EventKind};
use crate::units::NS_PER_MS;

/// A stopped run whose rig has not unloaded within this time is closed all the same.
const UNLOAD_TIMEOUT_NS: u64 = 20_000 * NS_PER_MS;

impl Rig {
    pub(super) fn on_state(&mut self, state: RigState, cause: Cause, turn: &mut Turn) {
        let before = self.state.replace(state);
        self.cause = cause;
        if before == Some(state) {
            return;
        }
        self.event(
            turn,
            EventKind::RigState,
            format!("rig {state:?}, cause {cause:?}"),
        );
        match (&mut self.activity, state) {
            (Activity::Running(run), RigState::Hold) => {
                run.hold(self.ticks.newest().unwrap_or(0));
                self.notice = format!("the rig holds ({cause:?}): resume or stop");
            }
            (Activity::Running(run), RigState::Armed) if run.is_held() => self.resume_run(turn),
            (Activity::Running(_), RigState::Unload | RigState::Tripped | RigState::Off) => {
                let text = format!("the rig ended the run: {cause:?}");
                self.stop_run(Ending::Aborted, text, turn.now_ns);
            }
            (Activity::Stopping { .. }, RigState::Off | RigState::Tripped) => self.close_stopped_run(turn),
            (Activity::Arming(_), RigState::Tripped | RigState::Unload) => {
                self.notice = format!("the rig did not arm ({cause:?}): remove the cause, then start again");
                self.activity = Activity::Idle;
            }
            (Activity::Unloading, RigState::Off | RigState::Tripped) => self.activity = Activity::Idle,
            _ => {}
        }
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

    pub(super) fn on_reboot(&mut self, turn: &mut Turn) {
        self.session.restart(turn.now_ns);
        self.forget_stream();
        let text = "the rig's firmware restarted: check the rig, then start again";
        self.event(turn, EventKind::RigState, text.to_owned());
        if let Activity::Running(_) | Activity::Stopping { .. } = self.activity {
            self.close_run(Ending::Aborted, text, turn);
        }
        self.activity = Activity::Idle;
    }

    fn forget_stream(&mut self) {
        self.ticks.restart();
        self.clock.restart();
        self.sample_counter.reset();
        self.stillness.clear();
    }

    /// Does what a detector decided; only while a run is under way.
    pub(super) fn act(&mut self, action: Action, turn: &mut Turn) {
        if !matches!(self.activity, Activity::Running(_)) {
            return;
        }
        match action {
            Action::Hold(why) => {
                self.event(turn, EventKind::Limit, why.clone());
                self.notice = why;
                self.next_request = Some(RequestCode::Hold);
            }
            Action::Abort(why) => {
                self.event(turn, EventKind::Limit, why.clone());
                self.abort(turn.link);
                self.stop_run(Ending::Aborted, why, turn.now_ns);
            }
        }
    }

    /// Checks what no frame reports: bus errors, a silent stream, an unload that does not end.
    pub(super) fn watch(&mut self, turn: &mut Turn) {
        self.note_bus_errors(turn);
        if let Some(action) = self.detectors.silence(turn.now_ns) {
            self.act(action, turn);
        }
        let silent_ns = self.detectors.age_ms(turn.now_ns).unwrap_or(0) * NS_PER_MS;
        let is_dead = silent_ns > DEAD_STREAM_NS;
        if is_dead && self.session.is_open() {
            self.session.restart(turn.now_ns);
            self.forget_stream();
            self.state = None;
            self.nmt_sent_ns = None;
        }
        match &self.activity {
            Activity::Stopping { since_ns, .. }
                if is_dead || turn.now_ns.saturating_sub(*since_ns) > UNLOAD_TIMEOUT_NS =>
            {
                self.close_stopped_run(turn);
            }
            Activity::Arming(_) | Activity::Unloading if is_dead => self.activity = Activity::Idle,
            _ => {}
        }
    }

    fn note_bus_errors(&mut self, turn: &mut Turn) {
        let bus_errors = turn.link.health.bus_errors.load(Ordering::Relaxed);
        if bus_errors > self.counters.bus_errors {
            let more = bus_errors - self.counters.bus_errors;
            if matches!(self.activity, Activity::Running(_)) {
                self.event(
                    turn,
                    EventKind::Link,
                    format!("{more} new bus errors, {bus_errors} in total"),
                );
            }
        }
        self.counters.bus_errors = bus_errors;
    }

    /// A request was refused or not answered: an arming run is dropped, and the reason is shown.
    pub(super) fn give_up(&mut self, why: String, turn: &mut Turn) {
        self.event(turn, EventKind::RigState, why.clone());
        self.notice = why;
        if matches!(self.activity, Activity::Arming(_)) {
            self.activity = Activity::Idle;
        }
    }
}
