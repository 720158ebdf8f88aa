//! `leafbench plan`.

use clap::Args;

use super::shared::local::{BenchArg, ProfileArgs};
use super::shared::progress::duration;
use super::{CliCommand, CliError, Done, Output};
use crate::daemon::plan::{self, Plan, PlanError};
use crate::profile::check::unit_of;

/// Predict a profile on the model and compare it with the limits of the bench; nothing moves
#[derive(Debug, Args)]
pub(super) struct PlanArgs {
    #[command(flatten)]
    profile: ProfileArgs,
    #[command(flatten)]
    bench: BenchArg,
}

impl CliCommand for PlanArgs {
    const NAME: &'static str = "plan";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench plan static-ramp",
        "leafbench plan sine-6mm-2.5hz --bench bench-configs/benches/samurai-rail.toml --json",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let bench = self.bench.load()?;
        let (profile, _) = self.profile.load()?;
        let plan = plan::check(&bench, &profile).map_err(|e| match e {
            PlanError::Model(e) => CliError::Model(e),
            PlanError::Profile(e) => CliError::Profile(e),
            PlanError::BrokenOff => CliError::Internal(e.to_string()),
        })?;
        output.result(&plan, || text(&plan))?;
        Ok(Done::success_if(plan.trips.is_empty()))
    }
}

/// A margin in words. Above 100 % the value lies on the other side of zero than its limit.
fn margin(percent: f64) -> String {
    match percent {
        p if p < 0.0 => format!("exceeded by {:.1} % of the limit", -p),
        p if p > 100.0 => "far: on the other side of zero".to_owned(),
        p => format!("{p:.1} % left"),
    }
}

fn text(p: &Plan) -> String {
    let cycles = if p.cycles > 0 {
        format!(", {} counted cycles", p.cycles)
    } else {
        String::new()
    };
    let mut lines = vec![
        format!("profile       {}, {}{cycles}", p.profile, duration(p.duration_s)),
        format!("force         {:.1} to {:.1} N", p.force_min_n, p.force_max_n),
        format!(
            "displacement  {:.3} to {:.3} mm",
            p.displacement_min_mm, p.displacement_max_mm
        ),
        format!("speed         {:.1} mm/s at most", p.velocity_max_mm_s),
        format!("energy        {:.2} J", p.energy_j),
        String::new(),
        format!(
            "{:<26}{:>12}{:>12} {:<7}{:>9}  {}",
            "limit", "predicted", "allowed", "", "at", "margin"
        ),
    ];
    lines.extend(p.margins.iter().map(|m| {
        format!(
            "{:<26}{:>12.2}{:>12.2} {:<7}{:>7.2} s  {}",
            m.limit,
            m.predicted,
            m.allowed,
            unit_of(&m.limit),
            m.at_s,
            margin(m.margin_percent)
        )
    }));
    lines.push(String::new());
    match p.trips.is_empty() {
        true => lines.push("the profile stays within every limit".to_owned()),
        false => lines.extend(p.trips.iter().map(|t| format!("WOULD TRIP: {t}"))),
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_margin_beyond_the_limit_or_beyond_zero_says_what_it_means() {
        assert_eq!(margin(34.24), "34.2 % left");
        assert_eq!(margin(-3.25), "exceeded by 3.2 % of the limit");
        assert_eq!(margin(101.1), "far: on the other side of zero");
    }
}
