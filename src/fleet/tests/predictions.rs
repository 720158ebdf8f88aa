//! Coverage of predicted quantities on synthetic labs.

use super::synthetic::SyntheticLab;
use crate::fleet::predict::coverage::{FleetCoverage, coverage};

/// Estimates inside 50 % and 95 %, those inside 95 % of specimens without earlier runs, and their numbers.
#[derive(Debug, Default)]
struct InsideCount {
    inside: [usize; 2],
    of: usize,
    unseen: [usize; 2],
}

impl InsideCount {
    fn add(&mut self, found: &FleetCoverage) {
        for (sum, share) in self.inside.iter_mut().zip(&found.all.shares) {
            *sum += share.inside;
        }
        self.of += found.all.shares[0].of;
        self.unseen[0] += found.all.unseen95.inside;
        self.unseen[1] += found.all.unseen95.of;
    }

    fn share(&self, level: usize) -> f64 {
        self.inside[level] as f64 / self.of as f64
    }
}

fn inside(lab: &SyntheticLab, seeds: std::ops::Range<u64>) -> InsideCount {
    let mut count = InsideCount::default();
    seeds.for_each(|seed| count.add(&coverage(&lab.table(seed))));
    println!(
        "{:.4} in 50 %, {:.4} in 95 %: {count:?}",
        count.share(0),
        count.share(1)
    );
    count
}

fn lab(normal: bool) -> SyntheticLab {
    SyntheticLab {
        specimens: 24,
        runs: 144,
        force_gain: vec![0.0, 0.01, 0.0],
        delay_ms: vec![0.0, 0.0, 1.5],
        friction_growth: 0.002,
        normal,
        ..SyntheticLab::default()
    }
}

#[test]
fn predictions_hold_what_they_say() {
    for normal in [true, false] {
        let count = inside(&lab(normal), 9000..9008);
        // 93 to 97 % are wanted; estimates of one lab are not independent.
        assert!((0.93..=0.97).contains(&count.share(1)), "{normal}: {count:?}");
        assert!((0.45..=0.60).contains(&count.share(0)), "{normal}: {count:?}");
    }
}

/// `cargo test --lib predictions_of_many_labs -- --ignored --nocapture` prints the figures of docs/fleet.md.
#[test]
#[ignore = "takes some minutes"]
fn predictions_of_many_labs_hold_what_they_say() {
    for normal in [true, false] {
        let count = inside(&lab(normal), 9100..9200);
        assert!((0.93..=0.97).contains(&count.share(1)), "{normal}: {count:?}");
    }
}

#[test]
fn a_run_is_predicted_from_earlier_runs_only() {
    let rows = lab(false).table(9300);
    let all = coverage(&rows);
    let mut starts: Vec<_> = rows.iter().map(|row| row.started_utc).collect();
    starts.sort();
    let middle = starts[starts.len() / 2];
    let early: Vec<_> = rows
        .iter()
        .filter(|row| row.started_utc < middle)
        .cloned()
        .collect();
    let found = coverage(&early);
    assert!(found.runs.len() > 50);
    for run in &found.runs {
        let again = all
            .runs
            .iter()
            .find(|r| r.run_id == run.run_id && r.predicted.quantity == run.predicted.quantity);
        assert_eq!(again.expect("predicted"), run);
    }
}
