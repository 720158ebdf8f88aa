//! A simulated rig at the far end of a link: firmware, actuator, sensors and a plant. It is independent of the daemon.
//!
//! [`MockRig::tick`] is one tick of virtual time; [`MockRig::run_realtime`] ticks in real time in a thread or process of its
//! own. The same configuration, plant and received frames give the same bits.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use crate::detector;
use crate::link::Link;
use crate::model::Plant;
use crate::protocol::message::{
    Cause, DISPLACEMENT_MM_PER_COUNT, DecodeError, FORCE_N_PER_COUNT, FromRig, RigState, ToRig,
};
use crate::protocol::tick::ticks_in_ms;

mod actuator;
mod faults;
mod firmware;
mod guard;
mod host_side;
mod queue;
mod realtime;
mod requests;
mod sensors;
mod servo;
#[cfg(test)]
mod tests;
mod wire;

use actuator::{Actuator, ActuatorConfig, STEP_S, STEPS_PER_TICK};
use faults::SPIKE_TICKS;
#[cfg(test)]
pub(crate) use faults::{Amount, FAULTS};
pub(crate) use faults::{FaultError, FaultSchedule, list_of_faults, read_faults};
use firmware::{Drive, Firmware, Identity};
use guard::{Reaction, SensorReading};
use sensors::{Sensor, SensorConfig};
use servo::ServoConfig;
use wire::{Wire, WireFaults};

/// The `[mock_rig]` table of a bench file; every key has a default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct MockRigConfig {
    /// Seed of the noise of both channels.
    pub seed: u64,
    /// Node on the bus, 1 to 126.
    pub node: u8,
    /// Serial number (object 0x1018:4).
    pub serial: u32,
    /// Boot id of the first boot (object 0x2001).
    pub boot_id: u32,
    /// Calibration hash (object 0x2003).
    pub calibration_hash: u32,
    /// Displacement of the piston at boot, mm.
    pub start_displacement_mm: f64,
    /// Displacement at which the pusher touches the specimen: the zero of the plant, mm.
    pub contact_displacement_mm: f64,
    /// Steps of the plant per tick: 1 for a slow model, or 5, one per step of the hydraulics.
    pub plant_steps_per_ms: u32,
    /// Faults that the rig plays, as `NAME=AMOUNT@FROM..TO`.
    pub faults: Vec<String>,
    /// Properties of the load cell.
    pub load_cell: SensorConfig,
    /// Properties of the LVDT.
    pub lvdt: SensorConfig,
    /// Sizes of the hydraulics.
    pub actuator: ActuatorConfig,
    /// Gains of the servo loop.
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
            plant_steps_per_ms: STEPS_PER_TICK as u32,
            faults: Vec::new(),
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
    /// A number is out of range.
    #[error("mock_rig.{table}{key} = {value} is out of range: set it to {range}")]
    Range {
        /// Table below `mock_rig` with its dot, or empty.
        table: &'static str,
        /// Key in that table.
        key: &'static str,
        /// The value as given.
        value: f64,
        /// The allowed range.
        range: &'static str,
    },
    /// A fault of the list is not understood.
    #[error("mock_rig.faults: {0}")]
    Fault(#[from] FaultError),
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
                "a value within the stroke",
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
                steps == 1 || steps == STEPS_PER_TICK as u32,
                "1 or 5",
            ),
        ];
        let own = own
            .into_iter()
            .find(|o| !o.2)
            .map(|(key, value, _, range)| ("", key, value, range));
        let in_table =
            |table, fault: Option<OutOfRange>| fault.map(|(key, value, range)| (table, key, value, range));
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
            })?;
        FaultSchedule::parse(&self.faults)?;
        Ok(())
    }
}

/// Key, value and allowed range of a number that is out of range.
type OutOfRange = (&'static str, f64, &'static str);

/// The first number outside its range, with the range as text.
fn first_out_of_range<const N: usize>(
    numbers: [(&'static str, f64, RangeInclusive<f64>, &'static str); N],
) -> Option<OutOfRange> {
    numbers
        .into_iter()
        .find(|(_, value, range, _)| !range.contains(value))
        .map(|(key, value, _, range)| (key, value, range))
}

/// Faults that are injected into the rig; none by default. [`FaultSchedule`] gives them names and times.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Injection {
    /// Faults of the link.
    pub wire: WireFaults,
    /// Wire of the load cell open: no valid reading.
    pub force_open: bool,
    /// Wire of the LVDT open: no valid reading.
    pub displacement_open: bool,
    /// The reading of the load cell no longer changes.
    pub force_frozen: bool,
    /// The reading of the LVDT no longer changes.
    pub displacement_frozen: bool,
    /// One sample of the load cell is off by this, again and again while the fault lasts, N.
    pub force_spike_n: f64,
    /// One sample of the LVDT is off by this, again and again while the fault lasts, mm.
    pub displacement_spike_mm: f64,
    /// Additional noise of the load cell in multiples of its own.
    pub force_noise: f64,
    /// Additional noise of the LVDT in multiples of its own.
    pub displacement_noise: f64,
    /// Relative error of the load cell's gain: 0.05 reads 5 % high.
    pub force_gain_error: f64,
    /// Relative error of the LVDT's gain.
    pub displacement_gain_error: f64,
    /// Error of the load cell's zero, N.
    pub force_offset_n: f64,
    /// The load cell reads with the wrong sign.
    pub force_inverted: bool,
    /// The LVDT reads with the wrong sign.
    pub displacement_inverted: bool,
    /// The firmware does not run: no samples; the hardware watchdog closes the valve after 10 ms.
    pub firmware_hangs: bool,
    /// The firmware restarts, once.
    pub firmware_reboots: bool,
    /// The firmware enforces no limit and finds no fault of a sensor.
    pub limits_ignored: bool,
    /// The servo valve does not move.
    pub valve_stuck: bool,
    /// The piston retracts at this speed with the valve closed, mm/s.
    pub leak_mm_s: f64,
    /// The supply pressure fails.
    pub supply_lost: bool,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
    /// The specimen carries no load.
    pub specimen_broken: bool,
    /// Additional force of the specimen in multiples of its own.
    pub specimen_stiffer: f64,
}

/// The hardware watchdog switches the pressure off if the firmware does not run for this long: 10 ms.
const WATCHDOG_TICKS: u64 = ticks_in_ms(10);

/// A simulated rig.
pub(crate) struct MockRig {
    node: u8,
    firmware: Firmware,
    drive: Drive,
    actuator: Actuator,
    load_cell: Sensor,
    lvdt: Sensor,
    plant: Box<dyn Plant>,
    contact_mm: f64,
    /// The plant is stepped every this many steps of the hydraulics.
    plant_every: usize,
    specimen_n: f64,
    /// Ticks in a row in which the firmware did not run.
    hung_ticks: u64,
    wire: Wire,
    /// Ticks since the start of the rig.
    ticks: u64,
    /// Tick at which the newest motion began.
    run_since: Option<u64>,
    was_running: bool,
    /// Faults that come and go by themselves.
    schedule: FaultSchedule,
    /// Faults in effect from the next tick on.
    pub injection: Injection,
    /// Faults that wire, firmware, sensors and actuator already have.
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
            drive: Drive::OFF,
            actuator: Actuator::new(&config.actuator, start_mm, specimen_n),
            load_cell,
            lvdt,
            plant,
            contact_mm: config.contact_displacement_mm,
            plant_every: STEPS_PER_TICK / config.plant_steps_per_ms as usize,
            specimen_n,
            hung_ticks: 0,
            wire: Wire::new(config.node, config.seed),
            ticks: 0,
            run_since: None,
            was_running: false,
            schedule: FaultSchedule::parse(&config.faults)?,
            injection: Injection::default(),
            injected: Injection::default(),
        })
    }

    /// One tick: handles the frames that arrived, steps the physics, reads the sensors, sends.
    pub(crate) fn tick(&mut self, link: &mut Link) {
        self.ticks += 1;
        self.play_schedule();
        self.wire.begin_tick(link);
        self.take_frames(link);
        let spike_lasts = self.lasting_spike();
        if self.injection != self.injected {
            self.inject();
        }
        self.physics();
        if self.injection.firmware_hangs {
            self.hung_ticks += 1;
            if self.hung_ticks >= WATCHDOG_TICKS && detector::acts("F1") {
                self.drive = Drive::OFF;
            }
        } else {
            if std::mem::take(&mut self.hung_ticks) >= WATCHDOG_TICKS && detector::acts("F1") {
                self.firmware.trip(Cause::Watchdog, Reaction::Off);
            }
            let spikes = !spike_lasts || self.ticks.is_multiple_of(SPIKE_TICKS);
            let spike = |amount: f64| if spikes { amount } else { 0.0 };
            let reading = SensorReading {
                force_counts: self.load_cell.read(spike(self.injection.force_spike_n)),
                displacement_counts: self.lvdt.read(spike(self.injection.displacement_spike_mm)),
                supply_ratio: self.actuator.supply_ratio(),
                emergency_stop: self.injection.emergency_stop,
            };
            self.drive = self.firmware.tick(&reading);
        }
        self.send(link);
    }

    /// Puts the faults of the schedule into effect whose time has come. Without a schedule the injection stays as it is.
    fn play_schedule(&mut self) {
        let is_running = self.firmware.state == RigState::Running;
        if is_running && !self.was_running {
            self.run_since = Some(self.ticks);
        }
        self.was_running = is_running;
        if !self.schedule.is_empty() {
            let run_tick = self.run_since.map(|since| self.ticks - since);
            self.injection = self.schedule.injection(self.ticks, run_tick);
        }
    }

    fn take_frames(&mut self, link: &mut Link) {
        while let Some(frame) = link.receive() {
            let Some(frame) = self.wire.arrives(frame) else {
                continue;
            };
            match ToRig::decode(&frame, self.node) {
                Ok(message) => self.firmware.handle(message),
                // A frame of another length is foreign, not corrupt.
                Err(DecodeError::ForeignId(_) | DecodeError::Length { .. }) => continue,
                Err(DecodeError::RequestCode { counter, .. }) => self.firmware.refuse_request(counter),
                Err(DecodeError::Config { index, sub, .. }) => self.firmware.refuse_access(index, sub),
                Err(DecodeError::Crc { .. } | DecodeError::Field { .. }) => self.firmware.note_corrupt(),
            }
            self.send(link);
        }
        if let Some(message) = self.wire.foreign() {
            self.firmware.handle(message);
        }
    }

    /// True if a spike is in effect for longer than a tick: then it comes again and again.
    fn lasting_spike(&self) -> bool {
        let before = &self.injected;
        let now = &self.injection;
        (before.force_spike_n != 0.0 && now.force_spike_n != 0.0)
            || (before.displacement_spike_mm != 0.0 && now.displacement_spike_mm != 0.0)
    }

    fn physics(&mut self) {
        for step in 0..STEPS_PER_TICK {
            let displacement_mm = self
                .actuator
                .step(self.drive.valve, self.drive.open, self.specimen_n);
            if (step + 1) % self.plant_every == 0 {
                let dt_s = STEP_S * self.plant_every as f64;
                // The pusher is not fixed to the specimen, so it cannot pull.
                let force_n = self.plant.step(displacement_mm - self.contact_mm, dt_s).max(0.0);
                self.specimen_n = if self.injection.specimen_broken {
                    0.0
                } else {
                    force_n * (1.0 + self.injection.specimen_stiffer)
                };
            }
            self.load_cell.step(self.specimen_n);
            self.lvdt.step(displacement_mm);
        }
    }

    fn inject(&mut self) {
        let restarts = self.injection.firmware_reboots && !self.injected.firmware_reboots;
        self.injected = self.injection.clone();
        let injection = &self.injected;
        self.wire.faults = injection.wire;
        let sign = |inverted: bool| if inverted { -1.0 } else { 1.0 };
        self.load_cell.open = injection.force_open;
        self.load_cell.frozen = injection.force_frozen;
        self.load_cell.gain_fault = (1.0 + injection.force_gain_error) * sign(injection.force_inverted);
        self.load_cell.noise_fault = 1.0 + injection.force_noise;
        self.load_cell.offset_fault = injection.force_offset_n;
        self.lvdt.open = injection.displacement_open;
        self.lvdt.frozen = injection.displacement_frozen;
        self.lvdt.gain_fault =
            (1.0 + injection.displacement_gain_error) * sign(injection.displacement_inverted);
        self.lvdt.noise_fault = 1.0 + injection.displacement_noise;
        self.actuator.valve_stuck = injection.valve_stuck;
        self.actuator.supply_lost = injection.supply_lost;
        self.actuator.leak_mm_s = injection.leak_mm_s;
        self.firmware.limits_ignored = injection.limits_ignored;
        if restarts {
            self.firmware.reboot();
            self.drive = Drive::OFF;
        }
    }

    /// Sends the outbox. Frames that the link refuses are counted by the link.
    fn send(&mut self, link: &mut Link) {
        if self.firmware.outbox().is_empty() {
            return;
        }
        for message in self.firmware.outbox().drain() {
            let urgent = matches!(message, FromRig::Emergency(_));
            self.wire.send(message.encode(self.node), urgent, link);
        }
    }
}
