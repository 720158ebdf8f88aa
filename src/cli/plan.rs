//! `leafbench plan`.

use clap::{Arg, ArgMatches};

use super::progress::duration;
use super::{CliError, Command, Done, Output, local};
use crate::daemon::plan::{self, Plan, PlanError};

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "plan",
    what: "Check a profile against the bench's limits and dry-run it on the model; nothing moves",
    arguments: |command| {
        command
            .arg(profile_argument())
            .arg(local::bench_argument())
            .arg(local::profiles_argument())
    },
    run,
};

/// `PROFILE`.
pub(super) fn profile_argument() -> Arg {
    Arg::new("profile")
        .value_name("PROFILE")
        .required(true)
        .help("Name of a profile, or a profile file (.toml)")
}

fn run(matches: &ArgMatches, output: &Output) -> Result<Done, CliError> {
    let bench = local::bench(matches)?;
    let name = matches
        .get_one::<String>("profile")
        .map(String::as_str)
        .unwrap_or_default();
    let (profile, _) = local::profile(matches, name)?;
    let plan = plan::check(&bench, &profile).map_err(|e| match e {
        PlanError::Model(e) => CliError::Model(e),
        PlanError::Profile(e) => CliError::Profile(e),
    })?;
    output.result(&plan, || text(&plan))?;
    Ok(if plan.trips.is_empty() {
        Done::Well
    } else {
        Done::Otherwise
    })
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
            "{:<26}{:>12}{:>12}{:>9}{:>10}",
            "limit", "predicted", "allowed", "margin", "at"
        ),
    ];
    lines.extend(p.margins.iter().map(|m| {
        format!(
            "{:<26}{:>12.2}{:>12.2}{:>7.1} %{:>8.2} s",
            m.limit, m.predicted, m.allowed, m.margin_percent, m.at_s
        )
    }));
    lines.push(String::new());
    match p.trips.is_empty() {
        true => lines.push("the profile keeps every limit".to_owned()),
        false => lines.extend(p.trips.iter().map(|t| format!("WOULD TRIP: {t}"))),
    }
    lines.join("\n")
}
