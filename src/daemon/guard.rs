//! Protects the rig from requests of other web pages. The daemon listens on loopback only, but a browser on the same
//! computer sends requests of any page there. A request must have our address as host, come from our page, and be JSON or bytes
//! that are named so.

use std::net::SocketAddr;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::error::ApiError;

/// Checks the headers of every request.
#[derive(Debug, Clone)]
pub(super) struct RequestGuard {
    /// Host names with port under which this daemon answers.
    hosts: [String; 3],
}

impl RequestGuard {
    /// The guard of a daemon that listens on `address`.
    pub(super) fn new(address: SocketAddr) -> Self {
        let port = address.port();
        RequestGuard {
            hosts: [
                format!("127.0.0.1:{port}"),
                format!("localhost:{port}"),
                format!("[::1]:{port}"),
            ],
        }
    }

    /// The refusal of this request; `None` if it is allowed.
    fn refusal(&self, method: &Method, headers: &HeaderMap) -> Option<ApiError> {
        let forbidden = |what: &str| {
            Some(ApiError::new(
                StatusCode::FORBIDDEN,
                what.to_owned(),
                format!("open http://{}/ on the bench computer", self.hosts[0]),
            ))
        };
        // DNS rebinding: an attacker's host name that resolves to 127.0.0.1 is refused here.
        if !text(headers, header::HOST).is_some_and(|host| self.hosts.iter().any(|h| h == host)) {
            return forbidden("the request has another host than this daemon");
        }
        // Browsers send the origin with every POST and every WebSocket; other programs send none.
        let origin = headers
            .get(header::ORIGIN)
            .map(|o| o.to_str().unwrap_or_default());
        if origin.is_some_and(|o| !self.hosts.iter().any(|h| o == format!("http://{h}"))) {
            return forbidden("the request comes from another web page");
        }
        // A form of another page cannot send these types without a preflight request.
        let taken = text(headers, header::CONTENT_TYPE).is_some_and(|t| {
            let kind = t.split(';').next().unwrap_or_default().trim();
            ["application/json", "application/octet-stream"]
                .iter()
                .any(|taken| kind.eq_ignore_ascii_case(taken))
        });
        (method == Method::POST && !taken).then(|| {
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
    // A header that occurs twice is refused: a proxy may have checked the other value.
    if values.next().is_some() {
        None
    } else {
        only.to_str().ok()
    }
}

/// Middleware in front of all routes: refuses a request, or adds the security headers to its answer.
pub(super) async fn check(State(guard): State<RequestGuard>, request: Request, next: Next) -> Response {
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
                // A page with its style inside, and the report of a diagnosis, bring rules of their own.
                headers
                    .entry(name)
                    .or_insert(axum::http::HeaderValue::from_static(value));
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
    fn other_hosts_and_origins_are_forbidden() {
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
        for taken in ["application/json; charset=utf-8", "application/octet-stream"] {
            let headers = [host.clone(), (header::CONTENT_TYPE, taken)];
            assert_eq!(refused(Method::POST, &headers), None, "{taken}");
        }
    }
}
