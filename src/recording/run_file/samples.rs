//! Samples of a run file one by one. Blocks that cannot be read and ticks without a sample are noted as gaps.

use rusqlite::{Connection, OptionalExtension};

use super::block::{self, RECORD_BYTES};
use super::layout::Totals;
use crate::recording::{Flags, Header, Sample, Unsaved};

/// If the number of blocks is not known, blocks are looked up one by one until this many in a row are missing.
const MISSING_BLOCKS_AT_END: u64 = 4096;

/// Why ticks have no sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum GapCause {
    /// The sample did not arrive from the rig.
    Lost,
    /// The sample was recorded; its block is damaged.
    Damaged,
    /// The sample was recorded, but the disk could not be written.
    Unsaved,
}

/// A range of ticks without a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub(crate) struct Gap {
    /// First tick without a sample.
    pub from_tick: u64,
    /// Last tick without a sample. At the damaged end of an open run only a lower bound is known.
    pub to_tick: u64,
    pub cause: GapCause,
}

impl Gap {
    /// Number of ticks in the gap.
    pub(crate) fn ticks(&self) -> u64 {
        (self.to_tick + 1).saturating_sub(self.from_tick)
    }
}

/// The database of a run file with what is needed to read its samples.
#[derive(Debug)]
pub(super) struct Blocks {
    pub database: Connection,
    pub header: Header,
    /// What the file has; `None` if this row is damaged.
    pub totals: Option<Totals>,
    /// Number of blocks; `None` if it is not known.
    pub count: Option<u64>,
    /// Samples that were recorded and did not get into the file.
    pub unsaved: Option<Unsaved>,
}

impl Blocks {
    /// All readable samples in the order of ticks, with one block at a time in memory.
    pub(super) fn samples(&self) -> SampleReader<'_> {
        let totals = self.totals.unwrap_or_default();
        SampleReader {
            blocks: self,
            next_block: 1,
            last_block: self.last(),
            missing: 0,
            data: Vec::new(),
            block_first_tick: 0,
            at: 0,
            next_tick: totals.first_tick,
            zero_tick: totals.zero_tick,
            unreadable: false,
            gaps: Vec::new(),
        }
    }

    /// Number of the last block, if the file still has it.
    pub(super) fn last(&self) -> Option<u64> {
        self.count.or_else(|| self.indexed())
    }

    /// Largest number of a block that SQLite finds; 0 if there are none, `None` if the table cannot be read.
    pub(super) fn indexed(&self) -> Option<u64> {
        let largest = "SELECT coalesce(max(seq), 0) FROM blocks";
        self.database
            .query_row(largest, [], |row| row.get::<_, i64>(0))
            .ok()
            .map(|seq| seq as u64)
    }

    /// A block, if its checksum is correct. It is looked up by its number alone, so that damage to other blocks does not matter.
    pub(super) fn read(&self, seq: u64) -> Option<(u64, Vec<u8>)> {
        let sql = "SELECT first_tick, sample_count, crc32, data FROM blocks WHERE seq = ?1";
        let mut statement = self.database.prepare_cached(sql).ok()?;
        let row = statement.query_row([seq as i64], |row| {
            Ok((
                row.get::<_, i64>(0)?,
                row.get::<_, i64>(1)?,
                row.get::<_, i64>(2)?,
                row.get::<_, Vec<u8>>(3)?,
            ))
        });
        let (first_tick, count, crc32, data) = row.optional().ok().flatten()?;
        let (first_tick, count) = (first_tick as u64, count as u64);
        let good = i64::from(block::block_crc32(seq, first_tick, count, &data)) == crc32
            && count.checked_mul(RECORD_BYTES as u64) == Some(data.len() as u64);
        good.then_some((first_tick, data))
    }
}

/// Iterator over the samples of a run file.
pub(crate) struct SampleReader<'a> {
    blocks: &'a Blocks,
    next_block: u64,
    last_block: Option<u64>,
    missing: u64,
    data: Vec<u8>,
    block_first_tick: u64,
    at: usize,
    /// Tick of the next sample if none is missing.
    next_tick: Option<u64>,
    zero_tick: Option<u64>,
    /// A block since the last good one could not be read.
    unreadable: bool,
    /// Gaps up to the last sample returned; complete after the end of the iterator.
    pub(super) gaps: Vec<Gap>,
}

impl SampleReader<'_> {
    /// Loads the next good block; false at the end.
    fn load(&mut self) -> bool {
        loop {
            match self.last_block {
                Some(last) if self.next_block > last => return false,
                None if self.missing >= MISSING_BLOCKS_AT_END => return false,
                _ => {}
            }
            let seq = self.next_block;
            self.next_block += 1;
            if let Some((first_tick, data)) = self.blocks.read(seq) {
                self.missing = 0;
                self.block_first_tick = first_tick;
                self.data = data;
                self.at = 0;
                return true;
            }
            self.missing += 1;
            self.unreadable = true;
        }
    }

    /// Notes the missing ticks between the last sample and `tick`; true if there are any.
    fn note_gap(&mut self, tick: u64) -> bool {
        let unreadable = std::mem::take(&mut self.unreadable);
        let from_tick = self.next_tick.unwrap_or(tick);
        if tick <= from_tick {
            return false;
        }
        let to_tick = tick - 1;
        let unsaved = self.blocks.unsaved.as_ref();
        let unsaved = unsaved.is_some_and(|u| u.from_tick <= to_tick && from_tick <= u.to_tick);
        self.gaps.push(Gap {
            from_tick,
            to_tick,
            cause: match (unreadable, unsaved) {
                (true, _) => GapCause::Damaged,
                (false, true) => GapCause::Unsaved,
                (false, false) => GapCause::Lost,
            },
        });
        self.next_tick = Some(tick);
        true
    }

    /// Notes damage at the end, up to the last tick in the file if it is known, and the samples that were not saved after it.
    fn note_end(&mut self) {
        let last_tick = self.blocks.totals.and_then(|totals| totals.last_tick);
        let end = match (last_tick, self.next_tick) {
            (Some(last), _) => Some(last + 1),
            (None, Some(next)) if self.last_block.is_some() => Some(next + 1),
            _ => None,
        };
        if let Some(end) = end.filter(|_| self.unreadable) {
            self.note_gap(end);
        }
        if let Some(unsaved) = &self.blocks.unsaved {
            self.next_tick.get_or_insert(unsaved.from_tick);
            self.note_gap(unsaved.to_tick + 1);
        }
    }
}

impl Iterator for SampleReader<'_> {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        loop {
            if let Some(record) = self
                .data
                .get(self.at..)
                .and_then(<[u8]>::first_chunk::<RECORD_BYTES>)
            {
                let zero_tick = *self.zero_tick.get_or_insert(self.block_first_tick);
                let mut sample = block::unpack(record, self.block_first_tick, zero_tick, &self.blocks.header);
                self.at += RECORD_BYTES;
                if self.note_gap(sample.tick) {
                    sample.flags.insert(Flags::AFTER_GAP);
                }
                self.next_tick = Some(sample.tick + 1);
                return Some(sample);
            }
            if !self.load() {
                self.note_end();
                return None;
            }
        }
    }
}
