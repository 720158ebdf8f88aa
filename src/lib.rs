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
//! | 5 | diagnose, config |
//! | 6 | report, daemon, blind |
//! | 7 | cli |
//!
//! # The walk of a sample
//! `link` (frame) → `protocol::message` (counts) → `control::channel` (newtons, millimetres) → `control` (command,
//! segment, cycle, flags) → `twin` (model force beside it) → `recording::run_file` → `recording::csv`.
//! A command walks the same files backwards, from `bench-configs/profiles/` on.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod blind;
pub mod cli;
pub mod config;
pub mod control;
pub mod daemon;
pub mod diagnose;
pub mod effect;
pub mod identify;
pub mod link;
pub mod mockrig;
pub mod model;
pub mod profile;
pub mod protocol;
pub mod recording;
pub mod report;
pub mod truth;
pub mod twin;
pub mod units;
