//! The firmware's detectors: the faults of each tick and the reaction to each. `firmware` carries the reactions out.

use crate::detector;
use crate::protocol::message::{
    COUNTS_INVALID, Cause, DISPLACEMENT_MM_PER_COUNT, FORCE_N_PER_COUNT, Limits, SAMPLE_RATE_HZ, WireMode,
};
use crate::protocol::tick::{TICK_S, TICKS_PER_S, ticks_in_ms};

/// Reaction to a fault, mildest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Reaction {
    /// S1: decelerate and keep the position.
    Hold,
    /// S2: ramp to zero load, then Tripped.
    Unload,
    /// S3: valve closed and pump off at once, Tripped.
    Off,
}

/// The inputs of the firmware in one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SensorReading {
    /// Load cell in counts, or `COUNTS_INVALID`.
    pub force_counts: i32,
    /// LVDT in counts, or `COUNTS_INVALID`.
    pub displacement_counts: i32,
    /// Supply pressure as a fraction of its rating.
    pub supply_ratio: f64,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
}

/// State of the servo loop in this tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Following {
    /// Channel under control.
    pub mode: WireMode,
    /// Set point minus feedback, counts.
    pub error_counts: f64,
    /// Rate of the set point, counts per second.
    pub rate_counts_s: f64,
    /// Speed that the loop demanded of the valve, mm/s.
    pub speed_mm_s: f64,
    /// Ticks since the pressure was switched on.
    pub pressure_ticks: u64,
    /// The set point rests, because the rig holds.
    pub holds: bool,
}

/// Samples in a row beyond a limit that trip; one spike does not.
const LIMIT_SAMPLES: u64 = 2;
/// Samples in a row for the velocity: a spike of one sample is fast twice, forth and back.
const VELOCITY_SAMPLES: u64 = 3;
/// Ticks in a row for the following error: 20 ms.
const FOLLOWING_TICKS: u64 = ticks_in_ms(20);
/// The limit of the following error grows by the set point's travel in this time, s.
const FOLLOWING_SPEED_S: f64 = 0.02;
/// Error of the position during a hold that is creep, mm (fault H8).
const CREEP_MM: f64 = 0.2;
/// Ticks in a row for the creep: 100 ms, longer than the piston swings after its brake.
const CREEP_TICKS: u64 = ticks_in_ms(100);
/// Equal LVDT readings in a row that mean a stuck channel if the loop demanded motion meanwhile: 20 ms.
const STUCK_TICKS: u64 = ticks_in_ms(20);
/// Travel that the loop must have demanded meanwhile, mm.
const STUCK_TRAVEL_MM: f64 = 0.5;
/// Supply pressure below this fraction of its rating counts as lost.
const SUPPLY_RATIO_MIN: f64 = 0.8;
/// Ticks in a row for the supply: 5 ms.
const SUPPLY_TICKS: u64 = ticks_in_ms(5);
/// Time for the pump to build up pressure: 300 ms.
const SUPPLY_GRACE_TICKS: u64 = ticks_in_ms(300);
/// Window of the break detector: 10 ms.
const BREAK_TICKS: usize = ticks_in_ms(10) as usize;
/// A smaller fall of the force is no break, N.
const BREAK_FALL_N: f64 = 200.0;
/// Stiffer than any specimen, N/mm: a fall that the retreat of the pusher explains is no break.
const BREAK_RATE_N_PER_MM: f64 = 1000.0;

/// The detectors with their counts of ticks in a row.
#[derive(Debug, Clone, Default)]
pub(crate) struct SafetyGuard {
    force_bad: u64,
    displacement_bad: u64,
    force_over: u64,
    displacement_over: u64,
    /// Positive for too fast a loading, negative for too fast an unloading.
    velocity_over: i64,
    following_over: u64,
    creep: u64,
    stuck: u64,
    stuck_travel_mm: f64,
    supply_low: u64,
    last_force: i32,
    last_displacement: i32,
    velocity_counts_s: f64,
    /// Force and displacement of the newest ticks in counts, a ring.
    history: [[i32; 2]; BREAK_TICKS + 2],
    ticks: usize,
}

impl SafetyGuard {
    /// Resets all counts when the pressure is switched on; the last readings stay.
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

    /// Speed of the LVDT, smoothed over about 5 ms, counts per second.
    pub(crate) fn velocity_counts_s(&self) -> f64 {
        self.velocity_counts_s
    }

    /// True while the load cell has no reading.
    pub(crate) fn force_invalid(&self) -> bool {
        self.force_bad > 0
    }

    /// True while a sensor has no reading.
    pub(crate) fn sensors_bad(&self) -> bool {
        self.force_bad > 0 || self.displacement_bad > 0
    }

    /// Takes a reading, with pressure on or off.
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
        let velocity = f64::from(self.last_displacement - before) * TICKS_PER_S;
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

    /// The most severe fault in the reading just observed; called while the pressure is on.
    pub(crate) fn check(
        &mut self,
        reading: &SensorReading,
        limits: &Limits,
        following: &Following,
    ) -> Option<(Cause, Reaction)> {
        // All detectors run in each tick, also after one of them has found a fault, so that their counts are complete.
        let faults = [
            reading
                .emergency_stop
                .then_some((Cause::EmergencyStop, Reaction::Off))
                .filter(|_| detector::acts("H7")),
            self.supply(reading, following),
            (self.displacement_bad >= LIMIT_SAMPLES && detector::acts("X2"))
                .then_some((Cause::DisplacementSensor, Reaction::Off)),
            self.stuck(following),
            self.displacement_limit(limits),
            self.specimen_break(),
            (self.force_bad >= LIMIT_SAMPLES && detector::acts("X1"))
                .then_some((Cause::ForceSensor, Reaction::Unload)),
            self.force_limit(limits),
            self.velocity_limit(limits),
            self.following_error(limits, following),
            self.creep(following),
        ];
        faults.into_iter().flatten().next()
    }

    fn supply(&mut self, reading: &SensorReading, following: &Following) -> Option<(Cause, Reaction)> {
        let built_up = following.pressure_ticks > SUPPLY_GRACE_TICKS;
        count(
            &mut self.supply_low,
            built_up && reading.supply_ratio < SUPPLY_RATIO_MIN,
        );
        (self.supply_low >= SUPPLY_TICKS && detector::acts("H6"))
            .then_some((Cause::SupplyPressure, Reaction::Off))
    }

    fn stuck(&mut self, following: &Following) -> Option<(Cause, Reaction)> {
        // The speed was asked for in the tick before: it belongs to the step that this sample ends.
        if self.stuck == 0 {
            self.stuck_travel_mm = 0.0;
        } else {
            self.stuck_travel_mm += following.speed_mm_s * TICK_S;
        }
        let is_stuck = self.stuck >= STUCK_TICKS && self.stuck_travel_mm.abs() > STUCK_TRAVEL_MM;
        (is_stuck && detector::acts("X3")).then_some((Cause::SensorStuck, Reaction::Off))
    }

    fn displacement_limit(&mut self, limits: &Limits) -> Option<(Cause, Reaction)> {
        let x = self.last_displacement;
        let over = x > limits.displacement_max_counts || x < limits.displacement_min_counts;
        count(&mut self.displacement_over, over);
        (self.displacement_over >= LIMIT_SAMPLES && detector::acts("H3"))
            .then_some((Cause::DisplacementLimit, Reaction::Off))
    }

    fn force_limit(&mut self, limits: &Limits) -> Option<(Cause, Reaction)> {
        let over = self.last_force > limits.force_max_counts || self.last_force < limits.force_min_counts;
        count(&mut self.force_over, over);
        (self.force_over >= LIMIT_SAMPLES && detector::acts("H2"))
            .then_some((Cause::ForceLimit, Reaction::Unload))
    }

    fn velocity_limit(&mut self, limits: &Limits) -> Option<(Cause, Reaction)> {
        let step = self.at(0)[1] - self.at(1)[1];
        let limit = i64::from(limits.velocity_max_counts_s);
        let fast = i64::from(step.abs()) * i64::from(SAMPLE_RATE_HZ) > limit;
        // Counts up while fast in one direction, down in the other.
        self.velocity_over = match (fast, step > 0) {
            (false, _) => 0,
            (true, true) => self.velocity_over.max(0) + 1,
            (true, false) => self.velocity_over.min(0) - 1,
        };
        (self.velocity_over.unsigned_abs() >= VELOCITY_SAMPLES)
            .then_some((Cause::VelocityLimit, Reaction::Unload))
    }

    fn following_error(&mut self, limits: &Limits, following: &Following) -> Option<(Cause, Reaction)> {
        let limit = f64::from(match following.mode {
            WireMode::Displacement => limits.following_error_displacement_counts,
            WireMode::Force => limits.following_error_force_counts,
        });
        let limit = limit + FOLLOWING_SPEED_S * following.rate_counts_s.abs();
        count(&mut self.following_over, following.error_counts.abs() > limit);
        (self.following_over >= FOLLOWING_TICKS && detector::acts("H1"))
            .then_some((Cause::FollowingError, Reaction::Unload))
    }

    /// The piston does not stay where the hold has put it.
    fn creep(&mut self, following: &Following) -> Option<(Cause, Reaction)> {
        let error_mm = following.error_counts.abs() * DISPLACEMENT_MM_PER_COUNT;
        count(&mut self.creep, following.holds && error_mm > CREEP_MM);
        (self.creep >= CREEP_TICKS && detector::acts("H8"))
            .then_some((Cause::FollowingError, Reaction::Unload))
    }

    /// Detects a fall of the force by more than half, and by more than the retreat of the pusher explains. Two samples on
    /// each side, so that a spike is no break.
    fn specimen_break(&self) -> Option<(Cause, Reaction)> {
        if self.ticks < self.history.len() || self.force_bad > 0 {
            return None;
        }
        let before = f64::from(self.at(BREAK_TICKS)[0].min(self.at(BREAK_TICKS + 1)[0])) * FORCE_N_PER_COUNT;
        let now = f64::from(self.at(0)[0].max(self.at(1)[0])) * FORCE_N_PER_COUNT;
        let retreat = f64::from(self.at(BREAK_TICKS + 1)[1] - self.at(0)[1]) * DISPLACEMENT_MM_PER_COUNT;
        let fall = before - now;
        let broken = fall > 0.5 * before && fall > BREAK_FALL_N && fall > BREAK_RATE_N_PER_MM * retreat;
        (broken && detector::acts("H4")).then_some((Cause::SpecimenBreak, Reaction::Off))
    }

    /// Force and displacement `ago` ticks before now.
    fn at(&self, ago: usize) -> [i32; 2] {
        let len = self.history.len();
        let place = (self.ticks + len - ago % len) % len;
        self.history.get(place).copied().unwrap_or_default()
    }
}

/// Counts ticks in a row; resets where `on` is false.
fn count(counter: &mut u64, on: bool) {
    *counter = if on { counter.saturating_add(1) } else { 0 };
}
