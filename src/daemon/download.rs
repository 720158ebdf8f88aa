//! A run as CSV, MF4 or Parquet over HTTP. The run is first exported to a temporary file, so that the download is complete or
//! fails.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use axum::body::Body;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::error::ApiError;
use super::store::Store;
use crate::recording::atomic_file;
use crate::recording::export::{self, ExportError, Selection, TableFormat};
use crate::recording::run_file::RunFile;

/// Size of the blocks that are read and sent.
const BLOCK_BYTES: usize = 64 * 1024;

/// The part of the run to export: at most one of the three.
#[derive(Debug, Clone, Copy, Default, serde::Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct DownloadPart {
    /// Number of one counted cycle.
    cycle: Option<u32>,
    /// The mean over the complete counted cycles.
    #[serde(default)]
    mean_loop: bool,
    /// Every n-th sample.
    every: Option<u64>,
    /// `1` to get what is left of a damaged or incomplete run.
    #[serde(default, deserialize_with = "one_or_true")]
    partial: bool,
}

/// `1`, `true`, `0` or `false`.
fn one_or_true<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    let text: String = serde::Deserialize::deserialize(deserializer)?;
    match text.as_str() {
        "1" | "true" => Ok(true),
        "0" | "false" => Ok(false),
        _ => Err(serde::de::Error::custom("partial must be 1 or 0")),
    }
}

impl DownloadPart {
    /// The selection, and the addition to the file name.
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

/// Format of the file that is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum DownloadFormat {
    /// Text, without its data package.
    Csv,
    /// Doubles, with all facts of the run in the same file.
    Table(TableFormat),
}

impl DownloadFormat {
    fn extension(self) -> &'static str {
        match self {
            DownloadFormat::Csv => "csv",
            DownloadFormat::Table(format) => format.extension(),
        }
    }

    fn content_type(self) -> &'static str {
        match self {
            DownloadFormat::Csv => "text/csv; charset=utf-8",
            DownloadFormat::Table(TableFormat::Parquet) => "application/vnd.apache.parquet",
            // The general type of files: a browser saves it.
            DownloadFormat::Table(TableFormat::Mf4) => "application/octet-stream",
        }
    }

    /// Exports to a file in `folder`; its path.
    fn export(self, run: &RunFile, selection: Selection, folder: &Path) -> Result<PathBuf, ExportError> {
        let path = folder.join("download").with_extension(self.extension());
        match self {
            DownloadFormat::Csv => export::export(run, selection, &path).map(|exported| exported.csv),
            DownloadFormat::Table(format) => {
                export::export_table(run, selection, format, &path)?;
                Ok(path)
            }
        }
    }
}

/// An exported run that is ready to be sent.
pub(super) struct Download {
    format: DownloadFormat,
    file: File,
    bytes: u64,
    name: String,
    /// What is not in the file; empty if it is whole.
    missing: String,
}

/// Header of an answer that is not the whole run, with what is missing.
const PARTIAL_HEADER: &str = "leafbench-partial";

/// Exports the part to a temporary file. The file is deleted from its folder before it is sent, so that it cannot remain.
pub(super) fn prepare(
    store: &Store,
    run_id: &str,
    part: &DownloadPart,
    format: DownloadFormat,
) -> Result<Download, ApiError> {
    let (selection, suffix) = part.selection().ok_or_else(|| {
        ApiError::new(
            StatusCode::BAD_REQUEST,
            "the request names more than one part of the run".to_owned(),
            "give only one of cycle, mean_loop and every".to_owned(),
        )
    })?;
    let listing = store.find(run_id).map_err(ApiError::not_found)?;
    let run = RunFile::open(&listing.path).map_err(ApiError::disk)?;
    let missing = run.survey().incomplete();
    if !missing.is_empty() && !part.partial {
        return Err(ApiError::new(
            StatusCode::CONFLICT,
            format!("run {} is not whole: {missing}", listing.run_id),
            "add partial=1 to the address to get what is left of it".to_owned(),
        ));
    }
    let partial = if missing.is_empty() { "" } else { "-partial" };
    let name = format!("{}{suffix}{partial}.{}", listing.run_id, format.extension());
    let folder = Scratch::new(store).map_err(scratch_failed)?;
    let exported = format.export(&run, selection, &folder.0);
    let file = File::open(exported.map_err(|e| ApiError::invalid(&e))?).map_err(scratch_failed)?;
    let bytes = file.metadata().map_err(scratch_failed)?.len();
    Ok(Download {
        format,
        file,
        bytes,
        name,
        missing,
    })
}

fn scratch_failed(error: std::io::Error) -> ApiError {
    ApiError::new(
        StatusCode::INSUFFICIENT_STORAGE,
        format!("the export cannot be written to the data folder: {error}"),
        "free space on the disk".to_owned(),
    )
}

/// The temporary folder of one export. Dropping it deletes the folder.
struct Scratch(PathBuf);

impl Scratch {
    fn new(store: &Store) -> std::io::Result<Scratch> {
        use std::sync::atomic::{AtomicU64, Ordering};
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let path = store
            .folder()
            .join(format!(".download-{}-{number}", std::process::id()));
        atomic_file::create_private_folder(&path)?;
        Ok(Scratch(path))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // A folder that cannot be deleted only takes space.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Sends the file in blocks. They are read on a thread that may wait for the disk.
pub(super) fn stream(download: Download) -> Response {
    let (sender, receiver) = tokio::sync::mpsc::channel(4);
    let mut file = download.file;
    tokio::task::spawn_blocking(move || {
        let mut next = || -> std::io::Result<Option<Vec<u8>>> {
            let mut block = vec![0; BLOCK_BYTES];
            let read = file.read(&mut block)?;
            block.truncate(read);
            Ok((read > 0).then_some(block))
        };
        // Ends with the file, with a read error (the receiver gets it), or when the client disconnects.
        while let Some(item) = next().transpose() {
            let failed = item.is_err();
            if sender.blocking_send(item).is_err() || failed {
                return;
            }
        }
    });
    let blocks = futures_util::stream::unfold(receiver, |mut receiver| async move {
        receiver.recv().await.map(|item| (item, receiver))
    });
    let headers = [
        (header::CONTENT_TYPE, download.format.content_type().to_owned()),
        (header::CONTENT_LENGTH, download.bytes.to_string()),
        (
            header::CONTENT_DISPOSITION,
            format!("attachment; filename=\"{}\"", download.name),
        ),
    ];
    let mut response = (headers, Body::from_stream(blocks)).into_response();
    // Sentences of this program: printable ASCII. Other characters, from a path, leave the mark alone.
    let missing = HeaderValue::from_str(&download.missing).unwrap_or(HeaderValue::from_static("yes"));
    if !download.missing.is_empty() {
        response.headers_mut().insert(PARTIAL_HEADER, missing);
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_most_one_part_can_be_selected() {
        let part = |cycle, mean_loop, every| {
            DownloadPart {
                cycle,
                mean_loop,
                every,
                partial: false,
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
