//! leafbench: controller of a hardware-in-the-loop test bench for leaf springs, with a virtual twin and a diagnosis of the twin.
//!
//! One daemon drives a hydraulic load frame over CAN or serial and records the load cell and the LVDT. During a test it also
//! steps a leaf-spring model, the virtual twin. [`diagnose()`] compares recordings with a model and says which physics the model
//! lacks. To run a bench, use the program (`leafbench --help`). This library is for programs that use its parts.
//!
//! # Run a profile on the mock rig
//! The mock rig simulates a rig. Here it runs in memory and in virtual time.
//! ```
//! use leafbench::{Bench, Profile, record};
//!
//! let ramp = r#"
//!     name = "ramp"
//!     control = "displacement"
//!     [[block]]
//!     segment = [
//!         { kind = "ramp", to_mm = 5.0, duration_s = 2.0 },
//!         { kind = "ramp", to_mm = 0.0, duration_s = 2.0 },
//!     ]
//! "#;
//! let recording = record(&Bench::shipped()?, &Profile::from_toml(ramp, "ramp")?)?;
//! let peak_n = recording.force_n.iter().copied().fold(0.0, f64::max);
//! // 72 N/mm over 5 mm, and 15 % friction on the way up.
//! assert!((peak_n - 72.0 * 5.0 * 1.15).abs() < 5.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Diagnose a recording
//! A CSV needs the columns `time_s`, `displacement_mm` and `force_n`. The spring in this example has a helper leaf that touches at
//! 6 mm. The model `equivalent` has none.
//! ```
//! use leafbench::{Baseline, DiagnoseOptions, Verdict, diagnose, find_model, read_csv};
//!
//! let mut csv = String::from("time_s,displacement_mm,force_n\n");
//! for i in 0..3000 {
//!     let time_s = f64::from(i) * 0.004;
//!     let phase = std::f64::consts::TAU * 0.25 * time_s;
//!     let x_mm = 5.0 - 5.0 * phase.cos();
//!     let dry_friction = 0.1 * phase.sin().signum();
//!     let force_n = (70.0 * x_mm + 25.0 * (x_mm - 6.0).max(0.0)) * (1.0 + dry_friction);
//!     csv += &format!("{time_s:.3},{x_mm:.5},{force_n:.3}\n");
//! }
//! let file = std::env::temp_dir().join(format!("leafbench-doc-{}.csv", std::process::id()));
//! std::fs::write(&file, csv)?;
//!
//! let recording = read_csv(&file)?;
//! let baseline = Baseline::of(find_model("equivalent")?);
//! let diagnosis = diagnose(&[recording], &baseline, &DiagnoseOptions::default(), &mut |_, _| {})?;
//! assert_ne!(diagnosis.verdict, Verdict::Adequate);
//! println!("{}", diagnosis.summary);
//! # std::fs::remove_file(&file)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Step a model by hand
//! ```
//! use leafbench::find_model;
//!
//! let model = find_model("equivalent")?;
//! // preload_n, rate_n_per_mm, friction_ratio, presliding_mm
//! let mut plant = model.plant(&[50.0, 80.0, 0.12, 0.4], &Default::default())?;
//! let loading_n = plant.step(5.0, 0.1);
//! plant.step(9.0, 0.1);
//! let unloading_n = plant.step(5.0, 0.1);
//! assert!((loading_n - 450.0 * 1.12).abs() < 0.1);
//! assert!((unloading_n - 450.0 * 0.88).abs() < 0.1);
//! # Ok::<(), leafbench::BuildError>(())
//! ```
//!
//! # Layers
//! A module uses only modules of a lower rank. `tests/architecture.rs` compares this table with every `use crate::` line.
//! `docs/architecture.md` explains the parts.
//!
//! | rank | modules |
//! |---|---|
//! | 0 | units, regular_file, cancel, detector, nearest, ring |
//! | 1 | recording, profile, protocol, calibration |
//! | 2 | acceptance, archive, model, link, truth |
//! | 3 | effect, control, conformance |
//! | 4 | identify, mockrig, twin |
//! | 5 | config, diagnose, papers |
//! | 6 | fleet |
//! | 7 | report |
//! | 8 | daemon, blind |
//! | 9 | cli |
//! | 10 | library |
//!
//! A sample goes through `link`, `protocol`, `control`, `twin`, `recording`, in this order. A command goes the other way, from
//! `profile`.
#![cfg_attr(not(test), forbid(unsafe_code))]
// The allocator that counts for the tests, and nothing else.
#![cfg_attr(test, deny(unsafe_code))]
#![warn(missing_docs, unreachable_pub)]

mod acceptance;
mod archive;
mod blind;
mod calibration;
mod cancel;
mod cli;
mod config;
mod conformance;
mod control;
mod daemon;
mod detector;
mod diagnose;
mod effect;
mod fleet;
mod identify;
mod library;
mod link;
mod mockrig;
mod model;
mod nearest;
mod papers;
mod profile;
mod protocol;
mod recording;
mod regular_file;
mod report;
mod ring;
mod truth;
mod twin;
mod units;

pub use archive::{ArchivedRun, DiagnosedRun, DiagnosisRow, Estimated};
pub use cancel::CancelFlag;
pub use cli::main;
pub use config::Bench;
pub use diagnose::{
    Baseline, DiagnoseOptions, Diagnosis, EffectEstimate, Estimates, Finding, ParameterEstimate, Verdict,
    diagnose, estimate,
};
pub use effect::codes as codes_of_physics;
pub use library::{
    BenchDiagnosis, CallFailure, DiagnoseOrder, FailureKind, IdentifyOrder, ReadRecording, RecordError,
    archived_runs, diagnose_archived, diagnose_on_bench, find_bench, find_profile, identify, plan,
    read_archived, read_recording, record, record_run, require_one_specimen, simulate, store_diagnoses,
    undiagnosed_runs,
};
pub use model::{BuildError, Model, Parameter, Plant, all as models, find as find_model};
pub use profile::Profile;
pub use recording::{Recording, RecordingError, csv::read_file as read_csv};
pub use units::Mode;

#[cfg(feature = "benchmarks")]
#[doc(hidden)]
#[path = "../benches/mod.rs"]
pub mod benchmarks;

#[cfg(test)]
#[allow(unreachable_pub, reason = "test helpers are seen by their own tests only")]
#[path = "../tests/mod.rs"]
mod tests;
