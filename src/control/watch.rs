//! What control does when a detector acts, when the link reports something, and when something does not end.

use std::sync::atomic::Ordering;

use super::detectors::{Action, Damage, LinkCounts};
use super::{Activity, DEAD_STREAM_NS, Rig, Turn};
use crate::detector;
use crate::protocol::message::{RequestCode, RigState};
use crate::recording::{Ending, EventKind};
use crate::units::{NS_PER_MS, NS_PER_S};

/// A stopped run whose rig has not unloaded within this time is closed all the same.
const UNLOAD_TIMEOUT_NS: u64 = 20 * NS_PER_S;
/// A rig that was asked to unload and still does not is aborted after this time.
const UNLOAD_PATIENCE_NS: u64 = NS_PER_S;
/// A rig that was asked to arm and is not armed is unloaded after this time.
const ARM_PATIENCE_NS: u64 = 5 * NS_PER_S;
/// A rig clock that is further off than this is told, ppm: a quartz is off by 100 at most (fault F4).
const DRIFT_MAX_PPM: u64 = 1000;
/// A turn of control that comes later than this is told, ms (fault O1). The lease of the rig is 50 ms.
const LATE_TOLD_MS: u64 = 20;
/// A stopped run is recorded at least this long: a trip at once is followed by its first movements.
const AFTER_STOP_NS: u64 = 500 * NS_PER_MS;

/// True in the states that keep a load until somebody unloads it.
fn is_loaded(state: RigState) -> bool {
    matches!(state, RigState::Armed | RigState::Running | RigState::Hold)
}

impl Rig {
    /// Does what a detector decided; only while a run is under way.
    pub(super) fn act(&mut self, action: Action, turn: &mut Turn) {
        if !matches!(self.activity, Activity::Running(_)) {
            return;
        }
        match action {
            Action::Tell(why) => {
                self.event(turn, EventKind::Limit, why.clone());
                self.notice = why;
            }
            Action::Hold(why) => {
                self.event(turn, EventKind::Limit, why.clone());
                self.notice = why;
                self.next_request = Some(RequestCode::Hold);
            }
            Action::Abort(why) => {
                self.event(turn, EventKind::Limit, why.clone());
                self.fault = Some(why.clone());
                self.abort(turn.now_ns, turn.link);
                self.stop_run(Ending::Aborted, why, turn.now_ns);
            }
        }
    }

    /// A frame with a wrong CRC, field or sequence.
    pub(super) fn on_damaged_frame(&mut self, damage: Damage, turn: &mut Turn) {
        if let Some(action) = self.detectors.on_damaged_frame(damage, turn.now_ns) {
            self.act(action, turn);
        }
    }

    /// Compares the newest status with what the run expects.
    pub(super) fn check_progress(&mut self, turn: &mut Turn) {
        let (Activity::Running(run), Some(state)) = (&self.activity, self.state) else {
            return;
        };
        let Some(expected) = run.expected() else { return };
        let tick = self.ticks.newest().unwrap_or(0);
        let found = self.detectors.on_progress(state, self.queue_ms, tick, expected);
        if let Some(action) = found {
            self.act(action, turn);
        }
    }

    /// Checks what no frame reports: the link, silent streams, states that do not end.
    pub(super) fn watch(&mut self, turn: &mut Turn) {
        self.watch_link(turn);
        if let Some(action) = self.detectors.end_poll(turn.now_ns) {
            self.act(action, turn);
        }
        self.watch_clock(turn);
        self.watch_lateness(turn);
        self.watch_silence(turn);
        self.watch_activity(turn);
    }

    fn watch_clock(&mut self, turn: &mut Turn) {
        let ppm = self.clock.drift_ppm().unwrap_or(0);
        let drifts = ppm.unsigned_abs() > DRIFT_MAX_PPM;
        if drifts && !self.clock_drifts && detector::acts("F4") {
            let text = format!(
                "the rig's clock is off by {ppm} ppm against this computer (limit {DRIFT_MAX_PPM} ppm): frequencies of the profile are off by as much, check the rig's oscillator"
            );
            self.event(turn, EventKind::Link, text.clone());
            self.notice = text;
        }
        self.clock_drifts = drifts;
    }

    /// Tells of a run whose control was late for so long that its samples and commands waited (fault O1).
    fn watch_lateness(&mut self, turn: &mut Turn) {
        let Activity::Running(run) = &mut self.activity else {
            return;
        };
        let late = &mut run.late_turns;
        if late.told || late.worst_ms <= LATE_TOLD_MS || !detector::acts("O1") {
            return;
        }
        late.told = true;
        let text = format!(
            "control was late by {} ms on this computer (limit {LATE_TOLD_MS} ms): end other programs or allow real-time priority",
            late.worst_ms
        );
        self.act(Action::Tell(text), turn);
    }

    fn watch_link(&mut self, turn: &mut Turn) {
        let health = &turn.link.health;
        let read = |counter: &std::sync::atomic::AtomicU64| counter.load(Ordering::Relaxed);
        let counts = LinkCounts {
            bus_off: read(&health.bus_off),
            overflows: read(&health.overflows),
            bad_packets: read(&health.bad_packets),
            good_packets: read(&health.good_packets),
        };
        let bus_errors = read(&health.bus_errors);
        let error_passive = health.error_passive.load(Ordering::Relaxed);
        if bus_errors > self.counters.bus_errors {
            let more = bus_errors - self.counters.bus_errors;
            let text = format!("{more} new bus errors, {bus_errors} in total");
            self.event(turn, EventKind::Link, text);
        }
        self.counters.bus_errors = bus_errors;
        self.counters.receive_overflows = counts.overflows;
        let error_passive = error_passive && detector::acts("L4");
        if error_passive && !self.error_passive {
            let text = "the CAN controller is error passive: check bit rate, termination and wiring; no new run starts until it recovers";
            self.event(turn, EventKind::Link, text.to_owned());
            text.clone_into(&mut self.notice);
        }
        self.error_passive = error_passive;
        if let Some(action) = self.detectors.on_link(counts, turn.now_ns) {
            self.act(action, turn);
        }
    }

    /// Without samples the rig is not connected; without status its state is unknown.
    fn watch_silence(&mut self, turn: &mut Turn) {
        let silent_ns = self.detectors.age_ms(turn.now_ns).unwrap_or(0) * NS_PER_MS;
        if silent_ns > DEAD_STREAM_NS {
            // A pause of this computer hides a silence from its detector.
            let text = format!(
                "no sample for {} ms: check the link and the rig",
                silent_ns / NS_PER_MS
            );
            self.act(Action::Abort(text), turn);
            self.close_stopped_run(turn);
            self.activity = Activity::Idle;
            // Once for each loss, also where statuses go on.
            if self.ticks.newest().is_some() || self.session.is_owned() {
                self.session.restart(turn.now_ns);
                self.forget_stream();
                self.nmt = None;
            }
            self.state = None;
        }
        if self
            .detectors
            .status_silence_ms()
            .is_some_and(|ms| ms * NS_PER_MS > DEAD_STREAM_NS)
        {
            self.state = None;
        }
    }

    /// Ends what the rig's state ends, and helps where it does not.
    fn watch_activity(&mut self, turn: &mut Turn) {
        let without_pressure = matches!(self.state, Some(RigState::Off | RigState::Tripped));
        let waits = self.next_request.is_some() || self.session.awaits_answer();
        let passed = |since_ns: u64| turn.now_ns.saturating_sub(since_ns);
        match &self.activity {
            Activity::Stopping { since_ns, .. }
                if passed(*since_ns) > UNLOAD_TIMEOUT_NS
                    || (without_pressure && !waits && passed(*since_ns) > AFTER_STOP_NS) =>
            {
                self.close_stopped_run(turn);
            }
            Activity::Unloading { .. } if without_pressure && !waits => self.activity = Activity::Idle,
            Activity::Stopping { since_ns, .. } | Activity::Unloading { since_ns } => {
                let unloads = without_pressure || self.state == Some(RigState::Unload);
                if !unloads
                    && self.abort.is_none()
                    && passed(*since_ns) > UNLOAD_PATIENCE_NS
                    && detector::acts("F5")
                {
                    let text = "the rig did not begin to unload within 1 s after the request: it is aborted by NMT stop";
                    self.event(turn, EventKind::Limit, text.to_owned());
                    self.fault = Some(text.to_owned());
                    self.abort(turn.now_ns, turn.link);
                }
            }
            Activity::Arming { since_ns, .. } if passed(*since_ns) > ARM_PATIENCE_NS => {
                self.give_up(
                    "the rig was asked to arm and is not armed after 5 s: check the rig".to_owned(),
                    turn,
                );
            }
            // The rig is ours, nothing is under way, and it carries load all the same.
            Activity::Idle if self.session.is_open() && self.state.is_some_and(is_loaded) && !waits => {
                self.unload(turn.now_ns);
            }
            _ => {}
        }
    }

    /// A request was refused or not answered: an arming run is dropped, the rig unloads, and the reason is shown.
    pub(super) fn give_up(&mut self, why: String, turn: &mut Turn) {
        self.event(turn, EventKind::RigState, why.clone());
        self.notice = why;
        if matches!(self.activity, Activity::Arming { .. }) {
            self.unload(turn.now_ns);
        }
    }

    /// Asks the rig to unload, without a run under way. While an abort is not over, no request is sent: it unloads the rig.
    pub(super) fn unload(&mut self, now_ns: u64) {
        self.session.forget_request();
        self.next_request = self.abort.is_none().then_some(RequestCode::Unload);
        self.activity = Activity::Unloading { since_ns: now_ns };
    }
}
