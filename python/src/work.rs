//! Computes on a thread of its own, without the interpreter's lock. The calling thread meanwhile shows the progress and looks for
//! Ctrl-C; then the computation is cancelled, and its thread has ended before the exception is raised.
//!
//! Each call has a thread pool of its own. The pool that rayon shares among all calls would hang in a process that was forked, as
//! `multiprocessing` does it, because its threads are not there.

use std::panic::{self, AssertUnwindSafe};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread;
use std::time::Duration;

use leafbench::{CallFailure, CancelFlag};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use rayon::ThreadPoolBuilder;

use crate::errors;

/// The calling thread looks this often for Ctrl-C: a person does not notice the delay, and the lock is almost always free.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Stack of a thread: that of a main thread on Linux.
const STACK_BYTES: usize = 8 << 20;

/// What the computation is given.
pub(crate) struct Job {
    /// Ends it.
    pub flag: CancelFlag,
    steps: Sender<(f64, String)>,
}

impl Job {
    /// Shows the share done, 0 to 1, and the current step.
    pub(crate) fn show(&self, share: f64, step: &str) {
        // Nobody listens any more only when the job is cancelled.
        let _ = self.steps.send((share, step.to_owned()));
    }
}

/// Runs `work` on as many threads (0: one for each core) and returns its result. `progress(share, step)` is called on this thread;
/// an exception in it ends the work.
pub(crate) fn until_done_on<T: Send>(
    py: Python<'_>,
    threads: usize,
    progress: Option<Bound<'_, PyAny>>,
    work: impl FnOnce(&Job) -> Result<T, CallFailure> + Send,
) -> PyResult<T> {
    let progress = progress.map(Bound::unbind);
    let (steps, shown) = mpsc::channel();
    let job = Job {
        flag: CancelFlag::default(),
        steps,
    };
    let flag = job.flag.clone();
    let ended = py.detach(move || {
        let pool = ThreadPoolBuilder::new()
            .num_threads(threads)
            .stack_size(STACK_BYTES)
            .build()
            .map_err(|error| {
                PyOSError::new_err(format!("no thread can be started: {error}: end other programs"))
            })?;
        thread::scope(|scope| {
            // The job, and with it the sender, is dropped at the end of the work, which ends the loop below.
            let work = move || panic::catch_unwind(AssertUnwindSafe(move || work(&job)));
            let thread = thread::Builder::new()
                .name("leafbench".to_owned())
                .spawn_scoped(scope, || pool.install(work))
                .map_err(PyOSError::new_err)?;
            let watched = loop {
                let step = shown.recv_timeout(LOOK_EVERY);
                if matches!(step, Err(RecvTimeoutError::Disconnected)) {
                    break Ok(());
                }
                if let Err(raised) = Python::attach(|py| looked_after(py, progress.as_ref(), step.ok())) {
                    flag.cancel();
                    break Err(raised);
                }
            };
            let result = thread.join().and_then(|caught| caught);
            watched.map(|()| result)
        })
    })?;
    match ended {
        Ok(result) => result.map_err(|failure| errors::exception(py, failure)),
        Err(payload) => Err(errors::of_panic(payload.as_ref())),
    }
}

/// As [`until_done_on`], on one thread and without progress.
pub(crate) fn until_done<T: Send>(
    py: Python<'_>,
    work: impl FnOnce(&Job) -> Result<T, CallFailure> + Send,
) -> PyResult<T> {
    until_done_on(py, 1, None, work)
}

/// Raises what a signal handler raised (Ctrl-C), and shows a step.
fn looked_after(py: Python<'_>, progress: Option<&Py<PyAny>>, step: Option<(f64, String)>) -> PyResult<()> {
    py.check_signals()?;
    match (progress, step) {
        (Some(progress), Some(step)) => progress.call1(py, step).map(drop),
        _ => Ok(()),
    }
}
