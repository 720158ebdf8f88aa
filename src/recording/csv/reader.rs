//! Reads a CSV of this bench or of another program into a [`Recording`]: columns by name in any order, unknown ones ignored.
//! `rows` splits the bytes into rows.
//!
//! The file is read as a stream. Apart from the columns kept, the memory used is bounded for any input.

use std::io::Read;
use std::path::Path;

use csv::ByteRecord;

use super::rows::Rows;
use super::{CsvError, NEEDED};
use crate::recording::Recording;
use crate::regular_file;
use crate::units::Mode;

/// Largest number of samples: 14 hours at 1 kHz, about 2 GB in memory.
const ROW_LIMIT: usize = 50_000_000;
/// Messages show at most this many characters of a cell.
const SHOWN_CHARS: usize = 40;

/// Wrong units that occur: stem of the column, ending of its unit, factor to the unit of docs/formats.md.
const OTHER_UNITS: &[(&str, &str, f64)] = &[
    ("time", "ms", 1e-3),
    ("time", "us", 1e-6),
    ("time", "min", 60.0),
    ("displacement", "m", 1e3),
    ("displacement", "cm", 10.0),
    ("displacement", "um", 1e-3),
    ("displacement", "in", 25.4),
    ("force", "kn", 1e3),
    ("force", "mn", 1e6),
    ("force", "kgf", 9.80665),
    ("force", "lbf", 4.448_221_615_260_5),
];

/// Reads a CSV file.
pub fn read_file(path: &Path) -> Result<Recording, CsvError> {
    let name = path.display().to_string();
    match regular_file::open(path) {
        Ok(file) => read(&name, file),
        Err(source) => Err(CsvError::Io { name, source }),
    }
}

/// Reads a CSV from any source; `name` is for messages.
pub(crate) fn read(name: &str, source: impl Read) -> Result<Recording, CsvError> {
    let mut rows = Rows::new(name, source);
    let mut record = ByteRecord::new();
    if !rows.next(&mut record)? {
        return Err(CsvError::Empty { name: name.into() });
    }
    let columns = Columns::find(name, &record)?;
    let mut recording = columns.empty_recording(name);
    while rows.next(&mut record)? {
        if recording.len() >= ROW_LIMIT {
            return Err(CsvError::TooManyRows {
                name: name.into(),
                row: rows.row(&record),
                limit: ROW_LIMIT,
            });
        }
        let row = CsvRow {
            name,
            record: &record,
            row: rows.row(&record),
        };
        columns.push(&row, &mut recording)?;
    }
    if recording.is_empty() {
        return Err(CsvError::NoRows { name: name.into() });
    }
    columns.choose_command(&mut recording);
    Ok(recording)
}

/// Index of each column that is read.
struct Columns {
    needed: [usize; 3],
    command_mm: Option<usize>,
    command_n: Option<usize>,
    cycle: Option<usize>,
    flags: Option<usize>,
}

impl Columns {
    fn find(name: &str, header: &ByteRecord) -> Result<Columns, CsvError> {
        let mut names = Vec::with_capacity(header.len());
        for cell in header {
            let text = std::str::from_utf8(cell).ok().filter(|text| !text.contains('\0'));
            names.push(text.ok_or_else(|| CsvError::NotText {
                name: name.into(),
                row: 1,
            })?);
        }
        let found = |column: &str| names.iter().position(|&there| there == column);
        for (i, &column) in names.iter().enumerate() {
            if !column.is_empty() && found(column) != Some(i) {
                return Err(CsvError::DuplicateColumn {
                    name: name.into(),
                    column: shown(column),
                });
            }
        }
        let mut needed = [0; 3];
        for (place, column) in needed.iter_mut().zip(NEEDED) {
            *place = found(column).ok_or_else(|| missing(name, column, &names))?;
        }
        Ok(Columns {
            needed,
            command_mm: found("command_mm"),
            command_n: found("command_n"),
            cycle: found("cycle"),
            flags: found("flags"),
        })
    }

    fn empty_recording(&self, name: &str) -> Recording {
        Recording {
            name: name.to_owned(),
            command: self.command_mm.or(self.command_n).map(|_| Vec::new()),
            command_mode: None,
            cycle: self.cycle.map(|_| Vec::new()),
            flags: self.flags.map(|_| Vec::new()),
            ..Recording::default()
        }
    }

    fn push(&self, row: &CsvRow, recording: &mut Recording) -> Result<(), CsvError> {
        let [time, displacement, force] = self.needed;
        let time_s = row.number(time, "time_s")?;
        if let Some(&before_s) = recording.time_s.last()
            && time_s <= before_s
        {
            return Err(CsvError::TimeNotRising {
                name: row.name.into(),
                row: row.row,
                time_s,
                before_s,
            });
        }
        recording.time_s.push(time_s);
        recording
            .displacement_mm
            .push(row.number(displacement, "displacement_mm")?);
        recording.force_n.push(row.number(force, "force_n")?);
        self.push_command(row, recording)?;
        if let (Some(at), Some(cycle)) = (self.cycle, &mut recording.cycle) {
            cycle.push(row.whole(at, "cycle", u32::MAX)?);
        }
        if let (Some(at), Some(flags)) = (self.flags, &mut recording.flags) {
            flags.push(row.whole(at, "flags", u32::from(u16::MAX))? as u16);
        }
        Ok(())
    }

    /// The mode of the first command in the file is the recording's; commands of the other mode are left out.
    fn push_command(&self, row: &CsvRow, recording: &mut Recording) -> Result<(), CsvError> {
        let Some(command) = &mut recording.command else {
            return Ok(());
        };
        let mut value = f64::NAN;
        let columns = [
            (self.command_mm, "command_mm", Mode::Displacement),
            (self.command_n, "command_n", Mode::Force),
        ];
        for (at, column, mode) in columns {
            let Some(at) = at.filter(|&at| !row.cell(at).is_empty()) else {
                continue;
            };
            let number = row.number(at, column)?;
            if *recording.command_mode.get_or_insert(mode) == mode {
                value = number;
            }
        }
        command.push(value);
        Ok(())
    }

    /// A command column without any command is left out.
    fn choose_command(&self, recording: &mut Recording) {
        if recording.command_mode.is_none() {
            recording.command = None;
        }
    }
}

fn missing(name: &str, column: &'static str, names: &[&str]) -> CsvError {
    let name = name.to_owned();
    if let [only] = names
        && let Some(separator) = [';', '\t', '|'].into_iter().find(|&c| only.contains(c))
    {
        return CsvError::Separator { name, separator };
    }
    for there in names {
        let lower = there.to_ascii_lowercase();
        let other = OTHER_UNITS.iter().find(|(stem, unit, _)| {
            column.starts_with(stem)
                && lower.strip_prefix(stem).and_then(|rest| rest.strip_prefix('_')) == Some(unit)
        });
        if let Some(&(_, _, factor)) = other {
            return CsvError::WrongUnit {
                name,
                column,
                found: shown(there),
                factor,
            };
        }
    }
    CsvError::MissingColumn {
        name,
        column,
        found: shown(&names.join(", ")),
    }
}

/// One row with its file and row number for messages.
struct CsvRow<'a> {
    name: &'a str,
    record: &'a ByteRecord,
    row: u64,
}

impl CsvRow<'_> {
    fn cell(&self, at: usize) -> &[u8] {
        self.record.get(at).unwrap_or_default()
    }

    fn number(&self, at: usize, column: &'static str) -> Result<f64, CsvError> {
        let cell = self.cell(at);
        let parsed = std::str::from_utf8(cell)
            .ok()
            .and_then(|text| text.parse::<f64>().ok());
        match parsed {
            Some(value) if value.is_finite() => Ok(value),
            _ => Err(self.refuse(cell, column, parsed.is_some())),
        }
    }

    fn whole(&self, at: usize, column: &'static str, most: u32) -> Result<u32, CsvError> {
        let value = self.number(at, column)?;
        if value.fract() == 0.0 && (0.0..=f64::from(most)).contains(&value) {
            return Ok(value as u32);
        }
        Err(CsvError::NotANumber {
            name: self.name.into(),
            row: self.row,
            column,
            text: shown(&String::from_utf8_lossy(self.cell(at))),
            wanted: format!("a whole number from 0 to {most}"),
        })
    }

    fn refuse(&self, cell: &[u8], column: &'static str, not_finite: bool) -> CsvError {
        let (name, row) = (self.name.to_owned(), self.row);
        let text = shown(&String::from_utf8_lossy(cell));
        if cell.is_empty() {
            CsvError::EmptyCell { name, row, column }
        } else if not_finite {
            CsvError::NotFinite {
                name,
                row,
                column,
                text,
            }
        } else if text.contains(',') && text.replace(',', ".").parse::<f64>().is_ok() {
            CsvError::DecimalComma {
                name,
                row,
                column,
                text,
            }
        } else if cell.contains(&0) {
            CsvError::NotText { name, row }
        } else {
            CsvError::NotANumber {
                name,
                row,
                column,
                text,
                wanted: "a number".into(),
            }
        }
    }
}

/// A text for a message, cut after [`SHOWN_CHARS`] characters.
fn shown(text: &str) -> String {
    let mut short: String = text.chars().take(SHOWN_CHARS).collect();
    if short.len() < text.len() {
        short.push_str("...");
    }
    short
}

#[cfg(test)]
mod tests {
    use std::io;

    use proptest::prelude::*;

    use super::*;

    const HEAD: &str = "time_s,displacement_mm,force_n\n";

    fn message(text: &str) -> String {
        read("r.csv", text.as_bytes()).unwrap_err().to_string()
    }

    #[test]
    fn columns_of_another_program_are_found_in_any_order() {
        let text = "\u{feff}note,force_n, displacement_mm ,time_s\r\n\"a, \"\"b\"\"\",-1.5,2e-1,0\r\nc,\"3\",4,0.5\r\n";
        let recording = read("foreign.csv", text.as_bytes()).unwrap();
        assert_eq!(recording.time_s, [0.0, 0.5]);
        assert_eq!(recording.displacement_mm, [0.2, 4.0]);
        assert_eq!(recording.force_n, [-1.5, 3.0]);
        assert_eq!(
            (recording.command, recording.cycle, recording.flags),
            (None, None, None)
        );
    }

    #[test]
    fn the_columns_of_this_bench_are_read() {
        let text = "time_s,displacement_mm,force_n,command_mm,command_n,cycle,segment,twin_force_n,flags\n\
                    0,1,2,,,0,1,,1\n1,1,2,,5.5,3,1,7,0\n2,1,2,4,,3,1,7,0\n";
        let recording = read("own.csv", text.as_bytes()).unwrap();
        assert_eq!(recording.command_mode, Some(Mode::Force));
        let command = recording.command.unwrap();
        assert!(command[0].is_nan() && command[1] == 5.5 && command[2].is_nan());
        assert_eq!(recording.cycle, Some(vec![0, 3, 3]));
        assert_eq!(recording.flags, Some(vec![1, 0, 0]));
    }

    /// A text and a part of the message that it is refused with.
    const HEADER_MISTAKES: &[(&str, &str)] = &[
        ("", "row 1: the file is empty"),
        (HEAD, "row 2: there are no samples"),
        (
            "time_s,force_n\n0,1\n",
            "column displacement_mm is missing, the file has time_s, force_n",
        ),
        (
            "time_s,displacement_mm,force_kN\n",
            "force_kN has the wrong unit, force_n is needed: multiply it by 1000",
        ),
        (
            "time_s,displacement_m,force_n\n",
            "displacement_m has the wrong unit",
        ),
        ("time_ms,displacement_mm,force_n\n", "multiply it by 0.001"),
        (
            "time_s;displacement_mm;force_n\n0;1;2\n",
            "row 1: the columns are separated by ';'",
        ),
        (
            "time_s,time_s,displacement_mm,force_n\n",
            "row 1: duplicate column time_s",
        ),
        (
            "time_s,displacement_mm,force_n,cycle\n0,1,2,-1\n",
            "row 2, column cycle: \"-1\" is not a whole number from 0 to 4294967295",
        ),
        (
            "time_s,displacement_mm,force_n,flags\n0,1,2,70000\n",
            "row 2, column flags: \"70000\" is not a whole number from 0 to 65535",
        ),
    ];

    /// Rows after [`HEAD`] and a part of the message that they are refused with.
    const ROW_MISTAKES: &[(&str, &str)] = &[
        ("0,1,2\n1,2\n", "row 3: the row has 2 cells and the header has 3"),
        ("0,1,\n", "row 2, column force_n: the cell is empty"),
        (
            "0,\"1,5\",2\n",
            "row 2, column displacement_mm: \"1,5\" has a decimal comma",
        ),
        (
            "0,1,NaN\n",
            "row 2, column force_n: \"NaN\" is not a finite number",
        ),
        ("0,1,1e999\n", "not a finite number"),
        ("0,1,=1+1\n", "\"=1+1\" is not a number"),
        ("0,1,2\n\n0,1,2\n", "row 4, column time_s: 0 s comes after 0 s"),
        ("0,1,2\n-1,1,2\n", "-1 s comes after 0 s"),
        ("0,1,2\r\n\r\n0,1,2", "row 4, column time_s: 0 s comes after 0 s"),
        ("0,1,2\r\n1,2", "row 3: the row has 2 cells"),
        ("0,1,\0\n", "row 2: this is not UTF-8 text"),
    ];

    #[test]
    fn p8_every_mistake_is_told_with_row_column_and_advice() {
        let headers = HEADER_MISTAKES
            .iter()
            .map(|&(text, wanted)| (message(text), wanted));
        let rows = ROW_MISTAKES
            .iter()
            .map(|&(rows, wanted)| (message(&format!("{HEAD}{rows}")), wanted));
        for (got, wanted) in headers.chain(rows) {
            assert!(got.contains(wanted), "{got:?} should say {wanted:?}");
        }
        let binary = read("r.bin", &b"SQLite format 3\0\x10\0\xff"[..]).unwrap_err();
        assert!(matches!(binary, CsvError::NotText { row: 1, .. }), "{binary}");
    }

    /// Fault P8: 10 GB without a line end, and 10 GB within one quoted cell, end at the cap.
    #[test]
    fn an_endless_line_ends_at_the_cap() {
        let endless = io::repeat(b'7').take(10 << 30);
        let error = read("r.csv", endless).unwrap_err();
        assert!(matches!(error, CsvError::LineTooLong { row: 1, .. }), "{error}");
        let quoted = HEAD
            .as_bytes()
            .chain(&b"0,1,\""[..])
            .chain(io::repeat(b'\n').take(10 << 30));
        assert!(matches!(read("r.csv", quoted), Err(CsvError::LineTooLong { .. })));
    }

    proptest! {
        #[test]
        fn any_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            let _ = read("r.csv", bytes.as_slice());
        }

        #[test]
        fn any_rows_never_panic(rows in "[-0-9.,e\"\\n\\r;aN\u{0}]{0,200}") {
            let _ = read("r.csv", format!("{HEAD}{rows}").as_bytes());
        }

        /// Three cells that may be no number, or a time that does not rise, in any row.
        #[test]
        fn rows_are_read_as_they_are_or_refused(
            rows in proptest::collection::vec((-1..20_i32, prop_oneof![9 => -1e3..1e3_f64, 1 => Just(f64::NAN)], -1e6..1e6_f64), 1..5)
        ) {
            let mut text = HEAD.to_owned();
            let mut time = 0;
            let mut times = Vec::new();
            for (step, mm, n) in &rows {
                time += step;
                times.push(f64::from(time));
                text += &format!("{time},{mm},{n}\n");
            }
            let rises = times.windows(2).all(|w| w[0] < w[1]);
            let finite = rows.iter().all(|row| row.1.is_finite());
            match read("r.csv", text.as_bytes()) {
                Ok(recording) => {
                    prop_assert!(rises && finite, "{}", text);
                    prop_assert_eq!(recording.time_s, times);
                    let force_n: Vec<f64> = rows.iter().map(|row| row.2).collect();
                    prop_assert_eq!(recording.force_n, force_n);
                    prop_assert_eq!(recording.displacement_mm.len(), rows.len());
                }
                Err(error) => prop_assert!(!(rises && finite), "{}: {}", text, error),
            }
        }
    }
}
