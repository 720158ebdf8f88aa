//! What a check of the computer says, and the files it reads.

use std::path::{Path, PathBuf};

use serde::Serialize;

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Grade {
    /// As it should be.
    Ok,
    /// The bench works, but worse than it could.
    Warning,
    /// The bench does not work, or cannot be trusted.
    Problem,
}

impl Grade {
    /// The word in the text.
    pub(super) fn word(self) -> &'static str {
        match self {
            Grade::Ok => "ok",
            Grade::Warning => "warning",
            Grade::Problem => "problem",
        }
    }
}

/// One thing that was looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(super) struct DoctorFinding {
    /// What was looked at, in a word or two.
    pub subject: &'static str,
    /// `ok`, `warning` or `problem`.
    pub grade: Grade,
    /// What was found.
    pub what: String,
    /// File, interface or folder where it was found; empty if the sentence says it.
    pub place: String,
    /// What to do; empty if nothing needs to be done.
    pub what_to_do: String,
}

impl DoctorFinding {
    fn new(subject: &'static str, grade: Grade, what: impl Into<String>, to_do: impl Into<String>) -> Self {
        DoctorFinding {
            subject,
            grade,
            what: what.into(),
            place: String::new(),
            what_to_do: to_do.into(),
        }
    }

    /// All is well.
    pub(super) fn ok(subject: &'static str, what: impl Into<String>) -> Self {
        Self::new(subject, Grade::Ok, what, "")
    }

    /// Worse than it could be.
    pub(super) fn warning(
        subject: &'static str,
        what: impl Into<String>,
        what_to_do: impl Into<String>,
    ) -> Self {
        Self::new(subject, Grade::Warning, what, what_to_do)
    }

    /// Does not work, or cannot be trusted.
    pub(super) fn problem(
        subject: &'static str,
        what: impl Into<String>,
        what_to_do: impl Into<String>,
    ) -> Self {
        Self::new(subject, Grade::Problem, what, what_to_do)
    }

    /// The same with the place.
    pub(super) fn at(mut self, place: impl Into<String>) -> Self {
        self.place = place.into();
        self
    }
}

/// The folder that holds `proc`, `sys`, `dev` and `run`: `/`, or a copy that a test made.
#[derive(Debug, Clone)]
pub(super) struct SystemRoot(PathBuf);

impl SystemRoot {
    /// The computer that runs this program.
    pub(super) fn real() -> Self {
        SystemRoot(PathBuf::from("/"))
    }

    /// A computer that consists of the files of a test.
    #[cfg(test)]
    pub(super) fn faked(folder: &Path) -> Self {
        SystemRoot(folder.to_owned())
    }

    /// The path of a file, which is given with or without a slash at its beginning.
    pub(super) fn path(&self, file: impl AsRef<Path>) -> PathBuf {
        let file = file.as_ref();
        self.0.join(file.strip_prefix("/").unwrap_or(file))
    }

    /// Text of a file without the white space at its ends; `None` if it cannot be read.
    pub(super) fn text(&self, file: &str) -> Option<String> {
        let text = std::fs::read_to_string(self.path(file)).ok()?;
        Some(text.trim().to_owned())
    }

    /// A number that is all that a file holds.
    pub(super) fn number(&self, file: &str) -> Option<i64> {
        self.text(file)?.parse().ok()
    }

    /// Whether there is something at this path.
    pub(super) fn has(&self, file: &str) -> bool {
        self.path(file).exists()
    }
}

/// Whether a process has a capability now: `status` is the text of its `/proc/PID/status`.
pub(super) fn has_capability(status: &str, bit: u32) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask & (1 << bit) != 0)
}
