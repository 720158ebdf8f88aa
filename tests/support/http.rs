//! Requests to a daemon over a plain socket: any headers, also forged ones, and clients that leave.

use std::io::{Read, Write};
use std::net::TcpStream;

use super::{Daemon, PATIENCE};

/// Sends the head of a request with the owner's token, and `body`; the answer is not read.
pub fn send(daemon: &Daemon, head: &str, body: &str) -> TcpStream {
    send_as_it_is(daemon, &format!("{head}{}", daemon.bearer()), body)
}

/// The same without a token, unless `head` has one.
pub fn send_as_it_is(daemon: &Daemon, head: &str, body: &str) -> TcpStream {
    let mut stream = TcpStream::connect(daemon.authority()).expect("the daemon listens");
    stream.set_read_timeout(Some(PATIENCE)).expect("set");
    let length = body.len();
    // The daemon may close the connection before it has read a request that it refuses: then the answer is missing, not the test.
    let _ = write!(
        stream,
        "{head}Content-Length: {length}\r\nConnection: close\r\n\r\n{body}"
    );
    stream
}

/// Status and body of the answer; status 0 if there is none.
pub fn answer(mut stream: TcpStream) -> (u16, String) {
    let mut answer = Vec::new();
    // The daemon may close the connection before it has read a body that it refuses.
    let _ = stream.read_to_end(&mut answer);
    let answer = String::from_utf8_lossy(&answer).into_owned();
    let status = answer.split(' ').nth(1).and_then(|s| s.parse().ok()).unwrap_or(0);
    let body = answer
        .split_once("\r\n\r\n")
        .map(|(_, body)| body.to_owned())
        .unwrap_or_default();
    (status, body)
}

/// Sends a request with any headers. Returns status and body.
pub fn request(daemon: &Daemon, head: &str, body: &str) -> (u16, String) {
    answer(send(daemon, head, body))
}

/// The same without a token, unless `head` has one.
pub fn request_as_it_is(daemon: &Daemon, head: &str, body: &str) -> (u16, String) {
    answer(send_as_it_is(daemon, head, body))
}

/// The head of a request as the page sends it.
pub fn post_head(daemon: &Daemon, path: &str) -> String {
    format!(
        "POST {path} HTTP/1.1\r\nHost: {}\r\nContent-Type: application/json\r\n",
        daemon.authority()
    )
}

/// Sends JSON as the page does. The answer is not read.
pub fn post(daemon: &Daemon, path: &str, body: &serde_json::Value) -> TcpStream {
    send(daemon, &post_head(daemon, path), &body.to_string())
}

/// The JSON that the daemon answers to a GET.
pub fn get_json(daemon: &Daemon, path: &str) -> serde_json::Value {
    let head = format!("GET {path} HTTP/1.1\r\nHost: {}\r\n", daemon.authority());
    let (status, body) = request(daemon, &head, "");
    assert_eq!(status, 200, "{path}: {body}");
    serde_json::from_str(&body).expect("JSON")
}
