//! The result of a run: limits of a profile, verdicts, exit codes, JUnit XML, the certificate on one sheet.

use std::path::Path;
use std::process::Command;

use super::support::bench::{mock, play, sine};
use super::support::http::{answer, request};
use super::support::{Daemon, json, leafbench};
use crate::acceptance::{LimitVerdict, RunResult, RunVerdict};
use crate::recording::run_file::{RunFile, RunFileWriter, test_support};
use crate::recording::{ChannelScale, Ending, Event, EventKind, Header, Outcome, Recorder};
use crate::report::certificate;

/// Three counted cycles of 1000 samples: 6 mm, 300 N, 0.2 rad of lag. Cycle n has its force multiplied by 1 + 0.1 (n - 1).
fn recorded(folder: &Path, accept: &str, change: fn(&mut Header, &mut Outcome)) -> RunFile {
    let path = folder.join("run.leafrun");
    let mut header = test_support::header();
    header.profile_toml = format!(
        "name = \"sine-6mm-1hz\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"sine\"\nmean_mm = 0.0\n\
         amplitude_mm = 6.0\nfrequency_hz = 1.0\ncycles = 3\n{accept}"
    );
    header.cycles_planned = 3;
    // Without an offset or a tare the amplitudes are those of the counts.
    for channel in [&mut header.force_channel, &mut header.displacement_channel] {
        *channel = ChannelScale {
            offset: 0.0,
            tare: 0.0,
            ..*channel
        };
    }
    let mut outcome = test_support::outcome(3000);
    change(&mut header, &mut outcome);
    let _ = std::fs::remove_file(&path);
    let mut writer = RunFileWriter::create(&path, &header).expect("created");
    for tick in 0..outcome.samples {
        let mut sample = test_support::sample(tick);
        let factor = 1.0 + 0.1 * f64::from(sample.cycle - 1);
        sample.force_counts = (f64::from(sample.force_counts) * factor).round() as i32;
        sample.force_n = header.force_channel.value(sample.force_counts);
        sample.displacement_mm = header.displacement_channel.value(sample.displacement_counts);
        sample.cycle += header.first_cycle - 1;
        writer.sample(&sample);
    }
    writer.end(&outcome);
    RunFile::open(&path).expect("opens")
}

fn result(accept: &str, change: fn(&mut Header, &mut Outcome)) -> RunResult {
    let folder = tempfile::tempdir().expect("a folder");
    RunResult::of(&recorded(folder.path(), accept, change))
}

fn as_it_is(_: &mut Header, _: &mut Outcome) {}

/// Stops in the third cycle.
fn stopped(_: &mut Header, outcome: &mut Outcome) {
    outcome.ending = Ending::Stopped;
    outcome.samples = 2500;
    outcome.cycles_completed = 2;
}

#[test]
fn the_values_of_each_cycle_and_their_trend_are_those_of_the_samples() {
    let result = result("", as_it_is);
    assert_eq!(result.verdict, RunVerdict::NoLimits);
    let value = |name: &str| result.values.iter().find(|v| v.name == name).expect("a value");
    let near =
        |found: f64, exact: f64, within: f64| assert!((found - exact).abs() < within, "{found} for {exact}");
    // A count is 0.1 N; the largest sample of a sine lies within 1e-5 of its peak.
    let peak = value("force_peak_n");
    near(peak.first, 300.0, 0.06);
    near(peak.last, 360.0, 0.06);
    near(peak.trend.expect("three cycles"), 30.0, 0.06);
    assert_eq!(peak.trend_unit, "N/cycle");
    near(value("travel_mm").mean, 12.0, 0.001);
    // x = 6 sin p and F = 300 sin (p - 0.2) enclose -pi 6 300 sin 0.2.
    let energy_j = -std::f64::consts::PI * 6.0 * 300.0 * 0.2f64.sin() * 1e-3;
    near(value("loop_energy_j").first, energy_j, 1e-3);
    near(value("secant_rate_n_per_mm").last, 60.0, 0.02);
    assert_eq!(result.cycles.len(), 3);
    assert!(result.whole.is_some());
}

#[test]
fn each_limit_is_judged_by_its_worst_cycle() {
    let result = result(
        "[[accept]]\nforce_peak_max_n = 350.0\nforce_peak_min_n = 290.0\nforce_peak_trend_max_n_per_cycle = 31.0\n\
         [[accept]]\ncycles = [1, 2]\nforce_peak_max_n = 350.0\n[[accept]]\nlost_max_samples = 0\n",
        as_it_is,
    );
    let told: Vec<_> = result
        .limits
        .iter()
        .map(|l| (l.key.as_str(), l.verdict, l.at_cycle))
        .collect();
    use LimitVerdict::{Fail, Pass};
    assert_eq!(
        told,
        [
            ("force_peak_min_n", Pass, Some(1)),
            ("force_peak_max_n", Fail, Some(3)),
            ("force_peak_trend_max_n_per_cycle", Pass, None),
            ("force_peak_max_n", Pass, Some(2)),
            ("lost_max_samples", Pass, None),
        ]
    );
    assert_eq!(result.verdict, RunVerdict::Fail);
    assert!(
        result
            .why
            .starts_with("1 of 5 limits broken: peak force at most 350 N, cycles 1 to 3, measured 360"),
        "{}",
        result.why
    );
}

#[test]
fn what_was_not_recorded_is_not_judged_and_what_is_broken_is_broken() {
    let limits =
        "[[accept]]\nforce_peak_max_n = 400.0\n[[accept]]\ncycles = [1, 2]\nforce_peak_max_n = 400.0\n";
    let verdicts = |r: &RunResult| r.limits.iter().map(|l| l.verdict).collect::<Vec<_>>();
    use LimitVerdict::{Fail, NotJudged, Pass};
    let short = result(limits, stopped);
    assert_eq!(
        (short.verdict, verdicts(&short)),
        (RunVerdict::NotJudged, vec![NotJudged, Pass])
    );
    assert_eq!(short.limits[0].why, "2 of 3 cycles from 1 to 3 are complete");
    assert!(!short.is_accepted());
    let broken = result("[[accept]]\nforce_peak_max_n = 320.0\n", stopped);
    assert_eq!(
        (broken.verdict, verdicts(&broken)),
        (RunVerdict::Fail, vec![Fail])
    );
    // A run that resumes at cycle 3 of 5 has nothing to say on cycles 1 and 2.
    let resumed = result(limits, |header, _| {
        header.first_cycle = 3;
        header.cycles_planned = 5;
        header.profile_toml = header.profile_toml.replace("cycles = 3", "cycles = 5");
    });
    assert_eq!(
        (resumed.verdict, verdicts(&resumed)),
        (RunVerdict::NotJudged, vec![Pass, NotJudged])
    );
    let unread = result("", |header, _| header.profile_toml = "name = 1".to_owned());
    assert_eq!(unread.verdict, RunVerdict::NotJudged, "{}", unread.why);
}

#[test]
fn a_profile_that_counts_no_cycles_is_judged_over_its_whole_motion() {
    let folder = tempfile::tempdir().expect("a folder");
    let ramp = "name = \"ramp\"\ncontrol = \"displacement\"\n[[block]]\n\
                [[block.segment]]\nkind = \"ramp\"\nto_mm = 10.0\nduration_s = 2.0\n\
                [[block.segment]]\nkind = \"ramp\"\nto_mm = 0.0\nduration_s = 2.0\n\
                [[accept]]\ndisplacement_peak_min_mm = 9.9\ndisplacement_peak_max_mm = 10.1\nforce_peak_max_n = 700.0\n";
    play(&mock(), ramp, Some(folder.path()));
    let result = RunResult::of(&RunFile::open(&folder.path().join("ramp.leafrun")).expect("closed"));
    let verdicts: Vec<_> = result
        .limits
        .iter()
        .map(|l| (l.key.as_str(), l.verdict))
        .collect();
    // 72 N/mm over 10 mm and 15 % of friction are 828 N.
    assert_eq!(
        verdicts,
        [
            ("force_peak_max_n", LimitVerdict::Fail),
            ("displacement_peak_min_mm", LimitVerdict::Pass),
            ("displacement_peak_max_mm", LimitVerdict::Pass),
        ]
    );
    assert!(result.whole.expect("measured").loop_energy_j > 0.0);
}

#[test]
fn the_shipped_profile_with_limits_keeps_them_on_the_mock_bench() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = include_str!("../bench-configs/profiles/sine-6mm-2.5hz-10.toml");
    play(&mock(), text, Some(folder.path()));
    let run = RunFile::open(&folder.path().join("sine-6mm-2.5hz-10.leafrun")).expect("closed");
    let result = RunResult::of(&run);
    assert_eq!(
        (result.verdict, result.why.as_str()),
        (RunVerdict::Pass, "6 limits are kept")
    );
}

/// Pages of a printed HTML file; nothing without Chromium.
fn printed_pages(html: &Path) -> Option<usize> {
    let folder = html.parent().expect("a folder");
    let pdf = html.with_extension("pdf");
    let printed = Command::new("chromium")
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--no-pdf-header-footer",
        ])
        .arg(format!("--user-data-dir={}", folder.join("browser").display()))
        .arg(format!("--print-to-pdf={}", pdf.display()))
        .arg(html)
        .output();
    if printed.is_err() {
        println!("SKIPPED: Chromium is not installed");
        assert!(std::env::var_os("LEAFBENCH_REQUIRE_CHROMIUM").is_none());
        return None;
    }
    let bytes = std::fs::read(&pdf).expect("printed");
    let text = String::from_utf8_lossy(&bytes);
    Some(text.matches("/Type /Page\n").count() + text.matches("/Type /Page ").count())
}

/// Every key of an accept block, with limits of many digits, three times; a bench and a person with long names; many events.
fn crowded(folder: &Path) -> RunFile {
    let keys = "force_peak_max_n = 123456.789\nforce_valley_min_n = -123456.789\nforce_amplitude_max_n = 1.0\ntravel_max_mm = 1.0\n\
                loop_energy_max_j = -9.0\nsecant_rate_trend_max_n_per_mm_per_cycle = 0.000123\nloop_energy_trend_max_j_per_cycle = 0.1\n";
    let accept = format!("[[accept]]\n{keys}").repeat(3);
    let run = recorded(folder, &accept, |header, outcome| {
        header.specimen = "specimen with a long name ".repeat(8);
        header.operator = "W".repeat(300);
        header.remarks = vec!["override by R. Meier: the calibration of the load cell was due ".repeat(6); 9];
        header.bench_toml = format!(
            "name = \"{}\"\n[force_channel]\ncertificate = \"{}\"\ncalibrated = \"2026-09-01\"\ndue = \"2027-09-01\"\n",
            "bench ".repeat(40),
            "DKD-K-12345 ".repeat(20)
        );
        for sensor in [&mut header.force_sensor, &mut header.displacement_sensor] {
            sensor.sensor = "maker and type of a sensor ".repeat(4);
            sensor.serial = "0041".repeat(16);
            sensor.class = "0.5 of ISO 7500-1 ".repeat(6);
            sensor.laboratory = "a laboratory with a long name ".repeat(4);
            sensor.expanded_uncertainty = Some(0.123_456);
        }
        outcome.ending = Ending::Aborted;
        outcome.cause = "the rig ended the run because of something long ".repeat(9);
    });
    let path = run.path().to_owned();
    drop(run);
    RunFile::open(&path).expect("opens")
}

#[test]
fn a_certificate_is_one_sheet_however_much_there_is_to_say() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = crowded(folder.path());
    let page = certificate::page(&run).expect("readable");
    for wanted in [
        "FAIL",
        "override by R. Meier",
        "DKD-K-12345",
        &run.header().bench_sha256,
        "<svg",
        "more limits:",
    ] {
        assert!(page.to_lowercase().contains(&wanted.to_lowercase()), "{wanted}");
    }
    assert!(!page.replace("http://www.w3.org/", "").contains("http") && !page.contains("NaN"));
    let html = folder.path().join("certificate.html");
    std::fs::write(&html, page).expect("written");
    if let Some(pages) = printed_pages(&html) {
        assert_eq!(pages, 1);
    }
}

#[test]
fn a_certificate_tells_of_a_trip_and_has_the_hash_of_the_run_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.leafrun");
    let mut header = test_support::header();
    header.force_sensor.serial = "LC-0041".to_owned();
    header.force_sensor.class = "0.5 of ISO 7500-1".to_owned();
    header.force_sensor.expanded_uncertainty = Some(2.5);
    let mut writer = RunFileWriter::create(&path, &header).expect("created");
    (0..1500).for_each(|tick| writer.sample(&test_support::sample(tick)));
    writer.event(&Event {
        tick: 1500,
        time_s: 1.5,
        kind: EventKind::Limit,
        text: "force limit: 3210 N above 3200 N".to_owned(),
    });
    writer.end(&test_support::outcome(1500));
    drop(writer);
    let page = certificate::page(&RunFile::open(&path).expect("opens")).expect("readable");
    assert!(
        page.contains("1.500 s: force limit: 3210 N above 3200 N"),
        "{page}"
    );
    for wanted in ["LC-0041", "0.5 of ISO 7500-1", "2.5 N (k = 2)"] {
        assert!(page.contains(wanted), "{wanted}");
    }
    let sum = Command::new("sha256sum").arg(&path).output().expect("coreutils");
    let sum = String::from_utf8_lossy(&sum.stdout);
    assert!(page.contains(sum.split(' ').next().expect("a hash")));
}

/// A sine in real time with one limit that the spring keeps and one that it breaks.
fn short_sine(folder: &Path) -> String {
    let text = sine("short", 4.0, 2.0, 3)
        + "[[accept]]\nforce_peak_max_n = 100.0\ndisplacement_amplitude_max_mm = 3.0\n";
    let path = folder.join("short.toml");
    std::fs::write(&path, text.replace("duration_s = 2.0", "duration_s = 0.5")).expect("written");
    path.to_str().expect("UTF-8").to_owned()
}

#[test]
fn a_broken_limit_is_exit_code_one_and_a_failed_case_and_is_served() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let daemon = Daemon::ready(&data, &[]);
    let report = folder.path().join("report.xml");
    let profile = short_sine(folder.path());
    let junit = report.to_str().expect("UTF-8");
    let (ended, code) = json(&data, &["run", &profile, "--junit", junit]);
    assert_eq!(
        (code, &ended["ending"]),
        (1, &serde_json::json!("completed")),
        "{ended}"
    );
    assert_eq!(ended["result"]["verdict"], "fail", "{ended}");
    let told = std::fs::read_to_string(&report).expect("written");
    assert!(
        told.contains("tests=\"3\" failures=\"1\" errors=\"0\" skipped=\"0\""),
        "{told}"
    );
    assert!(
        told.contains("name=\"short: peak force at most 100 N, cycles 1 to 3\""),
        "{told}"
    );

    let run_id = ended["run_id"].as_str().expect("an id");
    let head = |what: &str| {
        format!(
            "GET /api/runs/{run_id}/{what} HTTP/1.1\r\nHost: {}\r\n",
            daemon.authority()
        )
    };
    let (status, served) = request(&daemon, &head("result"), "");
    let served: serde_json::Value = serde_json::from_str(&served).expect("JSON");
    assert_eq!((status, &served), (200, &ended["result"]));
    let (status, page) = request(&daemon, &head("certificate"), "");
    assert!(status == 200 && page.contains("Test certificate"), "{page}");
    let missing = head("result").replace(run_id, "nothing");
    assert_eq!(request(&daemon, &missing, "").0, 404);

    let (again, code) = json(&data, &["result", "latest"]);
    assert_eq!((code, &again), (1, &served));
    let file = folder.path().join("sheet.html");
    let written = leafbench(&["certificate", "latest", "--data"])
        .arg(&data)
        .arg("--out")
        .arg(&file)
        .output()
        .expect("starts");
    assert_eq!(written.status.code(), Some(0));
    assert_eq!(std::fs::read_to_string(&file).expect("written"), page);
    let (_, code) = json(
        &data,
        &["certificate", "latest", "--out", file.to_str().expect("UTF-8")],
    );
    assert_eq!(code, 2, "it is there already");
}

#[test]
fn the_page_shows_the_result_over_the_plots_and_nothing_jumps() {
    use super::support::browser::Page;
    use super::support::http::post;
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let Some(mut page) = Page::open(&daemon.link(), 1280, 800) else {
        return;
    };
    page.until_state("Ready");
    let places = "JSON.stringify(['stop', 'run', 'profile', 'loop', 'clear-peaks', 'counts'].map(id => document.getElementById(id))\
                  .map(e => [e.id, e.offsetLeft, e.offsetTop]))";
    page.until("document.getElementById('band').innerText.includes('N') && document.getElementById('counts').innerText !== ''");
    let before = page.value(places);
    let text = std::fs::read_to_string(short_sine(folder.path())).expect("written");
    let started = post(&daemon, "/api/run", &serde_json::json!({ "profile": text }));
    assert_eq!(answer(started).0, 202);
    page.until("!document.getElementById('result').hidden");
    assert_eq!(page.text("result-verdict"), "Fail");
    assert!(
        page.text("result-limits")
            .contains("peak force at most 100 N, cycles 1 to 3")
    );
    assert!(page.text("result-values").contains("secant rate, N/mm"));
    assert_eq!(
        page.value("document.querySelectorAll('#result-limits tr').length"),
        2
    );
    for (width, height) in [(1280, 800), (1024, 768)] {
        page.size(width, height);
        assert_eq!(page.misplaced(), "", "{width}x{height}");
    }
    page.size(1280, 800);
    assert_eq!(page.value(places), before, "the panel moves nothing");
    page.click("result-close");
    page.until("document.getElementById('result').hidden");
    page.click("result-open");
    page.until("!document.getElementById('result').hidden");
    let started = post(&daemon, "/api/run", &serde_json::json!({ "profile": text }));
    assert_eq!(answer(started).0, 202);
    page.until("document.getElementById('result').hidden");
}
