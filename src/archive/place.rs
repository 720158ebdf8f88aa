//! The store of an archive: a folder, or a bucket of an object store. Calls wait for their answer and repeat what may succeed at
//! the next try.

use std::path::{Path as FilePath, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use futures_util::TryStreamExt;
use object_store::aws::AmazonS3Builder;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{Error, ObjectStore, ObjectStoreExt, PutMode, PutPayload, RetryConfig};
use tokio::runtime::Runtime;

use super::ArchiveError;

/// How often a call is tried. The pauses double: they are 3 s in all.
const TRIES: u32 = 7;
/// First pause between two tries.
const FIRST_PAUSE: Duration = Duration::from_millis(50);
/// Beginning of the name of an archive in an object store.
const S3: &str = "s3://";

/// The store of one archive. Its methods may be called from many threads.
#[derive(Debug)]
pub(crate) struct ArchiveStore {
    /// As the user wrote it, for messages.
    name: String,
    runtime: Runtime,
    store: Arc<dyn ObjectStore>,
    /// Before the name of every object.
    prefix: Path,
    /// Where the objects lie, if they lie in a folder.
    folder: Option<PathBuf>,
}

/// An object of the store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ObjectEntry {
    pub path: String,
    pub bytes: u64,
}

impl ArchiveStore {
    /// Opens `place`: a folder, which is made if it is not there, or `s3://BUCKET/PREFIX`. The key of an object store comes from the
    /// environment (`AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`, `AWS_ENDPOINT` ...).
    pub(crate) fn open(place: &str) -> Result<ArchiveStore, ArchiveError> {
        match place.strip_prefix(S3) {
            Some(rest) => ArchiveStore::bucket(place, rest),
            None => ArchiveStore::folder(place),
        }
    }

    /// The archive in a folder, only if there is one: reading makes no folder.
    pub(crate) fn open_existing(place: &str) -> Result<ArchiveStore, ArchiveError> {
        if !place.starts_with(S3) && !FilePath::new(place).is_dir() {
            return Err(ArchiveError::NoArchive {
                place: place.to_owned(),
            });
        }
        ArchiveStore::open(place)
    }

    fn folder(place: &str) -> Result<ArchiveStore, ArchiveError> {
        let refused = |reason: String| ArchiveError::Place {
            place: place.to_owned(),
            reason,
        };
        if place.contains("://") {
            return Err(refused("only folders and s3:// are known".to_owned()));
        }
        std::fs::create_dir_all(place).map_err(|e| refused(e.to_string()))?;
        let store = LocalFileSystem::new_with_prefix(place).map_err(|e| refused(e.to_string()))?;
        let folder = Some(PathBuf::from(place));
        let store = ArchiveStore::over(place, Arc::new(store.with_fsync(true)), Path::default())?;
        Ok(ArchiveStore { folder, ..store })
    }

    fn bucket(place: &str, rest: &str) -> Result<ArchiveStore, ArchiveError> {
        let refused = |reason: String| ArchiveError::Place {
            place: place.to_owned(),
            reason,
        };
        let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
        // The first one that is installed stays, so an error here means that there is one.
        let _ = tokio_rustls::rustls::crypto::ring::default_provider().install_default();
        // `repeat` tries again, for every kind of store.
        let retry = RetryConfig {
            max_retries: 0,
            ..RetryConfig::default()
        };
        let store = AmazonS3Builder::from_env()
            .with_bucket_name(bucket)
            .with_retry(retry)
            .build();
        let store = store.map_err(|e| refused(e.to_string()))?;
        let prefix = Path::parse(prefix).map_err(|e| refused(e.to_string()))?;
        ArchiveStore::over(place, Arc::new(store), prefix)
    }

    /// An archive in any store.
    pub(super) fn over(
        name: &str,
        store: Arc<dyn ObjectStore>,
        prefix: Path,
    ) -> Result<ArchiveStore, ArchiveError> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .thread_name("archive")
            .enable_all()
            .build();
        Ok(ArchiveStore {
            name: name.to_owned(),
            runtime: runtime.map_err(|e| ArchiveError::Place {
                place: name.to_owned(),
                reason: e.to_string(),
            })?,
            store,
            prefix,
            folder: None,
        })
    }

    /// Files whose writing was interrupted. A folder keeps them under a name that ends with `#` and a number, and no reader of the
    /// archive lists them, but a program that reads the whole folder would.
    pub(super) fn interrupted_files(&self) -> Result<Vec<PathBuf>, ArchiveError> {
        let mut found = Vec::new();
        let mut folders: Vec<PathBuf> = self.folder.iter().cloned().collect();
        while let Some(folder) = folders.pop() {
            let failed = |source| ArchiveError::Read {
                path: folder.clone(),
                source,
            };
            for entry in std::fs::read_dir(&folder).map_err(failed)? {
                let path = entry.map_err(failed)?.path();
                if path.is_dir() {
                    folders.push(path);
                } else if is_interrupted(&path) {
                    found.push(path);
                }
            }
        }
        found.sort_unstable();
        Ok(found)
    }

    /// The name that the user gave.
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Content of an object; `None` if there is none of this name.
    pub(super) fn get(&self, object: &str) -> Result<Option<Vec<u8>>, ArchiveError> {
        let path = self.path(object);
        let read = self.repeat(async || self.store.get(&path).await?.bytes().await);
        match read {
            Ok(bytes) => Ok(Some(bytes.to_vec())),
            Err(Error::NotFound { .. }) => Ok(None),
            Err(source) => Err(self.failed("reading", object, source)),
        }
    }

    /// Writes an object whole or not at all, and replaces an old one.
    pub(super) fn put(&self, object: &str, content: Vec<u8>) -> Result<(), ArchiveError> {
        let path = self.path(object);
        let payload = PutPayload::from(content);
        let put = self.repeat(async || self.store.put(&path, payload.clone()).await);
        put.map(|_| ()).map_err(|e| self.failed("writing", object, e))
    }

    /// Writes a new object; false if there is one of this name. It may be the one that was just written: if the answer was lost, the second
    /// try finds it. The caller compares the contents.
    pub(super) fn create(&self, object: &str, content: Vec<u8>) -> Result<bool, ArchiveError> {
        let path = self.path(object);
        let payload = PutPayload::from(content);
        let put = self.repeat(async || {
            let create = PutMode::Create.into();
            self.store.put_opts(&path, payload.clone(), create).await
        });
        match put {
            Ok(_) => Ok(true),
            Err(Error::AlreadyExists { .. } | Error::Precondition { .. }) => Ok(false),
            Err(source) => Err(self.failed("writing", object, source)),
        }
    }

    /// Removes an object; it is no error if there is none.
    pub(super) fn delete(&self, object: &str) -> Result<(), ArchiveError> {
        let path = self.path(object);
        match self.repeat(async || self.store.delete(&path).await) {
            Ok(()) | Err(Error::NotFound { .. }) => Ok(()),
            Err(source) => Err(self.failed("removing", object, source)),
        }
    }

    /// All objects of the archive, sorted by name.
    pub(super) fn list(&self) -> Result<Vec<ObjectEntry>, ArchiveError> {
        let prefix = (self.prefix != Path::default()).then_some(&self.prefix);
        let found = self.repeat(async || self.store.list(prefix).try_collect::<Vec<_>>().await);
        let found = found.map_err(|e| self.failed("listing", "its objects", e))?;
        let mut objects: Vec<ObjectEntry> = found
            .into_iter()
            .map(|meta| ObjectEntry {
                path: self.without_prefix(&meta.location),
                bytes: meta.size,
            })
            .collect();
        objects.sort_unstable_by(|a, b| a.path.cmp(&b.path));
        Ok(objects)
    }

    fn path(&self, object: &str) -> Path {
        let parts = object.split('/').map(Into::into);
        self.prefix.parts().chain(parts).collect()
    }

    fn without_prefix(&self, path: &Path) -> String {
        let rest = path.prefix_match(&self.prefix);
        let parts: Vec<_> = rest
            .into_iter()
            .flatten()
            .map(|p| p.as_ref().to_owned())
            .collect();
        parts.join("/")
    }

    /// Tries a call again if another try may succeed.
    fn repeat<T>(&self, call: impl AsyncFn() -> Result<T, Error>) -> Result<T, Error> {
        self.runtime.block_on(async {
            let mut pause = FIRST_PAUSE;
            for _ in 1..TRIES {
                match call().await {
                    Err(Error::Generic { .. } | Error::JoinError { .. }) => {}
                    answer => return answer,
                }
                tokio::time::sleep(pause).await;
                pause *= 2;
            }
            call().await
        })
    }

    fn failed(&self, doing: &'static str, object: &str, source: Error) -> ArchiveError {
        ArchiveError::Store {
            place: self.name.clone(),
            doing,
            object: object.to_owned(),
            source: Box::new(source),
        }
    }
}

/// True for the name that a file has until it is whole: `NAME#NUMBER`.
fn is_interrupted(path: &FilePath) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    let number = name
        .and_then(|name| name.rsplit_once('#'))
        .map(|(_, number)| number);
    number.is_some_and(|number| !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit()))
}
