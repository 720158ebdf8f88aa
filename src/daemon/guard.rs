//! Protects the rig from requests of other web pages. A browser sends requests of any page to any address, also to a daemon that
//! listens on loopback only. A request must have one of our addresses as host, come from our page, and be JSON or bytes that
//! are named so. `gate` then asks who sends it.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::error::ApiError;

/// Pages that another page may link to: they show nothing by themselves to somebody who is not signed in.
const LINKED: [&str; 2] = ["/", "/login"];

/// One address under which this daemon answers.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Site {
    /// Host with port, as in the header `Host`.
    host: String,
    /// The origin of our page there.
    origin: String,
    kind: SiteKind,
}

/// How a request gets to a site.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum SiteKind {
    /// Over the loopback address of this computer.
    Local,
    /// From another computer, over TLS.
    Direct,
    /// Through a proxy with TLS.
    Proxy,
}

/// The other end of a connection, as the server sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct PeerAddress(pub IpAddr);

/// Where a request comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Peer {
    /// Of the client; 0.0.0.0 if a proxy did not say it.
    pub address: IpAddr,
    /// It is on this computer, and uses its loopback address.
    pub is_local: bool,
}

/// Checks the headers of every request.
#[derive(Debug, Clone)]
pub(super) struct RequestGuard {
    sites: Arc<Vec<Site>>,
}

impl RequestGuard {
    /// The guard of a daemon that answers this computer at `local`.
    pub(super) fn new(local: SocketAddr) -> Self {
        let port = local.port();
        let names = ["127.0.0.1", "localhost", "[::1]"];
        let site = |name: &str| Site {
            host: format!("{name}:{port}"),
            origin: format!("http://{name}:{port}"),
            kind: SiteKind::Local,
        };
        RequestGuard {
            sites: Arc::new(names.into_iter().map(site).collect()),
        }
    }

    fn with(mut self, host: String, kind: SiteKind) -> Self {
        let origin = format!("https://{host}");
        Arc::make_mut(&mut self.sites).push(Site { host, origin, kind });
        self
    }

    /// Also answers other computers at this address over TLS, under its number and under `names`.
    pub(super) fn with_tls(self, address: SocketAddr, names: &[String]) -> Self {
        let port = address.port();
        let guard = self.with(address.to_string(), SiteKind::Direct);
        names.iter().fold(guard, |guard, name| {
            let guard = guard.with(format!("{name}:{port}"), SiteKind::Direct);
            // Browsers leave out the port of https.
            if port == 443 {
                guard.with(name.clone(), SiteKind::Direct)
            } else {
                guard
            }
        })
    }

    /// Also answers under the name of a proxy with TLS.
    pub(super) fn with_proxy(self, name: &str) -> Self {
        self.with(name.to_owned(), SiteKind::Proxy)
    }

    /// The site that a request asks for.
    fn site(&self, headers: &HeaderMap) -> Option<&Site> {
        let host = text(headers, header::HOST)?;
        self.sites
            .iter()
            .find(|site| site.host.eq_ignore_ascii_case(host))
    }

    /// Where a request to `site` comes from.
    fn peer(site: &Site, end: Option<&PeerAddress>, headers: &HeaderMap) -> Peer {
        let unknown = IpAddr::from(Ipv4Addr::UNSPECIFIED);
        let end = end.map_or(unknown, |end| end.0);
        // The last one is what our own proxy has written.
        let forwarded = || {
            let told = headers.get_all("x-forwarded-for").iter().next_back()?;
            let last = told.to_str().ok()?.rsplit(',').next()?;
            last.trim().parse().ok()
        };
        Peer {
            address: match site.kind {
                SiteKind::Proxy => forwarded().unwrap_or(unknown),
                SiteKind::Local | SiteKind::Direct => end,
            },
            is_local: site.kind == SiteKind::Local && end.is_loopback(),
        }
    }

    /// The refusal of this request; `None` if it is allowed.
    fn refusal(&self, method: &Method, path: &str, headers: &HeaderMap) -> Option<ApiError> {
        let forbidden = |what: &str| {
            let for_others = self.sites.iter().find(|site| site.kind != SiteKind::Local);
            let what_to_do = match (for_others, self.sites.first()) {
                (Some(site), _) => {
                    format!(
                        "open {}/; the daemon takes another name with --name NAME",
                        site.origin
                    )
                }
                (None, Some(site)) => format!("open {}/ on the bench computer", site.origin),
                (None, None) => String::new(),
            };
            let status = StatusCode::FORBIDDEN;
            Some(ApiError::new(status, what.to_owned(), what_to_do))
        };
        // DNS rebinding: an attacker's host name that resolves to our address is refused here.
        let Some(site) = self.site(headers) else {
            return forbidden("the request has another host than this daemon");
        };
        // Browsers send the origin with every POST and every WebSocket; other programs send none.
        let origin = headers
            .get(header::ORIGIN)
            .map(|o| o.to_str().unwrap_or_default());
        if origin.is_some_and(|o| o != site.origin) {
            return forbidden("the request comes from another web page");
        }
        if is_from_elsewhere(headers) && !is_link(method, path, headers) {
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

/// The browser says that another page asked for this, also one at another port of this computer. `none` is the person: the
/// address bar, or a bookmark.
fn is_from_elsewhere(headers: &HeaderMap) -> bool {
    headers
        .get_all("sec-fetch-site")
        .iter()
        .any(|site| site != "same-origin" && site != "none")
}

/// A person follows a link to our page.
fn is_link(method: &Method, path: &str, headers: &HeaderMap) -> bool {
    let is = |name: &'static str, value: &str| text(headers, HeaderName::from_static(name)) == Some(value);
    method == Method::GET
        && LINKED.contains(&path)
        && is("sec-fetch-mode", "navigate")
        && is("sec-fetch-dest", "document")
}

/// A header that occurs once. One that occurs twice is as good as none: a proxy may have checked the other value.
pub(super) fn text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    let mut values = headers.get_all(name).iter();
    let only = values.next()?;
    if values.next().is_some() {
        None
    } else {
        only.to_str().ok()
    }
}

/// Middleware in front of all routes: refuses a request, or adds the security headers to its answer.
pub(super) async fn check(State(guard): State<RequestGuard>, mut request: Request, next: Next) -> Response {
    let refusal = guard.refusal(request.method(), request.uri().path(), request.headers());
    if let Some(refusal) = refusal {
        return refusal.into_response();
    }
    if let Some(site) = guard.site(request.headers()) {
        let end = request.extensions().get::<PeerAddress>();
        let peer = RequestGuard::peer(site, end, request.headers());
        request.extensions_mut().insert(peer);
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(method: Method, headers: &[(HeaderName, &str)]) -> Option<StatusCode> {
        let guard = RequestGuard::new("127.0.0.1:8000".parse().expect("an address"));
        let headers: HeaderMap = headers
            .iter()
            .map(|(n, v)| (n.clone(), v.parse().expect("a value")))
            .collect();
        guard
            .refusal(&method, "/api/status", &headers)
            .map(|e| e.status())
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

    #[test]
    fn a_browser_that_says_that_another_page_asks_is_refused() {
        let of = |site: &str, mode: &str, path: &str| {
            let guard = RequestGuard::new("127.0.0.1:8000".parse().expect("an address"));
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, "127.0.0.1:8000".parse().expect("a value"));
            for (name, value) in [
                ("sec-fetch-site", site),
                ("sec-fetch-mode", mode),
                ("sec-fetch-dest", "document"),
            ] {
                headers.insert(name, value.parse().expect("a value"));
            }
            guard.refusal(&Method::GET, path, &headers).map(|e| e.status())
        };
        for (site, mode, path, refused) in [
            ("same-origin", "cors", "/api/status", false),
            ("none", "navigate", "/api/status", false),
            ("cross-site", "no-cors", "/api/status", true),
            // Another port of this computer.
            ("same-site", "no-cors", "/api/status", true),
            ("cross-site", "navigate", "/api/runs/x/csv", true),
            ("cross-site", "navigate", "/", false),
            ("cross-site", "no-cors", "/", true),
        ] {
            let expected = refused.then_some(StatusCode::FORBIDDEN);
            assert_eq!(of(site, mode, path), expected, "{site} {mode} {path}");
        }
    }

    #[test]
    fn only_loopback_is_local_and_a_proxy_says_who_is_behind_it() {
        let local: SocketAddr = "127.0.0.1:8000".parse().expect("an address");
        let guard = RequestGuard::new(local)
            .with_tls("10.0.0.5:443".parse().expect("an address"), &["bench".to_owned()])
            .with_proxy("lab.example");
        let of = |host: &str, end: [u8; 4]| {
            let headers: HeaderMap = [
                (header::HOST, host.parse().expect("a value")),
                (
                    HeaderName::from_static("x-forwarded-for"),
                    "1.1.1.1, 10.9.9.9".parse().expect("a value"),
                ),
            ]
            .into_iter()
            .collect();
            let site = guard.site(&headers)?;
            let peer = RequestGuard::peer(site, Some(&PeerAddress(end.into())), &headers);
            Some((peer.address.to_string(), peer.is_local))
        };
        let told = |address: &str, is_local| Some((address.to_owned(), is_local));
        assert_eq!(of("localhost:8000", [127, 0, 0, 1]), told("127.0.0.1", true));
        assert_eq!(of("localhost:8000", [10, 0, 0, 7]), told("10.0.0.7", false));
        assert_eq!(of("bench", [10, 0, 0, 7]), told("10.0.0.7", false));
        assert_eq!(of("10.0.0.5:443", [127, 0, 0, 1]), told("127.0.0.1", false));
        assert_eq!(of("lab.example", [127, 0, 0, 1]), told("10.9.9.9", false));
        assert_eq!(of("other.example", [127, 0, 0, 1]), None);
    }
}
