//! How fast a run is recorded, exported and read: samples a second into the run file, CSV rows a second both ways.

use crate::recording::csv::{self, CsvFormat, CsvWriter};
use crate::recording::run_file::{RunFile, RunFileWriter};
use crate::recording::{
    ChannelScale, Ending, FirmwareIdentity, Flags, Header, Outcome, Recorder, Sample, SensorIdentity, export,
};
use crate::units::{Command, Mode};
use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, Throughput};

/// The static ramp's length: 120 s at 1 kHz.
const SAMPLES: u64 = 120_000;

fn header() -> Header {
    let scale = |scale_per_count| ChannelScale {
        scale_per_count,
        offset: 0.0,
        tare: 0.123,
        curve: [0.0; 2],
    };
    Header {
        run_id: "bench".into(),
        started_utc: "2026-01-01T00:00:00Z".into(),
        specimen: String::new(),
        operator: String::new(),
        profile_name: "bench".into(),
        profile_toml: String::new(),
        bench_toml: String::new(),
        bench_sha256: String::new(),
        firmware: FirmwareIdentity::default(),
        program_version: String::new(),
        sample_rate_hz: 1000.0,
        force_channel: scale(0.1),
        displacement_channel: scale(0.0005),
        force_sensor: SensorIdentity::default(),
        displacement_sensor: SensorIdentity::default(),
        twin: String::new(),
        first_cycle: 1,
        resumes_run: String::new(),
        continues: String::new(),
        cycles_planned: 0,
        duration_planned_s: 120.0,
        remarks: Vec::new(),
    }
}

fn samples(header: &Header) -> Vec<Sample> {
    let sample = |tick: u64| {
        let phase_rad = std::f64::consts::TAU * tick as f64 / 1000.0;
        let displacement_counts = (12_000.0 * phase_rad.sin()) as i32;
        let force_counts = (3_000.0 * phase_rad.sin()) as i32;
        Sample {
            tick,
            time_s: tick as f64 / 1000.0,
            force_n: header.force_channel.value(force_counts),
            displacement_mm: header.displacement_channel.value(displacement_counts),
            force_counts,
            displacement_counts,
            command: Some(Command::Displacement(6.0 * phase_rad.sin())),
            cycle: (tick / 1000) as u32,
            segment: 1,
            twin_force_n: Some(300.0 * phase_rad.sin()),
            flags: Flags::default(),
        }
    };
    (0..SAMPLES).map(sample).collect()
}

/// What one benchmark reads is there before, because a filter may have left out the one that writes it.
pub fn recording(criterion: &mut Criterion) {
    let header = header();
    let samples = samples(&header);
    let mut group = criterion.benchmark_group("recording");
    group.sample_size(10).throughput(Throughput::Elements(SAMPLES));
    csv_rows(&mut group, &header, &samples);
    run_file(&mut group, &header, &samples);
    group.finish();
}

fn csv_rows(group: &mut BenchmarkGroup<'_, WallTime>, header: &Header, samples: &[Sample]) {
    let format = CsvFormat::new(header, &[Mode::Displacement]);
    let mut csv = Vec::new();
    let mut write = || {
        csv.clear();
        let mut writer = CsvWriter::new(&mut csv, format.clone()).expect("memory takes all");
        for sample in samples {
            writer.sample(sample).expect("memory takes all");
        }
    };
    write();
    group.bench_function("csv rows written", |bencher| bencher.iter(&mut write));
    group.bench_function("csv rows read", |bencher| {
        bencher.iter(|| {
            csv::read("bench.csv", csv.as_slice())
                .expect("own CSV is valid")
                .len()
        });
    });
}

fn run_file(group: &mut BenchmarkGroup<'_, WallTime>, header: &Header, samples: &[Sample]) {
    let outcome = Outcome {
        ending: Ending::Completed,
        cause: String::new(),
        samples: SAMPLES,
        lost: 0,
        late: 0,
        cycles_completed: 0,
        unsaved: None,
        punctuality: None,
    };
    let folder = tempfile::tempdir().expect("the temporary folder can be made");
    let path = folder.path().join("bench.leafrun");
    let record = || {
        let mut writer = RunFileWriter::create(&path, header).expect("the folder is writable");
        samples.iter().for_each(|sample| writer.sample(sample));
        writer.end(&outcome);
        assert!(writer.status().problem().is_none());
    };
    record();
    group.bench_function("samples into the run file, synced", |bencher| {
        bencher.iter(|| {
            let _ = std::fs::remove_file(&path);
            record();
        });
    });
    let run = RunFile::open(&path).expect("just written");
    group.bench_function("samples out of the run file", |bencher| {
        bencher.iter(|| run.samples().count())
    });
    group.bench_function("run file to csv and package, synced", |bencher| {
        let csv = folder.path().join("bench.csv");
        bencher
            .iter(|| export::export(&run, export::Selection::Whole, &csv).expect("the folder is writable"));
    });
}
