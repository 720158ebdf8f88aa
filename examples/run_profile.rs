//! Runs a shipped profile on the mock rig in virtual time and prints what was measured.
//!
//!     cargo run --example run_profile

use std::error::Error;
use std::path::Path;

use leafbench::{Bench, Profile, record};

fn main() -> Result<(), Box<dyn Error>> {
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs");
    let bench = Bench::load(&configs.join("benches/mock.toml"))?;
    let text = std::fs::read_to_string(configs.join("profiles/sine-6mm-2.5hz-10.toml"))?;
    let profile = Profile::from_toml(&text, "sine-6mm-2.5hz-10")?;

    let recording = record(&bench, &profile)?;

    let extreme = |values: &[f64], pick: fn(f64, f64) -> f64| values.iter().copied().reduce(pick);
    println!("profile       {}", profile.name);
    println!("samples       {}", recording.len());
    println!(
        "peak          {:.1} N",
        extreme(&recording.force_n, f64::max).unwrap_or(f64::NAN)
    );
    println!(
        "largest travel {:.3} mm",
        extreme(&recording.displacement_mm, f64::max).unwrap_or(f64::NAN)
    );

    // Work over the whole motion. The spring ends where it began, so this work is the friction loss.
    let energy_nmm: f64 = (1..recording.len())
        .map(|i| {
            let travel_mm = recording.displacement_mm[i] - recording.displacement_mm[i - 1];
            0.5 * (recording.force_n[i] + recording.force_n[i - 1]) * travel_mm
        })
        .sum();
    println!("friction work {:.2} J", 1e-3 * energy_nmm);
    Ok(())
}
