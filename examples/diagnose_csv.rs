//! Says which physics a model lacks, from the CSV files that are given as arguments. Without arguments it records two tests on
//! the mock rig, whose specimen has a helper leaf that the model lacks.
//!
//!     cargo run --release --example diagnose_csv
//!     cargo run --release --example diagnose_csv -- loops/a.csv loops/b.csv

use std::error::Error;
use std::path::Path;

use leafbench::{
    Baseline, Bench, DiagnoseOptions, Profile, Recording, diagnose, find_model, read_csv, record,
};

fn main() -> Result<(), Box<dyn Error>> {
    let files: Vec<String> = std::env::args().skip(1).collect();
    let read = || files.iter().map(|f| read_csv(Path::new(f)));
    let recordings = match files.is_empty() {
        true => concealed()?,
        false => read().collect::<Result<_, _>>()?,
    };
    let baseline = Baseline::of(find_model("equivalent")?);
    let options = DiagnoseOptions::default();
    let diagnosis = diagnose(&recordings, &baseline, &options, &mut |_, _| {})?;
    println!("{}", diagnosis.summary);
    for finding in &diagnosis.effects {
        println!(
            "{}: {} ({:.0} % sure)",
            finding.code,
            finding.statement,
            100.0 * finding.confidence
        );
    }
    Ok(())
}

/// A slow and a quick sine on a mock rig whose specimen has a helper leaf that touches at 8 mm.
fn concealed() -> Result<Vec<Recording>, Box<dyn Error>> {
    let helper = [("extra_rate_n_per_mm", 15.0), ("knee_mm", 8.0), ("width_mm", 0.5)];
    let bench = Bench::shipped()?.with_concealed_effect("progressive_stiffness", &helper);
    let sine = |name: &str, mean_mm: f64, frequency_hz: f64, cycles: u32| {
        let text = format!(
            "name = \"{name}\"\ncontrol = \"displacement\"\n[[block]]\nsegment = [\n\
             {{ kind = \"ramp\", to_mm = {mean_mm:?}, duration_s = 2.0 }},\n\
             {{ kind = \"sine\", mean_mm = {mean_mm:?}, amplitude_mm = 6.0, frequency_hz = {frequency_hz:?}, cycles = {cycles}, taper_cycles = 1 }},\n\
             {{ kind = \"ramp\", to_mm = 0.0, duration_s = 2.0 }},\n]\n"
        );
        Profile::from_toml(&text, name)
    };
    let profiles = [sine("slow", 8.0, 0.25, 5)?, sine("quick", 7.0, 2.0, 12)?];
    let recordings = profiles.iter().map(|p| record(&bench, p));
    Ok(recordings.collect::<Result<_, _>>()?)
}
