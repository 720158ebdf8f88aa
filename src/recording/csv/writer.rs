//! Writes samples as CSV rows with a fixed number of decimals, enough to recover every count.

use std::io::{self, Write};

use crate::recording::{Header, Sample};
use crate::units::Mode;

/// Largest number of decimals that is useful with a double.
const MOST_DECIMALS: u32 = 9;

/// Columns of a CSV and their number of decimals.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct CsvFormat {
    /// Number of decimals of `time_s`.
    pub time_decimals: u32,
    /// Number of decimals of columns in mm.
    pub displacement_decimals: u32,
    /// Number of decimals of columns in N.
    pub force_decimals: u32,
    /// One command column for each mode that the run used, in this order.
    pub command_modes: Vec<Mode>,
}

impl CsvFormat {
    /// Takes the decimals from the calibration and the sample rate of the header.
    pub(crate) fn new(header: &Header, command_modes: &[Mode]) -> CsvFormat {
        CsvFormat {
            time_decimals: time_decimals(header.sample_rate_hz),
            displacement_decimals: decimals(header.displacement_channel.scale_per_count),
            force_decimals: decimals(header.force_channel.scale_per_count),
            command_modes: command_modes.to_vec(),
        }
    }

    /// Names of the columns in the order in which they are written.
    pub(crate) fn columns(&self) -> Vec<&'static str> {
        let mut columns = vec!["time_s", "displacement_mm", "force_n"];
        columns.extend(self.command_modes.iter().map(|mode| match mode {
            Mode::Displacement => "command_mm",
            Mode::Force => "command_n",
        }));
        columns.extend(["cycle", "segment", "twin_force_n", "flags"]);
        columns
    }

    /// Number of decimals of a command in this mode.
    pub(in crate::recording) fn mode_decimals(&self, mode: Mode) -> u32 {
        match mode {
            Mode::Displacement => self.displacement_decimals,
            Mode::Force => self.force_decimals,
        }
    }
}

/// Decimals for a quarter of a count or finer: rounding then never gives another count, for any tare.
fn decimals(scale_per_count: f64) -> u32 {
    (0..MOST_DECIMALS)
        .find(|&d| 10f64.powi(-(d as i32)) <= scale_per_count.abs() / 4.0)
        .unwrap_or(MOST_DECIMALS)
}

/// Decimals that make the sample period exact (1 kHz: 3); nanoseconds if no number of decimals does.
fn time_decimals(sample_rate_hz: f64) -> u32 {
    (0..MOST_DECIMALS)
        .find(|&d| {
            let ticks = 10f64.powi(d as i32) / sample_rate_hz;
            ticks >= 1.0 && ticks.fract() == 0.0
        })
        .unwrap_or(MOST_DECIMALS)
}

/// Writes the header row and one row per sample into a sink.
pub(crate) struct CsvWriter<W: Write> {
    sink: W,
    format: CsvFormat,
    row: Vec<u8>,
    rows: u64,
}

impl<W: Write> CsvWriter<W> {
    /// Writes the header row.
    pub(crate) fn new(mut sink: W, format: CsvFormat) -> io::Result<CsvWriter<W>> {
        sink.write_all(format.columns().join(",").as_bytes())?;
        sink.write_all(b"\r\n")?;
        Ok(CsvWriter {
            sink,
            format,
            row: Vec::with_capacity(160),
            rows: 0,
        })
    }

    /// Writes one row.
    pub(crate) fn sample(&mut self, sample: &Sample) -> io::Result<()> {
        let (row, format) = (&mut self.row, &self.format);
        row.clear();
        push_fixed(row, sample.time_s, format.time_decimals);
        row.push(b',');
        push_fixed(row, sample.displacement_mm, format.displacement_decimals);
        row.push(b',');
        push_fixed(row, sample.force_n, format.force_decimals);
        for &mode in &format.command_modes {
            row.push(b',');
            if let Some(command) = sample.command.filter(|command| command.mode() == mode) {
                push_fixed(row, command.value(), format.mode_decimals(mode));
            }
        }
        row.push(b',');
        push_unsigned(row, sample.cycle.into());
        row.push(b',');
        push_unsigned(row, sample.segment.into());
        row.push(b',');
        if let Some(force_n) = sample.twin_force_n {
            push_fixed(row, force_n, format.force_decimals);
        }
        row.push(b',');
        push_unsigned(row, sample.flags.bits().into());
        row.extend_from_slice(b"\r\n");
        self.sink.write_all(row)?;
        self.rows += 1;
        Ok(())
    }

    /// Number of rows written, without the header row.
    pub(crate) fn rows(&self) -> u64 {
        self.rows
    }
}

/// Appends a number with a fixed number of decimals, rounded to nearest; nothing if it is not finite.
pub(in crate::recording) fn push_fixed(out: &mut Vec<u8>, value: f64, decimals: u32) {
    let unit = 10u64.pow(decimals);
    let scaled = (value.abs() * unit as f64).round();
    // Beyond 2^53 a double has no such decimals: the standard formatter writes it.
    if scaled.is_nan() || scaled >= 9e15 {
        if value.is_finite() {
            out.extend_from_slice(format!("{value:.*}", decimals as usize).as_bytes());
        }
        return;
    }
    let scaled = scaled as u64;
    if value < 0.0 && scaled > 0 {
        out.push(b'-');
    }
    push_unsigned(out, scaled / unit);
    if decimals > 0 {
        out.push(b'.');
        let fraction = scaled % unit;
        let mut place = unit / 10;
        while place > 0 {
            out.push(b'0' + (fraction / place % 10) as u8);
            place /= 10;
        }
    }
}

fn push_unsigned(out: &mut Vec<u8>, mut value: u64) {
    let start = out.len();
    loop {
        out.push(b'0' + (value % 10) as u8);
        value /= 10;
        if value == 0 {
            break;
        }
    }
    out[start..].reverse();
}

#[cfg(test)]
mod tests {
    use super::super::super::run_file::test_support::{header, sample};
    use super::*;

    fn fixed(value: f64, decimals: u32) -> String {
        let mut out = Vec::new();
        push_fixed(&mut out, value, decimals);
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn numbers_have_fixed_decimals_and_no_negative_zero() {
        assert_eq!(fixed(-1.5, 3), "-1.500");
        assert_eq!(fixed(-0.0004, 3), "0.000");
        assert_eq!(fixed(0.9996, 3), "1.000");
        assert_eq!(fixed(12.0, 0), "12");
        assert_eq!(fixed(f64::NAN, 3), "");
        assert_eq!(fixed(-1e300, 0).len(), 302);
    }

    #[test]
    fn decimals_follow_from_the_calibration() {
        let format = CsvFormat::new(&header(), &[Mode::Force, Mode::Displacement]);
        assert_eq!(
            (
                format.time_decimals,
                format.displacement_decimals,
                format.force_decimals
            ),
            (3, 4, 2)
        );
        assert_eq!(
            format.columns().join(","),
            "time_s,displacement_mm,force_n,command_n,command_mm,cycle,segment,twin_force_n,flags"
        );
        assert_eq!(time_decimals(800.0), 5);
        assert_eq!(time_decimals(3000.0), MOST_DECIMALS);
    }

    #[test]
    fn every_count_is_recovered_from_the_decimals() {
        let head = header();
        for counts in -30_000..30_000 {
            let mm = fixed(head.displacement_channel.value(counts), 4).parse().unwrap();
            assert_eq!(head.displacement_channel.counts(mm), counts);
            let n = fixed(head.force_channel.value(counts), 2).parse().unwrap();
            assert_eq!(head.force_channel.counts(n), counts);
        }
    }

    #[test]
    fn a_row_has_the_documented_form() {
        let mut out = Vec::new();
        let format = CsvFormat::new(&header(), &[Mode::Displacement]);
        let mut writer = CsvWriter::new(&mut out, format).unwrap();
        let mut s = sample(1);
        writer.sample(&s).unwrap();
        (s.command, s.twin_force_n) = (None, None);
        writer.sample(&s).unwrap();
        let text = String::from_utf8(out).unwrap();
        let rows: Vec<&str> = text.split("\r\n").collect();
        assert_eq!(rows[1], "0.001,0.0252,-71.39,0.0377,1,1,-72.39,0");
        assert_eq!(rows[2], "0.001,0.0252,-71.39,,1,1,,0");
    }
}
