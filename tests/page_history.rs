//! The recorded runs on the technician's page: search, compare, diagnose, improved twin, next test. Without Chromium these
//! tests pass without running.

use super::diagnosis_jobs::confounded;
use super::run_history::fill;
use super::support::browser::Page;
use super::support::{Daemon, json};

/// Sizes of the window that technicians have.
const SIZES: [(u32, u32); 2] = [(1280, 800), (1024, 768)];

fn open(daemon: &Daemon) -> Option<Page> {
    let mut page = Page::open(&daemon.link(), SIZES[0].0, SIZES[0].1)?;
    page.until_state("Ready");
    page.until("document.querySelectorAll('#runs .opener').length > 0");
    Some(page)
}

/// Nothing is cut or lies over something else, in both sizes, and everything has its name.
fn check(page: &mut Page, when: &str) {
    for (width, height) in SIZES {
        page.size(width, height);
        assert_eq!(page.misplaced(), "", "{when} at {width}x{height}");
    }
    page.size(SIZES[0].0, SIZES[0].1);
    let nameless = "[...document.querySelectorAll('.runs button, .runs input, .runs select, .runs a')].filter(e => \
         e.offsetParent !== null && !(e.textContent.trim() || e.getAttribute('aria-label') || (e.labels && e.labels.length && \
         e.labels[0].textContent.trim()))).map(e => e.id || e.outerHTML).join()";
    assert_eq!(page.value(nameless), "", "{when}");
}

fn scroll_to(page: &mut Page, id: &str) {
    page.value(&format!(
        "document.getElementById('{id}').scrollIntoView({{ block: 'center' }})"
    ));
}

fn click(page: &mut Page, id: &str) {
    scroll_to(page, id);
    page.click(id);
}

/// Writes into a field as a person does.
fn write(page: &mut Page, id: &str, text: &str) {
    page.value(&format!(
        "(() => {{ const e = document.getElementById('{id}'); e.value = '{text}'; \
         e.dispatchEvent(new Event('input', {{ bubbles: true }})); }})()"
    ));
}

#[test]
fn runs_are_searched_paged_opened_and_compared() {
    let folder = tempfile::tempdir().expect("a folder");
    fill(folder.path(), 70);
    let daemon = Daemon::ready(folder.path(), &[]);
    let Some(mut page) = open(&daemon) else {
        return;
    };
    // Until all files are checked for damage, the count says how many are not.
    page.until("document.getElementById('runs-count').textContent === '1 to 25 of 70'");
    check(&mut page, "a page of runs");
    click(&mut page, "older");
    page.until("document.getElementById('runs-count').textContent === '26 to 50 of 70'");
    click(&mut page, "older");
    page.until("document.getElementById('runs-count').textContent === '51 to 70 of 70'");
    assert_eq!(page.value("document.getElementById('older').disabled"), true);
    click(&mut page, "newer");
    page.until("document.getElementById('runs-count').textContent === '26 to 50 of 70'");

    write(&mut page, "find-operator", "bob");
    page.until("document.getElementById('runs-count').textContent === '1 to 23 of 23'");
    write(&mut page, "find-specimen", "leaf 3");
    page.until("document.getElementById('runs-count').textContent === '1 to 3 of 3'");
    write(&mut page, "find-text", "no such thing");
    page.until("document.getElementById('runs-count').textContent === 'No run fits.'");
    click(&mut page, "find-clear");
    page.until("document.getElementById('runs-count').textContent === '1 to 25 of 70'");

    // With the keyboard alone: to the next row, and its details.
    page.value("document.querySelector('#runs .opener').focus()");
    page.key("ArrowDown", "");
    page.key("Enter", "\r");
    page.until("document.querySelector('#runs tr.details .facts')");
    assert_eq!(
        page.value("document.querySelectorAll('#runs tr')[2].className"),
        "details",
        "of the second row"
    );
    page.value("document.querySelector('#runs tr.details').scrollIntoView({ block: 'center' })");
    check(&mut page, "details");

    for n in [0, 1] {
        page.value(&format!(
            "document.querySelectorAll('#runs input[type=checkbox]')[{n}].click()"
        ));
    }
    assert_eq!(page.text("chosen"), "2 chosen");
    click(&mut page, "compare");
    page.until("!document.getElementById('comparison').hidden");
    assert_eq!(
        page.value("document.querySelectorAll('#compare-figures tr').length"),
        9
    );
    check(&mut page, "a comparison");
}

#[test]
fn a_diagnosis_is_followed_over_a_reload_and_leads_to_the_twin_and_to_the_next_test() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = confounded(folder.path());
    let Some(mut page) = open(&daemon) else {
        return;
    };
    page.value("document.getElementById('run-box-one').click()");
    click(&mut page, "diagnose");
    page.until("document.querySelector('#jobs li')");
    page.value("location.reload()");
    page.until("document.readyState === 'complete' && document.querySelector('#jobs li')");
    page.until("document.querySelector('#jobs .hint') && (document.querySelector('#jobs .hint').textContent.includes(' %: ') || document.querySelector('#jobs progress').hidden)");
    check(&mut page, "a diagnosis under way");
    page.until("document.querySelector('#jobs progress').hidden");
    let button = |words: &str| {
        format!("[...document.querySelectorAll('#jobs button')].find(b => b.textContent === '{words}')")
    };
    assert_eq!(
        page.value(&format!("{}.hidden", button("Show the report"))),
        false
    );

    page.value(&format!("{}.click()", button("Show the report")));
    page.until("document.querySelector('#jobs iframe').offsetHeight > 300");
    check(&mut page, "a report");

    page.value(&format!("{}.click()", button("Use the improved model as twin")));
    page.until("document.getElementById('twin-model').textContent.includes('(diagnosis ')");
    assert_eq!(page.value("document.getElementById('twin-own').hidden"), false);
    check(&mut page, "an improved twin");
    click(&mut page, "twin-own");
    page.until("document.getElementById('twin-model').textContent === 'Twin of the next run: equivalent'");

    page.value(&format!("{}.click()", button("Run the next test")));
    page.until("document.getElementById('profile').value.startsWith('next-test-')");
    page.until("document.getElementById('plan').textContent.includes('Predicted: ')");
    assert_eq!(
        daemon.status()["rig"]["phase"],
        "ready",
        "nothing moves before Run is pressed"
    );
    click(&mut page, "run");
    page.until_state("Running");
    page.key("Escape", "");
    page.until_state("Ready");
    let (runs, _) = json(&daemon.data, &["runs", "--text", "Esc page"]);
    assert_eq!(runs.as_array().map(Vec::len), Some(1), "{runs}");
}
