//! Where the estimates of a fleet command come from: an archive with diagnoses, or a table.

use std::path::{Path, PathBuf};

use clap::Args;

use super::estimate::specimens;
use crate::archive::{ArchiveReader, ArchiveStore};
use crate::cli::CliError;
use crate::fleet::estimate::read_estimates;
use crate::fleet::members::{ArchivedEstimates, archived_estimates, placed_runs};
use crate::fleet::predict::loops::loop_values;
use crate::fleet::predict::measured::MeasuredRun;
use crate::model::{self, Model};
use crate::profile::Profile;
use crate::regular_file::{self, TABLE_MAX_BYTES};

/// An archive or a table of estimates.
#[derive(Debug, Args)]
pub(super) struct EstimateSource {
    /// Archive with diagnoses (a folder or s3://BUCKET/PREFIX), or a table of estimates (CSV), one row for each quantity of each run
    #[arg(value_name = "ARCHIVE|TABLE")]
    pub(super) source: String,
    /// Table with the columns specimen, family and batch of an archive's specimens [default: all are one family]
    #[arg(long, value_name = "CSV")]
    pub(super) specimens: Option<PathBuf>,
    /// Model of the diagnoses in an archive
    #[arg(long, value_name = "MODEL", default_value = "equivalent")]
    pub(super) baseline: String,
}

impl EstimateSource {
    /// The model of the estimates.
    pub(super) fn model(&self) -> Result<&'static Model, CliError> {
        Ok(model::find(&self.baseline)?)
    }

    /// The rows of the table or of the archive, and what was left out.
    pub(super) fn load(&self) -> Result<ArchivedEstimates, CliError> {
        let path = Path::new(&self.source);
        if path.is_file() {
            let text =
                regular_file::read_text(path, TABLE_MAX_BYTES).map_err(CliError::file(path, "reading"))?;
            return Ok(ArchivedEstimates {
                rows: read_estimates(&self.source, text.as_bytes())?,
                left_out: Vec::new(),
            });
        }
        let model = self.model()?;
        let members = self.specimens.as_deref().map(specimens).transpose()?;
        let store = ArchiveStore::open_existing(&self.source)?;
        let reader = ArchiveReader::open(&store)?;
        let diagnosed = reader.diagnoses(model.name)?;
        Ok(archived_estimates(&reader.runs()?, &diagnosed, members.as_ref()))
    }

    /// What the loops of the archived runs measured, by start; nothing for a table, which has no loops.
    pub(super) fn measured(&self) -> Result<Vec<MeasuredRun>, CliError> {
        if Path::new(&self.source).is_file() {
            return Ok(Vec::new());
        }
        let members = self.specimens.as_deref().map(specimens).transpose()?;
        let store = ArchiveStore::open_existing(&self.source)?;
        let reader = ArchiveReader::open(&store)?;
        let (runs, cycles, profiles) = (reader.runs()?, reader.cycles()?, reader.profiles()?);
        let placed = placed_runs(&runs, members.as_ref()).into_iter().flatten();
        let measured = placed.filter_map(|placed| {
            let text = profiles.get(&placed.run_id)?;
            Some(MeasuredRun {
                profile: Profile::from_toml(text, &placed.run_id).ok()?,
                loops: loop_values(cycles.get(&placed.run_id)?.iter()),
                placed,
            })
        });
        Ok(measured.collect())
    }

    /// The source as a page shows it: its name without the folder.
    pub(super) fn shown(&self) -> String {
        let name = Path::new(&self.source).file_name();
        name.map_or(self.source.clone(), |name| name.to_string_lossy().into_owned())
    }
}
