//! Fuzzing of every parser: inputs that mutate from a corpus, by a seeded generator, in this process, on stable Rust.
//!
//! | command | time for each parser |
//! |---|---|
//! | `cargo test --release --lib trust::fuzz` | 0.7 s |
//! | `LEAFBENCH_FUZZ_SECONDS=3600 cargo test --release --lib trust::fuzz -- --nocapture` | an hour |
//!
//! `LEAFBENCH_FUZZ_SEED` chooses other inputs. Input number N of a parser is the same for the same seed. No input may panic, take
//! longer than a second of the processor, or hold more than 64 MiB. One that does is written to `target/fuzz`; once it is mended, its
//! file goes to `tests/fuzz/corpus/PARSER`, where every run tries it first.

mod engine;
mod mutation;
mod parsers;
mod run_file;
