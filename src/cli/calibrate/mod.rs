//! `leafbench calibrate`: `session` keeps what was read, `table` reads points from a file, `walk` takes them with a technician,
//! `result` makes the calibration file and its report.

mod result;
mod session;
mod store_hash;
mod table;
mod walk;

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::shared::client::DataArg;
use super::shared::local::{self, BenchArg};
use super::{CliCommand, CliError, Done, Output};
use crate::calibration::CalibratedChannel;
use crate::config::Bench;
use result::{Certificate, ChannelFigures};
use session::CalibrationSession;
use table::PointRow;
use walk::{Instrument, Walked};

/// Calibrate a sensor against a reference instrument, step by step, and write its calibration file
#[derive(Debug, Args)]
#[command(
    after_help = "The steps are: zero, up through the levels, down again, zero. At each step the sensor's uncorrected reading is\n\
                  shown; type the value of the reference. The points are kept: leave with q or Ctrl-C, and the same command goes on\n\
                  where you left. b goes one step back. Nothing is moved: use jog, a profile with holds, or weights.\n\
                  Exit code 0: the file is written; 1: interrupted, or no class is reached; 2: unusable input."
)]
pub(super) struct CalibrateArgs {
    /// What is calibrated
    #[arg(long, value_enum, required_unless_present = "store_hash")]
    channel: Option<ChannelWord>,
    #[command(flatten)]
    bench: BenchArg,
    #[command(flatten)]
    data: DataArg,
    /// Number of the certificate that this calibration gets
    #[arg(long, value_name = "TEXT", required_unless_present = "store_hash")]
    certificate: Option<String>,
    /// Serial number of the sensor
    #[arg(long, value_name = "TEXT", required_unless_present = "store_hash")]
    serial: Option<String>,
    /// Expanded uncertainty (k = 2) of the reference instrument, percent of its value
    #[arg(long, value_name = "PERCENT", required_unless_present = "store_hash")]
    reference_uncertainty: Option<f64>,
    /// Reference instrument: type, serial number, certificate
    #[arg(long, value_name = "TEXT", default_value = "")]
    reference: String,
    /// Maker and type of the sensor
    #[arg(long, value_name = "TEXT", default_value = "")]
    sensor: String,
    /// Who calibrates the sensor
    #[arg(long, value_name = "TEXT", default_value = "in house")]
    laboratory: String,
    /// Last day of the calibration, YYYY-MM-DD [default: one year from today]
    #[arg(long, value_name = "DATE")]
    due: Option<jiff::civil::Date>,
    /// Greatest level, N or mm [default: the upper limit of the bench]
    #[arg(long, value_name = "VALUE")]
    max: Option<f64>,
    /// Levels above zero, evenly spaced up to the greatest
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(2..=50))]
    levels: u32,
    /// Times that all levels are taken up and down; ISO 7500-1 asks for 3, ISO 9513 for 2
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=10))]
    series: u32,
    /// Highest order of the polynomial, 1 to 3; a lower one is taken where it is enough
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=3))]
    order: u32,
    /// Values of the reference from a CSV: direction (up, down), reference_n or reference_mm, one row for each step; with
    /// reading_n or reading_mm too, no rig is needed
    #[arg(long, value_name = "FILE")]
    points: Option<PathBuf>,
    /// Calibration file to write [default: CERTIFICATE.toml here]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replace the file if it is there already
    #[arg(long)]
    force: bool,
    /// Begin again in place of going on with an interrupted calibration
    #[arg(long)]
    restart: bool,
    /// Instead: store the calibration hash of the bench file in the rig, which must be off, with no daemon running
    #[arg(long, conflicts_with_all = ["channel", "points", "out"])]
    store_hash: bool,
    /// Link for --store-hash [default: from the bench file]
    #[arg(long, value_name = "ADDRESS", requires = "store_hash")]
    link: Option<String>,
}

/// A channel on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ChannelWord {
    /// The load cell, N
    Force,
    /// The LVDT, mm
    Displacement,
}

impl CliCommand for CalibrateArgs {
    const NAME: &'static str = "calibrate";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench calibrate --channel force --certificate LC-7 --serial 0041 --reference-uncertainty 0.1 --max 2000",
        "leafbench calibrate --channel displacement --certificate LV-3 --serial 18 --reference-uncertainty 0.02 --points points.csv",
        "leafbench calibrate --store-hash --bench bench-configs/benches/mock-vcan.toml --link can:vcan0",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let bench = self.bench.load()?;
        let Some(channel) = self.channel else {
            return store_hash::store(&bench, self.link.as_deref(), output);
        };
        let channel = match channel {
            ChannelWord::Force => CalibratedChannel::Force,
            ChannelWord::Displacement => CalibratedChannel::Displacement,
        };
        let figures = ChannelFigures::of(&bench, channel);
        let certificate = self.certificate(&figures)?;
        let out = self
            .out
            .clone()
            .unwrap_or_else(|| PathBuf::from(format!("{}.toml", certificate.number)));
        // Before the work, not after an hour of it.
        local::require_new(&[&out], self.force)?;
        let rows = self
            .points
            .as_deref()
            .map(|path| table::read(path, channel))
            .transpose()?;
        let part = session::path_of(&out);
        let session = self.session(channel, &certificate, &figures, &part)?;
        let Some(session) = self.taken(session, rows.as_deref(), &bench, &figures, &part)? else {
            output.note(&format!(
                "the points are kept in {}: the same command goes on",
                part.display()
            ));
            return Ok(Done::Negative);
        };
        let done = result::finish(&session, &certificate, &bench, &out, self.order as usize)?;
        // The result has all that the session had.
        let _ = std::fs::remove_file(&part);
        output.result(&done, || done.text())?;
        Ok(Done::success_if(done.assessment.class.is_some()))
    }
}

impl CalibrateArgs {
    /// The texts of the certificate. Clap has seen that the required ones are there.
    fn certificate(&self, figures: &ChannelFigures) -> Result<Certificate, CliError> {
        let today = jiff::Timestamp::now().to_zoned(jiff::tz::TimeZone::UTC).date();
        let in_a_year = today.saturating_add(jiff::Span::new().years(1));
        let text = |text: &Option<String>| text.clone().unwrap_or_default().trim().to_owned();
        let certificate = Certificate {
            number: text(&self.certificate),
            serial: text(&self.serial),
            reference_percent: self.reference_uncertainty.unwrap_or(0.0),
            reference: self.reference.clone(),
            sensor: self.sensor.clone(),
            laboratory: self.laboratory.clone(),
            calibrated: today.to_string(),
            due: self.due.unwrap_or(in_a_year).to_string(),
        };
        let refused = |why: &str| Err(CliError::Input(why.to_owned()));
        if certificate.number.is_empty() || certificate.number.contains('/') || certificate.serial.is_empty()
        {
            return refused(
                "--certificate and --serial need a text without /: copy them from the label and the certificate",
            );
        }
        if !(0.0..=5.0).contains(&certificate.reference_percent) {
            return refused(
                "--reference-uncertainty is outside 0 to 5 %: take it from the certificate of the reference",
            );
        }
        match self.max {
            Some(max) if !(max > 0.0 && max <= figures.capacity) => Err(CliError::Input(format!(
                "--max {max} is outside 0 to the capacity of the sensor, {} {}",
                figures.capacity,
                figures.channel.unit()
            ))),
            _ => Ok(certificate),
        }
    }

    /// The session that was interrupted, or a new one.
    fn session(
        &self,
        channel: CalibratedChannel,
        certificate: &Certificate,
        figures: &ChannelFigures,
        part: &Path,
    ) -> Result<CalibrationSession, CliError> {
        if self.restart && part.exists() {
            std::fs::remove_file(part).map_err(CliError::file(part, "removing"))?;
        }
        let new = CalibrationSession {
            channel,
            certificate: certificate.number.clone(),
            serial: certificate.serial.clone(),
            greatest: self.max.unwrap_or(figures.limit),
            levels: self.levels,
            series: self.series,
            taken: Vec::new(),
        };
        new.continued(part)
    }

    /// The session with all its points: from the file, or from the sensor. `None` if the technician left before its end.
    fn taken(
        &self,
        mut session: CalibrationSession,
        rows: Option<&[PointRow]>,
        bench: &Bench,
        figures: &ChannelFigures,
        part: &Path,
    ) -> Result<Option<CalibrationSession>, CliError> {
        let from_file: Option<Vec<_>> = rows.and_then(|rows| rows.iter().map(PointRow::taken).collect());
        if let Some(taken) = from_file {
            session.taken = taken;
            return Ok(Some(session));
        }
        let references = rows
            .map(|rows| table::of_steps(rows, &session.steps()))
            .transpose()?;
        let client = self.data.client()?;
        let instrument = Instrument {
            client: &client,
            channel: session.channel,
            bench: &bench.name,
            per_count: figures.per_count,
            noise: figures.noise,
        };
        let lines = walk::typed_lines();
        let walked = walk::walk(&instrument, &mut session, references.as_deref(), &lines, part)?;
        Ok((walked == Walked::ToTheEnd).then_some(session))
    }
}
