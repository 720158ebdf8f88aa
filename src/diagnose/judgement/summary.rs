//! The diagnosis in a few sentences.

use crate::diagnose::diagnosis::*;
use crate::diagnose::fitting::ShapeShares;

/// Said where the budget of the search was spent.
const CUT_SHORT: &str = " The search ended at its budget: larger sets of effects were not compared. Diagnose fewer recordings, or \
    shorter ones.";

pub(super) fn summary(
    verdict: Verdict,
    effects: &[Finding],
    modelled: Option<String>,
    location: &[Location],
    fit: &FitErrors,
) -> String {
    let [noise, improved] = [fit.noise_floor_nrmse, fit.improved.nrmse_heldout].map(percent);
    match verdict {
        Verdict::Adequate => {
            format!(
                "The baseline explains the recordings: error {improved} on held-out cycles, noise {noise}."
            )
        }
        Verdict::MissingPhysics => {
            let name = |e: &Finding| match e.group.join(" or ").replace('_', " ") {
                none if none.is_empty() => e.code.replace('_', " "),
                group => format!("one of {group}"),
            };
            let codes: Vec<String> = effects.iter().map(name).collect();
            let with_law = modelled.map_or(String::new(), |what| format!(", with {what}"));
            format!(
                "Missing: {}{with_law}. The error on held-out cycles {}, noise {noise}.",
                codes.join(" and "),
                change(fit)
            )
        }
        Verdict::Unexplained => {
            let place = location
                .first()
                .map_or(String::new(), |l| format!(": {}", l.words));
            let modelled = modelled.map_or(String::new(), |what| {
                format!(
                    " Modelled by {what}: the error on held-out cycles {}, noise {noise}.",
                    change(fit)
                )
            });
            format!("No effect in the library explains the difference{place}.{modelled}")
        }
    }
}

/// How the error on held-out cycles changes. A named effect can leave it as it is, where the rest is larger than the effect.
fn change(fit: &FitErrors) -> String {
    let [before, after] = [&fit.baseline, &fit.improved].map(|errors| percent(errors.nrmse_heldout));
    if fit.improved.nrmse_heldout < fit.baseline.nrmse_heldout && before != after {
        format!("falls from {before} to {after}")
    } else {
        format!("does not fall: {before} without, {after} with it")
    }
}

fn percent(share: f64) -> String {
    format!("{:.2} %", 100.0 * share)
}

/// What the diagnosis left to the shape of a law, and whether its search was cut short.
pub(super) fn limits_in_words(shape: Option<ShapeShares>, cut_short: bool) -> String {
    shape.map_or(String::new(), rest_in_words) + if cut_short { CUT_SHORT } else { "" }
}

/// Error of the freer friction law, as a share of the force that it explains.
pub(super) fn law_error_in_words(share: f64) -> String {
    format!(
        " The rest is {:.0} % of what the freer friction law changes in the force. No friction law is known better than to a tenth, so no \
         effect is named for the rest.",
        (100.0 * share).max(1.0)
    )
}

fn rest_in_words(shares: ShapeShares) -> String {
    if let (false, Some(curve)) = (shares.are_errors_of_shape(), shares.curve) {
        return format!(
            " The rest depends on the displacement alone: {:.1} % of the force range in the spring's curve and {:.0} % of the friction. \
             These recordings do not tell which effect it is, so none is named.",
            100.0 * curve,
            100.0 * shares.friction
        );
    }
    let friction = 100.0 * shares.friction;
    let (size, shape) = match shares.curve {
        None => (format!("{friction:.1} % of the friction"), "the friction law"),
        Some(curve) => (
            format!(
                "{friction:.1} % of the friction and {:.2} % of the force range",
                100.0 * curve
            ),
            "the friction law and of the spring's curve",
        ),
    };
    format!(" The rest, {size}, has the shape of {shape}: no further effect is named.")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(baseline: f64, improved: f64) -> FitErrors {
        let errors = |nrmse_heldout| Errors {
            nrmse_heldout,
            ..Errors::default()
        };
        FitErrors {
            baseline: errors(baseline),
            improved: errors(improved),
            ..FitErrors::default()
        }
    }

    #[test]
    fn an_error_falls_only_where_it_is_lower() {
        assert_eq!(change(&fit(0.02, 0.001)), "falls from 2.00 % to 0.10 %");
        assert_eq!(
            change(&fit(0.0122, 0.0124)),
            "does not fall: 1.22 % without, 1.24 % with it"
        );
        assert_eq!(
            change(&fit(0.01, 0.009999)),
            "does not fall: 1.00 % without, 1.00 % with it"
        );
    }
}
