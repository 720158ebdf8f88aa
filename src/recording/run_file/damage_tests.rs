//! Faults D1, K4 and K5: after a kill, a cut-off file or flipped bytes, only the damaged blocks are lost.

use std::fs;
use std::path::{Path, PathBuf};

use super::test_support::{header, outcome, sample};
use super::{Gap, GapCause, RunFile, RunFileError, RunFileWriter};
use crate::recording::{Ending, Event, EventKind, Flags, Header, Outcome, Recorder, Sample};

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

/// An event of each 20th tick.
fn event(tick: u64) -> Event {
    Event {
        tick,
        time_s: tick as f64 / 1000.0,
        kind: EventKind::Operator,
        text: format!("event at tick {tick}"),
    }
}

/// The events read are the first ones that were written, unchanged; as many as belong to `samples` samples, or one fewer.
fn assert_first_events(read: &[Event], samples: usize, what: &str) {
    let written: Vec<Event> = (0..samples as u64).step_by(20).map(event).collect();
    assert!(
        read.len() + 1 >= written.len(),
        "{what}: {} of {}",
        read.len(),
        written.len()
    );
    assert!(
        written.starts_with(read) || read.starts_with(&written),
        "{what}: {read:?}"
    );
    read.iter().for_each(|e| assert_eq!(*e, event(e.tick), "{what}"));
}

/// A copy of file and log at any time is what a kill leaves: it has everything that was committed.
#[test]
fn d1_a_killed_writer_leaves_everything_it_committed() {
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
fn k4_a_log_cut_at_any_byte_of_its_end_keeps_the_earlier_commits() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("live.leafrun");
    let mut writer = RunFileWriter::create(&path, &header()).unwrap();
    for tick in 0..200u64 {
        if tick % 20 == 0 {
            writer.event(&event(tick));
        }
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
        let run = RunFile::open(&cut).unwrap();
        let read: Vec<Sample> = run.samples().collect();
        assert_first_events(&run.events(), read.len(), "cut log");
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
fn k4_a_closed_file_cut_at_any_byte_of_its_end_keeps_the_earlier_blocks() {
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
fn k5_every_flipped_byte_of_a_block_is_found_and_costs_that_block() {
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

/// What a user of a run file gets from it.
#[derive(Debug, PartialEq)]
struct Content {
    header: Header,
    outcome: Option<Outcome>,
    events: Vec<Event>,
    samples: Vec<Sample>,
}

/// The content, and whether the file tells that it is damaged; `None` if it is refused.
fn content(path: &Path) -> Option<(Content, bool)> {
    let run = RunFile::open(path).ok()?;
    let content = Content {
        header: run.header().clone(),
        outcome: run.outcome().cloned(),
        events: run.events(),
        samples: run.samples().collect(),
    };
    Some((content, tells_damage(&run)))
}

fn tells_damage(run: &RunFile) -> bool {
    !run.survey().damage.is_empty()
}

/// A small closed run with events, whose first sample is not at tick 0.
fn small_run(path: &Path) {
    let mut writer = RunFileWriter::create(path, &header()).unwrap();
    writer.begin(&header());
    for tick in 7000..7030_u64 {
        if tick % 10 == 0 {
            writer.event(&Event {
                tick,
                time_s: (tick - 7000) as f64 / 1000.0,
                kind: EventKind::RigState,
                text: "rig Running".into(),
            });
        }
        writer.sample(&sample(tick));
        if tick % 10 == 9 {
            writer.flush();
        }
    }
    writer.end(&outcome(30));
}

/// Every flipped byte of the file, one after the other. A page of SQLite is mostly unused zeros: one in 16 of them is enough.
#[test]
fn k5_every_flipped_byte_gives_the_same_content_or_a_told_damage() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("whole.leafrun");
    small_run(&path);
    let (whole, damaged) = content(&path).unwrap();
    assert!(!damaged && whole.samples.len() == 30 && whole.events.len() == 3);
    let mut file = fs::read(&path).unwrap();
    let flipped = folder.path().join("flipped.leafrun");
    let mut silent = Vec::new();
    for byte in 0..file.len() {
        if file[byte] == 0 && byte % 16 != 0 {
            continue;
        }
        let mask = if byte % 2 == 0 { 0x01 } else { 0x80 };
        {
            file[byte] ^= mask;
            fs::write(&flipped, &file).unwrap();
            file[byte] ^= mask;
            let Some((read, told)) = content(&flipped) else {
                continue;
            };
            if !told && read != whole {
                silent.push((byte, mask));
            }
            // What is read beside told damage is what was written, or it is left out.
            let place = format!("byte {byte}");
            assert_eq!(read.header, whole.header, "{place}");
            assert!(read.outcome.is_none() || read.outcome == whole.outcome, "{place}");
            assert!(
                read.events.iter().all(|e| whole.events.contains(e)),
                "{place}: {:?}",
                read.events
            );
            for s in &read.samples {
                let plain = Sample {
                    flags: s.flags.difference(Flags::AFTER_GAP),
                    ..*s
                };
                assert!(whole.samples.contains(&plain), "{place}: {s:?}");
            }
        }
    }
    assert!(silent.is_empty(), "{} silent changes: {silent:?}", silent.len());
}

/// Every row of every table, dropped or with one value changed.
#[test]
fn k5_every_dropped_row_and_every_changed_value_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("whole.leafrun");
    small_run(&path);
    let (whole, _) = content(&path).unwrap();
    let changed = folder.path().join("changed.leafrun");
    let mut silent = Vec::new();
    for sql in changes(&path) {
        fs::copy(&path, &changed).unwrap();
        let database = rusqlite::Connection::open(&changed).unwrap();
        database.execute(&sql, []).unwrap();
        drop(database);
        if content(&changed).is_some_and(|(read, told)| !told && read != whole) {
            silent.push(sql);
        }
    }
    assert!(silent.is_empty(), "{} silent changes: {silent:#?}", silent.len());
}

/// One statement for each row to drop and for each value to change.
fn changes(path: &Path) -> Vec<String> {
    let database = rusqlite::Connection::open(path).unwrap();
    let list = |sql: &str| -> Vec<String> {
        let mut statement = database.prepare(sql).unwrap();
        let rows = statement.query_map([], |row| row.get(0)).unwrap();
        rows.map(Result::unwrap).collect()
    };
    let mut changes = Vec::new();
    for table in list("SELECT name FROM sqlite_master WHERE type = 'table'") {
        changes.push(format!("DELETE FROM {table}"));
        for row in list(&format!("SELECT CAST(rowid AS TEXT) FROM {table}")) {
            changes.push(format!("DELETE FROM {table} WHERE rowid = {row}"));
            for column in list(&format!("SELECT name FROM pragma_table_info('{table}')")) {
                for value in [
                    format!("{column} + 1"),
                    format!("replace({column}, 'Running', 'Tripped')"),
                    format!("replace({column}, 'rig_state', 'limit')"),
                    format!("replace({column}, 'completed', 'stopped')"),
                ] {
                    changes.push(format!(
                        "UPDATE OR IGNORE {table} SET {column} = {value} WHERE rowid = {row}"
                    ));
                }
            }
        }
    }
    changes
}

/// A file that version 0.1.0 of leafbench wrote: the content of `small_run`.
fn version_1(folder: &Path) -> PathBuf {
    let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recordings/version-1.leafrun");
    let copy = folder.join("version-1.leafrun");
    fs::copy(kept, &copy).unwrap();
    copy
}

#[test]
fn a_file_of_version_1_has_the_same_content_and_its_ticks_and_counts_are_compared() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("now.leafrun");
    small_run(&path);
    let (now, _) = content(&path).unwrap();
    let old = version_1(folder.path());
    assert_eq!(content(&old).unwrap(), (now, false));
    for sql in [
        "UPDATE run SET first_tick = 5000",
        "UPDATE run SET last_tick = 9000",
        "DELETE FROM blocks WHERE seq = 2",
        "DELETE FROM events WHERE seq = 2",
        "UPDATE events SET kind = 'rig state' WHERE seq = 2",
        "UPDATE run SET outcome_json = NULL",
    ] {
        let old = version_1(folder.path());
        rusqlite::Connection::open(&old)
            .unwrap()
            .execute(sql, [])
            .unwrap();
        let (read, told) = content(&old).unwrap();
        assert!(told, "{sql}");
        assert_eq!(read.samples[0].time_s, 0.0, "{sql}");
    }
}

#[test]
fn an_open_file_of_version_1_is_closed_as_aborted() {
    let folder = tempfile::tempdir().unwrap();
    let old = version_1(folder.path());
    let open =
        "UPDATE run SET outcome_json = NULL, outcome_crc32 = NULL, last_tick = NULL, block_count = NULL";
    rusqlite::Connection::open(&old)
        .unwrap()
        .execute(open, [])
        .unwrap();
    let closed = RunFile::open(&old)
        .unwrap()
        .close_as_aborted("left open")
        .unwrap();
    assert_eq!((closed.samples, closed.lost), (30, 0));
    let again = RunFile::open(&old).unwrap();
    assert_eq!(again.outcome(), Some(&closed));
    assert!(!tells_damage(&again));
}

/// SQLite's own pages have no checksum. A flipped byte in them must not give a false sample or a panic.
#[test]
fn k5_no_flipped_byte_anywhere_gives_a_false_sample() {
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
            // Values, times, command and cycle.
            assert_identical(&read, &format!("byte {byte}"));
            // Must not panic; damaged events are left out.
            run.events();
        }
    }
    assert!(opened.iter().all(|&n| n > 20), "refused and opened: {opened:?}");
}
