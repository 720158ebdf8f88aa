//! The load frame's hydraulics: servo valve, oil column, piston. Sized like a 25 kN, 100 mm dynamic frame.
//!
//! ```text
//! valve   spool'' = w^2 (u - spool) - 2 D w spool', |spool| <= 1, rate-limited        u: command, -1 to 1
//! flow    Q = Q0 * spool * sqrt((p_s - p_L sgn spool) / p_s)                          Merritt 1967, eq. 5-32
//! oil     (V / 4 E) dp_L/dt = Q - A v - C p_L
//! piston  m dv/dt = A p_L - F_specimen - (b + F_c / (|v| + v_0)) v
//! ```
//! Units: N, mm, s, MPa; the mass in tonnes, so that N = t mm/s2. p_L load pressure, A piston area, V trapped volume,
//! E bulk modulus, C leakage. The servo loop is in `servo`; the specimen is a `Plant`.

use serde::{Deserialize, Serialize};

use super::sensors::TwoPole;
use super::{OutOfRange, first_out_of_range};
use crate::protocol::tick::TICK_S;

/// Sizes of the load frame's hydraulics; the table `[mock_rig.actuator]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct ActuatorConfig {
    /// Effective piston area in mm2: 25 kN at 20 MPa.
    pub piston_area_mm2: f64,
    /// Supply pressure minus return pressure in MPa.
    pub supply_mpa: f64,
    /// Oil trapped in both chambers and lines in mm3.
    pub oil_volume_mm3: f64,
    /// Bulk modulus of the oil with its air content in MPa.
    pub bulk_modulus_mpa: f64,
    /// Cross-port leakage in mm3/s per MPa.
    pub leakage_mm3_s_per_mpa: f64,
    /// Piston, pusher and load cell in kg.
    pub moving_mass_kg: f64,
    /// Seal friction in N.
    pub seal_friction_n: f64,
    /// Viscous friction in N s/mm.
    pub viscous_n_s_per_mm: f64,
    /// Speed at full spool without load in mm/s.
    pub full_speed_mm_s: f64,
    /// Natural frequency of the valve in Hz.
    pub valve_hz: f64,
    /// Damping ratio of the valve, below 1.
    pub valve_damping: f64,
    /// Time from closed to full spool in ms.
    pub valve_full_stroke_ms: f64,
    /// Half of the stroke in mm: the piston hits its cushion at plus and minus this.
    pub half_stroke_mm: f64,
}

impl Default for ActuatorConfig {
    fn default() -> Self {
        ActuatorConfig {
            piston_area_mm2: 1250.0,
            supply_mpa: 20.0,
            oil_volume_mm3: 150_000.0,
            bulk_modulus_mpa: 1000.0,
            leakage_mm3_s_per_mpa: 30.0,
            moving_mass_kg: 25.0,
            seal_friction_n: 30.0,
            viscous_n_s_per_mm: 2.0,
            // 10 % less than the servo assumes, because rated valve flows are too high by about as much.
            full_speed_mm_s: 315.0,
            valve_hz: 70.0,
            valve_damping: 0.8,
            valve_full_stroke_ms: 8.0,
            half_stroke_mm: 50.0,
        }
    }
}

impl ActuatorConfig {
    /// The first field that is out of range, with its range.
    pub(super) fn fault(&self) -> Option<OutOfRange> {
        first_out_of_range([
            ("piston_area_mm2", self.piston_area_mm2, 10.0..=1e6, "10 to 1e6"),
            ("supply_mpa", self.supply_mpa, 1.0..=100.0, "1 to 100"),
            ("oil_volume_mm3", self.oil_volume_mm3, 1e3..=1e8, "1e3 to 1e8"),
            (
                "bulk_modulus_mpa",
                self.bulk_modulus_mpa,
                50.0..=2000.0,
                "50 to 2000",
            ),
            (
                "leakage_mm3_s_per_mpa",
                self.leakage_mm3_s_per_mpa,
                0.0..=1e4,
                "0 to 1e4",
            ),
            ("moving_mass_kg", self.moving_mass_kg, 1.0..=1e4, "1 to 1e4"),
            ("seal_friction_n", self.seal_friction_n, 0.0..=5e3, "0 to 5e3"),
            (
                "viscous_n_s_per_mm",
                self.viscous_n_s_per_mm,
                0.0..=1e3,
                "0 to 1e3",
            ),
            ("full_speed_mm_s", self.full_speed_mm_s, 1.0..=5e3, "1 to 5e3"),
            ("valve_hz", self.valve_hz, 5.0..=300.0, "5 to 300"),
            ("valve_damping", self.valve_damping, 0.1..=0.99, "0.1 to 0.99"),
            (
                "valve_full_stroke_ms",
                self.valve_full_stroke_ms,
                1.0..=1e3,
                "1 to 1e3",
            ),
            ("half_stroke_mm", self.half_stroke_mm, 1.0..=1e3, "1 to 1e3"),
        ])
            .or_else(|| {
                let too_fast = self.oil_frequency_rad_s() * STEP_S >= 1.0;
                too_fast.then_some((
                    "moving_mass_kg",
                    self.moving_mass_kg,
                    "a larger value: the natural frequency of the oil column is too high for the steps of the mock rig",
                ))
            })
    }

    fn oil_stiffness_n_per_mm(&self) -> f64 {
        4.0 * self.bulk_modulus_mpa * self.piston_area_mm2.powi(2) / self.oil_volume_mm3
    }

    fn oil_frequency_rad_s(&self) -> f64 {
        (self.oil_stiffness_n_per_mm() / (self.moving_mass_kg * 1e-3)).sqrt()
    }
}

/// Steps of the hydraulics per tick.
pub(crate) const STEPS_PER_TICK: usize = 5;
/// Length of such a step in s.
pub(crate) const STEP_S: f64 = TICK_S / STEPS_PER_TICK as f64;
/// Speed at which the seal friction has half its full value, mm/s.
const SEAL_SPEED_MM_S: f64 = 0.05;
/// Time constant of the supply pressure, s.
const PUMP_TIME_S: f64 = 0.03;

/// The hydraulics with their state.
#[derive(Debug, Clone)]
pub(crate) struct Actuator {
    area: f64,
    supply_full: f64,
    supply: f64,
    flow_full: f64,
    leakage: f64,
    oil: f64,
    mass_t: f64,
    seal_n: f64,
    viscous: f64,
    half_stroke: f64,
    spool: TwoPole,
    spool_rate_max: f64,
    load_pressure: f64,
    velocity_mm_s: f64,
    /// Displacement of the piston in mm, loading positive.
    pub displacement_mm: f64,
    /// Injected fault: the spool does not move.
    pub valve_stuck: bool,
    /// Injected fault: no supply pressure.
    pub supply_lost: bool,
    /// Injected fault: the piston retracts at this speed with the valve closed, mm/s.
    pub leak_mm_s: f64,
}

impl Actuator {
    /// At rest at `displacement_mm` against `specimen_n`, pump off.
    pub(crate) fn new(config: &ActuatorConfig, displacement_mm: f64, specimen_n: f64) -> Self {
        Actuator {
            area: config.piston_area_mm2,
            supply_full: config.supply_mpa,
            supply: 0.0,
            flow_full: config.full_speed_mm_s * config.piston_area_mm2,
            leakage: config.leakage_mm3_s_per_mpa,
            oil: 4.0 * config.bulk_modulus_mpa / config.oil_volume_mm3,
            mass_t: config.moving_mass_kg * 1e-3,
            seal_n: config.seal_friction_n,
            viscous: config.viscous_n_s_per_mm,
            half_stroke: config.half_stroke_mm,
            spool: TwoPole::new(config.valve_hz, config.valve_damping, STEP_S),
            spool_rate_max: 1e3 / config.valve_full_stroke_ms,
            load_pressure: specimen_n / config.piston_area_mm2,
            velocity_mm_s: 0.0,
            displacement_mm,
            valve_stuck: false,
            supply_lost: false,
            leak_mm_s: 0.0,
        }
    }

    /// Supply pressure as a fraction of its rating.
    pub(crate) fn supply_ratio(&self) -> f64 {
        self.supply / self.supply_full
    }

    /// One step of [`STEP_S`] with the valve commanded to `command` (-1 to 1) against `specimen_n`. With `open` false
    /// the blocking valve holds the oil in the chambers and the pump is off. Returns the displacement in mm.
    pub(crate) fn step(&mut self, command: f64, open: bool, specimen_n: f64) -> f64 {
        let supply = if open && !self.supply_lost {
            self.supply_full
        } else {
            0.0
        };
        self.supply += (supply - self.supply) * (STEP_S / PUMP_TIME_S);
        if !self.valve_stuck {
            self.spool.limit_rate(self.spool_rate_max);
            self.spool.step(command.clamp(-1.0, 1.0));
        }
        let flow = if open { self.flow(self.spool.value()) } else { 0.0 };

        // Semi-implicit: pressure from the old speed, speed from the new pressure, displacement from the new speed. Leakage
        // and seal friction are implicit, so that they are stable at any setting.
        let leak = self.area * self.leak_mm_s;
        let inflow = flow - leak - self.area * self.velocity_mm_s;
        self.load_pressure =
            (self.load_pressure + STEP_S * self.oil * inflow) / (1.0 + STEP_S * self.oil * self.leakage);
        let drag = self.viscous + self.seal_n / (self.velocity_mm_s.abs() + SEAL_SPEED_MM_S);
        let push_n = self.area * self.load_pressure - specimen_n;
        self.velocity_mm_s =
            (self.velocity_mm_s + STEP_S / self.mass_t * push_n) / (1.0 + STEP_S / self.mass_t * drag);
        self.displacement_mm += STEP_S * self.velocity_mm_s;
        if self.displacement_mm.abs() > self.half_stroke {
            self.displacement_mm = self.displacement_mm.clamp(-self.half_stroke, self.half_stroke);
            self.velocity_mm_s = 0.0;
        }
        self.displacement_mm
    }

    /// Flow in mm3/s through the valve at this spool; negative pressure drop drives the oil back.
    fn flow(&self, spool: f64) -> f64 {
        let spool = spool.clamp(-1.0, 1.0);
        let drop = (self.supply - self.load_pressure * spool.signum()) / self.supply_full;
        self.flow_full * spool * drop.abs().sqrt().copysign(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pressurised() -> Actuator {
        let config = ActuatorConfig {
            leakage_mm3_s_per_mpa: 0.0,
            seal_friction_n: 0.0,
            ..ActuatorConfig::default()
        };
        let mut actuator = Actuator::new(&config, 0.0, 0.0);
        for _ in 0..3000 {
            actuator.step(0.0, true, 0.0);
        }
        actuator
    }

    #[test]
    fn speed_at_a_quarter_spool_under_load_by_hand() {
        let mut actuator = pressurised();
        let mut before = 0.0;
        let mut x = 0.0;
        for _ in 0..1000 {
            before = x;
            x = actuator.step(0.25, true, 10_000.0);
        }
        // p_L = (10000 + 2 v) / 1250 MPa, v = 315 / 4 * sqrt(1 - p_L / 20): 60.8 mm/s.
        let v: f64 = 60.77;
        assert!((v - 78.75 * (1.0 - (10_000.0 + 2.0 * v) / 25_000.0).sqrt()).abs() < 0.05);
        assert!(
            ((x - before) / STEP_S - v).abs() < 0.1,
            "{}",
            (x - before) / STEP_S
        );
    }

    #[test]
    fn blocked_oil_is_a_spring() {
        let mut actuator = pressurised();
        for _ in 0..20_000 {
            actuator.step(0.0, false, 4167.0);
        }
        // 4 E A^2 / V = 41 667 N/mm: 4167 N push the piston back by 0.1 mm, without seals and leakage.
        assert!(
            (actuator.displacement_mm + 0.1).abs() < 1e-3,
            "{}",
            actuator.displacement_mm
        );
    }

    #[test]
    fn stays_finite_under_any_command() {
        let mut actuator = pressurised();
        for i in 0..20_000 {
            let command = if i % 7 < 3 { 1.0 } else { -1.0 };
            let x = actuator.step(command, i % 1000 < 900, 300.0 * actuator.displacement_mm.max(0.0));
            assert!(x.abs() <= 50.0);
        }
    }

    #[test]
    fn impossible_sizes_are_refused() {
        let config = ActuatorConfig {
            supply_mpa: f64::NAN,
            ..ActuatorConfig::default()
        };
        assert_eq!(config.fault().map(|f| f.0), Some("supply_mpa"));
        let config = ActuatorConfig {
            moving_mass_kg: 1.0,
            ..ActuatorConfig::default()
        };
        assert_eq!(config.fault().map(|f| f.0), Some("moving_mass_kg"));
        assert_eq!(ActuatorConfig::default().fault(), None);
    }
}
