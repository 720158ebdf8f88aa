//! Files as other programs write them, each read to the same eight samples.

use std::path::Path;

use super::super::csv;
use super::text::TextEncoding;
use super::*;
use crate::regular_file;

const DISPLACEMENT_MM: [f64; 8] = [0.0, 1.25, 2.5, 3.75, 5.0, 3.75, 2.5, 1.25];
const FORCE_N: [f64; 8] = [10.0, 115.5, 221.0, 326.5, 1432.0, 300.25, 190.0, 80.0];

fn file(name: &str) -> Vec<u8> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recordings/foreign");
    regular_file::read(&folder.join(name), IMPORT_MAX_BYTES).unwrap()
}

/// Options with a `--map` and an interval in s.
fn told(map: &str, interval_s: Option<f64>) -> ImportOptions {
    ImportOptions {
        map: parse_map(map).unwrap(),
        interval_s,
        ..ImportOptions::default()
    }
}

/// The recording of a file, which must be the eight samples at 1 kHz, the first one at `start_s`.
fn read(name: &str, start_s: f64, options: &ImportOptions) -> Imported {
    let imported = import(name, &file(name), options).unwrap_or_else(|e| panic!("{e}"));
    let recording = &imported.recording;
    let time_s: Vec<f64> = (0..8).map(|i| start_s + f64::from(i) * 0.001).collect();
    // The cells have 9 digits in files with inches and pounds, and all digits otherwise.
    let close = |a: &[f64], b: &[f64]| {
        a.len() == b.len()
            && a.iter()
                .zip(b)
                .all(|(a, b)| (a - b).abs() < 1e-7 * b.abs().max(1.0))
    };
    assert!(close(&recording.time_s, &time_s), "{name}: {recording:?}");
    assert!(
        close(&recording.displacement_mm, &DISPLACEMENT_MM),
        "{name}: {recording:?}"
    );
    assert!(close(&recording.force_n, &FORCE_N), "{name}: {recording:?}");
    imported
}

/// File, what is taken from names and units, separator, decimal sign, encoding.
const UNDERSTOOD: [(&str, &str, char, DecimalSign, TextEncoding); 9] = {
    use DecimalSign::{Comma, Point};
    use TextEncoding::{Utf8, Utf16, Windows1252};
    [
        (
            "decimal-comma.csv",
            "Zeit [s]=time_s,Weg [mm]=displacement_mm,Kraft [N]=force_n",
            ';',
            Comma,
            Utf8,
        ),
        (
            "kilonewtons.csv",
            "time_s=time_s,displacement_mm=displacement_mm,force_kn=force_n*1000",
            ',',
            Point,
            Utf8,
        ),
        (
            "time-in-ms.csv",
            "t/ms=time_s*0.001,s/mm=displacement_mm,F/N=force_n",
            ';',
            Comma,
            Utf8,
        ),
        (
            "latin-1.csv",
            "Zeit in s=time_s,Länge [µm]=displacement_mm*0.001,Kraft [N]=force_n",
            ';',
            Comma,
            Windows1252,
        ),
        (
            "tab.txt",
            "Time [s]=time_s,Travel [mm]=displacement_mm,Load [N]=force_n",
            '\t',
            Point,
            Utf8,
        ),
        (
            "preamble.csv",
            "Zeit [s]=time_s,Weg [mm]=displacement_mm,Kraft [N]=force_n",
            ';',
            Comma,
            Utf8,
        ),
        (
            "quoted-thousands.csv",
            "Time (s)=time_s,Stroke (mm)=displacement_mm,Load (N)=force_n",
            ',',
            Point,
            Utf8,
        ),
        (
            "utf-16.txt",
            "Zeit [s]=time_s,Weg [mm]=displacement_mm,Kraft [N]=force_n",
            '\t',
            Comma,
            Utf16,
        ),
        (
            "old-line-ends.csv",
            "Time [s]=time_s,Travel [in]=displacement_mm*25.4,Force [lbf]=force_n*4.4482216152605",
            ',',
            Point,
            Utf8,
        ),
    ]
};

#[test]
fn files_with_names_and_units_need_no_map() {
    for (name, map, separator, decimal, encoding) in UNDERSTOOD {
        let imported = read(name, 0.0, &ImportOptions::default());
        assert_eq!(imported.map_text(), map);
        assert_eq!(
            (imported.separator, imported.decimal, imported.encoding),
            (separator, decimal, encoding),
            "{name}"
        );
        assert!(imported.guessed && imported.flipped.is_empty(), "{name}");
        // What was taken, typed as --map, gives the same.
        let again = read(name, 0.0, &told(&imported.map_text(), None));
        assert_eq!(again.map_text(), map);
    }
}

#[test]
fn a_table_without_time_needs_the_interval() {
    let refused = import("no-time.csv", &file("no-time.csv"), &ImportOptions::default()).unwrap_err();
    assert!(refused.to_string().contains("such as --dt 0.001"), "{refused}");
    let with_interval = ImportOptions {
        interval_s: Some(0.001),
        ..ImportOptions::default()
    };
    let imported = read("no-time.csv", 0.0, &with_interval);
    // Three digits, not 0.006999999999999999.
    assert_eq!(imported.recording.time_s[7], 0.007);
    assert_eq!(imported.recording.force_n[1], 115.5);
    // A column of time that exists is not used, and said to be unused.
    let beside = read("decimal-comma.csv", 0.0, &with_interval);
    assert_eq!(beside.unused, ["Zeit [s]"]);
    let both = told("Zeit [s]=time_s,Weg=displacement_mm,Kraft=force_n", Some(0.001));
    let twice = import("decimal-comma.csv", &file("decimal-comma.csv"), &both).unwrap_err();
    assert!(twice.to_string().contains("time_s is given twice"), "{twice}");
}

#[test]
fn other_names_are_listed_and_read_as_told() {
    let name = "other-names.csv";
    let refused = import(name, &file(name), &ImportOptions::default()).unwrap_err();
    let said = refused.to_string();
    assert!(
        said.contains("#1 No., #2 Actuator, front, #3 Cell B, #4 Valve") && said.contains("--dt SECONDS"),
        "{said}"
    );
    let imported = read(
        name,
        0.0,
        &told(
            "Actuator, front=displacement_mm*10,#3=force_n*10,No.=cycle",
            Some(0.001),
        ),
    );
    assert_eq!(imported.recording.cycle, Some((1..=8).collect()));
    assert_eq!(imported.unused, ["Valve"]);
    assert!(!imported.guessed);
}

#[test]
fn a_wrong_sign_is_told_and_turned() {
    let name = "wrong-sign.csv";
    let as_it_is = import(name, &file(name), &ImportOptions::default()).unwrap();
    assert!(
        as_it_is
            .notes
            .iter()
            .any(|note| note.ends_with("add --flip force")),
        "{:?}",
        as_it_is.notes
    );
    assert_eq!(as_it_is.recording.force_n[4], -1432.0);
    let options = ImportOptions {
        flip_force: true,
        ..ImportOptions::default()
    };
    let imported = read(name, 0.0, &options);
    assert_eq!(imported.flipped, ["force_n"]);
    assert!(imported.notes.is_empty(), "{:?}", imported.notes);
}

#[test]
fn clock_times_and_tables_without_header_are_read_as_told() {
    let clock = "Uhrzeit=time_s,Weg=displacement_mm,Kraft=force_n";
    // 10:31:07 in s since midnight.
    read("clock-time.csv", 37_867.0, &told(clock, None));
    read(
        "no-header.csv",
        0.0,
        &told("#1=time_s,#2=displacement_mm,#3=force_n", None),
    );
}

#[test]
fn the_preamble_and_the_empty_rows_are_told() {
    let imported = read("preamble.csv", 0.0, &ImportOptions::default());
    assert_eq!((imported.header_row, imported.first_row), (Some(6), 7));
    assert_eq!(imported.notes, ["1 rows without any value were left out"]);
}

fn refusal(text: &str, options: &ImportOptions) -> String {
    import("f.csv", text.as_bytes(), options).unwrap_err().to_string()
}

#[test]
fn p8_every_mistake_is_told_with_row_column_and_advice() {
    let head = "t [s];x [mm];F [N]\n0,0;0,5;1\n0,1;0,6;2\n";
    let none = ImportOptions::default();
    for (rows, wanted) in [
        (
            "0,2;high;3\n",
            "row 4, column x [mm]: \"high\" is not a number with a decimal comma",
        ),
        ("0,2;0.75;3\n", "\"0.75\" in row 4 has a decimal point"),
        ("0,2;;3\n", "row 4, column x [mm]: \"\" is not a number"),
        ("0,1;0,7;3\n", "row 4, column t [s]: 0.1 s comes after 0.1 s"),
        ("0,2;0,7\n", "row 4: the row ends before column F [N]"),
        ("0,2;0,7;3;4\n", "row 4: 4 cells, and the header has 3"),
    ] {
        let said = refusal(&format!("{head}{rows}"), &none);
        assert!(said.contains(wanted), "{said:?} should say {wanted:?}");
    }
    for (map, wanted) in [
        (
            "y=displacement_mm,F=force_n",
            "--map y: there is no such column: use one of #1 t [s]",
        ),
        ("x=displacement_mm", "--map names no column for force_n"),
        ("F=displacement_mm,x=force_n", "the unit of the column is N"),
        ("x=force_n*1,F=force_n", "force_n is given twice"),
    ] {
        let said = refusal(head, &told(map, None));
        assert!(said.contains(wanted), "{said:?} should say {wanted:?}");
    }
}

#[test]
fn an_uncertain_decimal_sign_is_told_and_can_be_chosen() {
    let text = "t [ms];x [mm];F [N]\n1;1,234;5\n2;1,235;6\n3;1,236;7\n";
    let imported = import("f.csv", text.as_bytes(), &ImportOptions::default()).unwrap();
    assert_eq!(imported.recording.displacement_mm[0], 1.234);
    assert!(
        imported.notes[0].contains("add --decimal point"),
        "{:?}",
        imported.notes
    );
    let chosen = ImportOptions {
        decimal: Some(DecimalSign::Point),
        ..ImportOptions::default()
    };
    let imported = import("f.csv", text.as_bytes(), &chosen).unwrap();
    assert_eq!(imported.recording.displacement_mm[0], 1234.0);
    assert!(imported.notes.is_empty());
}

#[test]
fn a_factor_against_the_header_is_told() {
    let text = "t [s],x [mm],F [kN]\n0,1,5\n1,2,6\n";
    let imported = import(
        "f",
        text.as_bytes(),
        &told("t=time_s,x=displacement_mm,F=force_n*1", None),
    )
    .unwrap();
    assert_eq!(
        imported.mapped[2].reason,
        "from --map, although the header says kN"
    );
    assert_eq!(imported.recording.force_n, [5.0, 6.0]);
}

#[test]
fn an_imported_recording_is_written_and_read_back() {
    let imported = read("decimal-comma.csv", 0.0, &ImportOptions::default());
    let mut out = Vec::new();
    csv::write_recording(&mut out, &imported.recording).unwrap();
    assert!(out.starts_with(b"time_s,displacement_mm,force_n\r\n0,0,10\r\n0.001,1.25,115.5\r\n"));
    let back = csv::read("back.csv", out.as_slice()).unwrap();
    assert_eq!(
        (back.time_s, back.displacement_mm, back.force_n),
        (
            imported.recording.time_s,
            imported.recording.displacement_mm,
            imported.recording.force_n
        )
    );
}

proptest::proptest! {
    #[test]
    fn any_text_never_panics(bytes in "[-0-9.,;\t\"a\\[\\]:\n\r=é]{0,200}") {
        let _ = import("f", bytes.as_bytes(), &ImportOptions { interval_s: Some(0.1), ..ImportOptions::default() });
        let _ = import("f", bytes.as_bytes(), &told("#1=displacement_mm,#2=force_n", Some(0.1)));
        let _ = parse_map(&bytes);
    }
}

/// Found by fuzzing: 1e308 m are infinite in mm.
#[test]
fn a_number_that_is_infinite_after_its_factor_is_refused() {
    let table = b"Zeit [s];Weg [m];Kraft [N]\n0;1,5;2\n1;-1e308;2\n";
    let error = import("t", table, &ImportOptions::default())
        .expect_err("refused")
        .to_string();
    assert!(error.contains("row 3") && error.contains("finite"), "{error}");
}
