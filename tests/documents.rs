//! The documents are held against the program: every key of docs/profiles-and-benches.md with its default, range and unit,
//! and the columns and flags of docs/formats.md.
//!
//! The keys of a parser are taken from its own error for an unknown key, so that there is no second list of them here.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::calibration::CalibrationFile;
use crate::config::{Bench, Specimen};
use crate::effect::{EFFECTS, FORMS};
use crate::mockrig::MockRigConfig;
use crate::model::leaf_pack::PackStructure;
use crate::model::{MODELS, Model, Parameter};
use crate::profile::{Profile, Segment};
use crate::recording::csv::CsvFormat;
use crate::recording::cycles::CYCLE_COLUMNS;
use crate::recording::run_file::{RunFile, RunFileWriter, test_support};
use crate::recording::{Event, EventKind, Flags, Recorder};
use crate::units::Mode;

/// A key that no table has.
const UNKNOWN: &str = "zz_unknown";
const COLUMNS: &str = "| key | unit | range | default | what it is |";
const PROFILE_HEAD: &str = "name = \"p\"\ncontrol = \"displacement\"\n[[block]]\n";

/// One row of a table in the document.
struct DocumentedKey {
    key: String,
    unit: String,
    range: String,
    default: String,
}

/// What the parser of one table says about itself.
#[derive(Default)]
struct ParsedTable {
    keys: Vec<String>,
    defaults: toml::Table,
}

fn document() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/profiles-and-benches.md");
    std::fs::read_to_string(path).expect("the document is in the repository")
}

/// The tables with the five columns, by the heading before them.
fn documented(text: &str) -> BTreeMap<String, Vec<DocumentedKey>> {
    let mut tables: BTreeMap<String, Vec<DocumentedKey>> = BTreeMap::new();
    let (mut heading, mut in_table) = ("", false);
    for line in text.lines() {
        if let Some(title) = line.strip_prefix("### ") {
            heading = title;
        }
        in_table = line == COLUMNS || (in_table && line.starts_with('|'));
        if in_table && line.starts_with("| `") {
            let cells: Vec<&str> = line.split('|').map(str::trim).collect();
            let cell = |i: usize| cells.get(i).copied().unwrap_or_default().to_owned();
            tables.entry(heading.to_owned()).or_default().push(DocumentedKey {
                key: cell(1).trim_matches('`').to_owned(),
                unit: cell(2),
                range: cell(3),
                default: cell(4),
            });
        }
    }
    tables
}

/// The keys in an error such as "unknown field `x`, expected one of `a`, `b`" or "key "x" is unknown: use one of a, b".
fn keys_in(error: &dyn std::fmt::Display) -> Vec<String> {
    let error = error.to_string();
    assert!(
        error.contains(UNKNOWN),
        "not an error about an unknown key: {error}"
    );
    match error.split_once("expected ") {
        Some((_, list)) => list.split('`').skip(1).step_by(2).map(str::to_owned).collect(),
        None => {
            let (_, list) = error.split_once(": use one of ").expect("a list of keys");
            list.split(", ").map(str::to_owned).collect()
        }
    }
}

fn table_of(value: impl serde::Serialize) -> toml::Table {
    toml::Table::try_from(value).expect("a table")
}

/// The text with an unknown key after the header of a table.
fn with_unknown(text: &str, header: &str) -> String {
    assert!(text.contains(&format!("{header}\n")), "{header}");
    text.replacen(&format!("{header}\n"), &format!("{header}\n{UNKNOWN} = 0\n"), 1)
}

fn without_key(text: &str, key: &str) -> String {
    let kept = text.lines().filter(|l| !l.starts_with(&format!("{key} = ")));
    kept.collect::<Vec<_>>().join("\n")
}

fn add(
    tables: &mut BTreeMap<String, ParsedTable>,
    heading: &str,
    error: &dyn std::fmt::Display,
    defaults: toml::Table,
) {
    let keys = keys_in(error);
    tables.insert(heading.to_owned(), ParsedTable { keys, defaults });
}

fn add_profile(tables: &mut BTreeMap<String, ParsedTable>) {
    let refused = |text: &str| Profile::from_toml(text, "p").expect_err("an unknown key");
    let sine = "kind = \"sine\"\nmean_mm = 0.0\namplitude_mm = 1.0\nfrequency_hz = 1.0\ncycles = 1\n";
    let text = format!("{PROFILE_HEAD}[[block.segment]]\n{sine}");
    let plain = Profile::from_toml(&text, "p").expect("a profile");
    let Segment::Cycles(cycles) = &plain.blocks[0].segments[0] else {
        panic!("{plain:?}")
    };
    let top = table_of(BTreeMap::from([("description", &plain.description)]));
    add(tables, "profile", &refused(&format!("{UNKNOWN} = 0\n")), top);
    let block = table_of(BTreeMap::from([("repeat", plain.blocks[0].repeat)]));
    let error = refused(&format!("{PROFILE_HEAD}{UNKNOWN} = 0\n"));
    add(tables, "profile [[block]]", &error, block);
    let segment = table_of(BTreeMap::from([("correct", cycles.correct)]));
    let error = refused(&format!("{PROFILE_HEAD}[[block.segment]]\n{UNKNOWN} = 0\n"));
    add(tables, "profile [[block.segment]]", &error, segment);
    let error = refused(&format!("{PROFILE_HEAD}[[accept]]\n{UNKNOWN} = 0\n"));
    add(tables, "profile [[accept]]", &error, toml::Table::new());
}

fn add_bench(tables: &mut BTreeMap<String, ParsedTable>) {
    let text = Bench::shipped().expect("shipped").to_toml();
    let mut bare = text.clone();
    for key in ["queue_lead_ms", "silence_ms", "model_mismatch", "source"] {
        assert!(bare.contains(&format!("\n{key} = ")), "{key}");
        bare = without_key(&bare, key);
    }
    let plain = Bench::parse(&bare, "bench").expect("these keys have defaults");
    let refused = |text: String| Bench::parse(&text, "bench").expect_err("an unknown key");
    let error = refused(format!("{UNKNOWN} = 0\n{text}"));
    add(tables, "bench", &error, toml::Table::new());
    for (heading, defaults) in [
        ("[link]", table_of(&plain.link)),
        ("[force_channel]", toml::Table::new()),
        ("[displacement_channel]", toml::Table::new()),
        ("[limits]", toml::Table::new()),
        ("[daemon]", table_of(&plain.daemon)),
        ("[specimen]", table_of(&plain.specimen)),
    ] {
        let error = refused(with_unknown(&text, heading));
        add(tables, heading, &error, defaults);
    }
}

/// A law without an effect in it.
const LAW: &str = "[model.law]\naxis = \"displacement_mm\"\nopposes_motion = false\nper_load = false\nat = [0.0, 1.0]\nforce = [0.0, 1.0]\n";

fn add_specimen(tables: &mut BTreeMap<String, ParsedTable>) {
    let refused = |text: String| Specimen::parse(&text, "specimen").expect_err("an unknown key");
    let text = "name = \"s\"\n[model]\nname = \"equivalent\"\n[[model.effect]]\ncode = \"backlash\"\n";
    let plain = Specimen::parse(text, "specimen").expect("a specimen");
    let error = refused(format!("{UNKNOWN} = 0\n{text}"));
    add(tables, "specimen", &error, table_of(&plain));
    let with_law = format!("{text}{LAW}");
    for heading in ["[model]", "[[model.effect]]", "[model.law]"] {
        let error = refused(with_unknown(&with_law, heading));
        add(tables, heading, &error, toml::Table::new());
    }
}

/// The keys of both kinds of sensors are in one table.
fn add_calibration(tables: &mut BTreeMap<String, ParsedTable>) {
    let refused = |text: String| toml::from_str::<CalibrationFile>(&text).expect_err("an unknown key");
    let error = refused(format!("{UNKNOWN} = 0\n"));
    add(tables, "calibration", &error, toml::Table::new());
    let error = refused(format!("[[point]]\n{UNKNOWN} = 0\n"));
    add(tables, "calibration [[point]]", &error, toml::Table::new());
}

fn add_mock_rig(tables: &mut BTreeMap<String, ParsedTable>) {
    let refused = |text: &str| toml::from_str::<MockRigConfig>(text).expect_err("an unknown key");
    let defaults = table_of(MockRigConfig::default());
    for (key, inner) in defaults.iter().filter_map(|(k, v)| Some((k, v.as_table()?))) {
        let error = refused(&format!("[{key}]\n{UNKNOWN} = 0\n"));
        add(tables, &format!("[mock_rig.{key}]"), &error, inner.clone());
    }
    let error = refused(&format!("{UNKNOWN} = 0\n"));
    add(tables, "[mock_rig]", &error, defaults);
}

fn structure_error(model: &Model, structure: &toml::Table) -> String {
    match model.plant(&model.start_values(), structure) {
        Ok(_) => panic!("{} accepts an unknown key", model.name),
        Err(error) => error.to_string(),
    }
}

fn add_structures(tables: &mut BTreeMap<String, ParsedTable>) {
    let unknown = toml::Table::from_iter([(UNKNOWN.to_owned(), toml::Value::Integer(0))]);
    for model in MODELS {
        let defaults = match model.name {
            "leaf-pack" => table_of(PackStructure::default()),
            _ => toml::Table::new(),
        };
        let error = structure_error(model, &unknown);
        let heading = format!("[model.structure] {}", model.name);
        add(tables, &heading, &error, defaults);
        if model.name == "leaf-pack" {
            let leaves = toml::Value::Array(vec![toml::Value::Table(unknown.clone())]);
            let error = structure_error(model, &toml::Table::from_iter([("leaves".to_owned(), leaves)]));
            let heading = "[[model.structure.leaves]] leaf-pack";
            add(tables, heading, &error, toml::Table::new());
        }
    }
}

/// Parameters of all models and effects, by their heading.
fn parameters() -> BTreeMap<String, &'static [Parameter]> {
    let models = MODELS
        .iter()
        .map(|m| (format!("[model.parameters] {}", m.name), m.parameters));
    let effects = EFFECTS
        .iter()
        .chain(FORMS)
        .map(|e| (format!("[model.effect.parameters] {}", e.code), e.parameters));
    models.chain(effects).collect()
}

fn parsed() -> BTreeMap<String, ParsedTable> {
    let mut tables = BTreeMap::new();
    add_profile(&mut tables);
    add_bench(&mut tables);
    add_specimen(&mut tables);
    add_calibration(&mut tables);
    add_mock_rig(&mut tables);
    add_structures(&mut tables);
    for (heading, parameters) in parameters() {
        let starts = parameters.iter().map(|p| (p.name, p.start));
        let table = ParsedTable {
            keys: parameters.iter().map(|p| p.name.to_owned()).collect(),
            defaults: table_of(starts.collect::<BTreeMap<_, _>>()),
        };
        tables.insert(heading, table);
    }
    tables
}

/// A default that is written as a value; `None` for "required" and for a default in words.
fn value_of(default: &str) -> Option<toml::Value> {
    let number = default.parse::<f64>().ok().map(toml::Value::Float);
    number.or_else(|| {
        let text = format!("x = {default}");
        let value = text.parse::<toml::Table>().ok()?.remove("x")?;
        (value.is_str() || value.is_bool()).then_some(value)
    })
}

fn same(a: &toml::Value, b: &toml::Value) -> bool {
    let number = |v: &toml::Value| v.as_float().or_else(|| v.as_integer().map(|i| i as f64));
    match (number(a), number(b)) {
        (Some(a), Some(b)) => a == b,
        _ => a == b,
    }
}

/// Rows of a document's tables whose first cell is this code.
fn rows_of(page: &str, code: &str) -> usize {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs").join(page);
    let text = std::fs::read_to_string(path).expect("the document is in the repository");
    let start = format!("| `{code}` |");
    text.lines().filter(|line| line.starts_with(&start)).count()
}

#[test]
fn every_effect_is_in_the_tables_of_the_documents() {
    // Codes; equations and bounds; codes of a config file.
    let wanted = [
        ("formats.md", 1),
        ("models.md", 2),
        ("profiles-and-benches.md", 1),
    ];
    let mut missing = Vec::new();
    for effect in EFFECTS {
        for (page, tables) in wanted {
            if rows_of(page, effect.code) < tables {
                missing.push(format!("docs/{page}: {} needs {tables} table rows", effect.code));
            }
        }
    }
    assert!(missing.is_empty(), "{}", missing.join("\n"));
}

#[test]
fn every_key_of_a_parser_is_documented_and_every_documented_key_is_accepted() {
    let (documented, parsed) = (documented(&document()), parsed());
    let mut wrong = Vec::new();
    for (heading, rows) in &documented {
        match parsed.get(heading) {
            None => wrong.push(format!("\"{heading}\": no parser reads this table")),
            Some(table) => {
                let refused = rows.iter().filter(|r| !table.keys.contains(&r.key));
                wrong.extend(refused.map(|r| format!("\"{heading}\": the parser refuses {}", r.key)));
                let missing = table.keys.iter().filter(|k| rows.iter().all(|r| r.key != **k));
                wrong.extend(missing.map(|k| format!("\"{heading}\": {k} is not documented")));
            }
        }
    }
    let absent = parsed.keys().filter(|h| !documented.contains_key(*h));
    wrong.extend(absent.map(|h| format!("\"{h}\": the table is not documented")));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn documented_defaults_are_those_of_the_parsers() {
    let parsed = parsed();
    let (mut compared, mut wrong) = (0, Vec::new());
    for (heading, rows) in documented(&document()) {
        let Some(table) = parsed.get(&heading) else {
            continue;
        };
        for row in &rows {
            if let (Some(said), Some(found)) = (value_of(&row.default), table.defaults.get(&row.key)) {
                compared += 1;
                if !same(&said, found) {
                    wrong.push(format!(
                        "\"{heading}\": {} = {said}, the parser's default is {found}",
                        row.key
                    ));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(compared > 100, "only {compared} defaults were compared");
}

/// Defaults inside a model cannot be read: the model with the documented value must give the same forces as without it.
#[test]
fn documented_defaults_of_a_structure_change_nothing() {
    let documented = documented(&document());
    let mut compared = 0;
    for model in MODELS.iter().filter(|m| m.name != "leaf-pack") {
        let forces = |structure: &toml::Table| -> Vec<f64> {
            let mut plant = model
                .plant(&model.start_values(), structure)
                .unwrap_or_else(|e| panic!("{e}"));
            let path = (0..200).map(|i| 20.0 - 20.0 * (f64::from(i) * 0.05).cos());
            path.map(|x| plant.step(x, 0.01)).collect()
        };
        let plain = forces(&toml::Table::new());
        for row in &documented[&format!("[model.structure] {}", model.name)] {
            let value = value_of(&row.default).expect("every key has a default");
            let with = forces(&toml::Table::from_iter([(row.key.clone(), value)]));
            assert!(
                plain == with,
                "\"[model.structure] {}\": {} = {} is not the default",
                model.name,
                row.key,
                row.default
            );
            compared += 1;
        }
    }
    assert!(compared >= 14, "only {compared} defaults were compared");
}

#[test]
fn documented_ranges_and_units_of_parameters_are_those_of_the_models() {
    let documented = documented(&document());
    let mut wrong = Vec::new();
    for (heading, parameters) in parameters() {
        for p in parameters {
            let Some(row) = documented
                .get(&heading)
                .and_then(|rows| rows.iter().find(|r| r.key == p.name))
            else {
                continue;
            };
            let bounds = row
                .range
                .split_once(" to ")
                .and_then(|(a, b)| Some([a.parse::<f64>().ok()?, b.parse().ok()?]));
            if bounds != Some(p.bounds) {
                wrong.push(format!(
                    "\"{heading}\": {} is {}, the bounds are {:?}",
                    p.name, row.range, p.bounds
                ));
            }
            let unit = if p.unit.is_empty() { "-" } else { p.unit };
            if row.unit != unit {
                wrong.push(format!(
                    "\"{heading}\": {} is in {}, the model has {unit}",
                    p.name, row.unit
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_documented_taper_is_that_of_the_parser() {
    let taper = |kind: &str| {
        let text = format!(
            "{PROFILE_HEAD}[[block.segment]]\nkind = \"{kind}\"\nmean_mm = 0.0\namplitude_mm = 1.0\nfrequency_hz = 1.0\n\
             cycles = 1\n"
        );
        match &Profile::from_toml(&text, "p").expect("a profile").blocks[0].segments[0] {
            Segment::Cycles(cycles) => cycles.taper_cycles,
            other => panic!("{other:?}"),
        }
    };
    let rows = &documented(&document())["profile [[block.segment]]"];
    let row = rows.iter().find(|r| r.key == "taper_cycles").expect("documented");
    assert_eq!(
        row.default,
        format!("{} (sine), {} (triangle)", taper("sine"), taper("triangle"))
    );
}

#[test]
fn every_example_is_accepted() {
    let text = document();
    let examples: Vec<&str> = text
        .split("```toml\n")
        .skip(1)
        .filter_map(|s| s.split("```").next())
        .collect();
    assert!(examples.len() >= 3, "{} examples", examples.len());
    for example in examples {
        let refused = if example.contains("\ncontrol = ") {
            Profile::from_toml(example, "example")
                .err()
                .map(|e| e.to_string())
        } else if example.contains("\n[limits]") {
            Bench::parse(example, "example").err().map(|e| e.to_string())
        } else {
            Specimen::parse(example, "example").err().map(|e| e.to_string())
        };
        assert_eq!(refused, None, "{example}");
    }
}

/// First cells of the first table after a heading of docs/formats.md.
fn first_cells(heading: &str) -> Vec<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/formats.md");
    let text = std::fs::read_to_string(path).expect("the document is in the repository");
    let section = text.lines().skip_while(|l| *l != heading);
    let table = section
        .skip_while(|l| !l.starts_with('|'))
        .take_while(|l| l.starts_with('|'));
    table
        .skip(2)
        .flat_map(|row| row.split('|').nth(1).unwrap_or_default().split(','))
        .map(|cell| cell.trim().trim_matches('`').to_owned())
        .collect()
}

#[test]
fn documented_columns_are_those_that_are_written() {
    let format = CsvFormat {
        time_decimals: 3,
        displacement_decimals: 4,
        force_decimals: 2,
        command_modes: vec![Mode::Displacement, Mode::Force],
    };
    assert_eq!(first_cells("## Recording CSV"), format.columns());
    assert_eq!(first_cells("## Cycles CSV"), CYCLE_COLUMNS);
}

/// Python's own tests need its package built; this one tells of a forgotten field at once.
#[test]
fn documented_fields_of_a_diagnosis_are_those_of_the_python_package() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("python/package/leafbench/_diagnosis.py");
    let text = std::fs::read_to_string(path).expect("the package is in the repository");
    let of_class = text.lines().skip_while(|l| *l != "class Diagnosis:").skip(1);
    let fields: BTreeSet<&str> = of_class
        .take_while(|l| !l.starts_with("    def "))
        .filter_map(|l| l.strip_prefix("    ")?.split_once(": "))
        .map(|(field, _)| field)
        .filter(|f| f.chars().all(|c| c.is_ascii_lowercase() || c == '_'))
        .filter(|f| !["json", "improved_toml"].contains(f))
        .collect();
    let cells = first_cells("### `diagnosis.json`");
    let documented: BTreeSet<&str> = cells
        .iter()
        .map(|cell| cell.split(['.', '[']).next().unwrap_or_default())
        .filter(|key| !key.is_empty())
        .collect();
    assert_eq!(documented, fields);
}

#[test]
fn documented_flags_are_those_of_a_sample() {
    let bits: Vec<String> = Flags::all().iter().map(|f| f.bits().to_string()).collect();
    assert_eq!(first_cells("### Flags"), bits);
}

/// The queries of docs/formats.md: what stands in quotes after `sqlite3 ... RUN.leafrun`.
fn documented_queries() -> Vec<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/formats.md");
    let text = std::fs::read_to_string(path).expect("the document is in the repository");
    let quoted = text.split("RUN.leafrun \"").skip(1);
    let queries = quoted.map(|rest| rest.split('"').next().unwrap_or_default().to_owned());
    queries.collect()
}

/// A run of 1300 samples in a file in `folder`; the texts have quotes and umlauts.
fn written_run(folder: &Path) -> RunFile {
    let path = folder.join("run.leafrun");
    let mut writer = RunFileWriter::create(&path, &test_support::header()).expect("created");
    for tick in 40_000..41_300 {
        writer.sample(&test_support::sample(tick));
    }
    writer.event(&Event {
        tick: 40_003,
        time_s: 0.003,
        kind: EventKind::RigState,
        text: "\"läuft\"".to_owned(),
    });
    writer.end(&test_support::outcome(1300));
    RunFile::open(&path).expect("a run file")
}

#[test]
fn documented_queries_print_what_is_in_a_run_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = written_run(folder.path());
    let database = rusqlite::Connection::open(run.path()).expect("a database");
    let queries = documented_queries();
    let [summary, calibration, profile, events, samples] = queries.as_slice() else {
        panic!("five queries, not {}: {queries:?}", queries.len())
    };
    let header = run.header();
    let row = database.query_row(summary, [], |row| {
        Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?))
    });
    let wanted = (header.specimen.clone(), "completed".to_owned(), 1300, 1300);
    assert_eq!(row, Ok(wanted));
    let row = database.query_row(calibration, [], |row| Ok([row.get(0)?, row.get(1)?, row.get(2)?]));
    let force = header.force_channel;
    assert_eq!(row, Ok([force.scale_per_count, force.offset, force.tare]));
    let row = database.query_row(profile, [], |row| row.get(0));
    assert_eq!(row, Ok(header.profile_toml.clone()));
    let row = database.query_row(events, [], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)));
    assert_eq!(row, Ok((0.003, "rig_state".to_owned(), "\"läuft\"".to_owned())));
    let mut statement = database.prepare(samples).expect("a query that SQLite accepts");
    let rows = statement.query_map([], |row| Ok([row.get(0)?, row.get(1)?, row.get(2)?]));
    let rows: Vec<[f64; 3]> = rows.expect("rows").map(|row| row.expect("numbers")).collect();
    assert_eq!(rows.len(), 1300);
    for (row, s) in rows.iter().zip(run.samples()) {
        for (found, wanted) in row.iter().zip([s.time_s, s.displacement_mm, s.force_n]) {
            // SQLite reads the text of a number in the header to the last bit or the one before.
            assert!(
                (found - wanted).abs() <= 1e-12 * wanted.abs().max(1.0),
                "{row:?} {s:?}"
            );
        }
    }
    assert!(rows.iter().any(|[_, x_mm, _]| *x_mm < 0.0), "negative counts too");
}

/// All Rust sources below a folder, one after the other.
fn sources(folder: &Path) -> String {
    let entries = std::fs::read_dir(folder).expect("a folder of the repository");
    let mut text = String::new();
    for path in entries.map(|entry| entry.expect("an entry").path()) {
        if path.is_dir() {
            text += &sources(&path);
        } else if path.extension().is_some_and(|e| e == "rs") {
            text += &std::fs::read_to_string(&path).expect("a source");
        }
    }
    text
}

#[test]
fn the_tests_that_the_fault_matrix_names_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let code = sources(&root.join("src")) + &sources(&root.join("tests"));
    let text =
        std::fs::read_to_string(root.join("docs/faults.md")).expect("the document is in the repository");
    let rows = text.lines().filter(|line| line.starts_with('|'));
    let names = rows.flat_map(|row| row.split('`').skip(1).step_by(2));
    // Keys and causes have fewer parts than the name of a test.
    let tests: Vec<&str> = names.filter(|name| name.matches('_').count() >= 4).collect();
    assert!(tests.len() > 60, "{} names of tests", tests.len());
    let missing: Vec<&&str> = tests
        .iter()
        .filter(|name| !code.contains(&format!("fn {name}(")))
        .collect();
    assert!(missing.is_empty(), "no such tests: {missing:?}");
}
