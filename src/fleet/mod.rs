//! Pooled diagnosis: what the estimates of many runs say together about specimens, families, batches, benches, operators and age.

pub(crate) mod estimate;
