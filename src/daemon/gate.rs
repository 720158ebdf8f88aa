//! The gate of each route: who sends a request, and whether their role is enough. Orders go to the audit log here, with their
//! answer; refused ones too.

use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::access::role::{Needs, Role};
use super::access::{Known, MOST_WRONG, Person, Shown, WINDOW};
use super::audit::chain::Deed;
use super::commanding;
use super::error::{ApiError, AuditNote};
use super::guard::{self, Peer};
use super::server::STOP_PATH;
use super::state::DaemonState;

/// What the audit log has in place of a status for a client that left before the answer.
const CLIENT_LEFT: u16 = 499;

/// The page without a session.
const SIGN_IN_PAGE: &str = include_str!("page/login.html");

/// Name of the session's cookie. Cookies do not keep the ports of a computer apart, so each daemon has its own.
pub(super) fn cookie_name(state: &DaemonState) -> String {
    format!("leafbench-{}", state.settings.listen.port())
}

/// The page that says how to sign in, and that takes the secret of a link.
pub(super) fn sign_in_page(status: StatusCode) -> Response {
    let kind = [(header::CONTENT_TYPE, "text/html; charset=utf-8")];
    (status, kind, SIGN_IN_PAGE).into_response()
}

/// What one route asks for.
#[derive(Clone)]
pub(super) struct Gate {
    pub state: Arc<DaemonState>,
    pub needs: Needs,
}

impl Gate {
    /// Who sends the request; the refusal if it is nobody with the role of this route.
    fn admit(&self, peer: Peer, headers: &HeaderMap) -> Result<Person, Refused> {
        let role = self.needs.role.unwrap_or(Role::Watch);
        let cookie_name = cookie_name(&self.state);
        let shown = Shown {
            bearer: bearer(headers),
            cookie: cookie(headers, &cookie_name),
            is_local: peer.is_local,
        };
        match self.state.access.identify(shown) {
            Known::Person(person) if person.role < role => {
                let refusal = too_small(&person, role);
                Err(Refused::Person(Box::new(person), refusal))
            }
            Known::Person(person) if !person.has_key && !self.needs.by_cookie => {
                Err(Refused::Person(Box::new(person), only_a_cookie()))
            }
            Known::Person(person) => Ok(person),
            Known::Nobody => Err(Refused::Nobody(not_signed_in("the request has no token"))),
            Known::Wrong => Err(Refused::Wrong(wrong(&self.state, peer))),
        }
    }

    /// Whether the audit log has the requests of this route.
    fn is_audited(&self, method: &Method, path: &str) -> bool {
        let is_order =
            self.needs.role >= Some(Role::Operate) && method != Method::GET && method != Method::HEAD;
        is_order || path == STOP_PATH || self.needs.role == Some(Role::Administer)
    }
}

/// Why a request is refused.
enum Refused {
    /// This person may not do it.
    Person(Box<Person>, ApiError),
    /// No secret was shown.
    Nobody(ApiError),
    /// A secret was shown that is none of ours.
    Wrong(ApiError),
}

/// The token of the header `Authorization`; empty if it is there and has none.
fn bearer(headers: &HeaderMap) -> Option<&str> {
    headers.get(header::AUTHORIZATION)?;
    let told = guard::text(headers, header::AUTHORIZATION).unwrap_or_default();
    let (scheme, token) = told.split_once(' ').unwrap_or_default();
    Some(if scheme.eq_ignore_ascii_case("bearer") {
        token.trim()
    } else {
        ""
    })
}

/// The value of our cookie.
fn cookie<'h>(headers: &'h HeaderMap, name: &str) -> Option<&'h str> {
    let texts = headers
        .get_all(header::COOKIE)
        .iter()
        .filter_map(|v| v.to_str().ok());
    let mut pairs = texts
        .flat_map(|text| text.split(';'))
        .filter_map(|pair| pair.trim().split_once('='));
    pairs.find_map(|(key, value)| (key == name).then_some(value))
}

fn too_small(person: &Person, role: Role) -> ApiError {
    ApiError::new(
        StatusCode::FORBIDDEN,
        format!(
            "the token \"{}\" may {}, and this needs the role {role}",
            person.name, person.role
        ),
        "ask the person who administers the bench; a stop is taken from everyone".to_owned(),
    )
}

fn only_a_cookie() -> ApiError {
    ApiError::new(
        StatusCode::UNAUTHORIZED,
        "this page has lost its key, so it may only watch and stop".to_owned(),
        "open the link that `leafbench open` prints on the bench computer".to_owned(),
    )
}

/// 401, with what to do.
fn not_signed_in(error: &str) -> ApiError {
    ApiError::new(
        StatusCode::UNAUTHORIZED,
        error.to_owned(),
        "page: open the link that `leafbench open` prints on the bench computer; program: send the header Authorization: Bearer \
         TOKEN, with the token of the file `token` in the data folder, or of `leafbench token add`"
            .to_owned(),
    )
}

/// 401 for a wrong secret, 429 for many of them. Somebody with a right one is never kept waiting: otherwise every program on
/// the bench computer could keep the operator out, and 256 random bits are not guessed at any speed.
pub(super) fn wrong(state: &DaemonState, peer: Peer) -> ApiError {
    let count = state.access.note_wrong(peer.address);
    if count == 1 || count == MOST_WRONG + 1 {
        let told = if count == 1 {
            "a wrong token"
        } else {
            "more wrong tokens, refused unseen for a while"
        };
        state.audit.note(Deed {
            who: "nobody".to_owned(),
            from: peer.address.to_string(),
            what: told.to_owned(),
            ..Deed::default()
        });
    }
    if count <= MOST_WRONG {
        return not_signed_in("the token is not valid, or its session has ended");
    }
    ApiError::new(
        StatusCode::TOO_MANY_REQUESTS,
        format!(
            "{MOST_WRONG} wrong tokens came from {} within {} s",
            peer.address,
            WINDOW.as_secs()
        ),
        format!("wait {} s, then send the right token", WINDOW.as_secs()),
    )
}

/// A request whose answer goes to the audit log, also if its client leaves before.
struct Audited {
    state: Arc<DaemonState>,
    /// `None` once it is noted.
    deed: Option<Deed>,
}

impl Audited {
    fn answered(mut self, response: &Response) {
        if let Some(mut deed) = self.deed.take() {
            deed.status = response.status().as_u16();
            if let Some(AuditNote(detail)) = response.extensions().get() {
                deed.detail.clone_from(detail);
            }
            self.state.audit.note(deed);
        }
    }
}

impl Drop for Audited {
    fn drop(&mut self) {
        if let Some(mut deed) = self.deed.take() {
            deed.status = CLIENT_LEFT;
            "the client left before the answer".clone_into(&mut deed.detail);
            self.state.audit.note(deed);
        }
    }
}

fn deed(person: Option<&Person>, peer: Peer, request: &Request) -> Deed {
    let caller = commanding::read_caller(request.headers()).ok().flatten();
    Deed {
        who: person.map_or("nobody", |person| &person.name).to_owned(),
        role: person.map_or("", |person| person.role.word()).to_owned(),
        from: peer.address.to_string(),
        client: caller.map(|caller| caller.name).unwrap_or_default(),
        what: format!("{} {}", request.method(), request.uri().path()),
        ..Deed::default()
    }
}

/// Middleware of each route. The handler finds the [`Person`] in the extensions of the request.
pub(super) async fn check(State(gate): State<Gate>, mut request: Request, next: Next) -> Response {
    if gate.needs.role.is_none() {
        return next.run(request).await;
    }
    let unknown = Peer {
        address: IpAddr::from(Ipv4Addr::UNSPECIFIED),
        is_local: false,
    };
    let peer = request.extensions().get::<Peer>().copied().unwrap_or(unknown);
    let admitted = gate.admit(peer, request.headers());
    let person = match &admitted {
        Ok(person) => Some(person),
        Err(Refused::Person(person, _)) => Some(&**person),
        Err(_) => None,
    };
    // A request without any secret tells nothing about anybody, and wrong ones are noted already.
    let is_audited = person.is_some() && gate.is_audited(request.method(), request.uri().path());
    let audited = is_audited.then(|| Audited {
        state: Arc::clone(&gate.state),
        deed: Some(deed(person, peer, &request)),
    });
    let response = match admitted {
        Ok(person) => {
            request.extensions_mut().insert(person);
            next.run(request).await
        }
        Err(Refused::Person(_, refusal) | Refused::Nobody(refusal) | Refused::Wrong(refusal)) => {
            match request.uri().path() {
                "/" => sign_in_page(refusal.into_response().status()),
                _ => refusal.into_response(),
            }
        }
    };
    if let Some(audited) = audited {
        audited.answered(&response);
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(pairs: &[(&'static str, &str)]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for (name, value) in pairs {
            headers.append(*name, value.parse().expect("a value"));
        }
        headers
    }

    #[test]
    fn a_token_is_read_from_one_header_only() {
        assert_eq!(bearer(&headers(&[])), None);
        assert_eq!(bearer(&headers(&[("authorization", "Bearer abc")])), Some("abc"));
        assert_eq!(bearer(&headers(&[("authorization", "bearer abc")])), Some("abc"));
        for other in ["abc", "Basic abc", "Bearer", ""] {
            assert_eq!(bearer(&headers(&[("authorization", other)])), Some(""), "{other}");
        }
        let twice = headers(&[("authorization", "Bearer a"), ("authorization", "Bearer b")]);
        assert_eq!(bearer(&twice), Some(""));
    }

    #[test]
    fn our_cookie_is_found_among_others() {
        let told = headers(&[
            ("cookie", "a=1; leafbench-80=x; b=2"),
            ("cookie", "leafbench-8000=y"),
        ]);
        assert_eq!(cookie(&told, "leafbench-8000"), Some("y"));
        assert_eq!(cookie(&told, "leafbench-80"), Some("x"));
        assert_eq!(cookie(&told, "leafbench-8"), None);
    }
}
