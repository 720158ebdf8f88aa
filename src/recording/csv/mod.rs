//! The recording CSV of docs/formats.md: `writer` writes samples, `recording_writer` a whole recording, `reader` reads files of
//! this bench and of other programs.

mod error;
mod reader;
mod recording_writer;
mod rows;
mod writer;

pub(crate) use error::CsvError;
#[cfg(any(test, feature = "benchmarks"))]
pub(crate) use reader::read;
pub use reader::read_file;
pub(crate) use recording_writer::write_recording;
pub(super) use writer::push_fixed;
pub(crate) use writer::{CsvFormat, CsvWriter};

/// Columns that every recording must have.
pub(crate) const NEEDED: [&str; 3] = ["time_s", "displacement_mm", "force_n"];
