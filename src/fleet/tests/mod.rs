//! Tests of pooling on synthetic labs. `docs/fleet.md` has the figures of larger simulations with the same generator.

mod drawings;
mod predictions;
pub(in crate::fleet) mod synthetic;

use super::findings::{AgeUnit, BenchError, FleetFinding, GroupLevel};
use super::*;
use synthetic::SyntheticLab;

fn pooled(rows: &[EstimateRow]) -> FleetFindings {
    pool(rows, &FleetOptions::default()).expect("a sound table")
}

fn quantity<'f>(findings: &'f FleetFindings, name: &str) -> &'f QuantityFindings {
    let mut all = findings.quantities.iter();
    all.find(|q| q.quantity == name).expect("the quantity")
}

fn covers(value: &PooledValue, truth: f64) -> bool {
    value.low95 <= truth && truth <= value.high95
}

/// What was found about a subject in a quantity.
fn about<'f>(findings: &'f FleetFindings, subject: &str, quantity: &str) -> Option<&'f FleetFinding> {
    let mut all = findings.findings.iter();
    all.find(|f| f.subject == subject && f.quantity == quantity)
}

/// Of the labs with everything in them: how often each thing was found, and how often its interval holds the truth.
#[derive(Debug, Default)]
struct LabsFound {
    gain: Coverage,
    force_is_the_cause: usize,
    delay: Coverage,
    batch: usize,
    outliers: usize,
    slope: Coverage,
    /// Findings about subjects in which there is nothing.
    wrong: usize,
}

impl LabsFound {
    fn count(&mut self, lab: &SyntheticLab, findings: &FleetFindings) {
        let bench = |quantity_name: &str, name: &str| {
            let mut benches = quantity(findings, quantity_name).benches.iter();
            benches.find(|b| b.name == name).map(|b| b.effect.clone())
        };
        let held =
            |value: Option<PooledValue>, truth: f64| value.is_some_and(|v| v.found && covers(&v, truth));
        self.gain
            .count(held(bench("rate_n_per_mm", "B2"), lab.force_gain[1]));
        self.delay
            .count(held(bench("channel_delay", "B3"), lab.delay_ms[2]));
        let causes = &findings.bench_causes;
        let force = causes
            .iter()
            .filter(|c| c.bench == "B2" && c.error == BenchError::ForceGain);
        self.force_is_the_cause += force.count();
        self.batch += usize::from(about(findings, "F2 / m2", "series_compliance").is_some());
        let outlier = |s: &&&str| about(findings, s, "rate_n_per_mm").is_some();
        self.outliers += ["S007", "S025"].iter().filter(outlier).count();
        let slopes = &quantity(findings, "friction_ratio").slopes;
        let mut shared = slopes.iter().filter(|s| s.family.is_none());
        let slope = shared.find(|s| s.per == AgeUnit::ThousandCycles);
        self.slope
            .count(held(slope.map(|s| s.slope.clone()), lab.friction_growth));
        self.wrong += findings.findings.iter().filter(|f| !is_true(f)).count();
    }
}

/// True if the lab with everything in it has what the finding says.
fn is_true(finding: &FleetFinding) -> bool {
    let subjects: &[&str] = match finding.quantity.as_str() {
        "rate_n_per_mm" => &["B2", "S007", "S025"],
        "preload_n" => &["B2"],
        "friction_ratio" => &["", "F1", "F2", "F3", "F4"],
        "series_compliance" => &["F2", "F2 / m1", "F2 / m2"],
        "channel_delay" => &["B3"],
        _ => &[],
    };
    subjects.contains(&finding.subject.as_str())
}

fn found_in(seeds: std::ops::Range<u64>) -> LabsFound {
    let lab = SyntheticLab::with_everything();
    let mut found = LabsFound::default();
    seeds.for_each(|seed| found.count(&lab, &pooled(&lab.table(seed))));
    found
}

#[test]
fn everything_in_a_lab_is_found() {
    let found = found_in(100..110);
    println!("{found:?}");
    // Intervals of 95 %: 8 of 10 or more have a chance of 99 %.
    for held in [found.gain, found.delay, found.slope] {
        assert!(held.held >= 8, "{found:?}");
    }
    assert!(found.force_is_the_cause >= 9 && found.outliers >= 18, "{found:?}");
    assert!(found.batch >= 7 && found.wrong <= 2, "{found:?}");
}

#[test]
fn a_lab_with_nothing_in_it_gets_nothing() {
    let lab = SyntheticLab {
        specimens: 24,
        runs: 120,
        ..SyntheticLab::default()
    };
    let seeds = 5000..5200;
    let wrong = seeds
        .filter(|seed| !pooled(&lab.table(*seed)).findings.is_empty())
        .count();
    println!("{wrong} of 200 labs with nothing in them got a finding");
    assert!(wrong <= 10, "{wrong} of 200");
}

/// The figures of `docs/fleet.md` about labs with nothing and with everything in them.
#[test]
#[ignore = "minutes"]
fn figures_of_many_labs() {
    let small = SyntheticLab {
        specimens: 24,
        runs: 120,
        ..SyntheticLab::default()
    };
    for (lab, seeds) in [(SyntheticLab::default(), 20_000..20_400), (small, 30_000..31_000)] {
        let (labs, mut named) = (seeds.end - seeds.start, BTreeMap::new());
        let mut wrong = 0;
        for seed in seeds {
            let found = pooled(&lab.table(seed)).findings;
            found.iter().for_each(|f| *named.entry(f.kind).or_insert(0) += 1);
            wrong += usize::from(!found.is_empty());
        }
        println!("nothing, {} runs: {wrong} of {labs} labs; {named:?}", lab.runs);
    }
    println!("everything, 400 labs: {:?}", found_in(40_000..40_400));
}

/// Counts of intervals that hold the truth, and of all.
#[derive(Debug, Default, Clone, Copy)]
struct Coverage {
    held: usize,
    all: usize,
}

impl Coverage {
    fn count(&mut self, held: bool) {
        self.held += usize::from(held);
        self.all += 1;
    }

    fn share(self) -> f64 {
        self.held as f64 / self.all as f64
    }
}

/// Coverage of the intervals of benches, of slopes and of specimens.
fn coverage(lab: &SyntheticLab, seeds: std::ops::Range<u64>) -> [Coverage; 3] {
    let [mut benches, mut slopes, mut specimens] = [Coverage::default(); 3];
    for seed in seeds {
        let mut rows = lab.table(seed);
        rows.retain(|row| ["rate_n_per_mm", "friction_ratio"].contains(&row.quantity.as_str()));
        let found = pooled(&rows);
        let log_gain = |name: &str| {
            let bench: usize = name[1..].parse().expect("a number");
            lab.force_gain[bench - 1].ln_1p()
        };
        let rate = quantity(&found, "rate_n_per_mm");
        for bench in &rate.benches {
            let others: f64 = bench.against.iter().map(|b| log_gain(b)).sum();
            let truth = log_gain(&bench.name) - others / bench.against.len() as f64;
            benches.count(covers(&bench.effect, truth.exp_m1()));
        }
        let truths: BTreeMap<String, f64> = lab.rate_deviations(seed).into_iter().collect();
        for specimen in &rate.specimen_deviations {
            specimens.count(covers(&specimen.deviation, truths[&specimen.specimen].exp_m1()));
        }
        for slope in &quantity(&found, "friction_ratio").slopes {
            let truth = match slope.per {
                AgeUnit::ThousandCycles => lab.friction_growth,
                AgeUnit::Year => 0.0,
            };
            slopes.count(covers(&slope.slope, truth));
        }
    }
    [benches, slopes, specimens]
}

#[test]
fn intervals_hold_the_truth_in_95_percent() {
    for families in [2, 4] {
        let lab = SyntheticLab {
            families,
            specimens: 6 * families,
            runs: 36 * families,
            force_gain: vec![0.0, 0.004, -0.003],
            friction_growth: 0.002,
            ..SyntheticLab::default()
        };
        let found = coverage(&lab, 7000..7150);
        println!("{families} families: {:?}", found.map(Coverage::share));
        for coverage in found {
            // Three standard deviations of the share, taken as if the intervals of a lab were one (150 labs), beside 93 to 97 %.
            assert!(
                (0.90..=0.985).contains(&coverage.share()),
                "{families}: {found:?}"
            );
        }
    }
}

#[test]
fn the_order_of_the_rows_does_not_matter() {
    let mut rows = SyntheticLab::with_everything().table(3);
    let before = pooled(&rows);
    rows.reverse();
    rows.swap(10, 200);
    assert_eq!(pooled(&rows), before);
}

#[test]
fn a_bench_with_an_effect_of_its_own_is_not_taken_for_its_springs() {
    let lab = SyntheticLab {
        bench_compliance: vec![0.0, 0.4, 0.0],
        of_five_on_two_benches: 3,
        ..SyntheticLab::default()
    };
    let mut named = 0;
    for seed in 0..10 {
        let mut rows = lab.table(seed);
        rows.retain(|row| row.quantity == "series_compliance");
        let found = pooled(&rows);
        named += usize::from(about(&found, "B2", "series_compliance").is_some());
        let blames = |g: &&GroupLevel| g.on_least_sure_bench.as_ref().is_some_and(|v| v.found);
        let blamed = quantity(&found, "series_compliance").groups.iter().find(blames);
        assert!(blamed.is_none(), "seed {seed}: {blamed:?}");
    }
    assert!(named >= 9, "the bench is named in {named} of 10 labs");
}

#[test]
fn what_cannot_be_told_is_said() {
    let lab = SyntheticLab {
        of_five_on_two_benches: 0,
        force_gain: vec![0.0, 0.05, 0.0],
        ..SyntheticLab::default()
    };
    let found = pooled(&lab.table(4));
    assert!(quantity(&found, "rate_n_per_mm").benches.is_empty());
    let said = found.cannot_tell.join("\n");
    assert!(
        said.contains("the benches (B1), (B2) and (B3) cannot be compared"),
        "{said}"
    );
    let options = FleetOptions {
        reference_bench: Some("B9".to_owned()),
        ..FleetOptions::default()
    };
    let refused = pool(&lab.table(4), &options).expect_err("no such bench");
    assert_eq!(
        refused.to_string(),
        "the reference bench B9 is not in the table, which has B1, B2, B3: name one of them"
    );
}

#[test]
fn the_only_specimen_of_a_batch_is_not_judged() {
    let lab = SyntheticLab {
        specimens: 16,
        runs: 96,
        ..SyntheticLab::default()
    };
    let found = pooled(&lab.table(7));
    assert_eq!(found.findings, []);
    let rate = quantity(&found, "rate_n_per_mm");
    let mut alone = rate.specimen_deviations.iter().filter(|s| s.batch == "m1");
    assert!(alone.all(|s| s.deviation.p.is_none() && s.deletion_t == 0.0));
    let said = found.cannot_tell.join("\n");
    assert!(said.contains("S000, S001, S002 and S003"), "{said}");
}

#[test]
fn with_a_reference_each_bench_is_compared_with_it_alone() {
    let lab = SyntheticLab::with_everything();
    let options = FleetOptions {
        reference_bench: Some("B2".to_owned()),
        ..FleetOptions::default()
    };
    let found = pool(&lab.table(2), &options).expect("a sound table");
    let benches = &quantity(&found, "rate_n_per_mm").benches;
    let names: Vec<&str> = benches.iter().map(|b| b.name.as_str()).collect();
    assert_eq!(names, ["B1", "B3"]);
    for bench in benches {
        assert_eq!(bench.against, ["B2"]);
        assert!(bench.effect.found && bench.effect.value < 0.0, "{bench:?}");
    }
}

#[test]
fn rows_that_contradict_each_other_are_refused() {
    let mut rows = SyntheticLab::default().table(1);
    rows[6].family = "F9".to_owned();
    rows[6].specimen = rows[0].specimen.clone();
    let said = pool(&rows, &FleetOptions::default())
        .expect_err("two families")
        .to_string();
    assert_eq!(
        said,
        "specimen S000 has the family F1 in run r00000 and F9 in run r00001: correct one of them"
    );
    assert!(pool(&[], &FleetOptions::default()).is_err());
}

#[test]
fn small_and_odd_tables_give_no_value_that_is_no_number() {
    use rand::{RngExt, SeedableRng};
    let lab = SyntheticLab::with_everything();
    let all = lab.table(9);
    for seed in 0..60 {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let count = random.random_range(1..60);
        let mut rows: Vec<EstimateRow> = (0..count)
            .map(|_| all[random.random_range(0..all.len())].clone())
            .collect();
        for row in &mut rows {
            match seed % 4 {
                0 => row.estimate = 1.0,
                1 => row.std_error *= 1e6,
                2 => row.std_error *= 1e-9,
                _ => row.operator.clear(),
            }
        }
        let found = pooled(&rows);
        for quantity in &found.quantities {
            for (_, value) in asked(&mut quantity.clone()) {
                let p = value.p.unwrap_or(0.0);
                assert!((0.0..=1.0).contains(&p), "seed {seed}: {value:?}");
                let numbers = [value.value, value.low95, value.high95];
                assert!(numbers.iter().all(|v| !v.is_nan()), "seed {seed}: {value:?}");
            }
        }
    }
}
