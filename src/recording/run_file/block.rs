//! The bytes of one sample block: packed little-endian records and their CRC-32.
//!
//! A record is 40 bytes: tick offset from the block's first tick u32 · force counts i32 · displacement counts i32 ·
//! command f64 · twin force in N f64 (NaN = off) · cycle u32 · segment u32 · flags u16 · mode u8 (0 none, 1 displacement,
//! 2 force) · zero u8. Physical values are not stored: the counts and the calibration of the header give exactly
//! the same values again.

use crate::recording::{Flags, Header, Sample};
use crate::units::{Command, Mode};

/// Size of one packed sample in bytes.
pub(super) const RECORD_BYTES: usize = 40;

static CRC32: crc::Crc<u32, crc::Table<16>> = crc::Crc::<u32, crc::Table<16>>::new(&crc::CRC_32_ISO_HDLC);

/// CRC-32 (ISO-HDLC) of plain bytes.
pub(super) fn crc32(bytes: &[u8]) -> u32 {
    CRC32.checksum(bytes)
}

/// A CRC-32 over several fields.
pub(super) struct Digest(crc::Digest<'static, u32, crc::Table<16>>);

impl Digest {
    /// The digest of nothing.
    pub(super) fn new() -> Digest {
        Digest(CRC32.digest())
    }

    /// Adds a number as 8 bytes, little-endian.
    pub(super) fn word(&mut self, word: u64) {
        self.0.update(&word.to_le_bytes());
    }

    /// Adds plain bytes.
    pub(super) fn bytes(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// The checksum of all that was added.
    pub(super) fn finish(self) -> u32 {
        self.0.finalize()
    }
}

/// CRC-32 of a block and of its place in the file, so that a block in the wrong row is found as well.
pub(super) fn block_crc32(seq: u64, first_tick: u64, count: u64, data: &[u8]) -> u32 {
    let mut digest = Digest::new();
    for word in [seq, first_tick, count] {
        digest.word(word);
    }
    digest.bytes(data);
    digest.finish()
}

/// Appends one record. The caller keeps `sample.tick - first_tick` within 32 bits.
pub(super) fn pack(sample: &Sample, first_tick: u64, out: &mut Vec<u8>) {
    let offset = (sample.tick - first_tick) as u32;
    let (mode, command) = match sample.command {
        None => (0u8, 0.0),
        Some(Command::Displacement(mm)) => (1, mm),
        Some(Command::Force(n)) => (2, n),
    };
    out.extend_from_slice(&offset.to_le_bytes());
    out.extend_from_slice(&sample.force_counts.to_le_bytes());
    out.extend_from_slice(&sample.displacement_counts.to_le_bytes());
    out.extend_from_slice(&command.to_le_bytes());
    out.extend_from_slice(&sample.twin_force_n.unwrap_or(f64::NAN).to_le_bytes());
    out.extend_from_slice(&sample.cycle.to_le_bytes());
    out.extend_from_slice(&sample.segment.to_le_bytes());
    out.extend_from_slice(&sample.flags.bits().to_le_bytes());
    out.extend_from_slice(&[mode, 0]);
}

/// Turns one record back into a sample. The first tick of the run gives the time, the calibration of the header the values.
pub(super) fn unpack(
    record: &[u8; RECORD_BYTES],
    block_first_tick: u64,
    run_first_tick: u64,
    header: &Header,
) -> Sample {
    let tick = block_first_tick + u64::from(u32::from_le_bytes(field(record, 0)));
    let force_counts = i32::from_le_bytes(field(record, 4));
    let displacement_counts = i32::from_le_bytes(field(record, 8));
    let command = f64::from_le_bytes(field(record, 12));
    let twin_force_n = f64::from_le_bytes(field(record, 20));
    let [mode] = field(record, 38);
    Sample {
        tick,
        time_s: tick.saturating_sub(run_first_tick) as f64 / header.sample_rate_hz,
        force_n: header.force_channel.value(force_counts),
        displacement_mm: header.displacement_channel.value(displacement_counts),
        force_counts,
        displacement_counts,
        command: match mode {
            1 => Some(Command::new(Mode::Displacement, command)),
            2 => Some(Command::new(Mode::Force, command)),
            _ => None,
        },
        cycle: u32::from_le_bytes(field(record, 28)),
        segment: u32::from_le_bytes(field(record, 32)),
        twin_force_n: (!twin_force_n.is_nan()).then_some(twin_force_n),
        flags: Flags::from_bits_retain(u16::from_le_bytes(field(record, 36))),
    }
}

/// `N` bytes of a record; offsets are constants of this file, all within the 40 bytes.
fn field<const N: usize>(record: &[u8; RECORD_BYTES], at: usize) -> [u8; N] {
    std::array::from_fn(|i| record[at + i])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::run_file::test_support::{header, sample};

    #[test]
    fn a_packed_sample_comes_back_bit_for_bit() {
        let header = header();
        for i in [0u64, 1, 17, 4_000_000_000] {
            let mut original = sample(1_000 + i);
            original.twin_force_n = (i != 1).then_some(-1.0 / 3.0);
            original.command = match i {
                0 => None,
                1 => Some(Command::Force(0.1)),
                _ => Some(Command::Displacement(-6.0)),
            };
            let mut bytes = Vec::new();
            pack(&original, 1_000, &mut bytes);
            let record: [u8; RECORD_BYTES] = bytes.try_into().unwrap();
            assert_eq!(unpack(&record, 1_000, 0, &header), original);
        }
    }

    #[test]
    fn the_crc_detects_every_flipped_byte_and_a_moved_block() {
        let data = vec![7u8; RECORD_BYTES];
        let good = block_crc32(3, 1_000, 1, &data);
        assert_ne!(good, block_crc32(4, 1_000, 1, &data));
        assert_ne!(good, block_crc32(3, 1_001, 1, &data));
        for i in 0..data.len() {
            let mut bad = data.clone();
            bad[i] ^= 0x10;
            assert_ne!(good, block_crc32(3, 1_000, 1, &bad), "byte {i}");
        }
    }
}
