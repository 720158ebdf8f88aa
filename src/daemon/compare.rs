//! Two runs over each other: force over displacement of both, the difference, and their figures side by side.

use axum::Json;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, State};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::blocking::blocking;
use super::client_types::{Failure, RunSummary};
use super::error::ApiError;
use super::state::{App, DaemonState};
use crate::recording::overlay::{LoopBranch, RunFigures, RunOverlay};
use crate::recording::run_file::RunFile;

/// Points of a difference over the travel that both runs have.
const POINTS: u32 = 201;

/// Which runs are compared.
#[derive(Debug, Clone, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct CompareQuery {
    /// Run id, whole or short.
    first: String,
    /// Run id of the run that is subtracted.
    second: String,
}

/// Two runs over each other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(super) struct RunComparison {
    pub first: ComparedRun,
    pub second: ComparedRun,
    /// Force of the first run minus that of the second, at equal displacement and direction.
    pub difference: ForceDifference,
}

/// One of two runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(super) struct ComparedRun {
    /// The same as in the list of runs.
    pub summary: RunSummary,
    /// Number of complete cycles whose mean loop this is; 0 where it is the whole motion.
    pub cycles: usize,
    /// Displacements of the course in mm, in the order of time.
    pub displacement_mm: Vec<f64>,
    /// Forces of the course in N.
    pub force_n: Vec<f64>,
    pub figures: RunFigures,
}

/// The difference of two runs; null at a displacement that one of them does not have in this direction.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub(super) struct ForceDifference {
    /// Displacements that both runs have, in mm.
    pub displacement_mm: Vec<f64>,
    /// Difference while the displacement rises, in N.
    pub loading_n: Vec<Option<f64>>,
    /// Difference while the displacement falls, in N.
    pub unloading_n: Vec<Option<f64>>,
    /// Root mean square of both, in N; null if the runs have no displacement in common.
    pub rms_n: Option<f64>,
    /// Largest absolute value of both, in N.
    pub largest_n: Option<f64>,
}

/// Two runs over each other: the mean loop of the cycles, or the whole motion where a run has no two complete cycles.
#[utoipa::path(get, path = "/api/compare", params(CompareQuery),
    responses((status = 200, body = RunComparison), (status = 404, body = Failure), (status = 409, body = Failure)))]
pub(super) async fn compare(
    State(state): App,
    query: Result<Query<CompareQuery>, QueryRejection>,
) -> Result<Json<RunComparison>, ApiError> {
    let query = query?.0;
    blocking(&state, move |state| {
        let (first, a) = read(state, &query.first)?;
        let (second, b) = read(state, &query.second)?;
        Ok(Json(RunComparison {
            first,
            second,
            difference: difference(&a, &b),
        }))
    })
    .await
}

fn read(state: &DaemonState, id: &str) -> Result<(ComparedRun, RunOverlay), ApiError> {
    let listing = state.store.find(id).map_err(ApiError::not_found)?;
    let run = RunFile::open(&listing.path).map_err(ApiError::disk)?;
    let overlay = RunOverlay::of(&run, &run.survey());
    let (displacement_mm, force_n) = overlay.course.iter().copied().unzip();
    let compared = ComparedRun {
        summary: RunSummary::from(listing),
        cycles: overlay.cycles,
        displacement_mm,
        force_n,
        figures: overlay.figures,
    };
    Ok((compared, overlay))
}

fn difference(a: &RunOverlay, b: &RunOverlay) -> ForceDifference {
    let ranges = [&a.loading, &a.unloading, &b.loading, &b.unloading];
    let of_run = |branches: &[&LoopBranch]| {
        let ranges = branches.iter().filter_map(|branch| branch.range_mm());
        ranges.reduce(|r, s| (r.0.min(s.0), r.1.max(s.1)))
    };
    let common = of_run(&ranges[..2]).zip(of_run(&ranges[2..]));
    let Some((low, high)) = common
        .map(|(r, s)| (r.0.max(s.0), r.1.min(s.1)))
        .filter(|(low, high)| low < high)
    else {
        return ForceDifference::default();
    };
    let at = |i: u32| low + (high - low) * f64::from(i) / f64::from(POINTS - 1);
    let displacement_mm: Vec<f64> = (0..POINTS).map(at).collect();
    let minus = |a: &LoopBranch, b: &LoopBranch| -> Vec<Option<f64>> {
        let at = displacement_mm.iter();
        at.map(|&x| Some(a.force_n(x)? - b.force_n(x)?)).collect()
    };
    let (loading_n, unloading_n) = (minus(&a.loading, &b.loading), minus(&a.unloading, &b.unloading));
    let all: Vec<f64> = loading_n.iter().chain(&unloading_n).flatten().copied().collect();
    let squares: f64 = all.iter().map(|n| n * n).sum();
    ForceDifference {
        rms_n: (!all.is_empty()).then(|| (squares / all.len() as f64).sqrt()),
        largest_n: all.iter().map(|n| n.abs()).reduce(f64::max),
        displacement_mm,
        loading_n,
        unloading_n,
    }
}
