//! Failures of the library and panics as exceptions.

use std::any::Any;

use leafbench::{CallFailure, FailureKind, RecordingError};
use pyo3::exceptions::{PyKeyboardInterrupt, PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;

pyo3::create_exception!(
    leafbench,
    InputError,
    PyValueError,
    "Input that cannot be used. The text says what is wrong, where, and what to do.\n\n\
     ``file`` (file or recording), ``row`` (line of the file; the header of a CSV is row 1), ``column`` and ``index`` (sample of an\n\
     array, from 0) are the place, or None."
);
pyo3::create_exception!(
    leafbench,
    InternalError,
    PyRuntimeError,
    "A defect of leafbench. Please report it, with the text."
);

/// Words of the command line, and what they are in Python.
const PYTHON_WORDS: [(&str, &str); 6] = [
    (
        "turn the sign with --flip force,displacement",
        "turn both signs with recording.flipped(force=True, displacement=True)",
    ),
    (
        "turn the sign with --flip force",
        "turn the sign with recording.flipped(force=True)",
    ),
    (
        "turn the sign with --flip displacement",
        "turn the sign with recording.flipped(displacement=True)",
    ),
    (
        "add --mixed-specimens if it is the same spring",
        "add mixed_specimens=True if it is the same spring",
    ),
    (
        "give --model NAME or --specimen FILE",
        "give model=NAME or specimen=FILE",
    ),
    (
        "give recordings (CSV) or --targets FILE",
        "give at least one recording",
    ),
];

fn in_python_words(text: &str) -> String {
    PYTHON_WORDS
        .iter()
        .fold(text.to_owned(), |text, (command_line, python)| {
            text.replace(command_line, python)
        })
}

/// The place of a mistake.
#[derive(Default)]
struct Place {
    file: Option<String>,
    row: Option<u64>,
    column: Option<String>,
    index: Option<usize>,
}

fn input_error(py: Python<'_>, text: String, place: Place) -> PyErr {
    let error = InputError::new_err(text);
    let value = error.value(py);
    let set = value
        .setattr("file", place.file)
        .and_then(|()| value.setattr("row", place.row))
        .and_then(|()| value.setattr("column", place.column))
        .and_then(|()| value.setattr("index", place.index));
    set.err().unwrap_or(error)
}

/// The exception for a failure.
pub(crate) fn exception(py: Python<'_>, failure: CallFailure) -> PyErr {
    let text = in_python_words(&failure.text);
    match failure.kind {
        FailureKind::Input => {
            let (file, row, column) = (failure.file, failure.row, failure.column);
            let place = Place {
                file,
                row,
                column,
                index: None,
            };
            input_error(py, text, place)
        }
        // Python makes it a FileNotFoundError, a PermissionError and so on by its number.
        FailureKind::File { os_error } => PyOSError::new_err((os_error, text, failure.file)),
        FailureKind::Cancelled => PyKeyboardInterrupt::new_err(text),
        FailureKind::Defect => InternalError::new_err(text),
    }
}

/// The exception for columns that are no recording.
pub(crate) fn of_columns(py: Python<'_>, error: RecordingError) -> PyErr {
    let text = error.to_string();
    let place = Place {
        file: Some(error.name),
        column: Some(error.column.to_owned()),
        index: error.index,
        row: None,
    };
    input_error(py, text, place)
}

/// The exception for a panic.
pub(crate) fn of_panic(payload: &(dyn Any + Send)) -> PyErr {
    let words = payload
        .downcast_ref::<&str>()
        .map(|s| (*s).to_owned())
        .or_else(|| payload.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "without a message".to_owned());
    InternalError::new_err(format!(
        "leafbench {} has a defect, it panicked: {words}: please report this text with the recordings and the call",
        env!("CARGO_PKG_VERSION")
    ))
}

/// Panics, so that a test can see what becomes of it. Only with the feature `provoke-panic`.
#[cfg(feature = "provoke-panic")]
#[pyfunction]
pub(crate) fn provoke_panic(py: Python<'_>) -> PyResult<()> {
    crate::work::until_done(py, |_| panic!("asked for by a test"))
}
