//! Fits a model's parameters to recordings or to published figures.
