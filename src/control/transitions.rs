//! What changes of the rig, silence and detectors do to the run under way.

use super::*;

impl Rig {
    pub(super) fn on_state(
        &mut self,
        state: RigState,
        cause: Cause,
        now_ns: u64,
        recorder: &mut dyn Recorder,
    ) {
        let before = self.state.replace(state);
        self.cause = cause;
        if before == Some(state) {
            return;
        }
        self.event(
            recorder,
            EventKind::RigState,
            format!("rig {state:?}, cause {cause:?}"),
        );
        let newest = self.ticks.newest().unwrap_or(0);
        match (&mut self.activity, state) {
            (Activity::Running(run), RigState::Hold) => {
                run.hold(newest);
                self.notice = format!("the rig holds ({cause:?}): resume or stop");
            }
            (Activity::Running(run), RigState::Armed) if run.is_held() => {
                let level = self.reading.map_or(0.0, |r| Channels::feedback(run.mode(), &r));
                if let Err(error) = run.resume(newest + self.config.queue_lead_ms, level) {
                    let text = format!("the run cannot resume: {error}");
                    self.ask = Some(RequestCode::Unload);
                    self.wind_down(Ending::Stopped, text, now_ns);
                }
            }
            (Activity::Running(_), RigState::Unload | RigState::Tripped | RigState::Off) => {
                let text = format!("the rig ended the run: {cause:?}");
                self.wind_down(Ending::Aborted, text, now_ns);
            }
            (
                Activity::Stopping {
                    ending, cause: text, ..
                },
                RigState::Off | RigState::Tripped,
            ) => {
                let (ending, text) = (*ending, std::mem::take(text));
                self.close(ending, &text, recorder);
            }
            (Activity::Arming(_), RigState::Tripped | RigState::Unload) => {
                self.notice = format!("the rig did not arm: {cause:?}");
                self.activity = Activity::Idle;
            }
            (Activity::Unloading, RigState::Off | RigState::Tripped) => self.activity = Activity::Idle,
            _ => {}
        }
    }

    pub(super) fn on_reboot(&mut self, now_ns: u64, recorder: &mut dyn Recorder) {
        self.session.restart(now_ns);
        self.forget_stream();
        let text = "the rig's firmware restarted: check the rig, then start again";
        self.event(recorder, EventKind::RigState, text.to_owned());
        if let Activity::Running(_) | Activity::Stopping { .. } = self.activity {
            self.close(Ending::Aborted, text, recorder);
        }
        self.activity = Activity::Idle;
    }

    pub(super) fn forget_stream(&mut self) {
        self.ticks.restart();
        self.clock.restart();
        self.sample_counter.reset();
        self.stillness.clear();
    }

    /// Keeps recording while the rig unloads, then closes the run.
    pub(super) fn wind_down(&mut self, ending: Ending, cause: String, now_ns: u64) {
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

    pub(super) fn act(&mut self, action: Action, now_ns: u64, link: &mut Link, recorder: &mut dyn Recorder) {
        if !matches!(self.activity, Activity::Running(_)) {
            return;
        }
        match action {
            Action::Hold(why) => {
                self.event(recorder, EventKind::Limit, why.clone());
                self.notice = why;
                self.ask = Some(RequestCode::Hold);
            }
            Action::Abort(why) => {
                self.event(recorder, EventKind::Limit, why.clone());
                self.abort(link);
                self.wind_down(Ending::Aborted, why, now_ns);
            }
        }
    }

    pub(super) fn abort(&mut self, link: &mut Link) {
        let stop = ToRig::Nmt {
            command: NmtCommand::Stop,
            node: self.config.node,
        };
        link.send_urgent(stop.encode(self.config.node));
    }

    /// Watches what no frame tells: a closed link, a silent stream, an unload that does not end.
    pub(super) fn watch(&mut self, now_ns: u64, link: &mut Link, recorder: &mut dyn Recorder) {
        let bus_errors = link.health.bus_errors.load(std::sync::atomic::Ordering::Relaxed);
        if bus_errors > self.counters.bus_errors && matches!(self.activity, Activity::Running(_)) {
            let text = format!(
                "{} bus errors more, {bus_errors} in all",
                bus_errors - self.counters.bus_errors
            );
            self.event(recorder, EventKind::Link, text);
        }
        self.counters.bus_errors = bus_errors;
        if let Some(action) = self.detectors.silence(now_ns) {
            self.act(action, now_ns, link, recorder);
        }
        let silent_ns = self.detectors.age_ms(now_ns).unwrap_or(0) * MS;
        if silent_ns > DEAD_STREAM_NS && self.session.is_open() {
            self.session.restart(now_ns);
            self.forget_stream();
            self.state = None;
            self.nmt_sent_ns = None;
        }
        let overdue = match &self.activity {
            Activity::Stopping { since_ns, .. } => {
                silent_ns > DEAD_STREAM_NS || now_ns.saturating_sub(*since_ns) > UNLOAD_TIMEOUT_NS
            }
            _ => false,
        };
        if overdue && let Activity::Stopping { ending, cause, .. } = &mut self.activity {
            let (ending, text) = (*ending, std::mem::take(cause));
            self.close(ending, &text, recorder);
        }
        if matches!(self.activity, Activity::Arming(_) | Activity::Unloading) && silent_ns > DEAD_STREAM_NS {
            self.activity = Activity::Idle;
        }
    }

    /// A request came to nothing: an arming run is dropped, anything else is said.
    pub(super) fn give_up(&mut self, why: String, recorder: &mut dyn Recorder) {
        self.event(recorder, EventKind::RigState, why.clone());
        self.notice = why;
        if matches!(self.activity, Activity::Arming(_)) {
            self.activity = Activity::Idle;
        }
    }
}
