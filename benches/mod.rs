//! The code of the benchmarks. It is part of the library under the feature `benchmarks`, because it needs more than the
//! public types; `benches/speed.rs` and `benches/leaf_pack_speed.rs` run it.
#![allow(missing_docs, reason = "each benchmark prints its own name")]

pub mod bench_loop;
pub mod identify;
pub mod lateness;
pub mod leaf_pack;
pub mod protocol;
pub mod recording;
