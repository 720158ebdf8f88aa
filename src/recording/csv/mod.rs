//! The CSV of contracts.md: `writer` makes it from samples, `reader` takes it from this bench or from anywhere else.

mod error;
mod reader;
mod rows;
mod writer;

pub(crate) use error::CsvError;
#[cfg(any(test, feature = "benchmarks"))]
pub(crate) use reader::read;
pub(crate) use reader::read_file;
pub(super) use writer::push_fixed;
pub(crate) use writer::{CsvFormat, CsvWriter};

/// Columns that every recording needs.
pub(crate) const NEEDED: [&str; 3] = ["time_s", "displacement_mm", "force_n"];
