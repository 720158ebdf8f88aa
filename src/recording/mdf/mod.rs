//! Writes a table as an ASAM MDF 4.1 file (MF4): one channel group with the time as its master, attachments and events.
//! `block` lays out any block, `parts` fills each kind of them. What is in the table is the caller's.
//!
//! The samples are the last block of the file. Its length and the number of samples are written at the end.

mod block;
mod parts;

use std::io::{self, Seek, SeekFrom, Write};

use self::block::{Blocks, HEAD_BYTES};
use super::columns::{Cell, Column};

/// A file that is embedded, with its bytes unchanged.
pub(crate) struct Attachment<'a> {
    /// File name without folder.
    pub name: &'a str,
    pub mime_type: &'a str,
    pub comment: &'a str,
    pub bytes: &'a [u8],
}

/// Something that happened at one moment.
pub(crate) struct Mark<'a> {
    /// Time in s on the axis of the master channel; may be negative.
    pub time_s: f64,
    pub name: String,
    pub comment: &'a str,
}

/// Everything before the samples.
pub(crate) struct MdfHead<'a> {
    /// Time of the first sample: nanoseconds since 1970, UTC.
    pub start_ns: u64,
    /// One line: what was measured.
    pub title: &'a str,
    /// Version of the program that writes.
    pub program_version: &'a str,
    /// Common properties of the header: name and value.
    pub properties: &'a [(&'static str, String)],
    /// Name of the channel group.
    pub group: &'a str,
    /// The channels; the first one is the time in s and the master of the group.
    pub columns: &'a [&'static Column],
    pub attachments: &'a [Attachment<'a>],
    /// Marks in the order of time.
    pub marks: &'a [Mark<'a>],
}

/// Writes the samples of one file.
pub(crate) struct MdfWriter<W> {
    sink: W,
    columns: Vec<&'static Column>,
    /// The record of one sample; kept between samples.
    record: Vec<u8>,
    records: u64,
    /// Address of the number of samples.
    cycle_count_at: u64,
    /// Address of the block of samples.
    data_at: u64,
}

impl<W: Write + Seek> MdfWriter<W> {
    /// Writes everything before the samples.
    pub(crate) fn begin(mut sink: W, head: &MdfHead) -> io::Result<MdfWriter<W>> {
        let mut blocks = Blocks::default();
        let file = parts::add_all(&mut blocks, head);
        blocks.write(&mut sink)?;
        Ok(MdfWriter {
            sink,
            columns: head.columns.to_vec(),
            record: Vec::new(),
            records: 0,
            cycle_count_at: blocks.address(file.group) + parts::BEFORE_CYCLE_COUNT,
            data_at: blocks.address(file.data),
        })
    }

    /// Writes one sample: one cell for each channel. An empty cell is NaN, and its bit says that it is invalid.
    pub(crate) fn row(&mut self, cells: &[Cell]) -> io::Result<()> {
        self.record.clear();
        for (column, cell) in self.columns.iter().zip(cells) {
            parts::push_cell(&mut self.record, column.kind, *cell);
        }
        let invalid_from = self.record.len();
        self.record
            .resize(invalid_from + parts::invalid_bytes(&self.columns), 0);
        let cells = self.columns.iter().zip(cells);
        let bits = cells.filter(|(column, _)| column.may_be_empty()).enumerate();
        for (bit, _) in bits.filter(|(_, (_, cell))| **cell == Cell::Empty) {
            if let Some(byte) = self.record.get_mut(invalid_from + bit / 8) {
                *byte |= 1 << (bit % 8);
            }
        }
        self.sink.write_all(&self.record)?;
        self.records += 1;
        Ok(())
    }

    /// Writes the number of samples and the length of their block to their places, and returns the number.
    pub(crate) fn finish(mut self) -> io::Result<u64> {
        let bytes = HEAD_BYTES + self.records * parts::record_bytes(&self.columns);
        self.sink.seek(SeekFrom::Start(self.cycle_count_at))?;
        self.sink.write_all(&self.records.to_le_bytes())?;
        self.sink
            .seek(SeekFrom::Start(self.data_at + parts::BEFORE_LENGTH))?;
        self.sink.write_all(&bytes.to_le_bytes())?;
        self.sink.seek(SeekFrom::End(0))?;
        Ok(self.records)
    }
}
