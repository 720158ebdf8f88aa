//! The host of a conformance run: it hears every frame with its place in the rig's time, keeps the lease if asked to, and
//! streams one motion. Requests are in `asking`, arming and moves in `moving`.
//!
//! Times are judged by the rig's ticks: the tick of a frame is that of the newest SAMPLE before it in the stream, so a slow
//! computer does not make a rig look slow.

use crate::link::{self, Link};
use crate::protocol::frame::Frame;
use crate::protocol::message::{
    CommandMessage, FromRig, LeaseMessage, NmtCommand, RigState, StatusMessage, ToRig, WireMode, next_counter,
};

/// Period of the lease, ms.
const LEASE_PERIOD_MS: u64 = 10;
/// Commands are sent this far ahead, ms.
const AHEAD_MS: i64 = 200;
/// Commands sent per millisecond at most, so that the bus is not flooded while the queue fills.
const COMMANDS_PER_MS: usize = 4;
/// In real time, a wait goes on for this long after its limit, ms: the limit itself is judged in ticks.
const PATIENCE_MS: u64 = 3_000;
/// Transport of a frame in real time: adapters, drivers and pseudo-terminals, ms.
const TRANSPORT_MS: u64 = 50;

/// One frame of the rig.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Heard {
    /// Content of the frame, decoded.
    pub message: FromRig,
    /// Tick of the newest SAMPLE up to this frame; 0 before the first.
    pub tick: i64,
    /// Time of this computer at which it came, ms.
    pub at_ms: u64,
}

/// How time passes between two looks at the link.
pub(crate) enum ProbeClock {
    /// The rig is in this process: the function steps it by one tick.
    Virtual(Box<dyn FnMut()>),
    /// The function waits for about a millisecond and returns the time in ms.
    Real(Box<dyn FnMut() -> u64>),
}

/// Set point in counts at a tick, and whether it is the last one; `None` after the end.
pub(super) type SetPoints = Box<dyn Fn(i64) -> Option<(i32, bool)>>;

/// A host that checks a rig.
pub(crate) struct Probe {
    link: Link,
    clock: ProbeClock,
    now_ms: u64,
    longest_pause_ms: u64,
    pub(super) node: u8,
    pub(super) session: u8,
    /// A lease is sent every 10 ms, as soon as a sample was heard.
    pub(super) keeps_lease: bool,
    lease_sent_ms: u64,
    pub(super) lease_counter: u8,
    pub(super) command_counter: u8,
    pub(super) request_counter: u8,
    motion: Option<SetPoints>,
    sent_until: i64,
    newest_tick: Option<i64>,
    status: Option<StatusMessage>,
    /// All frames of the present row.
    pub(super) heard: Vec<Heard>,
    /// Place in `heard` from which the next expected frame is looked for: after the last one found, or the last one sent.
    looked_until: usize,
    /// Frames that are not what the document says, over the whole run.
    pub(super) undecodable: Vec<String>,
}

impl Probe {
    /// A host of the rig `node` behind `link`. `session` is its session number, 1 to 255.
    pub(crate) fn new(link: Link, clock: ProbeClock, node: u8, session: u8) -> Self {
        Probe {
            link,
            clock,
            now_ms: 0,
            longest_pause_ms: 0,
            node,
            session,
            keeps_lease: false,
            lease_sent_ms: 0,
            lease_counter: 0,
            command_counter: 0,
            request_counter: session % 15,
            motion: None,
            sent_until: 0,
            newest_tick: None,
            status: None,
            heard: Vec::new(),
            looked_until: 0,
            undecodable: Vec::new(),
        }
    }

    /// Forgets what the row before heard and streamed.
    pub(super) fn begin_row(&mut self) {
        self.heard.clear();
        self.looked_until = 0;
        self.motion = None;
        self.longest_pause_ms = 0;
    }

    /// Drops what came while a person was asked.
    pub(crate) fn catch_up(&mut self) {
        // One turn reads the clock: the first wait of the next row must not end before it began.
        self.turn();
        while self.link.receive().is_some() {}
        self.forget_ticks();
        self.begin_row();
        self.lease_sent_ms = self.now_ms;
    }

    /// Longest time that this computer did not look at the link during the row, ms; 1 in virtual time.
    pub(super) fn longest_pause_ms(&self) -> u64 {
        self.longest_pause_ms
    }

    /// What a time in ticks may exceed its limit by, ms: one turn in virtual time; the transport and this computer's own
    /// pauses in real time.
    pub(super) fn allowance_ms(&self) -> i64 {
        match self.clock {
            ProbeClock::Virtual(_) => 1,
            ProbeClock::Real(_) => (TRANSPORT_MS + self.longest_pause_ms) as i64,
        }
    }

    /// The newest STATUS.
    pub(super) fn status(&self) -> Option<StatusMessage> {
        self.status
    }

    /// Tick of the newest SAMPLE; 0 before the first.
    pub(super) fn tick(&self) -> i64 {
        self.newest_tick.unwrap_or(0)
    }

    /// The rig rebooted: its ticks start again.
    pub(super) fn forget_ticks(&mut self) {
        self.newest_tick = None;
        self.status = None;
    }

    /// Sends a message.
    pub(super) fn send(&mut self, message: ToRig) {
        self.send_frame(message.encode(self.node));
    }

    /// Sends a frame as it is.
    pub(super) fn send_frame(&mut self, frame: Frame) {
        self.looked_until = self.heard.len();
        self.link.send(frame);
        self.link.flush(link::now_ns());
    }

    /// Sends a network command to this rig.
    pub(super) fn network(&mut self, command: NmtCommand) {
        let node = self.node;
        self.send(ToRig::Nmt { command, node });
    }

    /// Sends one lease with the newest tick.
    pub(super) fn send_lease(&mut self) {
        self.lease_counter = next_counter(self.lease_counter);
        let lease = LeaseMessage {
            counter: self.lease_counter,
            session: self.session,
            control_tick: self.tick() as u16,
        };
        self.send(ToRig::Lease(lease));
    }

    /// Sends one command in displacement counts for `tick`.
    pub(super) fn send_command(&mut self, tick: i64, counts: i32, last: bool) {
        self.command_counter = next_counter(self.command_counter);
        let command = CommandMessage {
            counter: self.command_counter,
            session: self.session,
            tick: tick as u16,
            mode: WireMode::Displacement,
            counts,
            last,
        };
        self.send(ToRig::Command(command));
    }

    /// Streams `motion` from now on, the first command for `first_tick`.
    pub(super) fn stream(&mut self, first_tick: i64, motion: SetPoints) {
        self.sent_until = first_tick - 1;
        self.motion = Some(motion);
    }

    /// Ends the stream of commands without a last one.
    pub(super) fn cut_stream(&mut self) {
        self.motion = None;
    }

    /// The tick of the newest command that was streamed.
    pub(super) fn streamed_until(&self) -> i64 {
        self.sent_until
    }

    /// One turn: waits a millisecond, hears, and sends what is due.
    pub(super) fn turn(&mut self) {
        let before = self.now_ms;
        match &mut self.clock {
            ProbeClock::Virtual(step) => {
                step();
                self.now_ms += 1;
            }
            ProbeClock::Real(wait) => self.now_ms = wait(),
        }
        if before > 0 {
            self.longest_pause_ms = self.longest_pause_ms.max(self.now_ms.saturating_sub(before));
        }
        while let Some(frame) = self.link.receive() {
            self.hear(frame);
        }
        // What is sent by the way does not change from where an expected frame is looked for.
        let looked_until = self.looked_until;
        if self.keeps_lease
            && self.newest_tick.is_some()
            && self.now_ms >= self.lease_sent_ms + LEASE_PERIOD_MS
        {
            self.send_lease();
            self.lease_sent_ms = self.now_ms;
        }
        self.fill_queue();
        self.looked_until = looked_until;
        // What the port did not take before.
        self.link.flush(link::now_ns());
    }

    fn hear(&mut self, frame: Frame) {
        let message = match FromRig::decode(&frame, self.node) {
            Ok(message) => message,
            Err(error) => return self.undecodable.push(error.to_string()),
        };
        match message {
            FromRig::Sample(sample) => {
                let newest = self.newest_tick.unwrap_or(i64::from(sample.tick));
                let step = sample.tick.wrapping_sub(newest as u16) as i16;
                self.newest_tick = Some(newest + i64::from(step));
            }
            FromRig::Status(status) => self.status = Some(status),
            _ => {}
        }
        self.heard.push(Heard {
            message,
            tick: self.tick(),
            at_ms: self.now_ms,
        });
    }

    fn fill_queue(&mut self) {
        for _ in 0..COMMANDS_PER_MS {
            let Some(motion) = &self.motion else { return };
            let next = self.sent_until + 1;
            if next > self.tick() + AHEAD_MS {
                return;
            }
            match motion(next) {
                Some((counts, last)) => {
                    self.sent_until = next;
                    self.send_command(next, counts, last);
                }
                None => self.motion = None,
            }
        }
    }

    /// Lets `ms` milliseconds pass: of the rig's time if samples flow, else of this computer's.
    pub(super) fn pass(&mut self, ms: i64) {
        let (tick, now_ms) = (self.tick(), self.now_ms);
        let give_up_ms = now_ms + ms as u64 + self.patience_ms();
        loop {
            let flows = self.tick() != tick;
            let waited = self.now_ms - now_ms;
            let done = if flows {
                self.tick() - tick >= ms
            } else {
                waited as i64 >= ms
            };
            if done || self.now_ms >= give_up_ms {
                self.looked_until = self.heard.len();
                return;
            }
            self.turn();
        }
    }

    fn patience_ms(&self) -> u64 {
        match self.clock {
            ProbeClock::Virtual(_) => 2,
            ProbeClock::Real(_) => PATIENCE_MS,
        }
    }

    /// The next frame for which `is_it` holds, after the last one found or sent, which must come within `within_ms`. `what` names it in the error.
    pub(super) fn expect(
        &mut self,
        within_ms: i64,
        what: &str,
        mut is_it: impl FnMut(&FromRig) -> bool,
    ) -> Result<Heard, String> {
        let (start_tick, start_ms) = (self.tick(), self.now_ms);
        let give_up_ms = start_ms + within_ms as u64 + self.patience_ms();
        loop {
            while let Some(heard) = self.heard.get(self.looked_until).copied() {
                self.looked_until += 1;
                if !is_it(&heard.message) {
                    continue;
                }
                let took_ms = self.rig_time_ms(heard.tick - start_tick, heard.at_ms as i64 - start_ms as i64);
                if took_ms > within_ms + self.allowance_ms() {
                    return Err(format!(
                        "{what} came after {took_ms} ms, later than {within_ms} ms"
                    ));
                }
                return Ok(heard);
            }
            if self.now_ms >= give_up_ms {
                break;
            }
            self.turn();
        }
        Err(format!("no {what} within {within_ms} ms; {}", self.last_status()))
    }

    /// The rig's time in ms that a wait of `ticks` and of `waited_ms` of this computer took. Ticks stand still while no samples
    /// flow; then, in real time, the rig's time is not known and nothing is held against it.
    fn rig_time_ms(&self, ticks: i64, waited_ms: i64) -> i64 {
        match self.clock {
            ProbeClock::Virtual(_) => waited_ms,
            ProbeClock::Real(_) => ticks.min(waited_ms),
        }
    }

    /// The next STATUS for which `is_it` holds.
    pub(super) fn expect_status(
        &mut self,
        within_ms: i64,
        what: &str,
        is_it: impl Fn(&StatusMessage) -> bool,
    ) -> Result<(StatusMessage, i64), String> {
        let mut found = None;
        let heard = self.expect(within_ms, what, |message| match message {
            FromRig::Status(status) if is_it(status) => {
                found = Some(*status);
                true
            }
            _ => false,
        })?;
        found
            .map(|status| (status, heard.tick))
            .ok_or_else(|| format!("no {what}"))
    }

    /// Waits for a state.
    pub(super) fn expect_state(
        &mut self,
        within_ms: i64,
        state: RigState,
    ) -> Result<(StatusMessage, i64), String> {
        self.expect_status(within_ms, &format!("STATUS with state {state:?}"), |status| {
            status.state == state
        })
    }

    fn last_status(&self) -> String {
        match self.status {
            Some(status) => format!(
                "the newest STATUS says {:?}, cause {:?}, session {}, result {:?}",
                status.state, status.cause, status.session, status.ack_result
            ),
            None => "no STATUS was heard".to_owned(),
        }
    }

    /// Newest displacement and force in counts.
    pub(super) fn reading(&self) -> Option<(i32, i32)> {
        self.heard.iter().rev().find_map(|heard| match heard.message {
            FromRig::Sample(sample) => Some((sample.displacement_counts, sample.force_counts)),
            _ => None,
        })
    }

    /// STATUS frames heard since `from`, with their ticks.
    pub(super) fn statuses(&self, from: usize) -> impl Iterator<Item = (StatusMessage, i64)> + '_ {
        self.heard
            .iter()
            .skip(from)
            .filter_map(|heard| match heard.message {
                FromRig::Status(status) => Some((status, heard.tick)),
                _ => None,
            })
    }
}

/// Fails with what was found instead, if two things differ.
pub(super) fn same<T: PartialEq + std::fmt::Debug>(what: &str, found: T, expected: T) -> Result<(), String> {
    if found == expected {
        Ok(())
    } else {
        Err(format!("{what}: {found:?} instead of {expected:?}"))
    }
}
