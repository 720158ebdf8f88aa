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

#[cfg(test)]
mod tests {
    use super::super::beam_search::{SearchResult, search};
    use super::*;
    use crate::diagnose::DiagnoseOptions;
    use crate::diagnose::conditioning::tracks;
    use crate::diagnose::fitting::{Baseline, fitted_input, input};
    use crate::recording::Recording;

    /// Ten cycles of a spring that is damped and stiffer beyond 6 mm, with friction of 4 % of the load.
    fn recording() -> Recording {
        let at = |i: usize| {
            let angle = std::f64::consts::TAU * i as f64 / 400.0;
            let (x, v) = (6.0 - 5.0 * angle.cos(), 31.0 * angle.sin());
            let elastic_n = 100.0 + 80.0 * x + 40.0 * (x - 6.0).max(0.0);
            let noise_n = 0.3 * (12.9898 * i as f64).sin() * (78.233 * i as f64).cos();
            (x, elastic_n * (1.0 + 0.04 * v.signum()) + 0.5 * v + noise_n)
        };
        let (displacement_mm, force_n) = (0..4000).map(at).unzip();
        Recording {
            time_s: (0..4000).map(|i| 0.0025 * f64::from(i)).collect(),
            displacement_mm,
            force_n,
            ..Recording::default()
        }
    }

    /// The first search with a budget, and the steps that it took.
    fn searched(share: f64) -> (SearchResult, u64) {
        let options = DiagnoseOptions {
            points: 600,
            ..DiagnoseOptions::default()
        };
        let recordings = [recording()];
        let mut setup = Setup::new(&Baseline::of(&crate::model::equivalent::MODEL)).expect("listed");
        let tracks = tracks(&recordings, options.points).expect("conditioned");
        let data = input(tracks, &options).expect("threads");
        let (data, run, fitted) =
            fitted_input(&mut setup, data, &recordings, &options).expect("a finite force");
        let before = setup.steps();
        let context = run.context(&setup, &data);
        let result = search(&context, fitted, &[], Budget::up_to(share), &mut |_, _| {});
        (result, setup.steps() - before)
    }

    #[test]
    fn a_spent_budget_leaves_single_effects_and_says_so() {
        let (spent, few) = searched(0.0);
        assert!(spent.cut_short);
        assert!(spent.nodes.len() > 1 && spent.nodes.iter().all(|n| n.attached.len() <= 1));
        let (whole, many) = searched(1.0);
        assert!(!whole.cut_short);
        assert!(whole.nodes.iter().any(|n| n.attached.len() == 2));
        assert!(few < many, "{few} and {many}");
    }
}
