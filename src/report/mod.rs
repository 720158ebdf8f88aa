//! Reports that are read without a network: plots as SVG, pages that hold everything themselves. What is in them is
//! decided elsewhere.

pub(crate) mod aggregates;
pub(crate) mod diagnosis;
mod diagnosis_plots;
pub(crate) mod html;
pub(crate) mod pack;
pub(crate) mod svg;
