//! Acts when samples of a run cannot be brought to the disk: the rig is held before the memory is full, then the run is
//! stopped. It looks at counts only, so that it works as well while the recording thread waits for a disk that stalls.

use std::sync::Arc;
use std::time::Duration;

use super::backlog::Backlog;
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::run_file::RunFileStatus;

/// Time between two looks.
pub(super) const LOOK_PERIOD: Duration = Duration::from_millis(200);
/// The rig is held when this much of a run is not on the disk. The operator has been warned since the first error.
const HOLD_AFTER_S: u64 = 45;
/// The run is stopped when this much is not on the disk. Writer and ring have room for as much again, so unloading is
/// recorded too.
const STOP_AFTER_S: u64 = 60;

/// What to ask of control.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum DiskAction {
    /// Keep the position.
    Hold,
    /// End the run, with this cause.
    Stop(String),
}

/// The watch over the disk of one run.
#[derive(Debug)]
pub(super) struct DiskWatch {
    backlog: Backlog,
    disk: Arc<RunFileStatus>,
    held: bool,
    stopped: bool,
}

impl DiskWatch {
    /// A watch over the samples that control counts in `backlog` and the writer settles in `disk`.
    pub(super) fn new(backlog: Backlog, disk: Arc<RunFileStatus>) -> DiskWatch {
        DiskWatch {
            backlog,
            disk,
            held: false,
            stopped: false,
        }
    }

    /// The writer has ended: there is nothing left to watch.
    pub(super) fn is_over(&self) -> bool {
        self.disk.is_over()
    }

    /// What to ask of control now: each request once, and hold once more if the disk recovered in between.
    pub(super) fn look(&mut self) -> Option<DiskAction> {
        let unsaved_s =
            self.backlog.recorded().saturating_sub(self.disk.settled()) / u64::from(SAMPLE_RATE_HZ);
        let problem = self.disk.problem();
        let cause = problem
            .as_deref()
            .unwrap_or("the disk does not take samples fast enough");
        if unsaved_s >= STOP_AFTER_S && !self.stopped {
            self.stopped = true;
            let text = format!("{unsaved_s} s of samples are not on the disk: {cause}");
            tracing::error!("the run is stopped: {text}");
            return Some(DiskAction::Stop(text));
        }
        if unsaved_s >= HOLD_AFTER_S && !self.held {
            self.held = true;
            tracing::error!("the rig is held: {unsaved_s} s of samples are not on the disk: {cause}");
            return Some(DiskAction::Hold);
        }
        if unsaved_s == 0 {
            self.held = false;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::Recorder;
    use crate::recording::memory::Memory;
    use crate::recording::run_file::RunFileWriter;
    use crate::recording::run_file::test_support::{header, sample};

    /// Seconds at which a run whose disk takes nothing is held and stopped. `saved_s`: until then the disk takes everything.
    fn requests(saved_s: u64, of_s: u64) -> Vec<(u64, &'static str)> {
        let backlog = Backlog::default();
        let folder = tempfile::tempdir().expect("a folder");
        let mut writer = RunFileWriter::create(&folder.path().join("a.leafrun"), &header()).expect("made");
        let mut watch = DiskWatch::new(backlog.clone(), writer.status());
        let mut control = backlog.count_recorded(Memory::default());
        let mut asked = Vec::new();
        for tick in 0..of_s * 1000 {
            control.sample(&sample(tick));
            if tick < saved_s * 1000 {
                // A repeated sample is settled without the disk.
                writer.sample(&sample(0));
            }
            match watch.look() {
                Some(DiskAction::Hold) => asked.push((tick / 1000, "hold")),
                Some(DiskAction::Stop(cause)) => {
                    assert!(cause.contains("60 s of samples are not on the disk"), "{cause}");
                    asked.push((tick / 1000, "stop"));
                }
                _ => {}
            }
        }
        asked
    }

    #[test]
    fn k1_the_rig_is_held_at_45_s_and_the_run_stopped_at_60_s() {
        assert_eq!(requests(0, 70), [(44, "hold"), (59, "stop")]);
        assert_eq!(requests(10, 80), [(54, "hold"), (69, "stop")]);
        assert_eq!(requests(50, 50), []);
        assert_eq!(requests(0, 40), [], "a stall of 40 s is only an alarm");
    }
}
