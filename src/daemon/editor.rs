//! Requests of the profile editor: the text of a profile, saved and deleted own profiles, and what stands where in a text.

use axum::Json;
use axum::extract::{Path, State};

use super::blocking::blocking;
use super::client_types::{Accepted, Failure, OutlineRequest, ProfileSummary, ProfileText, SaveProfile};
use super::error::ApiError;
use super::library::LibraryError;
use super::request_body::JsonBody;
use super::state::App;
use crate::profile::outline::{self as profile_outline, ProfileOutline};

/// The text of a profile.
#[utoipa::path(get, path = "/api/profiles/{name}", params(("name" = String, Path)),
    responses((status = 200, body = ProfileText), (status = 422, body = Failure)))]
pub(super) async fn text(State(state): App, Path(name): Path<String>) -> Result<Json<ProfileText>, ApiError> {
    blocking(&state, move |state| {
        let found = state.library.text(&name);
        found.map(Json).map_err(|e| ApiError::profile(&e))
    })
    .await
}

/// Saves a text as an own profile, under the name in it, in the data folder. Another profile of this name is replaced only if
/// the request says so. A text that is no profile is refused with line and column.
#[utoipa::path(post, path = "/api/profiles", request_body = SaveProfile,
    responses((status = 200, body = ProfileSummary), (status = 409, body = Failure), (status = 422, body = Failure)))]
pub(super) async fn save(
    State(state): App,
    JsonBody(request): JsonBody<SaveProfile>,
) -> Result<Json<ProfileSummary>, ApiError> {
    blocking(&state, move |state| {
        let saved = state.library.save(&request.text, request.replace);
        saved.map(Json).map_err(|e| ApiError::profile(&e))
    })
    .await
}

/// Deletes an own profile. A shipped one of the same name takes its place again.
#[utoipa::path(delete, path = "/api/profiles/{name}", params(("name" = String, Path)),
    responses((status = 200, body = Accepted), (status = 409, body = Failure), (status = 422, body = Failure)))]
pub(super) async fn delete(State(state): App, Path(name): Path<String>) -> Result<Json<Accepted>, ApiError> {
    blocking(&state, move |state| {
        state.library.delete(&name).map_err(|e| ApiError::profile(&e))?;
        Ok(Json(Accepted {
            message: format!("the profile {name} is deleted"),
        }))
    })
    .await
}

/// Where in the text of a profile each block, segment and value stands, for a form that writes its changes into the text.
/// Values are not judged here: `POST /api/plan` does that.
#[utoipa::path(post, path = "/api/outline", request_body = OutlineRequest,
    responses((status = 200, body = ProfileOutline), (status = 422, body = Failure)))]
pub(super) async fn outline(
    JsonBody(request): JsonBody<OutlineRequest>,
) -> Result<Json<ProfileOutline>, ApiError> {
    let found = profile_outline::outline(&request.text, "text");
    found
        .map(Json)
        .map_err(|e| ApiError::profile(&LibraryError::Profile(e)))
}
