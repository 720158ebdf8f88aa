//! Rows about the objects: what the hello reads, what is refused, the limits and their CRC-32. Nothing moves.

use super::probe::{Probe, same};
use super::row::CheckRow;
use crate::protocol::cob;
use crate::protocol::frame::Frame;
use crate::protocol::message::{
    ConfigAbort, FromRig, LIMIT_COUNT, LIMITS, Limits, PROTOCOL_VERSION, SAMPLE_RATE_HZ, object,
};

pub(super) const ROWS: &[CheckRow] = &[
    CheckRow {
        id: "protocol-version",
        section: "9",
        title: "0x2000 has this major version",
        moves: false,
        check: protocol_version,
    },
    CheckRow {
        id: "identity",
        section: "9",
        title: "every object can be read",
        moves: false,
        check: identity,
    },
    CheckRow {
        id: "sample-rate",
        section: "9",
        title: "0x2002 is 1000 Hz",
        moves: false,
        check: sample_rate,
    },
    CheckRow {
        id: "read-only",
        section: "9",
        title: "writing a read-only object is refused",
        moves: false,
        check: read_only,
    },
    CheckRow {
        id: "unknown-object",
        section: "2",
        title: "unknown object and sub-index are refused",
        moves: false,
        check: unknown_object,
    },
    CheckRow {
        id: "malformed-sdo",
        section: "2",
        title: "a malformed request is refused, an abort ignored",
        moves: false,
        check: malformed,
    },
    CheckRow {
        id: "limit-ranges",
        section: "9",
        title: "each limit takes its range and refuses the values beside it",
        moves: false,
        check: limit_ranges,
    },
    CheckRow {
        id: "crc-32",
        section: "3",
        title: "0x2004 is the CRC-32 of the limits in force",
        moves: false,
        check: configuration_crc,
    },
    CheckRow {
        id: "calibration-hash",
        section: "9",
        title: "the calibration hash can be read and written in off",
        moves: false,
        check: calibration_hash,
    },
];

fn protocol_version(probe: &mut Probe) -> Result<String, String> {
    let version = probe.read(object::PROTOCOL)?;
    same("major version", version >> 16, PROTOCOL_VERSION >> 16)?;
    Ok(format!("{}.{}", version >> 16, version & 0xFFFF))
}

fn identity(probe: &mut Probe) -> Result<String, String> {
    let mut values = Vec::new();
    for object in READ_ONLY {
        values.push(probe.read(object)?);
    }
    for sub in 0..=LIMIT_COUNT as u8 {
        values.push(probe.read((object::LIMITS, sub))?);
    }
    let [device, vendor, product, revision, serial, ..] = values[..] else {
        return Err("fewer than five objects".to_owned());
    };
    Ok(format!(
        "device {device:#x}, vendor {vendor:#x}, product {product:#x}, revision {revision:#x}, serial {serial}"
    ))
}

/// All objects that cannot be written, single ones.
const READ_ONLY: [(u16, u8); 12] = [
    object::DEVICE_TYPE,
    object::VENDOR,
    object::PRODUCT,
    object::REVISION,
    object::SERIAL,
    object::PROTOCOL,
    object::BOOT_ID,
    object::SAMPLE_RATE,
    object::CONFIGURATION_CRC,
    object::FRAMES_REFUSED,
    object::COMMANDS_DROPPED,
    object::FRAMES_FOREIGN,
];

fn sample_rate(probe: &mut Probe) -> Result<String, String> {
    let rate_hz = probe.read(object::SAMPLE_RATE)?;
    same("sample rate in Hz", rate_hz, SAMPLE_RATE_HZ)?;
    Ok(format!("{rate_hz} Hz"))
}

fn read_only(probe: &mut Probe) -> Result<String, String> {
    for object in READ_ONLY.into_iter().chain([(object::LIMITS, 0)]) {
        let answer = probe.try_write(object, 1)?;
        let what = format!("write of {:#06x}:{}", object.0, object.1);
        same(&what, answer, Err(ConfigAbort::ReadOnly))?;
    }
    Ok(format!("{} objects refused", READ_ONLY.len() + 1))
}

fn unknown_object(probe: &mut Probe) -> Result<String, String> {
    for (object, abort) in [
        ((0x3000, 0), ConfigAbort::NoObject),
        ((object::SAMPLE_RATE.0, 1), ConfigAbort::NoSubIndex),
        ((object::VENDOR.0, 5), ConfigAbort::NoSubIndex),
        ((object::LIMITS, LIMIT_COUNT as u8 + 1), ConfigAbort::NoSubIndex),
    ] {
        let what = format!("read of {:#06x}:{}", object.0, object.1);
        same(&what, probe.try_read(object)?, Err(abort))?;
        let what = format!("write of {:#06x}:{}", object.0, object.1);
        same(&what, probe.try_write(object, 1)?, Err(abort))?;
    }
    Ok("0x06020000 and 0x06090011".to_owned())
}

fn malformed(probe: &mut Probe) -> Result<String, String> {
    let (index, sub) = object::SAMPLE_RATE;
    let id = cob::id(cob::CONFIG_REQUEST, probe.node);
    let bytes = |command: u8, value: u8| {
        let [low, high] = index.to_le_bytes();
        Frame::new(id, &[command, low, high, sub, value, 0, 0, 0])
    };
    let refused = FromRig::ConfigRefused {
        index,
        sub,
        abort: ConfigAbort::Command,
    };
    for (frame, what) in [
        (bytes(0x2F, 0), "answer to command 0x2F"),
        (bytes(0x40, 1), "answer to a read with a value"),
    ] {
        let answer = probe.access_frame(frame, index, sub)?;
        same(what, answer, refused)?;
    }
    let from = probe.heard.len();
    probe.send_frame(bytes(0x80, 0));
    probe.pass(50);
    let answers = probe.heard.iter().skip(from).filter(|heard| {
        matches!(
            heard.message,
            FromRig::ConfigValue { .. } | FromRig::ConfigWritten { .. } | FromRig::ConfigRefused { .. }
        )
    });
    same("answers to an abort", answers.count(), 0)?;
    Ok("0x05040001".to_owned())
}

fn limit_ranges(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let result = every_range(probe);
    probe.write_limits(&Limits::defaults())?;
    result.map(|()| format!("{LIMIT_COUNT} limits, both ends"))
}

fn every_range(probe: &mut Probe) -> Result<(), String> {
    for (i, limit) in LIMITS.iter().enumerate() {
        let object = (object::LIMITS, i as u8 + 1);
        for value in [limit.lowest, limit.highest] {
            let what = format!("write of {} = {value}", limit.name);
            same(&what, probe.try_write(object, value as u32)?, Ok(()))?;
            same(
                &format!("{} read back", limit.name),
                probe.read(object)? as i32,
                value,
            )?;
        }
        for value in [limit.lowest - 1, limit.highest + 1] {
            let what = format!("write of {} = {value}", limit.name);
            same(
                &what,
                probe.try_write(object, value as u32)?,
                Err(ConfigAbort::Range),
            )?;
            same(
                &format!("{} afterwards", limit.name),
                probe.read(object)? as i32,
                limit.highest,
            )?;
        }
    }
    Ok(())
}

fn configuration_crc(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let mut limits = Limits::defaults();
    for force_max_counts in [limits.force_max_counts, 31_415] {
        limits.force_max_counts = force_max_counts;
        probe.write_limits(&limits)?;
        let crc = probe.read(object::CONFIGURATION_CRC)?;
        if crc != limits.crc32() {
            return Err(format!("{crc:#010x} instead of {:#010x}", limits.crc32()));
        }
    }
    probe.write_limits(&Limits::defaults())?;
    Ok(format!("{:#010x}", Limits::defaults().crc32()))
}

fn calibration_hash(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let hash = probe.read(object::CALIBRATION_HASH)?;
    // The same value, so that a power cut in this moment costs nothing.
    let answer = probe.try_write(object::CALIBRATION_HASH, hash)?;
    same("write of the calibration hash", answer, Ok(()))?;
    same("hash read back", probe.read(object::CALIBRATION_HASH)?, hash)?;
    let none = if hash == 0 {
        ", none stored: the daemon will not arm"
    } else {
        ""
    };
    Ok(format!("{hash:#010x}{none}"))
}
