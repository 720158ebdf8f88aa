//! Requests, configuration accesses, and the way to a rig at rest with an open session.

use super::probe::{Probe, same};
use crate::protocol::frame::Frame;
use crate::protocol::message::{
    Cause, ConfigAbort, FromRig, LIMIT_COUNT, Limits, NmtCommand, NmtState, RequestCode, RequestMessage,
    RequestResult, RigState, ToRig, next_counter, object,
};

/// An answer to a request or a configuration access comes within this time, ms.
pub(super) const ANSWER_MS: i64 = 20;
/// Longest unload, ms.
pub(super) const UNLOAD_MS: i64 = 61_000;
/// A network command is followed by its heartbeat within its period, ms.
const HEARTBEAT_MS: i64 = 110;

/// What is at the other end of the link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Reach {
    /// No frame of this node came.
    Nothing,
    /// A session of another host owns the rig; its number.
    Owned(u8),
    /// A rig that no session owns.
    Free,
}

/// Time for a rig to answer at all, ms.
const REACH_MS: i64 = 2_000;

impl Probe {
    /// Starts the rig and looks whether it answers, and whom it belongs to.
    pub(crate) fn reach(&mut self) -> Reach {
        self.network(NmtCommand::Start);
        match self.expect_status(REACH_MS, "STATUS after NMT start", |_| true) {
            Ok((status, _)) if status.session != 0 => Reach::Owned(status.session),
            Ok(_) => Reach::Free,
            Err(_) if self.heard.is_empty() => Reach::Nothing,
            // It answers, but not as described: the rows say what is wrong.
            Err(_) => Reach::Free,
        }
    }

    /// A request with the next counter, not sent yet.
    pub(super) fn next_request(&mut self, session: u8, code: RequestCode, argument: u32) -> RequestMessage {
        self.request_counter = next_counter(self.request_counter);
        RequestMessage {
            counter: self.request_counter,
            session,
            code,
            argument,
        }
    }

    /// Sends a request of this session and waits for its result.
    pub(super) fn request(&mut self, code: RequestCode, argument: u32) -> Result<RequestResult, String> {
        let message = self.next_request(self.session, code, argument);
        self.ask(message)
    }

    /// Sends a request and waits for its result.
    pub(super) fn ask(&mut self, message: RequestMessage) -> Result<RequestResult, String> {
        self.send(ToRig::Request(message));
        let what = format!("answer to {:?} (counter {})", message.code, message.counter);
        let (status, _) =
            self.expect_status(ANSWER_MS, &what, |status| status.ack_counter == message.counter)?;
        Ok(status.ack_result)
    }

    /// Sends a request without waiting for its result.
    pub(super) fn send_request(&mut self, code: RequestCode) {
        let message = self.next_request(self.session, code, 0);
        self.send(ToRig::Request(message));
    }

    /// Sends a request whose result must be `expected`.
    pub(super) fn must(
        &mut self,
        code: RequestCode,
        argument: u32,
        expected: RequestResult,
    ) -> Result<(), String> {
        let result = self.request(code, argument)?;
        same(&format!("result of {code:?}"), result, expected)
    }

    /// Sends a configuration request as a frame and waits for the answer to the same object.
    pub(super) fn access_frame(&mut self, frame: Frame, index: u16, sub: u8) -> Result<FromRig, String> {
        self.send_frame(frame);
        let what = format!("answer for object {index:#06x}:{sub}");
        let heard = self.expect(ANSWER_MS, &what, |message| match *message {
            FromRig::ConfigValue { index: i, sub: s, .. }
            | FromRig::ConfigWritten { index: i, sub: s }
            | FromRig::ConfigRefused { index: i, sub: s, .. } => (i, s) == (index, sub),
            _ => false,
        })?;
        Ok(heard.message)
    }

    /// Reads an object; a refusal is the inner error.
    pub(super) fn try_read(&mut self, (index, sub): (u16, u8)) -> Result<Result<u32, ConfigAbort>, String> {
        let frame = ToRig::ConfigRead { index, sub }.encode(self.node);
        match self.access_frame(frame, index, sub)? {
            FromRig::ConfigValue { value, .. } => Ok(Ok(value)),
            FromRig::ConfigRefused { abort, .. } => Ok(Err(abort)),
            other => Err(format!(
                "a read of {index:#06x}:{sub} was answered with {other:?}"
            )),
        }
    }

    /// Reads an object that must be there.
    pub(super) fn read(&mut self, object: (u16, u8)) -> Result<u32, String> {
        self.try_read(object)?
            .map_err(|abort| format!("object {:#06x}:{} was refused ({abort:?})", object.0, object.1))
    }

    /// Writes an object; a refusal is the inner error.
    pub(super) fn try_write(
        &mut self,
        object: (u16, u8),
        value: u32,
    ) -> Result<Result<(), ConfigAbort>, String> {
        let (index, sub) = object;
        let frame = ToRig::ConfigWrite { index, sub, value }.encode(self.node);
        match self.access_frame(frame, index, sub)? {
            FromRig::ConfigWritten { .. } => Ok(Ok(())),
            FromRig::ConfigRefused { abort, .. } => Ok(Err(abort)),
            other => Err(format!(
                "a write of {index:#06x}:{sub} was answered with {other:?}"
            )),
        }
    }

    /// Writes all limits.
    pub(super) fn write_limits(&mut self, limits: &Limits) -> Result<(), String> {
        for (i, value) in limits.to_array().into_iter().enumerate().take(LIMIT_COUNT) {
            let sub = i as u8 + 1;
            self.try_write((object::LIMITS, sub), value as u32)?
                .map_err(|abort| format!("limit {sub} = {value} was refused ({abort:?})"))?;
        }
        Ok(())
    }

    /// Sends NMT start and waits until STATUS and HEARTBEAT say that it was taken.
    pub(super) fn start(&mut self) -> Result<(), String> {
        self.network(NmtCommand::Start);
        self.expect_status(ANSWER_MS, "STATUS after NMT start", |_| true)?;
        self.expect_heartbeat(NmtState::Operational)
    }

    /// Waits for a heartbeat with `state`.
    pub(super) fn expect_heartbeat(&mut self, state: NmtState) -> Result<(), String> {
        let what = format!("HEARTBEAT with state {state:?}");
        self.expect(HEARTBEAT_MS, &what, |message| {
            *message == FromRig::Heartbeat { state }
        })
        .map(|_| ())
    }

    /// Opens this session and keeps its lease.
    pub(super) fn open_session(&mut self) -> Result<(), String> {
        self.must(RequestCode::OpenSession, 0, RequestResult::Done)?;
        self.keeps_lease = true;
        Ok(())
    }

    /// Sends requests of another session, which the rig must refuse as busy.
    pub(super) fn others_are_refused(&mut self, codes: [RequestCode; 3]) -> Result<(), String> {
        let other = self.session % 255 + 1;
        for code in codes {
            let message = self.next_request(other, code, 0);
            let result = self.ask(message)?;
            same(
                &format!("{code:?} of another session"),
                result,
                RequestResult::Busy,
            )?;
        }
        Ok(())
    }

    /// Brings the rig to rest: started, session open, state off, no cause.
    pub(super) fn rest(&mut self) -> Result<(), String> {
        self.network(NmtCommand::Start);
        self.expect_status(ANSWER_MS, "STATUS after NMT start", |_| true)?;
        self.open_session()?;
        let state = self.status().map(|status| status.state);
        if state != Some(RigState::Tripped) && state != Some(RigState::Off) {
            self.must(RequestCode::Unload, 0, RequestResult::Done)?;
            self.expect_status(UNLOAD_MS, "end of the unload", |status| {
                matches!(status.state, RigState::Off | RigState::Tripped)
            })?;
        }
        if self
            .status()
            .is_some_and(|status| status.state == RigState::Tripped)
        {
            self.must(RequestCode::Reset, 0, RequestResult::Done)?;
        }
        let (state, cause) = self.now()?;
        same(
            "state and cause at rest",
            (state, cause),
            (RigState::Off, Cause::None),
        )
    }

    /// State and cause in the newest STATUS.
    pub(super) fn now(&self) -> Result<(RigState, Cause), String> {
        let status = self.status().ok_or("no STATUS was heard")?;
        Ok((status.state, status.cause))
    }

    /// Stops the lease and waits until the rig says that no session owns it.
    pub(super) fn let_session_lapse(&mut self, within_ms: i64) -> Result<(), String> {
        self.keeps_lease = false;
        self.expect_status(within_ms, "STATUS with session 0", |status| status.session == 0)?;
        Ok(())
    }
}
