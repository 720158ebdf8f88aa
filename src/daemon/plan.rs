//! Checks a profile before anything moves: it runs on the bench's model and is compared with the bench's limits.

use std::ops::ControlFlow;

use axum::http::StatusCode;
use serde::{Deserialize, Serialize};

use super::course::{CourseThinner, PlannedCourse};
use super::error::ApiError;
use crate::config::Bench;
use crate::model::BuildError;
use crate::profile::accept::{AcceptLimit, LimitSide};
use crate::profile::{Player, Profile, ProfileError};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::twin::{self, dry_run_with};

/// What a profile will do, predicted with the model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub(crate) struct Plan {
    /// Name of the profile.
    pub profile: String,
    /// Length in s.
    pub duration_s: f64,
    /// Number of counted cycles.
    pub cycles: u32,
    /// Lowest force in N.
    pub force_min_n: f64,
    /// Highest force in N.
    pub force_max_n: f64,
    /// Lowest displacement in mm.
    pub displacement_min_mm: f64,
    /// Highest displacement in mm.
    pub displacement_max_mm: f64,
    /// Highest speed in mm/s.
    pub velocity_max_mm_s: f64,
    /// Energy that the specimen dissipates, in J.
    pub energy_j: f64,
    /// Distance to each limit.
    pub margins: Vec<PlanMargin>,
    /// Limits that the profile would exceed, one sentence each; empty if the profile may run.
    pub trips: Vec<String>,
    /// Limits that a run of the profile is judged by, in the order of its file.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub accept: Vec<PlannedLimit>,
    /// Commanded and predicted values over time, if they were asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub course: Option<PlannedCourse>,
}

/// Distance between a predicted extreme and its limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub(crate) struct PlanMargin {
    /// Key of the limit in the bench config; its ending is the unit.
    pub limit: String,
    /// Predicted extreme, in the unit of the limit.
    pub predicted: f64,
    /// Value of the limit.
    pub allowed: f64,
    /// Time of the extreme in s, from the start of the profile.
    pub at_s: f64,
    /// Remaining distance in percent of the limit; negative beyond the limit.
    pub margin_percent: f64,
}

/// A limit that a run is judged by after its end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub(crate) struct PlannedLimit {
    /// What is limited, in words.
    pub what: String,
    /// `min` or `max`.
    pub side: LimitSide,
    /// The limit, in `unit`.
    pub limit: f64,
    /// Unit of the limit; empty for a pure number.
    pub unit: String,
    /// First and last counted cycle that it is about; `null` for all, or for the whole motion.
    pub cycles: Option<[u32; 2]>,
}

impl PlannedLimit {
    fn of(limit: &AcceptLimit) -> PlannedLimit {
        PlannedLimit {
            what: limit.judged.words(),
            side: limit.side,
            limit: limit.limit,
            unit: limit.judged.unit().to_owned(),
            cycles: limit.cycles,
        }
    }
}

/// Why a profile cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PlanError {
    #[error("the bench's model cannot be built")]
    Model(#[from] BuildError),
    #[error(transparent)]
    Profile(#[from] ProfileError),
    /// Nobody waits for the result any more.
    #[error("the check of the profile was broken off before its end")]
    BrokenOff,
}

/// A long dry run looks this often whether it is still wanted: every so many ticks, some 0.1 ms of computing.
const LOOK_TICKS: u32 = 1000;

/// Predicts what `profile` does on the bench's model, and which limits it would exceed.
pub(crate) fn check(bench: &Bench, profile: &Profile) -> Result<Plan, PlanError> {
    check_while(bench, profile, false, &|| true)
}

/// [`check`] that ends soon after `is_wanted` turns false. `with_course`: the plan also has the course over time.
pub(crate) fn check_while(
    bench: &Bench,
    profile: &Profile,
    with_course: bool,
    is_wanted: &dyn Fn() -> bool,
) -> Result<Plan, PlanError> {
    let plant = bench.model.plant()?;
    let (mut ticks, mut broken_off) = (0_u32, false);
    let rate_hz = f64::from(SAMPLE_RATE_HZ);
    let total_ticks = Player::new(profile, 0.0, rate_hz)?.total_ticks();
    let mut course = with_course.then(|| CourseThinner::new(total_ticks, rate_hz));
    let run = dry_run_with(
        profile,
        plant.as_ref(),
        &bench.profile_limits(),
        rate_hz,
        &mut |predicted| {
            if let Some(course) = &mut course {
                course.take(predicted);
            }
            ticks = (ticks + 1) % LOOK_TICKS;
            broken_off = ticks == 0 && !is_wanted();
            match broken_off {
                true => ControlFlow::Break(()),
                false => ControlFlow::Continue(()),
            }
        },
    )?;
    if broken_off {
        return Err(PlanError::BrokenOff);
    }
    let margin = |m: &twin::Margin| PlanMargin {
        limit: m.worst.name.to_owned(),
        predicted: m.worst.value,
        allowed: m.worst.limit,
        at_s: m.worst.time_s,
        margin_percent: m.margin_percent,
    };
    Ok(Plan {
        profile: profile.name.clone(),
        duration_s: run.duration_s,
        cycles: run.cycles,
        force_min_n: run.valley_force_n,
        force_max_n: run.peak_force_n,
        displacement_min_mm: run.valley_displacement_mm,
        displacement_max_mm: run.peak_displacement_mm,
        velocity_max_mm_s: run.peak_velocity_mm_s,
        energy_j: run.energy_j,
        margins: run.margins.iter().map(margin).collect(),
        trips: run.predicted_trips.iter().map(ToString::to_string).collect(),
        accept: profile.accept.iter().map(PlannedLimit::of).collect(),
        course: course.map(CourseThinner::end),
    })
}

/// Refuses a plan that exceeds a limit, with status 422 and the values.
pub(crate) fn refuse_predicted_trip(plan: &Plan) -> Result<(), ApiError> {
    if plan.trips.is_empty() {
        return Ok(());
    }
    Err(ApiError::new(
        StatusCode::UNPROCESSABLE_ENTITY,
        format!(
            "profile {} is predicted to trip: {}",
            plan.profile,
            plan.trips.join("; ")
        ),
        "lower its levels or its speed, or correct the limits or the model of the bench".to_owned(),
    ))
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::super::course::STRETCHES;
    use super::*;

    #[test]
    fn a_check_of_a_thousand_hours_ends_at_the_first_look_after_it_is_no_longer_wanted() {
        let text = "name = \"long\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"hold\"\n\
                    duration_s = 3.6e6\n";
        let profile = Profile::from_toml(text, "long").expect("a profile");
        let looks = Cell::new(0);
        let is_wanted = || {
            looks.set(looks.get() + 1);
            looks.get() < 3
        };
        let ended = check_while(&Bench::shipped().expect("built in"), &profile, false, &is_wanted);
        assert!(matches!(ended, Err(PlanError::BrokenOff)), "{ended:?}");
        assert_eq!(looks.get(), 3);
    }

    #[test]
    fn the_course_of_every_shipped_profile_keeps_its_peaks_in_few_points() {
        let bench = Bench::shipped().expect("built in");
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/profiles");
        for entry in std::fs::read_dir(folder).expect("shipped") {
            let path = entry.expect("readable").path();
            let name = path.display().to_string();
            let text = std::fs::read_to_string(&path).expect("readable");
            let profile = Profile::from_toml(&text, &name).expect("shipped");
            let plan = check_while(&bench, &profile, true, &|| true).expect("checked");
            let course = plan.course.expect("asked for");
            assert!(course.time_s.len() as u64 <= 2 * STRETCHES, "{name}");
            assert!(course.time_s.is_sorted(), "{name}");
            let highest = |values: &[f64]| values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let span_n = plan.force_max_n - plan.force_min_n;
            assert!(
                plan.force_max_n - highest(&course.force_n) < 0.02 * span_n,
                "{name}"
            );
            let late_s = plan.duration_s - highest(&course.time_s);
            assert!(late_s.abs() < 0.01 * plan.duration_s, "{name}: {late_s} s");
        }
    }
}
