//! A run as CSV over HTTP: exported whole into a file of its own first, so that what arrives is complete or fails visibly.

use std::fs::File;
use std::io::Read;

use axum::body::Body;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::api::ApiError;
use super::store::Store;
use crate::recording::export::{self, Selection};
use crate::recording::run_file::RunFile;

/// Bytes read and sent at a time.
const CHUNK: usize = 64 * 1024;

/// Which part of the run; at most one of the three.
#[derive(Debug, Clone, Copy, Default, serde::Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Chunk {
    /// One counted cycle.
    cycle: Option<u32>,
    /// The mean over the complete counted cycles.
    #[serde(default)]
    mean_loop: bool,
    /// Every n-th tick.
    every: Option<u64>,
}

impl Chunk {
    /// The selection, and what to add to the file's name.
    fn selection(self) -> Option<(Selection, String)> {
        match (self.cycle, self.mean_loop, self.every) {
            (None, false, None) => Some((Selection::Whole, String::new())),
            (Some(cycle), false, None) => Some((Selection::Cycle(cycle), format!("-cycle-{cycle}"))),
            (None, true, None) => Some((Selection::MeanLoop, "-mean-loop".to_owned())),
            (None, false, Some(n)) => Some((Selection::Every(n), format!("-every-{n}"))),
            _ => None,
        }
    }
}

/// A CSV that waits to be sent.
pub(super) struct Download {
    file: File,
    bytes: u64,
    name: String,
}

/// Exports the part into a file that has no name any more by the time it is sent.
pub(super) fn prepare(store: &Store, run_id: &str, part: &Chunk) -> Result<Download, ApiError> {
    let (selection, suffix) = part.selection().ok_or_else(|| {
        ApiError::new(
            StatusCode::BAD_REQUEST,
            "more than one part was asked for".to_owned(),
            "give one of cycle, mean_loop and every".to_owned(),
        )
    })?;
    let listing = store
        .find(run_id)
        .map_err(ApiError::disk)?
        .ok_or_else(|| ApiError::no_run(run_id))?;
    let run = RunFile::open(&listing.path).map_err(ApiError::disk)?;
    let name = format!("{}{suffix}.csv", listing.run_id);
    let folder = Scratch::new(store).map_err(scratch_failed)?;
    let exported =
        export::export(&run, selection, &folder.0.join("download.csv")).map_err(|e| ApiError::invalid(&e))?;
    let file = File::open(&exported.csv).map_err(scratch_failed)?;
    let bytes = file.metadata().map_err(scratch_failed)?.len();
    Ok(Download { file, bytes, name })
}

fn scratch_failed(error: std::io::Error) -> ApiError {
    ApiError::new(
        StatusCode::INSUFFICIENT_STORAGE,
        format!("the CSV cannot be made in the data folder: {error}"),
        "check the disk's space".to_owned(),
    )
}

/// A folder for one export; gone with this.
struct Scratch(std::path::PathBuf);

impl Scratch {
    fn new(store: &Store) -> std::io::Result<Scratch> {
        use std::sync::atomic::{AtomicU64, Ordering};
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let path = store
            .folder()
            .join(format!(".download-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&path)?;
        Ok(Scratch(path))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // What stays behind costs space and nothing else.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Sends it in chunks, read on a thread that may wait for the disk.
pub(super) fn stream(download: Download) -> Response {
    let (sender, receiver) = tokio::sync::mpsc::channel(4);
    let mut file = download.file;
    tokio::task::spawn_blocking(move || {
        let mut next = || -> std::io::Result<Option<Vec<u8>>> {
            let mut chunk = vec![0; CHUNK];
            let read = file.read(&mut chunk)?;
            chunk.truncate(read);
            Ok((read > 0).then_some(chunk))
        };
        // Ends with the file, with a failure that the receiver hears of, or where whoever downloads has gone.
        while let Some(item) = next().transpose() {
            let failed = item.is_err();
            if sender.blocking_send(item).is_err() || failed {
                return;
            }
        }
    });
    let chunks = futures_util::stream::unfold(receiver, |mut receiver| async move {
        receiver.recv().await.map(|item| (item, receiver))
    });
    let headers = [
        (header::CONTENT_TYPE, "text/csv; charset=utf-8".to_owned()),
        (header::CONTENT_LENGTH, download.bytes.to_string()),
        (
            header::CONTENT_DISPOSITION,
            format!("attachment; filename=\"{}\"", download.name),
        ),
    ];
    (headers, Body::from_stream(chunks)).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_most_one_part_can_be_asked_for() {
        let part = |cycle, mean_loop, every| {
            Chunk {
                cycle,
                mean_loop,
                every,
            }
            .selection()
        };
        assert_eq!(part(None, false, None), Some((Selection::Whole, String::new())));
        assert_eq!(part(Some(3), false, None).map(|s| s.0), Some(Selection::Cycle(3)));
        assert_eq!(part(None, true, None).map(|s| s.0), Some(Selection::MeanLoop));
        assert_eq!(part(Some(3), true, None), None);
        assert_eq!(part(None, true, Some(2)), None);
    }
}
