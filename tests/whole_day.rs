//! A technician's whole day on the page, in a headless Chromium on the mock rig: from the first plan to the next test, with a
//! stop, a trip and a lost daemon between. Each step leaves four screenshots: light and dark, in both sizes of the window. Nothing
//! may be cut, lie over something else, or jump. The screenshots stay in `LEAFBENCH_SCREENSHOTS`, or in `target/screenshots`.
//! Without Chromium this test passes without running.

use std::path::{Path, PathBuf};

use super::support::bench::concealing;
use super::support::browser::Page;
use super::support::{Daemon, config, until};

/// Sizes of the window that technicians have.
const SIZES: [(u32, u32); 2] = [(1280, 800), (1024, 768)];
const THEMES: [&str; 2] = ["light", "dark"];

/// The specimen of this rig has a weak helper leaf from 8 mm on that the bench's model knows nothing about. It costs some
/// newtons at 25 mm: there the prediction stays just within this limit, and the rig trips.
const FORCE_MAX_N: f64 = 2080.0;
const TOO_HIGH: &str = "name = \"too-high\"\ncontrol = \"displacement\"\n\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\n\
                        to_mm = 25.0\nduration_s = 4.0\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 0.0\nduration_s = 4.0\n";
/// Loops about the helper leaf's knee, judged.
const LOOPS: &str = "name = \"loops\"\ncontrol = \"displacement\"\n\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 9.0\n\
                     duration_s = 1.0\n[[block.segment]]\nkind = \"sine\"\nmean_mm = 9.0\namplitude_mm = 1.0\nfrequency_hz = 1.0\n\
                     cycles = 8\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 0.0\nduration_s = 1.0\n\n[[accept]]\n\
                     force_peak_max_n = 2000.0\nloop_energy_min_j = 0.001\n";

/// The page, and the folder of its screenshots.
struct Day {
    page: Page,
    folder: PathBuf,
    steps: u32,
    /// Places of what must never jump, by size of the window.
    places: Vec<(u32, serde_json::Value)>,
}

impl Day {
    fn element(id: &str) -> String {
        format!("document.getElementById('{id}')")
    }

    /// Presses a button as soon as it can be pressed, wherever it is on the page.
    fn press(&mut self, id: &str) {
        let element = Day::element(id);
        self.page
            .until(&format!("!{element}.disabled && !{element}.hidden"));
        self.page
            .value(&format!("{element}.scrollIntoView({{ block: 'center' }})"));
        self.page.click(id);
    }

    /// Presses the button of these words within an element.
    fn press_words(&mut self, within: &str, words: &str) {
        let button = format!(
            "[...document.querySelectorAll('{within} button')].find(b => b.textContent === '{words}')"
        );
        self.page.until(&format!(
            "({button}) && !({button}).hidden && !({button}).disabled"
        ));
        self.page.value(&format!("{button}.click()"));
    }

    /// Writes into a field as typing does.
    fn write(&mut self, id: &str, text: &str) {
        let (element, text) = (Day::element(id), serde_json::Value::from(text));
        self.page.value(&format!(
            "(() => {{ const e = {element}; e.focus(); e.value = {text}; e.dispatchEvent(new Event('input', {{ bubbles: true }})); }})()"
        ));
    }

    /// Takes the screenshots of one step, with this element in the middle of the window.
    fn step(&mut self, name: &str, in_sight: &str) {
        self.steps += 1;
        for (width, height) in SIZES {
            self.page.size(width, height);
            for theme in THEMES {
                self.page.theme(theme);
                let element = Day::element(in_sight);
                // Two frames: the plots are drawn again after a change of size or theme.
                self.page.value(&format!(
                    "(async () => {{ {element}.scrollIntoView({{ block: 'center' }}); \
                     for (let i = 0; i < 2; i++) await new Promise(requestAnimationFrame); }})()"
                ));
                let file = format!("{:02}-{name}-{width}-{theme}.png", self.steps);
                self.page.screenshot(&self.folder.join(file));
            }
            assert_eq!(self.page.misplaced(), "", "{name} at {width}x{height}");
            self.check_places(name, width, height);
        }
        self.page.theme(THEMES[0]);
        self.page.size(SIZES[0].0, SIZES[0].1);
    }

    /// The controls are at the same place as in every step before, and Stop and Reset are on the screen.
    fn check_places(&mut self, name: &str, width: u32, height: u32) {
        let places = self.page.value(
            "JSON.stringify(['stop', 'reset', 'hold', 'resume', 'zero', 'tare', 'jog-up', 'profile', 'run', 'loop'].map(id => \
             document.getElementById(id)).map(e => [e.id, e.offsetLeft, e.offsetTop]))",
        );
        match self.places.iter().find(|(of, _)| *of == width) {
            Some((_, before)) => assert_eq!(&places, before, "{name} at {width}x{height}"),
            None => self.places.push((width, places)),
        }
        let inside = self.page.value(
            "['stop', 'reset'].every(id => { const r = document.getElementById(id).getBoundingClientRect(); \
             return r.top >= 0 && r.bottom <= innerHeight && r.right <= innerWidth; })",
        );
        assert_eq!(
            inside, true,
            "Stop and Reset are on the screen: {name} at {width}x{height}"
        );
    }

    fn choose(&mut self, profile: &str) {
        let element = Day::element("profile");
        self.page.until(&format!(
            "[...{element}.options].some(o => o.value === '{profile}')"
        ));
        self.page.value(&format!(
            "{element}.value = '{profile}'; {element}.dispatchEvent(new Event('change'))"
        ));
        self.page
            .until("document.getElementById('plan').textContent.includes('Predicted: ')");
    }

    /// A new profile through the editor, saved and chosen.
    fn new_profile(&mut self, name: &str, text: &str) {
        self.press("new-profile");
        self.page.until("!document.getElementById('editor').hidden");
        self.write("editor-source", text);
        self.page.until(&format!(
            "checked && checked.profile === '{name}' && !document.getElementById('editor-error').textContent"
        ));
        if name == "loops" {
            self.step("profile-editor", "editor-source");
        }
        self.press("editor-save");
        self.page
            .until("document.getElementById('editor-told').textContent");
        self.press("editor-close");
        self.choose(name);
    }

    fn run_to_the_end(&mut self) {
        self.press("run");
        self.page.until_state("Running");
        self.page.until("!document.getElementById('result').hidden");
        self.page.until_state("Ready");
    }
}

/// The folder of the screenshots, which stay after the test.
fn screenshots() -> PathBuf {
    let folder = std::env::var_os("LEAFBENCH_SCREENSHOTS")
        .map_or_else(|| Path::new("target").join("screenshots"), PathBuf::from);
    std::fs::create_dir_all(&folder).expect("made");
    folder
}

/// A daemon whose specimen conceals a helper leaf, and its page.
fn open(folder: &Path) -> Option<(Daemon, Day)> {
    let mut bench = concealing(
        "progressive_stiffness",
        &[("extra_rate_n_per_mm", 3.0), ("knee_mm", 8.0), ("width_mm", 2.0)],
    );
    bench.limits.force_max_n = FORCE_MAX_N;
    let file = folder.join("bench.toml");
    std::fs::write(&file, bench.to_toml()).expect("written");
    let text = |path: PathBuf| path.to_str().expect("UTF-8").to_owned();
    let profiles = text(config("profiles"));
    let daemon = Daemon::ready(
        &folder.join("data"),
        &["--bench", &text(file), "--profiles", &profiles],
    );
    let mut page = Page::open(&daemon.link(), SIZES[0].0, SIZES[0].1)?;
    page.until_state("Ready");
    page.until(
        "document.getElementById('profile').value && document.getElementById('counts').innerText !== ''",
    );
    let day = Day {
        page,
        folder: screenshots(),
        steps: 0,
        places: Vec::new(),
    };
    Some((daemon, day))
}

#[test]
fn a_whole_day_from_the_first_plan_to_the_next_test() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some((mut daemon, mut day)) = open(folder.path()) else {
        return;
    };
    prepare(&daemon, &mut day);
    run_with_hold_and_reload(&daemon, &mut day);
    stop_and_trip(&mut day);
    search_and_compare(&mut day);
    diagnose_and_go_on(&mut day);
    daemon.process.0.kill().expect("killed");
    day.page.until_state("No daemon");
    day.step("daemon-killed", "stop");
    println!("{} steps, screenshots in {}", day.steps, day.folder.display());
}

/// Plan, tare, jog, stop, zero, a profile of one's own.
fn prepare(daemon: &Daemon, day: &mut Day) {
    day.write("specimen", "samurai-front 7");
    day.write("operator", "A. Technician");
    day.choose("static-ramp-12s");
    day.step("plan", "plan");
    day.press("tare");
    day.page
        .until("document.getElementById('notice').textContent.startsWith('New tare: ')");
    day.step("tare", "tare");

    day.page.mouse("mousePressed", "jog-up");
    until("a way of 1 mm", || {
        daemon.status()["rig"]["displacement_mm"]
            .as_f64()
            .filter(|mm| *mm > 1.0)
    });
    day.page.mouse("mouseReleased", "jog-up");
    day.page.until_state("Jog ended");
    day.step("jog", "jog-up");
    day.press("stop");
    day.page.until_state("Ready");
    day.press("zero");
    day.page.until_state("To zero");
    day.step("to-zero", "zero");
    day.page.until_state("Ready");
    day.new_profile("loops", LOOPS);
}

/// A run with a hold, a second window, a page that is loaded again, and its result.
fn run_with_hold_and_reload(daemon: &Daemon, day: &mut Day) {
    day.press("run");
    day.page.until_state("Running");
    day.page.until("status.rig.cycles_completed >= 1");
    day.step("running", "loop");
    day.press("hold");
    day.page.until_state("On hold");
    day.step("on-hold", "hold");

    let mut second = Page::open(&daemon.link(), SIZES[0].0, SIZES[0].1).expect("as the first one");
    second.until_state("On hold");
    second.until("document.getElementById('commander').textContent.startsWith('Watching. Commanded by: the page of A. Technician')");
    second.screenshot(&day.folder.join("second-window.png"));
    assert_eq!(second.misplaced(), "");
    assert_eq!(second.value("document.getElementById('stop').disabled"), false);
    drop(second);

    day.press("resume");
    day.page.until_state("Running");
    day.page.ask("Page.reload", &serde_json::json!({}));
    day.page
        .until("document.readyState === 'complete' && typeof points === 'object'");
    day.page.until_state("Running");
    day.page.until("points.t.length > 100 && isMine()");
    assert_eq!(
        day.page.value("points.t[0] < 1"),
        true,
        "the page shows the run from its start again"
    );
    day.step("loaded-again", "loop");
    day.page.until("!document.getElementById('result').hidden");
    day.page.until_state("Ready");
    assert_eq!(day.page.text("result-verdict"), "Pass");
    day.step("result", "result-verdict");

    let address = day
        .page
        .value("document.getElementById('result-certificate').href");
    let mut certificate = Page::open(&daemon.link(), 820, 1160).expect("as the first one");
    certificate.until("document.getElementById('state')");
    certificate.ask("Page.navigate", &serde_json::json!({ "url": address }));
    certificate
        .until("document.readyState === 'complete' && document.body.innerText.includes('samurai-front 7')");
    assert_eq!(
        certificate.value("document.body.innerText.includes('8 of 8 complete')"),
        true,
        "the cycle that was held and repeated counts once"
    );
    certificate.screenshot(&day.folder.join("certificate.png"));
    day.press("result-close");
}

/// A stop by key, scrolled; a trip, its reset, and back to zero.
fn stop_and_trip(day: &mut Day) {
    day.press("run");
    day.page.until_state("Running");
    day.page.until("status.rig.displacement_mm > 4");
    day.page.value("scrollTo(0, document.body.scrollHeight)");
    day.page.key("Escape", "");
    day.page.until_state("Ready");
    day.step("stopped", "stop");

    day.new_profile("too-high", TOO_HIGH);
    day.press("run");
    day.page.until_state("Interlocked");
    day.step("tripped", "state-detail");
    assert!(
        day.page
            .text("state-detail")
            .contains("What happened: The force passed its limit."),
        "{}",
        day.page.text("state-detail")
    );
    day.press("reset");
    day.page.until_state("Ready");
    day.press("zero");
    day.page.until_state("To zero");
    day.page.until_state("Ready");
    day.step("after-the-trip", "state-detail");
}

/// A second run of the loops; both are found and laid over each other.
fn search_and_compare(day: &mut Day) {
    day.choose("loops");
    day.run_to_the_end();
    day.press("result-close");
    day.write("find-profile", "loops");
    day.page.value(
        "(() => { const e = document.getElementById('find-result'); e.value = 'completed'; \
         e.dispatchEvent(new Event('input', { bubbles: true })); })()",
    );
    day.page
        .until("document.getElementById('runs-count').textContent === '1 to 2 of 2'");
    day.page.value("document.querySelector('#runs .opener').click()");
    day.page
        .until("document.querySelector('#runs tr.details .facts')");
    day.step("search", "runs");
    day.press_words("#runs tr.details", "Result");
    day.page.until("!document.getElementById('result').hidden");
    day.press("result-close");
    for n in [0, 1] {
        day.page.value(&format!(
            "document.querySelectorAll('#runs input[type=checkbox]')[{n}].click()"
        ));
    }
    day.press("compare");
    day.page.until("!document.getElementById('comparison').hidden");
    day.step("compare", "compare-loop");
    day.press("compare-close");
}

/// The helper leaf is found, its model becomes the twin, and the next test runs.
fn diagnose_and_go_on(day: &mut Day) {
    day.press("diagnose");
    day.page.until("document.querySelector('#jobs li')");
    day.step("diagnosis-under-way", "jobs");
    day.page.until("document.querySelector('#jobs progress').hidden");
    let told = day.page.value("document.querySelector('#jobs li p').textContent");
    assert!(
        told.as_str()
            .is_some_and(|t| t.starts_with("The model lacks physics.")),
        "{told}"
    );
    day.press_words("#jobs", "Show the report");
    day.page
        .until("document.querySelector('#jobs iframe').offsetHeight > 300");
    day.step("report", "jobs");
    day.press_words("#jobs", "Hide the report");
    day.press_words("#jobs", "Use the improved model as twin");
    day.page
        .until("document.getElementById('twin-model').textContent.includes('(diagnosis ')");
    day.step("improved-twin", "twin-model");
    day.press_words("#jobs", "Run the next test");
    day.page
        .until("document.getElementById('profile').value.startsWith('next-test-')");
    day.page
        .until("document.getElementById('plan').textContent.includes('Predicted: ')");
    day.step("next-test-planned", "plan");
    day.press("run");
    day.page.until_state("Running");
    day.page.until("status.rig.displacement_mm > 2");
    day.step("next-test", "loop");
    day.press("stop");
    day.page.until_state("Ready");
}
