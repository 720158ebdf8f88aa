//! The page for everyone: axe-core finds no serious violation, the keyboard reaches everything with a visible focus, a tablet
//! shows it whole, and nothing is asked from elsewhere.
//!
//! axe-core comes from npm and is no part of the project: `LEAFBENCH_AXE` is the path of its `axe.min.js`. Without it that test
//! passes without running, unless `LEAFBENCH_REQUIRE_CHROMIUM` is set, as in CI.

use serde_json::json;

use super::support::Daemon;
use super::support::browser::Page;

/// A ready daemon and its page; nothing without Chromium.
fn open(folder: &std::path::Path) -> Option<(Daemon, Page)> {
    let daemon = Daemon::ready(folder, &[]);
    let mut page = Page::open(&daemon.link(), 1280, 800)?;
    page.until_state("Ready");
    page.until("document.getElementById('profile').value");
    Some((daemon, page))
}

/// The text of axe-core.
pub(super) fn axe() -> Option<String> {
    let Some(path) = std::env::var_os("LEAFBENCH_AXE") else {
        assert!(
            std::env::var_os("LEAFBENCH_REQUIRE_CHROMIUM").is_none(),
            "LEAFBENCH_AXE is not set: it is the path of axe.min.js (npm install axe-core)"
        );
        println!("SKIPPED: LEAFBENCH_AXE is not set");
        return None;
    };
    Some(std::fs::read_to_string(path).expect("LEAFBENCH_AXE is the path of axe.min.js"))
}

/// The serious and critical violations, one line each.
pub(super) fn violations(page: &mut Page) -> String {
    let found = page.value(
        "axe.run(document, { resultTypes: ['violations'] }).then(r => r.violations.filter(v => ['serious', 'critical'].includes(v.impact)) \
         .map(v => v.id + ': ' + v.nodes.map(n => n.target.join(' ') + ' ' + (n.any[0] || n.all[0] || n.none[0] || {}).message).join(' | ')).join('\\n'))",
    );
    found.as_str().expect("a text").to_owned()
}

/// States of the page: name, and the script that brings it there from a frozen page.
const STATES: [(&str, &str); 10] = [
    ("ready", "freeze({})"),
    (
        "running",
        "freeze({ phase: 'running', run_id: 'r', profile: 'static-ramp', cycles_total: 5, remaining_s: 20 })",
    ),
    ("held", "freeze({ phase: 'held', hold_left_s: 26 })"),
    ("arming", "freeze({ phase: 'arming' })"),
    (
        "interlocked",
        "freeze({ phase: 'interlocked', rig_state: 'tripped', cause: 'force_limit', notice: 'the rig ended the run: force limit', \
         off_zero: 'The rig stands at 18.0 N and 0.300 mm.' })",
    ),
    ("no daemon", "freezeAs(null)"),
    (
        "watching",
        "freezeAs({ ...kept, commander: { id: 'x', name: 'the page of B', since_utc: '2026-01-01T10:03:00Z' } })",
    ),
    ("told", "freeze({}); say('A sentence of the daemon.')"),
    (
        "editor",
        "freeze({}); document.getElementById('new-profile').click()",
    ),
    ("import", "freeze({}); chooseTable()"),
];

/// Functions for [`STATES`]: a status that no message replaces.
const FROZEN: &str = "
  var kept = status, shownBy = show;
  show = () => {};
  function freezeAs(wanted) { status = wanted; everConnected = true; shownBy(); }
  function freeze(rig) { freezeAs({ ...kept, rig: { ...kept.rig, ...rig } }); }
  function chooseTable() {
    const files = new DataTransfer();
    files.items.add(new File(['Zeit [s];Weg [mm];Kraft [N]\\n0;1;-1\\n1;2;-2\\n2;3;-3\\n'], 'a.csv'));
    $('import-file').files = files.files;
    $('import-file').dispatchEvent(new Event('change'));
  }
  true";

#[test]
fn axe_core_finds_no_serious_violation_in_any_state_and_theme() {
    let Some(axe) = axe() else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let Some((_daemon, mut page)) = open(folder.path()) else {
        return;
    };
    page.value(&format!("{axe}; true"));
    page.value(FROZEN);
    let mut found = String::new();
    for theme in ["light", "dark"] {
        page.theme(theme);
        for (state, script) in STATES {
            page.value(&format!("{script}; true"));
            match state {
                "editor" => page.until(
                    "!document.getElementById('editor').hidden && document.getElementById('form-0-0-to_mm')",
                ),
                "import" => page.until("!document.getElementById('import-view').hidden"),
                _ => {}
            }
            let told = violations(&mut page);
            if !told.is_empty() {
                found += &format!("{theme}, {state}:\n{told}\n");
            }
            page.value("document.getElementById('editor').hidden = true; document.getElementById('import-view').hidden = true");
        }
    }
    assert_eq!(found, "");
}

/// Presses the Tab key.
fn tab(page: &mut Page) {
    for kind in ["rawKeyDown", "keyUp"] {
        let event = json!({ "type": kind, "key": "Tab", "code": "Tab", "windowsVirtualKeyCode": 9 });
        page.ask("Input.dispatchKeyEvent", &event);
    }
}

/// What can be pressed or filled in now, in the order of the page.
const REACHABLE: &str =
    "[...document.querySelectorAll('button, input, select, textarea, a[href], [tabindex=\"0\"]')]
  .filter(e => !e.disabled && e.offsetParent !== null && !e.closest('[inert]'))";
/// The element that has the focus: its place in that list, and what is wrong with how it is seen.
const FOCUSED: &str = "(() => {
  const e = document.activeElement, style = getComputedStyle(e.closest('.editor-source') || e), r = e.getBoundingClientRect();
  const seen = style.outlineStyle !== 'none' && parseFloat(style.outlineWidth) >= 3;
  const head = document.querySelector('header'), below = head.contains(e) || r.bottom > head.getBoundingClientRect().bottom;
  const wrong = [seen ? '' : 'no outline', below ? '' : 'behind the head', r.top < innerHeight ? '' : 'below the window'];
  return [LIST.indexOf(e), e.id || e.className || e.tagName, wrong.filter(Boolean).join(', ')];
})()";

#[test]
fn tab_reaches_everything_in_order_with_a_visible_focus() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((_daemon, mut page)) = open(folder.path()) else {
        return;
    };
    page.value("document.getElementById('new-profile').click()");
    page.until("document.getElementById('form-0-0-to_mm') && checked");
    for (width, height) in [(1280, 800), (768, 1024)] {
        page.size(width, height);
        page.value("document.body.tabIndex = -1; document.body.focus(); scrollTo(0, 0)");
        let count = page
            .value(&format!("{REACHABLE}.length"))
            .as_u64()
            .expect("a number");
        let (mut places, mut wrong) = (Vec::new(), Vec::new());
        // A field of a date has a stop for day, month, year and calendar.
        let dates = page.value("document.querySelectorAll('input[type=date]').length");
        for _ in 0..count + 3 * dates.as_u64().expect("a number") {
            tab(&mut page);
            let focused = page.value(&FOCUSED.replace("LIST", REACHABLE));
            places.push(focused[0].as_i64().expect("a place"));
            if focused[2] != "" {
                wrong.push(focused.to_string());
            }
        }
        places.dedup();
        let expected: Vec<i64> = (0..count as i64).collect();
        assert_eq!(places, expected, "{width}x{height}");
        assert_eq!(wrong, Vec::<String>::new(), "{width}x{height}");
    }
}

#[test]
fn a_tablet_shows_the_page_whole_and_stop_stays() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((_daemon, mut page)) = open(folder.path()) else {
        return;
    };
    page.size(768, 1024);
    page.value("document.getElementById('new-profile').click()");
    page.until("document.getElementById('form-0-0-to_mm') && checked");
    for scroll in ["0", "1200", "document.body.scrollHeight"] {
        page.value(&format!("scrollTo(0, {scroll})"));
        let seen = page.value(
            "(() => { const e = document.getElementById('stop'), r = e.getBoundingClientRect(); \
             return r.top >= 0 && r.right <= innerWidth && e.contains(document.elementFromPoint(r.x + r.width / 2, r.y + r.height / 2)); })()",
        );
        assert_eq!(seen, true, "scrolled to {scroll}");
    }
    assert_eq!(page.misplaced(), "");
}

#[test]
fn nothing_is_asked_from_elsewhere() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((daemon, mut page)) = open(folder.path()) else {
        return;
    };
    page.value("document.getElementById('new-profile').click()");
    page.until("document.getElementById('form-0-0-to_mm') && checked");
    let asked = page.value("performance.getEntriesByType('resource').map(e => e.name)");
    let asked = asked.as_array().expect("a list");
    assert!(asked.len() > 10, "{asked:?}");
    for address in asked {
        let address = address.as_str().expect("a text");
        assert!(address.starts_with(&format!("{}/", daemon.url)), "{address}");
    }
}
