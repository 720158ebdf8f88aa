//! The mean over the complete counted cycles without a hold, tick by tick from the start of the cycle.

use std::io::{self, Write};

use crate::recording::columns::Cell;
use crate::recording::csv::CsvFormat;
use crate::recording::run_file::{CycleSpan, RunFile, Survey};
use crate::recording::{Flags, Sample};
use crate::units::Mode;

/// The mode of the mean command: none if the run used both modes, because the mean has no unit then.
pub(super) fn command_mode(survey: &Survey) -> Option<Mode> {
    match survey.modes.as_slice() {
        [mode] => Some(*mode),
        _ => None,
    }
}

/// Names of the columns in the order in which they are written.
pub(super) fn columns(mode: Option<Mode>) -> Vec<&'static str> {
    let mut columns = vec!["time_s", "displacement_mm", "force_n"];
    columns.extend(mode.map(|mode| match mode {
        Mode::Displacement => "command_mm",
        Mode::Force => "command_n",
    }));
    columns.extend(["twin_force_n", "cycles_averaged"]);
    columns
}

/// One row of the mean loop: sums over the cycles that have a usable sample at this tick.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct MeanLoopBin {
    pub count: u32,
    pub displacement_mm: f64,
    pub force_n: f64,
    pub command: f64,
    pub commands: u32,
    pub twin_force_n: f64,
    pub twins: u32,
}

impl MeanLoopBin {
    fn add(&mut self, sample: &Sample) {
        self.count += 1;
        self.displacement_mm += sample.displacement_mm;
        self.force_n += sample.force_n;
        if let Some(command) = sample.command {
            self.command += command.value();
            self.commands += 1;
        }
        if let Some(twin_force_n) = sample.twin_force_n {
            self.twin_force_n += twin_force_n;
            self.twins += 1;
        }
    }

    /// Fills `row` with the means, in the order of [`columns`]. The bin has at least one sample.
    pub(super) fn cells(&self, time_s: f64, mode: Option<Mode>, row: &mut Vec<Cell>) {
        let mean = |sum: f64, count: u32| Cell::finite((count > 0).then(|| sum / f64::from(count)));
        row.clear();
        row.push(Cell::Number(time_s));
        row.push(mean(self.displacement_mm, self.count));
        row.push(mean(self.force_n, self.count));
        if mode.is_some() {
            row.push(mean(self.command, self.commands));
        }
        row.push(mean(self.twin_force_n, self.twins));
        row.push(Cell::Whole(self.count));
    }
}

/// One bin for each tick after the start of a cycle. Their number is the median length of a cycle in ticks.
pub(crate) fn mean_bins(run: &RunFile, survey: &Survey) -> Vec<MeanLoopBin> {
    let complete: Vec<CycleSpan> = survey.unbroken_cycles().copied().collect();
    let mut lengths: Vec<u64> = complete
        .iter()
        .map(|span| span.last_tick - span.first_tick + 1)
        .collect();
    lengths.sort_unstable();
    let median = lengths.get(lengths.len() / 2).copied().unwrap_or(0);
    let mut bins = vec![MeanLoopBin::default(); median as usize];
    let mut spans = complete.iter().peekable();
    for sample in run.samples() {
        while spans.next_if(|span| span.last_tick < sample.tick).is_some() {}
        let Some(span) = spans.peek().filter(|span| span.first_tick <= sample.tick) else {
            continue;
        };
        if let Some(bin) = bins.get_mut((sample.tick - span.first_tick) as usize)
            && !sample.flags.intersects(Flags::UNUSABLE)
        {
            bin.add(&sample);
        }
    }
    bins
}

/// Writes the mean loop as CSV; the number of rows, and the columns.
pub(super) fn write_csv(
    sink: &mut impl Write,
    run: &RunFile,
    survey: &Survey,
    format: &CsvFormat,
) -> io::Result<(u64, Vec<&'static str>)> {
    let mode = command_mode(survey);
    let columns = columns(mode);
    write!(sink, "{}\r\n", columns.join(","))?;
    let mut rows = 0;
    // A mean has finer steps than a count: one decimal more than for single samples.
    let (mm, n) = (
        format.displacement_decimals as usize + 1,
        format.force_decimals as usize + 1,
    );
    for (i, bin) in mean_bins(run, survey)
        .iter()
        .enumerate()
        .filter(|(_, bin)| bin.count > 0)
    {
        let count = f64::from(bin.count);
        let time_s = i as f64 / run.header().sample_rate_hz;
        let (x, f) = (bin.displacement_mm / count, bin.force_n / count);
        write!(
            sink,
            "{time_s:.*},{x:.mm$},{f:.n$}",
            format.time_decimals as usize
        )?;
        if let Some(mode) = mode {
            let decimals = if mode == Mode::Displacement { mm } else { n };
            write_mean(sink, bin.command, bin.commands, decimals)?;
        }
        write_mean(sink, bin.twin_force_n, bin.twins, n)?;
        write!(sink, ",{}\r\n", bin.count)?;
        rows += 1;
    }
    Ok((rows, columns))
}

/// Writes a cell with a mean; the cell is empty without a value.
fn write_mean(sink: &mut impl Write, sum: f64, count: u32, decimals: usize) -> io::Result<()> {
    match count {
        0 => write!(sink, ","),
        _ => write!(sink, ",{:.decimals$}", sum / f64::from(count)),
    }
}
