//! The layers of `src/lib.rs` hold, the lists are complete, formatting is done.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn rust_files(dir: &Path, into: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(dir).expect("source folder is readable") {
        let path = entry.expect("entry is readable").path();
        if path.is_dir() {
            rust_files(&path, into);
        } else if path.extension().is_some_and(|e| e == "rs") {
            into.push(path);
        }
    }
}

/// `module -> rank` from the table in `src/lib.rs`.
fn ranks() -> BTreeMap<String, u32> {
    let lib = fs::read_to_string(root().join("src/lib.rs")).expect("lib.rs is there");
    let mut ranks = BTreeMap::new();
    for line in lib.lines().filter_map(|l| l.strip_prefix("//! | ")) {
        let mut cells = line.split('|').map(str::trim);
        let (Some(rank), Some(modules)) = (cells.next().and_then(|c| c.parse().ok()), cells.next()) else {
            continue;
        };
        for module in modules.split(',') {
            ranks.insert(module.trim().to_owned(), rank);
        }
    }
    ranks
}

/// The top module that a file belongs to.
fn module_of(file: &Path) -> Option<String> {
    let inner = file.strip_prefix(root().join("src")).ok()?;
    let first = inner.components().next()?.as_os_str().to_str()?;
    let name = first.strip_suffix(".rs").unwrap_or(first);
    (name != "lib" && name != "main").then(|| name.to_owned())
}

/// Top modules named after `crate::` anywhere in a text, single or in braces; comments left out.
fn uses(text: &str) -> Vec<String> {
    let code: String = text
        .lines()
        .map(|l| l.split("//").next().unwrap_or(""))
        .collect::<Vec<_>>()
        .join("\n");
    let word = |s: &str| {
        s.chars()
            .take_while(|c| c.is_alphanumeric() || *c == '_')
            .collect::<String>()
    };
    let mut found = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        match rest.strip_prefix('{') {
            Some(list) => {
                let mut depth = 0;
                let mut start = true;
                for (i, c) in list.char_indices() {
                    match c {
                        '{' => depth += 1,
                        '}' if depth == 0 => break,
                        '}' => depth -= 1,
                        ',' if depth == 0 => start = true,
                        c if start && !c.is_whitespace() => {
                            found.push(word(&list[i..]));
                            start = false;
                        }
                        _ => {}
                    }
                }
            }
            None => found.push(word(rest)),
        }
    }
    found.retain(|w| !w.is_empty());
    found
}

#[test]
fn imports_run_downwards_only() {
    let ranks = ranks();
    assert!(
        ranks.len() > 10,
        "the layer table of lib.rs was not understood: {ranks:?}"
    );
    let mut files = Vec::new();
    rust_files(&root().join("src"), &mut files);
    let mut wrong = Vec::new();
    for file in files {
        let Some(module) = module_of(&file) else { continue };
        let Some(rank) = ranks.get(&module) else {
            wrong.push(format!("{} is in no rank of the table in lib.rs", file.display()));
            continue;
        };
        let text = fs::read_to_string(&file).expect("source file is readable");
        for used in uses(&text) {
            if used != module && ranks.get(&used).is_some_and(|r| r >= rank) {
                wrong.push(format!(
                    "{}: {module} (rank {rank}) uses {used} (rank {})",
                    file.display(),
                    ranks[&used]
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_reader_of_imports_sees_braces_and_paths() {
    let text =
        "use crate::{model::Plant, units::{self, Mode}, twin};\nlet x = crate::cli::run(); // crate::daemon";
    assert_eq!(uses(text), ["model", "units", "twin", "cli"]);
}

#[test]
fn physics_knows_no_clock_no_tokio_no_files() {
    let physics = [
        "units",
        "recording",
        "profile",
        "model",
        "effect",
        "identify",
        "diagnose",
        "truth",
    ];
    let forbidden = [
        "std::time::Instant",
        "SystemTime",
        "tokio::",
        "std::fs",
        "std::net",
    ];
    // The run file and the export are the two places of `recording` that own a path.
    let owns_files = [
        "run_file",
        "export",
        "csv",
        "datapackage",
        "recorder",
        "write_file",
        "atomic_file",
    ];
    let mut files = Vec::new();
    rust_files(&root().join("src"), &mut files);
    let mut wrong = Vec::new();
    for file in files {
        let Some(module) = module_of(&file).filter(|m| physics.contains(&m.as_str())) else {
            continue;
        };
        let path = file.display().to_string();
        if module == "recording" && owns_files.iter().any(|o| path.contains(o)) {
            continue;
        }
        let text = fs::read_to_string(&file).expect("source file is readable");
        let code = text.split("#[cfg(test)]").next().unwrap_or("");
        wrong.extend(
            forbidden
                .iter()
                .filter(|f| code.contains(*f))
                .map(|f| format!("{path} uses {f}")),
        );
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A proof in which truth and diagnosis share code proves nothing.
#[test]
fn the_truth_of_sealed_cases_shares_nothing_with_what_it_tests() {
    let mut files = Vec::new();
    rust_files(&root().join("src/truth"), &mut files);
    assert!(files.len() > 4, "src/truth was not found");
    for file in files {
        let text = fs::read_to_string(&file).expect("source file is readable");
        for used in uses(&text) {
            assert!(
                ["recording", "truth", "units"].contains(&used.as_str()),
                "{} uses {used}: only recording and units are common ground",
                file.display()
            );
        }
    }
}

#[test]
fn no_file_is_longer_than_500_lines() {
    let mut files = Vec::new();
    rust_files(&root().join("src"), &mut files);
    let long: Vec<String> = files
        .iter()
        .map(|f| {
            (
                f,
                fs::read_to_string(f)
                    .expect("source file is readable")
                    .lines()
                    .count(),
            )
        })
        .filter(|(_, lines)| *lines > 500)
        .map(|(f, lines)| format!("{}: {lines} lines", f.display()))
        .collect();
    assert!(long.is_empty(), "split these:\n{}", long.join("\n"));
}

#[test]
fn the_tree_is_formatted() {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let out = Command::new(cargo)
        .args(["fmt", "--check"])
        .current_dir(root())
        .output()
        .expect("cargo fmt runs: rustup component add rustfmt");
    assert!(
        out.status.success(),
        "run cargo fmt:\n{}",
        String::from_utf8_lossy(&out.stdout)
    );
}
