//! Says which physics a model left out, and proves it on data that no parameter was fitted on.
