//! The test for what a single slow sweep shows and nothing else: the same ramp several times. Its cycles check each other, and a law can be
//! read off some of them and proven on the others.

use super::separation::{ChannelNoise, admissible_forces};
use super::test_profiles::repeated_ramp;
use crate::diagnose::conditioning::{Track, median};
use crate::diagnose::diagnosis::NextTest;
use crate::diagnose::fitting::{FitContext, Node};

/// Fewest cycles of a recording that check each other: one is fitted, one selects, one reports. At half, a single sweep would do; at double, a
/// ramp that was repeated four times would be repeated again.
const LEAST_CYCLES: u32 = 3;
/// Cycles are slow if they are at most this many times as fast as the sweep. The ramp that is proposed takes 60 s, and a sweep up to 240 s. At
/// half, it would be proposed again after such a sweep; at double, sines of 0.1 Hz are slow beside a sweep of 120 s.
const AS_SLOW: f64 = 4.0;

/// `None` if the bench cannot run it, or if a recording has slow cycles already. `recording` is the name of the sweep that is not explained.
pub(super) fn propose(context: &FitContext<'_>, node: &Node, recording: &str) -> Option<NextTest> {
    if has_slow_cycles(&context.data.tracks, recording) {
        return None;
    }
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
            "only {recording} shows the difference, and it is a single sweep: this test repeats a slow ramp. Its cycles show whether the \
             difference comes back, and a law can then be read off them"
        ),
        separation_sigma: None,
        duration_s: motion.duration_s,
    })
}

/// True if a recording repeats a motion about as slow as that of the sweep.
fn has_slow_cycles(tracks: &[Track], sweep: &str) -> bool {
    let usual_mm_s = |t: &Track| median(t.motion.iter().map(|m| m.velocity_mm_s.abs()).collect());
    let sweep = tracks.iter().find(|t| t.name == sweep);
    let most_mm_s = sweep.map_or(0.0, |t| AS_SLOW * usual_mm_s(t));
    let mut repeated = tracks.iter().filter(|t| t.cycles >= LEAST_CYCLES);
    repeated.any(|t| usual_mm_s(t) <= most_mm_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::fitting::case;

    #[test]
    fn a_ramp_that_was_repeated_is_not_repeated_again() {
        let (data, _) = case(|_, _| 0.0);
        let cycles = data.tracks[0].clone();
        let mut ramp = Track {
            name: "ramp".to_owned(),
            cycles: 1,
            ..cycles.clone()
        };
        assert!(has_slow_cycles(&[ramp.clone(), cycles.clone()], "ramp"));
        for motion in &mut ramp.motion {
            motion.velocity_mm_s *= 0.1;
        }
        assert!(!has_slow_cycles(&[ramp, cycles], "ramp"));
    }
}
