//! Diagnoses that were asked for over HTTP: one at a time is computed, the others wait. `job` is the record of one on the
//! disk, `process` the program that computes it.

pub(crate) mod job;
mod process;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use crate::config::Bench;
use crate::recording::atomic_file;
use job::{BENCH, DiagnosisJob, JobState};
use process::DiagnosisProcess;

/// Folder of the jobs in the data folder.
const FOLDER: &str = "diagnoses";
/// Most jobs that wait at one time.
const MOST_WAITING: usize = 50;

/// The jobs of a data folder. Clones share them.
#[derive(Clone)]
pub(crate) struct Diagnoses(Arc<Shared>);

struct Shared {
    /// The data folder.
    data: PathBuf,
    queue: Mutex<JobQueue>,
    /// A job was added, or the daemon ends.
    changed: Condvar,
}

#[derive(Default)]
struct JobQueue {
    /// All jobs, oldest first.
    jobs: Vec<DiagnosisJob>,
    /// Id of the job that is computed, and of its process.
    computed: Option<(String, u32)>,
    ends: bool,
}

impl JobQueue {
    fn get(&mut self, id: &str) -> Option<&mut DiagnosisJob> {
        self.jobs.iter_mut().find(|job| job.id == id)
    }
}

/// Why something cannot be done with a job.
#[derive(Debug, thiserror::Error)]
pub(crate) enum JobError {
    #[error("there is no diagnosis \"{0}\": GET /api/diagnoses lists all")]
    Unknown(String),
    #[error("{MOST_WAITING} diagnoses wait already: wait for one, or cancel one")]
    TooMany,
    #[error("diagnosis {id} is {state}: {remedy}")]
    State {
        id: String,
        /// What it is, in words.
        state: &'static str,
        remedy: &'static str,
    },
    #[error(
        "the folder of the diagnosis cannot be written: check the free space and the permissions of the disk"
    )]
    Disk(#[from] std::io::Error),
}

impl Diagnoses {
    /// The jobs that the data folder has already.
    pub(crate) fn of(data: &Path) -> Diagnoses {
        let jobs = job::read_all(&data.join(FOLDER));
        Diagnoses(Arc::new(Shared {
            data: data.to_owned(),
            queue: Mutex::new(JobQueue {
                jobs,
                ..JobQueue::default()
            }),
            changed: Condvar::new(),
        }))
    }

    fn lock(&self) -> MutexGuard<'_, JobQueue> {
        self.0.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn folder(&self) -> PathBuf {
        self.0.data.join(FOLDER)
    }

    /// All jobs, newest first.
    pub(crate) fn list(&self) -> Vec<DiagnosisJob> {
        self.lock().jobs.iter().rev().cloned().collect()
    }

    pub(crate) fn get(&self, id: &str) -> Result<DiagnosisJob, JobError> {
        let found = self.lock().get(id).cloned();
        found.ok_or_else(|| unknown(id))
    }

    /// Adds a job, which starts from the model of `bench`.
    pub(crate) fn add(&self, job: DiagnosisJob, bench: &Bench) -> Result<(), JobError> {
        let waiting = |queue: &JobQueue| queue.jobs.iter().filter(|job| job.state.is_pending()).count();
        if waiting(&self.lock()) >= MOST_WAITING {
            return Err(JobError::TooMany);
        }
        job.write(&self.folder())?;
        let text = bench.to_toml();
        atomic_file::write(&job.folder(&self.folder()).join(BENCH), |file| {
            std::io::Write::write_all(file, text.as_bytes())
        })?;
        self.lock().jobs.push(job);
        self.0.changed.notify_all();
        Ok(())
    }

    /// Ends a job that waits or is computed; removes one that is over, with its files. Returns the job as it is then.
    pub(crate) fn end_or_remove(&self, id: &str) -> Result<DiagnosisJob, JobError> {
        let mut queue = self.lock();
        let computed = queue.computed.clone();
        let job = queue.get(id).ok_or_else(|| unknown(id))?;
        if !job.state.is_pending() {
            let gone = job.clone();
            queue.jobs.retain(|job| job.id != id);
            drop(queue);
            std::fs::remove_dir_all(gone.folder(&self.folder()))?;
            return Ok(gone);
        }
        job.state = JobState::Cancelled;
        job.step.clear();
        let job = job.clone();
        if let Some((_, process)) = computed.filter(|(computed, _)| computed == id) {
            // The number is still that of the process: it is waited for only after `computed` was emptied.
            let _ = kill(Pid::from_raw(process.cast_signed()), Signal::SIGKILL);
        }
        drop(queue);
        job.write(&self.folder())?;
        Ok(job)
    }

    /// A file that a job has left, with its type.
    pub(crate) fn file(&self, id: &str, name: &str) -> Result<(PathBuf, &'static str), JobError> {
        let job = self.get(id)?;
        let path = job.folder(&self.folder()).join(name);
        let kind = job::type_of(name).filter(|_| job.state == JobState::Done && path.is_file());
        kind.map(|kind| (path, kind)).ok_or_else(|| match job.state {
            JobState::Done => JobError::Unknown(format!("{id}/{name}")),
            _ => JobError::State {
                id: id.to_owned(),
                state: "not done",
                remedy: "wait for its end, or start another one",
            },
        })
    }

    /// Starts the thread that computes the jobs.
    pub(crate) fn spawn(&self) -> DiagnosisThread {
        let diagnoses = self.clone();
        let work = move || {
            while let Some(job) = diagnoses.next() {
                diagnoses.compute(job);
            }
        };
        if let Err(error) = std::thread::Builder::new()
            .name("diagnoses".to_owned())
            .spawn(work)
        {
            tracing::error!("diagnoses cannot be computed, they have no thread: {error}");
        }
        DiagnosisThread(self.clone())
    }

    /// Waits for the next job; `None` when the daemon ends.
    fn next(&self) -> Option<DiagnosisJob> {
        let mut queue = self.lock();
        loop {
            if queue.ends {
                return None;
            }
            if let Some(job) = queue.jobs.iter_mut().find(|job| job.state == JobState::Queued) {
                job.state = JobState::Running;
                job.step = "starting".to_owned();
                return Some(job.clone());
            }
            queue = self.0.changed.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn compute(&self, job: DiagnosisJob) {
        let result = self
            .diagnose(&job)
            .and_then(|()| job::found_in(&job.folder(&self.folder())));
        let mut queue = self.lock();
        // Its process was ended with the daemon; the next daemon says so.
        if queue.ends {
            return;
        }
        // A job that was cancelled stays so, whatever its process has done since.
        let Some(job) = queue.get(&job.id).filter(|job| job.state == JobState::Running) else {
            return;
        };
        job.step.clear();
        match result {
            Ok(found) => (job.state, job.share, job.found) = (JobState::Done, 1.0, Some(found)),
            Err(error) => (job.state, job.error) = (JobState::Failed, error),
        }
        let job = job.clone();
        drop(queue);
        if let Err(error) = job.write(&self.folder()) {
            tracing::warn!("diagnosis {}: its record cannot be written: {error}", job.id);
        }
    }

    fn diagnose(&self, job: &DiagnosisJob) -> Result<(), String> {
        let mut process = DiagnosisProcess::start(&self.0.data, &self.folder(), job)?;
        {
            let mut queue = self.lock();
            queue.computed = Some((job.id.clone(), process.id()));
            if queue.ends
                || queue
                    .get(&job.id)
                    .is_none_or(|job| job.state != JobState::Running)
            {
                let _ = kill(Pid::from_raw(process.id().cast_signed()), Signal::SIGKILL);
            }
        }
        let messages = process.follow(|progress| {
            if let Some(job) = self
                .lock()
                .get(&job.id)
                .filter(|job| job.state == JobState::Running)
            {
                (job.share, job.step) = (progress.share, progress.step);
            }
        });
        self.lock().computed = None;
        process.end(&messages)
    }
}

fn unknown(id: &str) -> JobError {
    // An id from a request may be long.
    JobError::Unknown(id.chars().take(40).collect())
}

/// The thread that computes the jobs. Dropping it ends the job under way.
pub(crate) struct DiagnosisThread(Diagnoses);

impl Drop for DiagnosisThread {
    fn drop(&mut self) {
        let mut queue = self.0.lock();
        queue.ends = true;
        if let Some((_, process)) = queue.computed {
            let _ = kill(Pid::from_raw(process.cast_signed()), Signal::SIGKILL);
        }
        drop(queue);
        self.0.0.changed.notify_all();
    }
}
