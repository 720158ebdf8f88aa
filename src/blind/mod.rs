//! Blind test of the diagnosis: cases of `truth` are diagnosed without their labels, then the labels are opened and the answers
//! are scored.
//!
//! `seal` hashes the labels, `score` compares one `answer` with its label, `statistics` and `requirements` evaluate many scores,
//! `page`, `by_world` and `world_figures` write the results as text. `cli` writes the files and shows the progress.

mod answer;
pub(crate) mod by_world;
pub(crate) mod page;
pub(crate) mod requirements;
pub(crate) mod score;
pub(crate) mod seal;
pub(crate) mod settle;
pub(crate) mod statistics;
mod world_figures;

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use rayon::prelude::*;

use crate::diagnose::note::NoteKind;
use crate::diagnose::{
    Baseline, ConditionError, DiagnoseError, DiagnoseOptions, Diagnosis, TurnedSign, diagnose,
};
use crate::model::equivalent;
use crate::recording::Recording;
use crate::truth::{BaselineSettings, Case, Family, World};

pub(crate) use answer::Answer;
pub(crate) use score::CaseScore;
pub(crate) use seal::SealedLabel;

/// Settings of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BlindRequest {
    /// Number of cases.
    pub cases: u64,
    /// Seed of all cases.
    pub seed: u64,
    /// Equations of the truth.
    pub world: World,
    /// Strength of every effect in detection limits; `None` to draw it.
    pub strength: Option<f64>,
    /// Only the cases of this family. They keep their numbers.
    pub family: Option<Family>,
    /// How many further case numbers are searched for cases with a look-alike. These cases count only for the rows of
    /// `--run-next`, because too few of the others need further tests.
    pub look_alikes: u64,
    /// Number of threads. Each case runs on one thread.
    pub threads: usize,
}

impl BlindRequest {
    /// Numbers of all cases in the run.
    pub(crate) fn numbers(&self) -> Vec<u64> {
        let family_of = |n: &u64| Family::of(self.world, *n);
        let drawn = (0..self.cases).filter(|n| self.family.is_none_or(|f| family_of(n) == f));
        let beyond =
            (self.cases..self.cases + self.look_alikes).filter(|n| family_of(n) == Family::Confounded);
        drawn.chain(beyond).collect()
    }

    /// The case with this number.
    pub(crate) fn case(&self, number: u64) -> Case {
        Case::draw(self.world, self.seed, number, self.strength)
    }

    /// Splits into the scores of the first `cases` numbers and those of the further cases with a look-alike.
    pub(crate) fn split<'s>(&self, scores: &'s [CaseScore]) -> (&'s [CaseScore], &'s [CaseScore]) {
        scores.split_at(scores.partition_point(|s| s.label.number < self.cases))
    }
}

/// The baseline for a case.
pub(crate) fn baseline(settings: &BaselineSettings) -> Baseline {
    let mut baseline = Baseline::of(&equivalent::MODEL);
    baseline.known = settings
        .known
        .as_ref()
        .map(|codes| codes.iter().map(|c| (*c).to_owned()).collect());
    baseline.start = settings.tuned.map(|values| values.to_vec());
    if let Some(speed) = settings.smoothing_mm_s {
        baseline.structure = equivalent::rate_dependent_friction(speed);
    }
    baseline
}

/// Diagnoses recordings of a case with its baseline and its bench limits, without its label.
pub(crate) fn examine(
    case: &Case,
    recordings: &[Recording],
    threads: usize,
) -> Result<Diagnosis, DiagnoseError> {
    let options = DiagnoseOptions {
        threads,
        limits: Some(settle::limits(case)),
        ..DiagnoseOptions::default()
    };
    diagnose(recordings, &baseline(&case.baseline), &options, &mut |_, _| {})
}

/// Draws, seals, diagnoses and scores every case. Calls `sealed` with all sealed labels before the first diagnosis, and `done`
/// with the number of finished cases after each case.
pub(crate) fn run(
    request: &BlindRequest,
    sealed: &mut dyn FnMut(&[SealedLabel]),
    done: &(dyn Fn(u64) + Sync),
) -> Result<Vec<CaseScore>, String> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(request.threads.max(1))
        .build()
        .map_err(|e| {
            format!(
                "{} threads cannot be started ({e}): close other programs and repeat the command",
                request.threads
            )
        })?;
    let labels: Vec<SealedLabel> = pool.install(|| {
        let numbers = request.numbers().into_par_iter().with_max_len(1);
        numbers
            .map(|n| SealedLabel::new(&request.case(n).label, request.seed))
            .collect()
    });
    sealed(&labels);
    let finished = AtomicU64::new(0);
    let scores: Vec<Result<CaseScore, String>> = pool.install(|| {
        // One case at a time for each thread: the cases take very different times.
        let labels = labels.par_iter().with_max_len(1);
        labels
            .map(|label| {
                let score = on_own_thread(|| scored(request.case(label.number), label));
                done(finished.fetch_add(1, Ordering::Relaxed) + 1);
                score
            })
            .collect()
    });
    scores.into_iter().collect()
}

/// Runs `work` on a new thread and waits for it. A diagnosis has a rayon pool of its own; a rayon thread that waits for another
/// pool starts further jobs meanwhile, so the duration of a case would contain other cases.
fn on_own_thread<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    let done = std::thread::scope(|scope| scope.spawn(work).join());
    done.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

/// Diagnoses a case on one core. Where a channel is refused for its sign, the sign is turned as the error says, and the second value is
/// true.
fn examine_as_told(case: &Case) -> (Result<Diagnosis, DiagnoseError>, bool) {
    let first = examine(case, &case.recordings, 1);
    let Err(DiagnoseError::Condition(ConditionError::Polarity { sign, .. })) = first else {
        return (first, false);
    };
    let mut turned = case.recordings.clone();
    for recording in &mut turned {
        recording.turn_signs(sign != TurnedSign::Displacement, sign != TurnedSign::Force);
    }
    (examine(case, &turned, 1), true)
}

/// Diagnoses a case on one core, runs its further tests if it needs them, opens its label and scores the answer.
fn scored(case: Case, label: &SealedLabel) -> Result<CaseScore, String> {
    let begun = Instant::now();
    let (first, turned) = examine_as_told(&case);
    let seconds = begun.elapsed().as_secs_f64();
    let mut answer = first.as_ref().map(Answer::of).map_err(ToString::to_string);
    if let (Ok(answer), true) = (&mut answer, turned) {
        answer.notes.push(NoteKind::Polarity);
    }
    let settling = match first {
        Ok(first) if settle::needs_further_tests(&case, &Answer::of(&first)) => {
            Some(settle::settle(&case, first))
        }
        _ => None,
    };
    if !label.matches(&case.label) {
        return Err(format!(
            "case {}: the label differs from the sealed label",
            label.number
        ));
    }
    Ok(CaseScore::new(case.label, answer, seconds, settling))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a technician does whose recordings are refused.
    #[test]
    fn a_refused_sign_is_turned_as_the_error_says() {
        let mut cases = (2..).step_by(5).map(|n| Case::draw(World::BoucWen, 2, n, None));
        let turned = |case: &Case| case.label.nuisance == Some("polarity");
        let case = cases.find(turned).expect("one of many");
        assert!(examine(&case, &case.recordings, 1).is_err());
        let (diagnosis, turned) = examine_as_told(&case);
        assert!(turned && diagnosis.is_ok());
    }

    #[test]
    fn further_cases_with_a_look_alike_are_drawn_and_split_off() {
        let request = BlindRequest {
            cases: 40,
            seed: 1,
            world: World::Own,
            strength: None,
            family: None,
            look_alikes: 160,
            threads: 1,
        };
        let numbers = request.numbers();
        assert!(numbers[..40].iter().copied().eq(0..40));
        // 1 of 20 cases is confounded.
        assert_eq!(numbers.len(), 40 + 160 / 20);
        assert!(
            numbers[40..]
                .iter()
                .all(|&n| Family::of(World::Own, n) == Family::Confounded)
        );
        let scores: Vec<CaseScore> = [39, 40]
            .map(|number| {
                let mut score = score::tests::score(&["inertia"], &["inertia"], &[]);
                score.label.number = number;
                score
            })
            .into();
        let (drawn, beyond) = request.split(&scores);
        assert_eq!((drawn[0].label.number, beyond[0].label.number), (39, 40));
    }
}
