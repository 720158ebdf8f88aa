//! The table of diagnoses: what the recording of a run says about each parameter of a model and each effect that the model may lack.
//! One file for each run and model, written once.

use std::time::Duration;

use super::lock::WriterLock;
use super::manifest::{Manifest, ManifestEntry};
use super::parquet_file::{ColumnForm, ParquetFile, TableColumn, TableValue, needed, optional};
use super::partition::{DIAGNOSES, SAMPLES, folder_name, hash};
use super::read::{number_at, text_at, whole_at};
use super::{ArchiveError, ArchiveReader, ArchiveStore};

/// Columns of the table.
const COLUMNS: [TableColumn; 19] = [
    needed("run_id", ColumnForm::Text, ""),
    needed("model", ColumnForm::Text, ""),
    needed("program_version", ColumnForm::Text, ""),
    needed("verdict", ColumnForm::Text, ""),
    needed("message", ColumnForm::Text, ""),
    needed("kind", ColumnForm::Text, ""),
    needed("quantity", ColumnForm::Text, ""),
    needed("unit", ColumnForm::Text, ""),
    needed("scale", ColumnForm::Text, ""),
    optional("estimate", ColumnForm::Number, ""),
    optional("std_error", ColumnForm::Number, ""),
    optional("form_error", ColumnForm::Number, ""),
    needed("testable", ColumnForm::Whole, "1"),
    needed("named", ColumnForm::Whole, "1"),
    optional("confidence", ColumnForm::Number, "1"),
    needed("parameter", ColumnForm::Text, ""),
    optional("value", ColumnForm::Number, ""),
    optional("ci95_low", ColumnForm::Number, ""),
    optional("ci95_high", ColumnForm::Number, ""),
];

/// A commit waits so long for another writer: commits of diagnoses are short, those of runs take seconds.
const PATIENCE: Duration = Duration::from_secs(60);

/// The diagnosis of one run with one model.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct DiagnosedRun {
    /// Id of the run.
    pub run_id: String,
    /// The model that the diagnosis began with.
    pub model: String,
    /// Version of leafbench that diagnosed it.
    pub program_version: String,
    /// `adequate`, `explained` ... as in diagnosis.json; `failed` if the recording could not be diagnosed.
    pub verdict: String,
    /// Why it could not be diagnosed.
    pub message: String,
    /// One row for each quantity; a failed diagnosis has none.
    pub rows: Vec<DiagnosisRow>,
}

/// One quantity of a diagnosis.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct DiagnosisRow {
    /// `parameter` of the model, or `effect`.
    pub kind: String,
    /// Name of the parameter, or code of the effect.
    pub quantity: String,
    /// Unit of the estimate.
    pub unit: String,
    /// `relative` or `absolute`: how it is pooled.
    pub scale: String,
    /// Estimate and standard error, which need not be there if the recording cannot tell.
    pub estimate: Option<f64>,
    /// Standard error, in the unit of the estimate.
    pub std_error: Option<f64>,
    /// The part of the standard error that all runs of a family share, because the model is wrong in the same way in all of them.
    pub form_error: Option<f64>,
    /// False if the model imitates the effect in this recording.
    pub testable: bool,
    /// What the diagnosis says of an effect that it names.
    pub named: Option<Estimated>,
}

/// A named effect.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Estimated {
    /// From 0 to 0.99.
    pub confidence: f64,
    /// Its leading parameter with its 95 % interval.
    pub parameter: String,
    /// Its value, in the unit at the end of its name.
    pub value: f64,
    /// The interval; `None` where the recording gives none.
    pub ci95: Option<[f64; 2]>,
}

/// Puts diagnoses into the archive. Those that are there already are left as they are, so it may be called again after an interruption.
/// Returns how many are new.
pub(crate) fn add_diagnoses(store: &ArchiveStore, diagnosed: &[DiagnosedRun]) -> Result<usize, ArchiveError> {
    let lock = WriterLock::take_within(store, PATIENCE)?;
    let mut manifest = Manifest::read(store)?.ok_or_else(|| ArchiveError::NoArchive {
        place: store.name().to_owned(),
    })?;
    let mut entries = Vec::new();
    for run in diagnosed {
        let path = path(&manifest, &run.run_id, &run.model).ok_or_else(|| ArchiveError::NoRun {
            place: store.name().to_owned(),
            run_id: run.run_id.clone(),
        })?;
        if manifest.has(&path) {
            continue;
        }
        let (content, rows) = file(run)?;
        let entry = ManifestEntry {
            bytes: content.len() as u64,
            sha256: hash(&content),
            rows,
            runs: vec![run.run_id.clone()],
            path,
        };
        store.put(&entry.path, content)?;
        entries.push(entry);
    }
    let new = entries.len();
    if new > 0 {
        lock.check()?;
        manifest.extend(entries);
        manifest.write(store)?;
    }
    Ok(new)
}

/// Where the diagnosis of a run with a model lies: beside its samples. `None` if the archive does not have the run.
fn path(manifest: &Manifest, run_id: &str, model: &str) -> Option<String> {
    let samples = manifest
        .of_table(SAMPLES)
        .find(|entry| entry.runs.iter().any(|run| run == run_id))?;
    let folders = samples.path.strip_prefix(SAMPLES)?.rsplit_once('/')?.0;
    Some(format!(
        "{DIAGNOSES}{folders}/{}.parquet",
        folder_name(&format!("{run_id}.{model}"))
    ))
}

impl ArchiveReader<'_> {
    /// Ids of the runs that have no diagnosis with this model yet, by start and then by id.
    pub(crate) fn undiagnosed(&self, model: &str) -> Result<Vec<String>, ArchiveError> {
        let ids = self.runs()?.into_iter().map(|run| run.run_id);
        let none =
            |id: &String| path(self.manifest(), id, model).is_none_or(|path| !self.manifest().has(&path));
        Ok(ids.filter(none).collect())
    }

    /// All diagnoses with this model, by run.
    pub(crate) fn diagnoses(&self, model: &str) -> Result<Vec<DiagnosedRun>, ArchiveError> {
        let mut found = Vec::new();
        for entry in self.manifest().of_table(DIAGNOSES) {
            let batches = self.batches(entry)?;
            let rows = batches
                .iter()
                .flat_map(|batch| (0..batch.num_rows()).map(move |row| (batch, row)));
            let mut diagnosed: Option<DiagnosedRun> = None;
            for (batch, row) in rows {
                let text = |column: &str| text_at(batch, column, row);
                let run = diagnosed.get_or_insert_with(|| DiagnosedRun {
                    run_id: text("run_id"),
                    model: text("model"),
                    program_version: text("program_version"),
                    verdict: text("verdict"),
                    message: text("message"),
                    rows: Vec::new(),
                });
                run.rows.extend(row_at(batch, row));
            }
            found.extend(diagnosed.filter(|run| run.model == model));
        }
        found.sort_by(|a, b| a.run_id.cmp(&b.run_id));
        Ok(found)
    }
}

/// A row; `None` for the row of a failed diagnosis.
fn row_at(batch: &arrow_array::RecordBatch, row: usize) -> Option<DiagnosisRow> {
    let text = |column: &str| text_at(batch, column, row);
    let number = |column: &str| number_at(batch, column, row);
    let named = whole_at(batch, "named", row) != 0;
    let kind = text("kind");
    (!kind.is_empty()).then(|| DiagnosisRow {
        kind,
        quantity: text("quantity"),
        unit: text("unit"),
        scale: text("scale"),
        estimate: number("estimate"),
        std_error: number("std_error"),
        form_error: number("form_error"),
        testable: whole_at(batch, "testable", row) != 0,
        named: named.then(|| Estimated {
            confidence: number("confidence").unwrap_or_default(),
            parameter: text("parameter"),
            value: number("value").unwrap_or(f64::NAN),
            ci95: number("ci95_low")
                .zip(number("ci95_high"))
                .map(|(low, high)| [low, high]),
        }),
    })
}

/// A diagnosis as the bytes of a Parquet file, and the number of its rows. A failed one has a row without a quantity, so that the table
/// says so.
fn file(run: &DiagnosedRun) -> Result<(Vec<u8>, u64), ArchiveError> {
    let mut file = ParquetFile::new(&COLUMNS, &[])?;
    let none = DiagnosisRow::default();
    if run.rows.is_empty() {
        file.row(&values(run, &none))?;
    }
    for row in &run.rows {
        file.row(&values(run, row))?;
    }
    file.finish()
}

fn values<'a>(run: &'a DiagnosedRun, row: &'a DiagnosisRow) -> [TableValue<'a>; 19] {
    use TableValue::{Text, Whole};
    let named = row.named.as_ref();
    let number = TableValue::finite;
    let ci95 = named.and_then(|n| n.ci95);
    [
        Text(&run.run_id),
        Text(&run.model),
        Text(&run.program_version),
        Text(&run.verdict),
        Text(&run.message),
        Text(&row.kind),
        Text(&row.quantity),
        Text(&row.unit),
        Text(&row.scale),
        number(row.estimate),
        number(row.std_error),
        number(row.form_error),
        Whole(i64::from(row.testable)),
        Whole(i64::from(named.is_some())),
        number(named.map(|n| n.confidence)),
        Text(named.map_or("", |n| &n.parameter)),
        number(named.map(|n| n.value)),
        number(ci95.map(|[low, _]| low)),
        number(ci95.map(|[_, high]| high)),
    ]
}
