//! Asks a long computation to end before it is done, from another thread.
//!
//! A fit is many calls deep, and what it has half way means nothing. So it is left by unwinding, as salsa does it: no step between
//! has to pass a "cancelled" on. This needs a program that unwinds (`panic = "unwind"`); leafbench's own program never cancels.

use std::panic::{self, AssertUnwindSafe};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A flag that ends the computations that were given it. Its clones are the same flag.
#[derive(Debug, Clone, Default)]
pub struct CancelFlag(Arc<AtomicBool>);

impl CancelFlag {
    /// Ends the computations soon; each returns its error for this.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// True after [`CancelFlag::cancel`].
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Leaves the computation below [`caught`] if the flag is set. The panic hook is not called, so nothing is printed.
    pub(crate) fn unwind_if_cancelled(&self) {
        if self.is_cancelled() {
            panic::resume_unwind(Box::new(CancelUnwind));
        }
    }
}

/// Two flags are equal if they are the same one.
impl PartialEq for CancelFlag {
    fn eq(&self, other: &CancelFlag) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// What a cancelled computation unwinds with.
struct CancelUnwind;

/// Runs `work`; `None` if it was cancelled. Any other panic goes on.
pub(crate) fn caught<T>(work: impl FnOnce() -> T) -> Option<T> {
    match panic::catch_unwind(AssertUnwindSafe(work)) {
        Ok(value) => Some(value),
        Err(payload) if payload.is::<CancelUnwind>() => None,
        Err(payload) => panic::resume_unwind(payload),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cancelled_computation_is_left_and_another_panic_goes_on() {
        let flag = CancelFlag::default();
        let work = |flag: &CancelFlag| {
            flag.unwind_if_cancelled();
            7
        };
        assert_eq!(caught(|| work(&flag)), Some(7));
        flag.clone().cancel();
        assert_eq!(caught(|| work(&flag)), None);
        let other = panic::catch_unwind(|| caught(|| panic::resume_unwind(Box::new(3_u8))));
        assert_eq!(other.err().and_then(|p| p.downcast_ref::<u8>().copied()), Some(3));
    }

    #[test]
    fn a_worker_thread_hands_the_cancelling_on() {
        let flag = CancelFlag::default();
        flag.cancel();
        let both = || rayon::join(|| flag.unwind_if_cancelled(), || ());
        assert_eq!(caught(both), None);
    }
}
