//! Speed of the leaf pack: `cargo bench --features benchmarks --bench leaf_pack_speed`.

use criterion::{Criterion, criterion_group, criterion_main};
use leafbench::benchmarks::leaf_pack::{OwnTime, duty, evolution, static_row, step, tail};

criterion_group! {
    name = leaf_pack;
    config = Criterion::default().with_measurement(OwnTime);
    targets = step, static_row, duty, tail, evolution
}
criterion_main!(leaf_pack);
