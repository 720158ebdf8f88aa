//! `leafbench certificate`.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;

use super::result::run_path;
use super::shared::client::DataArg;
use super::shared::local;
use super::{CliCommand, CliError, Done, Output};
use crate::recording::atomic_file;
use crate::recording::run_file::RunFile;
use crate::report::certificate;

/// Write the certificate of a run: one HTML page, which prints on one sheet A4; needs no daemon
#[derive(Debug, Args)]
pub(super) struct CertificateArgs {
    /// Run id, whole or short, `latest`, or a .leafrun file
    #[arg(value_name = "RUN")]
    run: String,
    /// File to write [default: RUN-certificate.html here]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replace the file if it is there already
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    data: DataArg,
}

/// The file that was written.
#[derive(serde::Serialize)]
struct WrittenCertificate {
    file: PathBuf,
}

impl CliCommand for CertificateArgs {
    const NAME: &'static str = "certificate";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench certificate latest",
        "leafbench certificate latest --out certificate.html",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let path = run_path(&self.run, &self.data)?;
        let run = RunFile::open(&path)?;
        let named = || PathBuf::from(format!("{}-certificate.html", run.header().run_id));
        let file = self.out.clone().unwrap_or_else(named);
        local::require_new(&[&file], self.force)?;
        let page = certificate::page(&run).map_err(CliError::file(&path, "reading"))?;
        atomic_file::write(&file, |sink| sink.write_all(page.as_bytes()))
            .map_err(CliError::file(&file, "writing"))?;
        let written = WrittenCertificate { file };
        output.result(&written, || written.file.display().to_string())?;
        Ok(Done::Success)
    }
}
