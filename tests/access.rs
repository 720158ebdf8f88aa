//! Who gets in, as a technician meets it: commands of the same user without ceremony, links for the page, tokens with roles, TLS,
//! and the audit log.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::sync::Arc;

use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};

use super::page_access::{axe, violations};
use super::support::browser::Page;
use super::support::http::{post_head, request_as_it_is};
use super::support::{Daemon, PATIENCE, json, leafbench, until};
use crate::daemon::routes::described;

fn audit_log(data: &Path) -> String {
    std::fs::read_to_string(data.join("audit.jsonl")).expect("a log")
}

/// Runs a command as a user who cannot read the owner's token; exit code, and all that it said.
fn as_other(data: &Path, token: &str, arguments: &[&str]) -> (Option<i32>, String) {
    let mut command = leafbench(arguments);
    command.arg("--json").arg("--data").arg(data);
    // A text that is no token goes before the file, too.
    let output = command.env("LEAFBENCH_TOKEN", token).output().expect("starts");
    let said = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8_lossy(&said).into_owned())
}

#[test]
fn commands_of_the_same_user_need_nothing_and_others_are_told_what_to_do() {
    let folder = tempfile::tempdir().expect("a folder");
    let _daemon = Daemon::ready(folder.path(), &[]);
    let token = folder.path().join("token");
    let mode = std::fs::metadata(&token).expect("made").permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    assert_eq!(json(folder.path(), &["zero"]).1, 0);
    let (code, said) = as_other(folder.path(), "", &["zero"]);
    assert!(code == Some(4) && said.contains("has no token"), "{said}");
    assert!(
        said.contains("leafbench open") && said.contains("leafbench token add"),
        "{said}"
    );
}

#[test]
fn a_person_with_a_token_does_what_their_role_may_and_the_log_has_their_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let (made, code) = json(folder.path(), &["token", "add", "meyer", "--role", "watch"]);
    assert_eq!(code, 0, "{made}");
    let own = made["token"].as_str().expect("a token");
    until("the daemon to know the token", || {
        (as_other(folder.path(), own, &["status"]).0 == Some(0)).then_some(())
    });
    let (code, said) = as_other(folder.path(), own, &["zero"]);
    assert!(
        code == Some(4) && said.contains("\\\"meyer\\\" may watch"),
        "{said}"
    );
    let (code, said) = as_other(folder.path(), own, &["stop", "--reason", "smoke"]);
    assert_eq!(code, Some(0), "everybody stops: {said}");
    let (list, _) = json(folder.path(), &["token", "list"]);
    assert_eq!(
        (&list[0]["name"], &list[0]["role"]),
        (&"meyer".into(), &"watch".into()),
        "{list}"
    );
    assert_eq!(json(folder.path(), &["token", "remove", "meyer"]).1, 0);
    until("the end of the token", || {
        (as_other(folder.path(), own, &["status"]).0 == Some(4)).then_some(())
    });
    json(folder.path(), &["tare"]);
    let log = until("the log", || {
        Some(audit_log(&daemon.data)).filter(|log| log.contains("POST /api/tare"))
    });
    let line = |words: &[&str]| {
        log.lines()
            .any(|line| words.iter().all(|word| line.contains(word)))
    };
    assert!(
        line(&["\"who\":\"owner\"", "POST /api/tare", "\"status\":200"]),
        "{log}"
    );
    assert!(
        line(&[
            "\"who\":\"meyer\"",
            "\"role\":\"watch\"",
            "POST /api/zero",
            "\"status\":403"
        ]),
        "{log}"
    );
    assert!(
        line(&["\"who\":\"meyer\"", "POST /api/stop", "smoke", "\"status\":200"]),
        "{log}"
    );
    assert!(line(&["token meyer (watch) removed"]), "{log}");
    assert!(
        !log.contains(own) && !log.contains(&daemon.token()),
        "no secret is in the log"
    );
}

#[test]
fn n12_the_audit_log_shows_a_change_at_every_line() {
    let folder = tempfile::tempdir().expect("a folder");
    {
        let mut daemon = Daemon::ready(folder.path(), &[]);
        for order in ["tare", "zero", "stop"] {
            json(folder.path(), &[order]);
        }
        until("the orders in the log", || {
            audit_log(&daemon.data).contains("POST /api/stop").then_some(())
        });
        // Its end is noted in the log, and the end of the log beside it.
        daemon.signal(nix::sys::signal::Signal::SIGTERM);
        daemon.process.0.wait().expect("ended");
    }
    let (whole, code) = json(folder.path(), &["audit", "verify"]);
    assert_eq!(code, 0, "{whole}");
    let hash = whole["hash"].as_str().expect("a hash").to_owned();
    assert_eq!(json(folder.path(), &["audit", "verify", "--hash", &hash]).1, 0);
    assert_eq!(json(folder.path(), &["audit", "verify", "--hash", "0"]).1, 1);
    let log = audit_log(folder.path());
    let lines: Vec<&str> = log.lines().collect();
    assert!(lines.len() >= 4, "{log}");
    let found = |changed: &[String]| {
        let text: String = changed.iter().map(|line| format!("{line}\n")).collect();
        std::fs::write(folder.path().join("audit.jsonl"), text).expect("written");
        json(folder.path(), &["audit", "verify"]).1 == 1
    };
    for at in 0..lines.len() {
        let mut changed: Vec<String> = lines.iter().map(|line| (*line).to_owned()).collect();
        changed[at] = changed[at].replacen("\"who\":\"", "\"who\":\"x", 1);
        assert!(found(&changed), "line {at} changed");
        changed.remove(at);
        assert!(found(&changed), "line {at} removed");
        changed.insert((at + 1) % lines.len(), lines[at].to_owned());
        assert!(found(&changed), "line {at} moved");
    }
    let (shown, code) = json(folder.path(), &["audit", "show", "--last", "2"]);
    assert_eq!((code, shown.as_array().map(Vec::len)), (0, Some(2)), "{shown}");
}

/// A run that its person started in spite of an objection stands in the log with the name.
#[test]
fn an_override_is_logged_by_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let more = ["--specimen", "another spring", "--override", "R. Meier"];
    let arguments: Vec<&str> = ["run", "static-ramp-12s"].into_iter().chain(more).collect();
    let mut command = leafbench(&arguments);
    command.arg("--data").arg(folder.path());
    let _running = super::support::Process(command.spawn().expect("starts"));
    let log = until("the start in the log", || {
        Some(audit_log(&daemon.data)).filter(|log| log.contains("override by R. Meier"))
    });
    let line = log
        .lines()
        .find(|line| line.contains("override by"))
        .expect("a line");
    assert!(
        line.contains("specimen another spring") && line.contains("\"status\":202"),
        "{line}"
    );
}

/// Sends a request over TLS to `address`, in the name of `host`; the whole answer.
fn over_tls(address: &str, host: &str, more: &str) -> String {
    let mut roots = RootCertStore::empty();
    let certificate = CertificateDer::from_pem_file("tests/tls/test-cert.pem").expect("a certificate");
    roots.add(certificate).expect("added");
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .expect("versions")
        .with_root_certificates(roots)
        .with_no_client_auth();
    let name = ServerName::try_from("bench.test").expect("a name");
    let session = ClientConnection::new(Arc::new(config), name).expect("a session");
    let stream = TcpStream::connect(address).expect("the daemon listens");
    stream.set_read_timeout(Some(PATIENCE)).expect("set");
    let mut stream = StreamOwned::new(session, stream);
    let head = format!("GET /api/status HTTP/1.1\r\nHost: {host}\r\n{more}Connection: close\r\n\r\n");
    stream.write_all(head.as_bytes()).expect("sent");
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn beyond_loopback_a_token_with_a_name_gets_in_over_tls_and_the_owners_does_not() {
    let folder = tempfile::tempdir().expect("a folder");
    let tls = [
        "--tls-cert",
        "tests/tls/test-cert.pem",
        "--tls-key",
        "tests/tls/test-key.pem",
        "--name",
        "bench.test",
    ];
    let daemon = Daemon::start(folder.path(), &tls);
    // Commands of this computer go on without ceremony, on a port of their own.
    daemon.until_phase("ready");
    let endpoint = std::fs::read_to_string(folder.path().join("daemon.json")).expect("written");
    let endpoint: serde_json::Value = serde_json::from_str(&endpoint).expect("JSON");
    let page = endpoint["page"].as_str().expect("an address");
    let host = page.trim_start_matches("https://").trim_end_matches('/');
    let address = host.replace("bench.test", "127.0.0.1");
    let (made, _) = json(folder.path(), &["token", "add", "meyer", "--role", "watch"]);
    let named = format!(
        "Authorization: Bearer {}\r\n",
        made["token"].as_str().expect("a token")
    );
    until("an answer over TLS", || {
        over_tls(&address, host, &named)
            .starts_with("HTTP/1.1 200")
            .then_some(())
    });
    // Waiting for the token has used up the wrong ones that are answered 401.
    let refused = ["HTTP/1.1 401", "HTTP/1.1 429"];
    let (owner, named) = (daemon.bearer(), named.as_str());
    for (what, host, line, expected) in [
        ("nothing", host, "", &refused[..1]),
        ("the owner's token", host, owner.as_str(), &refused[..]),
        (
            "the owner's token as if local",
            daemon.authority(),
            owner.as_str(),
            &["HTTP/1.1 200"],
        ),
        ("another host", "evil.example", named, &["HTTP/1.1 403"]),
    ] {
        let answer = over_tls(&address, host, line);
        assert!(
            expected.iter().any(|status| answer.starts_with(status)),
            "{what}: {answer}"
        );
    }
    // Without TLS the port says nothing.
    let mut plain = TcpStream::connect(&address).expect("the daemon listens");
    plain.set_read_timeout(Some(PATIENCE)).expect("set");
    let _ = plain.write_all(format!("GET /api/status HTTP/1.1\r\nHost: {host}\r\n{named}\r\n").as_bytes());
    let mut answer = Vec::new();
    let _ = plain.read_to_end(&mut answer);
    assert!(!String::from_utf8_lossy(&answer).contains("HTTP/1.1 200"));
}

#[test]
fn behind_a_proxy_the_owners_token_is_good_at_the_bench_only() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &["--behind-proxy", "lab.example"]);
    let through = |more: &str| {
        let head =
            format!("GET /api/status HTTP/1.1\r\nHost: lab.example\r\nX-Forwarded-For: 10.0.0.9\r\n{more}");
        request_as_it_is(&daemon, &head, "").0
    };
    assert_eq!(through(&daemon.bearer()), 401);
    let (made, _) = json(folder.path(), &["token", "add", "meyer", "--role", "operate"]);
    let named = format!(
        "Authorization: Bearer {}\r\n",
        made["token"].as_str().expect("a token")
    );
    until("the daemon to know the token", || {
        (through(&named) == 200).then_some(())
    });
    let own = format!("{named}Origin: https://lab.example\r\n");
    assert_eq!(through(&own), 200);
    assert_eq!(through(&format!("{named}Origin: http://lab.example\r\n")), 403);
}

/// A free port, for a daemon that comes back to it.
fn free_address() -> String {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    taken.local_addr().expect("an address").to_string()
}

/// A daemon at an address to which it comes back.
fn daemon_at(address: &str, data: &Path) -> Daemon {
    let mut command = leafbench(&["daemon", "--json", "--listen", address, "--data"]);
    command.arg(data);
    let daemon = Daemon::start_command(command, |_| data.to_owned());
    daemon.until_phase("ready");
    daemon
}

#[test]
fn a_link_signs_the_page_in_once_and_a_bookmark_outlives_the_daemon() {
    let folder = tempfile::tempdir().expect("a folder");
    let address = free_address();
    let daemon = daemon_at(&address, folder.path());
    let link = daemon.link();
    let Some(mut page) = Page::open(&link, 1280, 800) else {
        return;
    };
    page.until_state("Ready");
    assert_eq!(
        page.value("location.href"),
        format!("{}/", daemon.url),
        "no secret stays in the address"
    );
    // The same link again, in another browser.
    let mut other = Page::open(&link, 1280, 800).expect("as the first one");
    other.until("document.getElementById('sign-in-state')?.textContent.includes('was used already')");
    // And that browser at the plain address.
    other.ask(
        "Page.navigate",
        &serde_json::json!({ "url": format!("{}/", daemon.url) }),
    );
    other.until("document.getElementById('sign-in-state')?.textContent === 'This browser is not signed in.'");
    let words = other.value("document.body.innerText");
    assert!(
        words.as_str().expect("words").contains("leafbench open"),
        "{words}"
    );
    // The daemon ends and comes back: the page is signed in all the same, and may give orders.
    drop(daemon);
    page.until_state("No daemon");
    let _daemon = daemon_at(&address, folder.path());
    page.until_state("Ready");
    page.ask("Page.reload", &serde_json::json!({}));
    page.until("document.readyState === 'complete' && typeof points === 'object'");
    page.until_state("Ready");
    page.until("!document.getElementById('tare').disabled");
    page.value("document.getElementById('tare').click()");
    page.until("document.getElementById('notice').textContent.startsWith('New tare')");
}

#[test]
fn axe_core_finds_no_serious_violation_on_the_page_that_signs_in() {
    let Some(axe) = axe() else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::start(folder.path(), &[]);
    let Some(mut page) = Page::open(&format!("{}/", daemon.url), 768, 1024) else {
        return;
    };
    page.until("document.getElementById('sign-in-form')");
    page.value(&format!("{axe}; true"));
    for theme in ["light", "dark"] {
        page.theme(theme);
        assert_eq!(violations(&mut page), "", "{theme}");
    }
    assert_eq!(page.misplaced(), "");
}

#[test]
fn a_watcher_signs_in_with_a_token_and_stops_and_gives_no_order() {
    let folder = tempfile::tempdir().expect("a folder");
    let address = free_address();
    let daemon = daemon_at(&address, folder.path());
    let (made, _) = json(folder.path(), &["token", "add", "wall", "--role", "watch"]);
    let token = made["token"].as_str().expect("a token").to_owned();
    let Some(mut page) = Page::open(&format!("{}/", daemon.url), 1280, 800) else {
        return;
    };
    page.until("document.getElementById('sign-in-form')");
    page.value(&format!(
        "document.getElementById('sign-in-token').value = '{token}'; true"
    ));
    page.until("document.getElementById('sign-in-token').value.length === 64");
    // The daemon has read the list of tokens by now.
    std::thread::sleep(std::time::Duration::from_millis(600));
    page.value("setTimeout(() => document.getElementById('sign-in-form').requestSubmit(), 0); true");
    page.until_state("Ready");
    page.value("ask('api/zero', {}).catch(error => say(error.message))");
    page.until("document.getElementById('notice').textContent.includes('may watch')");
    page.value("stop('by the wall').then(() => say('stopped'))");
    page.until("document.getElementById('notice').textContent === 'stopped'");
    // Without its token the page says how to sign in.
    json(folder.path(), &["token", "remove", "wall"]);
    drop(daemon);
    let _daemon = daemon_at(&address, folder.path());
    page.until("document.getElementById('sign-in-state')");
}

#[test]
fn a_page_without_its_key_says_what_to_do_and_still_stops() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let Some(mut page) = Page::open(&daemon.link(), 1280, 800) else {
        return;
    };
    page.until_state("Ready");
    page.value("localStorage.removeItem('key')");
    page.value("document.getElementById('zero').click()");
    page.until("document.getElementById('notice').textContent.includes('may only watch and stop')");
    page.value("say('')");
    page.value("stop('without a key').then(() => say('stopped'))");
    page.until("document.getElementById('notice').textContent === 'stopped'");
}

/// Every answer of a walk over the routes has a place in the OpenAPI description.
#[test]
fn the_description_has_every_status_that_is_answered() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let document = described().expect("written");
    let cases = [
        ("POST", "/api/login", "/api/login", "{\"secret\":\"x\"}"),
        ("POST", "/api/login", "/api/login", "{"),
        ("POST", "/api/run", "/api/run", "{}"),
        ("POST", "/api/run", "/api/run", "{"),
        ("POST", "/api/run", "/api/run", "[1]"),
        ("POST", "/api/resume", "/api/resume", "{}"),
        ("POST", "/api/jog", "/api/jog", "{\"step_mm\":9}"),
        ("GET", "/api/runs/{run_id}", "/api/runs/none", ""),
        ("GET", "/api/runs/{run_id}/csv", "/api/runs/none/csv?every=x", ""),
        ("GET", "/api/runs/{run_id}/result", "/api/runs/none/result", ""),
        ("GET", "/api/runs", "/api/runs?limit=x", ""),
        ("GET", "/api/compare", "/api/compare", ""),
        ("GET", "/api/compare", "/api/compare?first=a&second=b", ""),
        ("GET", "/api/profiles/{name}", "/api/profiles/none", ""),
        ("DELETE", "/api/profiles/{name}", "/api/profiles/none", ""),
        ("POST", "/api/profiles", "/api/profiles", "{\"text\":\"x\"}"),
        ("POST", "/api/plan", "/api/plan", "{\"profile\":\"none\"}"),
        ("POST", "/api/outline", "/api/outline", "{\"text\":\"x\"}"),
        ("GET", "/api/diagnoses/{id}", "/api/diagnoses/none", ""),
        ("DELETE", "/api/diagnoses/{id}", "/api/diagnoses/none", ""),
        (
            "POST",
            "/api/diagnoses",
            "/api/diagnoses",
            "{\"runs\":[\"none\"]}",
        ),
        ("POST", "/api/twin", "/api/twin", "{\"diagnosis\":\"none\"}"),
        ("GET", "/api/imports/{name}", "/api/imports/none", ""),
        ("POST", "/api/imports", "/api/imports", "x"),
        ("GET", "/api/audit", "/api/audit?last=x", ""),
        ("GET", "/api/live", "/api/live", ""),
    ];
    for (method, path, address, body) in cases {
        let described = &document["paths"][path][method.to_lowercase()]["responses"];
        for line in [daemon.bearer(), String::new()] {
            let head = post_head(&daemon, address).replacen("POST", method, 1);
            let (status, told) = request_as_it_is(&daemon, &format!("{head}{line}"), body);
            assert!(
                !described[status.to_string()].is_null(),
                "{method} {address} {body}: {status} {told}"
            );
        }
    }
}
