//! The far end of a link where no hardware is: firmware, actuator, sensors and a plant. Knows nothing of the daemon.
//!
//! [`MockRig::tick`] is one millisecond of virtual time; [`MockRig::run_realtime`] ticks by the clock in a thread or process
//! of its own. Same configuration, same plant and same frames in: same bits out.

use serde::{Deserialize, Serialize};

use crate::link::Link;
use crate::model::Plant;
use crate::protocol::message::{
    Cause, DISPLACEMENT_MM_PER_COUNT, DecodeError, FORCE_N_PER_COUNT, FromRig, ToRig,
};

pub(crate) mod actuator;
pub(crate) mod firmware;
pub(crate) mod guard;
pub(crate) mod queue;
mod realtime;
pub(crate) mod requests;
pub(crate) mod sensors;
pub(crate) mod servo;
#[cfg(test)]
mod tests;

use actuator::{Actuator, ActuatorConfig, STEP_S, STEPS_PER_MS};
use firmware::{Drive, Firmware, Identity};
use guard::{Reaction, SensorReading};
use sensors::{Sensor, SensorConfig};
use servo::ServoConfig;

/// The `[mock_rig]` table of a bench file; every key has a default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct MockRigConfig {
    /// Seed of all noise.
    pub seed: u64,
    /// Node on the bus, 1 to 126.
    pub node: u8,
    /// Serial number (0x1018:4).
    pub serial: u32,
    /// Boot id of the first boot (0x2001).
    pub boot_id: u32,
    /// Calibration hash (0x2003).
    pub calibration_hash: u32,
    /// Where the piston stands at boot, mm.
    pub start_displacement_mm: f64,
    /// Displacement at which the pusher touches: the plant's zero, mm.
    pub contact_displacement_mm: f64,
    /// Times a millisecond that the plant is stepped: 1 for a costly model, 5 with every step of the hydraulics.
    pub plant_steps_per_ms: u32,
    /// Load cell.
    pub load_cell: SensorConfig,
    /// LVDT.
    pub lvdt: SensorConfig,
    /// Hydraulics.
    pub actuator: ActuatorConfig,
    /// Servo loop.
    pub servo: ServoConfig,
}

impl Default for MockRigConfig {
    fn default() -> Self {
        MockRigConfig {
            seed: 1,
            node: 1,
            serial: 1,
            boot_id: 1,
            calibration_hash: 0,
            start_displacement_mm: 0.0,
            contact_displacement_mm: 0.0,
            plant_steps_per_ms: STEPS_PER_MS as u32,
            load_cell: SensorConfig::default(),
            lvdt: SensorConfig::default(),
            actuator: ActuatorConfig::default(),
            servo: ServoConfig::default(),
        }
    }
}

/// Why a mock rig could not be built.
#[derive(Debug, thiserror::Error, PartialEq)]
pub(crate) enum MockRigError {
    /// A number that no rig can have.
    #[error("mock_rig.{table}{key} = {value} is not possible: it may be {range}")]
    Range {
        /// Table with its dot, or empty.
        table: &'static str,
        /// Key.
        key: &'static str,
        /// As given.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
}

impl MockRigConfig {
    /// Checks every number.
    pub(crate) fn check(&self) -> Result<(), MockRigError> {
        let stroke = self.actuator.half_stroke_mm;
        let steps = self.plant_steps_per_ms;
        let own = [
            (
                "node",
                f64::from(self.node),
                (1..=126).contains(&self.node),
                "1 to 126",
            ),
            (
                "start_displacement_mm",
                self.start_displacement_mm,
                self.start_displacement_mm.abs() <= stroke,
                "within the stroke",
            ),
            (
                "contact_displacement_mm",
                self.contact_displacement_mm,
                self.contact_displacement_mm.is_finite(),
                "any finite number",
            ),
            (
                "plant_steps_per_ms",
                f64::from(steps),
                steps == 1 || steps == STEPS_PER_MS as u32,
                "1 or 5",
            ),
        ];
        let own = own
            .into_iter()
            .find(|o| !o.2)
            .map(|(key, value, _, range)| ("", key, value, range));
        let in_table = |table, fault: Option<(&'static str, f64, &'static str)>| {
            fault.map(|(key, value, range)| (table, key, value, range))
        };
        own.or_else(|| in_table("load_cell.", self.load_cell.fault()))
            .or_else(|| in_table("lvdt.", self.lvdt.fault()))
            .or_else(|| in_table("actuator.", self.actuator.fault()))
            .or_else(|| in_table("servo.", self.servo.fault()))
            .map_or(Ok(()), |(table, key, value, range)| {
                Err(MockRigError::Range {
                    table,
                    key,
                    value,
                    range,
                })
            })
    }
}

/// Faults that a test puts into the rig; all off at first.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Injection {
    /// The load cell's reading stays as it is.
    pub force_frozen: bool,
    /// The LVDT's reading stays as it is.
    pub displacement_frozen: bool,
    /// Load cell open.
    pub force_open: bool,
    /// LVDT open.
    pub displacement_open: bool,
    /// Relative error of the load cell's gain: 0.05 reads 5 % high.
    pub force_gain_error: f64,
    /// The servo valve stays where it is.
    pub valve_stuck: bool,
    /// Supply pressure fails.
    pub supply_lost: bool,
    /// The specimen carries nothing any more.
    pub specimen_broken: bool,
    /// Emergency stop pressed.
    pub emergency_stop: bool,
    /// Nothing is sent; what arrives is still obeyed.
    pub mute: bool,
    /// The firmware does not tick: no samples; the hardware watchdog closes the valve after 10 ms.
    pub firmware_hangs: bool,
}

/// A firmware that does not tick for this long loses pressure: the watchdog is hardware.
const WATCHDOG_MS: u32 = 10;

/// The rig.
pub(crate) struct MockRig {
    node: u8,
    firmware: Firmware,
    drive: Drive,
    actuator: Actuator,
    load_cell: Sensor,
    lvdt: Sensor,
    plant: Box<dyn Plant>,
    contact_mm: f64,
    plant_every: usize,
    specimen_n: f64,
    hung_ms: u32,
    /// Faults in force from the next tick on.
    pub injection: Injection,
    injected: Injection,
}

impl MockRig {
    /// A rig that has just booted, with `plant` under its pusher.
    pub(crate) fn new(config: &MockRigConfig, mut plant: Box<dyn Plant>) -> Result<Self, MockRigError> {
        config.check()?;
        let start_mm = config.start_displacement_mm;
        let specimen_n = plant
            .step(start_mm - config.contact_displacement_mm, STEP_S)
            .max(0.0);
        let sensor = |channel: &SensorConfig, units_per_count, stream| {
            Sensor::new(channel, units_per_count, STEP_S, config.seed, stream)
        };
        let mut load_cell = sensor(&config.load_cell, FORCE_N_PER_COUNT, 1);
        let mut lvdt = sensor(&config.lvdt, DISPLACEMENT_MM_PER_COUNT, 2);
        load_cell.settle(specimen_n);
        lvdt.settle(start_mm);
        let identity = Identity {
            node: config.node,
            serial: config.serial,
            boot_id: config.boot_id,
            calibration_hash: config.calibration_hash,
        };
        Ok(MockRig {
            node: config.node,
            firmware: Firmware::new(identity, &config.servo),
            drive: Drive {
                valve: 0.0,
                open: false,
            },
            actuator: Actuator::new(&config.actuator, start_mm, specimen_n),
            load_cell,
            lvdt,
            plant,
            contact_mm: config.contact_displacement_mm,
            plant_every: STEPS_PER_MS / config.plant_steps_per_ms as usize,
            specimen_n,
            hung_ms: 0,
            injection: Injection::default(),
            injected: Injection::default(),
        })
    }

    /// The firmware, to look at.
    pub(crate) fn firmware(&self) -> &Firmware {
        &self.firmware
    }

    /// True displacement in mm.
    pub(crate) fn displacement_mm(&self) -> f64 {
        self.actuator.displacement_mm()
    }

    /// True force of the specimen in N.
    pub(crate) fn force_n(&self) -> f64 {
        self.specimen_n
    }

    /// The firmware starts again, as after a power dip of the controller.
    pub(crate) fn reboot(&mut self) {
        self.firmware.reboot();
    }

    /// One millisecond: obeys what arrived, lets the physics run, reads, answers.
    pub(crate) fn tick(&mut self, link: &mut Link) {
        while let Some(arrival) = link.receive() {
            match ToRig::decode(&arrival.frame, self.node) {
                Ok(message) => self.firmware.handle(message),
                // Another shape is no frame of ours: not even a corrupt one.
                Err(DecodeError::ForeignId(_) | DecodeError::Length { .. }) => continue,
                Err(_) => self.firmware.note_corrupt(),
            }
            self.send(link);
        }
        if self.injection != self.injected {
            self.inject();
        }
        self.physics();
        if self.injection.firmware_hangs {
            self.hung_ms += 1;
            if self.hung_ms >= WATCHDOG_MS {
                self.drive = Drive {
                    valve: 0.0,
                    open: false,
                };
            }
        } else {
            if std::mem::take(&mut self.hung_ms) >= WATCHDOG_MS {
                self.firmware.trip(Cause::Watchdog, Reaction::Off);
            }
            let reading = SensorReading {
                force_counts: self.load_cell.read(),
                displacement_counts: self.lvdt.read(),
                supply_ratio: self.actuator.supply_ratio(),
                emergency_stop: self.injection.emergency_stop,
            };
            self.drive = self.firmware.tick(&reading);
        }
        self.send(link);
    }

    fn physics(&mut self) {
        for step in 0..STEPS_PER_MS {
            let displacement_mm = self
                .actuator
                .step(self.drive.valve, self.drive.open, self.specimen_n);
            if (step + 1) % self.plant_every == 0 {
                let dt_s = STEP_S * self.plant_every as f64;
                // The pusher is not fixed to the specimen: it cannot be pulled.
                let force_n = self.plant.step(displacement_mm - self.contact_mm, dt_s).max(0.0);
                self.specimen_n = if self.injection.specimen_broken {
                    0.0
                } else {
                    force_n
                };
            }
            self.load_cell.feel(self.specimen_n);
            self.lvdt.feel(displacement_mm);
        }
    }

    fn inject(&mut self) {
        self.injected = self.injection.clone();
        let injection = &self.injected;
        self.load_cell.frozen = injection.force_frozen;
        self.load_cell.open = injection.force_open;
        self.load_cell.gain_fault = 1.0 + injection.force_gain_error;
        self.lvdt.frozen = injection.displacement_frozen;
        self.lvdt.open = injection.displacement_open;
        self.actuator.valve_stuck = injection.valve_stuck;
        self.actuator.supply_lost = injection.supply_lost;
    }

    /// A full ring is the link's to count: the rig does not wait for a host.
    fn send(&mut self, link: &mut Link) {
        if self.firmware.outbox().is_empty() {
            return;
        }
        for message in self.firmware.outbox().drain() {
            if !self.injection.mute {
                let frame = message.encode(self.node);
                if matches!(message, FromRig::Emergency { .. }) {
                    link.send_urgent(frame);
                } else {
                    link.send(frame);
                }
            }
        }
    }
}
