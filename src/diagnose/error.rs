//! Why there is no diagnosis. All reasons are errors of the input or of the machine, and each says what to do.

use crate::effect::EffectError;
use crate::model::BuildError;

/// Why there is no diagnosis. All reasons are errors of the input. An unexplained difference is a verdict, not an error.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum DiagnoseError {
    #[error("no recording was given: name at least one")]
    NoRecording,
    /// A recording cannot be used.
    #[error(transparent)]
    Condition(#[from] ConditionError),
    /// The baseline cannot be used.
    #[error(transparent)]
    Baseline(#[from] BaselineError),
    /// The baseline has no finite force at these displacements.
    #[error(
        "the baseline gives no finite force for these recordings: check sign and zero of the displacement"
    )]
    OutOfDomain,
    /// [`DiagnoseOptions::cancel`](super::DiagnoseOptions) was set.
    #[error("the diagnosis was cancelled: start it again")]
    Cancelled,
    /// The operating system refused the worker threads.
    #[error("the worker threads could not be started ({0}): close other programs and try again")]
    Threads(String),
}

/// Why a recording cannot be used.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum ConditionError {
    /// Too few samples without a flag.
    #[error("{name}: {have} usable samples, at least {least} are needed: record longer")]
    TooShort {
        name: String,
        have: usize,
        /// Number of usable samples that a recording needs.
        least: usize,
    },
    /// Columns of different length, values that are not finite, or time that does not rise.
    #[error("{name}, row {row}: {reason}")]
    Malformed {
        name: String,
        /// Row in the file; the header is row 1.
        row: usize,
        /// What is wrong and what to do.
        reason: &'static str,
    },
    /// A channel that does not move.
    #[error("{name}: the {channel} does not change: check the channel and its sign")]
    Flat {
        name: String,
        /// `displacement` or `force`.
        channel: &'static str,
    },
    /// A channel whose sign is turned.
    #[error(
        "{name}: loading the spring must raise displacement_mm and force_n, but {what}: turn the sign with --flip {sign}"
    )]
    Polarity {
        name: String,
        /// What the recording shows.
        what: String,
        /// Channels whose sign is turned.
        sign: TurnedSign,
    },
}

/// Channels whose sign is turned, displayed as the argument of `--flip` that repairs it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TurnedSign {
    Force,
    Displacement,
    Both,
}

impl std::fmt::Display for TurnedSign {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            TurnedSign::Force => "force",
            TurnedSign::Displacement => "displacement",
            TurnedSign::Both => "force,displacement",
        })
    }
}

/// Why a baseline cannot be used.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum BaselineError {
    /// The model refuses the structure or the start values.
    #[error("the baseline cannot be built")]
    Build(#[from] BuildError),
    /// A known code is not a code of physics (`docs/formats.md`).
    #[error("known physics")]
    Known(#[from] EffectError),
}
