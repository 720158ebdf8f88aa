//! A run file as a recording in memory: the same numbers, to the last bit, as those of its exported CSV.

use super::csv::CsvFormat;
use super::run_file::RunFile;
use super::{Recording, Sample};

/// Reads a whole run. `name` is for messages.
pub(crate) fn read(name: &str, run: &RunFile) -> Recording {
    let modes = run.survey().modes;
    let format = CsvFormat::new(run.header(), &modes);
    // The CSV has the commands of both modes; a reader takes those of the first one.
    let mode = modes.first().copied();
    let decimals = |sample: &Sample| match sample.command.filter(|command| Some(command.mode()) == mode) {
        Some(command) => rounded(command.value(), format.mode_decimals(command.mode())),
        None => f64::NAN,
    };
    let mut recording = Recording {
        name: name.to_owned(),
        command: mode.map(|_| Vec::new()),
        command_mode: mode,
        cycle: Some(Vec::new()),
        flags: Some(Vec::new()),
        ..Recording::default()
    };
    for sample in run.samples() {
        recording
            .time_s
            .push(rounded(sample.time_s, format.time_decimals));
        recording
            .displacement_mm
            .push(rounded(sample.displacement_mm, format.displacement_decimals));
        recording
            .force_n
            .push(rounded(sample.force_n, format.force_decimals));
        if let Some(command) = &mut recording.command {
            command.push(decimals(&sample));
        }
        if let Some(cycle) = &mut recording.cycle {
            cycle.push(sample.cycle);
        }
        if let Some(flags) = &mut recording.flags {
            flags.push(sample.flags.bits());
        }
    }
    recording
}

/// The number that a reader gets from the text with so many decimals: a quotient of whole numbers is rounded once, as text is.
fn rounded(value: f64, decimals: u32) -> f64 {
    let unit = 10u64.pow(decimals) as f64;
    let scaled = (value.abs() * unit).round();
    // Beyond 2^53 a double has no such decimals, and below half a unit there is no negative zero.
    match scaled {
        s if s.is_nan() || s >= 9e15 => value,
        0.0 => 0.0,
        s => (s / unit).copysign(value),
    }
}

#[cfg(test)]
mod tests {
    use super::super::export::{self, Selection};
    use super::super::run_file::test_support::{header, outcome, sample};
    use super::super::run_file::{RunFile, RunFileWriter};
    use super::super::{Recorder, csv};
    use super::*;

    #[test]
    fn a_run_file_and_its_csv_are_the_same_recording() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.leafrun");
        let mut writer = RunFileWriter::create(&path, &header()).unwrap();
        for tick in (0..3000).filter(|tick| !(700..705).contains(tick)) {
            let mut sample = sample(tick);
            // Before the profile there is no command.
            sample.command = sample.command.filter(|_| tick > 20);
            writer.sample(&sample);
        }
        writer.end(&outcome(3000));
        let run = RunFile::open(&path).unwrap();
        let exported = export::export(&run, Selection::Whole, &folder.path().join("run.csv")).unwrap();
        let mut of_csv = csv::read_file(&exported.csv).unwrap();
        of_csv.name = "run".to_owned();
        let of_run = read("run", &run);
        let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(
            bits(of_run.command.as_deref().unwrap()),
            bits(of_csv.command.as_deref().unwrap())
        );
        // NaN is not equal to itself, so the commands are compared above.
        let without = |recording: Recording| Recording {
            command: None,
            ..recording
        };
        assert_eq!(of_run.len(), 2995);
        assert_eq!(without(of_run), without(of_csv));
    }
}
