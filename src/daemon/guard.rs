//! Keeps foreign web pages away from the rig: the daemon listens on loopback only, and a browser on the same machine
//! would carry any page's request there. Requests must name us as host, come from our own page, and be JSON.

use std::net::SocketAddr;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::api::ApiError;

/// Names under which this daemon answers.
#[derive(Debug, Clone)]
pub(crate) struct RequestGuard {
    hosts: [String; 3],
}

impl RequestGuard {
    /// For a daemon that listens at `address`.
    pub(crate) fn new(address: SocketAddr) -> Self {
        let port = address.port();
        RequestGuard {
            hosts: [
                format!("127.0.0.1:{port}"),
                format!("localhost:{port}"),
                format!("[::1]:{port}"),
            ],
        }
    }

    /// Why this request is not for us, if it is not.
    fn refusal(&self, method: &Method, headers: &HeaderMap) -> Option<ApiError> {
        let forbidden = |what: &str| {
            Some(ApiError::new(
                StatusCode::FORBIDDEN,
                format!("this request {what}"),
                format!("open http://{}/ itself on the bench's computer", self.hosts[0]),
            ))
        };
        // A name that an attacker's DNS points at 127.0.0.1 shows here.
        if !text(headers, header::HOST).is_some_and(|host| self.hosts.iter().any(|h| h == host)) {
            return forbidden("names another host than this daemon");
        }
        // Programs send no origin; browsers do with every POST and every WebSocket.
        let origin = headers
            .get(header::ORIGIN)
            .map(|o| o.to_str().unwrap_or_default());
        if origin.is_some_and(|o| !self.hosts.iter().any(|h| o == format!("http://{h}"))) {
            return forbidden("comes from another web page");
        }
        // A form of a foreign page cannot send this type without asking first.
        let json = text(headers, header::CONTENT_TYPE).is_some_and(|t| {
            t.split(';')
                .next()
                .unwrap_or_default()
                .trim()
                .eq_ignore_ascii_case("application/json")
        });
        (method == Method::POST && !json).then(|| {
            ApiError::new(
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "the request is not JSON".to_owned(),
                "send Content-Type: application/json".to_owned(),
            )
        })
    }
}

fn text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    let mut values = headers.get_all(name).iter();
    let only = values.next()?;
    // Two of one name: whoever sits in between may have read the other one.
    if values.next().is_some() {
        None
    } else {
        only.to_str().ok()
    }
}

/// The middleware: in front of everything, routing included.
pub(crate) async fn check(State(guard): State<RequestGuard>, request: Request, next: Next) -> Response {
    match guard.refusal(request.method(), request.headers()) {
        Some(refusal) => refusal.into_response(),
        None => {
            let mut response = next.run(request).await;
            let headers = response.headers_mut();
            let fixed = [
                (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
                (header::X_FRAME_OPTIONS, "DENY"),
                (header::REFERRER_POLICY, "no-referrer"),
                (header::CACHE_CONTROL, "no-store"),
                (
                    header::CONTENT_SECURITY_POLICY,
                    "default-src 'self'; frame-ancestors 'none'; base-uri 'none'",
                ),
            ];
            for (name, value) in fixed {
                headers.insert(name, axum::http::HeaderValue::from_static(value));
            }
            response
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(method: Method, headers: &[(HeaderName, &str)]) -> Option<StatusCode> {
        let guard = RequestGuard::new("127.0.0.1:8000".parse().expect("an address"));
        let headers: HeaderMap = headers
            .iter()
            .map(|(n, v)| (n.clone(), v.parse().expect("a value")))
            .collect();
        guard.refusal(&method, &headers).map(|e| e.status())
    }

    #[test]
    fn hosts_and_origins_of_others_are_forbidden() {
        let host = (header::HOST, "127.0.0.1:8000");
        assert_eq!(refused(Method::GET, std::slice::from_ref(&host)), None);
        assert_eq!(refused(Method::GET, &[(header::HOST, "localhost:8000")]), None);
        for forged in [
            "",
            "evil.example:8000",
            "127.0.0.1",
            "127.0.0.1:80",
            "127.0.0.1:8000.evil.example",
        ] {
            assert_eq!(
                refused(Method::GET, &[(header::HOST, forged)]),
                Some(StatusCode::FORBIDDEN),
                "{forged}"
            );
        }
        assert_eq!(refused(Method::GET, &[]), Some(StatusCode::FORBIDDEN));
        let forged = [
            "null",
            "",
            "http://evil.example",
            "https://127.0.0.1:8000",
            "http://127.0.0.1:8001",
        ];
        for origin in forged {
            let headers = [host.clone(), (header::ORIGIN, origin)];
            assert_eq!(
                refused(Method::GET, &headers),
                Some(StatusCode::FORBIDDEN),
                "{origin}"
            );
        }
        assert_eq!(
            refused(Method::GET, &[host, (header::ORIGIN, "http://127.0.0.1:8000")]),
            None
        );
    }

    #[test]
    fn a_post_must_be_json() {
        let host = (header::HOST, "127.0.0.1:8000");
        for form in [
            "text/plain",
            "application/x-www-form-urlencoded",
            "multipart/form-data",
        ] {
            let headers = [host.clone(), (header::CONTENT_TYPE, form)];
            assert_eq!(
                refused(Method::POST, &headers),
                Some(StatusCode::UNSUPPORTED_MEDIA_TYPE)
            );
        }
        assert_eq!(
            refused(Method::POST, std::slice::from_ref(&host)),
            Some(StatusCode::UNSUPPORTED_MEDIA_TYPE)
        );
        let json = [host, (header::CONTENT_TYPE, "application/json; charset=utf-8")];
        assert_eq!(refused(Method::POST, &json), None);
    }
}
