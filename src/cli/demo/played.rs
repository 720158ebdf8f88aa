//! A run of a shipped profile on the bench's mock rig in virtual time, with the bench's model as its twin.

use std::path::Path;

use crate::cli::CliError;
use crate::cli::virtual_bench::record_run;
use crate::config::Bench;
use crate::daemon::library;
use crate::profile::Profile;
use crate::recording::Sample;
use crate::recording::metrics::NrmseMeter;
use crate::recording::run_file::RunFile;

/// Points of a curve in the page: finer than a screen shows.
const CURVE_POINTS: usize = 8000;
/// Counted cycle by which amplitude and mean have settled.
pub(super) const SETTLED_CYCLE: u32 = 5;

/// A run that was played.
pub(super) struct Played {
    pub profile: Profile,
    /// The closed run file.
    pub file: RunFile,
    /// The samples of the profile. Segment 0, such as the unloading after it, is recorded but no part of the test.
    pub samples: Vec<Sample>,
    /// Error of the twin over these samples, see [`NrmseMeter`]; `None` without a twin.
    pub twin_nrmse: Option<f64>,
    /// Bench time from the hello to the unloaded rig.
    pub virtual_s: f64,
}

impl Played {
    /// Plays a profile of the folder `configs` into a run file in `folder`. `silent` shows no progress.
    pub(super) fn shipped(
        name: &str,
        bench: &Bench,
        configs: &Path,
        folder: &Path,
        silent: bool,
    ) -> Result<Played, CliError> {
        std::fs::create_dir_all(folder).map_err(CliError::file(folder, "creating the folder"))?;
        let (profile, text) = library::read(&configs.join("profiles").join(format!("{name}.toml")))?;
        let run = record_run(bench, &profile, text, folder, silent)?;
        let samples: Vec<Sample> = run.file.samples().filter(|s| s.segment > 0).collect();
        let mut twin = NrmseMeter::default();
        for (sample, twin_n) in samples.iter().filter_map(|s| Some((s, s.twin_force_n?))) {
            twin.add(sample.force_n, twin_n);
        }
        Ok(Played {
            profile,
            file: run.file,
            samples,
            twin_nrmse: twin.value(),
            virtual_s: run.virtual_s,
        })
    }

    /// Displacement in mm and a force in N, thinned to what a plot can show.
    pub(super) fn curve(&self, force_n: fn(&Sample) -> Option<f64>) -> Vec<(f64, f64)> {
        curve(&self.samples, force_n)
    }

    /// The counted cycle in which amplitude and mean have settled; all samples if the profile has no such cycle.
    pub(super) fn settled_cycle(&self) -> &[Sample] {
        let in_cycle = |s: &Sample| s.cycle == SETTLED_CYCLE;
        let from = self.samples.iter().position(in_cycle);
        let to = self.samples.iter().rposition(in_cycle);
        from.zip(to)
            .map_or(&self.samples, |(from, to)| &self.samples[from..=to])
    }
}

/// Displacement in mm and a force in N, thinned to what a plot can show.
pub(super) fn curve(samples: &[Sample], force_n: fn(&Sample) -> Option<f64>) -> Vec<(f64, f64)> {
    let step = samples.len().div_ceil(CURVE_POINTS).max(1);
    samples
        .iter()
        .step_by(step)
        .filter_map(|s| Some((s.displacement_mm, force_n(s)?)))
        .collect()
}

/// A share in percent; a dash where there is none.
pub(super) fn percent(share: Option<f64>) -> String {
    share.map_or("\u{2013}".to_owned(), |v| format!("{:.2} %", 100.0 * v))
}
