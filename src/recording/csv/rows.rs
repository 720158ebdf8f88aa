//! Splits a CSV into rows of equal length, with bounded memory, each with its row number. `reader` reads the cells.

use std::io::{self, Read};

use csv::{ByteRecord, ErrorKind, ReaderBuilder, Terminator, Trim};

use super::CsvError;

/// Largest size of a row in bytes, its quoted cells included.
const LINE_LIMIT_BYTES: usize = 1 << 20;

/// The rows of a file. Blank lines are skipped, but they count in the row number.
pub(super) struct Rows<'a, R: Read> {
    name: &'a str,
    reader: csv::Reader<Capped<io::Chain<R, &'static [u8]>>>,
    width: Option<usize>,
}

impl<'a, R: Read> Rows<'a, R> {
    pub(super) fn new(name: &'a str, source: R) -> Self {
        let capped = Capped {
            // A last line without a line end gets one, so that the row number is right there too.
            source: source.chain(&b"\n"[..]),
            left: LINE_LIMIT_BYTES,
        };
        // Only \n ends a line and \r is trimmed: with both as line ends the line count of the reader is one too low.
        let reader = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .terminator(Terminator::Any(b'\n'))
            .trim(Trim::All)
            .from_reader(capped);
        Rows {
            name,
            reader,
            width: None,
        }
    }

    /// Reads the next row that is not blank; false at the end of the file.
    pub(super) fn next(&mut self, record: &mut ByteRecord) -> Result<bool, CsvError> {
        loop {
            self.reader.get_mut().left = LINE_LIMIT_BYTES;
            match self.reader.read_byte_record(record) {
                Ok(false) => return Ok(false),
                Ok(true) if record.len() == 1 && record.get(0).is_some_and(<[u8]>::is_empty) => {}
                Ok(true) => break,
                Err(error) => return Err(self.translated(error)),
            }
        }
        let expected = *self.width.get_or_insert(record.len());
        if record.len() == expected {
            return Ok(true);
        }
        Err(CsvError::Ragged {
            name: self.name.to_owned(),
            row: self.row(record),
            expected: expected as u64,
            found: record.len() as u64,
        })
    }

    /// Line of the file on which the row just read begins.
    pub(super) fn row(&self, record: &ByteRecord) -> u64 {
        let within = record.as_slice().iter().filter(|&&byte| byte == b'\n').count() as u64;
        self.reader.position().line().saturating_sub(1 + within)
    }

    fn translated(&self, error: csv::Error) -> CsvError {
        let name = self.name.to_owned();
        match error.into_kind() {
            ErrorKind::Io(source) if source.kind() == io::ErrorKind::FileTooLarge => CsvError::LineTooLong {
                name,
                row: self.reader.position().line(),
                limit: LINE_LIMIT_BYTES,
            },
            ErrorKind::Io(source) => CsvError::Io { name, source },
            other => CsvError::Io {
                name,
                source: io::Error::other(format!("{other:?}")),
            },
        }
    }
}

/// Fails when a row is too long. The CSV reader buffers 8 KiB, so the limit is exact to 8 KiB only.
struct Capped<R> {
    source: R,
    left: usize,
}

impl<R: Read> Read for Capped<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.left == 0 {
            return Err(io::ErrorKind::FileTooLarge.into());
        }
        let most = buffer.len().min(self.left);
        let got = self.source.read(buffer.get_mut(..most).unwrap_or_default())?;
        self.left -= got;
        Ok(got)
    }
}
