//! The abort: NMT stop, repeated until the rig confirms it. A single frame can be lost, so sending it once proves nothing.
//! The lease is not renewed any more, so that the rig unloads by itself where the frame never arrives.

use super::{Activity, Rig, Turn, is_due};
use crate::detector;
use crate::link::Link;
use crate::protocol::message::{NmtCommand, NmtState, RigState, ToRig};
use crate::units::{NS_PER_MS, NS_PER_S};

/// NMT stop is repeated this often until a status confirms it.
const REPEAT_NS: u64 = 10 * NS_PER_MS;
/// After this time without confirmation the operator is told to act.
const TELL_NS: u64 = NS_PER_S;

/// An abort that is not over.
#[derive(Debug, Clone, Copy)]
pub(super) struct Abort {
    since_ns: u64,
    sent_ns: u64,
    /// A status shows that the rig unloads or is without pressure.
    confirmed: bool,
    /// The operator was told that the rig does not confirm.
    told: bool,
}

impl Rig {
    /// Stops the rig with NMT stop: the firmware unloads. Requests that wait are dropped.
    pub(super) fn abort(&mut self, now_ns: u64, link: &mut Link) {
        self.session.forget_request();
        self.next_request = None;
        self.refused_command = None;
        self.send_stop(link);
        self.abort = Some(Abort {
            since_ns: now_ns,
            sent_ns: now_ns,
            confirmed: false,
            told: false,
        });
    }

    fn send_stop(&self, link: &mut Link) {
        let stop = ToRig::Nmt {
            command: NmtCommand::Stop,
            node: self.config.node,
        };
        link.send_urgent(stop.encode(self.config.node));
    }

    /// A status of the rig: does it confirm the abort?
    pub(super) fn confirm_abort_by_state(&mut self, state: RigState) {
        if let Some(abort) = &mut self.abort {
            abort.confirmed |= matches!(state, RigState::Unload | RigState::Tripped | RigState::Off);
        }
    }

    /// A heartbeat of the rig: one that has just booted has no pressure.
    pub(super) fn confirm_abort_by_heartbeat(&mut self, state: NmtState) {
        if let Some(abort) = &mut self.abort {
            abort.confirmed |= matches!(state, NmtState::BootUp | NmtState::PreOperational);
        }
    }

    /// Goes on with an abort: repeats it, tells the operator, and ends it once the rig has unloaded. True while it lasts:
    /// then neither lease nor request nor command is sent.
    pub(super) fn continue_abort(&mut self, turn: &mut Turn) -> bool {
        let Some(mut abort) = self.abort else {
            return false;
        };
        if abort.confirmed {
            let over = matches!(self.activity, Activity::Idle);
            self.abort = (!over).then_some(abort);
            return !over;
        }
        if is_due(Some(abort.sent_ns), turn.now_ns, REPEAT_NS) && detector::acts("L17") {
            self.send_stop(turn.link);
            abort.sent_ns = turn.now_ns;
        }
        if !abort.told && turn.now_ns.saturating_sub(abort.since_ns) > TELL_NS {
            abort.told = true;
            let text = "the rig has not confirmed the abort for 1 s: press the emergency stop";
            self.notice = match self.notice.is_empty() {
                true => text.to_owned(),
                false => format!("{text} ({})", self.notice),
            };
        }
        self.abort = Some(abort);
        true
    }
}
