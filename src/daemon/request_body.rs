//! The JSON body of a request, within its limits of size and time.

use axum::Json;
use axum::extract::{FromRequest, Request};
use axum::http::StatusCode;
use serde::de::DeserializeOwned;

use super::error::ApiError;
use super::server::ServerLimits;

/// The body of a request as JSON. A body that does not arrive in time is refused with 408.
pub(super) struct JsonBody<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for JsonBody<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, state: &S) -> Result<Self, ApiError> {
        let limits = request.extensions().get::<ServerLimits>().copied();
        let limit = limits.unwrap_or_default().body;
        match tokio::time::timeout(limit, Json::<T>::from_request(request, state)).await {
            Ok(Ok(Json(value))) => Ok(JsonBody(value)),
            Ok(Err(rejection)) => Err(rejection.into()),
            Err(_) => Err(ApiError::new(
                StatusCode::REQUEST_TIMEOUT,
                format!(
                    "the body of the request did not arrive within {} s",
                    limit.as_secs_f64()
                ),
                "send the request again".to_owned(),
            )),
        }
    }
}
