//! One file of each kind that a contributor adds. CONTRIBUTING.md says where to copy it. They compile and run here, so that
//! they stay true.

mod effect;
mod model;
