//! Several clients at one daemon: one commands, the others watch, and everybody may stop.

use serde_json::{Value, json as object};

use super::support::browser::Page;
use super::support::http::{answer, get_json, post, post_head, request};
use super::support::{Daemon, json, leafbench, until};

/// Up to 3 mm, and there for a minute.
const LONG: &str = "name = \"long\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\n\
                    to_mm = 3.0\nduration_s = 2.0\n[[block.segment]]\nkind = \"hold\"\nduration_s = 60.0\n";
/// Every order of the interface that moves the rig or changes how it is measured.
const ORDERS: [(&str, &str); 8] = [
    ("/api/command", "{}"),
    ("/api/run", "{\"profile\":\"static-ramp\"}"),
    ("/api/hold", "{}"),
    ("/api/resume", "{}"),
    ("/api/reset", "{}"),
    ("/api/tare", "{}"),
    ("/api/zero", "{}"),
    ("/api/jog", "{\"step_mm\":0.1}"),
];

/// Sends an order in the name of a client that stays; status and answer.
fn order(daemon: &Daemon, path: &str, body: &str, caller: &Value) -> (u16, Value) {
    let head = format!("{}leafbench-caller: {caller}\r\n", post_head(daemon, path));
    let (status, body) = request(daemon, &head, body);
    (status, serde_json::from_str(&body).unwrap_or(Value::Null))
}

fn client(name: &str, take_over: bool) -> Value {
    object!({ "id": name, "name": format!("the page of {name}"), "stays": true, "take_over": take_over })
}

#[test]
fn every_order_of_another_client_is_refused_with_words_and_a_stop_is_taken() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let (status, told) = order(&daemon, "/api/command", "{}", &client("A. Technician", false));
    assert_eq!(
        (status, told["message"].as_str()),
        (200, Some("the page of A. Technician commands the bench"))
    );
    for (path, body) in ORDERS {
        let (status, told) = order(&daemon, path, body, &client("B", false));
        assert_eq!(status, 409, "{path}: {told}");
        let error = told["error"].as_str().expect("a text");
        assert!(
            error.starts_with("the page of A. Technician commands the bench since "),
            "{path}: {error}"
        );
        assert!(
            told["what_to_do"].to_string().contains("take over"),
            "{path}: {told}"
        );
        assert_eq!(
            request(&daemon, &post_head(&daemon, path), body).0,
            409,
            "{path} without a name"
        );
    }
    let (status, _) = order(&daemon, "/api/stop", "{}", &client("B", false));
    assert_eq!(status, 200);
    assert_eq!(daemon.status()["commander"]["name"], "the page of A. Technician");
}

#[test]
fn taking_over_is_an_event_of_the_run_under_way_and_in_the_log() {
    let folder = tempfile::tempdir().expect("a folder");
    let log_path = folder.path().join("log");
    let log = std::fs::File::create(&log_path).expect("a file");
    let mut command = leafbench(&["daemon", "--json", "--listen", "127.0.0.1:0", "--data"]);
    command.arg(folder.path());
    let daemon = Daemon::start_with_log(command, folder.path(), log);
    daemon.until_phase("ready");
    let body = object!({ "profile": LONG }).to_string();
    let (status, started) = order(&daemon, "/api/run", &body, &client("A", false));
    assert_eq!(status, 202, "{started}");
    daemon.until_phase("running");
    assert_eq!(order(&daemon, "/api/hold", "{}", &client("B", false)).0, 409);
    assert_eq!(order(&daemon, "/api/hold", "{}", &client("B", true)).0, 200);
    assert_eq!(order(&daemon, "/api/resume", "{}", &client("A", false)).0, 409);
    // Everybody stops.
    assert_eq!(order(&daemon, "/api/stop", "{}", &client("A", false)).0, 200);
    daemon.until_phase("ready");
    let sentence = "the page of B took over the command from the page of A";
    let run = started["run_id"].as_str().expect("an id");
    until("the event in the run", || {
        let detail = get_json(&daemon, &format!("/api/runs/{run}"));
        let events = detail["events"].as_array()?;
        events
            .iter()
            .any(|event| event["kind"] == "operator" && event["text"] == sentence)
            .then_some(())
    });
    assert!(
        std::fs::read_to_string(&log_path)
            .expect("a log")
            .contains(sentence)
    );
}

#[test]
fn the_command_line_works_without_ceremony_and_takes_over_only_when_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let (_, code) = json(folder.path(), &["jog", "0"]);
    assert_ne!(code, 2, "an order without ceremony is understood");
    assert_eq!(
        daemon.status()["commander"],
        Value::Null,
        "one order leaves the command free"
    );
    order(&daemon, "/api/command", "{}", &client("A", false));
    let (told, code) = json(folder.path(), &["zero"]);
    assert_eq!(code, 4, "{told}");
    assert!(
        told.to_string().contains("the page of A commands the bench")
            && told.to_string().contains("--take-over"),
        "{told}"
    );
    let (told, code) = json(folder.path(), &["zero", "--take-over"]);
    assert_eq!(code, 0, "{told}");
}

/// A ready daemon and a page; nothing without Chromium.
fn open(folder: &std::path::Path) -> Option<(Daemon, Page)> {
    let daemon = Daemon::ready(folder, &[]);
    let mut page = Page::open(&daemon.link(), 1280, 800)?;
    page.until_state("Ready");
    Some((daemon, page))
}

#[test]
fn a_second_page_watches_until_it_takes_over_and_its_stop_always_works() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((daemon, mut first)) = open(folder.path()) else {
        return;
    };
    let mut second = Page::open(&daemon.link(), 1280, 800).expect("as the first one");
    second.until_state("Ready");
    first.value("document.getElementById('operator').value = 'A. Technician'");
    first.until("!document.getElementById('run').disabled");
    first.value("start({ profile: 'static-ramp-12s' })");
    first.until_state("Running");
    first.until("document.getElementById('commander').textContent.includes('(this page)')");
    second.until("document.getElementById('commander').textContent.startsWith('Watching. Commanded by: the page of A. Technician, since ')");
    for id in [
        "hold", "resume", "reset", "tare", "zero", "jog-up", "jog-down", "run",
    ] {
        assert_eq!(
            second.value(&format!("document.getElementById('{id}').disabled")),
            true,
            "{id}"
        );
    }
    assert_eq!(second.value("document.getElementById('stop').disabled"), false);
    assert_eq!(second.misplaced(), "");
    second.click("stop");
    second.until_state("Ready");

    second.click("take-over");
    second.until("!document.getElementById('take-over-ask').hidden");
    assert!(
        second
            .text("take-over-ask")
            .starts_with("Take over control from the page of A. Technician?")
    );
    second.value("document.querySelector('#take-over-ask button').click()");
    second.until("document.getElementById('commander').textContent.includes('(this page)')");
    second.until("!document.getElementById('run').disabled");
    first.until("document.body.classList.contains('watching') && document.getElementById('run').disabled");
}

#[test]
fn a_page_that_is_loaded_again_keeps_the_command_and_one_that_is_gone_loses_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((daemon, mut page)) = open(folder.path()) else {
        return;
    };
    page.value("ask('api/command', {})");
    page.until("isMine()");
    page.ask("Page.reload", &object!({}));
    page.until("typeof status === 'object' && status && isMine()");
    drop(page);
    until("a free command", || {
        daemon.status()["commander"].is_null().then_some(())
    });
    assert_eq!(
        answer(post(&daemon, "/api/jog", &object!({ "step_mm": 0.1 }))).0,
        200
    );
}
