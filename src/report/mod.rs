//! Plots and pages that are readable offline: SVG inside one HTML file, nothing fetched.

pub mod html;
pub mod loops;
pub mod svg;
