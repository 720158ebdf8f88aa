//! Faults D1, K4 and K5: after a kill, a cut-off file or flipped bytes, only the damaged blocks are lost.

use std::fs;
use std::path::Path;

use super::test_support::{header, outcome, sample};
use super::{Gap, GapCause, RunFile, RunFileError, RunFileWriter};
use crate::recording::{Ending, Flags, Recorder, Sample};

/// A closed run of `blocks` blocks of 10 samples.
fn small_blocks(path: &Path, blocks: u64) {
    let mut writer = RunFileWriter::create(path, &header()).unwrap();
    for tick in 0..blocks * 10 {
        writer.sample(&sample(tick));
        if tick % 10 == 9 {
            writer.flush();
        }
    }
    writer.end(&outcome(blocks * 10));
}

/// Every sample read is one that was written, except for the flag after a gap, which the reader sets.
fn assert_identical(read: &[Sample], what: &str) {
    for s in read {
        let plain = Sample {
            flags: s.flags.difference(Flags::AFTER_GAP),
            ..*s
        };
        assert_eq!(plain, sample(s.tick), "{what}");
    }
}

/// A copy of file and log at any time is what a kill leaves: it has everything that was committed.
#[test]
fn a_killed_writer_leaves_everything_it_committed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("live.leafrun");
    let mut writer = RunFileWriter::create(&path, &header()).unwrap();
    for tick in 0..600u64 {
        writer.sample(&sample(tick));
        if tick % 10 == 9 {
            writer.flush();
        }
        if tick % 37 != 0 {
            continue;
        }
        let killed = folder.path().join("killed.leafrun");
        fs::copy(&path, &killed).unwrap();
        fs::copy(super::sync::log_path(&path), super::sync::log_path(&killed)).unwrap();
        let run = RunFile::open(&killed).unwrap();
        let read: Vec<Sample> = run.samples().collect();
        assert_identical(&read, "killed");
        assert!(
            read.len() as u64 + 10 > tick,
            "{} samples at tick {tick}",
            read.len()
        );
        let left = read.len() as u64;
        let closed = run.close_as_aborted("daemon was killed").unwrap();
        assert_eq!(
            (closed.ending, closed.samples, closed.lost),
            (Ending::Aborted, left, 0)
        );
        assert!(!super::sync::log_path(&killed).exists());
        let again = RunFile::open(&killed).unwrap();
        assert_eq!(again.outcome(), Some(&closed));
        assert!(matches!(
            again.close_as_aborted("x"),
            Err(RunFileError::Closed { .. })
        ));
    }
}

#[test]
fn a_log_cut_at_any_byte_of_its_end_keeps_the_earlier_commits() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("live.leafrun");
    let mut writer = RunFileWriter::create(&path, &header()).unwrap();
    for tick in 0..200u64 {
        writer.sample(&sample(tick));
        if tick % 10 == 9 {
            writer.flush();
        }
    }
    let file = fs::read(&path).unwrap();
    let log = fs::read(super::sync::log_path(&path)).unwrap();
    let cut = folder.path().join("cut.leafrun");
    for missing in 0..4096 {
        fs::write(&cut, &file).unwrap();
        fs::write(super::sync::log_path(&cut), &log[..log.len() - missing]).unwrap();
        let read: Vec<Sample> = RunFile::open(&cut).unwrap().samples().collect();
        // A commit is one to four pages of 4 KiB: a cut of less than a page tears one commit.
        assert!(
            read.len() >= if missing == 0 { 200 } else { 190 },
            "{} at -{missing}",
            read.len()
        );
        assert_identical(&read, "cut log");
    }
}

#[test]
fn a_closed_file_cut_at_any_byte_of_its_end_keeps_the_earlier_blocks() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("whole.leafrun");
    small_blocks(&path, 100);
    let file = fs::OpenOptions::new().write(true).open(&path).unwrap();
    let whole = file.metadata().unwrap().len();
    for missing in 1..=4096 {
        file.set_len(whole - missing).unwrap();
        let run = RunFile::open(&path).unwrap();
        let mut reader = run.samples();
        let read: Vec<Sample> = reader.by_ref().collect();
        // The last page of 4 KiB holds at most nine blocks of 10 samples.
        assert!(read.len() >= 900, "{} at -{missing}", read.len());
        assert_identical(&read, "cut file");
        let damaged: u64 = reader.gaps.iter().map(Gap::ticks).sum();
        assert_eq!(
            read.len() as u64 + damaged,
            1000,
            "every tick is read or noted as a gap"
        );
    }
}

#[test]
fn every_flipped_byte_of_a_block_is_found_and_costs_that_block() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("whole.leafrun");
    small_blocks(&path, 60);
    let mut file = fs::read(&path).unwrap();
    let mut packed = Vec::new();
    for tick in 300..310 {
        super::block::pack(&sample(tick), 300, &mut packed);
    }
    let at = file
        .windows(packed.len())
        .position(|window| window == packed)
        .unwrap();
    let flipped = folder.path().join("flipped.leafrun");
    for byte in at..at + packed.len() {
        file[byte] ^= 0x40;
        fs::write(&flipped, &file).unwrap();
        file[byte] ^= 0x40;
        let run = RunFile::open(&flipped).unwrap();
        let survey = run.survey();
        assert_eq!((survey.samples, survey.damaged, survey.lost), (590, 10, 0));
        let [gap] = survey.gaps.as_slice() else {
            panic!("one gap: {:?}", survey.gaps)
        };
        assert_eq!(
            (gap.from_tick, gap.to_tick, gap.cause),
            (300, 309, GapCause::Damaged)
        );
        let read: Vec<Sample> = run.samples().collect();
        assert_identical(&read, "flipped");
        assert!(
            read.iter()
                .find(|s| s.tick == 310)
                .unwrap()
                .flags
                .contains(Flags::AFTER_GAP)
        );
    }
}

/// SQLite's own pages have no checksum. A flipped byte in them must not give a false sample or a panic.
#[test]
fn no_flipped_byte_anywhere_gives_a_false_sample() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("whole.leafrun");
    small_blocks(&path, 30);
    let mut file = fs::read(&path).unwrap();
    let flipped = folder.path().join("flipped.leafrun");
    let mut opened = [0_u32; 2];
    // A prime step reaches every kind of place in a page without 40,000 files.
    for byte in (0..file.len()).step_by(13) {
        file[byte] ^= 0x21;
        fs::write(&flipped, &file).unwrap();
        file[byte] ^= 0x21;
        let run = RunFile::open(&flipped);
        opened[usize::from(run.is_ok())] += 1;
        if let Ok(run) = run {
            let read: Vec<Sample> = run.samples().collect();
            assert!(read.windows(2).all(|w| w[0].tick < w[1].tick), "byte {byte}");
            for s in &read {
                let counts = sample(s.tick).force_counts;
                assert_eq!(s.force_counts, counts, "byte {byte}, tick {}", s.tick);
            }
            // Must not panic; damaged events are left out.
            run.events();
        }
    }
    assert!(opened.iter().all(|&n| n > 20), "refused and opened: {opened:?}");
}
