//! The content of each kind of block: header, history, group, channels, attachments, events. Numbers are little-endian, in the
//! order of the standard.

use md5::{Digest, Md5};

use super::block::{HEAD_BYTES, MdfBlockId, MdfBlocks};
use super::{Attachment, Mark, MdfHead};
use crate::recording::columns::{Cell, Column, ColumnKind};
use crate::recording::xml::escaped;

/// Place of the link to the next block of a chain.
const NEXT: usize = 0;
/// Bytes of a channel group before its number of samples: head, 6 links, id of the record.
pub(super) const BEFORE_CYCLE_COUNT: u64 = HEAD_BYTES + 6 * 8 + 8;
/// Bytes of any block before its length.
pub(super) const BEFORE_LENGTH: u64 = 8;
/// Flag of a time: the offsets to UTC are given. They are 0.
const OFFSETS_VALID: u8 = 2;
/// Kind of a channel: 0 a value, 2 the master; with synchronisation 1: time.
const MASTER: u8 = 2;
const TIME: u8 = 1;
/// Flag of a channel: it has an invalidation bit.
const INVALIDATION_BIT: u32 = 2;
/// Flags of an attachment: embedded, and its MD5 is given.
const EMBEDDED_WITH_MD5: u16 = 1 | 4;
/// Kind of an event: a marker, without effect on the recording.
const MARKER: u8 = 6;

/// The blocks whose addresses the writer needs.
pub(super) struct Parts {
    /// The channel group.
    pub group: MdfBlockId,
    /// The block of samples: the last one, still empty.
    pub data: MdfBlockId,
}

/// Adds all blocks of a file.
pub(super) fn add_all(blocks: &mut MdfBlocks, head: &MdfHead) -> Parts {
    let header = add_header(blocks, head);
    let history = add_history(blocks, head);
    let group = add_group(blocks, head);
    let attachments: Vec<MdfBlockId> = head
        .attachments
        .iter()
        .map(|a| add_attachment(blocks, a))
        .collect();
    let marks: Vec<MdfBlockId> = head.marks.iter().map(|m| add_mark(blocks, m)).collect();
    // Samples without record ids, because the group is alone: next group, channel group, samples, comment.
    let data_group = blocks.add("DG", vec![None, Some(group), None, None], vec![0; 8]);
    let data = blocks.add("DT", Vec::new(), Vec::new());
    blocks.link(data_group, 2, data);
    // Links of the header: data group, history, hierarchy, attachment, event, comment.
    blocks.link(header, 0, data_group);
    blocks.link(header, 1, history);
    chain(blocks, header, 3, &attachments);
    chain(blocks, header, 4, &marks);
    Parts { group, data }
}

/// Links `from` to the first block and each block to the next one.
fn chain(blocks: &mut MdfBlocks, from: MdfBlockId, place: usize, to: &[MdfBlockId]) {
    let (mut from, mut place) = (from, place);
    for &block in to {
        blocks.link(from, place, block);
        (from, place) = (block, NEXT);
    }
}

/// The header is the first block of the file.
fn add_header(blocks: &mut MdfBlocks, head: &MdfHead) -> MdfBlockId {
    let mut data = head.start_ns.to_le_bytes().to_vec();
    // Two offsets to UTC in minutes, flags of the time, class of the clock (0: of a computer), flags, reserved.
    data.extend([0, 0, 0, 0, OFFSETS_VALID, 0, 0, 0]);
    // Angle and distance at the start: not valid.
    data.extend([0; 16]);
    let header = blocks.add("HD", vec![None; 6], data);
    let properties: String = head
        .properties
        .iter()
        .map(|(name, value)| format!("<e name=\"{name}\">{}</e>", escaped(value)))
        .collect();
    let comment = format!(
        "<TX>{}</TX><common_properties>{properties}</common_properties>",
        escaped(head.title)
    );
    let comment = blocks.xml("HDcomment", &comment);
    blocks.link(header, 5, comment);
    header
}

/// The one entry of the history: which program wrote the file.
fn add_history(blocks: &mut MdfBlocks, head: &MdfHead) -> MdfBlockId {
    let comment = format!(
        "<TX>exported from a run file</TX><tool_id>leafbench</tool_id><tool_vendor>leafbench</tool_vendor>\
         <tool_version>{}</tool_version>",
        escaped(head.program_version)
    );
    let comment = blocks.xml("FHcomment", &comment);
    let mut data = head.start_ns.to_le_bytes().to_vec();
    data.extend([0, 0, 0, 0, OFFSETS_VALID, 0, 0, 0]);
    blocks.add("FH", vec![None, Some(comment)], data)
}

/// The channel group with its channels.
fn add_group(blocks: &mut MdfBlocks, head: &MdfHead) -> MdfBlockId {
    let name = blocks.text(head.group);
    let invalid_bytes = invalid_bytes(head.columns) as u32;
    let data_bytes = record_bytes(head.columns) as u32 - invalid_bytes;
    // Id of the record, number of samples (written at the end), flags, separator of paths, reserved.
    let mut data = vec![0; 24];
    data.extend(data_bytes.to_le_bytes());
    data.extend(invalid_bytes.to_le_bytes());
    let group = blocks.add("CG", vec![None, None, Some(name), None, None, None], data);
    let (mut byte_offset, mut invalid_bit) = (0, 0);
    let mut channels = Vec::new();
    for (place, column) in head.columns.iter().enumerate() {
        let bit = column.may_be_empty().then_some(invalid_bit);
        channels.push(add_channel(blocks, column, place == 0, byte_offset, bit));
        byte_offset += value_bytes(column.kind);
        invalid_bit += u32::from(bit.is_some());
    }
    chain(blocks, group, 1, &channels);
    group
}

/// One channel; `invalid_bit` is the place of its invalidation bit, if it has one.
fn add_channel(
    blocks: &mut MdfBlocks,
    column: &Column,
    is_master: bool,
    byte_offset: u32,
    invalid_bit: Option<u32>,
) -> MdfBlockId {
    let name = blocks.text(column.name);
    let unit = blocks.text(column.unit);
    let comment = blocks.text(column.description);
    // 4: a floating-point number, 0: a whole number without sign; both little-endian.
    let data_type = if column.kind == ColumnKind::Number { 4 } else { 0 };
    let (kind, sync) = if is_master { (MASTER, TIME) } else { (0, 0) };
    let flags = invalid_bit.map_or(0, |_| INVALIDATION_BIT);
    // The last number is the place of the first bit in its byte.
    let mut data = vec![kind, sync, data_type, 0];
    data.extend(byte_offset.to_le_bytes());
    data.extend((8 * value_bytes(column.kind)).to_le_bytes());
    data.extend(flags.to_le_bytes());
    data.extend(invalid_bit.unwrap_or(0).to_le_bytes());
    // Precision, reserved, number of attachments; then six numbers of ranges and limits: not valid.
    data.extend([0; 4 + 6 * 8]);
    // Next channel, structure, name, source, conversion, data, unit, comment.
    let links = vec![
        None,
        None,
        Some(name),
        None,
        None,
        None,
        Some(unit),
        Some(comment),
    ];
    blocks.add("CN", links, data)
}

fn add_attachment(blocks: &mut MdfBlocks, attachment: &Attachment) -> MdfBlockId {
    let name = blocks.text(attachment.name);
    let mime_type = blocks.text(attachment.mime_type);
    let comment = blocks.text(attachment.comment);
    let bytes = (attachment.bytes.len() as u64).to_le_bytes();
    let mut data = EMBEDDED_WITH_MD5.to_le_bytes().to_vec();
    // Index of the history entry that made it, reserved.
    data.extend([0; 6]);
    data.extend(Md5::digest(attachment.bytes));
    // The size of the original and of what is embedded.
    data.extend(bytes);
    data.extend(bytes);
    data.extend(attachment.bytes);
    blocks.add("AT", vec![None, Some(name), Some(mime_type), Some(comment)], data)
}

fn add_mark(blocks: &mut MdfBlocks, mark: &Mark) -> MdfBlockId {
    let name = blocks.text(&mark.name);
    let comment = blocks.text(mark.comment);
    // Marker; its place is a time; a point, no range; cause 0: other; flags; reserved.
    let mut data = vec![MARKER, TIME, 0, 0, 0, 0, 0, 0];
    // No scope, no attachments, first entry of the history.
    data.extend([0; 8]);
    // The time is a whole number of nanoseconds times 1e-9.
    data.extend(((mark.time_s * 1e9).round() as i64).to_le_bytes());
    data.extend(1e-9_f64.to_le_bytes());
    // Next event, parent, end of a range, name, comment.
    blocks.add("EV", vec![None, None, None, Some(name), Some(comment)], data)
}

/// Appends the value of one channel.
pub(super) fn push_cell(record: &mut Vec<u8>, kind: ColumnKind, cell: Cell) {
    let number = match cell {
        Cell::Number(value) => value,
        Cell::Whole(value) => f64::from(value),
        Cell::Empty => f64::NAN,
    };
    // Both conversions are exact: a column of whole numbers has only cells that fit.
    match kind {
        ColumnKind::Number => record.extend(number.to_le_bytes()),
        ColumnKind::Whole32 => record.extend((number as u32).to_le_bytes()),
        ColumnKind::Whole16 => record.extend((number as u16).to_le_bytes()),
    }
}

fn value_bytes(kind: ColumnKind) -> u32 {
    match kind {
        ColumnKind::Number => 8,
        ColumnKind::Whole32 => 4,
        ColumnKind::Whole16 => 2,
    }
}

/// Bytes of the invalidation bits of a record.
pub(super) fn invalid_bytes(columns: &[&Column]) -> usize {
    let bits = columns.iter().filter(|column| column.may_be_empty()).count();
    bits.div_ceil(8)
}

/// Bytes of a record: values and invalidation bits.
pub(super) fn record_bytes(columns: &[&Column]) -> u64 {
    let values = columns.iter().map(|column| u64::from(value_bytes(column.kind)));
    values.sum::<u64>() + invalid_bytes(columns) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::columns;

    fn column(name: &str) -> &'static Column {
        columns::find(name).unwrap()
    }

    #[test]
    fn a_record_has_its_values_and_then_its_invalidation_bits() {
        let columns = ["time_s", "command_mm", "cycle", "twin_force_n", "flags"].map(column);
        // 8 + 8 + 4 + 8 + 2 bytes, and one byte for the bits of command and twin.
        assert_eq!((record_bytes(&columns), invalid_bytes(&columns)), (31, 1));
        let mut record = Vec::new();
        push_cell(&mut record, ColumnKind::Number, Cell::Number(-0.0));
        push_cell(&mut record, ColumnKind::Whole32, Cell::Whole(u32::MAX));
        push_cell(&mut record, ColumnKind::Whole16, Cell::Whole(0x0102));
        assert_eq!(record, [0, 0, 0, 0, 0, 0, 0, 0x80, 255, 255, 255, 255, 2, 1]);
        record.clear();
        push_cell(&mut record, ColumnKind::Number, Cell::Empty);
        assert!(f64::from_le_bytes(record.try_into().unwrap()).is_nan());
    }
}
