//! Writes a table as an ASAM MDF 4.1 file (MF4): one channel group with the time as its master, attachments and events.
//! `block` lays out any block, `parts` fills each kind of them. What is in the table is the caller's.
//!
//! The samples are the last block of the file. Its length and the number of samples are written at the end.

mod block;
mod parts;

use std::io::{self, Seek, SeekFrom, Write};

use self::block::{HEAD_BYTES, MdfBlocks};
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
        let mut blocks = MdfBlocks::default();
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

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::recording::columns;

    /// Reads numbers and links at places of a file.
    struct Bytes(Vec<u8>);

    impl Bytes {
        fn at<const N: usize>(&self, place: u64) -> [u8; N] {
            self.0[place as usize..place as usize + N].try_into().unwrap()
        }

        fn u64(&self, place: u64) -> u64 {
            u64::from_le_bytes(self.at(place))
        }

        fn u32(&self, place: u64) -> u32 {
            u32::from_le_bytes(self.at(place))
        }

        /// Address of the block that a link leads to; its kind is as wanted.
        fn link(&self, block: u64, place: u64, kind: &[u8; 4]) -> u64 {
            let to = self.u64(block + 24 + 8 * place);
            assert_eq!(&self.at::<4>(to), kind, "link {place} of the block at {block}");
            to
        }

        fn text(&self, block: u64) -> &str {
            let content = &self.0[block as usize + 24..(block + self.u64(block + 8)) as usize];
            let end = content.iter().position(|&byte| byte == 0).unwrap();
            std::str::from_utf8(&content[..end]).unwrap()
        }
    }

    /// Two samples of time, command and flags, with one attachment and two marks. The second command is empty.
    fn file() -> Bytes {
        let mark = |time_s, name: &str| Mark {
            time_s,
            name: name.to_owned(),
            comment: "a < b",
        };
        let head = MdfHead {
            start_ns: 1_700_000_000_000_000_005,
            title: "ramp & hold",
            program_version: "1.2",
            properties: &[("subject", "leaf <7>".to_owned())],
            group: "samples",
            columns: &["time_s", "command_mm", "flags"].map(|name| columns::find(name).unwrap()),
            attachments: &[Attachment {
                name: "a.txt",
                mime_type: "text/plain",
                comment: "three bytes",
                bytes: b"abc",
            }],
            marks: &[mark(-0.1, "start"), mark(1.5, "end")],
        };
        let mut file = Cursor::new(Vec::new());
        let mut writer = MdfWriter::begin(&mut file, &head).unwrap();
        writer
            .row(&[Cell::Number(0.5), Cell::Number(3.0), Cell::Whole(7)])
            .unwrap();
        writer
            .row(&[Cell::Number(1.0), Cell::Empty, Cell::Whole(0)])
            .unwrap();
        assert_eq!(writer.finish().unwrap(), 2);
        Bytes(file.into_inner())
    }

    #[test]
    fn header_history_and_group_are_where_the_standard_wants_them() {
        let file = file();
        assert_eq!((file.at(64), file.u64(72), file.u64(80)), (*b"##HD", 104, 6));
        assert_eq!(
            file.u64(64 + 72),
            1_700_000_000_000_000_005,
            "the start after 6 links"
        );
        assert_eq!(file.at(64 + 84), [2], "the offsets to UTC are valid: zero");
        let comment = file.text(file.link(64, 5, b"##MD"));
        assert!(
            comment.contains("<TX>ramp &amp; hold</TX>")
                && comment.contains("<e name=\"subject\">leaf &lt;7&gt;</e>"),
            "{comment}"
        );
        let history = file.link(64, 1, b"##FH");
        assert_eq!(file.u64(history + 8), 56);
        assert!(
            file.text(file.link(history, 1, b"##MD"))
                .contains("<tool_version>1.2</tool_version>")
        );
        let data_group = file.link(64, 0, b"##DG");
        assert_eq!((file.u64(data_group + 8), file.u64(data_group + 24)), (64, 0));
        let group = file.link(data_group, 1, b"##CG");
        assert_eq!(file.u64(group + 8), 104);
        assert_eq!(file.u64(group + 80), 2, "samples");
        assert_eq!((file.u32(group + 96), file.u32(group + 100)), (18, 1), "bytes");
        assert_eq!(file.text(file.link(group, 2, b"##TX")), "samples");
    }

    #[test]
    fn channels_say_where_their_bits_are() {
        let file = file();
        let group = file.link(file.link(64, 0, b"##DG"), 1, b"##CG");
        let time = file.link(group, 1, b"##CN");
        let command = file.link(time, 0, b"##CN");
        let flags = file.link(command, 0, b"##CN");
        assert_eq!((file.u64(time + 8), file.u64(flags + 24)), (160, 0));
        // Kind, synchronisation, type, first bit; byte, bits, flags, invalidation bit.
        let layout = |at: u64| (file.at(at + 88), [92, 96, 100, 104].map(|p| file.u32(at + p)));
        assert_eq!(layout(time), ([2, 1, 4, 0], [0, 64, 0, 0]));
        assert_eq!(layout(command), ([0, 0, 4, 0], [8, 64, 2, 0]));
        assert_eq!(layout(flags), ([0, 0, 0, 0], [16, 16, 0, 0]));
        assert_eq!(file.text(file.link(command, 2, b"##TX")), "command_mm");
        assert_eq!(file.text(file.link(command, 6, b"##TX")), "mm");
    }

    #[test]
    fn samples_are_the_last_block() {
        let file = file();
        let samples = file.link(file.link(64, 0, b"##DG"), 2, b"##DT");
        assert_eq!(file.u64(samples + 8), 24 + 2 * 19);
        let mut wanted = Vec::new();
        wanted.extend([0.5_f64.to_le_bytes(), 3.0_f64.to_le_bytes()].concat());
        wanted.extend([7, 0, 0]);
        wanted.extend([1.0_f64.to_le_bytes(), f64::NAN.to_le_bytes()].concat());
        wanted.extend([0, 0, 1]);
        assert_eq!(file.0[samples as usize + 24..], wanted);
    }

    #[test]
    fn attachments_have_their_md5_and_marks_their_time() {
        let file = file();
        let attachment = file.link(64, 3, b"##AT");
        assert_eq!(file.u64(attachment + 8), 96 + 3);
        assert_eq!(file.at(attachment + 56), [5, 0], "embedded, with MD5");
        // MD5 of "abc", from RFC 1321.
        let md5 = 0x9001_5098_3cd2_4fb0_d696_3f7d_28e1_7f72_u128;
        assert_eq!(u128::from_be_bytes(file.at(attachment + 64)), md5);
        assert_eq!((file.u64(attachment + 80), file.u64(attachment + 88)), (3, 3));
        assert_eq!(&file.at::<3>(attachment + 96), b"abc");
        let first = file.link(64, 4, b"##EV");
        let second = file.link(first, 0, b"##EV");
        assert_eq!((file.u64(first + 8), file.u64(second + 24)), (96, 0));
        assert_eq!(file.at(first + 64), [6, 1, 0, 0]);
        assert_eq!(i64::from_le_bytes(file.at(first + 80)), -100_000_000);
        assert_eq!(f64::from_le_bytes(file.at(second + 88)), 1e-9);
        assert_eq!(file.text(file.link(second, 3, b"##TX")), "end");
        assert_eq!(file.text(file.link(second, 4, b"##TX")), "a < b");
    }
}
