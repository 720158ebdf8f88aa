//! Proof on concealed effects: sealed cases of `truth`, diagnosed without sight of their labels, opened and scored after.
//!
//! `seal` holds the labels, `score` judges one answer, `figures` puts many together, `page` prints them. Files and progress
//! bars are for the command line.

pub(crate) mod figures;
pub(crate) mod page;
pub(crate) mod score;
pub(crate) mod seal;
pub(crate) mod settle;

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use crate::diagnose::{Baseline, DiagnoseError, DiagnoseOptions, Diagnosis, diagnose};
use crate::model::equivalent;
use crate::recording::Recording;
use crate::truth::{Case, Family, Start};

pub(crate) use score::{Answer, Mark};
pub(crate) use seal::Seal;

/// The run that is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BlindRequest {
    /// How many cases.
    pub cases: u64,
    /// Seed of all of them.
    pub seed: u64,
    /// Strength of every effect; drawn where `None`.
    pub strength: Option<f64>,
    /// Only the cases of this family, under the numbers that they have among all.
    pub family: Option<Family>,
    /// Numbers after `cases` among which those with a look-alike are examined too: the row of `--run-next` alone counts them,
    /// for too few of the others have anything to settle.
    pub look_alikes: u64,
    /// Cores; one case runs on one.
    pub threads: usize,
}

impl BlindRequest {
    /// Numbers of the cases that are examined.
    pub(crate) fn numbers(&self) -> Vec<u64> {
        let drawn = (0..self.cases).filter(|&n| self.family.is_none_or(|f| Family::of(n) == f));
        let beyond =
            (self.cases..self.cases + self.look_alikes).filter(|&n| Family::of(n) == Family::Confounded);
        drawn.chain(beyond).collect()
    }

    /// The marks of the cases asked for, and those of the look-alikes after them.
    pub(crate) fn split<'m>(&self, marks: &'m [Mark]) -> (&'m [Mark], &'m [Mark]) {
        marks.split_at(marks.partition_point(|m| m.label.number < self.cases))
    }
}

/// The baseline that a case's start tells.
pub(crate) fn baseline(start: &Start) -> Baseline {
    let mut baseline = Baseline::of(&equivalent::MODEL);
    baseline.known = start
        .known
        .as_ref()
        .map(|codes| codes.iter().map(|c| (*c).to_owned()).collect());
    baseline.start = start.tuned.map(|values| values.to_vec());
    if let Some(speed) = start.smoothing_mm_s {
        baseline.structure = equivalent::rate_dependent_friction(speed);
    }
    baseline
}

/// Diagnoses recordings of a case with what it tells of its start and its bench, and nothing of its label.
pub(crate) fn examine(
    case_shown: &Case,
    recordings: &[Recording],
    threads: usize,
) -> Result<Diagnosis, DiagnoseError> {
    let options = DiagnoseOptions {
        threads,
        limits: Some(settle::limits(case_shown)),
        ..DiagnoseOptions::default()
    };
    diagnose(recordings, &baseline(&case_shown.start), &options, &mut |_, _| {})
}

/// Draws, seals, diagnoses, opens and marks every case. `sealed` hears all seals before the first diagnosis begins;
/// `done` hears how many cases are finished.
pub(crate) fn run(
    request: &BlindRequest,
    sealed: &mut dyn FnMut(&[Seal]),
    done: &(dyn Fn(u64) + Sync),
) -> Result<Vec<Mark>, String> {
    let numbers = request.numbers();
    let seals = side_by_side(&numbers, request.threads, &|&n| {
        seal::Seal::of(&Case::draw(request.seed, n, request.strength).label, request.seed)
    });
    sealed(&seals);
    let finished = AtomicU64::new(0);
    let marks = side_by_side(&seals, request.threads, &|seal| {
        let n = seal.number;
        let case = Case::draw(request.seed, n, request.strength);
        let begun = Instant::now();
        let first = examine(&case, &case.recordings, 1);
        let seconds = begun.elapsed().as_secs_f64();
        let answer = first.as_ref().map(Answer::of).map_err(ToString::to_string);
        let settling = match first {
            Ok(first) if settle::is_open(&case, &Answer::of(&first)) => Some(settle::settle(&case, first)),
            _ => None,
        };
        let opened = seal.open(&case.label);
        done(finished.fetch_add(1, Ordering::Relaxed) + 1);
        (
            n,
            opened.then(|| Mark::new(case.label, answer, seconds, settling)),
        )
    });
    marks
        .into_iter()
        .map(|(n, mark)| mark.ok_or_else(|| format!("case {n}: the label is not the one that was sealed")))
        .collect()
}

/// Results in the order of `list`, computed on several cores.
fn side_by_side<T: Sync, R: Send>(list: &[T], threads: usize, f: &(dyn Fn(&T) -> R + Sync)) -> Vec<R> {
    let next = AtomicU64::new(0);
    let results = Mutex::new(Vec::with_capacity(list.len()));
    std::thread::scope(|scope| {
        for _ in 0..threads.max(1) {
            scope.spawn(|| {
                while let Some((i, item)) = {
                    let i = next.fetch_add(1, Ordering::Relaxed) as usize;
                    list.get(i).map(|item| (i, item))
                } {
                    let result = f(item);
                    if let Ok(mut results) = results.lock() {
                        results.push((i, result));
                    }
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap_or_default();
    results.sort_by_key(|(i, _)| *i);
    results.into_iter().map(|(_, r)| r).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn look_alikes_beyond_the_cases_are_drawn_and_kept_apart() {
        let request = BlindRequest {
            cases: 40,
            seed: 1,
            strength: None,
            family: None,
            look_alikes: 160,
            threads: 1,
        };
        let numbers = request.numbers();
        assert!(numbers[..40].iter().copied().eq(0..40));
        // Every kind comes once in 20.
        assert_eq!(numbers.len(), 40 + 160 / 20);
        assert!(numbers[40..].iter().all(|&n| Family::of(n) == Family::Confounded));
        let marks: Vec<Mark> = [39, 40]
            .map(|number| {
                let mut mark = score::tests::mark(&["inertia"], &["inertia"], &[]);
                mark.label.number = number;
                mark
            })
            .into();
        let (drawn, beyond) = request.split(&marks);
        assert_eq!((drawn[0].label.number, beyond[0].label.number), (39, 40));
    }
}
