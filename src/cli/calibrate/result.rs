//! The end of a calibration: polynomial, errors, class, the file, and what to do with it.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::super::CliError;
use super::session::CalibrationSession;
use crate::calibration::assessment::{self, Assessment, CriterionResult, SensorFigures};
use crate::calibration::{CalibratedChannel, CalibrationFile, CalibrationPoint, class, fit};
use crate::config::Bench;
use crate::config::calibration::ReadCalibration;
use crate::daemon::reading::WINDOW_SAMPLES;
use crate::recording::{ChannelScale, atomic_file};

/// Texts and figures of the certificate that are not measured.
pub(super) struct Certificate {
    pub number: String,
    pub serial: String,
    pub reference: String,
    /// Expanded uncertainty (k = 2) of the reference, percent of its value.
    pub reference_percent: f64,
    pub sensor: String,
    pub laboratory: String,
    pub calibrated: String,
    pub due: String,
}

impl Certificate {
    /// A calibration file with these texts; its figures are empty.
    fn file(&self, channel: CalibratedChannel) -> CalibrationFile {
        CalibrationFile {
            channel,
            certificate: self.number.clone(),
            laboratory: self.laboratory.clone(),
            sensor: self.sensor.clone(),
            serial: self.serial.clone(),
            reference: self.reference.clone(),
            calibrated: self.calibrated.clone(),
            due: self.due.clone(),
            class: String::new(),
            expanded_uncertainty: 0.0,
            per_count: 0.0,
            capacity: 0.0,
            noise: 0.0,
            polynomial: Vec::new(),
            points: Vec::new(),
        }
    }
}

/// What to write into the bench file.
fn bench_line(channel: CalibratedChannel, file: &Path) -> String {
    format!("[{}] calibration = \"{}\"", channel.table(), file.display())
}

/// Decimals that a value of this channel is shown with.
fn decimals(channel: CalibratedChannel) -> usize {
    match channel {
        CalibratedChannel::Force => 2,
        CalibratedChannel::Displacement => 4,
    }
}

/// Figures of the channel in the bench file, N or mm.
pub(super) struct ChannelFigures {
    pub channel: CalibratedChannel,
    pub per_count: f64,
    pub capacity: f64,
    pub noise: f64,
    /// Upper limit of the bench.
    pub limit: f64,
    scale: ChannelScale,
}

impl ChannelFigures {
    pub(super) fn of(bench: &Bench, channel: CalibratedChannel) -> ChannelFigures {
        let (force, displacement) = (&bench.force_channel, &bench.displacement_channel);
        match channel {
            CalibratedChannel::Force => ChannelFigures {
                channel,
                per_count: force.n_per_count,
                capacity: force.capacity_n,
                noise: force.noise_n,
                limit: bench.limits.force_max_n,
                scale: force.scale(),
            },
            CalibratedChannel::Displacement => ChannelFigures {
                channel,
                per_count: displacement.mm_per_count,
                capacity: displacement.capacity_mm,
                noise: displacement.noise_mm,
                limit: bench.limits.displacement_max_mm,
                scale: displacement.scale(),
            },
        }
    }

    /// The worst error of the bench as it is, with the zero of the series taken off, percent of the reference.
    fn as_found_percent(&self, points: &[CalibrationPoint]) -> f64 {
        // Between two counts, so that the mean of a second is not rounded.
        let value = |reading: f64| {
            let counts = reading / self.per_count;
            let (low, high) = (counts.floor(), counts.ceil());
            let [a, b] = [low, high].map(|counts| self.scale.value(counts as i32));
            a + (b - a) * (counts - low)
        };
        let greatest = points.iter().map(|p| p.reference.abs()).fold(0.0, f64::max);
        let zero = points.iter().find(|p| p.is_zero(greatest));
        let zero = zero.map_or(0.0, |p| value(p.up) - p.reference);
        let error = |p: &CalibrationPoint| 100.0 * (value(p.up) - zero - p.reference) / p.reference.abs();
        let errors = points.iter().filter(|p| !p.is_zero(greatest)).map(error);
        errors.fold(0.0, |worst: f64, e| if e.abs() > worst.abs() { e } else { worst })
    }
}

/// What a calibration came to.
#[derive(Debug, Serialize)]
pub(super) struct Calibrated {
    pub file: PathBuf,
    #[serde(skip)]
    unit: &'static str,
    #[serde(skip)]
    decimals: usize,
    /// Order of the polynomial; 1 is a straight line.
    pub order: usize,
    /// Factors of the powers of the reading, from the constant on.
    pub polynomial: Vec<f64>,
    /// Standard deviation of what the polynomial leaves, N or mm.
    pub residual_sigma: f64,
    /// Worst error before this calibration, percent of the reference.
    pub as_found_percent: f64,
    pub assessment: Assessment,
    pub class: String,
    /// What to write into the bench file.
    pub bench_line: String,
    /// Calibration hash of the bench with this file.
    pub calibration_hash: String,
}

/// Fits, assesses, and writes the file.
pub(super) fn finish(
    session: &CalibrationSession,
    certificate: &Certificate,
    bench: &Bench,
    out: &Path,
    highest_order: usize,
) -> Result<Calibrated, CliError> {
    let figures = ChannelFigures::of(bench, session.channel);
    let points = session.points();
    let pairs: Vec<(f64, f64)> = points.iter().flat_map(CalibrationPoint::pairs).collect();
    let undetermined = || {
        CliError::Input(format!(
            "{} points are too few, or lie too close together, for a calibration: take at least two levels up and down",
            pairs.len()
        ))
    };
    let found =
        fit::lowest_sufficient(&pairs, highest_order, 0.5 * figures.per_count).ok_or_else(undetermined)?;
    let noise = noise(session).unwrap_or(figures.noise);
    let sensor = SensorFigures {
        per_count: figures.per_count,
        noise,
        noise_of_mean: noise / (WINDOW_SAMPLES as f64).sqrt(),
        reference_percent: certificate.reference_percent,
    };
    let standard = class::standard(session.channel);
    let assessment = assessment::assess(&points, &found, &sensor, standard).ok_or_else(undetermined)?;
    let file = CalibrationFile {
        class: assessment.class_text(),
        expanded_uncertainty: assessment.expanded_uncertainty,
        per_count: figures.per_count,
        capacity: figures.capacity,
        noise,
        polynomial: found.coefficients.clone(),
        points: points.clone(),
        ..certificate.file(session.channel)
    };
    let calibration_hash = write(&file, bench, out)?;
    Ok(Calibrated {
        file: out.to_owned(),
        unit: session.channel.unit(),
        decimals: decimals(session.channel),
        order: found.order(),
        polynomial: found.coefficients,
        residual_sigma: found.sigma,
        as_found_percent: figures.as_found_percent(&points),
        class: file.class,
        assessment,
        bench_line: bench_line(session.channel, out),
        calibration_hash: format!("{calibration_hash:#010x}"),
    })
}

/// Standard deviation of one sample: the median of what was measured at the points, where it was.
fn noise(session: &CalibrationSession) -> Option<f64> {
    let mut scatter: Vec<f64> = session
        .taken
        .iter()
        .map(|t| t.scatter)
        .filter(|s| *s > 0.0)
        .collect();
    scatter.sort_by(f64::total_cmp);
    scatter.get(scatter.len() / 2).copied()
}

/// Writes the file if a bench can use it. Returns the calibration hash of the bench with it.
fn write(file: &CalibrationFile, bench: &Bench, out: &Path) -> Result<u32, CliError> {
    let text = file.to_toml();
    let read = ReadCalibration::parse(&text, &out.display().to_string())?;
    let mut bench = bench.clone();
    match file.channel {
        CalibratedChannel::Force => bench.force_channel = read.force(),
        CalibratedChannel::Displacement => bench.displacement_channel = read.displacement(),
    }
    atomic_file::write(out, |file| file.write_all(text.as_bytes()))
        .map_err(CliError::file(out, "writing"))?;
    Ok(bench.calibration_hash())
}

impl Calibrated {
    /// The report for people.
    pub(super) fn text(&self) -> String {
        let (unit, decimals, a) = (self.unit, self.decimals, &self.assessment);
        let mut text = format!(
            "{:>4} {:>14} {:>14} {:>9} {:>14} {:>14}\n",
            "ser.",
            format!("reference {unit}"),
            format!("error {unit}"),
            "error %",
            format!("down {unit}"),
            "reversib. %"
        );
        for level in &a.levels {
            let down = level
                .down_error
                .map_or(String::new(), |e| format!("{e:+.decimals$}"));
            let reversal = level
                .reversibility_percent
                .map_or(String::new(), |r| format!("{r:+.3}"));
            let _ = writeln!(
                text,
                "{:>4} {:>14.decimals$} {:>+14.decimals$} {:>+9.3} {down:>14} {reversal:>14}",
                level.series, level.reference, level.up_error, level.up_error_percent
            );
        }
        let _ = writeln!(
            text,
            "polynomial of order {}: {:?}; it leaves {:.decimals$} {unit} (standard deviation)",
            self.order, self.polynomial, self.residual_sigma
        );
        let _ = writeln!(
            text,
            "as found, before this calibration: {:+.3} % at the worst point",
            self.as_found_percent
        );
        for criterion in &a.criteria {
            let _ = writeln!(text, "{}", criterion_line(criterion, unit, decimals));
        }
        if a.series < a.series_asked {
            let _ = writeln!(
                text,
                "repeatability   not measured: {} asks for {} series, this is {}",
                a.standard, a.series_asked, a.series
            );
        }
        let _ = write!(
            text,
            "{} from {:.decimals$} to {:.decimals$} {unit}; expanded uncertainty (k = 2) {:.decimals$} {unit}\n\
             {}\nin the bench file write under {}\nits calibration hash is then {}; store it in the rig with \
             `leafbench calibrate --store-hash --bench FILE`",
            self.class,
            a.range[0],
            a.range[1],
            a.expanded_uncertainty,
            self.file.display(),
            self.bench_line,
            self.calibration_hash
        );
        text
    }
}

fn criterion_line(c: &CriterionResult, unit: &str, decimals: usize) -> String {
    let name = format!("{:?}", c.criterion).to_lowercase();
    let class = c
        .class
        .map_or("no class".to_owned(), |class| format!("class {class}"));
    format!(
        "{name:<15} at most {:.3} % ({:.decimals$} {unit}): {class}",
        c.worst_percent, c.worst
    )
}
