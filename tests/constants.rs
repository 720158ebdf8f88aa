//! docs/diagnosis-constants.md lists every constant of the diagnosis with its reason, as it stands beside the constant.
//!
//! `LEAFBENCH_WRITE_CONSTANTS=1 cargo test --release --lib constants` writes the page anew.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

const PAGE: &str = "docs/diagnosis-constants.md";
const HEAD: &str = "# Constants of the diagnosis

Every constant of `src/diagnose` with its value and its reason, room by room in the order in which the data walk through them. A reason
that stands for several constants is with the first of them. The page is made from the comments beside the constants (`tests/constants.rs`),
so it cannot lag behind.
";
/// Rooms in the order of the table in `src/diagnose/mod.rs`; what lies beside them comes last.
const ROOMS: [&str; 6] = [
    "conditioning",
    "fitting",
    "search",
    "judgement",
    "next_test",
    "aggregates",
];

/// A constant as the page shows it.
#[derive(Debug, PartialEq)]
struct ListedConstant {
    name: String,
    value: String,
    /// Empty where the reason of the constant before stands for this one too.
    reason: String,
}

/// Constants of one file, without its tests. An error names a constant that has no reason.
fn constants(text: &str) -> Result<Vec<ListedConstant>, String> {
    let code = text.split("#[cfg(test)]").next().unwrap_or_default();
    let lines: Vec<&str> = code.lines().collect();
    let (mut found, mut reason, mut after_constant) = (Vec::new(), Vec::new(), false);
    let mut i = 0;
    while i < lines.len() {
        let line = lines[i].trim();
        if let Some(words) = line.strip_prefix("///") {
            reason.push(words.trim());
        } else if let Some((name, value)) = constant(line) {
            // A value of several lines is a table; its end is a line that closes it.
            let mut whole = value.to_owned();
            while !whole.ends_with(';') && i + 1 < lines.len() {
                i += 1;
                write!(whole, " {}", lines[i].trim()).expect("text grows");
            }
            if reason.is_empty() && !after_constant {
                return Err(format!("{name} has no reason"));
            }
            found.push(ListedConstant {
                name: name.to_owned(),
                value: whole.trim().trim_end_matches(';').to_owned(),
                reason: reason.join(" "),
            });
            reason.clear();
            after_constant = true;
            i += 1;
            continue;
        } else {
            reason.clear();
        }
        after_constant &= line.starts_with("///");
        i += 1;
    }
    Ok(found)
}

/// Name and the beginning of the value, if a line begins a constant.
fn constant(line: &str) -> Option<(&str, &str)> {
    let (visibility, rest) = line.split_once("const ")?;
    if !(visibility.is_empty() || visibility.starts_with("pub")) {
        return None;
    }
    let (name, rest) = rest.split_once(':')?;
    let is_name = name
        .chars()
        .all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_');
    let (_, value) = rest.split_once('=')?;
    is_name.then_some((name, value))
}

/// Files of a folder with their path in it, sorted, without files of tests.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("folder is readable") {
        let path = entry.expect("entry is readable").path();
        if path.is_dir() {
            found.extend(files(&path));
        } else if path
            .file_stem()
            .is_some_and(|stem| !stem.to_string_lossy().ends_with("tests"))
        {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// The room of a file, or nothing for a file beside the rooms.
fn room<'a>(file: &'a Path, of: &Path) -> &'a str {
    let inside = file.strip_prefix(of).expect("a file of the folder");
    let first = inside.iter().next().and_then(|part| part.to_str());
    first.filter(|part| ROOMS.contains(part)).unwrap_or("")
}

/// The page as it should be, and the number of its constants.
fn page() -> (String, usize) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/diagnose");
    let all = files(&folder);
    let (mut tables, mut count) = (String::new(), 0);
    for part in ROOMS.into_iter().chain([""]) {
        let heading = if part.is_empty() { "Beside the rooms" } else { part };
        write!(
            tables,
            "\n## {heading}\n\n| file | constant | value | reason |\n|---|---|---|---|\n"
        )
        .expect("text grows");
        for file in all.iter().filter(|file| room(file, &folder) == part) {
            let name = file
                .strip_prefix(&folder)
                .expect("a file of the folder")
                .display()
                .to_string();
            let text = fs::read_to_string(file).expect("source is readable");
            let listed = constants(&text).unwrap_or_else(|error| panic!("src/diagnose/{name}: {error}"));
            for c in listed {
                let value = c.value.replace('|', "\\|");
                writeln!(tables, "| `{name}` | `{}` | `{value}` | {} |", c.name, c.reason)
                    .expect("text grows");
                count += 1;
            }
        }
    }
    (format!("{HEAD}\n{count} constants.\n{tables}"), count)
}

#[test]
fn every_constant_of_the_diagnosis_is_on_the_page_with_its_reason() {
    let (page, count) = page();
    assert!(count > 100, "the constants were not found: {count}");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(PAGE);
    if std::env::var_os("LEAFBENCH_WRITE_CONSTANTS").is_some() {
        fs::write(&path, &page).expect("the page is writable");
    }
    let written = fs::read_to_string(&path).unwrap_or_default();
    let differs = page.lines().zip(written.lines()).find(|(now, then)| now != then);
    assert!(
        written == page,
        "{PAGE} is not up to date (LEAFBENCH_WRITE_CONSTANTS=1 cargo test --release --lib constants writes it); first difference: {differs:?}"
    );
}

#[test]
fn a_constant_without_a_reason_is_refused() {
    let listed = |name: &str, value: &str, reason: &str| ListedConstant {
        name: name.to_owned(),
        value: value.to_owned(),
        reason: reason.to_owned(),
    };
    let text = "/// Why\n/// so.\nconst A: f64 = 1.0;\npub(super) const B: [f64; 2] = [\n    1.0,\n];\n\n/// A function.\nfn f() {}\n";
    let both = vec![listed("A", "1.0", "Why so."), listed("B", "[ 1.0, ]", "")];
    assert_eq!(constants(text), Ok(both));
    let bare = "/// Why.\nconst A: f64 = 1.0;\n\nconst B: f64 = 2.0;\n";
    assert_eq!(constants(bare), Err("B has no reason".to_owned()));
}
