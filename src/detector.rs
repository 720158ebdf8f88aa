//! Which detectors act. In the program all of them do. A test switches one off to show that the test of its row then fails.

/// True if the detector of `row` acts; a row is an id of the fault matrix in `docs/faults.md`, such as `L9`.
#[cfg(not(test))]
#[inline(always)]
pub(crate) const fn acts(_row: &str) -> bool {
    true
}

#[cfg(test)]
thread_local! {
    static OFF: std::cell::Cell<&'static str> = const { std::cell::Cell::new("") };
}

/// True if the detector of `row` acts; a row is an id of the fault matrix in `docs/faults.md`, such as `L9`.
#[cfg(test)]
pub(crate) fn acts(row: &str) -> bool {
    OFF.with(|off| off.get() != row)
}

/// Switches the detector of `row` off in this thread until the value is dropped, also by a panic.
#[cfg(test)]
pub(crate) struct Off;

#[cfg(test)]
impl Off {
    pub(crate) fn new(row: &'static str) -> Self {
        OFF.with(|off| off.set(row));
        Off
    }
}

#[cfg(test)]
impl Drop for Off {
    fn drop(&mut self) {
        OFF.with(|off| off.set(""));
    }
}
