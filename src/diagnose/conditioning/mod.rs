//! First room: what the instruments recorded becomes tracks that every later room can rely on. It uses no model.
//!
//! | file | what it does |
//! |---|---|
//! | `samples` | the usable samples of a recording, each imperfection with a `note` (`spikes`, `gaps`, `clipping`, `vibration`, `polarity`) |
//! | `smoothing` | displacement without noise, with speed and acceleration |
//! | `turning_points`, `travel` | where the motion turned, and the travel since then |
//! | `thinning` | bins of samples, one for each point |
//! | `condition`, `track` | all of these together make a track |
//! | `splits` | what each point is used for |

mod clipping;
mod condition;
mod gaps;
mod polarity;
mod samples;
mod smoothing;
mod spikes;
mod splits;
mod thinning;
mod track;
mod travel;
mod turning_points;
mod vibration;

pub(in crate::diagnose) use condition::LARGEST_AVERAGING;
#[cfg(test)]
pub(in crate::diagnose) use smoothing::tests::noisy;
pub(in crate::diagnose) use smoothing::{median, noise, range};
pub(in crate::diagnose) use track::Track;

use crate::diagnose::error::ConditionError;
use crate::recording::Recording;

/// Tracks of recordings of one rig, each of about `budget` points at most, with the use of every point.
pub(in crate::diagnose) fn tracks(
    recordings: &[Recording],
    budget: usize,
) -> Result<Vec<Track>, ConditionError> {
    let mut tracks = condition::condition(recordings, budget)?;
    splits::assign_splits(&mut tracks);
    Ok(tracks)
}
