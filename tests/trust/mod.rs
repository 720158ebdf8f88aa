//! What must hold on the worst day: a control thread that never waits, files that survive kills and power cuts, parsers that
//! survive anything.

pub mod allocations;
mod archive_kills;
mod control_thread;
mod flipped_bits;
mod fuzz;
mod kills;
mod live_writer;
mod over_vcan;
mod soak;
mod virtual_loop;
