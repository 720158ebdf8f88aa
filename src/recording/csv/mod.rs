//! The CSV of contracts.md: `writer` makes it from samples, `reader` takes it from this bench or from anywhere else.

mod error;
mod reader;
mod rows;
mod writer;

pub use error::CsvError;
pub use reader::{read, read_file};
pub(super) use writer::push_fixed;
pub use writer::{CsvFormat, CsvWriter};

/// Columns that every recording needs.
pub const NEEDED: [&str; 3] = ["time_s", "displacement_mm", "force_n"];
