//! The compiled half of the Python package `leafbench`: calls of the library `leafbench`, with its errors as exceptions.
//!
//! The other half is Python, in `package/leafbench/`: it checks types, finds files and makes typed results. The two meet in JSON and in
//! columns of numbers.
//!
//! | file | what it does |
//! |---|---|
//! | `errors` | a failure or a panic becomes an exception |
//! | `work` | computes on another thread, without the interpreter's lock, until it is done or Ctrl-C is pressed |
//! | `columns` | a recording, and its columns for numpy and Arrow without a copy |
//! | `calls` | read, simulate, plan, identify, diagnose |
#![forbid(unsafe_code)]

mod calls;
mod columns;
mod errors;
mod work;

/// The module `leafbench._leafbench`. `leafbench/__init__.py` is the one to import.
#[pyo3::pymodule]
mod _leafbench {
    #[pymodule_export]
    use super::calls::{
        archived_runs, bench_toml, diagnose, diagnose_archived, identify, models, physics, plan, read,
        read_archived, require_one_specimen, simulate, store_diagnoses, undiagnosed_runs,
    };
    #[pymodule_export]
    use super::columns::{Column, Columns};
    #[cfg(feature = "provoke-panic")]
    #[pymodule_export]
    use super::errors::provoke_panic;
    #[pymodule_export]
    use super::errors::{InputError, InternalError};

    /// Version of leafbench.
    #[pymodule_export]
    #[allow(non_upper_case_globals, reason = "the name that Python modules use")]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
