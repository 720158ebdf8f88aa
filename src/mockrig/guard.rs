//! The firmware's own detectors: what it sees each tick that must not go on, and how it is to react.
//! The reaction is carried out in `firmware`.

use crate::protocol::message::{
    COUNTS_INVALID, Cause, DISPLACEMENT_MM_PER_COUNT, FORCE_N_PER_COUNT, Limits, WireMode,
};

/// What the firmware does about a fault, mildest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Reaction {
    /// S1: decelerate and keep the position.
    Hold,
    /// S2: ramp to zero load, then latched.
    Unload,
    /// S3: valve closed and pump off at once, latched.
    Off,
}

/// What the firmware reads in one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SensorReading {
    /// Load cell, or `COUNTS_INVALID`.
    pub force_counts: i32,
    /// LVDT, or `COUNTS_INVALID`.
    pub displacement_counts: i32,
    /// Supply pressure as a share of its rating.
    pub supply_ratio: f64,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
}

/// What the loop was to do in this tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Following {
    /// Channel under control.
    pub mode: WireMode,
    /// Set point less feedback, counts.
    pub error_counts: f64,
    /// Rate of the set point, counts a second.
    pub rate_counts_s: f64,
    /// Speed that the loop asked the valve for, mm/s.
    pub speed_mm_s: f64,
    /// Ticks since the pressure came on.
    pub pressure_ticks: u64,
}

/// Ticks in a row for a limit: one spike does not trip, two samples do (2 ms).
const LIMIT_TICKS: u32 = 2;
/// Ticks in a row for the velocity: a spike of one sample is fast twice, there and back.
const VELOCITY_TICKS: u32 = 3;
/// Ticks in a row for the following error.
const FOLLOWING_TICKS: u32 = 20;
/// Share of the speed that is added to the following error's limit, s: 2 %.
const FOLLOWING_SPEED_S: f64 = 0.02;
/// Equal LVDT readings in a row that mean a dead channel, where the loop asked for motion meanwhile.
const STUCK_TICKS: u32 = 20;
/// Travel that the loop must have asked for, mm.
const STUCK_TRAVEL_MM: f64 = 0.5;
/// Supply pressure below this share of its rating counts as lost.
const SUPPLY_RATIO_MIN: f64 = 0.8;
/// Ticks in a row for the supply.
const SUPPLY_TICKS: u32 = 5;
/// The pump has this long to build up pressure, ticks.
const SUPPLY_GRACE_TICKS: u64 = 300;
/// The window of the break detector, ticks.
const BREAK_TICKS: usize = 10;
/// A fall smaller than this is no break, N.
const BREAK_FALL_N: f64 = 200.0;
/// Stiffer than any specimen, N/mm: a fall that the pusher's own retreat can explain is no break.
const BREAK_RATE_N_PER_MM: f64 = 1000.0;

/// The detectors with what they remember.
#[derive(Debug, Clone, Default)]
pub(crate) struct SafetyGuard {
    force_bad: u32,
    displacement_bad: u32,
    force_over: u32,
    displacement_over: u32,
    velocity_over: i32,
    following_over: u32,
    stuck: u32,
    stuck_travel_mm: f64,
    supply_low: u32,
    last_force: i32,
    last_displacement: i32,
    velocity_counts_s: f64,
    history: [[i32; 2]; BREAK_TICKS + 2],
    ticks: usize,
}

impl SafetyGuard {
    /// Pressure comes on: counts start anew, the last readings stay.
    pub(crate) fn restart(&mut self) {
        *self = SafetyGuard {
            last_force: self.last_force,
            last_displacement: self.last_displacement,
            ..SafetyGuard::default()
        };
    }

    /// The last valid load-cell reading, counts.
    pub(crate) fn force_counts(&self) -> i32 {
        self.last_force
    }

    /// The last valid LVDT reading, counts.
    pub(crate) fn displacement_counts(&self) -> i32 {
        self.last_displacement
    }

    /// Speed of the LVDT, smoothed over some 5 ms, counts a second.
    pub(crate) fn velocity_counts_s(&self) -> f64 {
        self.velocity_counts_s
    }

    /// True while the load cell gives no reading.
    pub(crate) fn force_invalid(&self) -> bool {
        self.force_bad > 0
    }

    /// True while a sensor gives no reading.
    pub(crate) fn sensors_bad(&self) -> bool {
        self.force_bad > 0 || self.displacement_bad > 0
    }

    /// Takes the reading in, pressure on or not.
    pub(crate) fn observe(&mut self, reading: &SensorReading) {
        count(&mut self.force_bad, reading.force_counts == COUNTS_INVALID);
        count(
            &mut self.displacement_bad,
            reading.displacement_counts == COUNTS_INVALID,
        );
        if self.force_bad == 0 {
            self.last_force = reading.force_counts;
        }
        let before = self.last_displacement;
        if self.displacement_bad == 0 {
            self.last_displacement = reading.displacement_counts;
        }
        let velocity = f64::from(self.last_displacement - before) * 1000.0;
        self.velocity_counts_s += 0.2 * (velocity - self.velocity_counts_s);
        self.ticks += 1;
        let place = self.ticks % self.history.len();
        if let Some(slot) = self.history.get_mut(place) {
            *slot = [self.last_force, self.last_displacement];
        }
        count(
            &mut self.stuck,
            self.last_displacement == before && self.displacement_bad == 0,
        );
    }

    /// The worst thing there is in the reading just observed; called while the pressure is on.
    pub(crate) fn check(
        &mut self,
        reading: &SensorReading,
        limits: &Limits,
        following: &Following,
    ) -> Option<(Cause, Reaction)> {
        // All detectors run each tick, so that none misses a count because another spoke.
        let verdicts = [
            reading
                .emergency_stop
                .then_some((Cause::EmergencyStop, Reaction::Off)),
            self.supply(reading, following),
            (self.displacement_bad >= LIMIT_TICKS).then_some((Cause::DisplacementSensor, Reaction::Off)),
            self.stuck(following),
            self.displacement_limit(limits),
            self.specimen_break(),
            (self.force_bad >= LIMIT_TICKS).then_some((Cause::ForceSensor, Reaction::Unload)),
            self.force_limit(limits),
            self.velocity_limit(limits),
            self.following_error(limits, following),
        ];
        verdicts.into_iter().flatten().next()
    }

    fn supply(&mut self, reading: &SensorReading, following: &Following) -> Option<(Cause, Reaction)> {
        let built_up = following.pressure_ticks > SUPPLY_GRACE_TICKS;
        count(
            &mut self.supply_low,
            built_up && reading.supply_ratio < SUPPLY_RATIO_MIN,
        );
        (self.supply_low >= SUPPLY_TICKS).then_some((Cause::SupplyPressure, Reaction::Off))
    }

    fn stuck(&mut self, following: &Following) -> Option<(Cause, Reaction)> {
        if self.stuck == 0 {
            self.stuck_travel_mm = 0.0;
        }
        self.stuck_travel_mm += following.speed_mm_s * 1e-3;
        let dead = self.stuck >= STUCK_TICKS && self.stuck_travel_mm.abs() > STUCK_TRAVEL_MM;
        dead.then_some((Cause::SensorStuck, Reaction::Off))
    }

    fn displacement_limit(&mut self, limits: &Limits) -> Option<(Cause, Reaction)> {
        let x = self.last_displacement;
        let over = x > limits.displacement_max_counts || x < limits.displacement_min_counts;
        count(&mut self.displacement_over, over);
        (self.displacement_over >= LIMIT_TICKS).then_some((Cause::DisplacementLimit, Reaction::Off))
    }

    fn force_limit(&mut self, limits: &Limits) -> Option<(Cause, Reaction)> {
        let over = self.last_force > limits.force_max_counts || self.last_force < limits.force_min_counts;
        count(&mut self.force_over, over);
        (self.force_over >= LIMIT_TICKS).then_some((Cause::ForceLimit, Reaction::Unload))
    }

    fn velocity_limit(&mut self, limits: &Limits) -> Option<(Cause, Reaction)> {
        let step = self.at(0)[1] - self.at(1)[1];
        let limit = i64::from(limits.velocity_max_counts_s);
        let fast = i64::from(step.abs()) * 1000 > limit;
        // Counts up while fast in one direction, down in the other.
        self.velocity_over = match (fast, step > 0) {
            (false, _) => 0,
            (true, true) => self.velocity_over.max(0) + 1,
            (true, false) => self.velocity_over.min(0) - 1,
        };
        (self.velocity_over.unsigned_abs() >= VELOCITY_TICKS)
            .then_some((Cause::VelocityLimit, Reaction::Unload))
    }

    fn following_error(&mut self, limits: &Limits, following: &Following) -> Option<(Cause, Reaction)> {
        let limit = f64::from(match following.mode {
            WireMode::Displacement => limits.following_error_displacement_counts,
            WireMode::Force => limits.following_error_force_counts,
        });
        let limit = limit + FOLLOWING_SPEED_S * following.rate_counts_s.abs();
        count(&mut self.following_over, following.error_counts.abs() > limit);
        (self.following_over >= FOLLOWING_TICKS).then_some((Cause::FollowingError, Reaction::Unload))
    }

    /// Force falls by more than half, and by more than the pusher's retreat explains. Two samples on each side, so that
    /// a spike is no break.
    fn specimen_break(&self) -> Option<(Cause, Reaction)> {
        if self.ticks < self.history.len() || self.force_bad > 0 {
            return None;
        }
        let before = f64::from(self.at(BREAK_TICKS)[0].min(self.at(BREAK_TICKS + 1)[0])) * FORCE_N_PER_COUNT;
        let now = f64::from(self.at(0)[0].max(self.at(1)[0])) * FORCE_N_PER_COUNT;
        let retreat = f64::from(self.at(BREAK_TICKS + 1)[1] - self.at(0)[1]) * DISPLACEMENT_MM_PER_COUNT;
        let fall = before - now;
        let broken = fall > 0.5 * before && fall > BREAK_FALL_N && fall > BREAK_RATE_N_PER_MM * retreat;
        broken.then_some((Cause::SpecimenBreak, Reaction::Off))
    }

    /// Force and displacement `ago` ticks before now.
    fn at(&self, ago: usize) -> [i32; 2] {
        let len = self.history.len();
        let place = (self.ticks + len - ago % len) % len;
        self.history.get(place).copied().unwrap_or_default()
    }
}

/// Counts ticks in a row.
fn count(counter: &mut u32, on: bool) {
    *counter = if on { counter.saturating_add(1) } else { 0 };
}
