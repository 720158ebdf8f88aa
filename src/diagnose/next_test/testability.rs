//! The test for effects that the recordings cannot show: the baseline's own parameters imitate them there, but not over the test.

use nalgebra::{DMatrix, DVector};

use super::separation::{ChannelNoise, LinearisedRival, Rival, admissible_forces, forces};
use super::test_profiles::{TestMotion, TestProfile, test_profiles};
use crate::diagnose::diagnosis::NextTest;
use crate::diagnose::fitting::{Attached, FitContext, Node, insert_group};
use crate::diagnose::judgement::TESTABLE;

/// An effect that the recordings cannot show, in one of the sizes that a search starts from.
struct UnseenEffect<'c> {
    candidate: &'c Attached,
    start: Vec<f64>,
}

/// The shortest test of those that show most of the effects `codes`, or why there is none. `node` explains the recordings.
///
/// A slow model is left out: it would be run once for each parameter, effect and test.
pub(super) fn propose(
    context: &FitContext<'_>,
    node: &Node,
    codes: &[String],
) -> Result<Option<NextTest>, String> {
    if context.setup.model.slow || codes.is_empty() {
        return Ok(None);
    }
    let none = || {
        format!(
            "the recordings cannot show {}, and no profile within the limits can: the baseline's own parameters imitate it over each of them",
            spoken(codes)
        )
    };
    shortest(context, node, codes).map(Some).ok_or_else(none)
}

/// The shortest test of those that show most of the effects `codes`; `None` if none shows any.
fn shortest(context: &FitContext<'_>, node: &Node, codes: &[String]) -> Option<NextTest> {
    let noise = ChannelNoise::of(context);
    let range = noise.test_range(context);
    let rival = Rival {
        code: "nothing",
        node,
        lack: 0.0,
    };
    let baseline = LinearisedRival::new(context, &rival)?;
    let unseen: Vec<UnseenEffect<'_>> = unseen(context, node, codes);
    let tests = test_profiles(&range);
    let judged = context.parallel_map(&tests, |test| {
        let motion = test.motion(&range, context.limits.as_ref())?;
        let shown = shown(context, &baseline, &unseen, &motion, &noise)?;
        (!shown.is_empty()).then_some((shown, motion.duration_s))
    });
    let able = tests
        .iter()
        .zip(judged)
        .filter_map(|(test, judged)| Some((test, judged?)));
    let (test, (codes, duration_s)) =
        able.min_by(|(_, (a, a_s)), (_, (b, b_s))| (b.len().cmp(&a.len())).then(a_s.total_cmp(b_s)))?;
    Some(in_words(test, &codes, duration_s))
}

/// The codes as a sentence has them.
fn spoken(codes: &[impl AsRef<str>]) -> String {
    let names: Vec<String> = codes.iter().map(|code| code.as_ref().replace('_', " ")).collect();
    names.join(" and ")
}

fn in_words(test: &TestProfile, codes: &[&str], duration_s: f64) -> NextTest {
    let names = spoken(codes);
    NextTest {
        profile_toml: test.toml(&format!("Shows {names}.")),
        why: format!(
            "nothing in the recordings asks for a further test, but they cannot show {names}, because the baseline's own parameters imitate \
             it there; over this profile they cannot"
        ),
        separation_sigma: None,
        duration_s,
    }
}

/// The effects in all their starts, within their bounds.
fn unseen<'c>(context: &'c FitContext<'_>, node: &Node, codes: &[String]) -> Vec<UnseenEffect<'c>> {
    let wanted = |a: &&Attached| {
        codes.iter().any(|code| code == a.effect.code)
            && node.attached.iter().all(|own| own.effect.code != a.effect.code)
    };
    let starts = |candidate: &'c Attached| {
        (candidate.effect.starts)(&context.span)
            .into_iter()
            .map(move |mut start| {
                for (v, p) in start.iter_mut().zip(&candidate.parameters) {
                    *v = v.clamp(p.bounds[0], p.bounds[1]);
                }
                UnseenEffect { candidate, start }
            })
    };
    context
        .setup
        .candidates
        .iter()
        .filter(wanted)
        .flat_map(starts)
        .collect()
}

/// Codes of the effects of which the baseline, refitted to recordings and test together, leaves more than it can imitate.
fn shown(
    context: &FitContext<'_>,
    baseline: &LinearisedRival<'_, '_>,
    unseen: &[UnseenEffect<'_>],
    motion: &TestMotion,
    noise: &ChannelNoise,
) -> Option<Vec<&'static str>> {
    let values = &baseline.rival.node.values;
    let force_n = admissible_forces(context, &baseline.structure, values, motion)?;
    let weights = noise.weights(motion, &force_n);
    let here = force_n.component_mul(&weights);
    let jacobian = baseline.jacobian(context, motion, &weights, &here)?;
    let recorded = baseline.structure.fitted(values)?;
    let all = stacked(&baseline.known, &jacobian);
    let mut normal = all.tr_mul(&all);
    for i in 0..normal.nrows() {
        // A parameter without effect must not make the matrix singular.
        normal[(i, i)] = normal[(i, i)] * (1.0 + 1e-9) + 1e-9;
    }
    let factor = normal.cholesky()?;
    let mut codes: Vec<&'static str> = Vec::new();
    for h in unseen {
        let code = h.candidate.effect.code;
        let with = baseline.structure.with(h.candidate);
        let moved = insert_group(values, &h.start);
        let (Some(over_recordings), Some(over_test)) =
            (with.fitted(&moved), forces(context, &with, &moved, motion))
        else {
            continue;
        };
        let signature = joined(
            &(&recorded - over_recordings),
            &(over_test.component_mul(&weights) - &here),
        );
        let left = &signature - &all * factor.solve(&all.tr_mul(&signature));
        if left.norm() > TESTABLE * signature.norm() && !codes.contains(&code) {
            codes.push(code);
        }
    }
    Some(codes)
}

/// Rows of the recordings above rows of the test. A residual falls where the force rises, so the first change sign.
fn stacked(recorded: &DMatrix<f64>, test: &DMatrix<f64>) -> DMatrix<f64> {
    let mut all = DMatrix::zeros(recorded.nrows() + test.nrows(), recorded.ncols());
    all.rows_mut(0, recorded.nrows()).copy_from(&-recorded);
    all.rows_mut(recorded.nrows(), test.nrows()).copy_from(test);
    all
}

fn joined(one: &DVector<f64>, other: &DVector<f64>) -> DVector<f64> {
    DVector::from_iterator(one.len() + other.len(), one.iter().chain(other.iter()).copied())
}
