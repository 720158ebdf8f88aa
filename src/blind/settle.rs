//! `diagnose --run-next` on a sealed case: it records the proposed test with the specimen and the sensors of the case, adds
//! the recording and repeats the diagnosis.

use std::time::Instant;

use super::{Answer, examine};
use crate::diagnose::Diagnosis;
use crate::profile::{Player, Profile, ProfileLimits};
use crate::truth::{Case, Family};

/// Largest number of further tests, the default of `--rounds`.
pub(crate) const ROUNDS: usize = 4;
/// Rate of the commands of the bench, Hz.
const COMMANDS_HZ: f64 = 1000.0;

/// The further tests of a case and their result.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct Settling {
    /// Names of the profiles that were run.
    pub tests: Vec<String>,
    /// Named effects and their alternatives: before the first test, and after each test.
    pub path: Vec<String>,
    /// The last answer; `None` if the recordings were refused.
    pub answer: Option<Answer>,
    /// Reason why there was no further test.
    pub ended: String,
    /// Duration of all tests and diagnoses on one core, s.
    pub seconds: f64,
}

/// True if a case needs further tests: it has a look-alike, and the answer names something other than exactly the truth.
pub(crate) fn needs_further_tests(case: &Case, first: &Answer) -> bool {
    let truth: Vec<&str> = case.label.hidden.iter().map(|h| h.code).collect();
    let names_something = first.word() != "none";
    case.label.family == Family::Confounded && names_something && !first.is_exactly(&truth)
}

/// Limits of the bench for further tests: the speed of the shipped mock bench, and a quarter more travel than was recorded.
pub(crate) fn limits(case: &Case) -> ProfileLimits {
    let [top_mm, top_n] = case.label.top;
    ProfileLimits {
        force_min_n: -200.0,
        force_max_n: 1.5 * top_n,
        displacement_min_mm: -1.0,
        displacement_max_mm: 1.25 * top_mm,
        velocity_max_mm_s: 150.0,
        acceleration_max_mm_s2: 3000.0,
    }
}

/// Runs the tests that follow a first diagnosis.
pub(crate) fn settle(case: &Case, first: Diagnosis) -> Settling {
    let begun = Instant::now();
    let mut recordings = case.recordings.clone();
    let mut diagnosis = first;
    let mut settling = Settling {
        tests: Vec::new(),
        path: vec![Answer::of(&diagnosis).in_words()],
        answer: None,
        ended: String::new(),
        seconds: 0.0,
    };
    settling.ended = loop {
        if let Some(why) = diagnosis.settled() {
            break why.to_owned();
        }
        let next = match diagnosis.next() {
            Err(why) => break why.to_owned(),
            Ok(_) if settling.tests.len() == ROUNDS => break format!("{ROUNDS} tests were run"),
            Ok(next) => &next.profile_toml,
        };
        let (name, points) = match motion(next) {
            Err(why) => break why,
            Ok(motion) => motion,
        };
        settling.tests.push(name);
        recordings.push(case.play(&points, settling.tests.len() as u32));
        diagnosis = match examine(case, &recordings, 1) {
            Ok(diagnosis) => diagnosis,
            Err(refused) => {
                settling.seconds = begun.elapsed().as_secs_f64();
                settling.ended = refused.to_string();
                return settling;
            }
        };
        settling.path.push(Answer::of(&diagnosis).in_words());
    };
    settling.answer = Some(Answer::of(&diagnosis));
    settling.seconds = begun.elapsed().as_secs_f64();
    settling
}

/// Name of a profile, and its commands for a bench at rest at zero: time in s, displacement in mm.
fn motion(profile_toml: &str) -> Result<(String, Vec<[f64; 2]>), String> {
    let play = || {
        let profile = Profile::from_toml(profile_toml, "next-test.toml")?;
        let mut player = Player::new(&profile, 0.0, COMMANDS_HZ)?;
        let mut points = vec![[0.0, 0.0]];
        while let Some(slot) = player.next() {
            points.push([points.len() as f64 / COMMANDS_HZ, slot.command.value()]);
        }
        Ok((profile.name, points))
    };
    play().map_err(|e: crate::profile::ProfileError| format!("the bench cannot run the next test: {e}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth::World;

    #[test]
    fn a_profile_becomes_the_motion_of_the_bench() {
        let text = "name = \"up\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 4.0\nduration_s = 2.0\n";
        let (name, points) = motion(text).expect("a profile");
        assert_eq!((name.as_str(), points.len()), ("up", 2001));
        assert_eq!((points[0], points[2000]), ([0.0, 0.0], [2.0, 4.0]));
        assert!((points[1000][1] - 2.0).abs() < 1e-9);
        assert!(motion("name = 3").is_err());
    }

    #[test]
    fn only_a_claim_that_is_not_exactly_the_truth_needs_further_tests() {
        let case = Case::draw(World::Own, 1, 11, Some(5.0));
        assert_eq!(case.label.family, Family::Confounded);
        let code = case.label.hidden[0].code;
        let answer = |named: &[&str], others: &[&str]| {
            super::super::score::tests::score(&["inertia"], named, others)
                .answer
                .expect("answered")
        };
        assert!(
            !needs_further_tests(&case, &answer(&[code], &[])),
            "the answer is the truth"
        );
        assert!(
            !needs_further_tests(&case, &answer(&[], &[])),
            "nothing is claimed"
        );
        assert!(needs_further_tests(&case, &answer(&[code], &["backlash"])));
        assert!(
            needs_further_tests(&case, &answer(&["backlash"], &[])),
            "the answer is wrong and has no alternative"
        );
    }
}
