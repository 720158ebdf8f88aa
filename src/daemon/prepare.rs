//! Prepares a run until control can start it: profile, plan check, disk space, run file, recording thread. Nothing moves yet,
//! and a run that is withdrawn leaves nothing behind.

use std::path::PathBuf;
use std::sync::Arc;

use jiff::tz::TimeZone;

use super::backlog::{Backlog, Counted};
use super::client_types::StartRun;
use super::error::ApiError;
use super::progress::ProgressRecorder;
use super::resume::{self, ChosenProfile};
use super::state::DaemonState;
use super::wanted::Wanted;
use super::{header, permission, plan, store};
use crate::config::Bench;
use crate::control::run::RunOrder;
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::Header;
use crate::recording::recorder::{self, FanOut, RecorderInput, RecorderThread};
use crate::recording::run_file::{self, RunFileStatus, RunFileWriter, check_space};
use crate::twin::Twin;

/// A run that is ready to start: its file is open and its recording thread waits for samples.
pub(super) struct PreparedRun {
    pub order: RunOrder,
    pub file: NewRunFile,
    pub disk: Arc<RunFileStatus>,
    pub input: Counted<RecorderInput>,
    pub thread: RunRecording,
    /// Counts the samples that control records.
    pub backlog: Backlog,
}

/// The recording thread of a run. Its chain is: count of recorded samples, twin, then run file, live view and progress
/// side by side.
pub(super) type RunRecording = RecorderThread<Counted<Twin>>;

/// The file of a run that has not begun. Dropping it removes the file.
pub(super) struct NewRunFile(Option<PathBuf>);

impl NewRunFile {
    /// The run begins: its file stays. Returns the path.
    pub(super) fn keep(mut self) -> PathBuf {
        self.0.take().unwrap_or_default()
    }
}

impl Drop for NewRunFile {
    fn drop(&mut self) {
        if let Some(path) = &self.0 {
            run_file::remove(path);
        }
    }
}

impl PreparedRun {
    /// Ends the recording thread and removes the file. Waits some milliseconds for the thread.
    pub(super) fn discard(self) {
        drop(self.input);
        // The file is removed after its last handle is closed.
        drop(self.thread.join());
        drop(self.file);
    }
}

/// Prepares the requested run. Ends soon after it is no longer wanted.
pub(super) fn prepare(
    state: &Arc<DaemonState>,
    request: StartRun,
    wanted: &Wanted,
) -> Result<PreparedRun, ApiError> {
    let now = jiff::Timestamp::now();
    let chosen = resume::choose(state, &request)?;
    let bench = &state.twin.applied_to(&state.settings.bench);
    let today = now.to_zoned(TimeZone::UTC).date();
    let overrides = permission::remarks(bench, &chosen.specimen, today, request.override_by.as_deref())?;
    let plan = plan::check_while(bench, &chosen.profile, false, &|| wanted.withdrawn().is_none());
    wanted.check()?;
    let plan = plan.map_err(|e| ApiError::invalid(&e))?;
    plan::refuse_predicted_trip(&plan)?;
    check_space(state.store.folder(), plan.duration_s, f64::from(SAMPLE_RATE_HZ)).map_err(ApiError::disk)?;
    let planned = header::Planned {
        cycles: plan.cycles,
        duration_s: plan.duration_s,
    };
    let mut header = run_header(state, bench, &chosen, request, planned, now);
    header.remarks.extend(overrides);
    let path = state.store.path_for_new(&header.run_id);
    let writer = RunFileWriter::create(&path, &header).map_err(ApiError::disk)?;
    let file = NewRunFile(Some(path));
    let disk = writer.status();
    let backlog = Backlog::default();
    let (input, thread) = recording_chain(state, bench, writer, &backlog)?;
    Ok(PreparedRun {
        order: RunOrder {
            header,
            profile: chosen.profile,
            first_cycle: chosen.first_cycle,
        },
        file,
        disk,
        input,
        thread,
        backlog,
    })
}

fn run_header(
    state: &DaemonState,
    bench: &Bench,
    chosen: &ChosenProfile,
    request: StartRun,
    planned: header::Planned,
    now: jiff::Timestamp,
) -> Header {
    let mut header = header::new(
        store::new_run_id(now),
        now,
        bench,
        &chosen.profile,
        chosen.toml.clone(),
        planned,
    );
    header.twin = state.twin.words(&state.settings.bench);
    header.specimen.clone_from(&chosen.specimen);
    header.operator = request.operator.unwrap_or_default();
    header.first_cycle = chosen.first_cycle;
    header.resumes_run.clone_from(&chosen.resumes_run);
    header.remarks = state.control.degraded().to_vec();
    header
}

/// Starts the recording thread of a run and returns its input, which control feeds. The twin runs in the recording thread:
/// if it is slow, the ring in front of it fills, and control does not wait.
fn recording_chain(
    state: &Arc<DaemonState>,
    bench: &Bench,
    writer: RunFileWriter,
    backlog: &Backlog,
) -> Result<(Counted<RecorderInput>, RunRecording), ApiError> {
    let fan_out = FanOut(vec![
        Box::new(writer),
        Box::new(state.live.recorder()),
        Box::new(state.tally.recorder()),
        Box::new(ProgressRecorder::new(state)),
    ]);
    let plant = bench.model.plant().map_err(|e| ApiError::invalid(&e))?;
    let waiting = backlog.clone();
    let twin = Twin::new(
        plant,
        bench.displacement_channel.noise_mm,
        Box::new(fan_out),
        move || waiting.is_long(),
    )
    .watching(bench.noise());
    let (input, thread) =
        recorder::spawn(backlog.count_taken(twin)).map_err(|e| ApiError::internal(&e.to_string()))?;
    Ok((backlog.count_recorded(input), thread))
}
