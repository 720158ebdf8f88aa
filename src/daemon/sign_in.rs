//! Signs browsers in: the page without a session, links that work once, the session's cookie and key. And the audit log, for
//! administrators.

use axum::extract::{Query, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::access::Person;
use super::access::secret::Secret;
use super::access::sessions::{LINK_LIFE, SESSION_LIFE_S};
use super::audit;
use super::audit::chain::{self, AuditEntry, Deed};
use super::blocking::blocking;
use super::client_types::{Nothing, SignIn, SignInLink, SignedIn};
use super::error::ApiError;
use super::gate;
use super::guard::Peer;
use super::request_body::JsonBody;
use super::state::{App, DaemonState};

/// Path of the page that takes the secret of a link. The secret is behind the `#`, which browsers do not send: it is in no log.
pub(super) const LOGIN_PATH: &str = "/login";
/// Entries that are sent if the request does not say how many.
const LAST: usize = 100;
/// Most entries of one answer.
const MOST_ENTRIES: usize = 10_000;

/// The page that takes the secret of a link.
pub(super) async fn login_page() -> Response {
    gate::sign_in_page(StatusCode::OK)
}

/// The address that signs a browser of this computer in.
pub(super) fn link_url(state: &DaemonState, secret: &Secret) -> String {
    format!("http://{}{LOGIN_PATH}#{}", state.settings.local, secret.reveal())
}

/// Signs a browser in, with the secret of a link or with a token. The answer sets the cookie of the session, which watches and
/// stops; orders need the key of the answer.
#[utoipa::path(post, path = "/api/login", request_body = SignIn, responses((status = 200, body = SignedIn)))]
pub(super) async fn login(
    State(state): App,
    Extension(peer): Extension<Peer>,
    JsonBody(request): JsonBody<SignIn>,
) -> Result<Response, ApiError> {
    let signed_in = blocking(&state, move |state| {
        let signed_in = state.access.sign_in(request.secret.trim(), peer.is_local);
        signed_in.map_err(|e| ApiError::internal(&format!("the session cannot be stored: {e}")))
    })
    .await?;
    let Some((person, secrets)) = signed_in else {
        return Err(gate::wrong(&state, peer));
    };
    state.audit.note(Deed {
        who: person.name.clone(),
        role: person.role.word().to_owned(),
        from: peer.address.to_string(),
        what: "signs a browser in".to_owned(),
        status: StatusCode::OK.as_u16(),
        ..Deed::default()
    });
    let secure = if peer.is_local { "" } else { "; Secure" };
    let cookie = format!(
        "{}={}; Max-Age={SESSION_LIFE_S}; Path=/; HttpOnly; SameSite=Strict{secure}",
        gate::cookie_name(&state),
        secrets.cookie.reveal()
    );
    let answer = SignedIn {
        name: person.name,
        role: person.role,
        key: secrets.key.reveal().to_owned(),
    };
    Ok(([(header::SET_COOKIE, cookie)], Json(answer)).into_response())
}

/// A link that signs a browser in as the person who asks. It works once, for ten minutes.
#[utoipa::path(post, path = "/api/link", request_body = Nothing,
    responses((status = 200, body = SignInLink)))]
pub(super) async fn link(
    State(state): App,
    Extension(person): Extension<Person>,
) -> Result<Json<SignInLink>, ApiError> {
    let secret = state.access.link(&person);
    let secret = secret.map_err(|e| ApiError::internal(&format!("there is no random number: {e}")))?;
    Ok(Json(SignInLink {
        url: link_url(&state, &secret),
        works_s: LINK_LIFE.as_secs(),
    }))
}

/// Which part of the audit log is asked for.
#[derive(Debug, Default, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct AuditPart {
    /// Number of entries, the newest ones.
    last: Option<usize>,
}

/// The newest entries of the audit log.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct AuditAnswer {
    /// The entries that were asked for, oldest first.
    pub entries: Vec<AuditEntry>,
    /// What a check of the whole log found; empty if it is whole.
    pub problems: Vec<String>,
}

/// The newest entries of the audit log, and whether the whole log is as it was written.
#[utoipa::path(get, path = "/api/audit", params(AuditPart), responses((status = 200, body = AuditAnswer)))]
pub(super) async fn audit_log(
    State(state): App,
    Query(part): Query<AuditPart>,
) -> Result<Json<AuditAnswer>, ApiError> {
    blocking(&state, move |state| {
        let folder = &state.settings.data_folder;
        let (text, end) = audit::read(folder)
            .map_err(|e| ApiError::internal(&format!("the audit log cannot be read: {e}")))?;
        let wanted = part.last.unwrap_or(LAST).min(MOST_ENTRIES);
        let skipped = text.lines().count().saturating_sub(wanted);
        Ok(Json(AuditAnswer {
            entries: chain::entries(text.lines().skip(skipped)),
            problems: chain::check(&text, &end).problems,
        }))
    })
    .await
}
