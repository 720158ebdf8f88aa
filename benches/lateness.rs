//! How late the turns of the control loop begin, in real time: the thread of the daemon with the mock rig in memory. Prints the
//! classes of delay. `LEAFBENCH_LATENESS_SECONDS` sets how long it is watched (10 s).

use std::path::Path;
use std::time::Duration;

use criterion::Criterion;

use crate::cli::virtual_bench::VirtualBench;
use crate::config::Bench;
use crate::control::realtime::{ControlHandle, NoRecorder};
use crate::link::loopback;
use crate::recording::punctuality::LatenessClass;

/// Seconds without a setting.
const SECONDS: u64 = 10;

pub fn lateness(_: &mut Criterion) {
    let seconds =
        std::env::var("LEAFBENCH_LATENESS_SECONDS").map_or(SECONDS, |s| s.parse().expect("whole seconds"));
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs");
    let bench = Bench::load(&configs.join("benches/mock.toml")).expect("shipped");
    let VirtualBench { rig, mut mock, .. } = VirtualBench::new(&bench, None).expect("builds");
    let link = loopback::stepped(move |far| mock.tick(far));
    let (control, _thread) = ControlHandle::spawn(rig, link, Box::new(NoRecorder)).expect("a thread");
    std::thread::sleep(Duration::from_secs(seconds));
    let (_, health) = control.status();
    println!("\ncontrol loop, {} turns of 1 ms", health.turns);
    for class in Vec::<LatenessClass>::from(health.lateness) {
        let share = 100.0 * class.turns as f64 / health.turns.max(1) as f64;
        match class.up_to_us {
            Some(us) => println!(
                "  up to {:>6.2} ms {:>9} turns {share:>8.3} %",
                us as f64 / 1e3,
                class.turns
            ),
            None => println!("  longer          {:>9} turns {share:>8.3} %", class.turns),
        }
    }
    println!("  longest {:.3} ms", health.worst_lateness_us as f64 / 1e3);
    for sentence in control.degraded() {
        println!("  {sentence}");
    }
}
