//! Writes the reports: HTML pages that hold everything themselves and are read without a network, plots as SVG, and JUnit XML for
//! CI servers. What they say is decided by the callers.

pub(crate) mod aggregates;
pub(crate) mod certificate;
pub(crate) mod coverage;
pub(crate) mod diagnosis;
pub(crate) mod diagnosis_files;
mod diagnosis_plots;
mod figures;
pub(crate) mod fleet;
pub(crate) mod fleet_tables;
mod html;
mod interval_plot;
pub(crate) mod junit;
pub(crate) mod loops;
pub(crate) mod pack;
pub(crate) mod story;
pub(crate) mod svg;
