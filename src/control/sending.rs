//! What goes out in a poll: requests, the lease, commands ahead of time.

use super::*;

impl Rig {
    pub(super) fn send_due(&mut self, now_ns: u64, link: &mut Link, recorder: &mut dyn Recorder) {
        if let Some(given_up) = self.session.poll(now_ns, link) {
            self.on_unanswered(given_up, now_ns, link, recorder);
        }
        if self
            .nmt_sent_ns
            .is_none_or(|at| now_ns.saturating_sub(at) >= NMT_START_PERIOD_NS)
            && self
                .detectors
                .age_ms(now_ns)
                .is_none_or(|age| age * MS > DEAD_STREAM_NS)
        {
            let start = ToRig::Nmt {
                command: NmtCommand::Start,
                node: self.config.node,
            };
            link.send(start.encode(self.config.node));
            self.nmt_sent_ns = Some(now_ns);
        }
        if !self.session.is_open() {
            return;
        }
        if self
            .lease_sent_ns
            .is_none_or(|at| now_ns.saturating_sub(at) >= LEASE_PERIOD_NS)
        {
            self.lease_counter = next_counter(self.lease_counter);
            let lease = ToRig::Lease {
                counter: self.lease_counter,
                session: self.session.id(),
                control_tick: self.ticks.newest().unwrap_or(0) as u16,
            };
            link.send(lease.encode(self.config.node));
            self.lease_sent_ns = Some(now_ns);
        }
        if !self.session.awaits_answer()
            && let Some(code) = self.ask.take()
        {
            let argument = if code == RequestCode::Arm {
                self.session.configuration_crc()
            } else {
                0
            };
            self.session.request(code, argument, now_ns, link);
        }
        self.send_commands(link);
    }

    pub(super) fn on_unanswered(
        &mut self,
        code: RequestCode,
        now_ns: u64,
        link: &mut Link,
        recorder: &mut dyn Recorder,
    ) {
        let why = format!("the rig did not answer {code:?}, asked twice: check the link");
        if matches!(self.activity, Activity::Running(_)) {
            self.act(Action::Abort(why), now_ns, link, recorder);
        } else {
            if code == RequestCode::Unload {
                self.abort(link);
            }
            self.give_up(why, recorder);
        }
    }

    pub(super) fn send_commands(&mut self, link: &mut Link) {
        let Some(newest) = self.ticks.newest() else { return };
        if let Some(frame) = self.unsent.take()
            && !link.send(frame)
        {
            self.unsent = Some(frame);
            return;
        }
        let Activity::Running(run) = &mut self.activity else {
            return;
        };
        // A poll that comes late has as many ticks to make up for; the load of the bus is the same over time.
        let passed = newest
            .saturating_sub(self.fed_at_tick)
            .clamp(1, self.config.queue_lead_ms);
        self.fed_at_tick = newest;
        for _ in 0..u64::from(self.config.commands_per_poll) * passed {
            let Some((tick, slot)) = run.next_command(newest + self.config.queue_lead_ms) else {
                return;
            };
            self.command_counter = next_counter(self.command_counter);
            let message = ToRig::Command {
                counter: self.command_counter,
                session: self.session.id(),
                tick: tick as u16,
                mode: match slot.command {
                    Command::Displacement(_) => WireMode::Displacement,
                    Command::Force(_) => WireMode::Force,
                },
                counts: self.channels.command_counts(slot.command),
                last: slot.last,
            };
            let frame = message.encode(self.config.node);
            if !link.send(frame) {
                self.counters.send_failures += 1;
                self.unsent = Some(frame);
                return;
            }
        }
    }
}
