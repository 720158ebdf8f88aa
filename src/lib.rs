//! leafbench: controller of a hardware-in-the-loop test bench for leaf springs.
//!
//! One daemon drives a hydraulic load frame over CAN or serial, records the load cell and the LVDT, and steps a
//! leaf-spring model beside the rig as a virtual twin. Where they differ, `diagnose` says which physics is missing.
//!
//! # Layers
//! A module uses only modules of a lower rank. `tests/architecture.rs` reads this table and every `use crate::` line.
//!
//! | rank | modules |
//! |---|---|
//! | 0 | units |
//! | 1 | recording, profile, protocol |
//! | 2 | model, link, truth |
//! | 3 | effect, control |
//! | 4 | identify, mockrig, twin |
//! | 5 | config, diagnose, papers |
//! | 6 | daemon |
//! | 7 | report, blind |
//! | 8 | cli |
//!
//! # The walk of a sample
//! `link` (frame) → `protocol::message` (counts) → `control::channel` (newtons, millimetres) → `control` (command,
//! segment, cycle, flags) → `twin` (model force beside it) → `recording::run_file` → `recording::csv`.
//! A command walks the same files backwards, from `bench-configs/profiles/` on.
#![forbid(unsafe_code)]
#![warn(missing_docs, unreachable_pub)]

mod blind;
mod cli;
mod config;
mod control;
mod daemon;
mod diagnose;
mod effect;
mod identify;
mod link;
mod mockrig;
mod model;
mod papers;
mod profile;
mod protocol;
mod recording;
mod report;
mod truth;
mod twin;
mod units;

pub use cli::main;

#[cfg(feature = "benchmarks")]
#[doc(hidden)]
#[path = "../benches/mod.rs"]
pub mod benchmarks;

#[cfg(test)]
#[allow(unreachable_pub, reason = "test helpers are seen by their own tests only")]
#[path = "../tests/mod.rs"]
mod tests;
