//! Serves HTTP connections within limits: how many are open, how long a request may take to arrive, how long a client may not
//! read. `connections` chooses the connection that gives way to a new one; `api` has the routes.

use std::convert::Infallible;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::http::{Method, Request, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::{Router, http};
use hyper::body::{Body as HttpBody, Frame, Incoming, SizeHint};
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use nix::sys::socket::{setsockopt, sockopt};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsAcceptor;

use super::connections::{Connection, Connections, InUse};
use super::error::ApiError;
use super::guard::PeerAddress;

/// The request that is answered also when all ordinary connections are in use.
pub(super) const STOP_PATH: &str = "/api/stop";
/// Pause after an accept that failed because there are no more file handles.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);
/// A client that reads nothing of its answer for this long is disconnected by the kernel, ms.
const UNREAD_MS: u32 = 10_000;

/// Limits of the HTTP interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ServerLimits {
    /// Most connections that are open at one time.
    pub connections: usize,
    /// Further connections on which only a stop is answered.
    pub reserve: usize,
    /// Longest time for the headers of a request, and longest pause between two requests.
    pub headers: Duration,
    /// Longest time for the body of a request.
    pub body: Duration,
}

impl Default for ServerLimits {
    fn default() -> Self {
        ServerLimits {
            connections: 64,
            reserve: 32,
            headers: Duration::from_secs(10),
            body: Duration::from_secs(10),
        }
    }
}

/// An address where connections come in.
pub(super) struct Door {
    pub listener: TcpListener,
    /// Decrypts them; `None` on loopback, and behind a proxy that does it.
    pub tls: Option<TlsAcceptor>,
}

/// Serves all doors until the task is aborted. They share the limit of connections.
pub(super) async fn serve(doors: Vec<Door>, router: Router, limits: ServerLimits) {
    let connections = Arc::new(Connections::new(limits.connections, limits.reserve));
    let service = TowerToHyperService::new(router);
    let served = doors
        .into_iter()
        .map(|door| serve_door(door, Arc::clone(&connections), service.clone(), limits));
    futures_util::future::join_all(served).await;
}

async fn serve_door(
    door: Door,
    connections: Arc<Connections>,
    service: TowerToHyperService<Router>,
    limits: ServerLimits,
) {
    loop {
        match door.listener.accept().await {
            Ok((stream, peer)) => {
                // Where there is no place, dropping the stream closes it.
                if let Some(connection) = connections.admit() {
                    let visit = Visit {
                        connection: Arc::clone(&connection),
                        peer: PeerAddress(peer.ip()),
                        limits,
                    };
                    let task = tokio::spawn(visit.begin(stream, door.tls.clone(), service.clone()));
                    connection.served_by(task.abort_handle());
                }
            }
            Err(error) => {
                tracing::warn!("a connection was not accepted: {error}");
                tokio::time::sleep(ACCEPT_PAUSE).await;
            }
        }
        // The new connection reads its request before the next one is accepted, which may close it if it is idle.
        tokio::task::yield_now().await;
    }
}

/// One connection and whose it is.
struct Visit {
    connection: Arc<Connection>,
    peer: PeerAddress,
    limits: ServerLimits,
}

impl Visit {
    /// Serves the connection to its end, after its TLS handshake where there is one.
    async fn begin(self, stream: TcpStream, tls: Option<TlsAcceptor>, service: TowerToHyperService<Router>) {
        // Both only improve the timing, so the connection is served without them too.
        let _ = stream.set_nodelay(true);
        let _ = setsockopt(&stream, sockopt::TcpUserTimeout, &UNREAD_MS);
        let Some(tls) = tls else {
            return self.serve(stream, service).await;
        };
        match tokio::time::timeout(self.limits.headers, tls.accept(stream)).await {
            Ok(Ok(stream)) => self.serve(stream, service).await,
            Ok(Err(error)) => tracing::debug!("a TLS handshake failed: {error}"),
            Err(_) => tracing::debug!("a TLS handshake did not end in time"),
        }
    }

    async fn serve<S>(self, stream: S, service: TowerToHyperService<Router>)
    where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    {
        let limits = self.limits;
        let answer = service_fn(move |mut request: Request<Incoming>| {
            let in_use = self.connection.begin_request();
            let refused = self.connection.reserved && !is_stop(&request);
            request.extensions_mut().insert(limits);
            request.extensions_mut().insert(self.peer);
            request.extensions_mut().insert(Arc::clone(&self.connection));
            let answered = (!refused).then(|| service.call(request));
            async move {
                let response = match answered {
                    Some(answer) => answer.await?,
                    None => too_many_connections(),
                };
                Ok::<_, Infallible>(response.map(|body| {
                    Body::new(HeldBody {
                        body,
                        _in_use: in_use,
                    })
                }))
            }
        });
        let served = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(limits.headers)
            .serve_connection(TokioIo::new(stream), answer)
            .with_upgrades()
            .await;
        if let Err(error) = served {
            tracing::debug!("a connection ended: {error}");
        }
    }
}

fn is_stop(request: &Request<Incoming>) -> bool {
    request.method() == Method::POST && request.uri().path() == STOP_PATH
}

fn too_many_connections() -> Response {
    let refusal = ApiError::new(
        StatusCode::SERVICE_UNAVAILABLE,
        "the daemon has too many connections".to_owned(),
        "close other pages and programs that use it, then try again; a stop is always taken".to_owned(),
    );
    let close = [(http::header::CONNECTION, "close")];
    (close, refusal).into_response()
}

/// The body of an answer. Its connection is in use until it is sent.
struct HeldBody {
    body: Body,
    _in_use: InUse,
}

impl HttpBody for HeldBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::SocketAddr;
    use std::time::Instant;

    use axum::routing::{get, post};

    use super::super::request_body::JsonBody;
    use super::*;

    /// Longest wait on a busy machine.
    const PATIENCE: Duration = Duration::from_secs(60);

    /// A server with a route that answers at once, one that never does, one that reads a body, and the stop.
    fn server(limits: ServerLimits) -> (tokio::runtime::Runtime, SocketAddr) {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()
            .expect("a runtime");
        let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0")).expect("bound");
        let address = listener.local_addr().expect("an address");
        let router = Router::new()
            .route("/quick", get(|| async { "quick" }))
            .route("/never", get(std::future::pending::<()>))
            .route(
                "/body",
                post(|JsonBody(n): JsonBody<u8>| async move { n.to_string() }),
            )
            .route(STOP_PATH, post(|| async { "stopped" }));
        let door = Door { listener, tls: None };
        runtime.spawn(serve(vec![door], router, limits));
        (runtime, address)
    }

    fn send(address: SocketAddr, head: &str) -> std::net::TcpStream {
        let mut stream = std::net::TcpStream::connect(address).expect("connected");
        stream.set_read_timeout(Some(PATIENCE)).expect("set");
        stream.write_all(head.as_bytes()).expect("sent");
        stream
    }

    /// Status and whole answer; empty if the connection was closed without one.
    fn answer(mut stream: std::net::TcpStream) -> String {
        let mut bytes = Vec::new();
        let _ = stream.read_to_end(&mut bytes);
        String::from_utf8_lossy(&bytes).into_owned()
    }

    fn ask(address: SocketAddr, request: &str) -> String {
        answer(send(
            address,
            &format!("{request} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"),
        ))
    }

    #[test]
    fn a_request_that_does_not_arrive_is_given_up() {
        let short = Duration::from_millis(100);
        let (_runtime, address) = server(ServerLimits {
            headers: short,
            body: short,
            ..ServerLimits::default()
        });
        let begun = Instant::now();
        for half in [
            "",
            "GET /quick HTTP/1.1\r\n",
            "GET /quick HTTP/1.1\r\nHost: x\r\n",
        ] {
            assert!(!answer(send(address, half)).contains("200"), "{half:?}");
        }
        let half_body =
            "POST /body HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: 2\r\n\r\n1";
        let refused = answer(send(address, half_body));
        assert!(refused.starts_with("HTTP/1.1 408"), "{refused}");
        assert!(begun.elapsed() < PATIENCE, "{:?}", begun.elapsed());
    }

    #[test]
    fn any_number_of_half_open_requests_keeps_nobody_out() {
        let (_runtime, address) = server(ServerLimits {
            connections: 4,
            headers: PATIENCE,
            ..ServerLimits::default()
        });
        let half_open: Vec<_> = (0..100)
            .map(|_| send(address, "GET /quick HTTP/1.1\r\n"))
            .collect();
        assert!(ask(address, "GET /quick").ends_with("quick"));
        // The oldest gave way long before their time was over.
        let first = half_open.into_iter().next().expect("one");
        assert_eq!(answer(first), "");
    }

    #[test]
    fn with_all_connections_in_use_a_stop_is_answered_and_the_rest_refused() {
        let (_runtime, address) = server(ServerLimits {
            connections: 4,
            reserve: 2,
            ..ServerLimits::default()
        });
        let in_use: Vec<_> = (0..4)
            .map(|_| send(address, "GET /never HTTP/1.1\r\nHost: x\r\n\r\n"))
            .collect();
        // The fourth request may not have been read yet.
        let deadline = Instant::now() + PATIENCE;
        while !ask(address, "GET /quick").starts_with("HTTP/1.1 503") {
            assert!(Instant::now() < deadline, "all connections are in use");
        }
        for _ in 0..20 {
            assert!(ask(address, "POST /api/stop").ends_with("stopped"));
        }
        drop(in_use);
        let deadline = Instant::now() + PATIENCE;
        while !ask(address, "GET /quick").ends_with("quick") {
            assert!(Instant::now() < deadline, "the places are free again");
        }
    }
}
