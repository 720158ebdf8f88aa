//! Drawing files: what is read, what is refused, what the table of estimates lacks.

use super::*;

fn read(text: &str) -> Result<Drawings, DrawingError> {
    Drawings::read("drawings.toml", text)
}

fn said(table: &str) -> String {
    let text = format!("# drawings\n[family.F1.rate_n_per_mm]\n{table}\n");
    read(&text).expect_err(table).to_string()
}

fn limits(table: &str) -> DrawnLimits {
    let text = format!("[family.F1.rate_n_per_mm]\n{table}\n");
    let drawings = read(&text).expect(table);
    drawings.limits("F1", "rate_n_per_mm").expect("limits").clone()
}

#[test]
fn limits_are_read_as_the_drawing_has_them() {
    let ends = |l: &DrawnLimits| {
        let nominal = l.nominal.unwrap_or(1.0);
        [l.at_least, l.at_most].map(|limit| limit.map(|limit| limit.at(nominal)))
    };
    for (table, expected, words) in [
        (
            "nominal = \"50 N/mm\"\ntolerance = \"7 %\"",
            [Some(46.5), Some(53.5)],
            "tolerance 7 %",
        ),
        ("tolerance = \"25%\"", [Some(0.75), Some(1.25)], "tolerance 25 %"),
        (
            "nominal = \"50 N/mm\"\ntolerance = \"4.5 N/mm\"",
            [Some(45.5), Some(54.5)],
            "tolerance 4.5 N/mm",
        ),
        ("at_most = \"80 N/mm\"", [None, Some(80.0)], "at most 80 N/mm"),
        (
            "nominal = \"50 N/mm\"\nat_least = \"97 %\"\nat_most = \"105 %\"",
            [Some(48.5), Some(52.5)],
            "at least 97 % of the nominal, at most 105 % of the nominal",
        ),
        (
            "at_least = -3\nat_most = 0.5",
            [Some(-3.0), Some(0.5)],
            "at least -3, at most 0.5",
        ),
    ] {
        let limits = limits(table);
        for (got, wanted) in ends(&limits).iter().zip(expected) {
            assert_eq!(got.is_some(), wanted.is_some(), "{table}");
            assert!(
                (got.unwrap_or(0.0) - wanted.unwrap_or(0.0)).abs() < 1e-12,
                "{table}: {got:?}"
            );
        }
        assert_eq!(limits.words, words);
    }
}

#[test]
fn a_mistake_is_refused_with_file_key_and_what_to_do() {
    for (table, part) in [
        (
            "",
            "line 2: family.F1.rate_n_per_mm: it has no limit: add tolerance",
        ),
        (
            "tolerence = \"7 %\"",
            "line 3: unknown key tolerence: did you mean tolerance?",
        ),
        (
            "tolerance = \"7 %\"\nat_most = \"9 N/mm\"",
            ".tolerance: it stands beside",
        ),
        ("tolerance = \"-7 %\"", "above 0"),
        ("tolerance = \"120 %\"", "at_most in place of it"),
        ("tolerance = \"seven\"", "does not begin with a number"),
        ("tolerance = true", "as on the drawing"),
        (
            "nominal = \"62,0 N/mm\"\ntolerance = \"7 %\"",
            ".nominal: \"62,0 N/mm\" has a comma",
        ),
        (
            "nominal = \"62 %\"\ntolerance = \"7 %\"",
            "in the unit of the quantity",
        ),
        (
            "nominal = \"-62 N/mm\"\ntolerance = \"7 %\"",
            "percent of it mean nothing",
        ),
        (
            "nominal = \"62 N/mm\"\ntolerance = \"4 N\"",
            ".tolerance: it is in N, and another value in N/mm",
        ),
        ("at_least = \"9 N/mm\"\nat_most = \"8 N/mm\"", "not below at_most"),
        (
            "at_least = \"90 %\"\nat_most = \"80 N/mm\"",
            "enter both in percent",
        ),
        ("tolerance = ", "line 3"),
    ] {
        let said = said(table);
        assert!(
            said.starts_with("drawings.toml, line ") && said.contains(part),
            "{table}: {said}"
        );
    }
    assert!(
        read("famly = 1")
            .expect_err("a key")
            .to_string()
            .contains("unknown key famly")
    );
    assert!(read("").expect_err("empty").to_string().contains("family"));
}

#[test]
fn what_the_table_does_not_have_is_refused_or_said() {
    let rows = crate::fleet::tests::synthetic::SyntheticLab::default().table(1);
    let check = |text: &str| read(text).expect(text).check(&rows).map_err(|e| e.to_string());
    assert_eq!(check("[family.F1.rate_n_per_mm]\nat_most = \"80 N/mm\""), Ok(()));
    for (text, part) in [
        (
            "[family.G1.rate_n_per_mm]\nat_most = \"80 N/mm\"",
            "which has F1, F2, F3, F4",
        ),
        (
            "[family.F1.rate_n_mm]\nat_most = \"80 N/mm\"",
            "did you mean rate_n_per_mm?; it has channel_delay",
        ),
        (
            "[family.F1.rate_n_per_mm]\nat_most = \"80 kN/m\"",
            "enter it in N/mm",
        ),
        ("[family.F1.rate_n_per_mm]\nat_most = 80", "written in \"1\""),
        (
            "[family.F1.channel_delay]\ntolerance = \"5 %\"",
            "enter the limits in ms",
        ),
    ] {
        let said = check(text).expect_err(text);
        assert!(said.contains(part), "{text}: {said}");
    }
    let both =
        "[family.F1.rate_n_per_mm]\ntolerance = \"7 %\"\n[family.axle.rate_n_per_mm]\ntolerance = \"7 %\"";
    let said = read(both).expect("two families").families_without_runs(&rows);
    assert_eq!(said.len(), 1);
    assert!(
        said[0].starts_with("No specimen of family axle of drawings.toml"),
        "{said:?}"
    );
}
