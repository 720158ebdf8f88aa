//! Notes on the input: what is imperfect about an instrument or a recording, how large it is, and what was done about it.

use serde::Serialize;

/// What a note is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NoteKind {
    /// The sign of a channel.
    Polarity,
    /// The zero of a channel.
    Zero,
    /// Time without samples.
    Gap,
    /// Single samples that are far off.
    Spike,
    /// Hum or vibration of one frequency.
    Hum,
    /// Noise that is slower than white noise.
    Colour,
    /// Delay between the channels.
    Skew,
    /// A channel that stands at the end of its range.
    Clipping,
    /// A recording that starts within a cycle.
    Start,
    /// Recordings that disagree beyond their noise.
    Disagreement,
    /// A device that the baseline cannot be.
    Device,
}

/// What was done about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NoteAction {
    /// The samples or their weights were corrected.
    Corrected,
    /// The samples concerned are not compared.
    Masked,
    /// Nothing is concluded from the recording.
    Refused,
    /// The recording was used as it is.
    Told,
}

impl NoteKind {
    /// The kind as in `diagnosis.json`.
    pub(crate) fn word(self) -> &'static str {
        match self {
            NoteKind::Polarity => "polarity",
            NoteKind::Zero => "zero",
            NoteKind::Gap => "gap",
            NoteKind::Spike => "spike",
            NoteKind::Hum => "hum",
            NoteKind::Colour => "colour",
            NoteKind::Skew => "skew",
            NoteKind::Clipping => "clipping",
            NoteKind::Start => "start",
            NoteKind::Disagreement => "disagreement",
            NoteKind::Device => "device",
        }
    }
}

impl NoteAction {
    /// The action as in `diagnosis.json`.
    pub(crate) fn word(self) -> &'static str {
        match self {
            NoteAction::Corrected => "corrected",
            NoteAction::Masked => "masked",
            NoteAction::Refused => "refused",
            NoteAction::Told => "told",
        }
    }
}

/// A size with its unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct NoteSize {
    /// The number, in `unit`.
    pub value: f64,
    /// Unit as text: `N`, `mm`, `s`, `ms`, `samples`.
    pub unit: &'static str,
}

/// One note on one recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Note {
    /// Name of the recording.
    pub recording: String,
    /// What it is about.
    pub kind: NoteKind,
    /// How large it is.
    pub size: NoteSize,
    /// What was done about it.
    pub done: NoteAction,
    /// One sentence: what, where, what to do.
    pub text: String,
}

impl Note {
    /// A note; `size` is a number and its unit.
    pub(super) fn new(
        recording: &str,
        kind: NoteKind,
        size: (f64, &'static str),
        done: NoteAction,
        text: String,
    ) -> Note {
        Note {
            recording: recording.to_owned(),
            kind,
            size: NoteSize {
                value: size.0,
                unit: size.1,
            },
            done,
            text,
        }
    }
}
