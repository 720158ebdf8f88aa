//! Will say which physics a model left out, proven on data that no parameter was fitted on. Nothing is here yet.
