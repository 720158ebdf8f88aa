//! Events of the sample stream before they are put into words. Control passes them on as numbers, because a text would need an
//! allocation on its thread; the recording thread makes the text.

use super::{Event, EventKind};

/// Something that the stream of samples showed at one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct StreamEvent {
    /// The rig's tick.
    pub tick: u64,
    /// Seconds since the run's first sample.
    pub time_s: f64,
    /// What it showed.
    pub finding: StreamFinding,
}

/// What a stream of samples can show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum StreamFinding {
    /// Samples are missing before this one.
    Gap {
        /// Number of missing samples.
        lost: u64,
    },
    /// A cycle ended, and amplitude or mean of the command were corrected. Peak, valley and mean are in N or mm.
    Correction {
        /// The cycle that ended; 0 in a taper.
        cycle: u32,
        peak: f64,
        valley: f64,
        /// New factor on the amplitude of the command.
        amplitude_factor: f64,
        /// New offset of the mean of the command.
        mean_offset: f64,
    },
}

impl StreamEvent {
    /// The event as it is recorded.
    pub(crate) fn in_words(&self) -> Event {
        let (kind, text) = match self.finding {
            StreamFinding::Gap { lost } => (
                EventKind::Gap,
                format!("{lost} samples missing before {:.3} s", self.time_s),
            ),
            StreamFinding::Correction {
                cycle,
                peak,
                valley,
                amplitude_factor,
                mean_offset,
            } => {
                let cycle = match cycle {
                    0 => "an uncounted cycle".to_owned(),
                    number => format!("cycle {number}"),
                };
                let text = format!(
                    "after {cycle} (peak {peak:.4}, valley {valley:.4}): amplitude x {amplitude_factor:.5}, mean {mean_offset:+.4}"
                );
                (EventKind::Correction, text)
            }
        };
        Event {
            tick: self.tick,
            time_s: self.time_s,
            kind,
            text,
        }
    }
}
