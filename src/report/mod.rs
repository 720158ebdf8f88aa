//! Reports that are read without a network: plots as SVG, pages that hold everything themselves. What is in them is
//! decided elsewhere.

pub mod aggregates;
pub mod diagnosis;
mod diagnosis_plots;
pub mod html;
pub mod pack;
pub mod svg;
