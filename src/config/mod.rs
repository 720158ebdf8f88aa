//! Bench configs: as typed, checked, read and written.
