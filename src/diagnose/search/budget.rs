//! The budget of the searches. It is counted in steps of the model, so that the same recordings give the same answer on every
//! machine, and no set of recordings is searched without end.

use crate::diagnose::fitting::Setup;

/// Steps of the model that the searches of one diagnosis may take, about 25 s of one core. A search that finds it spent compares
/// no larger sets, and the report says so.
const MODEL_STEPS: u64 = 250_000_000;

/// What one search may use of the budget.
#[derive(Debug, Clone, Copy)]
pub(super) struct Budget {
    /// Steps of the model at which it is spent.
    ends_at: u64,
}

impl Budget {
    /// A share of all steps, from the start of the diagnosis: a later search gets what an earlier one left.
    pub(super) fn up_to(share: f64) -> Budget {
        Budget {
            ends_at: (share * MODEL_STEPS as f64) as u64,
        }
    }

    pub(super) fn is_spent(self, setup: &Setup) -> bool {
        setup.steps() >= self.ends_at
    }
}
