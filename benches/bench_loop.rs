//! Speed of the whole loop in virtual time: mock rig (`equivalent`), control, twin, recording into a run file.
//! One iteration plays a profile of 10 s. The goal is 500 times real time, that is at most 20 ms per iteration.

use std::path::Path;

use criterion::{BatchSize, Criterion, Throughput};

use crate::cli::virtual_bench::VirtualBench;
use crate::config::Bench;
use crate::control::run::RunOrder;
use crate::daemon::header;
use crate::profile::{Player, Profile};
use crate::recording::run_file::RunFileWriter;
use crate::twin::Twin;

/// Ramp, counted cycles at 2.5 Hz and back: 10 s.
const PROFILE: &str = "name = \"bench-loop\"\ncontrol = \"displacement\"\n[[block]]\n\
    [[block.segment]]\nkind = \"ramp\"\nto_mm = 10.0\nduration_s = 2.0\n\
    [[block.segment]]\nkind = \"sine\"\nmean_mm = 10.0\namplitude_mm = 4.0\nfrequency_hz = 2.5\ncycles = 11\n\
    taper_cycles = 2\ncorrect = true\n\
    [[block.segment]]\nkind = \"ramp\"\nto_mm = 0.0\nduration_s = 2.0\n";

pub fn bench_loop(criterion: &mut Criterion) {
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs");
    let bench = Bench::load(&configs.join("benches/mock.toml")).expect("shipped");
    let profile = Profile::from_toml(PROFILE, "bench_loop").expect("well formed");
    let player = Player::new(&profile, 0.0, 1000.0).expect("plays");
    let folder = tempfile::tempdir().expect("a folder");
    let mut number = 0;
    let mut group = criterion.benchmark_group("bench_loop");
    // One element is a virtual second: criterion prints virtual seconds per second.
    group.throughput(Throughput::Elements(player.duration_s().round() as u64));
    group.sample_size(20);
    group.bench_function("mock rig, control, twin, run file", |bencher| {
        bencher.iter_batched(
            || {
                number += 1;
                let planned = header::Planned {
                    cycles: player.total_cycles(),
                    duration_s: player.duration_s(),
                };
                let (id, now) = (format!("bench-{number}"), jiff::Timestamp::UNIX_EPOCH);
                let header = header::new(id, now, &bench, &profile, PROFILE.to_owned(), planned);
                let path = folder.path().join(format!("{number}.leafrun"));
                let writer = RunFileWriter::create(&path, &header).expect("a run file");
                let plant = bench.model.plant().expect("builds");
                let order = RunOrder {
                    header,
                    profile: profile.clone(),
                    first_cycle: 1,
                };
                let virtual_bench = VirtualBench::new(&bench, None).expect("builds");
                (
                    virtual_bench,
                    order,
                    Twin::new(plant, 0.001, Box::new(writer), || false),
                )
            },
            |(mut virtual_bench, order, mut chain)| {
                virtual_bench
                    .play(order, &mut chain, |_| ())
                    .expect("plays to its end")
            },
            BatchSize::PerIteration,
        );
    });
    group.finish();
}
