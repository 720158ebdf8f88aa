//! Follows a run from the end of its recording chain: keeps its progress up to date and acts on a model mismatch.

use std::sync::Arc;

use super::client_types::{RunState, ending_word};
use super::newest_run::NewestRun;
use super::orders;
use super::state::DaemonState;
use crate::config::MismatchAction;
use crate::control::realtime::{ControlHandle, Request};
use crate::recording::{Event, EventKind, Header, Outcome, Recorder, Sample};

/// The last recorder of the chain: when it receives the end of the run, the run file is complete.
pub(super) struct ProgressRecorder {
    newest_run: NewestRun,
    control: ControlHandle,
    on_mismatch: MismatchAction,
    runtime: tokio::runtime::Handle,
}

impl ProgressRecorder {
    /// The recorder of the next run. Call it on a thread of the async runtime.
    pub(super) fn new(state: &Arc<DaemonState>) -> Self {
        ProgressRecorder {
            newest_run: state.newest_run.clone(),
            control: state.control.clone(),
            on_mismatch: state.settings.bench.daemon.model_mismatch,
            runtime: tokio::runtime::Handle::current(),
        }
    }

    /// Sends the request as an operator would, from its own task, so that recording and control do not wait for each other.
    fn act_on_mismatch(&self, text: &str) {
        let text = text.to_owned();
        let request: Box<dyn Fn() -> Request + Send + Sync> = match self.on_mismatch {
            MismatchAction::Tell => return,
            MismatchAction::Hold => Box::new(|| Request::Hold),
            MismatchAction::Stop => Box::new(move || Request::Stop(text.clone())),
        };
        let control = self.control.clone();
        self.runtime.spawn(async move {
            if let Err(error) = orders::insist(&control, request).await {
                tracing::warn!("model mismatch: control did not act on it: {error}");
            }
        });
    }
}

impl Recorder for ProgressRecorder {
    fn begin(&mut self, _: &Header) {
        self.newest_run.update(|p| p.state = RunState::Running);
    }

    fn sample(&mut self, _: &Sample) {}

    fn event(&mut self, event: &Event) {
        tracing::info!("{:.3} s {:?}: {}", event.time_s, event.kind, event.text);
        if event.kind == EventKind::ModelMismatch {
            self.newest_run
                .update(|p| p.model_mismatch = format!("{:.1} s: {}", event.time_s, event.text));
            self.act_on_mismatch(&event.text);
        }
    }

    fn end(&mut self, outcome: &Outcome) {
        self.newest_run.update(|p| {
            p.state = RunState::Ended;
            p.ending = Some(ending_word(outcome.ending).to_owned());
            p.cause.clone_from(&outcome.cause);
            p.samples = outcome.samples;
            p.lost = outcome.lost;
            p.late = outcome.late;
            p.cycles_completed = outcome.cycles_completed;
        });
    }
}
