//! The judgement of specimens: inside, outside, on the limit, and what else explains it.

use super::*;
use crate::fleet::estimate::EstimateRow;
use crate::fleet::findings::FleetFindings;
use crate::fleet::tests::synthetic::SyntheticLab;
use crate::fleet::{FleetOptions, pool};

const SEED: u64 = 31;

/// S001, of family F2, is 12 % too stiff.
fn lab() -> SyntheticLab {
    SyntheticLab::with_stiff_specimen(1, 0.12)
}

fn rate_rows(lab: &SyntheticLab) -> Vec<EstimateRow> {
    let mut rows = lab.table(SEED);
    rows.retain(|row| row.quantity == "rate_n_per_mm");
    rows
}

fn against(rows: &[EstimateRow], drawings: &str) -> FleetFindings {
    let options = FleetOptions {
        drawings: Some(Drawings::read("drawings.toml", drawings).expect(drawings)),
        ..FleetOptions::default()
    };
    pool(rows, &options).expect("pooled")
}

fn judgement<'f>(findings: &'f FleetFindings, specimen: &str) -> &'f DrawingJudgement {
    let mut all = findings.quantities.iter().flat_map(|q| &q.against_drawing);
    all.find(|j| j.specimen == specimen).expect(specimen)
}

/// The true rate of S001.
fn true_rate() -> f64 {
    let own = lab().rate_deviations(SEED)[1].1;
    lab().family_rates(SEED)[1] * own.exp()
}

fn verdict_of(limits: &str) -> DrawingVerdict {
    let text = format!("[family.F2.rate_n_per_mm]\n{limits}\n");
    judgement(&against(&rate_rows(&lab()), &text), "S001").verdict
}

#[test]
fn the_chance_of_a_value_outside_is_that_of_its_distance_from_the_limit() {
    let p = |estimate: f64, low: f64, high: f64| {
        let value = Contrast {
            estimate,
            std_error: 0.5,
            degrees: 1e6,
        };
        outside_p(&value, low, high)
    };
    let none = f64::INFINITY;
    // One-sided tails of a normal law at 1.96 and at 0 standard errors.
    assert!((p(10.98, -none, 10.0) - 0.025).abs() < 1e-4);
    assert!((p(9.02, 10.0, none) - 0.025).abs() < 1e-4);
    assert!((p(10.0, -none, 10.0) - 0.5).abs() < 1e-9);
    assert!((p(9.02, -none, 10.0) - 0.975).abs() < 1e-4);
    // The other limit is 2 standard errors further: its tail at 3.96 comes on top, and at a width of 0 it is as large.
    assert!((p(10.98, 9.0, 10.0) - 0.025 - 3.7e-5).abs() < 1e-4);
    assert!((p(10.98, 10.0, 10.0) - 0.05).abs() < 1e-4);
    assert_eq!(
        outside_p(
            &Contrast {
                estimate: 9.0,
                std_error: 0.0,
                degrees: 5.0
            },
            0.0,
            1.0
        ),
        1.0
    );
}

#[test]
fn inside_outside_and_straddling_are_told() {
    let rate = true_rate();
    for (nominal, verdict) in [
        (rate, DrawingVerdict::Within),
        (rate / 1.12, DrawingVerdict::OutOfTolerance),
        (rate / 0.88, DrawingVerdict::OutOfTolerance),
        (rate / 1.07, DrawingVerdict::Undecided),
        (rate / 0.93, DrawingVerdict::Undecided),
    ] {
        let limits = format!("nominal = \"{nominal} N/mm\"\ntolerance = \"7 %\"");
        assert_eq!(verdict_of(&limits), verdict, "{limits}");
    }
}

#[test]
fn one_sided_limits_ask_about_one_side() {
    let rate = true_rate();
    let limit = |key: &str, factor: f64| verdict_of(&format!("{key} = \"{} N/mm\"", factor * rate));
    assert_eq!(limit("at_most", 0.94), DrawingVerdict::OutOfTolerance);
    assert_eq!(limit("at_most", 1.06), DrawingVerdict::Within);
    assert_eq!(limit("at_most", 1.0), DrawingVerdict::Undecided);
    assert_eq!(limit("at_least", 0.94), DrawingVerdict::Within);
    assert_eq!(limit("at_least", 1.06), DrawingVerdict::OutOfTolerance);
}

#[test]
fn the_mean_of_the_others_stands_for_a_nominal_that_is_missing() {
    let findings = against(
        &rate_rows(&lab()),
        "[family.F2.rate_n_per_mm]\ntolerance = \"7 %\"",
    );
    let out = judgement(&findings, "S001");
    assert_eq!(out.verdict, DrawingVerdict::OutOfTolerance);
    let nominal = out.nominal.expect("the mean");
    // Five others, each within some 2 % of the mean.
    assert!(
        (nominal / lab().family_rates(SEED)[1] - 1.0).abs() < 0.03,
        "{out:?}"
    );
    let deviation = lab().rate_deviations(SEED)[1].1.exp();
    assert!(
        (out.value.value / nominal / deviation - 1.0).abs() < 0.03,
        "{out:?}"
    );
    let said = &findings
        .findings
        .iter()
        .find(|f| f.subject == "S001")
        .expect("found")
        .sentence;
    assert!(said.contains(" above the mean of family F2, "), "{said}");
    assert!(
        said.contains("tolerance 7 %: out of tolerance (6 runs)."),
        "{said}"
    );
    // The same in the unit.
    let tolerance = format!("tolerance = \"{} N/mm\"", 0.07 * nominal);
    assert_eq!(verdict_of(&tolerance), DrawingVerdict::OutOfTolerance);
}

#[test]
fn what_has_no_run_or_no_drawing_is_not_judged() {
    let mut rows = lab().table(SEED);
    rows.retain(|r| r.quantity == "rate_n_per_mm" || r.quantity == "friction_ratio" && r.specimen != "S005");
    let text = "[family.F2.friction_ratio]\nat_most = 0.9\n[family.F2.rate_n_per_mm]\nat_least = \"1 N/mm\"";
    let findings = against(&rows, text);
    let counts = findings.against_drawings.expect("judged");
    // Six specimens of F2, one without runs in friction; none of the other families.
    assert_eq!((counts.judged, counts.within), (11, 11));
    let said = findings.cannot_tell.join("\n");
    assert!(
        said.contains("friction_ratio of S005 was not judged by the drawing"),
        "{said}"
    );
    assert!(
        findings
            .findings
            .iter()
            .all(|f| f.kind != crate::fleet::findings::QuestionKind::Drawing)
    );
}

#[test]
fn a_whole_family_or_batch_outside_is_said_to_be_the_cause() {
    let nominal = lab().family_rates(SEED)[0];
    let text = format!(
        "[family.F1.rate_n_per_mm]\nnominal = \"{} N/mm\"\ntolerance = \"3 %\"",
        0.8 * nominal
    );
    let findings = against(&rate_rows(&lab()), &text);
    let remark = judgement(&findings, "S000").remark.clone().expect("a remark");
    assert!(
        remark.starts_with("So are 6 of the 6 specimens of family F1"),
        "{remark}"
    );
    let mut of_batch = rate_rows(&lab());
    for row in of_batch.iter_mut().filter(|row| row.family == "F1") {
        let is_new = ["S000", "S004", "S008"].contains(&row.specimen.as_str());
        let factor = if is_new { 1.3 } else { 1.0 };
        row.batch = if is_new { "new" } else { "old" }.to_owned();
        row.estimate *= factor;
        row.std_error *= factor;
    }
    let text = format!("[family.F1.rate_n_per_mm]\nnominal = \"{nominal} N/mm\"\ntolerance = \"15 %\"");
    let findings = against(&of_batch, &text);
    let remark = judgement(&findings, "S004").remark.clone().expect("a remark");
    assert_eq!(
        remark,
        "So are 3 of the 3 specimens of batch new: the batch as a whole explains it."
    );
    assert_eq!(judgement(&findings, "S020").verdict, DrawingVerdict::Within);
}

#[test]
fn an_excess_that_hangs_on_a_bench_is_said_to_hang_on_it() {
    // B2 reads 1 % high. If it is right, the specimen is above a limit that lies 0.4 % above its true value.
    let limits = format!(
        "[family.F2.rate_n_per_mm]\nat_most = \"{} N/mm\"",
        1.004 * true_rate()
    );
    let findings = against(&rate_rows(&lab()), &limits);
    let one = judgement(&findings, "S001");
    assert_eq!(
        (one.verdict, one.clearest_bench.as_deref()),
        (DrawingVerdict::Undecided, Some("B2"))
    );
    assert!(
        one.value.low95 < 1.004 * true_rate() && one.value.high95 > 1.008 * true_rate(),
        "{one:?}"
    );
    let options = FleetOptions {
        reference_bench: Some("B1".to_owned()),
        drawings: Some(Drawings::read("drawings.toml", &limits).expect("limits")),
        ..FleetOptions::default()
    };
    let with_reference = pool(&rate_rows(&lab()), &options).expect("pooled");
    let known = judgement(&with_reference, "S001");
    assert_eq!((&known.least_sure_bench, &known.remark), (&None, &None));
    assert!(
        known.value.high95 < one.value.high95 - 0.005 * true_rate(),
        "{known:?}"
    );
}

#[test]
fn the_benches_that_decide_are_named() {
    let findings = against(
        &rate_rows(&lab()),
        "[family.F2.rate_n_per_mm]\nat_most = \"500 N/mm\"",
    );
    let undecided = DrawingJudgement {
        verdict: DrawingVerdict::Undecided,
        least_sure_bench: Some("B1".to_owned()),
        clearest_bench: Some("B2".to_owned()),
        clearest_p: 0.001,
        ..judgement(&findings, "S001").clone()
    };
    let said = if_bench(&undecided, 6).expect("a remark");
    assert!(
        said.starts_with("It is out of tolerance if bench B2 is right, but not surely if bench B1 is"),
        "{said}"
    );
    assert_eq!(if_bench(&undecided, 60), None, "one of many");
    let within = DrawingJudgement {
        verdict: DrawingVerdict::Within,
        ..undecided
    };
    assert_eq!(if_bench(&within, 6), None);
}
