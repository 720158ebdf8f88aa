//! Pooled diagnosis: what the estimates of many runs say together about specimens, families, batches, benches, operators and age.

mod design;
pub(crate) mod estimate;
mod mixed_model;
mod quantity_data;
