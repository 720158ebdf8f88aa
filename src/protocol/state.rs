//! States of the rig's firmware and the causes of its faults, as in the state diagram of `firmware-protocol.md`. Which
//! change is allowed when is decided by the firmware (`mockrig`).

use super::wire_enum::wire_enum;

wire_enum! {
    /// State of the rig's firmware (4 bits).
    #[derive(serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub(crate) enum RigState: u8 {
        /// S3: pump off, blocking valve closed. After boot and after an unload without fault. Arming is allowed.
        Off = 0,
        /// Pressure on; the servo keeps the displacement at which it was armed and follows the queue once commands are due.
        Armed = 1,
        /// Follows the command queue.
        Running = 2,
        /// S1: keeps the position, pressure on; becomes Unload after the hold time-out.
        Hold = 3,
        /// S2: ramps to zero load on its own, then Off (on request) or Tripped (after a fault).
        Unload = 4,
        /// S3, latched by a fault: needs a Reset request. Reset never resumes motion.
        Tripped = 5,
    }
}

wire_enum! {
    /// First cause of a latched state (8 bits).
    #[derive(serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub(crate) enum Cause: u8 {
        /// No fault is latched.
        None = 0,
        /// The host's lease lapsed.
        LeaseLapsed = 1,
        /// NMT stop from the host.
        HostAbort = 2,
        /// Unload request of an operator.
        Requested = 3,
        /// Force beyond its limit.
        ForceLimit = 4,
        /// Displacement beyond its limit.
        DisplacementLimit = 5,
        /// Speed beyond its limit.
        VelocityLimit = 6,
        /// Following error beyond its limit for 20 ms.
        FollowingError = 7,
        /// The command queue ran empty.
        QueueDry = 8,
        /// Three corrupt or out-of-sequence frames within 100 ms.
        CorruptFrames = 9,
        /// Load cell open or at its rail.
        ForceSensor = 10,
        /// LVDT open or at its rail.
        DisplacementSensor = 11,
        /// The LVDT reading does not change although the servo moves the rig.
        SensorStuck = 12,
        /// Force fell by more than half within 10 ms.
        SpecimenBreak = 13,
        /// The firmware did not run for 10 ms.
        Watchdog = 14,
        /// The hold time-out passed without a resume.
        HoldTimeout = 15,
        /// The emergency stop is pressed.
        EmergencyStop = 16,
        /// Supply pressure lost.
        SupplyPressure = 17,
        /// More than five frames of a foreign session within 100 ms.
        ForeignSession = 18,
        /// A command beyond the limits, or of the wrong mode.
        BadCommand = 19,
    }
}

impl Cause {
    /// CiA 301 emergency code and error register (0x1001) of the EMERGENCY frame. Register: bit 0 generic, bit 4
    /// communication, bit 7 manufacturer. Codes from 0xFF00 on are this protocol's own, the others are of CiA 301 and 402.
    pub(crate) fn emergency(self) -> (u16, u8) {
        match self {
            Cause::None => (0x0000, 0x00),
            Cause::LeaseLapsed => (0x8130, 0x11),
            Cause::HostAbort => (0xFF02, 0x81),
            Cause::Requested => (0xFF03, 0x81),
            Cause::ForceLimit => (0xFF10, 0x81),
            Cause::DisplacementLimit => (0xFF11, 0x81),
            Cause::VelocityLimit => (0xFF12, 0x81),
            Cause::FollowingError => (0x8611, 0x81),
            Cause::QueueDry => (0xFF20, 0x11),
            Cause::CorruptFrames => (0x8100, 0x11),
            Cause::ForceSensor => (0xFF30, 0x81),
            Cause::DisplacementSensor => (0xFF31, 0x81),
            Cause::SensorStuck => (0xFF32, 0x81),
            Cause::SpecimenBreak => (0xFF40, 0x81),
            Cause::Watchdog => (0x6010, 0x01),
            Cause::HoldTimeout => (0xFF21, 0x81),
            Cause::EmergencyStop => (0x9000, 0x81),
            Cause::SupplyPressure => (0xFF50, 0x81),
            Cause::ForeignSession => (0xFF22, 0x11),
            Cause::BadCommand => (0xFF23, 0x11),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_for_a_person_are_words() {
        assert_eq!(Cause::ForceLimit.to_string(), "force limit");
        assert_eq!(RigState::Tripped.to_string(), "tripped");
    }

    #[test]
    fn every_cause_has_an_emergency_code_of_its_own() {
        let codes: std::collections::BTreeSet<u16> =
            Cause::ALL.iter().map(|cause| cause.emergency().0).collect();
        assert_eq!(codes.len(), Cause::ALL.len());
        for cause in Cause::ALL {
            // CiA 301: code 0 and register 0 mean "no error", and only they do.
            let (code, register) = cause.emergency();
            assert_eq!(code == 0, cause == Cause::None);
            assert_eq!(register & 1 == 0, cause == Cause::None);
        }
    }
}
