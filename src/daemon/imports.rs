//! Tables of other programs that come in through the page: a preview of what is taken for what, and the recording (CSV and data
//! package) in the folder `imports` of the data folder.

use std::path::{Path, PathBuf};

use axum::Json;
use axum::body::Bytes;
use axum::extract::rejection::QueryRejection;
use axum::extract::{self, FromRequest, Query, Request, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::blocking::blocking;
use super::client_types::Failure;
use super::error::{ApiError, chain};
use super::server::ServerLimits;
use super::state::{App, DaemonState};
use crate::recording::import::{
    DecimalSign, ImportError, ImportOptions, ImportSource, Imported, import, parse_map, save, view,
};
use crate::recording::{Recording, datapackage};
use crate::regular_file::{self, TABLE_MAX_BYTES};

/// Largest foreign table that the page takes, bytes: an hour at 1 kHz with some columns. The command line takes larger ones.
pub(super) const TABLE_LIMIT: usize = 128 << 20;
/// Folder of the imported recordings in the data folder.
const FOLDER: &str = "imports";
/// Most points of the loop in a preview.
const LOOP_POINTS: usize = 3000;
/// Rows of a preview.
const PREVIEW_ROWS: usize = 8;
/// Longest name of a recording, characters.
const NAME_MAX_CHARS: usize = 64;

type HttpAnswer<T> = Result<T, ApiError>;

/// How to read a foreign table.
#[derive(Debug, Clone, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ImportQuery {
    /// Name of the foreign file.
    file: String,
    /// What the columns are, as for `leafbench import --map`: `#2=displacement_mm,#3=force_n*1000`. Empty: from names and units.
    #[serde(default)]
    map: String,
    /// Time between two samples in s, in place of a column of time.
    #[serde(default)]
    dt: Option<f64>,
    /// Decimal sign, `point` or `comma`; without it from the numbers.
    #[serde(default)]
    #[param(value_type = Option<String>)]
    decimal: Option<DecimalSign>,
    /// Turns the sign of the force.
    #[serde(default)]
    flip_force: bool,
    /// Turns the sign of the displacement.
    #[serde(default)]
    flip_displacement: bool,
    /// Name of the recording: 1 to 64 letters, digits, dashes, points and underscores. Not for a preview.
    #[serde(default)]
    name: String,
    /// A recording of this name may be replaced.
    #[serde(default)]
    replace: bool,
}

/// A foreign table, and what it would become.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub(super) struct ImportPreview {
    /// How the bytes are read as text.
    encoding: String,
    /// Character between the columns.
    separator: String,
    /// Line of the header, from 1; `null` if there is none.
    header_row: Option<usize>,
    /// Line of the first sample, from 1.
    first_row: usize,
    /// Names of the columns.
    columns: Vec<String>,
    /// The first rows as they stand in the file.
    rows: Vec<Vec<String>>,
    /// Why the table cannot be imported like this; empty if it can.
    problem: String,
    /// What it would become; `null` if it cannot be imported like this.
    result: Option<ImportResult>,
}

/// The recording that a foreign table becomes.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub(super) struct ImportResult {
    /// The columns that are read.
    mapped: Vec<ImportColumn>,
    /// True where names and units decided.
    guessed: bool,
    /// Decimal sign: `point` or `comma`.
    #[schema(value_type = String)]
    decimal: DecimalSign,
    /// What to look at, one sentence each.
    notes: Vec<String>,
    /// Number of samples.
    samples: usize,
    /// Time from the first to the last sample, s.
    duration_s: f64,
    /// The first samples: time in s, displacement in mm, force in N.
    first: Vec<[f64; 3]>,
    /// Displacement in mm of the points of the loop, thinned.
    loop_displacement_mm: Vec<f64>,
    /// Force in N of the points of the loop.
    loop_force_n: Vec<f64>,
}

/// A column and what it is taken for.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub(super) struct ImportColumn {
    /// Place of the column, from 0.
    index: usize,
    /// `time_s`, `displacement_mm`, `force_n` or `cycle`.
    target: String,
    /// Factor to s, mm or N.
    factor: f64,
    /// Where the factor comes from.
    reason: String,
}

/// An imported recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(super) struct ImportSummary {
    /// Name of the recording.
    name: String,
    /// Path of the CSV.
    csv: String,
    /// Number of samples; 0 if the data package does not say it.
    samples: u64,
    /// Name of the foreign file.
    imported_from: String,
    /// When it was imported, UTC, RFC 3339.
    imported_utc: String,
}

impl ImportQuery {
    fn options(&self) -> HttpAnswer<ImportOptions> {
        if let Some(dt) = self.dt.filter(|s| !(*s > 0.0 && *s <= 86_400.0)) {
            return Err(refused(
                format!("{dt} is no time between two samples"),
                "give seconds above 0, such as 0.001 for 1 kHz",
            ));
        }
        Ok(ImportOptions {
            map: parse_map(&self.map).map_err(|error| refused(error, ""))?,
            interval_s: self.dt,
            decimal: self.decimal,
            flip_force: self.flip_force,
            flip_displacement: self.flip_displacement,
        })
    }

    /// The CSV to write.
    fn csv(&self, state: &DaemonState) -> HttpAnswer<PathBuf> {
        let allowed = |c: char| c.is_ascii_alphanumeric() || "-._".contains(c);
        let right = self.name.len() <= NAME_MAX_CHARS
            && self.name.chars().all(allowed)
            && self.name.starts_with(|c: char| c.is_ascii_alphanumeric());
        match right {
            true => Ok(folder(state).join(format!("{}.csv", self.name))),
            false => Err(refused(
                format!("\"{}\" cannot be the name of a recording", self.name),
                "use 1 to 64 letters, digits, dashes, points and underscores, and begin with a letter or digit",
            )),
        }
    }
}

fn folder(state: &DaemonState) -> PathBuf {
    state.settings.data_folder.join(FOLDER)
}

fn refused(error: String, what_to_do: &str) -> ApiError {
    ApiError::new(StatusCode::UNPROCESSABLE_ENTITY, error, what_to_do.to_owned())
}

fn too_large() -> ApiError {
    ApiError::new(
        StatusCode::PAYLOAD_TOO_LARGE,
        format!("the table has more than {} MiB", TABLE_LIMIT >> 20),
        "import it on the command line: leafbench import FILE".to_owned(),
    )
}

/// The bytes of a table, within the limits of size and time.
pub(super) struct TableBody(Bytes);

impl<S: Send + Sync> FromRequest<S> for TableBody {
    type Rejection = ApiError;

    async fn from_request(request: Request, state: &S) -> HttpAnswer<Self> {
        let told = request.headers().get(header::CONTENT_LENGTH);
        let length: Option<usize> = told.and_then(|value| value.to_str().ok()?.parse().ok());
        if length.is_some_and(|bytes| bytes > TABLE_LIMIT) {
            return Err(too_large());
        }
        let limits = request.extensions().get::<ServerLimits>().copied();
        let limit = limits.unwrap_or_default().body;
        match tokio::time::timeout(limit, Bytes::from_request(request, state)).await {
            Ok(Ok(bytes)) => Ok(TableBody(bytes)),
            Ok(Err(rejection)) if rejection.status() == StatusCode::PAYLOAD_TOO_LARGE => Err(too_large()),
            Ok(Err(rejection)) => Err(ApiError::new(
                rejection.status(),
                rejection.body_text(),
                "choose the file again".to_owned(),
            )),
            Err(_) => Err(ApiError::new(
                StatusCode::REQUEST_TIMEOUT,
                format!("the table did not arrive within {} s", limit.as_secs_f64()),
                "choose the file again".to_owned(),
            )),
        }
    }
}

/// Shows what a foreign table has in it and what it would become. Nothing is written. The body is the file.
#[utoipa::path(post, path = "/api/imports/preview", params(ImportQuery),
    request_body(content = Vec<u8>, content_type = "application/octet-stream"),
    responses((status = 200, body = ImportPreview), (status = 413, body = Failure), (status = 422, body = Failure)))]
pub(super) async fn preview(
    State(state): App,
    query: Result<Query<ImportQuery>, QueryRejection>,
    TableBody(bytes): TableBody,
) -> HttpAnswer<Json<ImportPreview>> {
    let query = query?.0;
    blocking(&state, move |_| {
        let seen = view(&query.file, &bytes).map_err(|error| refused(for_the_page(&error), ""))?;
        let imported = import(&query.file, &bytes, &query.options()?);
        Ok(Json(ImportPreview {
            encoding: seen.encoding.name().to_owned(),
            separator: seen.separator.to_string(),
            header_row: seen.header_row,
            first_row: seen.first_row,
            columns: seen.columns,
            rows: seen.rows,
            problem: imported.as_ref().err().map(for_the_page).unwrap_or_default(),
            result: imported.ok().map(ImportResult::of),
        }))
    })
    .await
}

/// Imports a foreign table as a recording of the data folder: CSV and data package. The body is the file.
#[utoipa::path(post, path = "/api/imports", params(ImportQuery),
    request_body(content = Vec<u8>, content_type = "application/octet-stream"),
    responses((status = 200, body = ImportSummary), (status = 409, body = Failure), (status = 413, body = Failure),
        (status = 422, body = Failure)))]
pub(super) async fn take(
    State(state): App,
    query: Result<Query<ImportQuery>, QueryRejection>,
    TableBody(bytes): TableBody,
) -> HttpAnswer<Json<ImportSummary>> {
    let query = query?.0;
    blocking(&state, move |state| {
        let csv = query.csv(state)?;
        if csv.exists() && !query.replace {
            return Err(ApiError::new(
                StatusCode::CONFLICT,
                format!("there is a recording \"{}\" already", query.name),
                "import under another name, or say that it is to be replaced".to_owned(),
            ));
        }
        let imported = import(&query.file, &bytes, &query.options()?);
        let imported = imported.map_err(|error| refused(for_the_page(&error), ""))?;
        let source = ImportSource {
            file_name: &query.file,
            bytes: &bytes,
            imported_utc: &jiff::Timestamp::now().to_string(),
        };
        let written = crate::recording::atomic_file::create_private_folder(&folder(state))
            .and_then(|()| save(&imported, &source, &csv));
        written.map_err(|error| not_written(&csv, &error))?;
        Ok(Json(summary(&csv)))
    })
    .await
}

fn not_written(csv: &Path, error: &std::io::Error) -> ApiError {
    ApiError::new(
        StatusCode::INTERNAL_SERVER_ERROR,
        format!("{} cannot be written: {error}", csv.display()),
        "check the permissions and the free space of the disk".to_owned(),
    )
}

/// The imported recordings, by name.
#[utoipa::path(get, path = "/api/imports", responses((status = 200, body = Vec<ImportSummary>)))]
pub(super) async fn list(State(state): App) -> HttpAnswer<Json<Vec<ImportSummary>>> {
    blocking(&state, |state| {
        // Before the first import there is no folder.
        let entries = std::fs::read_dir(folder(state)).into_iter().flatten().flatten();
        let mut files: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
        files.retain(|path| path.extension().is_some_and(|e| e == "csv"));
        files.sort();
        Ok(Json(files.iter().map(|path| summary(path)).collect()))
    })
    .await
}

/// An imported recording as CSV.
#[utoipa::path(get, path = "/api/imports/{name}", params(("name" = String, Path)),
    responses((status = 200, content_type = "text/csv", body = String), (status = 404, body = Failure)))]
pub(super) async fn csv(
    State(state): App,
    extract::Path(name): extract::Path<String>,
) -> HttpAnswer<Response> {
    let file_name = format!("{name}.csv");
    let bytes = blocking(&state, move |state| {
        let query = ImportQuery {
            name,
            ..ImportQuery::default()
        };
        let path = query.csv(state)?;
        regular_file::read(&path, u64::MAX).map_err(|error| {
            ApiError::new(
                StatusCode::NOT_FOUND,
                format!("the recording {} cannot be read: {error}", path.display()),
                "GET /api/imports lists the imported recordings".to_owned(),
            )
        })
    })
    .await?;
    let headers = [
        (header::CONTENT_TYPE, "text/csv; charset=utf-8".to_owned()),
        (
            header::CONTENT_DISPOSITION,
            format!("attachment; filename=\"{file_name}\""),
        ),
    ];
    Ok((headers, bytes).into_response())
}

/// What the data package beside a CSV says of it.
fn summary(csv: &Path) -> ImportSummary {
    let text = regular_file::read_text(&datapackage::path_of(csv), TABLE_MAX_BYTES).unwrap_or_default();
    let package: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    let told = |pointer: &str| {
        let text = package.pointer(pointer).and_then(serde_json::Value::as_str);
        text.unwrap_or_default().to_owned()
    };
    ImportSummary {
        name: csv.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        csv: csv.display().to_string(),
        samples: package
            .pointer("/leafbench/rows")
            .and_then(serde_json::Value::as_u64)
            .unwrap_or(0),
        imported_from: told("/leafbench/imported_from/file"),
        imported_utc: told("/created"),
    }
}

impl ImportResult {
    fn of(imported: Imported) -> ImportResult {
        let Recording {
            time_s,
            displacement_mm,
            force_n,
            ..
        } = &imported.recording;
        let every = time_s.len().div_ceil(LOOP_POINTS).max(1);
        let thinned = |values: &[f64]| values.iter().copied().step_by(every).collect();
        let rows = time_s.iter().zip(displacement_mm).zip(force_n).take(PREVIEW_ROWS);
        ImportResult {
            guessed: imported.guessed,
            decimal: imported.decimal,
            notes: imported.notes.iter().map(|note| without_options(note)).collect(),
            samples: time_s.len(),
            duration_s: time_s
                .first()
                .zip(time_s.last())
                .map_or(0.0, |(first, last)| last - first),
            first: rows.map(|((t, x), f)| [*t, *x, *f]).collect(),
            loop_displacement_mm: thinned(displacement_mm),
            loop_force_n: thinned(force_n),
            mapped: imported
                .mapped
                .iter()
                .map(|m| ImportColumn {
                    index: m.index,
                    target: m.target.name().to_owned(),
                    factor: m.factor,
                    reason: without_options(&m.reason),
                })
                .collect(),
        }
    }
}

/// The sentence without the options of the command line: on the page the fields stand for them.
fn without_options(sentence: &str) -> String {
    let replaced = [
        ("add --flip force,displacement", "turn both signs"),
        ("add --flip force or --flip displacement", "turn that sign"),
        ("add --flip displacement", "turn the sign of the displacement"),
        ("add --flip force", "turn the sign of the force"),
        ("add --decimal comma", "choose the comma"),
        ("add --decimal point", "choose the point"),
        (
            "with --decimal point or --decimal comma",
            "with the field for the decimal sign",
        ),
        (
            "--map gives no factor and the header no unit",
            "no factor is given, and the header has no unit",
        ),
        ("from --map, although", "as chosen here, although"),
        ("from --map", "as chosen here"),
        (", such as --dt 0.001", ", such as 0.001"),
    ];
    replaced
        .into_iter()
        .fold(sentence.to_owned(), |text, (option, words)| {
            text.replace(option, words)
        })
}

/// Why a table cannot be imported, and what to do on the page.
fn for_the_page(error: &ImportError) -> String {
    match error {
        ImportError::Unmapped { problem, .. } => format!(
            "{}: choose below what each column is, with the factor to s, mm or N where the header has no unit (1000 from kN to N)",
            problem.replace("--map names", "there is")
        ),
        ImportError::Column { column, problem, .. } => format!("column {column}: {problem}: choose another one"),
        ImportError::WrongQuantity { column, target, unit, .. } => format!(
            "{column} is not {target}: its unit is {unit}: choose another column, or write the factor"
        ),
        ImportError::Twice { target, .. } => format!(
            "{target} is given twice: choose one column for it, and no time between two samples where a column is the time"
        ),
        ImportError::NoTime { .. } => {
            "there is no column of time: choose one below, or give the time between two samples in s, such as 0.001".to_owned()
        }
        other => without_options(&chain(other)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_sentence_of_the_page_names_an_option_of_the_command_line() {
        let tables: [(&str, &str); 8] = [
            ("", "x;y\n1;2\n2;3\n3;4\n"),
            ("", "t [s];Weg [mm]\n0;1\n1;2\n2;3\n"),
            ("", "Weg [mm];Kraft [N]\n0;1\n1;2\n2;3\n"),
            ("#1=time_s", "t [s];Weg [mm];F [N]\n0;1;1\n1;2;1\n2;3;1\n"),
            (
                "#1=force_n,#2=displacement_mm",
                "t [s];Weg [mm];F [N]\n0;1;1\n1;2;1\n2;3;1\n",
            ),
            (
                "no=force_n,#2=displacement_mm",
                "t [s];Weg [mm];F [N]\n0;1;1\n1;2;1\n2;3;1\n",
            ),
            ("", "t [s];Weg [mm];F [N]\n0;1,5;1.5\n1;2,5;1.5\n2;3;1\n"),
            ("", "t [s];Weg [mm];F [N]\n1;1;1\n1;2;1\n1;3;1\n"),
        ];
        for (map, text) in tables {
            let options = ImportOptions {
                map: parse_map(map).expect("a map"),
                ..ImportOptions::default()
            };
            let error = import("a.csv", text.as_bytes(), &options).expect_err(text);
            let told = for_the_page(&error);
            assert!(!told.contains("--"), "{told}");
            assert!(told.contains(": "), "what to do: {told}");
        }
        let signs = "t [s];Weg [mm];F [N]\n0;1,234;-1,111\n1;2,345;-2,222\n2;3,456;-3,333\n";
        let told =
            ImportResult::of(import("a.csv", signs.as_bytes(), &ImportOptions::default()).expect("read"));
        assert_eq!(told.notes.len(), 2, "{:?}", told.notes);
        for note in told.notes.iter().chain(told.mapped.iter().map(|m| &m.reason)) {
            assert!(!note.contains("--"), "{note}");
        }
    }
}
