//! Writes a recording in memory as CSV, every number with as many digits as it has.

use std::io::{self, Write};

use super::NEEDED;
use crate::recording::Recording;

/// Writes the three columns that every recording has, and the cycles where there are any.
pub(crate) fn write_recording(sink: &mut impl Write, recording: &Recording) -> io::Result<()> {
    let mut header = NEEDED.join(",");
    if recording.cycle.is_some() {
        header.push_str(",cycle");
    }
    write!(sink, "{header}\r\n")?;
    let columns = recording.time_s.iter().zip(&recording.displacement_mm);
    for (i, ((time_s, displacement_mm), force_n)) in columns.zip(&recording.force_n).enumerate() {
        write!(sink, "{time_s},{displacement_mm},{force_n}")?;
        if let Some(cycle) = recording.cycle.as_ref().and_then(|c| c.get(i)) {
            write!(sink, ",{cycle}")?;
        }
        write!(sink, "\r\n")?;
    }
    Ok(())
}
