//! How fast the page draws with fifty cycles in view, and what ten viewers that never read cost the control loop. Both print
//! their figures: `cargo test --release --lib page_frames -- --nocapture`.

use std::net::TcpStream;

use serde_json::{Value, json};

use super::run_files::get;
use super::support::browser::Page;
use super::support::http::{answer, post};
use super::support::{Daemon, json as command, until};

/// Cycles at 5 Hz: fifty are over after 12 s, and the run goes on while frames are counted.
const FIFTY: &str = "name = \"fifty\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 4.0\n\
                     duration_s = 1.0\n[[block.segment]]\nkind = \"sine\"\nmean_mm = 4.0\namplitude_mm = 1.5\nfrequency_hz = 5.0\n\
                     cycles = 400\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 0.0\nduration_s = 2.0\n";
/// Frames per second that a moving plot needs.
const TARGET_FPS: f64 = 30.0;
const FRAMES: usize = 120;
/// Turns of the control loop in one window of the measurement: 3 s.
const TURNS: u64 = 3000;

#[test]
fn the_page_draws_fifty_cycles_of_a_live_run_fast_enough() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let Some(mut page) = Page::open(&daemon.link(), 1280, 800) else {
        return;
    };
    page.until_state("Ready");
    assert_eq!(
        answer(post(&daemon, "/api/run", &json!({ "profile": FIFTY }))).0,
        202
    );
    page.until("status.rig.cycles_completed >= 50");
    let measured = page.value(&format!(
        "new Promise(done => {{ const at = [], drawn = [], drawBefore = drawPlots; \
         drawPlots = () => {{ const begun = performance.now(); drawBefore(); drawn.push(performance.now() - begun); }}; \
         const frame = now => {{ at.push(now); if (at.length <= {FRAMES}) requestAnimationFrame(frame); \
         else {{ drawPlots = drawBefore; done({{ seconds: (at[{FRAMES}] - at[0]) / 1000, drawn, points: points.t.length, \
         running: status.rig.phase }}); }} }}; requestAnimationFrame(frame); }})"
    ));
    let mut drawn: Vec<f64> = serde_json::from_value(measured["drawn"].clone()).expect("numbers");
    drawn.sort_by(f64::total_cmp);
    let (median_ms, worst_ms) = (drawn[drawn.len() / 2], drawn[drawn.len() - 1]);
    let fps = FRAMES as f64 / measured["seconds"].as_f64().expect("a number");
    println!(
        "{fps:.1} frames per second, the plots drawn {:.1} times per second (target {TARGET_FPS}), with {} points of 50 cycles \
         in view; drawing takes {median_ms:.1} ms (median), {worst_ms:.1} ms (worst)",
        drawn.len() as f64 / measured["seconds"].as_f64().expect("a number"),
        measured["points"],
    );
    assert_eq!(measured["running"], "running");
    // Frames per second also depend on what else this computer does; the time of one drawing much less.
    assert!(median_ms < 1000.0 / TARGET_FPS, "{median_ms} ms for one drawing");
    command(folder.path(), &["stop"]);
}

/// Turns and sum of their delays in us.
#[derive(Debug, Clone, Copy)]
struct Delays {
    turns: f64,
    late: f64,
    sum_us: f64,
}

fn delays(daemon: &Daemon) -> Delays {
    let (_, _, text) = get(daemon, "/metrics");
    let value = |name: &str| {
        let line = text
            .lines()
            .find(|line| line.starts_with(&format!("{name} ")))
            .expect(name);
        line.rsplit(' ')
            .next()
            .and_then(|v| v.parse::<f64>().ok())
            .expect("a number")
    };
    Delays {
        turns: value("leafbench_control_lateness_seconds_count"),
        late: value("leafbench_control_late_turns_total"),
        sum_us: 1e6 * value("leafbench_control_lateness_seconds_sum"),
    }
}

/// Mean delay in us and share of late turns over the next window.
fn window(daemon: &Daemon) -> (f64, f64) {
    let begin = delays(daemon);
    let end = until("a window of turns", || {
        let now = delays(daemon);
        (now.turns >= begin.turns + TURNS as f64).then_some(now)
    });
    let turns = end.turns - begin.turns;
    (
        (end.sum_us - begin.sum_us) / turns,
        (end.late - begin.late) / turns,
    )
}

/// Asks for the live view and never reads it.
fn viewer(daemon: &Daemon) -> TcpStream {
    let mut stream = TcpStream::connect(daemon.authority()).expect("the daemon listens");
    let head = format!(
        "GET /api/live HTTP/1.1\r\nHost: {}\r\n{}Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
        daemon.authority(),
        daemon.bearer()
    );
    std::io::Write::write_all(&mut stream, head.as_bytes()).expect("sent");
    stream
}

#[test]
fn ten_viewers_that_never_read_do_not_delay_control() {
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let lost = |status: &Value| status["rig"]["counters"]["lost"].as_u64().expect("a number");
    let lost_before = lost(&daemon.status());
    let (mut without, mut with) = (Vec::new(), Vec::new());
    // By turns, so that what else this computer does meets both.
    for _ in 0..3 {
        without.push(window(&daemon));
        let viewers: Vec<TcpStream> = (0..10).map(|_| viewer(&daemon)).collect();
        with.push(window(&daemon));
        drop(viewers);
    }
    let least = |windows: &[(f64, f64)]| {
        windows
            .iter()
            .fold((f64::INFINITY, f64::INFINITY), |(us, share), w| {
                (us.min(w.0), share.min(w.1))
            })
    };
    let (quiet, busy) = (least(&without), least(&with));
    println!(
        "mean delay of a turn in us, share of late turns\n  without viewers {without:.0?}\n  with ten        {with:.0?}"
    );
    println!(
        "  best window: {:.0} us and {:.2} % late without, {:.0} us and {:.2} % late with",
        quiet.0,
        100.0 * quiet.1,
        busy.0,
        100.0 * busy.1
    );
    assert_eq!(lost(&daemon.status()), lost_before);
    // Two threads serve the viewers; on two busy cores they may take a turn of the computer, but never the loop.
    assert!(
        busy.0 < quiet.0 + 500.0,
        "{} us with viewers, {} us without",
        busy.0,
        quiet.0
    );
}
