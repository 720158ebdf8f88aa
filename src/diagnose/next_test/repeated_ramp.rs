//! The test for what a single slow sweep shows and nothing else: the same ramp several times. Its cycles check each other, and a law can be
//! read off some of them and proven on the others.

use super::separation::{ChannelNoise, admissible_forces};
use super::test_profiles::repeated_ramp;
use crate::diagnose::diagnosis::NextTest;
use crate::diagnose::fitting::{FitContext, Node};

/// `None` if the bench cannot run it. `recording` is the name of the sweep that is not explained.
pub(super) fn propose(context: &FitContext<'_>, node: &Node, recording: &str) -> Option<NextTest> {
    let range = ChannelNoise::of(context).test_range(context);
    let test = repeated_ramp(&range);
    let motion = test.motion(&range, context.limits.as_ref())?;
    admissible_forces(
        context,
        &context.structure(node.attached.clone()),
        &node.values,
        &motion,
    )?;
    Some(NextTest {
        profile_toml: test.toml("Repeats a slow ramp, so that its cycles check each other."),
        why: format!(
            "only {recording} shows the difference, and it is a single sweep: this test repeats a slow ramp, so that some of its cycles show \
             whether the difference is in the others, too, and a law can be read off it"
        ),
        separation_sigma: None,
        duration_s: motion.duration_s,
    })
}
