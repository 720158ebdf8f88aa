//! Virtual benches with something concealed in the specimen, and their runs.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use crate::cli::virtual_bench::VirtualBench;
use crate::config::{Bench, EffectConfig};
use crate::control::run::RunOrder;
use crate::daemon::header::{self, Planned};
use crate::profile::{Player, Profile};
use crate::recording::export::{self, Selection};
use crate::recording::memory::Memory;
use crate::recording::recorder::FanOut;
use crate::recording::run_file::{RunFile, RunFileWriter};
use crate::recording::{Recorder, Sample};
use crate::twin::Twin;

/// The shipped mock bench.
pub fn mock() -> Bench {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/benches/mock.toml");
    Bench::load(&path).expect("shipped")
}

/// The same with an effect in the specimen of which the bench's model knows nothing.
pub fn concealing(code: &str, parameters: &[(&str, f64)]) -> Bench {
    let mut bench = mock();
    bench.specimen.model.effects.push(EffectConfig {
        code: code.to_owned(),
        parameters: parameters.iter().map(|(n, v)| ((*n).to_owned(), *v)).collect(),
    });
    bench
}

/// The shipped mock bench with another seed of the sensor noise.
pub fn seeded(seed: u64) -> Bench {
    let mut bench = mock();
    let seed = i64::try_from(seed).expect("TOML has signed numbers");
    bench.mock_rig.insert("seed".to_owned(), seed.into());
    bench
}

/// Name and text of every shipped profile, sorted by name.
pub fn shipped_profiles() -> Vec<(String, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/profiles");
    let files = std::fs::read_dir(folder)
        .expect("shipped")
        .map(|entry| entry.expect("readable").path());
    let mut profiles: Vec<(String, String)> = files
        .map(|path| {
            let name = path
                .file_stem()
                .and_then(|name| name.to_str())
                .expect("UTF-8")
                .to_owned();
            (name, std::fs::read_to_string(&path).expect("readable"))
        })
        .collect();
    profiles.sort();
    assert!(!profiles.is_empty());
    profiles
}

/// The order of a run of a profile's text.
pub fn order(bench: &Bench, profile_toml: &str) -> RunOrder {
    let profile = Profile::from_toml(profile_toml, "test").expect("a profile");
    let player = Player::new(&profile, 0.0, 1000.0).expect("plays");
    let planned = Planned {
        cycles: player.total_cycles(),
        duration_s: player.duration_s(),
    };
    let now = "2026-01-01T00:00:00Z".parse().expect("a time");
    let text = profile_toml.to_owned();
    RunOrder {
        header: header::new(profile.name.clone(), now, bench, &profile, text, planned),
        profile,
        first_cycle: 1,
    }
}

/// The bench's model as a twin that watches, in front of `next`.
pub fn twin(bench: &Bench, next: Box<dyn Recorder + Send>) -> Twin {
    let plant = bench.model.plant().expect("a sound model");
    Twin::new(plant, bench.displacement_channel.noise_mm, next, || false).watching(bench.noise())
}

/// Runs a profile's text on the bench in virtual time, its model as the twin; with a folder also into a run file and a CSV there.
pub fn play(bench: &Bench, profile_toml: &str, folder: Option<&Path>) -> (Memory, Option<PathBuf>) {
    let order = order(bench, profile_toml);
    let kept = Arc::new(Mutex::new(Memory::default()));
    let mut into: Vec<Box<dyn Recorder + Send>> = vec![Box::new(kept.clone())];
    let file = folder.map(|f| f.join(format!("{}.leafrun", order.profile.name)));
    if let Some(path) = &file {
        into.push(Box::new(
            RunFileWriter::create(path, &order.header).expect("scratch folder is writable"),
        ));
    }
    let mut chain = twin(bench, Box::new(FanOut(into)));
    VirtualBench::new(bench, None)
        .and_then(|mut b| b.play(order, &mut chain, |_| {}))
        .expect("runs");
    drop(chain);
    let csv = file.map(|path| {
        let run = RunFile::open(&path).expect("closed");
        export::export(&run, Selection::Whole, &path.with_extension("csv"))
            .expect("exports")
            .csv
    });
    let memory = kept.lock().expect("one thread").clone();
    (memory, csv)
}

/// A sine in displacement from 2 mm up, and back to rest.
pub fn sine(name: &str, stroke_mm: f64, frequency_hz: f64, cycles: u32) -> String {
    let (mean, amplitude) = (2.0 + 0.5 * stroke_mm, 0.5 * stroke_mm);
    format!(
        "name = \"{name}\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\nto_mm = {mean:?}\n\
         duration_s = 2.0\n[[block.segment]]\nkind = \"sine\"\nmean_mm = {mean:?}\namplitude_mm = {amplitude:?}\n\
         frequency_hz = {frequency_hz:?}\ncycles = {cycles}\ntaper_cycles = 1\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 0.0\n\
         duration_s = 2.0\n"
    )
}

/// rms(measured - twin) / (max - min of measured force) over the run's own samples.
pub fn twin_nrmse(samples: &[Sample]) -> f64 {
    let pairs: Vec<(f64, f64)> = samples
        .iter()
        .filter(|s| s.segment > 0)
        .filter_map(|s| Some((s.force_n, s.twin_force_n?)))
        .collect();
    let squares: f64 = pairs.iter().map(|(m, t)| (m - t).powi(2)).sum();
    let (low, high) = pairs
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| {
            (l.min(p.0), h.max(p.0))
        });
    (squares / pairs.len() as f64).sqrt() / (high - low)
}
