//! The house rules hold: layers, unique names, short functions, doc comments with content, cited pages that exist.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A function longer than this is a list of steps that need names.
const LONGEST_FUNCTION: usize = 60;
/// A doc comment with fewer words says nothing that the name does not say.
const FEWEST_DOC_WORDS: usize = 3;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Path relative to the repository, for messages.
fn shown(path: &Path) -> String {
    path.strip_prefix(root()).unwrap_or(path).display().to_string()
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// All files below `folder` with one of the extensions.
fn files(folder: &str, extensions: &[&str]) -> Vec<PathBuf> {
    fn walk(folder: &Path, extensions: &[&str], into: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).expect("folder is readable") {
            let path = entry.expect("entry is readable").path();
            if path.is_dir() {
                walk(&path, extensions, into);
            } else if path
                .extension()
                .is_some_and(|e| extensions.iter().any(|x| e == *x))
            {
                into.push(path);
            }
        }
    }
    let mut found = Vec::new();
    walk(&root().join(folder), extensions, &mut found);
    found.sort();
    assert!(!found.is_empty(), "{folder} holds no {extensions:?}");
    found
}

fn rust_files(folder: &str) -> Vec<PathBuf> {
    files(folder, &["rs"])
}

/// `module -> rank` from the table in `src/lib.rs`.
fn ranks() -> BTreeMap<String, u32> {
    let lib = read(&root().join("src/lib.rs"));
    let mut ranks = BTreeMap::new();
    for line in lib.lines().filter_map(|l| l.strip_prefix("//! | ")) {
        let mut cells = line.split('|').map(str::trim);
        let (Some(rank), Some(modules)) = (cells.next().and_then(|c| c.parse().ok()), cells.next()) else {
            continue;
        };
        for module in modules.split(',') {
            ranks.insert(module.trim().trim_matches('`').to_owned(), rank);
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
    let mut wrong = Vec::new();
    for file in rust_files("src") {
        let Some(module) = module_of(&file) else { continue };
        let Some(rank) = ranks.get(&module) else {
            wrong.push(format!("{} is in no rank of the table in lib.rs", shown(&file)));
            continue;
        };
        for used in uses(&read(&file)) {
            if used != module && ranks.get(&used).is_some_and(|r| r >= rank) {
                wrong.push(format!(
                    "{}: {module} (rank {rank}) uses {used} (rank {})",
                    shown(&file),
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

/// A module as its path from the crate: `["profile", "file"]`.
type ModulePath = Vec<String>;
/// For each module, the modules beside it that it imports.
type Imports = BTreeMap<ModulePath, BTreeSet<ModulePath>>;

fn module_path(file: &str) -> ModulePath {
    let file = file.trim_start_matches("src/").trim_end_matches(".rs");
    file.trim_end_matches("/mod")
        .split('/')
        .map(str::to_owned)
        .collect()
}

/// Code of a file without its comments and without the test module at its end.
fn code_without_tests(text: &str) -> String {
    let lines: Vec<&str> = text
        .lines()
        .map(|l| l.split("//").next().unwrap_or("").trim_end())
        .collect();
    let tests = lines
        .windows(2)
        .position(|pair| pair[0] == "#[cfg(test)]" && pair[1].contains("mod ") && pair[1].ends_with('{'));
    lines[..tests.unwrap_or(lines.len())].join("\n")
}

/// Reads the path at the start of a text, with all branches of its braces, and returns the rest of the text.
fn read_path<'t>(text: &'t str, before: &[String], found: &mut Vec<ModulePath>) -> &'t str {
    let Some(list) = text.strip_prefix('{').filter(|_| !before.is_empty()) else {
        let end = text
            .find(|c: char| !c.is_alphanumeric() && c != '_')
            .unwrap_or(text.len());
        let (word, rest) = text.split_at(end);
        let mut path = before.to_vec();
        path.extend((!word.is_empty()).then(|| word.to_owned()));
        return match rest.strip_prefix("::").filter(|_| !word.is_empty()) {
            Some(rest) => read_path(rest, &path, found),
            None => {
                found.push(path);
                rest
            }
        };
    };
    let mut rest = list.trim_start();
    while !rest.is_empty() && !rest.starts_with('}') {
        rest = read_path(rest, before, found);
        // An `as` and the new name are left out.
        rest = &rest[rest.find([',', '}']).unwrap_or(rest.len())..];
        rest = rest.strip_prefix(',').unwrap_or(rest).trim_start();
    }
    rest.strip_prefix('}').unwrap_or(rest)
}

/// All paths in a code, and whether each one is in a `use`.
fn paths(code: &str) -> Vec<(bool, ModulePath)> {
    let mut all = Vec::new();
    let (mut rest, mut in_use) = (code, false);
    while let Some(start) = rest.find(|c: char| c.is_alphabetic() || c == '_' || c == ';') {
        rest = &rest[start..];
        if let Some(after) = rest.strip_prefix(';') {
            (rest, in_use) = (after, false);
            continue;
        }
        let mut found = Vec::new();
        rest = read_path(rest, &[], &mut found);
        if found == [["pub"]] && rest.starts_with("(in ") {
            // How far an item is seen is no use of what sees it.
            rest = &rest[rest.find(')').unwrap_or(0)..];
        }
        in_use |= found == [["use"]];
        all.extend(found.into_iter().filter(|p| p.len() > 1).map(|p| (in_use, p)));
    }
    all
}

/// The path from the crate of a path that is written in `module`; `None` for a path into another crate or into a type.
fn from_crate(
    module: &[String],
    path: &[String],
    files: &BTreeMap<ModulePath, String>,
) -> Option<ModulePath> {
    let ups = path.iter().take_while(|s| *s == "super").count();
    let child = [module, &path[..1]].concat();
    match path[0].as_str() {
        "crate" => Some(path[1..].to_vec()),
        "self" => Some([module, &path[1..]].concat()),
        "super" => Some([&module[..module.len().checked_sub(ups)?], &path[ups..]].concat()),
        _ => files.contains_key(&child).then(|| [module, path].concat()),
    }
}

/// Names that a module takes from its own children and hands on, with the path behind each.
fn handed_on(files: &BTreeMap<ModulePath, String>) -> BTreeMap<ModulePath, ModulePath> {
    let mut names = BTreeMap::new();
    for (module, code) in files {
        for (in_use, path) in paths(code) {
            let target = from_crate(module, &path, files).filter(|t| in_use && t.len() > module.len() + 1);
            if let Some(target) = target.filter(|t| t.starts_with(module)) {
                names.insert([&module[..], &target[target.len() - 1..]].concat(), target);
            }
        }
    }
    names
}

/// Each module with a module that it uses, once for each use; names that a parent hands on are followed.
fn used_modules(files: &BTreeMap<ModulePath, String>) -> Vec<(&ModulePath, ModulePath)> {
    let handed_on = handed_on(files);
    let mut uses = Vec::new();
    for (module, code) in files {
        for (_, path) in paths(code) {
            let Some(mut path) = from_crate(module, &path, files) else {
                continue;
            };
            while let Some((name, behind)) = (1..=path.len())
                .rev()
                .filter(|&n| !files.contains_key(&path[..n]))
                .find_map(|n| Some((n, handed_on.get(&path[..n])?)))
            {
                path = [behind, &path[name..]].concat();
            }
            if let Some(used) = (1..=path.len()).rev().find(|&n| files.contains_key(&path[..n])) {
                path.truncate(used);
                uses.push((module, path));
            }
        }
    }
    uses
}

/// Imports between modules that stand side by side. A folder is one module for those beside it; what a parent and its own
/// children take from each other is left out.
fn imports_beside(files: &BTreeMap<ModulePath, String>) -> Imports {
    let mut imports = Imports::new();
    for (module, used) in used_modules(files) {
        let same = module.iter().zip(&used).take_while(|(a, b)| a == b).count();
        if same > 0 && same < module.len() && same < used.len() {
            let beside = imports.entry(module[..=same].to_vec()).or_default();
            beside.insert(used[..=same].to_vec());
        }
    }
    imports
}

/// Groups of modules that import each other, directly or through others.
fn circles(imports: &Imports) -> BTreeSet<Vec<String>> {
    let reached = |from: &ModulePath| {
        let mut seen = BTreeSet::new();
        let mut next: Vec<&ModulePath> = imports.get(from).into_iter().flatten().collect();
        while let Some(module) = next.pop() {
            if seen.insert(module.clone()) {
                next.extend(imports.get(module).into_iter().flatten());
            }
        }
        seen
    };
    let reach: Imports = imports.keys().map(|m| (m.clone(), reached(m))).collect();
    let on_circle = reach.iter().filter(|(module, seen)| seen.contains(*module));
    on_circle
        .map(|(module, seen)| {
            let back = seen
                .iter()
                .filter(|m| reach.get(*m).is_some_and(|r| r.contains(module)));
            back.map(|m| m.join("::")).collect()
        })
        .collect()
}

/// Code of all modules of the library, without their tests.
fn library() -> BTreeMap<ModulePath, String> {
    let of_tests = |file: &Path| {
        let parts = file.with_extension("");
        parts.iter().any(|p| p.to_string_lossy().ends_with("tests"))
    };
    rust_files("src")
        .iter()
        .map(|file| (PathBuf::from(shown(file)), read(file)))
        .filter(|(file, _)| !of_tests(file) && !file.ends_with("lib.rs") && !file.ends_with("main.rs"))
        .map(|(file, text)| (module_path(&file.to_string_lossy()), code_without_tests(&text)))
        .collect()
}

#[test]
fn files_of_a_room_do_not_import_each_other_in_a_circle() {
    let imports = imports_beside(&library());
    assert!(
        imports.len() > 100,
        "the imports were not found: {}",
        imports.len()
    );
    let wrong: Vec<String> = circles(&imports).iter().map(|circle| circle.join(", ")).collect();
    assert!(
        wrong.is_empty(),
        "move what they share to a file below them:\n{}",
        wrong.join("\n")
    );
}

#[test]
fn the_reader_of_circles_follows_uses_paths_and_names_handed_on() {
    let circles_of = |texts: &[(&str, &str)]| {
        let modules = texts
            .iter()
            .map(|(file, text)| (module_path(file), code_without_tests(text)));
        circles(&imports_beside(&modules.collect()))
    };
    let a_and_b = || BTreeSet::from([vec!["r::a".to_owned(), "r::b".to_owned()]]);
    let by_paths = [
        ("src/r/mod.rs", "mod a;\nmod b;"),
        ("src/r/a.rs", "use super::{C, b::{self as other, D}};"),
        ("src/r/b.rs", "fn f() { crate::r::a::g() }"),
    ];
    assert_eq!(circles_of(&by_paths), a_and_b());
    let by_parent = [
        ("src/r/mod.rs", "mod a;\nmod b;\npub(crate) use a::{A, E};"),
        ("src/r/a.rs", "use super::b::B;"),
        ("src/r/b/mod.rs", "mod c;"),
        ("src/r/b/c.rs", "use crate::r::A;"),
    ];
    assert_eq!(circles_of(&by_parent), a_and_b());
    let none = [
        ("src/r/mod.rs", "use a::A;\npub(crate) struct P;"),
        ("src/r/a.rs", "use super::P;\nuse super::b::B; // super::c"),
        (
            "src/r/b.rs",
            "struct B;\n#[cfg(test)]\nmod tests {\n    use super::super::a::A;\n}",
        ),
    ];
    assert_eq!(circles_of(&none), BTreeSet::new());
}

/// `part -> row` from the table of parts in a doc comment; the first cell of a row names its parts.
fn rows(text: &str) -> BTreeMap<String, usize> {
    let table = text.lines().filter_map(|l| l.strip_prefix("//! | `"));
    let parts = table.enumerate().flat_map(|(row, line)| {
        let cell = line.split(" |").next().unwrap_or("");
        cell.split(',')
            .map(move |part| (part.trim().trim_matches('`').to_owned(), row))
    });
    parts.collect()
}

/// Uses in `folder` against the order of its table, one sentence each. A part uses parts in rows above its own, and nothing that
/// the folder's own `mod.rs` defines: that is built on all parts.
fn uses_against_the_order(folder: &str, text: &str, files: &BTreeMap<ModulePath, String>) -> Vec<String> {
    let rows = rows(text);
    let inside = |module: &ModulePath| module.len() > 1 && module[0] == folder;
    let there: BTreeSet<&String> = files.keys().filter(|m| inside(m)).map(|m| &m[1]).collect();
    let listed: BTreeSet<&String> = rows.keys().collect();
    let differ = there.symmetric_difference(&listed);
    let mut wrong: Vec<String> = differ
        .map(|part| format!("{part} is only in the folder or only in the table"))
        .collect();
    for (module, used) in used_modules(files).into_iter().filter(|(m, _)| inside(m)) {
        if used == [folder] {
            wrong.push(format!("{} uses what mod.rs defines", module.join("::")));
        } else if inside(&used) && used[1] != module[1] && rows.get(&used[1]) >= rows.get(&module[1]) {
            wrong.push(format!(
                "{} uses {}, which is not above {}",
                module.join("::"),
                used.join("::"),
                module[1]
            ));
        }
    }
    wrong
}

#[test]
fn the_rooms_of_a_diagnosis_use_only_earlier_rooms() {
    let doors = read(&root().join("src/diagnose/mod.rs"));
    let rows = rows(&doors);
    for room in ["conditioning", "fitting", "search", "judgement", "next_test"] {
        assert!(rows.contains_key(room), "{room} is no row of the table: {rows:?}");
    }
    let wrong = uses_against_the_order("diagnose", &doors, &library());
    assert!(
        wrong.is_empty(),
        "the data walk through the rooms once:\n{}",
        wrong.join("\n")
    );
}

#[test]
fn the_reader_of_rooms_sees_every_way_back() {
    let table = "//! | part | what it does |\n//! |---|---|\n//! | `a`, `b` | words |\n//! | `c` | first |\n//! | `d` | last |";
    let wrong = |c: &str| {
        let texts = [
            (
                "src/r/mod.rs",
                "mod a;\npub(crate) use d::D;\npub(crate) struct P;",
            ),
            ("src/r/a.rs", "pub(crate) struct A;"),
            ("src/r/b.rs", ""),
            ("src/r/c/mod.rs", "mod x;\npub(in crate::r) use x::X;"),
            ("src/r/c/x.rs", c),
            (
                "src/r/d/mod.rs",
                "use crate::r::{a::A, c::X};\npub(crate) struct D;",
            ),
        ];
        let files = texts.map(|(file, text)| (module_path(file), code_without_tests(text)));
        uses_against_the_order("r", table, &files.into_iter().collect())
    };
    assert_eq!(wrong("use super::super::a::A;"), Vec::<String>::new());
    assert_eq!(wrong("pub(in crate::r) struct X;"), Vec::<String>::new());
    assert_eq!(
        wrong("#[cfg(test)]\nmod tests {\n    use crate::r::d::D;\n}"),
        Vec::<String>::new()
    );
    let back = ["r::c::x uses r::d, which is not above c"];
    assert_eq!(wrong("use crate::r::d::D;"), back, "by its path");
    assert_eq!(
        wrong("fn f() { super::super::D }"),
        back,
        "by a name that is handed on"
    );
    assert_eq!(wrong("use crate::r::P;"), ["r::c::x uses what mod.rs defines"]);
    let files = BTreeMap::from([(module_path("src/r/a.rs"), "use super::b::B;".to_owned())]);
    let missing = |part| format!("{part} is only in the folder or only in the table");
    assert_eq!(
        uses_against_the_order("r", table, &files),
        ["b", "c", "d"].map(missing)
    );
    let files = ["a", "b", "c", "d"].map(|part| {
        let code = if part == "a" { "use super::b::B;" } else { "" };
        (vec!["r".to_owned(), part.to_owned()], code.to_owned())
    });
    let beside = uses_against_the_order("r", table, &files.into_iter().collect());
    assert_eq!(beside, ["r::a uses r::b, which is not above a"], "in one row");
}

#[test]
fn physics_knows_no_clock_no_tokio_no_files() {
    let physics = [
        "units",
        "recording",
        "profile",
        "acceptance",
        "model",
        "effect",
        "identify",
        "papers",
        "diagnose",
        "fleet",
        "truth",
    ];
    let forbidden = [
        "std::time::Instant",
        "SystemTime",
        "tokio::",
        "std::fs",
        "std::net",
    ];
    // The places of `recording` that own a path.
    let owns_files = [
        "run_file",
        "export",
        "csv",
        "datapackage",
        "recorder",
        "write_file",
        "atomic_file",
    ];
    let mut wrong = Vec::new();
    for file in rust_files("src") {
        let Some(module) = module_of(&file).filter(|m| physics.contains(&m.as_str())) else {
            continue;
        };
        let path = shown(&file);
        if module == "recording" && owns_files.iter().any(|o| path.contains(o)) {
            continue;
        }
        let text = read(&file);
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
    for file in rust_files("src/truth") {
        for used in uses(&read(&file)) {
            assert!(
                // A profile is what was commanded: it has no physics of a specimen, and the run files of a lab need it.
                ["profile", "recording", "truth", "units"].contains(&used.as_str()),
                "{} uses {used}: only profile, recording and units are common ground",
                shown(&file)
            );
        }
    }
}

/// Name of a type that a line defines at the level of a module.
fn type_defined_by(line: &str) -> Option<&str> {
    let item = line
        .strip_prefix("pub(crate) ")
        .or_else(|| line.strip_prefix("pub(super) "))
        .or_else(|| line.strip_prefix("pub "))
        .unwrap_or(line);
    let name = ["struct ", "enum ", "trait ", "type ", "union "]
        .iter()
        .find_map(|keyword| item.strip_prefix(keyword))?;
    let end = name.find(|c: char| !c.is_alphanumeric() && c != '_');
    Some(&name[..end.unwrap_or(name.len())])
}

#[test]
fn a_type_name_stands_for_one_thing() {
    let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for file in rust_files("src") {
        for line in read(&file).lines() {
            if let Some(name) = type_defined_by(line) {
                places.entry(name.to_owned()).or_default().push(shown(&file));
            }
        }
    }
    assert!(places.len() > 100, "the types were not found");
    let twice: Vec<String> = places
        .iter()
        .filter(|(_, files)| files.len() > 1)
        .map(|(name, files)| format!("{name}: {}", files.join(", ")))
        .collect();
    assert!(twice.is_empty(), "rename these:\n{}", twice.join("\n"));
}

/// Name, first line (from 1) and length of each function of a formatted file.
fn functions(text: &str) -> Vec<(String, usize, usize)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = Vec::new();
    for (start, line) in lines.iter().enumerate() {
        let item = line.trim_start();
        let indent = &line[..line.len() - item.len()];
        let is_item = item.split(' ').next().is_some_and(|word| {
            word == "fn" || word.starts_with("pub") || ["async", "const", "extern"].contains(&word)
        });
        let Some((head, rest)) = item.split_once("fn ").filter(|_| is_item) else {
            continue;
        };
        if head.contains(['=', '(', '"']) && !head.starts_with("pub(") {
            continue;
        }
        let name = rest
            .split(|c: char| !c.is_alphanumeric() && c != '_')
            .next()
            .unwrap_or("");
        if name.is_empty() || line.ends_with(['}', ';']) {
            continue;
        }
        // The formatter puts the closing brace below the first letter of the item; a trait's own line ends in `;`.
        let end = lines[start..]
            .iter()
            .position(|l| l.strip_prefix(indent) == Some("}"))
            .unwrap_or(0);
        let has_body = lines[start..=start + end].iter().any(|l| l.ends_with('{'));
        if has_body {
            found.push((name.to_owned(), start + 1, end + 1));
        }
    }
    found
}

#[test]
fn a_function_fits_a_screen() {
    let mut long = Vec::new();
    let mut seen = 0;
    for folder in ["src", "tests", "benches", "examples"] {
        for file in rust_files(folder) {
            for (name, line, length) in functions(&read(&file)) {
                seen += 1;
                if length > LONGEST_FUNCTION {
                    long.push(format!("{}:{line}: {name} has {length} lines", shown(&file)));
                }
            }
        }
    }
    assert!(seen > 2000, "only {seen} functions were found");
    assert!(long.is_empty(), "give their steps names:\n{}", long.join("\n"));
}

#[test]
fn the_measure_of_functions_counts_from_head_to_brace() {
    let text = "impl A {\n    pub(crate) fn b(\n        c: u8,\n    ) -> u8 {\n        c\n    }\n\n    fn d() {}\n}\nfn e() {\n}\n";
    let e = ("e".to_owned(), 10, 2);
    assert_eq!(functions(text), [("b".to_owned(), 2, 5), e]);
}

#[test]
fn a_doc_comment_says_more_than_two_words() {
    let mut empty = Vec::new();
    for folder in ["src", "tests", "benches", "examples"] {
        for file in rust_files(folder) {
            let text = read(&file);
            let lines: Vec<&str> = text.lines().map(str::trim_start).collect();
            for (i, line) in lines.iter().enumerate() {
                let Some(words) = line.strip_prefix("///") else {
                    continue;
                };
                let alone =
                    |j: Option<usize>| j.and_then(|j| lines.get(j)).is_none_or(|l| !l.starts_with("///"));
                let count = words.split_whitespace().count();
                if count > 0 && count < FEWEST_DOC_WORDS && alone(i.checked_sub(1)) && alone(Some(i + 1)) {
                    empty.push(format!("{}:{}: {line}", shown(&file), i + 1));
                }
            }
        }
    }
    assert!(
        empty.is_empty(),
        "say what it is, or remove:\n{}",
        empty.join("\n")
    );
}

/// Pages named in a text: `name.md`, with or without folders.
fn pages_cited(text: &str) -> Vec<String> {
    let letter = |c: char| c.is_alphanumeric() || "_-./".contains(c);
    text.match_indices(".md")
        .filter(|(at, _)| {
            text[at + 3..]
                .chars()
                .next()
                .is_none_or(|c| !c.is_alphanumeric() && c != '_')
        })
        .map(|(at, _)| {
            let start = text[..at]
                .rfind(|c| !letter(c))
                .map_or(0, |i| i + text[i..].chars().next().map_or(1, char::len_utf8));
            text[start..at + 3].to_owned()
        })
        .filter(|page| page.len() > 3 && !page.starts_with('.'))
        .collect()
}

/// Files that people read: sources, documents, configs.
fn readable_files() -> Vec<PathBuf> {
    let mut all = Vec::new();
    for folder in ["src", "tests", "benches", "examples", "bench-configs", "docs"] {
        all.extend(files(folder, &["rs", "md", "toml", "py", "html", "js", "css"]));
    }
    for name in [
        "README.md",
        "CONTRIBUTING.md",
        "CHANGELOG.md",
        "firmware-protocol.md",
        "Cargo.toml",
    ] {
        all.push(root().join(name));
    }
    // This file names what it forbids.
    all.retain(|f| !f.ends_with("tests/architecture.rs"));
    all
}

#[test]
fn every_page_that_is_cited_is_there() {
    let mut missing = Vec::new();
    for file in readable_files() {
        let text = read(&file);
        for (number, line) in text.lines().enumerate() {
            let place = || format!("{}:{}", shown(&file), number + 1);
            for page in pages_cited(line) {
                let page = page.trim_start_matches(['.', '/']);
                let beside = file.parent().map(|folder| folder.join(page));
                let there = root().join(page).is_file()
                    || root().join("docs").join(page).is_file()
                    || beside.is_some_and(|p| p.is_file());
                // What a command writes is no citation.
                let written = page == "papers.md" || page == "blind.md";
                if !there && !written {
                    missing.push(format!("{} cites {page}", place()));
                }
            }
            for phrase in ["the card", "the issue"] {
                let lower = line.to_lowercase();
                let found = lower
                    .match_indices(phrase)
                    .any(|(at, _)| !lower[at + phrase.len()..].starts_with(|c: char| c.is_alphanumeric()));
                if found {
                    missing.push(format!("{} cites \"{phrase}\", which no reader has", place()));
                }
            }
        }
    }
    assert!(missing.is_empty(), "{}", missing.join("\n"));
}

#[test]
fn the_reader_of_citations_sees_links_and_bare_names() {
    let text = "see [x](docs/formats.md#codes), `models.md`, a.mdx and (rig.md)";
    assert_eq!(pages_cited(text), ["docs/formats.md", "models.md", "rig.md"]);
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
