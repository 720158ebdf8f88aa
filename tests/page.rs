//! The technician's page in a headless Chromium, on the mock rig. Without Chromium these tests pass without running.

use super::support::browser::Page;
use super::support::http::{answer, post};
use super::support::{Daemon, json, until};

/// Sizes of the window that technicians have.
const SIZES: [(u32, u32); 2] = [(1280, 800), (1024, 768)];

/// Up to 6 mm, and there for a minute.
const LONG: &str = "name = \"long\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\n\
                    to_mm = 6.0\nduration_s = 2.0\n[[block.segment]]\nkind = \"hold\"\nduration_s = 60.0\n";

/// A ready daemon and its page; nothing without Chromium.
fn open(folder: &std::path::Path) -> Option<(Daemon, Page)> {
    let daemon = Daemon::ready(folder, &[]);
    let mut page = Page::open(&daemon.url, 1280, 800)?;
    page.until_state("Ready");
    Some((daemon, page))
}

fn run(daemon: &Daemon, page: &mut Page) {
    let started = post(daemon, "/api/run", &serde_json::json!({ "profile": LONG }));
    assert_eq!(answer(started).0, 202);
    page.until_state("Running");
}

/// The element is whole within the window.
fn on_screen(page: &mut Page, id: &str) -> bool {
    let seen = format!(
        "(() => {{ const e = document.getElementById('{id}'), r = e.getBoundingClientRect(); \
         const top = document.elementFromPoint(r.x + r.width / 2, r.y + r.height / 2); \
         return r.top >= 0 && r.left >= 0 && r.bottom <= innerHeight && r.right <= innerWidth && (top === e || e.contains(top)); }})()"
    );
    page.value(&seen) == true
}

#[test]
fn stop_and_reset_are_on_the_screen_scrolled_or_not_and_nothing_is_cut() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((daemon, mut page)) = open(folder.path()) else {
        return;
    };
    run(&daemon, &mut page);
    for (width, height) in SIZES {
        page.size(width, height);
        for scroll in ["0", "document.body.scrollHeight"] {
            page.value(&format!("scrollTo(0, {scroll})"));
            for id in ["stop", "reset"] {
                assert!(
                    on_screen(&mut page, id),
                    "{id} at {width}x{height}, scrolled to {scroll}"
                );
            }
        }
        assert_eq!(page.misplaced(), "", "{width}x{height}");
    }
    assert!(page.text("clear").eq_ignore_ascii_case("keep clear"));
}

#[test]
fn escape_stops_from_everywhere_and_space_where_nobody_types() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((daemon, mut page)) = open(folder.path()) else {
        return;
    };
    run(&daemon, &mut page);
    page.value("document.getElementById('operator').focus()");
    page.key(" ", " ");
    assert_eq!(page.value("document.getElementById('operator').value"), " ");
    assert_eq!(page.text("state"), "Running");
    page.key("Escape", "");
    page.until_state("Ready");
    let (runs, _) = json(folder.path(), &["runs"]);
    assert_eq!(runs[0]["cause"], "key Esc on the page");

    // A button that was clicked keeps the focus: Space stops all the same, and does not press it again.
    run(&daemon, &mut page);
    page.value("document.getElementById('hold').focus()");
    page.key(" ", " ");
    page.until_state("Ready");
    let (runs, _) = json(folder.path(), &["runs"]);
    assert_eq!(runs[0]["cause"], "key Space on the page");
}

#[test]
fn a_jog_goes_on_while_its_button_is_held_and_zero_brings_the_rig_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((daemon, mut page)) = open(folder.path()) else {
        return;
    };
    let displacement_mm = || daemon.status()["rig"]["displacement_mm"].as_f64();
    page.mouse("mousePressed", "jog-up");
    until("a way of 0.5 mm", || displacement_mm().filter(|mm| *mm > 0.5));
    page.mouse("mouseReleased", "jog-up");
    page.until_state("Jog ended");
    assert!(
        page.text("hold-left").starts_with("unloads in "),
        "{}",
        page.text("hold-left")
    );
    let rest_mm = displacement_mm().expect("a reading");
    std::thread::sleep(std::time::Duration::from_millis(600));
    let later_mm = displacement_mm().expect("a reading");
    assert!(
        (later_mm - rest_mm).abs() < 0.06,
        "{rest_mm} mm, then {later_mm} mm"
    );
    page.click("stop");
    page.until_state("Ready");
    assert!(
        page.text("state-detail").contains("not at zero") || page.text("state-detail").contains("stands at")
    );
    page.until("!document.getElementById('zero').disabled");
    page.click("zero");
    page.until_state("To zero");
    page.until_state("Ready");
    assert!(
        !page.text("state-detail").contains("stands at"),
        "{}",
        page.text("state-detail")
    );
}

#[test]
fn a_jog_ends_when_its_window_loses_the_focus() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((_daemon, mut page)) = open(folder.path()) else {
        return;
    };
    page.mouse("mousePressed", "jog-up");
    page.until_state("Jogging");
    page.value("window.dispatchEvent(new Event('blur'))");
    page.until_state("Jog ended");
}

#[test]
fn the_scope_runs_between_two_runs_and_peaks_are_kept_until_they_are_cleared() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((_daemon, mut page)) = open(folder.path()) else {
        return;
    };
    page.until("points.t.length > 200 && runOfPoints === ''");
    let newest = page
        .value("points.t[points.t.length - 1]")
        .as_f64()
        .expect("a time");
    page.until(&format!("points.t[points.t.length - 1] > {newest} + 0.5"));
    page.until("document.getElementById('force-peak').innerText.startsWith('peaks ')");
    page.value("peaks = { force: [-1, 77], displacement: [0, 1] }");
    page.until("document.getElementById('force-peak').innerText.includes('77.')");
    page.click("clear-peaks");
    page.until("!document.getElementById('force-peak').innerText.includes('77.')");
}

#[test]
fn a_daemon_that_is_gone_leaves_no_number_that_looks_live() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((mut daemon, mut page)) = open(folder.path()) else {
        return;
    };
    page.until("document.getElementById('force').innerText !== '\\u2013'");
    daemon.process.0.kill().expect("killed");
    page.until_state("No daemon");
    assert_eq!(
        (page.text("force"), page.text("displacement")),
        ("\u{2013}".into(), "\u{2013}".into())
    );
    page.until("points.t.length === 0");
    assert!(
        page.text("clear").eq_ignore_ascii_case("keep clear"),
        "nobody knows whether it moves"
    );
}
