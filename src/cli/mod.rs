//! Commands: the only part that knows all the others.

pub mod demo;
pub mod table;
pub mod virtual_bench;

/// Now, UTC, RFC 3339 to the second.
pub fn now_utc() -> String {
    jiff::Timestamp::now().strftime("%Y-%m-%dT%H:%M:%SZ").to_string()
}
