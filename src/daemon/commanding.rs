//! Reads who sends a request, and holds its order against who commands.

use std::sync::Arc;
use std::time::Instant;

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderMap, StatusCode};

use super::access::Person;
use super::client_types::{CALLER_HEADER, Caller};
use super::commander::{Presence, client_id};
use super::error::ApiError;
use super::orders;
use super::state::DaemonState;
use crate::control::realtime::Request;

/// Longest id of a client, bytes.
const ID_MAX_BYTES: usize = 64;
/// Longest name of a client, characters.
const NAME_MAX_CHARS: usize = 120;

/// Which client of this person sent a request; `None` if it does not say so.
pub(super) fn caller(person: &Person, headers: &HeaderMap) -> Result<Option<Caller>, ApiError> {
    let named = |caller: Caller| Caller {
        person: person.name.clone(),
        ..caller
    };
    Ok(read_caller(headers)?.map(named))
}

/// What the header says.
pub(super) fn read_caller(headers: &HeaderMap) -> Result<Option<Caller>, ApiError> {
    let Some(text) = headers.get(CALLER_HEADER) else {
        return Ok(None);
    };
    let read: Option<Caller> = text
        .to_str()
        .ok()
        .and_then(|text| serde_json::from_str(text).ok());
    let is_right = |caller: &Caller| {
        (1..=ID_MAX_BYTES).contains(&caller.id.len())
            && (1..=NAME_MAX_CHARS).contains(&caller.name.chars().count())
            && !caller.name.chars().any(char::is_control)
    };
    read.filter(is_right).map(Some).ok_or_else(|| {
        ApiError::new(
            StatusCode::BAD_REQUEST,
            format!("the header {CALLER_HEADER} does not say who sends the request"),
            format!(
                "send JSON in ASCII: {{\"id\": 1 to {ID_MAX_BYTES} bytes, \"name\": 1 to {NAME_MAX_CHARS} characters}}"
            ),
        )
    })
}

/// As an argument of a handler: the request is an order, and its client has the command. It is there while the order is
/// served.
pub(super) struct Commanding {
    _presence: Option<Presence>,
}

impl FromRequestParts<Arc<DaemonState>> for Commanding {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &Arc<DaemonState>) -> Result<Self, ApiError> {
        let person = parts.extensions.get::<Person>();
        let person = person.ok_or_else(|| ApiError::internal("an order came without its person"))?;
        let named = caller(person, &parts.headers)?;
        let presence = named
            .as_ref()
            .map(|caller| state.commander.presence(client_id(caller)));
        let claimed = state
            .commander
            .claim(&named.unwrap_or_default(), Instant::now())?;
        if let Some(told) = claimed {
            tracing::info!("{told}");
            state.audit.note_daemon("command", &told);
            if let Err(error) = orders::insist(&state.control, || Request::Note(told.clone())).await {
                tracing::warn!("the run under way has no event of it: {error}");
            }
        }
        Ok(Commanding { _presence: presence })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_that_names_nobody_is_refused_with_what_to_send() {
        let read = |text: &str| {
            let value = axum::http::HeaderValue::from_str(text).expect("a header");
            read_caller(&HeaderMap::from_iter([(
                axum::http::HeaderName::from_static(CALLER_HEADER),
                value,
            )]))
        };
        let long = format!(r#"{{"id":"{}","name":"x"}}"#, "i".repeat(65));
        for wrong in [
            "",
            "page",
            "{}",
            r#"{"id":"","name":"x"}"#,
            r#"{"id":"a","name":"\n"}"#,
            &long,
        ] {
            let refused = read(wrong).expect_err(wrong);
            assert_eq!(refused.status(), StatusCode::BAD_REQUEST);
        }
        let told = read(r#"{"id":"a","name":"page of J. Meyer","stays":true}"#);
        assert_eq!(told.expect("right").expect("named").name, "page of J. Meyer");
        assert!(read_caller(&HeaderMap::new()).expect("nobody").is_none());
    }
}
