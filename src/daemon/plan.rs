//! Checks a profile before anything moves: against the bench's limits, and dry-run on the bench's model.

use axum::http::StatusCode;
use serde::{Deserialize, Serialize};

use super::api::ApiError;
use crate::config::Bench;
use crate::model::BuildError;
use crate::profile::{Profile, ProfileError};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::twin::{self, dry_run};

/// What a profile will do, as the model has it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub(crate) struct Plan {
    /// Profile's name.
    pub profile: String,
    /// Length in s.
    pub duration_s: f64,
    /// Counted cycles.
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
    /// Work done on the specimen and not given back, in J.
    pub energy_j: f64,
    /// How far each limit is away.
    pub margins: Vec<PlanMargin>,
    /// What would trip, one sentence each; empty where the profile may run.
    pub trips: Vec<String>,
}

/// How far a limit is away.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub(crate) struct PlanMargin {
    /// The limit's key in the bench config; its ending is the unit.
    pub limit: String,
    /// Predicted extreme.
    pub predicted: f64,
    /// The limit.
    pub allowed: f64,
    /// When, in s of the profile.
    pub at_s: f64,
    /// What is left, in percent of the limit; negative beyond it.
    pub margin_percent: f64,
}

/// Why a profile could not be dry-run.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PlanError {
    /// The bench's model.
    #[error("the bench's model cannot be built")]
    Model(#[from] BuildError),
    /// The profile.
    #[error(transparent)]
    Profile(#[from] ProfileError),
}

/// What `profile` will do on the bench's model, and what would trip.
pub(crate) fn check(bench: &Bench, profile: &Profile) -> Result<Plan, PlanError> {
    let plant = bench.model.plant()?;
    let run = dry_run(
        profile,
        plant.as_ref(),
        &bench.profile_limits(),
        f64::from(SAMPLE_RATE_HZ),
    )?;
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
    })
}

/// Refuses a plan that would trip: 422 with the numbers.
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
        "lower its levels or speed, or check the bench's limits and model".to_owned(),
    ))
}
