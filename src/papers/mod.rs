//! The papers' own identifications run again: plain tables of their figures beside ours, for a command line to print.

pub(crate) mod first;
pub(crate) mod second;
pub(crate) mod third;
