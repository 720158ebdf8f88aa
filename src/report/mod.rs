//! Plots and pages that are readable offline.
