//! The index of the data folder: what a list says about each run file, without opening all of them for each request. Each
//! look compares the folder with the index and reads only files that are new or have changed (`identity`). The index is kept
//! on the disk for the next program (`kept`).

mod identity;
mod kept;

use std::collections::{HashMap, HashSet};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use super::client_types::RunSummary;
use crate::recording::run_file::{self, EXTENSION, RunFileError, RunListing};
use identity::FileIdentity;
use kept::{KeptIndex, KeptRun};

/// A file that is being written is read again only after this many times as long as reading it took: a long run is not read
/// from its start with every look.
const REST: u32 = 20;
/// A file that could not be read is tried again after this time: the reason may have been a lack of file handles.
const RETRY: Duration = Duration::from_secs(1);

/// One run file as it was last read.
#[derive(Debug, Clone)]
pub(crate) struct IndexedRun {
    pub listing: RunListing,
    /// The listing as it is answered.
    pub summary: RunSummary,
    /// The file was read in full, so `listing.problem` is complete.
    pub checked: bool,
    file: OsString,
    identity: FileIdentity,
    /// When it was read, and how long that took; for files whose state may change.
    read: (Instant, Duration),
    /// It was read well after its last change, so its identity says whether it is the same.
    settled: bool,
}

/// How much is read in full at one time.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct CheckLimits {
    /// No further file is begun after this.
    pub until: Option<Instant>,
    /// Larger files are left out, bytes.
    pub file_bytes: Option<u64>,
}

/// The runs of a folder, oldest first.
pub(crate) type IndexedRuns = Arc<[Arc<IndexedRun>]>;

/// The index of one folder. It is shared by all threads of a program.
#[derive(Debug)]
pub(crate) struct RunIndex {
    folder: PathBuf,
    state: Mutex<IndexState>,
}

#[derive(Debug, Default)]
struct IndexState {
    /// `None` before the first look.
    kept: Option<KeptIndex>,
    runs: HashMap<OsString, Arc<IndexedRun>>,
    sorted: IndexedRuns,
}

impl RunIndex {
    /// The index of `folder`. Nothing is read yet.
    pub(crate) fn new(folder: &Path) -> RunIndex {
        RunIndex {
            folder: folder.to_owned(),
            state: Mutex::default(),
        }
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    fn lock(&self) -> MutexGuard<'_, IndexState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The runs as they are on the disk now.
    pub(crate) fn look(&self) -> Result<IndexedRuns, RunFileError> {
        let mut state = self.lock();
        // Under the lock: an older list of files must not remove what a newer one has added.
        let files = self.run_files()?;
        let mut kept_runs = HashMap::new();
        let first = state.kept.is_none();
        if first {
            let (kept, runs) = KeptIndex::read(&self.folder);
            (state.kept, kept_runs) = (Some(kept), runs);
        }
        let before = state.runs.len();
        state.runs.retain(|file, _| files.contains_key(file));
        let gone = state.runs.len() < before;
        let mut read = Vec::new();
        for (file, log) in files {
            let path = self.folder.join(&file);
            let Some(identity) = FileIdentity::of(&path, log.as_deref()) else {
                state.runs.remove(&file);
                continue;
            };
            if state
                .runs
                .get(&file)
                .is_some_and(|run| run.holds(&identity, &path))
            {
                continue;
            }
            let kept = file.to_str().and_then(|file| kept_runs.remove(file));
            let kept = kept.filter(|kept| kept.identity == identity);
            let is_kept = kept.is_some();
            let run = Arc::new(match kept {
                Some(kept) => IndexedRun::kept(file.clone(), path, kept),
                None => IndexedRun::read(file.clone(), path, identity),
            });
            read.extend((!is_kept).then(|| Arc::clone(&run)));
            state.runs.insert(file, run);
        }
        if first || gone || !read.is_empty() {
            state.changed(&read);
        }
        Ok(Arc::clone(&state.sorted))
    }

    /// Name of each run file, and the path of the log beside it if there is one.
    fn run_files(&self) -> Result<HashMap<OsString, Option<PathBuf>>, RunFileError> {
        let failed = |source| RunFileError::Io {
            path: self.folder.clone(),
            doing: "listing",
            source,
        };
        let log_extension = format!("{EXTENSION}-wal");
        let (mut files, mut logs) = (HashMap::new(), HashSet::new());
        for entry in std::fs::read_dir(&self.folder).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            let Some(extension) = path.extension() else {
                continue;
            };
            if extension == log_extension.as_str() {
                logs.insert(path);
            } else if extension == EXTENSION {
                files.extend(path.file_name().map(|name| (name.to_owned(), None)));
            }
        }
        for log in logs {
            let run = log.with_extension(EXTENSION);
            if let Some(place) = run.file_name().and_then(|name| files.get_mut(name)) {
                *place = Some(log);
            }
        }
        Ok(files)
    }

    /// Reads in full those of `runs` that were not, in their order and within `limits`. Returns how many are left.
    pub(crate) fn check(&self, runs: &[Arc<IndexedRun>], limits: CheckLimits) -> usize {
        let unchecked = runs.iter().filter(|run| !run.checked);
        let mut left = unchecked.clone().count();
        let small =
            |run: &&Arc<IndexedRun>| limits.file_bytes.is_none_or(|most| run.identity.bytes() <= most);
        let mut checked = Vec::new();
        for run in unchecked.filter(small) {
            if limits.until.is_some_and(|until| Instant::now() >= until) {
                break;
            }
            checked.push(Arc::new(run.in_full()));
            left -= 1;
        }
        self.lock().take(&checked);
        left
    }

    /// The index's own newest version of these runs; without those that are gone.
    pub(crate) fn renewed(&self, runs: &[Arc<IndexedRun>]) -> Vec<Arc<IndexedRun>> {
        let state = self.lock();
        runs.iter()
            .filter_map(|run| state.runs.get(&run.file).map(Arc::clone))
            .collect()
    }
}

impl IndexState {
    /// Puts in what was read in full, unless the file has changed since.
    fn take(&mut self, checked: &[Arc<IndexedRun>]) {
        let mut taken = Vec::new();
        for run in checked {
            if let Some(known) = self.runs.get_mut(&run.file)
                && known.identity == run.identity
            {
                *known = Arc::clone(run);
                taken.push(Arc::clone(run));
            }
        }
        if !taken.is_empty() {
            self.changed(&taken);
        }
    }

    /// Sorts the runs again, and keeps what was read on the disk.
    fn changed(&mut self, read: &[Arc<IndexedRun>]) {
        let mut sorted: Vec<Arc<IndexedRun>> = self.runs.values().map(Arc::clone).collect();
        sorted.sort_by(|a, b| a.order().cmp(&b.order()));
        self.sorted = sorted.into();
        let Some(kept) = &mut self.kept else { return };
        match kept.is_worn(self.runs.len()) {
            true => {
                let all: Vec<KeptRun> = self.runs.values().filter_map(|run| run.to_keep()).collect();
                // A folder without finished runs gets no index.
                if !all.is_empty() {
                    kept.rewrite(&all);
                }
            }
            false => {
                let more: Vec<KeptRun> = read.iter().filter_map(|run| run.to_keep()).collect();
                kept.add(&more);
            }
        }
    }
}

impl IndexedRun {
    /// Reads a file. `identity` was taken before, so a change during the reading is seen at the next look.
    fn read(file: OsString, path: PathBuf, identity: FileIdentity) -> IndexedRun {
        let (now, begun) = (SystemTime::now(), Instant::now());
        let listing = run_file::listing(path);
        IndexedRun {
            summary: RunSummary::from(listing.clone()),
            checked: !listing.is_closed() || !listing.problem.is_empty(),
            settled: listing.is_closed() && !identity.is_fresh(now),
            listing,
            file,
            identity,
            read: (begun, begun.elapsed()),
        }
    }

    /// What an earlier program read from the same state of the file.
    fn kept(file: OsString, path: PathBuf, kept: KeptRun) -> IndexedRun {
        let listing = RunListing { path, ..kept.listing };
        IndexedRun {
            summary: RunSummary::from(listing.clone()),
            listing,
            checked: kept.checked,
            file,
            identity: kept.identity,
            read: (Instant::now(), Duration::ZERO),
            settled: true,
        }
    }

    /// The same run after its file was read in full.
    fn in_full(&self) -> IndexedRun {
        let listing = RunListing {
            problem: run_file::check(&self.listing.path),
            ..self.listing.clone()
        };
        IndexedRun {
            summary: RunSummary::from(listing.clone()),
            listing,
            checked: true,
            ..self.clone()
        }
    }

    /// What is known of the file is still right, or the file need not be read again so soon.
    fn holds(&self, now: &FileIdentity, path: &Path) -> bool {
        if self.settled {
            return self.identity == *now;
        }
        let (at, took) = self.read;
        if self.listing.is_closed() {
            return false;
        }
        if self.listing.started_utc.is_empty() {
            return self.identity == *now && at.elapsed() < RETRY;
        }
        let rests = at.elapsed() < took * REST;
        self.identity == *now && now.has_log() || rests && run_file::is_open(path)
    }

    /// The runs are listed in this order.
    pub(crate) fn order(&self) -> (&str, &str, &OsString) {
        (&self.listing.started_utc, &self.listing.run_id, &self.file)
    }

    /// Only closed files are kept on the disk: the others change.
    fn to_keep(&self) -> Option<KeptRun> {
        self.settled.then_some(())?;
        Some(KeptRun {
            file: self.file.to_str()?.to_owned(),
            identity: self.identity,
            checked: self.checked,
            listing: self.listing.clone(),
        })
    }
}
