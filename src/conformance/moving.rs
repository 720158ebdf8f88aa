//! Arming with tight limits around the present position, and moves of a fraction of a millimetre.

use super::asking::UNLOAD_MS;
use super::probe::{Probe, same};
use crate::protocol::message::{
    COUNTS_INVALID, COUNTS_MAX, Cause, FromRig, Limits, RequestCode, RequestResult, RigState,
};

/// Height of the moves in displacement counts: 0.25 mm.
pub(super) const MOVE_COUNTS: i32 = 500;
/// Time of such a move, ms.
pub(super) const MOVE_MS: i64 = 250;
/// Travel that the limits allow on each side, counts: 1 mm.
const TRAVEL_COUNTS: i32 = 2_000;
/// Force that the limits allow on each side, counts: 200 N.
const FORCE_COUNTS: i32 = 2_000;
/// Time in which the pressure builds up and the position settles after arm, ms.
const SETTLE_MS: i64 = 500;
/// First command of a motion after it was begun, ms.
const LEAD_MS: i64 = 100;
/// The largest lease, ms: this computer may be slow.
const LONG_LEASE_MS: i32 = 500;

impl Probe {
    /// Limits of 1 mm and 200 N around the present position. The unload ends at the present position.
    pub(super) fn tight_limits(&mut self) -> Result<Limits, String> {
        self.pass(20);
        let (displacement, force) = self.reading().ok_or("no SAMPLE was heard")?;
        if displacement == COUNTS_INVALID || force == COUNTS_INVALID {
            return Err("a sensor has no valid reading: connect it first".to_owned());
        }
        let within = |counts: i32| counts.clamp(-COUNTS_MAX, COUNTS_MAX);
        Ok(Limits {
            force_max_counts: within(force + FORCE_COUNTS),
            force_min_counts: within(force - FORCE_COUNTS),
            displacement_max_counts: within(displacement + TRAVEL_COUNTS),
            displacement_min_counts: within(displacement - TRAVEL_COUNTS),
            velocity_max_counts_s: 100_000,
            following_error_displacement_counts: 1_000,
            following_error_force_counts: 2_000,
            lease_ms: LONG_LEASE_MS,
            hold_timeout_ms: 30_000,
            unload_velocity_counts_s: 10_000,
            queue_low_ms: 30,
            // The ramp ends by the displacement, whatever the specimen.
            unloaded_force_counts: within(force - FORCE_COUNTS / 2),
            retract_counts: displacement,
        })
    }

    /// Arms at the present position with tight limits that `change` may alter. Returns the position in counts.
    pub(super) fn arm(&mut self, change: impl FnOnce(&mut Limits)) -> Result<i32, String> {
        self.rest()?;
        let mut limits = self.tight_limits()?;
        let at = limits.retract_counts;
        change(&mut limits);
        self.write_limits(&limits)?;
        self.must(RequestCode::Arm, limits.crc32(), RequestResult::Done)?;
        self.pass(SETTLE_MS);
        let now = self.now()?;
        same("state and cause after arm", now, (RigState::Armed, Cause::None))?;
        Ok(at)
    }

    /// Arms and moves up by 0.25 mm; the rig is armed there. Returns the position before the move.
    pub(super) fn arm_up(&mut self, change: impl FnOnce(&mut Limits)) -> Result<i32, String> {
        let at = self.arm(change)?;
        self.ramp(at, at + MOVE_COUNTS, true);
        self.expect_state(LEAD_MS + ANSWER, RigState::Running)?;
        self.expect_state(MOVE_MS + ANSWER, RigState::Armed)?;
        Ok(at)
    }

    /// Streams a ramp; with `ends` its last command is marked, else it stays at the end level.
    pub(super) fn ramp(&mut self, from: i32, to: i32, ends: bool) -> i64 {
        let first = self.tick() + LEAD_MS;
        let motion = move |tick: i64| {
            let passed = (tick - first).min(MOVE_MS);
            let counts = from + ((to - from) as i64 * passed / MOVE_MS) as i32;
            (!ends || tick - first <= MOVE_MS).then_some((counts, ends && passed == MOVE_MS))
        };
        self.stream(first, Box::new(motion));
        first
    }

    /// Waits until an unload has ended in `state`.
    pub(super) fn expect_end(&mut self, state: RigState) -> Result<(), String> {
        self.expect_state(UNLOAD_MS, state).map(|_| ())
    }

    /// Causes of the EMERGENCY frames of this row, without "cleared".
    pub(super) fn emergencies(&self) -> Vec<(Cause, RigState)> {
        self.heard
            .iter()
            .filter_map(|heard| match heard.message {
                FromRig::Emergency(emergency) if emergency.code != 0 => {
                    Some((emergency.cause, emergency.state))
                }
                _ => None,
            })
            .collect()
    }
}

/// Turns between a state and its STATUS, ms.
const ANSWER: i64 = 20;
