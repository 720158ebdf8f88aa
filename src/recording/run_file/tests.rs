//! A run file without faults: what was written comes back.

use super::test_support::{header, outcome, sample};
use super::{RunFile, RunFileError, RunFileWriter, check_space};
use crate::recording::{Event, EventKind, Recorder, Sample};

fn event(tick: u64) -> Event {
    Event {
        tick,
        time_s: tick as f64 / 1000.0,
        kind: EventKind::Start,
        text: "started".into(),
    }
}

#[test]
fn a_run_comes_back_bit_for_bit_from_one_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.leafrun");
    let mut writer = RunFileWriter::create(&path, &header()).unwrap();
    writer.begin(&header());
    writer.event(&event(0));
    let samples: Vec<Sample> = (0..5000).filter(|tick| tick % 1700 != 7).map(sample).collect();
    for s in &samples {
        writer.sample(s);
    }
    writer.end(&outcome(1));
    assert_eq!(
        std::fs::read_dir(folder.path()).unwrap().count(),
        1,
        "no log beside the file"
    );

    let run = RunFile::open(&path).unwrap();
    assert_eq!(run.header(), &header());
    assert_eq!(run.events(), vec![event(0)]);
    let ended = run.outcome().unwrap();
    assert_eq!(
        (ended.samples, ended.lost),
        (4997, 3),
        "ticks 7, 1707 and 3407 are missing"
    );
    let back: Vec<Sample> = run
        .samples()
        .map(|s| Sample {
            flags: samples[0].flags,
            ..s
        })
        .collect();
    assert_eq!(back, samples);
}

#[test]
fn late_and_repeated_samples_are_not_stored() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.leafrun");
    let mut writer = RunFileWriter::create(&path, &header()).unwrap();
    for tick in [5, 6, 6, 4, 7] {
        writer.sample(&sample(tick));
    }
    writer.end(&outcome(0));
    let run = RunFile::open(&path).unwrap();
    assert_eq!(run.samples().map(|s| s.tick).collect::<Vec<_>>(), [5, 6, 7]);
}

#[test]
fn a_run_file_is_never_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.leafrun");
    std::fs::write(&path, "mine").unwrap();
    assert!(matches!(
        RunFileWriter::create(&path, &header()),
        Err(RunFileError::Exists { .. })
    ));
    assert_eq!(std::fs::read(&path).unwrap(), b"mine");
}

#[test]
fn a_run_that_would_fill_the_disk_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    // A million hours at 1 kHz are 460 TB: more than the disk of any test machine.
    let refused = check_space(folder.path(), 3.6e9, 1000.0);
    assert!(matches!(refused, Err(RunFileError::NoSpace { .. })));
}
