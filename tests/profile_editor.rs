//! The profile editor of the page, in a headless Chromium on the mock rig. Without Chromium these tests pass without running.

use super::support::browser::Page;
use super::support::{Daemon, until};

/// A ready daemon and its page; nothing without Chromium.
fn open(folder: &std::path::Path) -> Option<(Daemon, Page)> {
    let daemon = Daemon::ready(folder, &[]);
    let mut page = Page::open(&daemon.link(), 1280, 800)?;
    page.until_state("Ready");
    page.until("document.getElementById('profile').value");
    Some((daemon, page))
}

/// Presses a button of the page that may lie outside of the window.
fn press(page: &mut Page, id: &str) {
    page.until(&format!("!document.getElementById('{id}').disabled"));
    page.value(&format!("document.getElementById('{id}').click()"));
}

/// Presses the first button of a question.
fn confirm(page: &mut Page, id: &str) {
    page.until(&format!("!document.getElementById('{id}').hidden"));
    page.value(&format!("document.querySelector('#{id} button').click()"));
}

/// Replaces the text of the editor as typing does.
fn type_text(page: &mut Page, text: &str) {
    let text = serde_json::Value::from(text);
    page.value(&format!(
        "source.value = {text}; source.dispatchEvent(new Event('input'))"
    ));
}

/// Writes into a field of the form as typing does.
fn fill(page: &mut Page, id: &str, text: &str) {
    page.until(&format!("outline && document.getElementById('{id}')"));
    page.value(&format!(
        "(() => {{ const f = document.getElementById('{id}'); f.focus(); f.value = '{text}'; f.dispatchEvent(new Event('input')); }})()"
    ));
}

fn text(page: &mut Page) -> String {
    page.value("source.value").as_str().expect("a text").to_owned()
}

const CHECKED: &str = "checked && !document.getElementById('editor-error').textContent";

#[test]
fn a_change_in_the_form_is_written_into_the_text_and_comments_stay() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((_daemon, mut page)) = open(folder.path()) else {
        return;
    };
    press(&mut page, "new-profile");
    page.until(CHECKED);
    assert!(
        page.text("editor-plan").contains("11 s. Predicted: "),
        "{}",
        page.text("editor-plan")
    );
    fill(&mut page, "form-0-0-to_mm", "6,5");
    fill(&mut page, "form-0-1-duration_s", "2");
    page.until("checked && checked.duration_s === 12 && checked.displacement_max_mm === 6.5");
    let written = text(&mut page);
    assert!(written.starts_with("# Levels count from"), "{written}");
    assert!(
        written.contains("to_mm = 6.5\n") && written.contains("kind = \"hold\"\nduration_s = 2\n"),
        "{written}"
    );
    // What is no number is marked and not written.
    fill(&mut page, "form-0-0-to_mm", "fast");
    assert_eq!(
        page.value("document.getElementById('form-0-0-to_mm').getAttribute('aria-invalid')"),
        "true"
    );
    assert_eq!(text(&mut page), written);

    // Blocks and segments: added, moved, removed.
    page.value("document.getElementById('form-0-new-kind').value = 'sine'");
    press(&mut page, "form-0-add");
    page.until("outline && outline.blocks[0].segments.length === 4 && document.getElementById('form-0-3-amplitude_mm')");
    fill(&mut page, "form-0-3-taper_cycles", "3");
    page.until("source.value.includes('taper_cycles = 3')");
    page.until(CHECKED);
    press(&mut page, "form-0-3-up");
    page.until("outline && outline.blocks[0].segments[2].values.some(v => v.text === '\"sine\"')");
    press(&mut page, "form-0-2-remove");
    page.until("outline && outline.blocks[0].segments.length === 3");
    press(&mut page, "form-add-block");
    page.until("outline && outline.blocks.length === 2");
    fill(&mut page, "form-1-repeat", "4");
    page.until(&format!("{CHECKED} && source.value.includes('repeat = 4')"));
    assert!(!text(&mut page).contains("sine"));
    assert_eq!(page.misplaced(), "");
}

#[test]
fn an_error_of_the_text_is_marked_at_its_line_and_column() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((_daemon, mut page)) = open(folder.path()) else {
        return;
    };
    press(&mut page, "new-profile");
    page.until(CHECKED);
    let wrong = text(&mut page).replacen("duration_s = 5.0", "duration_s = -1", 1);
    type_text(&mut page, &wrong);
    page.until("document.querySelector('#editor-marks mark')");
    assert_eq!(
        page.value("document.querySelector('#editor-marks mark').textContent"),
        "-1"
    );
    assert_eq!(
        page.value("document.querySelector('#editor-lines b').textContent"),
        "12\n"
    );
    assert!(
        page.text("editor-error")
            .contains("line 12, column 14: duration_s = -1 is not above 0")
    );
    press(&mut page, "editor-goto");
    assert_eq!(
        page.value("source.value.slice(source.selectionStart, source.selectionEnd)"),
        "-1"
    );
    press(&mut page, "editor-save");
    page.until("document.getElementById('editor-told').textContent.includes('is not above 0')");
    // The form still reads the text, and can mend it.
    fill(&mut page, "form-0-0-duration_s", "4");
    page.until(CHECKED);
    assert_eq!(
        page.value("document.querySelector('#editor-marks mark')"),
        serde_json::Value::Null
    );
}

#[test]
fn profiles_are_saved_copied_and_deleted_and_a_shipped_one_only_when_asked() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((_daemon, mut page)) = open(folder.path()) else {
        return;
    };
    let own = folder.path().join("profiles");
    press(&mut page, "new-profile");
    page.until(CHECKED);
    press(&mut page, "editor-save");
    page.until("document.getElementById('profile').value === 'my-test'");
    assert!(own.join("my-test.toml").is_file());
    let group = "document.getElementById('profile').selectedOptions[0].parentElement.label";
    assert_eq!(page.value(group), "Your profiles");
    // Unsaved changes of the chosen profile forbid the run, and saving allows it.
    fill(&mut page, "form-0-0-to_mm", "4");
    page.until("document.getElementById('run').disabled");
    assert!(
        page.text("plan").contains("save them before you run it"),
        "{}",
        page.text("plan")
    );
    page.until(CHECKED);
    press(&mut page, "editor-save");
    page.until("!document.getElementById('run').disabled");
    assert!(
        std::fs::read_to_string(own.join("my-test.toml"))
            .expect("saved")
            .contains("to_mm = 4\n")
    );

    press(&mut page, "editor-duplicate");
    page.until(CHECKED);
    press(&mut page, "editor-save");
    page.until("document.getElementById('profile').value === 'my-test-copy'");
    press(&mut page, "editor-delete");
    confirm(&mut page, "editor-ask");
    until("the copy is gone", || {
        (!own.join("my-test-copy.toml").exists()).then_some(())
    });

    page.until("document.getElementById('editor').hidden && profiles.every(p => p.name !== 'my-test-copy')");
    page.value("document.getElementById('profile').value = 'static-ramp-12s'");
    press(&mut page, "edit-profile");
    page.until(&format!("{CHECKED} && edited.name === 'static-ramp-12s'"));
    press(&mut page, "editor-save");
    page.until("!document.getElementById('editor-ask').hidden");
    assert!(
        page.text("editor-ask").contains("a shipped profile"),
        "{}",
        page.text("editor-ask")
    );
    assert!(!own.join("static-ramp-12s.toml").exists());
    confirm(&mut page, "editor-ask");
    until("saved", || {
        own.join("static-ramp-12s.toml").is_file().then_some(())
    });
    page.until(&format!("{group} === 'Your profiles'"));
}

#[test]
fn a_prediction_that_trips_disables_run_and_says_so_beside_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((_daemon, mut page)) = open(folder.path()) else {
        return;
    };
    press(&mut page, "new-profile");
    page.until(CHECKED);
    fill(&mut page, "form-0-0-to_mm", "500");
    page.until("checked && checked.trips.length > 0");
    assert!(
        page.text("editor-plan").starts_with("Cannot run: "),
        "{}",
        page.text("editor-plan")
    );
    press(&mut page, "editor-save");
    page.until("planned.name === 'my-test' && planned.refused && document.getElementById('run').disabled");
    let beside = page.text("plan");
    assert!(
        beside.starts_with("Cannot run: ") && beside.contains(" mm"),
        "{beside}"
    );
    fill(&mut page, "form-0-0-to_mm", "5");
    page.until(CHECKED);
    press(&mut page, "editor-save");
    page.until("!document.getElementById('run').disabled");
}
