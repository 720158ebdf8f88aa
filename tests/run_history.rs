//! The list of runs of a folder with many of them: right after every change of the folder, in pages, and fast.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use nix::sys::time::TimeValLike;

use super::support::{Daemon, http, json, until};
use crate::daemon::run_search::{RunQuery, WantedEnding};
use crate::daemon::store::Store;
use crate::recording::Recorder;
use crate::recording::run_file::test_support::{header, outcome, sample};
use crate::recording::run_file::{self, EXTENSION, RunFileWriter};

/// Id of the n-th run; a run starts every minute.
fn id(n: usize) -> String {
    format!("20260101t{n:06}-abcd")
}

fn path(folder: &Path, n: usize) -> PathBuf {
    folder.join(id(n)).with_extension(EXTENSION)
}

/// Starts the n-th run of a laboratory: 7 specimens, 3 operators.
fn begin(folder: &Path, n: usize) -> RunFileWriter {
    let mut head = header();
    let start = jiff::Timestamp::from_second(1_767_225_600 + 60 * n as i64).expect("a time");
    head.run_id = id(n);
    head.started_utc = start.strftime("%Y-%m-%dT%H:%M:%S.000Z").to_string();
    head.specimen = format!("leaf {}", n % 7);
    head.operator = ["Ann", "Bob", "Cem"][n % 3].to_owned();
    let mut writer = RunFileWriter::create(&path(folder, n), &head).expect("created");
    (0..20).for_each(|tick| writer.sample(&sample(tick)));
    writer
}

fn record(folder: &Path, n: usize) {
    begin(folder, n).end(&outcome(20));
}

/// Makes `count` finished runs: the first with `record`, the others as copies with another header, which is faster.
pub fn fill(folder: &Path, count: usize) {
    record(folder, 0);
    let template = std::fs::read(path(folder, 0)).expect("closed");
    for n in 1..count {
        std::fs::write(path(folder, n), &template).expect("written");
        let mut head = header();
        let start = jiff::Timestamp::from_second(1_767_225_600 + 60 * n as i64).expect("a time");
        head.run_id = id(n);
        head.started_utc = start.strftime("%Y-%m-%dT%H:%M:%S.000Z").to_string();
        head.specimen = format!("leaf {}", n % 7);
        head.operator = ["Ann", "Bob", "Cem"][n % 3].to_owned();
        run_file::test_support::replace_header(&path(folder, n), &head);
    }
}

/// Ids that a search of a new program gives, and those of a store that has looked before: they must be the same.
fn ids(known: &Store, folder: &Path, query: &RunQuery) -> Vec<String> {
    let found = |store: &Store| {
        let page = store.search(query, None).expect("listed");
        let ids = page.runs.iter().map(|run| run.summary.run_id.clone());
        (ids.collect::<Vec<_>>(), page.total)
    };
    let (ids, total) = found(known);
    assert_eq!(found(&Store::new(folder)), (ids.clone(), total));
    ids
}

fn all(known: &Store, folder: &Path) -> Vec<String> {
    ids(known, folder, &RunQuery::default())
}

#[test]
fn pages_hold_every_run_once_also_if_runs_come_and_go_between_them() {
    let folder = tempfile::tempdir().expect("a folder");
    fill(folder.path(), 300);
    let store = Store::new(folder.path());
    let wanted = RunQuery {
        specimen: Some("LEAF 3".to_owned()),
        ..RunQuery::default()
    };
    let mut expected: Vec<String> = (0..300).filter(|n| n % 7 == 3).map(id).collect();
    expected.reverse();
    assert_eq!(ids(&store, folder.path(), &wanted), expected);

    let (mut after, mut seen, mut pages) = (None, Vec::new(), 0);
    loop {
        let query = RunQuery {
            limit: Some(10),
            after: after.clone(),
            ..wanted.clone()
        };
        let page = store.search(&query, None).expect("listed");
        let last = page.runs.last().expect("no empty page").listing.path.clone();
        seen.extend(page.runs.iter().map(|run| run.summary.run_id.clone()));
        pages += 1;
        if pages == 1 {
            assert_eq!(page.total, expected.len());
            // The page goes on behind a run that is no longer there, and a newer run does not move it.
            std::fs::remove_file(last).expect("removed");
            record(folder.path(), 3 + 7 * 100);
        }
        after = page.next;
        if after.is_none() {
            break;
        }
    }
    assert_eq!((pages, seen), (expected.len().div_ceil(10), expected));
}

#[test]
fn the_list_follows_runs_that_begin_end_and_go() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    fill(folder, 5);
    let store = Store::new(folder);
    let newest_first = |numbers: &[usize]| numbers.iter().copied().map(id).collect::<Vec<_>>();
    assert_eq!(all(&store, folder), newest_first(&[4, 3, 2, 1, 0]));
    // A run under way, then its end.
    let mut writer = begin(folder, 9);
    let open = RunQuery {
        result: Some(WantedEnding::Open),
        ..RunQuery::default()
    };
    assert_eq!(ids(&store, folder, &open), newest_first(&[9]));
    writer.end(&outcome(20));
    drop(writer);
    assert_eq!(ids(&store, folder, &open), newest_first(&[]));
    std::fs::remove_file(path(folder, 3)).expect("removed");
    assert_eq!(all(&store, folder), newest_first(&[9, 4, 2, 1, 0]));
}

#[test]
fn another_run_in_the_place_of_a_file_is_seen_also_with_the_old_size_and_time() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    fill(folder, 5);
    let store = Store::new(folder);
    let newest_first = |numbers: &[usize]| numbers.iter().copied().map(id).collect::<Vec<_>>();
    assert_eq!(all(&store, folder), newest_first(&[4, 3, 2, 1, 0]));
    // Another run in the place of a file, with the old size and the old time of change.
    let (old, times) = (
        path(folder, 2),
        std::fs::metadata(path(folder, 2)).expect("there"),
    );
    std::fs::copy(path(folder, 4), folder.join("new")).expect("copied");
    std::fs::rename(folder.join("new"), &old).expect("replaced");
    let file = std::fs::File::options().append(true).open(&old).expect("opened");
    file.set_modified(times.modified().expect("a time")).expect("set");
    assert_eq!(all(&store, folder), newest_first(&[4, 4, 3, 1, 0]));
}

#[test]
fn no_harm_to_the_index_is_seen_in_the_list() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    fill(folder, 4);
    let store = Store::new(folder);
    let newest_first = |numbers: &[usize]| numbers.iter().copied().map(id).collect::<Vec<_>>();

    let index = folder.join("runs.index");
    // A file that has just changed is not kept: it may change again within the same time stamp.
    let whole = until("an index with every run", || {
        assert_eq!(all(&store, folder), newest_first(&[3, 2, 1, 0]));
        let text = std::fs::read(&index).ok()?;
        let lines = String::from_utf8_lossy(&text).into_owned();
        [3, 2, 1, 0]
            .iter()
            .all(|&n| lines.contains(&id(n)))
            .then_some(text)
    });
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 1;
    let doubled = [&whole[..], &whole[..]].concat();
    for harm in [
        &whole[..whole.len() - 9],
        &flipped,
        &doubled,
        b"",
        b"\xff\n",
        &whole[30..],
    ] {
        std::fs::write(&index, harm).expect("written");
        let new = Store::new(folder);
        assert_eq!(all(&new, folder), newest_first(&[3, 2, 1, 0]));
    }
    std::fs::remove_file(&index).expect("there");
    assert_eq!(all(&Store::new(folder), folder), newest_first(&[3, 2, 1, 0]));
    assert!(index.exists(), "it is written again");
    std::fs::remove_file(&index).expect("there");
    std::fs::create_dir(&index).expect("an index that cannot be written");
    assert_eq!(all(&Store::new(folder), folder), newest_first(&[3, 2, 1, 0]));
}

#[test]
fn a_file_that_is_damaged_later_is_listed_as_damaged() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    fill(folder, 4);
    let store = Store::new(folder);
    let damaged = RunQuery {
        result: Some(WantedEnding::Damaged),
        ..RunQuery::default()
    };
    assert_eq!(ids(&store, folder, &damaged), Vec::<String>::new());
    run_file::test_support::damage_samples(&path(folder, 2));
    assert_eq!(ids(&store, folder, &damaged), [id(2)]);
    std::fs::write(path(folder, 1), "no run").expect("written");
    let unreadable = RunQuery {
        result: Some(WantedEnding::Unreadable),
        ..RunQuery::default()
    };
    assert_eq!(ids(&store, folder, &unreadable), [id(1)]);
}

#[test]
fn an_answer_in_time_says_how_many_files_it_has_not_read() {
    let folder = tempfile::tempdir().expect("a folder");
    fill(folder.path(), 30);
    let store = Store::new(folder.path());
    let page = store
        .search(&RunQuery::default(), Some(Duration::ZERO))
        .expect("listed");
    assert_eq!((page.total, page.unread), (30, 30));
    until("everything read in full", || {
        store.check_some(Duration::from_secs(60)).expect("read");
        let page = store
            .search(&RunQuery::default(), Some(Duration::ZERO))
            .expect("listed");
        (page.unread == 0).then_some(())
    });
    // A new program knows it from the index.
    let page = Store::new(folder.path()).search(&RunQuery::default(), Some(Duration::ZERO));
    assert_eq!(page.expect("listed").unread, 0);
}

/// Searches of different kinds, each for a `page`.
fn searches(page: &RunQuery) -> [(&'static str, RunQuery); 5] {
    let text = |words: &str| RunQuery {
        text: Some(words.to_owned()),
        ..page.clone()
    };
    [
        ("a page of all", page.clone()),
        ("one word", text("bob")),
        ("three words", text("leaf cem sine")),
        ("nothing fits", text("no such thing")),
        (
            "specimen, operator, dates, result",
            RunQuery {
                specimen: Some("leaf 3".to_owned()),
                operator: Some("ann".to_owned()),
                since: Some("2026-01-02T00:00:00Z".parse().expect("a time")),
                result: Some(WantedEnding::Completed),
                ..page.clone()
            },
        ),
    ]
}

/// Processor time of this thread.
fn processor_time() -> Duration {
    use nix::sys::resource::{UsageWho, getrusage};
    let usage = getrusage(UsageWho::RUSAGE_THREAD).expect("known");
    let time = usage.user_time() + usage.system_time();
    Duration::from_micros(time.num_microseconds().unsigned_abs())
}

/// The times that technicians were promised: a search over 10 000 runs in less than 200 ms. The processor time is judged: a search
/// is one thread that waits for nothing, and on a busy computer the time on the clock is that of the others. Run it with
/// `cargo test --release --lib ten_thousand -- --ignored --nocapture`.
#[test]
#[ignore = "makes 10 000 files and measures times"]
fn a_search_over_ten_thousand_runs_takes_less_than_200_ms() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let timed = |what: &str, work: &mut dyn FnMut()| {
        let (begun, computed) = (Instant::now(), processor_time());
        work();
        let computed = processor_time() - computed;
        let ms = |time: Duration| 1000.0 * time.as_secs_f64();
        println!(
            "{what}: {:.1} ms, processor {:.1} ms",
            ms(begun.elapsed()),
            ms(computed)
        );
        computed
    };
    timed("making 10 000 run files", &mut || fill(folder, 10_000));
    // What changed in the last second is read again with every look.
    std::thread::sleep(Duration::from_millis(1100));
    let search = |store: &Store, query: &RunQuery, within| store.search(query, within).expect("listed");
    let page = RunQuery {
        limit: Some(25),
        ..RunQuery::default()
    };
    let within = Some(Duration::from_millis(80));
    let store = Store::new(folder);
    timed("first look without an index", &mut || {
        drop(search(&store, &page, within))
    });
    timed("reading all files in full", &mut || {
        drop(store.check_some(PATIENCE))
    });
    let new = Store::new(folder);
    timed("first look with the index of an earlier program", &mut || {
        drop(search(&new, &page, within))
    });
    for (what, query) in searches(&page) {
        let took = (0..5)
            .map(|_| timed(what, &mut || drop(search(&new, &query, within))))
            .max();
        assert!(took < Some(Duration::from_millis(200)), "{what}: {took:?}");
    }
    record(folder, 10_001);
    let took = timed("a page after a new run", &mut || {
        let page = search(&new, &page, within);
        assert_eq!(page.runs[0].summary.run_id, id(10_001));
    });
    assert!(took < Duration::from_millis(200), "{took:?}");
}

/// Longest time for reading 10 000 small files.
const PATIENCE: Duration = Duration::from_secs(600);

/// Headers and JSON of an answer.
fn get(daemon: &Daemon, path: &str) -> (u16, String, serde_json::Value) {
    let head = format!("GET {path} HTTP/1.1\r\nHost: {}\r\n", daemon.authority());
    let mut answer = String::new();
    let mut stream = http::send(daemon, &head, "");
    std::io::Read::read_to_string(&mut stream, &mut answer).expect("an answer");
    let (headers, body) = answer.split_once("\r\n\r\n").expect("a body");
    let status = headers
        .split(' ')
        .nth(1)
        .and_then(|s| s.parse().ok())
        .expect("a status");
    (
        status,
        headers.to_owned(),
        serde_json::from_str(body).expect("JSON"),
    )
}

fn field<'a>(headers: &'a str, name: &str) -> Option<&'a str> {
    headers
        .lines()
        .find_map(|line| line.strip_prefix(name)?.strip_prefix(": "))
}

fn ids_of(runs: &serde_json::Value) -> Vec<String> {
    let runs = runs.as_array().expect("a list");
    let ids = runs
        .iter()
        .map(|run| run["run_id"].as_str().expect("an id").to_owned());
    ids.collect()
}

#[test]
fn http_and_the_command_line_give_the_same_runs_in_pages_and_whole() {
    let folder = tempfile::tempdir().expect("a folder");
    fill(folder.path(), 60);
    let daemon = Daemon::start(folder.path(), &[]);
    let newest: Vec<String> = (0..60).rev().map(id).collect();
    let (status, headers, runs) = get(&daemon, "/api/runs");
    assert_eq!((status, ids_of(&runs)), (200, newest.clone()));
    assert_eq!(
        (
            field(&headers, "leafbench-total"),
            field(&headers, "leafbench-next")
        ),
        (Some("60"), None)
    );

    let mut path = "/api/runs?operator=bob&limit=7".to_owned();
    let mut seen = Vec::new();
    loop {
        let (status, headers, runs) = get(&daemon, &path);
        assert_eq!((status, field(&headers, "leafbench-total")), (200, Some("20")));
        seen.extend(ids_of(&runs));
        match field(&headers, "leafbench-next") {
            Some(next) => path = format!("/api/runs?operator=bob&limit=7&after={next}"),
            None => break,
        }
    }
    let (mut listed, code) = json(folder.path(), &["runs", "--operator", "bob"]);
    listed.as_array_mut().expect("a list").reverse();
    assert_eq!((code, &seen), (0, &ids_of(&listed)));
    assert_eq!(seen.len(), 20);

    let (status, _, error) = get(&daemon, "/api/runs?since=yesterday");
    assert_eq!(status, 400);
    let text = error["error"].as_str().expect("a text");
    assert!(
        text.contains("since=yesterday") && text.contains("2026-11-23"),
        "{text}"
    );
    assert_eq!(
        get(
            &daemon,
            "/api/runs?since=2026-01-01&until=2026-01-01&text=ANN+sine"
        )
        .0,
        200
    );
    for refused in ["result=good", "limit=-1", "specimn=x"] {
        assert_eq!(get(&daemon, &format!("/api/runs?{refused}")).0, 400, "{refused}");
    }
    assert_eq!(
        ids_of(&get(&daemon, "/api/runs?after=nonsense").2),
        Vec::<String>::new()
    );
}

#[test]
fn two_runs_are_compared_at_equal_displacement() {
    let folder = tempfile::tempdir().expect("a folder");
    for (n, extra_counts) in [(0, 0), (1, 50)] {
        let mut head = header();
        head.run_id = id(n);
        let mut writer = RunFileWriter::create(&path(folder.path(), n), &head).expect("created");
        for tick in 0..4000 {
            let mut sample = sample(tick);
            sample.force_counts += extra_counts;
            writer.sample(&sample);
        }
        writer.end(&outcome(4000));
    }
    let daemon = Daemon::start(folder.path(), &[]);
    let (status, _, both) = get(&daemon, &format!("/api/compare?first={}&second={}", id(1), id(0)));
    assert_eq!(status, 200, "{both}");
    // 50 counts of 0.1 N, everywhere.
    for of in ["loading_n", "unloading_n"] {
        let values = both["difference"][of].as_array().expect("a column");
        let known: Vec<f64> = values.iter().filter_map(serde_json::Value::as_f64).collect();
        assert!(
            known.len() > 190 && known.iter().all(|n| (n - 5.0).abs() < 1e-6),
            "{of}: {known:?}"
        );
    }
    assert!((both["difference"]["rms_n"].as_f64().expect("a number") - 5.0).abs() < 1e-6);
    assert_eq!(both["first"]["cycles"], 4);
    let peak = |which: &str| both[which]["figures"]["force_max_n"].as_f64().expect("a number");
    assert!((peak("first") - peak("second") - 5.0).abs() < 1e-6);
    assert_eq!(
        get(&daemon, &format!("/api/compare?first={}&second=none", id(1))).0,
        404
    );
}
