//! One error for all calls of the library: in words, with what a program can act on.

use std::io;
use std::path::Path;

use crate::archive::ArchiveError;
use crate::cli::CliError;
use crate::config::ConfigError;
use crate::daemon::chain;
use crate::daemon::library::LibraryError;
use crate::diagnose::{ConditionError, DiagnoseError};
use crate::identify::IdentifyError;
use crate::profile::ProfileError;
use crate::recording::RecordingError;
use crate::recording::csv::CsvError;
use crate::recording::run_file::RunFileError;

/// Error numbers of the operating system: no such file, and an error of the device.
const ENOENT: i32 = 2;
const EIO: i32 = 5;

/// What kind of error it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FailureKind {
    /// The input cannot be used.
    Input,
    /// A file cannot be read or written.
    File {
        /// Error number of the operating system.
        os_error: i32,
    },
    /// [`CancelFlag::cancel`](crate::CancelFlag::cancel) was called.
    Cancelled,
    /// A defect of leafbench.
    Defect,
}

/// Why a call gave no result.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{text}")]
pub struct CallFailure {
    /// What kind of error it is.
    pub kind: FailureKind,
    /// What is wrong, where, and what to do.
    pub text: String,
    /// File or recording.
    pub file: Option<String>,
    /// Line of the file from 1; the header of a CSV is row 1.
    pub row: Option<u64>,
    /// Column of a CSV, or key of a bench file.
    pub column: Option<String>,
}

impl CallFailure {
    /// Input that has no place in a file.
    pub(crate) fn input(text: String) -> CallFailure {
        CallFailure {
            kind: FailureKind::Input,
            text,
            file: None,
            row: None,
            column: None,
        }
    }

    fn at(self, file: &str, row: Option<u64>, column: Option<&str>) -> CallFailure {
        CallFailure {
            file: Some(file.to_owned()),
            row,
            column: column.map(str::to_owned),
            ..self
        }
    }

    /// A file that could not be read. Without the error of the system, the file itself tells whether it is there.
    fn of_file(self, path: &Path, error: Option<&io::Error>) -> CallFailure {
        let known = error.and_then(io::Error::raw_os_error);
        // What is there and still refused (a folder, a pipe) is the wrong input.
        let there = path.exists();
        let kind = match known {
            Some(os_error) => FailureKind::File { os_error },
            None if !there => FailureKind::File { os_error: ENOENT },
            None if error.is_some_and(|e| e.kind() != io::ErrorKind::InvalidInput) => {
                FailureKind::File { os_error: EIO }
            }
            None => FailureKind::Input,
        };
        CallFailure { kind, ..self }.at(&path.display().to_string(), None, None)
    }
}

impl From<CsvError> for CallFailure {
    fn from(error: CsvError) -> CallFailure {
        let failure = CallFailure::input(chain(&error));
        match &error {
            CsvError::Io { name, source } => failure.of_file(Path::new(name), Some(source)),
            _ => {
                let (name, row, column) = error.place();
                failure.at(name, Some(row), column)
            }
        }
    }
}

impl From<RunFileError> for CallFailure {
    fn from(error: RunFileError) -> CallFailure {
        let failure = CallFailure::input(chain(&error));
        match &error {
            RunFileError::Io { path, source, .. } => failure.of_file(path, Some(source)),
            RunFileError::Database { path, .. } => CallFailure {
                kind: FailureKind::File { os_error: EIO },
                ..failure
            }
            .at(&path.display().to_string(), None, None),
            RunFileError::NotARun { path, .. } => failure.of_file(path, None),
            RunFileError::Version { path, .. } | RunFileError::Damaged { path, .. } => {
                failure.at(&path.display().to_string(), None, None)
            }
            _ => failure,
        }
    }
}

impl From<ArchiveError> for CallFailure {
    fn from(error: ArchiveError) -> CallFailure {
        let failure = CallFailure::input(chain(&error));
        match error {
            ArchiveError::NoArchive { place } => failure.of_file(Path::new(&place), None),
            ArchiveError::Store { place, .. } => CallFailure {
                kind: FailureKind::File { os_error: EIO },
                ..failure
            }
            .at(&place, None, None),
            ArchiveError::Read { path, source } => failure.of_file(&path, Some(&source)),
            ArchiveError::RunFile(error) => error.into(),
            ArchiveError::Parquet { .. } => CallFailure {
                kind: FailureKind::Defect,
                ..failure
            },
            _ => failure,
        }
    }
}

impl From<ConfigError> for CallFailure {
    fn from(error: ConfigError) -> CallFailure {
        let failure = CallFailure::input(chain(&error));
        match &error {
            ConfigError::Read { path, .. } => failure.of_file(path, None),
            ConfigError::Invalid {
                origin, line, key, ..
            } => failure.at(origin, Some(*line as u64), Some(key)),
        }
    }
}

impl From<ProfileError> for CallFailure {
    fn from(error: ProfileError) -> CallFailure {
        let failure = CallFailure::input(chain(&error));
        match &error {
            ProfileError::File { name, line, .. } => failure.at(name, Some(*line as u64), None),
            _ => failure,
        }
    }
}

impl From<LibraryError> for CallFailure {
    fn from(error: LibraryError) -> CallFailure {
        let failure = CallFailure::input(chain(&error));
        match error {
            LibraryError::File { path, .. } => failure.of_file(&path, None),
            LibraryError::Folder { path, source } => failure.of_file(&path, Some(&source)),
            LibraryError::Profile(error) => error.into(),
            _ => failure,
        }
    }
}

impl From<DiagnoseError> for CallFailure {
    fn from(error: DiagnoseError) -> CallFailure {
        let failure = CallFailure::input(chain(&error));
        match &error {
            DiagnoseError::Cancelled => CallFailure {
                kind: FailureKind::Cancelled,
                ..failure
            },
            DiagnoseError::Condition(
                ConditionError::TooShort { name, .. }
                | ConditionError::Flat { name, .. }
                | ConditionError::Malformed { name, .. }
                | ConditionError::Polarity { name, .. },
            ) => failure.at(name, None, None),
            _ => failure,
        }
    }
}

impl From<RecordingError> for CallFailure {
    fn from(error: RecordingError) -> CallFailure {
        let failure = CallFailure::input(error.to_string());
        failure.at(&error.name, None, Some(error.column))
    }
}

impl From<IdentifyError> for CallFailure {
    fn from(error: IdentifyError) -> CallFailure {
        let failure = CallFailure::input(chain(&error));
        match &error {
            IdentifyError::Recording { name, .. } => failure.at(name, None, None),
            _ => failure,
        }
    }
}

impl From<CliError> for CallFailure {
    fn from(error: CliError) -> CallFailure {
        let failure = CallFailure::input(chain(&error));
        match error {
            CliError::Archive(error) => error.into(),
            CliError::Csv(error) => error.into(),
            CliError::RunFile(error) => error.into(),
            CliError::Config(error) => error.into(),
            CliError::Profile(error) => error.into(),
            CliError::Library(error) => error.into(),
            CliError::Diagnose(error) => error.into(),
            CliError::Identify(error) => error.into(),
            CliError::File { path, source, .. } => failure.of_file(&path, Some(&source)),
            CliError::Internal(_) => CallFailure {
                kind: FailureKind::Defect,
                ..failure
            },
            _ => failure,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{find_bench, read_recording};
    use super::*;

    fn failed(name: &str, text: Option<&str>) -> CallFailure {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join(name);
        if let Some(text) = text {
            std::fs::write(&path, text).expect("written");
        }
        read_recording(&path).expect_err("refused")
    }

    #[test]
    fn a_broken_row_has_file_row_and_column() {
        let failure = failed("a.csv", Some("time_s,displacement_mm,force_n\n0,1,2\n1,2,high\n"));
        assert_eq!(failure.kind, FailureKind::Input);
        assert!(
            failure.file.as_deref().is_some_and(|f| f.ends_with("a.csv")),
            "{failure:?}"
        );
        assert_eq!(
            (failure.row, failure.column.as_deref()),
            (Some(3), Some("force_n"))
        );
    }

    #[test]
    fn a_missing_file_is_told_from_one_that_is_no_recording() {
        let missing = FailureKind::File { os_error: ENOENT };
        assert_eq!(failed("a.csv", None).kind, missing);
        assert_eq!(failed("a.leafrun", None).kind, missing);
        assert_eq!(failed("a.leafrun", Some("no database")).kind, FailureKind::Input);
        let folder = tempfile::tempdir().expect("a folder");
        let refused = read_recording(folder.path()).expect_err("a folder");
        assert_eq!(refused.kind, FailureKind::Input, "{refused:?}");
    }

    #[test]
    fn a_key_of_a_bench_that_is_wrong_has_its_line() {
        let folder = tempfile::tempdir().expect("a folder");
        let refused = find_bench(Some("name = \"a\"\nlimit = 3\n"), folder.path()).expect_err("refused");
        assert_eq!(refused.kind, FailureKind::Input);
        assert!(refused.row.is_some() && refused.column.is_some(), "{refused:?}");
    }
}
