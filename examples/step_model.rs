//! Steps a model by hand through one cycle and prints its loop as CSV.
//!
//!     cargo run --example step_model > loop.csv

use leafbench::{BuildError, find_model};

fn main() -> Result<(), BuildError> {
    let model = find_model("equivalent")?;
    for parameter in model.parameters {
        eprintln!(
            "{:15} {:8} {} ({})",
            parameter.name, parameter.start, parameter.unit, parameter.what
        );
    }
    let structure = Default::default();
    let mut plant = model.plant(&model.start_values(), &structure)?;
    println!("time_s,displacement_mm,force_n");
    for i in 0..=400 {
        let time_s = f64::from(i) * 0.01;
        let displacement_mm = 6.0 - 6.0 * (std::f64::consts::TAU * 0.5 * time_s).cos();
        println!(
            "{time_s:.2},{displacement_mm:.4},{:.3}",
            plant.step(displacement_mm, 0.01)
        );
    }
    Ok(())
}
