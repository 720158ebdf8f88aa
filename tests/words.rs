//! Snapshots of the words that a user reads: the help, the errors, the reports. They lie in `tests/snapshots/`.
//!
//! After a text was changed on purpose, `INSTA_UPDATE=always cargo test --release words` writes the snapshots again (not with `--lib`,
//! which would leave an older program there); read the difference before the commit. Numbers of the reports are `#`, so that only words are compared.

use std::fmt::Write as _;
use std::net::TcpListener;
use std::path::{Path, PathBuf};

use super::support::{config, leafbench};
use sha2::{Digest, Sha256};

use crate::recording::Recording;
use crate::truth::{Case, Family, sensors};

/// Compares with `tests/snapshots/NAME.snap`.
fn compare(name: &str, text: &str) {
    let mut settings = insta::Settings::clone_current();
    settings.set_snapshot_path(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/snapshots"));
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    settings.bind(|| insta::assert_snapshot!(name, text));
}

/// What the program says on stdout and stderr, with the exit code. In arguments and answer, `DIR` stands for `folder` and
/// `PORT` for a port that another program has.
fn said(arguments: &[&str], folder: &Path) -> (i32, String, String) {
    let folder = folder.to_str().expect("UTF-8");
    let taken = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = taken.local_addr().expect("an address").to_string();
    let filled_in = |a: &&str| a.replace("DIR", folder).replace("127.0.0.1:PORT", &address);
    let arguments: Vec<String> = arguments.iter().map(filled_in).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let output = leafbench(&arguments).output().expect("the program starts");
    let text = |bytes: &[u8]| {
        let text = String::from_utf8_lossy(bytes);
        text.replace(folder, "DIR").replace(&address, "127.0.0.1:PORT")
    };
    let code = output.status.code().expect("no signal ended it");
    (code, text(&output.stdout), text(&output.stderr))
}

#[test]
fn the_help_of_every_command_is_as_recorded() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut help = String::new();
    for command in [""].into_iter().chain(crate::cli::command_names()) {
        let arguments: Vec<&str> = [command, "--help"]
            .into_iter()
            .filter(|a| !a.is_empty())
            .collect();
        let (code, stdout, stderr) = said(&arguments, folder.path());
        assert_eq!((code, stderr.as_str()), (0, ""), "{command}");
        let _ = writeln!(help, "$ leafbench {}\n{stdout}", arguments.join(" "));
    }
    compare("help", &help);
}

/// A recording with one row changed: name of the file, row (the header is row 1), what is written there.
const BAD_ROWS: [(&str, usize, &str); 6] = [
    ("kilonewtons-header.csv", 1, "time_s,displacement_mm,force_kn"),
    ("column-missing.csv", 1, "time_s,displacement_mm,force"),
    ("decimal-comma.csv", 5, "0.03,\"4,02\",1.5"),
    ("text.csv", 5, "0.03,high,1.5"),
    ("not-finite.csv", 5, "0.03,NaN,1.5"),
    ("time-falls.csv", 5, "0.01,4.02,1.5"),
];
/// A bench with one line changed: name of the file, the key, the new line.
const BAD_BENCHES: [(&str, &str, &str); 6] = [
    ("bench-mock.toml", "seed", "sed = 1"),
    ("bench-sign.toml", "sign", "sign = -1"),
    ("bench-key.toml", "force_max_n", "force_maximum_n = 3500.0"),
    ("bench-limit.toml", "force_max_n", "force_max_n = 3500000.0"),
    ("bench-address.toml", "address", "address = \"usb:0\""),
    ("bench-unit.toml", "force_max_n", "force_max_n = \"3.5 kN\""),
];
/// Name and text of profiles and tables with mistakes.
const BAD_TEXTS: [(&str, &str); 7] = [
    ("empty.csv", ""),
    (
        "profile-kind.toml",
        "name = \"profile-kind\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp up\"\n",
    ),
    (
        "profile-limit.toml",
        "name = \"profile-limit\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\n\
         to_mm = 400.0\nduration_s = 20.0\n",
    ),
    ("table-header.csv", "mount,amplitude_mm\nshackle,6\n"),
    (
        "table-number.csv",
        "mount,amplitude_mm,frequency_hz,peak_force_n,loop_energy_j\nshackle,6,1,688,0.665\nshackle,10,1,high,1.6\n",
    ),
    (
        "table-unit.csv",
        "mount,amplitude_mm,frequency_hz,peak_force_n,loop_energy_j\nshackle,6,1,688,0.665\nshackle,10,1,-1028,1.6\n",
    ),
    (
        "table-few.csv",
        "mount,amplitude_mm,frequency_hz,peak_force_n,loop_energy_j\nshackle,6,1,688,0.665\n",
    ),
];
/// What a technician does wrong. `DIR` is the folder with the files above.
const MISTAKES: [&[&str]; 41] = [
    &["fly"],
    &["run"],
    &["run", "static-ramp", "--data", "DIR/data"],
    &["status", "--data", "DIR/data"],
    &["daemon", "--listen", "0.0.0.0:80", "--data", "DIR/data"],
    &["daemon", "--listen", "127.0.0.1:PORT", "--data", "DIR/daemon"],
    &["mock-rig", "--link", "serial:DIR/no-such-port"],
    &["mock-rig", "--link", "can:can7"],
    &["export", "latest", "--data", "DIR/data"],
    &["export", "no-such-run", "--data", "DIR/data"],
    &["export", "DIR/empty.csv"],
    &["plan", "no-such-profile"],
    &["plan", "DIR/profile-kind.toml"],
    &["plan", "DIR/profile-limit.toml"],
    &["plan", "static-ramp", "--bench", "DIR/no-such-bench.toml"],
    &["plan", "static-ramp", "--bench", "DIR/bench-key.toml"],
    &["plan", "static-ramp", "--bench", "DIR/bench-limit.toml"],
    &["plan", "static-ramp", "--bench", "DIR/bench-address.toml"],
    &["plan", "static-ramp", "--bench", "DIR/bench-unit.toml"],
    &["plan", "static-ramp", "--bench", "DIR/bench-sign.toml"],
    &["plan", "static-ramp", "--bench", "DIR/bench-mock.toml"],
    &["plan", "static-ramp", "--bench", "/dev/zero"],
    &["simulate", "static-ramp-12s", "--out", "DIR/no-such-folder/a.csv"],
    &["identify", "--model", "equivalent"],
    &["identify", "DIR/good.csv"],
    &["identify", "--model", "wobble", "DIR/good.csv"],
    &[
        "identify",
        "--model",
        "equivalent",
        "--fix",
        "rate",
        "DIR/good.csv",
    ],
    &[
        "identify",
        "--model",
        "equivalent",
        "--fix",
        "rte=3",
        "DIR/good.csv",
    ],
    &["diagnose", "DIR/no-such-recording.csv"],
    &["diagnose", "DIR/pipe.csv"],
    &["diagnose", "DIR/empty.csv"],
    &["diagnose", "DIR/short.csv"],
    &["diagnose", "DIR/metres.csv"],
    &["diagnose", "DIR/kilonewtons.csv"],
    &["diagnose", "--known", "magnetism", "DIR/good.csv"],
    &["diagnose", "--baseline", "rubber", "DIR/good.csv"],
    &["diagnose", "--targets", "DIR/table-header.csv"],
    &["diagnose", "--targets", "DIR/table-number.csv"],
    &["diagnose", "--targets", "DIR/table-unit.csv"],
    &["diagnose", "--targets", "DIR/table-few.csv"],
    &["diagnose", "--run-next", "--data", "DIR/data", "DIR/good.csv"],
];

/// Loops of a spring as CSV, with the columns multiplied.
fn loops(samples: i32, per_mm: f64, per_n: f64) -> String {
    let mut text = "time_s,displacement_mm,force_n\n".to_owned();
    for k in 0..samples {
        let phase = std::f64::consts::TAU * f64::from(k) / 100.0;
        let mm = 10.0 - 6.0 * phase.cos();
        let n = 800.0 - 480.0 * phase.cos() + 60.0 * phase.sin();
        let _ = writeln!(text, "{:.2},{},{}", f64::from(k) * 0.01, mm * per_mm, n * per_n);
    }
    text
}

fn with_line(text: &str, number: usize, line: &str) -> String {
    let mut lines: Vec<&str> = text.lines().collect();
    lines[number - 1] = line;
    lines.join("\n")
}

/// Writes the files with mistakes.
fn write_mistakes(folder: &Path) {
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).expect("written");
    let good = loops(600, 1.0, 1.0);
    write("good.csv", &good);
    nix::unistd::mkfifo(&folder.join("pipe.csv"), nix::sys::stat::Mode::S_IRWXU).expect("made");
    write("short.csv", &loops(10, 1.0, 1.0));
    write("metres.csv", &loops(600, 1e-3, 1.0));
    write("kilonewtons.csv", &loops(600, 1.0, 1e-3));
    for (name, row, line) in BAD_ROWS {
        write(name, &with_line(&good, row, line));
    }
    let bench = std::fs::read_to_string(config("benches/mock.toml")).expect("shipped");
    let specimen = "samurai-front-equivalent.toml";
    std::fs::copy(config("specimens").join(specimen), folder.join(specimen)).expect("shipped");
    let bench = bench.replace("../specimens/", "");
    for (name, key, line) in BAD_BENCHES {
        let starts = format!("{key} = ");
        let at = bench.lines().position(|l| l.starts_with(&starts));
        write(
            name,
            &with_line(&bench, 1 + at.expect("the key is shipped"), line),
        );
    }
    for (name, text) in BAD_TEXTS {
        write(name, text);
    }
}

#[test]
fn the_errors_of_a_technician_are_as_recorded() {
    let folder = tempfile::tempdir().expect("a folder");
    write_mistakes(folder.path());
    let rows = BAD_ROWS.map(|(name, ..)| format!("DIR/{name}"));
    let rows = rows.iter().map(|path| vec!["diagnose", path]);
    let mut errors = String::new();
    for line in MISTAKES.iter().map(|line| line.to_vec()).chain(rows) {
        let shown = line.join(" ");
        let (code, stdout, stderr) = said(&line, folder.path());
        assert_ne!(code, 0, "{shown}: {stdout}");
        let answer = stdout + &stderr;
        let _ = writeln!(errors, "$ leafbench {shown}\n{}\n", answer.trim_end());
    }
    compare("errors", &errors);
}

/// A page without its tags and style: one line for each text, but none for a text without letters.
fn without_tags(page: &str) -> String {
    let body = page.split_once("</style>").map_or(page, |(_, body)| body);
    let texts = body
        .split('<')
        .map(|part| part.split_once('>').map_or(part, |(_, text)| text));
    let texts = texts.flat_map(str::lines).map(str::trim);
    let texts: Vec<&str> = texts.filter(|t| t.contains(char::is_alphabetic)).collect();
    texts.join("\n")
}

/// Every number, with its sign, point and exponent, becomes `#`.
fn without_numbers(text: &str) -> String {
    let mut words = String::new();
    let mut rest = text.chars().peekable();
    while let Some(c) = rest.next() {
        let starts_word = !words.ends_with(|w: char| w.is_alphanumeric() || "_#".contains(w));
        let signed = starts_word && "+-\u{2212}".contains(c) && rest.peek().is_some_and(char::is_ascii_digit);
        if !c.is_ascii_digit() && !signed {
            words.push(c);
            continue;
        }
        let mut before = c;
        while let Some(next) = rest.peek().copied() {
            let exponent = next == 'e' && before.is_ascii_digit();
            let continues =
                next.is_ascii_digit() || next == '.' || exponent || (next == '-' && before == 'e');
            if !continues {
                break;
            }
            before = next;
            rest.next();
        }
        words.push('#');
        // The full stop of a sentence, and the letter of a unit, are no part of the number.
        if before == '.' || before == 'e' {
            words.push(before);
        }
    }
    words
}

#[test]
fn numbers_become_number_signs_and_words_stay() {
    for (text, wanted) in [
        ("peak 1.5e-3 N, -4 mm.", "peak # N, # mm."),
        ("at 9 mm. Then 3.", "at # mm. Then #."),
        ("case-0001-2.csv", "case-#-#.csv"),
        ("3 e", "# e"),
    ] {
        assert_eq!(without_numbers(text), wanted);
    }
    assert_eq!(
        without_tags("<style>a {}</style><p>b <i>c</i></p><td>12</td>"),
        "b\nc"
    );
    assert_eq!(
        without_candidates(
            "a\nAdded to the baseline\ngain\nheld out\ninertia\nbacklash\n# more are in a file.\nb"
        ),
        "a\nAdded to the baseline\ngain\nheld out\nCANDIDATES\n# more are in a file.\nb"
    );
    assert_eq!(
        without_nearest(
            "or run_in instead of unknown: near\nor inertia instead of unknown: near\nrun in\nunknown\nnear\ntest\ninertia\nunknown\nnear\ntest\nb\nb"
        ),
        "or EFFECT instead of unknown: near\nEFFECT\nunknown\nnear\ntest\nb\nb"
    );
}

/// The rows of the table of candidates become one word. Which of two equally good sets comes first depends on the last bit of the
/// arithmetic, and that differs between processors.
fn without_candidates(words: &str) -> String {
    let head = "\nAdded to the baseline\ngain\nheld out\n";
    let Some((before, after)) = words.split_once(head) else {
        return words.to_owned();
    };
    let rows = after
        .lines()
        .take_while(|l| *l != "Parameters" && !l.contains("more are in"));
    let length: usize = rows.map(|row| row.len() + 1).sum();
    assert!(length > 0, "a table without rows: {words}");
    format!("{before}{head}CANDIDATES\n{}", &after[length..])
}

/// The nearest effects of an unexplained difference become one, on the terminal and in the report's table, for the same reason.
fn without_nearest(words: &str) -> String {
    let lines: Vec<&str> = words.lines().collect();
    let named = |(i, line): (usize, &&str)| {
        if lines.get(i + 1) == Some(&"unknown") {
            return "EFFECT".to_owned();
        }
        let nearest = line
            .strip_prefix("or ")
            .and_then(|l| l.split_once(" instead of unknown"));
        nearest.map_or((*line).to_owned(), |(_, why)| {
            format!("or EFFECT instead of unknown{why}")
        })
    };
    let mut kept: Vec<String> = Vec::new();
    for line in lines.iter().enumerate().map(named) {
        kept.push(line);
        // A line of the terminal, or a row of four cells, that is the same as the one before.
        for (length, starts) in [(1, "or EFFECT"), (4, "EFFECT")] {
            let from = kept.len().saturating_sub(length);
            let repeated = kept[..from].ends_with(&kept[from..]);
            if repeated && kept[from].starts_with(starts) {
                kept.truncate(from);
            }
        }
    }
    kept.join("\n")
}

/// True for a SHA-256 in hex.
fn is_hash(text: &str) -> bool {
    text.len() == 64 && text.chars().all(|c| c.is_ascii_hexdigit())
}

/// The terminal's text and the words of the report after a command.
fn reported(arguments: &[&str], folder: &Path) -> String {
    let (code, stdout, stderr) = said(arguments, folder);
    assert_eq!(code, 0, "{stderr}");
    let page = std::fs::read_to_string(folder.join("out/report.html")).expect("written");
    let words = format!(
        "=== terminal\n{}\n\n=== report.html\n{}\n",
        stdout.trim_end(),
        without_tags(&page)
            .replace(folder.to_str().expect("UTF-8"), "DIR")
            .lines()
            .map(|line| if is_hash(line) { "HASH" } else { line })
            .collect::<Vec<_>>()
            .join("\n")
    );
    // Runs of blanks depend on the width of numbers.
    let words = without_candidates(&without_numbers(&words));
    let lines = words
        .lines()
        .map(|l| l.split_whitespace().collect::<Vec<_>>().join(" "));
    without_nearest(&lines.collect::<Vec<_>>().join("\n"))
}

/// Diagnoses the first recordings of a case, of each only every `every`th sample.
fn diagnosed(case: &Case, recordings: usize, every: usize) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    let mut paths = Vec::new();
    for recording in case.recordings.iter().take(recordings) {
        let kept = |column: &[f64]| column.iter().copied().step_by(every).collect::<Vec<f64>>();
        let thinned = Recording {
            time_s: kept(&recording.time_s),
            displacement_mm: kept(&recording.displacement_mm),
            force_n: kept(&recording.force_n),
            ..recording.clone()
        };
        let path: PathBuf = folder.path().join(&recording.name);
        std::fs::write(&path, sensors::csv(&thinned)).expect("written");
        paths.push(path.to_str().expect("UTF-8").to_owned());
    }
    let mut arguments = vec!["diagnose", "--out", "DIR/out"];
    arguments.extend(paths.iter().map(String::as_str));
    let words = reported(&arguments, folder.path());
    let page = std::fs::read_to_string(folder.path().join("out/report.html")).expect("written");
    for path in &paths {
        let hash = Sha256::digest(std::fs::read(path).expect("written"));
        let hash: String = hash.iter().map(|byte| format!("{byte:02x}")).collect();
        assert!(page.contains(&hash), "the report has no hash of {path}");
    }
    words
}

#[test]
fn the_words_of_a_named_effect_are_as_recorded() {
    let case = Case::single("progressive_stiffness", 2, 40.0).expect("visible");
    let words = diagnosed(&case, 2, 3);
    assert!(
        words.contains("MISSING PHYSICS: "),
        "choose another case: {words}"
    );
    compare("diagnosis-named", &words);
}

#[test]
fn the_words_of_unexplained_physics_are_as_recorded() {
    let case = Case::hiding(Family::Outside, &["local_friction"], 31, 10.0).expect("visible");
    let words = diagnosed(&case, 2, 2);
    assert!(words.contains("UNEXPLAINED: "), "choose another case: {words}");
    compare("diagnosis-unexplained", &words);
}

#[test]
fn the_words_of_an_adequate_model_are_as_recorded() {
    let case = Case::hiding(Family::None, &[], 1, 0.0).expect("nothing hidden needs no size");
    let words = diagnosed(&case, 2, 2);
    assert!(words.contains("ADEQUATE: "), "choose another case: {words}");
    compare("diagnosis-adequate", &words);
}

#[test]
fn the_words_of_a_diagnosis_of_tables_are_as_recorded() {
    let folder = tempfile::tempdir().expect("a folder");
    let static_table = "tests/tables/p000_table2_static.csv";
    let dynamic_table = "tests/tables/p000_table3_dynamic.csv";
    let bench = "bench-configs/benches/mock.toml";
    let arguments = [
        "diagnose",
        "--targets",
        static_table,
        dynamic_table,
        "--bench",
        bench,
    ];
    let arguments = [&arguments[..], &["--out", "DIR/out"]].concat();
    compare("diagnosis-targets", &reported(&arguments, folder.path()));
}
