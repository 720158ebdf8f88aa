//! What the program does with files and benches, as calls for other programs: the Python package is built on them.
//!
//! | file | what it does |
//! |---|---|
//! | `failure` | one error for all calls, with file, row and column |
//! | `files` | recordings, benches and profiles from files or by name |
//! | `archives` | runs of an archive: the list, runs as recordings, and their diagnoses |
//! | `simulation` | a profile on the model, on the mock rig, or compared with the limits |
//! | `identification` | a model fitted to recordings, as `leafbench identify` does it |
//! | `bench_diagnosis` | a diagnosis with the proof of its improved model, as `leafbench diagnose` does it |

mod archives;
mod bench_diagnosis;
mod failure;
mod files;
mod identification;
mod simulation;

pub use archives::{archived_runs, diagnose_archived, read_archived, store_diagnoses, undiagnosed_runs};
pub use bench_diagnosis::{BenchDiagnosis, DiagnoseOrder, diagnose_on_bench};
pub use failure::{CallFailure, FailureKind};
pub use files::{ReadRecording, find_bench, find_profile, read_recording, require_one_specimen};
pub use identification::{IdentifyOrder, identify};
pub use simulation::{RecordError, plan, record, record_run, simulate};
