//! The wire is held together from all sides: document, DBC, codec and serial framing say the same, whatever arrives
//! never panics, and no corruption passes for another value.

mod any;
mod corruption;
mod dbc;
mod document;
mod exchange;
mod fields;
mod noise;
mod round_trip;
mod stream;
