//! The three papers' own identifications run again: their printed figures, and ours.

pub(crate) mod first;
pub(crate) mod second;
pub(crate) mod third;
