//! A run as a table, for formats that hold doubles: every number as it was computed, without rounding.

use std::io;

use super::{Selection, mean_loop};
use crate::recording::Sample;
use crate::recording::columns::{self, Cell, Column};
use crate::recording::csv::CsvFormat;
use crate::recording::run_file::{RunFile, Survey};
use crate::units::Mode;

/// The columns and rows of a part of a run.
pub(super) struct Table<'a> {
    pub run: &'a RunFile,
    pub survey: &'a Survey,
    pub selection: Selection,
    /// The columns in order; the first one is the time.
    pub columns: Vec<&'static Column>,
}

impl<'a> Table<'a> {
    pub(super) fn new(run: &'a RunFile, survey: &'a Survey, selection: Selection) -> Table<'a> {
        let names = match selection {
            Selection::MeanLoop => mean_loop::columns(mean_loop::command_mode(survey)),
            _ => CsvFormat::new(run.header(), &survey.modes).columns(),
        };
        Table {
            run,
            survey,
            selection,
            columns: names.into_iter().filter_map(columns::find).collect(),
        }
    }

    /// Gives the rows in order to `take`, each with one cell for each column; the number of rows.
    pub(super) fn for_each(&self, mut take: impl FnMut(&[Cell]) -> io::Result<()>) -> io::Result<u64> {
        let (mut row, mut rows) = (Vec::with_capacity(self.columns.len()), 0);
        if self.selection == Selection::MeanLoop {
            let mode = mean_loop::command_mode(self.survey);
            let rate_hz = self.run.header().sample_rate_hz;
            for (i, bin) in mean_loop::mean_bins(self.run, self.survey).iter().enumerate() {
                if bin.count > 0 {
                    bin.cells(i as f64 / rate_hz, mode, &mut row);
                    take(&row)?;
                    rows += 1;
                }
            }
            return Ok(rows);
        }
        for sample in self.run.samples().filter(self.selection.filter(self.survey)) {
            cells(&sample, &self.survey.modes, &mut row);
            take(&row)?;
            rows += 1;
        }
        Ok(rows)
    }
}

/// Fills `row` with the cells of one sample, in the order of [`CsvFormat::columns`].
fn cells(sample: &Sample, modes: &[Mode], row: &mut Vec<Cell>) {
    row.clear();
    row.push(Cell::Number(sample.time_s));
    row.push(Cell::Number(sample.displacement_mm));
    row.push(Cell::Number(sample.force_n));
    for &mode in modes {
        let command = sample.command.filter(|command| command.mode() == mode);
        row.push(Cell::finite(command.map(|command| command.value())));
    }
    row.push(Cell::Whole(sample.cycle));
    row.push(Cell::Whole(sample.segment));
    row.push(Cell::finite(sample.twin_force_n));
    row.push(Cell::Whole(sample.flags.bits().into()));
}
