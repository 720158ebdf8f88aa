//! Starts a run and follows it to its closed file: profile, plan check, space, run file, recording thread, control.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::http::StatusCode;

use super::api::ApiError;
use super::backlog::{Backlog, Counted};
use super::client_types::{RunProgress, RunState, StartRun, Started};
use super::{Shared, header, plan, store};
use crate::config::MismatchAction;
use crate::control::Phase;
use crate::control::realtime::{ControlHandle, Request};
use crate::control::run::RunOrder;
use crate::profile::{Player, Profile};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::recorder::{self, FanOut, RecorderInput, RecorderThread};
use crate::recording::run_file::{RunFile, RunFileStatus, RunFileWriter, check_space};
use crate::recording::{Ending, Event, EventKind, Header, Outcome, Recorder, Sample};
use crate::twin::Twin;

/// The run under way, or the newest.
#[derive(Default)]
pub(crate) struct Runs {
    /// One start at a time: the second finds the rig busy.
    starting: tokio::sync::Mutex<()>,
    newest: Arc<Mutex<Option<Newest>>>,
}

struct Newest {
    progress: RunProgress,
    path: PathBuf,
    disk: Arc<RunFileStatus>,
    /// The recording thread has ended and the file is as it stays.
    closed: bool,
}

impl Runs {
    fn lock(&self) -> MutexGuard<'_, Option<Newest>> {
        self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How far the newest run is.
    pub(crate) fn newest(&self) -> Option<RunProgress> {
        self.lock().as_ref().map(|newest| RunProgress {
            disk_problem: newest.disk.problem().unwrap_or_default(),
            ..newest.progress.clone()
        })
    }

    /// No recording thread is at work.
    pub(crate) fn all_closed(&self) -> bool {
        self.lock().as_ref().is_none_or(|newest| newest.closed)
    }

    /// At the daemon's end: closes a file that its recording thread left open.
    pub(crate) fn close_unfinished(&self, cause: &str) -> Vec<String> {
        let newest = self.lock();
        let open = newest
            .iter()
            .filter(|n| n.progress.state == RunState::Running || !n.closed);
        open.map(|n| store::close_as_aborted(&n.path, &n.progress.run_id, cause))
            .collect()
    }

    /// Starts a run; refused without any motion where anything speaks against it.
    pub(crate) async fn start(&self, shared: &Arc<Shared>, order: StartRun) -> Result<Started, ApiError> {
        let _one_at_a_time = self.starting.lock().await;
        let (status, _) = shared.control.status();
        if let Some(refusal) = busy(&status) {
            return Err(refusal);
        }
        let blocking = Arc::clone(shared);
        // Files, SQLite and the dry run take their time: not on the threads that serve the interface.
        let prepared = tokio::task::spawn_blocking(move || prepare(&blocking, order))
            .await
            .map_err(|_| ApiError::internal("preparing the run failed"))??;
        let run_id = prepared.order.header.run_id.clone();
        *self.lock() = Some(Newest {
            progress: RunProgress {
                run_id: run_id.clone(),
                profile: prepared.order.profile.name.clone(),
                state: RunState::Arming,
                ending: None,
                cause: String::new(),
                samples: 0,
                lost: 0,
                cycles_completed: 0,
                disk_problem: String::new(),
                model_mismatch: String::new(),
            },
            path: prepared.path.clone(),
            disk: prepared.disk,
            closed: false,
        });
        let input = Box::new(prepared.input);
        let asked = shared
            .control
            .ask(Request::Start(Box::new(prepared.order), input))
            .await;
        follow(shared, prepared.thread, prepared.path);
        asked?;
        tracing::info!("run {run_id} starts");
        Ok(Started { run_id })
    }
}

/// A start that control would refuse anyway; said before anything is written.
fn busy(status: &crate::control::RigStatus) -> Option<ApiError> {
    let text = match status.phase {
        Phase::Ready => return None,
        Phase::Connecting if status.notice.is_empty() => {
            "the rig is not connected: check the link and the rig's power".to_owned()
        }
        Phase::Connecting => format!("the rig is not connected: {}", status.notice),
        Phase::Interlocked => {
            format!(
                "the rig is interlocked ({:?}): remove the cause, then reset",
                status.cause
            )
        }
        _ => match &status.run_id {
            Some(run) => format!("run {run} is under way: stop it or wait for its end"),
            None => "the rig is busy: wait until it is unloaded".to_owned(),
        },
    };
    Some(ApiError::new(StatusCode::CONFLICT, text, String::new()))
}

struct Prepared {
    order: RunOrder,
    path: PathBuf,
    disk: Arc<RunFileStatus>,
    input: Counted<RecorderInput>,
    thread: Recording,
}

/// The chain of one run: backlog, twin, then run file, live view and watcher side by side.
type Recording = RecorderThread<Counted<Twin>>;

fn prepare(shared: &Arc<Shared>, request: StartRun) -> Result<Prepared, ApiError> {
    let (profile, profile_toml, first_cycle) = profile_of(shared, &request)?;
    let bench = &shared.settings.bench;
    let plan = plan::check(bench, &profile).map_err(|e| ApiError::invalid(&e))?;
    plan::refuse_predicted_trip(&plan)?;
    check_space(shared.store.folder(), plan.duration_s, f64::from(SAMPLE_RATE_HZ)).map_err(ApiError::disk)?;
    let now = jiff::Timestamp::now();
    let planned = header::Planned {
        cycles: plan.cycles,
        duration_s: plan.duration_s,
    };
    let mut header = header::new(
        store::new_run_id(now),
        now,
        bench,
        &profile,
        profile_toml,
        planned,
    );
    if let Some(specimen) = request.specimen.filter(|s| !s.trim().is_empty()) {
        header.specimen = specimen;
    }
    header.operator = request.operator.unwrap_or_default();
    header.first_cycle = first_cycle;
    header.resumes_run = request.resume_run.unwrap_or_default();
    header.remarks = shared.control.degraded().to_vec();
    let path = shared.store.path_for_new(&header.run_id);
    let writer = RunFileWriter::create(&path, &header).map_err(ApiError::disk)?;
    let disk = writer.status();
    let watcher = Watcher {
        newest: Arc::clone(&shared.runs.newest),
        control: shared.control.clone(),
        on_mismatch: bench.daemon.model_mismatch,
        asks: tokio::runtime::Handle::current(),
    };
    let fan_out = FanOut(vec![
        Box::new(writer),
        Box::new(shared.live.tap()),
        Box::new(watcher),
    ]);
    let plant = bench.model.plant().map_err(|e| ApiError::invalid(&e))?;
    // The twin is a stage of the recording thread: where it is slow the ring fills, control never waits.
    let backlog = Backlog::default();
    let asked = backlog.clone();
    let twin = Twin::new(
        plant,
        bench.displacement_channel.noise_mm,
        Box::new(fan_out),
        move || asked.is_long(),
    )
    .watching(bench.noise());
    let (input, thread) =
        recorder::spawn(backlog.behind(twin)).map_err(|e| ApiError::internal(&e.to_string()))?;
    let input = backlog.before(input);
    Ok(Prepared {
        order: RunOrder {
            header,
            profile,
            first_cycle,
        },
        path,
        disk,
        input,
        thread,
    })
}

/// The profile asked for, or that of the run to go on with, and the cycle to begin at.
fn profile_of(shared: &Shared, request: &StartRun) -> Result<(Profile, String, u32), ApiError> {
    let Some(resumed) = &request.resume_run else {
        let name = request.profile.as_deref().unwrap_or_default();
        let (profile, text) = shared.library.find(name).map_err(|e| ApiError::invalid(&e))?;
        return Ok((profile, text, 1));
    };
    let listing = shared.store.find(resumed).map_err(ApiError::disk)?;
    let listing = listing.ok_or_else(|| ApiError::no_run(resumed))?;
    let run = RunFile::open(&listing.path).map_err(ApiError::disk)?;
    let text = run.header().profile_toml.clone();
    let profile = Profile::from_toml(&text, resumed).map_err(|e| ApiError::invalid(&e))?;
    if let Some(name) = request.profile.as_deref() {
        let (asked, _) = shared.library.find(name).map_err(|e| ApiError::invalid(&e))?;
        if asked != profile {
            return Err(ApiError::new(
                StatusCode::CONFLICT,
                format!(
                    "run {resumed} was another profile ({}) than {}",
                    profile.name, asked.name
                ),
                "leave the profile out, or start a fresh run".to_owned(),
            ));
        }
    }
    let done = listing
        .cycles_completed
        .max(run.header().first_cycle.saturating_sub(1));
    let player = Player::new(&profile, 0.0, f64::from(SAMPLE_RATE_HZ)).map_err(|e| ApiError::invalid(&e))?;
    if done >= player.total_cycles() {
        return Err(ApiError::new(
            StatusCode::CONFLICT,
            format!(
                "run {resumed} has no cycle left to do: {done} of {} are complete",
                player.total_cycles()
            ),
            "start a fresh run".to_owned(),
        ));
    }
    Ok((profile, text, done + 1))
}

/// Waits for the recording thread and settles what became of the run.
fn follow(shared: &Arc<Shared>, thread: Recording, path: PathBuf) {
    let shared = Arc::clone(shared);
    tokio::task::spawn_blocking(move || {
        // Dropping the chain closes the file's handles.
        drop(thread.join());
        let mut newest = shared.runs.lock();
        let Some(newest) = newest.as_mut().filter(|n| n.path == path) else {
            return;
        };
        if newest.progress.state == RunState::Arming {
            newest.progress.state = RunState::NeverStarted;
            newest.progress.cause = shared.control.status().0.notice;
            // Nothing was recorded: no run, no file.
            for ending in ["", "-wal", "-shm"] {
                let _ = std::fs::remove_file(format!("{}{ending}", path.display()));
            }
        } else if newest.progress.state == RunState::Running {
            tracing::error!(
                "the recording of run {} ended before the run",
                newest.progress.run_id
            );
        }
        newest.closed = true;
    });
}

/// Last in the chain: when it hears of the end the file is closed already.
struct Watcher {
    newest: Arc<Mutex<Option<Newest>>>,
    control: ControlHandle,
    on_mismatch: MismatchAction,
    asks: tokio::runtime::Handle,
}

impl Watcher {
    fn update(&self, change: impl FnOnce(&mut RunProgress)) {
        let mut newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(newest) = newest.as_mut() {
            change(&mut newest.progress);
        }
    }

    /// Asks control as an operator would, from a task of its own: neither the recording nor control waits for the other.
    fn act_on_mismatch(&self, text: &str) {
        let request = match self.on_mismatch {
            MismatchAction::Tell => return,
            MismatchAction::Hold => Request::Hold,
            MismatchAction::Stop => Request::Stop(text.to_owned()),
        };
        let control = self.control.clone();
        self.asks.spawn(async move {
            if let Err(error) = control.ask(request).await {
                tracing::warn!("model mismatch: control did not act on it: {error}");
            }
        });
    }
}

impl Recorder for Watcher {
    fn begin(&mut self, _: &Header) {
        self.update(|p| p.state = RunState::Running);
    }

    fn sample(&mut self, _: &Sample) {}

    fn event(&mut self, event: &Event) {
        tracing::info!("{:.3} s {:?}: {}", event.time_s, event.kind, event.text);
        if event.kind == EventKind::ModelMismatch {
            self.update(|p| p.model_mismatch = format!("{:.1} s: {}", event.time_s, event.text));
            self.act_on_mismatch(&event.text);
        }
    }

    fn end(&mut self, outcome: &Outcome) {
        self.update(|p| {
            p.state = RunState::Ended;
            p.ending = Some(ending_word(outcome.ending).to_owned());
            p.cause.clone_from(&outcome.cause);
            p.samples = outcome.samples;
            p.lost = outcome.lost;
            p.cycles_completed = outcome.cycles_completed;
        });
    }
}

/// The stable word of an ending.
pub(crate) fn ending_word(ending: Ending) -> &'static str {
    match ending {
        Ending::Completed => "completed",
        Ending::Stopped => "stopped",
        Ending::Aborted => "aborted",
    }
}
