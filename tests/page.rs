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
    let mut page = Page::open(&daemon.link(), 1280, 800)?;
    page.until_state("Ready");
    Some((daemon, page))
}

fn run(daemon: &Daemon, page: &mut Page) {
    let started = post(daemon, "/api/run", &serde_json::json!({ "profile": LONG }));
    assert_eq!(answer(started).0, 202);
    page.until_state("Running");
}

/// Why the recorded runs ended.
fn causes(folder: &std::path::Path) -> Vec<String> {
    let (runs, _) = json(folder, &["runs"]);
    let runs = runs.as_array().expect("a list");
    runs.iter()
        .map(|run| run["cause"].as_str().expect("a cause").to_owned())
        .collect()
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
    assert_eq!(causes(folder.path()), ["stopped by key Esc on the page"]);

    // A button that was clicked keeps the focus: Space stops all the same, and does not press it again.
    run(&daemon, &mut page);
    page.value("document.getElementById('hold').focus()");
    page.key(" ", " ");
    page.until_state("Ready");
    let mut told = causes(folder.path());
    told.sort();
    assert_eq!(
        told,
        [
            "stopped by key Esc on the page",
            "stopped by key Space on the page"
        ]
    );
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
    assert_eq!(page.value("points.t.length"), 0, "from the first moment on");
    assert_eq!(page.text("force-peak").trim(), "", "a peak is a reading too");
    assert!(
        page.text("clear").eq_ignore_ascii_case("keep clear"),
        "nobody knows whether it moves"
    );
}

/// What the page shows of a rig in this state; `of` is an expression over the page.
fn shown(page: &mut Page, rig: &serde_json::Value, of: &str) -> String {
    let answer = page.value(&format!(
        "(() => {{ const kept = status; status = {{ ...kept, rig: {{ ...kept.rig, ...{rig} }} }}; show(); \
         const seen = String({of}); status = kept; show(); return seen; }})()"
    ));
    answer.as_str().expect("a text").to_owned()
}

#[test]
fn a_trip_is_told_in_one_place_and_no_state_moves_the_page() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((_daemon, mut page)) = open(folder.path()) else {
        return;
    };
    let tripped = serde_json::json!({
        "phase": "interlocked", "rig_state": "tripped", "cause": "force_limit",
        "notice": "the rig ended the run: force limit", "off_zero": "The rig stands at 18.0 N and 0.300 mm.",
    });
    let told = shown(
        &mut page,
        &tripped,
        "document.getElementById('state-detail').innerText",
    );
    assert!(
        told.contains("What happened: The force passed its limit."),
        "{told}"
    );
    assert!(told.contains("What to do: Check profile, specimen"), "{told}");
    assert!(
        told.contains("press Reset") && told.contains("return to zero"),
        "{told}"
    );
    let allowed = shown(&mut page, &tripped, "document.getElementById('reset').disabled");
    assert_eq!(allowed, "false", "the reset is beside it");

    let held = serde_json::json!({ "phase": "held", "hold_left_s": 26.4 });
    assert_eq!(
        shown(&mut page, &held, "document.getElementById('hold-left').innerText"),
        "unloads in 27 s"
    );

    for (width, height) in SIZES {
        page.size(width, height);
        let of = "[document.querySelector('header').offsetHeight, document.getElementById('stop').offsetLeft, \
                  document.getElementById('run').offsetTop]";
        let still = shown(&mut page, &serde_json::json!({}), of);
        for phase in [
            "connecting",
            "arming",
            "running",
            "held",
            "unloading",
            "interlocked",
        ] {
            let mut rig = tripped.clone();
            rig["phase"] = phase.into();
            rig["force_n"] = (-13_107.1).into();
            assert_eq!(shown(&mut page, &rig, of), still, "{phase} at {width}x{height}");
        }
    }
}

#[test]
fn everything_that_moves_the_rig_says_keep_clear() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((_daemon, mut page)) = open(folder.path()) else {
        return;
    };
    let clear = "!document.getElementById('clear').hidden";
    for (phase, motion, expected) in [
        ("ready", None, "false"),
        ("arming", None, "true"),
        ("running", None, "true"),
        ("running", Some("zero"), "true"),
        ("running", Some("jog"), "true"),
        ("held", None, "true"),
        ("unloading", None, "true"),
        ("connecting", None, "true"),
        ("interlocked", None, "false"),
    ] {
        let rig = serde_json::json!({ "phase": phase, "motion": motion, "notice": "stopped by an operator" });
        assert_eq!(shown(&mut page, &rig, clear), expected, "{phase} {motion:?}");
    }
}
