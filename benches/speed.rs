//! Speed of the wire, the recording, the fit and the whole loop: `cargo bench --features benchmarks --bench speed`.

use criterion::{criterion_group, criterion_main};
use leafbench::benchmarks::{bench_loop, identify, lateness, protocol, recording};

criterion_group!(
    speed,
    protocol::protocol,
    recording::recording,
    bench_loop::bench_loop,
    lateness::lateness,
    identify::step,
    identify::refit
);
criterion_main!(speed);
