//! Fuzzing of run files. A file is longer than what other parsers get, so the input says where and how a sound file is changed.

use std::path::{Path, PathBuf};

use super::engine::{Parser, fuzz, kind};
use crate::recording::run_file::test_support::{header, outcome, sample};
use crate::recording::run_file::{RunFile, RunFileWriter};
use crate::recording::{Event, EventKind, Flags, Recorder, Sample};

/// Samples of the sound file.
const SAMPLES: u64 = 60;
/// Page of SQLite, bytes.
const PAGE: usize = 4096;

fn event(tick: u64) -> Event {
    Event {
        tick,
        time_s: tick as f64 / 1000.0,
        kind: EventKind::Operator,
        text: format!("event at tick {tick}"),
    }
}

fn sound_file(path: &Path) -> Vec<u8> {
    let mut writer = RunFileWriter::create(path, &header()).expect("made");
    writer.begin(&header());
    for tick in 0..SAMPLES {
        writer.sample(&sample(tick));
        if tick % 20 == 19 {
            writer.event(&event(tick));
            writer.flush();
        }
    }
    writer.end(&outcome(SAMPLES));
    std::fs::read(path).expect("read")
}

/// Changes the file: four bytes of the input are one change.
fn change(file: &mut Vec<u8>, input: &[u8]) {
    for change in input.chunks_exact(4).take(64) {
        let at = usize::from(u16::from_le_bytes([change[0], change[1]])) * 7 % file.len();
        match change[2] % 8 {
            0 => file.truncate(at.max(1)),
            1 => file[at] = change[3],
            2 => file[at / PAGE * PAGE..=at].fill(change[3]),
            _ => file[at] ^= 1 << (change[3] % 8),
        }
    }
}

/// Reads what is there: every value is one that was written, and what is missing is told. Returns the kind of outcome.
fn read(path: &Path) -> u64 {
    let run = match RunFile::open(path) {
        Ok(run) => run,
        Err(error) => return kind(&error),
    };
    assert_eq!(run.header(), &header());
    let survey = run.survey();
    // Without the count of the content and the first block nobody knows where time began; both are told.
    let time_is_known = !survey.damage.iter().any(|sentence| sentence.contains("count"));
    for read in run.samples() {
        let plain = Sample {
            flags: read.flags.difference(Flags::AFTER_GAP),
            time_s: if time_is_known {
                read.time_s
            } else {
                read.tick as f64 / 1000.0
            },
            ..read
        };
        assert_eq!(plain, sample(read.tick), "a false sample");
    }
    let events = run.events();
    events.iter().for_each(|read| assert_eq!(*read, event(read.tick)));
    let told = !survey.damage.is_empty();
    assert!(
        told || (survey.samples, events.len()) == (SAMPLES, 3),
        "{survey:?} and no word of damage"
    );
    survey.samples << 8 | (events.len() as u64) << 1 | u64::from(told)
}

#[test]
fn k5_fuzz_run_file() {
    let memory = Path::new("/dev/shm");
    let parent: PathBuf = if memory.is_dir() {
        memory.into()
    } else {
        std::env::temp_dir()
    };
    let folder = tempfile::tempdir_in(parent).expect("a folder");
    let sound = sound_file(&folder.path().join("sound.leafrun"));
    let changed = folder.path().join("changed.leafrun");
    fuzz(Parser {
        name: "run-file",
        seeds: (0..8_u8)
            .map(|n| vec![n, n.wrapping_mul(31), 1, 0xFF, 7, 9, 0x80, 0])
            .collect(),
        words: &[],
        parse: &mut |input| {
            let mut file = sound.clone();
            change(&mut file, input);
            std::fs::write(&changed, &file).expect("room for a small file");
            let kind = read(&changed);
            crate::recording::run_file::remove(&changed);
            kind
        },
    });
}
