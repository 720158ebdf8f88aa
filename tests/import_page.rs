//! Foreign tables through the page: what is taken for what, corrected and imported, with the same numbers as on the command line.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::support::browser::Page;
use super::support::{Daemon, leafbench, until};

/// A foreign table of `tests/recordings/foreign`; what a person says about it on the page (column, target, factor, sign), the
/// time between two samples; the same for the command line.
type Foreign = (
    &'static str,
    &'static [(usize, &'static str, &'static str, bool)],
    &'static str,
    &'static [&'static str],
);

const TABLES: [Foreign; 14] = [
    (
        "clock-time.csv",
        &[
            (0, "time_s", "", false),
            (1, "displacement_mm", "", false),
            (2, "force_n", "", false),
        ],
        "",
        &["--map", "#1=time_s,#2=displacement_mm,#3=force_n"],
    ),
    ("decimal-comma.csv", &[], "", &[]),
    ("kilonewtons.csv", &[], "", &[]),
    ("latin-1.csv", &[], "", &[]),
    (
        "no-header.csv",
        &[
            (0, "time_s", "", false),
            (1, "displacement_mm", "", false),
            (2, "force_n", "", false),
        ],
        "",
        &["--map", "#1=time_s,#2=displacement_mm,#3=force_n"],
    ),
    ("no-time.csv", &[], "0,001", &["--dt", "0.001"]),
    ("old-line-ends.csv", &[], "", &[]),
    (
        "other-names.csv",
        &[(1, "displacement_mm", "10", false), (2, "force_n", "10", false)],
        "0.001",
        &["--map", "#2=displacement_mm*10,#3=force_n*10", "--dt", "0.001"],
    ),
    ("preamble.csv", &[], "", &[]),
    ("quoted-thousands.csv", &[], "", &[]),
    ("tab.txt", &[], "", &[]),
    ("time-in-ms.csv", &[], "", &[]),
    ("utf-16.txt", &[], "", &[]),
    (
        "wrong-sign.csv",
        &[(2, "force_n", "", true)],
        "",
        &["--flip", "force"],
    ),
];

fn foreign(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/recordings/foreign")
        .join(name)
}

/// Chooses a file in the field of the page, as a person does.
fn choose(page: &mut Page, name: &str, bytes: &[u8]) {
    let (name, bytes) = (json!(name), json!(bytes));
    page.value(&format!(
        "(() => {{ const files = new DataTransfer(); files.items.add(new File([new Uint8Array({bytes})], {name})); \
         const field = document.getElementById('import-file'); field.files = files.files; \
         field.dispatchEvent(new Event('change')); }})()"
    ));
    page.until(
        "importSeen && importSeen.columns.length || document.getElementById('import-told').textContent",
    );
}

/// Changes a field and waits for the preview that follows.
fn set(page: &mut Page, id: &str, property: &str, value: &serde_json::Value) {
    page.value(&format!(
        "(() => {{ const f = document.getElementById('{id}'); importSeen.old = true; f['{property}'] = {value}; \
         f.dispatchEvent(new Event('change')); }})()"
    ));
    page.until("!importSeen.old || document.getElementById('import-told').textContent");
}

/// Makes the choices of a person for the table that was chosen.
fn correct(page: &mut Page, (_, choices, interval, _): &Foreign) {
    for (column, target, factor, flip) in *choices {
        set(page, &format!("import-target-{column}"), "value", &json!(target));
        if !factor.is_empty() {
            set(page, &format!("import-factor-{column}"), "value", &json!(factor));
        }
        if *flip {
            set(page, &format!("import-flip-{column}"), "checked", &json!(true));
        }
    }
    if !interval.is_empty() {
        set(page, "import-interval", "value", &json!(interval));
    }
}

/// The CSV that the command line makes of the table.
fn by_command(folder: &Path, (name, _, _, options): &Foreign) -> String {
    let csv = folder.join("wanted.csv");
    let output = leafbench(&["import", "--force", "--out"])
        .arg(&csv)
        .arg(foreign(name))
        .args(*options)
        .output()
        .expect("leafbench starts");
    assert!(
        output.status.success(),
        "{name}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    std::fs::read_to_string(&csv).expect("written")
}

#[test]
fn every_foreign_table_comes_in_with_the_numbers_of_the_command_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let Some(mut page) = Page::open(&daemon.link(), 1280, 800) else {
        return;
    };
    page.until_state("Ready");
    for table in TABLES {
        let name = table.0;
        choose(&mut page, name, &std::fs::read(foreign(name)).expect("there"));
        correct(&mut page, &table);
        assert_eq!(page.text("import-problem"), "", "{name}");
        assert_eq!(page.value("importSeen.result.first.length > 2"), true, "{name}");
        page.value("document.getElementById('import-save').click()");
        page.until("document.getElementById('import-told').textContent");
        let told = page.text("import-told");
        assert!(told.starts_with("Imported as "), "{name}: {told}");
        let stem = name.split('.').next().expect("a name");
        let imported = folder.path().join("imports").join(format!("{stem}.csv"));
        let written = std::fs::read_to_string(&imported).expect(name);
        assert_eq!(written, by_command(folder.path(), &table), "{name}");
        assert!(imported.with_extension("datapackage.json").is_file(), "{name}");
    }
    page.until(&format!(
        "document.querySelectorAll('#imports li').length === {}",
        TABLES.len()
    ));
    assert_eq!(page.misplaced(), "");
}

#[test]
fn what_cannot_be_imported_is_said_in_the_words_of_the_page_and_nothing_is_replaced_unasked() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let Some(mut page) = Page::open(&daemon.link(), 1280, 800) else {
        return;
    };
    page.until_state("Ready");
    choose(&mut page, "picture.csv", b"\x89PNG\x00\x01\x02");
    assert!(
        page.text("import-told").contains("this is not text"),
        "{}",
        page.text("import-told")
    );

    choose(
        &mut page,
        "no-time.csv",
        &std::fs::read(foreign("no-time.csv")).expect("there"),
    );
    let problem = page.text("import-problem");
    assert!(
        problem.contains("give the time between two samples in s") && !problem.contains("--"),
        "{problem}"
    );
    assert_eq!(
        page.value("document.getElementById('import-save').disabled"),
        true
    );
    set(&mut page, "import-interval", "value", &json!("0.001"));
    page.value("document.getElementById('import-save').click()");
    page.until("document.getElementById('import-told').textContent.startsWith('Imported as no-time')");
    let csv = folder.path().join("imports/no-time.csv");
    std::fs::write(&csv, "mine").expect("written");
    page.value("document.getElementById('import-save').click()");
    page.until("!document.getElementById('import-ask').hidden");
    assert_eq!(std::fs::read_to_string(&csv).expect("there"), "mine");
    page.value("document.querySelector('#import-ask button').click()");
    until("replaced", || {
        (std::fs::read_to_string(&csv).ok()? != "mine").then_some(())
    });
}

#[test]
fn a_table_that_is_too_large_is_refused_with_words() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let head = format!(
        "POST /api/imports/preview?file=big.csv HTTP/1.1\r\nHost: {}\r\nContent-Type: application/octet-stream\r\n\
         {}Content-Length: {}\r\nConnection: close\r\n\r\n",
        daemon.authority(),
        daemon.bearer(),
        200 << 20
    );
    let mut stream = std::net::TcpStream::connect(daemon.authority()).expect("the daemon listens");
    std::io::Write::write_all(&mut stream, head.as_bytes()).expect("sent");
    let (status, body) = super::support::http::answer(stream);
    assert_eq!(status, 413, "{body}");
    assert!(
        body.contains("the table has more than 128 MiB") && body.contains("leafbench import FILE"),
        "{body}"
    );
}
