//! Figures for Prometheus at `/metrics`, in its text format 0.0.4. They are made from the status that control publishes and from
//! counters of other threads: control never waits for a scrape.

use std::fmt::Write as _;

use super::state::DaemonState;
use super::tally::TallyCounts;
use crate::control::realtime::LoopHealth;
use crate::control::{Phase, RigStatus};
use crate::link::LinkHealth;
use crate::recording::punctuality::LATENESS_BOUNDS_US;

/// Type of the text, for the header of the answer.
pub(super) const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

/// All phases of a bench: the figure of the present one is 1, that of all others 0.
const PHASES: [Phase; 7] = [
    Phase::Connecting,
    Phase::Ready,
    Phase::Arming,
    Phase::Running,
    Phase::Held,
    Phase::Unloading,
    Phase::Interlocked,
];

/// All figures of this daemon.
pub(super) fn text(state: &DaemonState) -> String {
    let (rig, control) = state.control.status();
    let settings = &state.settings;
    let mut page = MetricsPage::default();
    page.family(
        "leafbench_info",
        "gauge",
        "Version, bench and link of this daemon.",
    );
    page.value(
        "leafbench_info",
        &[
            ("version", env!("CARGO_PKG_VERSION")),
            ("bench", &settings.bench.name),
            ("link", &settings.link_address),
        ],
        1.0,
    );
    bench(&mut page, &rig);
    samples(&mut page, &rig);
    punctuality(&mut page, &control);
    page.gauge(
        "leafbench_control_degraded",
        "Things that the system does not allow the control thread (real-time priority, locked memory).",
        state.control.degraded().len() as f64,
    );
    connection(&mut page, &rig, &state.link_health());
    runs(&mut page, &state.tally.counts());
    if let Some(bytes) = state.disk.free_bytes() {
        let what = "Free space on the disk of the run files.";
        page.gauge("leafbench_disk_free_bytes", what, bytes as f64);
    }
    page.gauge(
        "leafbench_live_clients",
        "Open live views (pages).",
        state.live.viewers() as f64,
    );
    page.0
}

/// What the bench is doing.
fn bench(page: &mut MetricsPage, rig: &RigStatus) {
    page.family(
        "leafbench_bench_state",
        "gauge",
        "1 for the present state of the bench.",
    );
    for phase in PHASES {
        let is_now = f64::from(u8::from(phase == rig.phase));
        let name = phase.to_string().replace(' ', "_");
        page.value("leafbench_bench_state", &[("state", &name)], is_now);
    }
    let off_zero = f64::from(u8::from(!rig.off_zero.is_empty()));
    page.gauge(
        "leafbench_off_zero",
        "1 if the rig rests away from the tared zero.",
        off_zero,
    );
    if let Some(force_n) = rig.force_n {
        page.gauge(
            "leafbench_force_newtons",
            "Newest force from the tared zero.",
            force_n,
        );
    }
    if let Some(displacement_mm) = rig.displacement_mm {
        let what = "Newest displacement from the tared zero.";
        page.gauge("leafbench_displacement_meters", what, displacement_mm / 1000.0);
    }
}

/// Samples and frames.
fn samples(page: &mut MetricsPage, rig: &RigStatus) {
    let c = &rig.counters;
    let counters = [
        ("leafbench_samples_total", "Samples received.", c.samples),
        (
            "leafbench_samples_lost_total",
            "Samples missing according to the ticks of the rig.",
            c.lost,
        ),
        (
            "leafbench_samples_late_total",
            "Samples that the link delivered too late.",
            c.late,
        ),
        (
            "leafbench_samples_flagged_total",
            "Samples in which a channel gave no valid reading.",
            c.flagged,
        ),
        (
            "leafbench_emergencies_total",
            "Emergency frames of the rig.",
            c.emergencies,
        ),
        (
            "leafbench_late_polls_total",
            "Polls of the rig more than 5 ms after the one before.",
            c.late_polls,
        ),
    ];
    for (name, what, value) in counters {
        page.counter(name, what, value as f64);
    }
    page.family(
        "leafbench_frames_lost_total",
        "counter",
        "Frames that were not used, by reason.",
    );
    for (reason, count) in [
        ("refused", c.frames_refused),
        ("out_of_sequence", c.frames_out_of_sequence),
        ("receive_overflow", c.receive_overflows),
    ] {
        page.value("leafbench_frames_lost_total", &[("reason", reason)], count as f64);
    }
}

/// How late the turns of the control loop begin.
fn punctuality(page: &mut MetricsPage, health: &LoopHealth) {
    const NAME: &str = "leafbench_control_lateness_seconds";
    page.family(
        NAME,
        "histogram",
        "Delay of the turns of the control loop after their deadlines.",
    );
    let bucket = format!("{NAME}_bucket");
    let mut below = 0;
    for (bound_us, count) in LATENESS_BOUNDS_US.iter().zip(health.lateness.counts) {
        below += count;
        let bound = (*bound_us as f64 / 1e6).to_string();
        page.value(&bucket, &[("le", &bound)], below as f64);
    }
    page.value(&bucket, &[("le", "+Inf")], health.turns as f64);
    page.value(&format!("{NAME}_sum"), &[], health.sum_us as f64 / 1e6);
    page.value(&format!("{NAME}_count"), &[], health.turns as f64);
    page.gauge(
        "leafbench_control_worst_lateness_seconds",
        "Largest delay of a turn since the start of the daemon.",
        health.worst_lateness_us as f64 / 1e6,
    );
    page.counter(
        "leafbench_control_late_turns_total",
        "Turns of the control loop that began more than a millisecond late.",
        health.late_turns as f64,
    );
}

/// The link, and the bus behind it.
fn connection(page: &mut MetricsPage, rig: &RigStatus, health: &LinkHealth) {
    use std::sync::atomic::Ordering::Relaxed;
    let flag = |value: bool| f64::from(u8::from(value));
    page.gauge(
        "leafbench_link_open",
        "1 while the link is open.",
        flag(health.is_open()),
    );
    let passive = health.error_passive.load(Relaxed);
    page.gauge(
        "leafbench_can_error_passive",
        "1 while the CAN controller is error passive.",
        flag(passive),
    );
    let bus_off = health.bus_off.load(Relaxed) as f64;
    page.counter(
        "leafbench_can_bus_off_total",
        "Bus-off reports since the link was opened.",
        bus_off,
    );
    page.family(
        "leafbench_link_errors_total",
        "counter",
        "Errors of the link, by kind.",
    );
    for (kind, count) in [
        ("bus", rig.counters.bus_errors),
        ("send", rig.counters.send_failures),
        ("bad_packet", health.bad_packets.load(Relaxed)),
    ] {
        page.value("leafbench_link_errors_total", &[("kind", kind)], count as f64);
    }
}

/// The runs of this daemon.
fn runs(page: &mut MetricsPage, counts: &TallyCounts) {
    page.family(
        "leafbench_runs_total",
        "counter",
        "Runs of this daemon that are over, by result.",
    );
    for (result, count) in [
        ("completed", counts.completed),
        ("stopped", counts.stopped),
        ("aborted", counts.aborted),
    ] {
        page.value("leafbench_runs_total", &[("result", result)], count as f64);
    }
    let what = "Reports that the measurement left the band of the twin.";
    page.counter("leafbench_model_mismatches_total", what, counts.mismatches as f64);
    if let Some(error_n) = counts.twin_error_n {
        page.gauge(
            "leafbench_twin_error_newtons",
            "Root mean square of measured force less force of the twin, over the last second of the run.",
            error_n,
        );
    }
}

/// The text as it grows.
#[derive(Default)]
struct MetricsPage(String);

impl MetricsPage {
    /// The two lines before the figures of one name. Writing into a text does not fail.
    fn family(&mut self, name: &str, kind: &str, what: &str) {
        let _ = write!(self.0, "# HELP {name} {what}\n# TYPE {name} {kind}\n");
    }

    /// A line with one figure.
    fn value(&mut self, name: &str, labels: &[(&str, &str)], value: f64) {
        let labels: Vec<String> = labels
            .iter()
            .map(|(label, text)| format!("{label}=\"{}\"", escaped(text)))
            .collect();
        let labels = match labels.is_empty() {
            true => String::new(),
            false => format!("{{{}}}", labels.join(",")),
        };
        let _ = writeln!(self.0, "{name}{labels} {value}");
    }

    /// A figure that rises and falls.
    fn gauge(&mut self, name: &str, what: &str, value: f64) {
        self.family(name, "gauge", what);
        self.value(name, &[], value);
    }

    /// A figure that only rises until the daemon ends.
    fn counter(&mut self, name: &str, what: &str, value: f64) {
        self.family(name, "counter", what);
        self.value(name, &[], value);
    }
}

/// The text of a label as the format wants it.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\")
        .replace('"', "\\\"")
        .replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;

    use super::*;

    /// Names of the figures in a text, with those of a histogram's parts.
    fn names(text: &str) -> BTreeSet<&str> {
        let figures = text.lines().filter(|line| !line.starts_with('#'));
        figures.filter_map(|line| line.split(['{', ' ']).next()).collect()
    }

    /// The text with every figure that may be missing.
    fn full_text() -> String {
        let folder = tempfile::tempdir().expect("a folder");
        let state = DaemonState::without_rig(folder.path());
        state.disk.look(folder.path());
        let mut text = text(&state);
        let mut page = MetricsPage::default();
        let mut rig = RigStatus::unknown();
        (rig.force_n, rig.displacement_mm) = (Some(18.0), Some(0.3));
        bench(&mut page, &rig);
        runs(
            &mut page,
            &TallyCounts {
                twin_error_n: Some(3.0),
                ..TallyCounts::default()
            },
        );
        text += &page.0;
        text
    }

    /// promtool's rules: HELP and TYPE before the first figure of a name, a number after each name.
    #[test]
    fn every_figure_has_help_type_and_a_number() {
        let folder = tempfile::tempdir().expect("a folder");
        let state = DaemonState::without_rig(folder.path());
        let text = text(&state);
        let mut described = BTreeSet::new();
        for line in text.lines() {
            if let Some(rest) = line.strip_prefix("# TYPE ") {
                let (name, kind) = rest.split_once(' ').expect("name and kind");
                assert!(["gauge", "counter", "histogram"].contains(&kind), "{line}");
                assert_eq!(name.ends_with("_total"), kind == "counter", "{line}");
                assert!(described.insert(name.to_owned()), "{name} twice");
                continue;
            }
            if line.starts_with("# HELP ") {
                continue;
            }
            let (figure, value) = line.rsplit_once(' ').expect("a figure and its value");
            assert!(value.parse::<f64>().is_ok(), "{line}");
            let name = figure.split('{').next().unwrap_or_default();
            let family = ["_bucket", "_sum", "_count"]
                .iter()
                .find_map(|part| name.strip_suffix(part))
                .unwrap_or(name);
            assert!(described.contains(family), "{line}");
        }
        assert!(
            text.contains("leafbench_bench_state{state=\"connecting\"} 1\n"),
            "{text}"
        );
        assert!(
            text.contains("leafbench_bench_state{state=\"ready\"} 0\n"),
            "{text}"
        );
    }

    #[test]
    fn the_buckets_of_the_histogram_rise_to_the_number_of_turns() {
        let mut health = LoopHealth::default();
        for late_ns in [0, 60_000, 600_000, 7_000_000, 90_000_000] {
            health.note(late_ns);
        }
        let mut page = MetricsPage::default();
        punctuality(&mut page, &health);
        let counts: Vec<f64> = page
            .0
            .lines()
            .filter(|line| line.contains("_bucket{"))
            .filter_map(|line| line.rsplit_once(' ')?.1.parse().ok())
            .collect();
        assert!(counts.is_sorted(), "{counts:?}");
        assert_eq!((counts[0], counts[counts.len() - 1]), (1.0, 5.0), "{}", page.0);
        assert!(
            page.0
                .contains("leafbench_control_lateness_seconds_sum 0.09766\n"),
            "{}",
            page.0
        );
    }

    #[test]
    fn a_label_with_quotes_stays_one_label() {
        let mut page = MetricsPage::default();
        page.value("m", &[("bench", "a \"b\" \\ c\nd")], 1.5);
        assert_eq!(page.0, "m{bench=\"a \\\"b\\\" \\\\ c\\nd\"} 1.5\n");
    }

    #[test]
    fn the_dashboard_and_the_document_name_only_figures_that_are_served() {
        let served = full_text();
        let served = names(&served);
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        for file in ["packaging/grafana-dashboard.json", "docs/operations.md"] {
            let text = std::fs::read_to_string(root.join(file)).expect("in the repository");
            let is_of_a_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
            let named: BTreeSet<&str> = text
                .split(|c| !is_of_a_name(c))
                .filter(|word| word.starts_with("leafbench_"))
                .collect();
            assert!(named.len() > 10, "{file}: {named:?}");
            let histogram = "leafbench_control_lateness_seconds";
            let missing: Vec<_> = named
                .iter()
                .filter(|name| **name != histogram && !served.contains(*name))
                .collect();
            assert!(missing.is_empty(), "{file}: {missing:?} are not served");
        }
        let document = std::fs::read_to_string(root.join("docs/operations.md")).expect("in the repository");
        for name in served {
            let family = ["_bucket", "_sum", "_count"]
                .iter()
                .find_map(|part| name.strip_suffix(part));
            let name = family.unwrap_or(name);
            assert!(
                document.contains(&format!("`{name}`")),
                "{name} is not in docs/operations.md"
            );
        }
        let dashboard =
            std::fs::read_to_string(root.join("packaging/grafana-dashboard.json")).expect("there");
        let dashboard: serde_json::Value = serde_json::from_str(&dashboard).expect("JSON");
        assert!(
            dashboard["panels"]
                .as_array()
                .is_some_and(|panels| panels.len() >= 8)
        );
    }
}
