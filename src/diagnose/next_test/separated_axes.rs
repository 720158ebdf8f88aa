//! The test for a difference that no name explains, or that several names explain: it separates the axis on which the difference lies
//! from those that go together with it in the recordings.

use super::separation::{ChannelNoise, admissible_forces};
use super::test_profiles::{TestMotion, TestProfile, axis_profiles, test_profiles};
use crate::diagnose::diagnosis::{Location, NextTest};
use crate::diagnose::fitting::{FitContext, Node};
use crate::diagnose::search::{AXES, AxisPoint, axis_in_words, confounding, go_together, recorded_points};
use crate::effect::Axis;

/// A shorter test is preferred if two axes go together by at most this much more after it.
const AS_GOOD: f64 = 0.05;

/// The axes of a place that go together in the recordings: the one that was located, and those that cannot be told from it.
struct TiedAxes {
    located: Axis,
    words: String,
    partners: Vec<Axis>,
}

/// How far the axes go together, as the largest of all pairs.
fn most_confounding(points: &[AxisPoint], tied: &TiedAxes) -> f64 {
    let pairs = tied
        .partners
        .iter()
        .map(|&partner| confounding(points, [tied.located, partner]));
    pairs.fold(0.0, f64::max)
}

/// The first located axis that goes together with others. The force is left out: it follows from the displacement in every test.
fn tied_axes(points: &[AxisPoint], places: &[Location]) -> Option<TiedAxes> {
    places.iter().find_map(|place| {
        let others = AXES
            .into_iter()
            .filter(|a| ![place.axis, Axis::ForceN].contains(a));
        let partners: Vec<Axis> = others
            .filter(|&other| go_together(points, [place.axis, other]))
            .collect();
        (!partners.is_empty()).then(|| TiedAxes {
            located: place.axis,
            words: place.words.clone(),
            partners,
        })
    })
}

/// Points of a test on the axes. All tests count as one recording.
fn points_of(motion: &TestMotion) -> Vec<AxisPoint> {
    let mut points = Vec::with_capacity(motion.points.len());
    let mut turns = motion.turns.iter().peekable();
    let (mut turned_mm, mut turned, mut before_s) = (motion.points[0].displacement_mm, 0, 0.0);
    for (k, p) in motion.points.iter().enumerate() {
        let duration_s = p.time_s - before_s;
        before_s = p.time_s;
        points.push(AxisPoint {
            at: AXES.map(|axis| match axis {
                Axis::DistanceFromReversalMm => (p.displacement_mm - turned_mm).abs(),
                Axis::DisplacementMm => p.displacement_mm,
                Axis::VelocityMmS => p.motion.velocity_mm_s.abs(),
                Axis::Cycle => 1.0 + f64::from(turned / 2),
                Axis::TimeS => p.time_s,
                _ => 0.0,
            }),
            direction: if turned % 2 == 0 { 1.0 } else { -1.0 },
            share: duration_s / motion.duration_s,
        });
        if turns.next_if(|turn| **turn == k).is_some() {
            (turned_mm, turned) = (p.displacement_mm, turned + 1);
        }
    }
    points
}

/// The test that separates the axes of a located difference best, or why there is none.
pub(super) fn propose(
    context: &FitContext<'_>,
    node: &Node,
    places: &[Location],
) -> Result<NextTest, String> {
    let recorded = recorded_points(context.data);
    if places.is_empty() {
        return Err(
            "the difference was not located on any axis, so no test is better than another".to_owned(),
        );
    }
    let Some(tied) = tied_axes(&recorded, places) else {
        return Err("the recordings separate all axes of the place that was located: no further test would add to them, so \
                    inspect the specimen at that place"
            .to_owned());
    };
    let noise = ChannelNoise::of(context);
    let range = noise.test_range(context);
    let mut tests = axis_profiles(&range);
    tests.extend(test_profiles(&range));
    let judged = context.parallel_map(&tests, |test| {
        let motion = test.motion(&range, context.limits.as_ref())?;
        let mut points = recorded.clone();
        points.extend(points_of(&motion));
        Some((most_confounding(&points, &tied), motion))
    });
    let judged = tests.iter().zip(judged);
    let mut open: Vec<Judged<'_>> = judged
        .filter_map(|(test, judged)| judged.map(|(after, motion)| Judged { test, after, motion }))
        .collect();
    let before = most_confounding(&recorded, &tied);
    let structure = context.structure(node.attached.clone());
    // The force is computed for the best test only: a slow model takes long for all of them.
    while let Some(best) = best(&open, before) {
        let chosen = open.swap_remove(best);
        if admissible_forces(context, &structure, &node.values, &chosen.motion).is_some() {
            return Ok(in_words(&tied, &chosen, before));
        }
    }
    Err("no profile within the limits separates the axes that go together in the recordings".to_owned())
}

/// A test with what it does to the axes.
struct Judged<'t> {
    test: &'t TestProfile,
    /// How far the axes go together when its points are added.
    after: f64,
    motion: TestMotion,
}

/// Index of the shortest of the tests that separate the axes best.
fn best(open: &[Judged<'_>], before: f64) -> Option<usize> {
    let least = open.iter().map(|j| j.after).fold(f64::INFINITY, f64::min);
    let good = |j: &Judged<'_>| j.after <= least + AS_GOOD && j.after < before - AS_GOOD;
    (0..open.len())
        .filter(|&k| good(&open[k]))
        .min_by(|&a, &b| open[a].motion.duration_s.total_cmp(&open[b].motion.duration_s))
}

/// The test with the reason for it.
fn in_words(tied: &TiedAxes, chosen: &Judged<'_>, before: f64) -> NextTest {
    let axis = axis_in_words(tied.located);
    let partners: Vec<&str> = tied.partners.iter().map(|&a| axis_in_words(a)).collect();
    let partners = partners.join(" and ");
    NextTest {
        profile_toml: chosen.test.toml(&format!("Separates {axis} from {partners}.")),
        why: format!(
            "{}; but in the recordings {axis} and {partners} go together to {:.0} %, so the difference may lie on either: this test varies \
             one against the other, to {:.0} %",
            tied.words,
            100.0 * before,
            100.0 * chosen.after
        ),
        separation_sigma: None,
        duration_s: chosen.motion.duration_s,
    }
}
