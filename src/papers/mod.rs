//! The papers' own identifications run again: plain tables of their figures beside ours, for a command line to print.

pub mod first;
pub mod second;
pub mod third;
