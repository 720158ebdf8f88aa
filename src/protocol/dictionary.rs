//! The object dictionary: the objects that the host reads and writes over SDO, and the limits among them.

use super::wire_enum::wire_enum;

wire_enum! {
    /// Why a configuration access was refused (CiA 301 abort codes).
    pub(crate) enum ConfigAbort: u32 {
        /// No object has this index.
        NoObject = 0x0602_0000,
        /// The object has no such sub-index.
        NoSubIndex = 0x0609_0011,
        /// The object is read only.
        ReadOnly = 0x0601_0002,
        /// The value is out of range.
        Range = 0x0609_0030,
        /// Not allowed in this state (pressure is on).
        State = 0x0800_0022,
        /// The request is malformed.
        Command = 0x0504_0001,
    }
}

/// Objects of the configuration that both sides know (index, sub-index).
pub(crate) mod object {
    /// Device type (ro).
    pub(crate) const DEVICE_TYPE: (u16, u8) = (0x1000, 0);
    /// Vendor id (ro).
    pub(crate) const VENDOR: (u16, u8) = (0x1018, 1);
    /// Product code (ro).
    pub(crate) const PRODUCT: (u16, u8) = (0x1018, 2);
    /// Firmware revision (ro).
    pub(crate) const REVISION: (u16, u8) = (0x1018, 3);
    /// Serial number (ro).
    pub(crate) const SERIAL: (u16, u8) = (0x1018, 4);
    /// Protocol version (ro).
    pub(crate) const PROTOCOL: (u16, u8) = (0x2000, 0);
    /// Boot id, different after each boot (ro).
    pub(crate) const BOOT_ID: (u16, u8) = (0x2001, 0);
    /// Sample rate in Hz (ro).
    pub(crate) const SAMPLE_RATE: (u16, u8) = (0x2002, 0);
    /// Hash of the sensors' calibration: first four bytes of its SHA-256, big endian (rw in Off).
    pub(crate) const CALIBRATION_HASH: (u16, u8) = (0x2003, 0);
    /// CRC-32 (ISO-HDLC) over the limits 0x2100:1 to 13 as little-endian i32 in order (ro).
    pub(crate) const CONFIGURATION_CRC: (u16, u8) = (0x2004, 0);
    /// Frames refused since boot: wrong CRC-8, reserved bit, unknown value, wrong sequence (ro).
    pub(crate) const FRAMES_REFUSED: (u16, u8) = (0x2005, 1);
    /// Commands of the own session dropped since boot: late, too far ahead, wrong state (ro).
    pub(crate) const COMMANDS_DROPPED: (u16, u8) = (0x2005, 2);
    /// LEASE and COMMAND frames of another session since boot (ro).
    pub(crate) const FRAMES_FOREIGN: (u16, u8) = (0x2005, 3);
    /// Index of the limits; sub-index n is `LIMITS[n - 1]` (rw in Off and Tripped).
    pub(crate) const LIMITS: u16 = 0x2100;
}

/// Range and default of one limit, in its own unit on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct LimitEntry {
    /// Name in `firmware-protocol.md`.
    pub name: &'static str,
    /// Lowest value that the firmware takes.
    pub lowest: i32,
    /// Highest value that the firmware takes.
    pub highest: i32,
    /// Value after a boot.
    pub default: i32,
}

const fn limit(name: &'static str, lowest: i32, highest: i32, default: i32) -> LimitEntry {
    LimitEntry {
        name,
        lowest,
        highest,
        default,
    }
}

/// Full scale of both channels. A tare moves the limits of a level, so their range is the whole channel.
const FULL: i32 = 131_071;

/// All limits in the order of sub-indices 1 to 13. The defaults are 10 kN, 49 mm, 300 mm/s. No limit can be switched off.
pub(crate) const LIMITS: [LimitEntry; LIMIT_COUNT] = [
    limit("force_max", -FULL, FULL, 100_000),
    limit("force_min", -FULL, FULL, -5_000),
    limit("displacement_max", -FULL, FULL, 98_000),
    limit("displacement_min", -FULL, FULL, -98_000),
    limit("velocity_max", 1_000, 2_500_000, 600_000),
    limit("following_error_displacement", 1, 40_000, 2_000),
    limit("following_error_force", 1, 40_000, 5_000),
    limit("lease", 20, 500, 50),
    limit("hold_timeout", 100, 600_000, 30_000),
    limit("unload_velocity", 100, 50_000, 10_000),
    limit("queue_low", 5, 200, 30),
    limit("unloaded_force", -FULL, FULL, 100),
    limit("retract", -FULL, FULL, -10_000),
];

/// The limits that the firmware holds, in the order of their sub-indices at 0x2100. All are i32 on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Limits {
    /// 1: upper force, counts.
    pub force_max_counts: i32,
    /// 2: lower force, counts.
    pub force_min_counts: i32,
    /// 3: upper displacement, counts.
    pub displacement_max_counts: i32,
    /// 4: lower displacement, counts.
    pub displacement_min_counts: i32,
    /// 5: speed, counts per second.
    pub velocity_max_counts_s: i32,
    /// 6: following error in displacement control, counts (persistence 20 ms).
    pub following_error_displacement_counts: i32,
    /// 7: following error in force control, counts (persistence 20 ms).
    pub following_error_force_counts: i32,
    /// 8: lease, ms.
    pub lease_ms: i32,
    /// 9: time after which Hold becomes Unload, ms.
    pub hold_timeout_ms: i32,
    /// 10: speed of the unload ramp, counts per second.
    pub unload_velocity_counts_s: i32,
    /// 11: queue level below which the rig decelerates to Hold, ms.
    pub queue_low_ms: i32,
    /// 12: force at or below which the specimen counts as unloaded, counts.
    pub unloaded_force_counts: i32,
    /// 13: displacement at which the unload ramp ends if the force has not fallen before, counts.
    pub retract_counts: i32,
}

/// Number of limits.
pub(crate) const LIMIT_COUNT: usize = 13;

impl Limits {
    /// The limits in the order of sub-indices 1 to 13.
    pub(crate) fn to_array(self) -> [i32; LIMIT_COUNT] {
        [
            self.force_max_counts,
            self.force_min_counts,
            self.displacement_max_counts,
            self.displacement_min_counts,
            self.velocity_max_counts_s,
            self.following_error_displacement_counts,
            self.following_error_force_counts,
            self.lease_ms,
            self.hold_timeout_ms,
            self.unload_velocity_counts_s,
            self.queue_low_ms,
            self.unloaded_force_counts,
            self.retract_counts,
        ]
    }

    /// The limits after a boot.
    pub(crate) fn defaults() -> Self {
        Limits::from_array(LIMITS.map(|limit| limit.default))
    }

    /// True if the limits do not contradict each other: each range is open, and an unload ends within both.
    pub(crate) fn is_consistent(&self) -> bool {
        let force = self.force_min_counts..self.force_max_counts;
        let travel = self.displacement_min_counts..self.displacement_max_counts;
        force.contains(&self.unloaded_force_counts) && travel.contains(&self.retract_counts)
    }

    /// Limits from the values of sub-indices 1 to 13.
    pub(crate) fn from_array(a: [i32; LIMIT_COUNT]) -> Self {
        Limits {
            force_max_counts: a[0],
            force_min_counts: a[1],
            displacement_max_counts: a[2],
            displacement_min_counts: a[3],
            velocity_max_counts_s: a[4],
            following_error_displacement_counts: a[5],
            following_error_force_counts: a[6],
            lease_ms: a[7],
            hold_timeout_ms: a[8],
            unload_velocity_counts_s: a[9],
            queue_low_ms: a[10],
            unloaded_force_counts: a[11],
            retract_counts: a[12],
        }
    }
}
