//! What a poll sends: requests, NMT start, the lease, and commands ahead of their ticks.

use super::detectors::Action;
use super::{Activity, DEAD_STREAM_NS, Rig, Turn, is_due};
use crate::detector;
use crate::link::Link;
use crate::protocol::frame::Frame;
use crate::protocol::message::{
    CommandMessage, LeaseMessage, NmtCommand, NmtState, RequestCode, RigState, ToRig, WireMode, next_counter,
};
use crate::units::{Mode, NS_PER_MS};

/// The lease is sent this often, from the control loop itself.
const LEASE_PERIOD_NS: u64 = 10 * NS_PER_MS;
/// A link that refuses a command for longer is a fault, ns (L5). Each turn tries again. A bus that is busy for a few ms is none;
/// the rig's queue of 100 ms still has the time for an orderly end.
const REFUSED_NS: u64 = 20 * NS_PER_MS;
/// NMT start is repeated this often until samples come.
const NMT_START_PERIOD_NS: u64 = 500 * NS_PER_MS;

impl Rig {
    pub(super) fn send_due(&mut self, turn: &mut Turn) {
        if self.continue_abort(turn) {
            return;
        }
        let started = matches!(self.nmt, Some(NmtState::Operational | NmtState::Stopped));
        if let Some(unanswered) = self.session.poll(started, turn.now_ns, turn.link) {
            self.on_unanswered(unanswered, turn);
        }
        self.start_node(turn);
        if !self.session.is_owned() {
            return;
        }
        // A lease that the link refused is tried again in the next turn.
        if is_due(self.lease_sent_ns, turn.now_ns, LEASE_PERIOD_NS)
            && let Some(newest) = self.ticks.newest()
            && self.send_lease(newest, turn.link)
        {
            self.lease_sent_ns = Some(turn.now_ns);
        }
        if !self.session.is_open() {
            return;
        }
        if !self.session.awaits_answer()
            && let Some(code) = self.next_request.take()
        {
            let argument = if code == RequestCode::Arm {
                self.session.configuration_crc()
            } else {
                0
            };
            self.session.request(code, argument, turn.now_ns, turn.link);
        }
        self.send_commands(turn.link);
        self.watch_refusals(turn);
    }

    /// Ends the run if the link takes no command for too long.
    fn watch_refusals(&mut self, turn: &mut Turn) {
        if self.refused_command.is_none() {
            self.refused_since_ns = None;
            return;
        }
        let since_ns = *self.refused_since_ns.get_or_insert(turn.now_ns);
        let refused_ns = turn.now_ns.saturating_sub(since_ns);
        if refused_ns > REFUSED_NS && detector::acts("L5") {
            let why = format!(
                "the link has taken no command for {} ms (limit {} ms): check bus load, cable and adapter",
                refused_ns / NS_PER_MS,
                REFUSED_NS / NS_PER_MS
            );
            self.act(Action::Abort(why), turn);
        }
    }

    /// NMT start: until samples flow, and again after an abort or a restart, before the next run.
    fn start_node(&mut self, turn: &mut Turn) {
        let silent = self
            .detectors
            .age_ms(turn.now_ns)
            .is_none_or(|age| age * NS_PER_MS > DEAD_STREAM_NS);
        let at_rest = matches!(self.activity, Activity::Idle)
            && matches!(self.state, None | Some(RigState::Off | RigState::Tripped));
        let not_started = matches!(self.nmt, Some(NmtState::Stopped | NmtState::PreOperational));
        let needed = silent || (not_started && at_rest);
        if needed && is_due(self.nmt_sent_ns, turn.now_ns, NMT_START_PERIOD_NS) {
            let start = ToRig::Nmt {
                command: NmtCommand::Start,
                node: self.config.node,
            };
            turn.link.send(start.encode(self.config.node));
            self.nmt_sent_ns = Some(turn.now_ns);
        }
    }

    fn on_unanswered(&mut self, code: RequestCode, turn: &mut Turn) {
        let why = format!("the rig did not answer {code}, asked twice: check the link");
        if matches!(self.activity, Activity::Running(_)) {
            self.act(Action::Abort(why), turn);
        } else {
            self.give_up(why, turn);
            if code == RequestCode::Unload {
                self.abort(turn.now_ns, turn.link);
            }
        }
    }

    /// True if the link took the lease.
    fn send_lease(&mut self, newest_tick: u64, link: &mut Link) -> bool {
        self.lease_counter = next_counter(self.lease_counter);
        let lease = ToRig::Lease(LeaseMessage {
            counter: self.lease_counter,
            session: self.session.id(),
            control_tick: newest_tick as u16,
        });
        link.send(lease.encode(self.config.node))
    }

    fn send_commands(&mut self, link: &mut Link) {
        let Some(newest) = self.ticks.newest() else { return };
        if let Some(frame) = self.refused_command.take()
            && !link.send(frame)
        {
            self.refused_command = Some(frame);
            return;
        }
        if !matches!(self.activity, Activity::Running(_)) {
            return;
        }
        // A late poll sends the commands of the ticks that it missed; the mean load of the bus stays the same.
        let passed = newest
            .saturating_sub(self.commands_sent_at)
            .clamp(1, self.lead_ticks);
        self.commands_sent_at = newest;
        for _ in 0..u64::from(self.config.commands_per_poll) * passed {
            let Some(frame) = self.next_command(newest + self.lead_ticks) else {
                return;
            };
            if !link.send(frame) {
                self.counters.send_failures += 1;
                self.refused_command = Some(frame);
                return;
            }
        }
    }

    /// The frame of the next command of the run, if it is due by the tick `horizon`.
    fn next_command(&mut self, horizon: u64) -> Option<Frame> {
        let Activity::Running(run) = &mut self.activity else {
            return None;
        };
        let (tick, slot) = run.next_command(horizon)?;
        self.command_counter = next_counter(self.command_counter);
        let command = ToRig::Command(CommandMessage {
            counter: self.command_counter,
            session: self.session.id(),
            tick: tick as u16,
            mode: match slot.command.mode() {
                Mode::Displacement => WireMode::Displacement,
                Mode::Force => WireMode::Force,
            },
            counts: self
                .channels
                .command_counts(self.config.limits.within(slot.command)),
            last: slot.last,
        });
        Some(command.encode(self.config.node))
    }
}
