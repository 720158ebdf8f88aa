//! The faults that the mock rig can play, and when: `NAME=AMOUNT@FROM..TO`. A new fault is one line in [`FAULTS`], and one in
//! the table of `docs/faults.md`.

use serde::Deserialize;

use super::Injection;
use crate::nearest;
use crate::protocol::tick::{TICK_S, TICKS_PER_S};

/// Number of a fault: what it is if it is not given, and what it may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Amount {
    /// Amount of a fault that is written without one.
    pub default: f64,
    /// Smallest and largest amount.
    pub range: [f64; 2],
    /// Unit of the amount; `-` for a pure number.
    pub unit: &'static str,
}

/// One kind of fault.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FaultKind {
    /// Name in `--fault` and in a bench file.
    pub name: &'static str,
    /// Its amount, if it has one.
    pub amount: Option<Amount>,
    /// It happens once at its begin, unless an end is given.
    pub once: bool,
    /// What happens, as a sentence without subject or point.
    pub what: &'static str,
    inject: fn(&mut Injection, f64),
}

const fn amount(default: f64, low: f64, high: f64, unit: &'static str) -> Option<Amount> {
    Some(Amount {
        default,
        range: [low, high],
        unit,
    })
}

/// Share of the frames.
const SHARE: Option<Amount> = amount(1.0, 0.0, 1.0, "-");
/// Share of the frames, of a fault that spoils the link.
const SOME: Option<Amount> = amount(0.1, 0.0, 1.0, "-");

const fn fault(
    name: &'static str,
    amount: Option<Amount>,
    inject: fn(&mut Injection, f64),
    what: &'static str,
) -> FaultKind {
    FaultKind {
        name,
        amount,
        once: false,
        what,
        inject,
    }
}

const fn once(
    name: &'static str,
    amount: Option<Amount>,
    inject: fn(&mut Injection, f64),
    what: &'static str,
) -> FaultKind {
    FaultKind {
        name,
        amount,
        once: true,
        what,
        inject,
    }
}

/// All faults, by place and name.
#[rustfmt::skip]
pub(crate) const FAULTS: &[FaultKind] = &[
    // Link
    fault("sample-lost", SHARE, |i, v| i.wire.sample_lost = v, "this share of the samples is lost"),
    fault("status-lost", SHARE, |i, v| i.wire.status_lost = v, "this share of the status frames is lost"),
    fault("emergency-lost", SHARE, |i, v| i.wire.emergency_lost = v, "this share of the emergency frames is lost"),
    fault("lease-lost", SHARE, |i, v| i.wire.lease_lost = v, "this share of the leases is lost"),
    fault("command-lost", SHARE, |i, v| i.wire.command_lost = v, "this share of the commands is lost"),
    fault("request-lost", SHARE, |i, v| i.wire.request_lost = v, "this share of the requests is lost, so that none is acknowledged"),
    fault("abort-lost", SHARE, |i, v| i.wire.abort_lost = v, "this share of the NMT frames is lost"),
    fault("link-silent", None, |i, _| i.wire.silent = true, "no frame passes in either direction"),
    fault("frame-corrupt", SOME, |i, v| i.wire.corrupt = v, "one bit changes in this share of the frames to the host"),
    fault("host-frame-corrupt", SOME, |i, v| i.wire.host_corrupt = v, "one bit changes in this share of the frames to the rig"),
    fault("frame-repeated", SOME, |i, v| i.wire.repeated = v, "this share of the frames to the host arrives twice"),
    fault("frame-reordered", SOME, |i, v| i.wire.reordered = v, "this share of the frames to the host arrives after the next one"),
    fault("frame-late", amount(50.0, 1.0, 1000.0, "ms"), |i, v| i.wire.late_ms = v, "frames to the host arrive late; the delay grows by 1 ms in each 3 ms, up to this"),
    fault("second-host", None, |i, _| i.wire.second_host = true, "another host sends a lease of its own each 10 ms"),
    fault("second-rig", None, |i, _| i.wire.second_rig = true, "another rig with this node sends samples"),
    // Sensors
    fault("force-open", None, |i, _| i.force_open = true, "the load cell gives no valid reading"),
    fault("displacement-open", None, |i, _| i.displacement_open = true, "the LVDT gives no valid reading"),
    fault("force-stuck", None, |i, _| i.force_frozen = true, "the reading of the load cell no longer changes"),
    fault("displacement-stuck", None, |i, _| i.displacement_frozen = true, "the reading of the LVDT no longer changes"),
    once("force-spike", amount(1000.0, -20_000.0, 20_000.0, "N"), |i, v| i.force_spike_n = v, "one sample of the load cell is off by this; with an end, one sample each 25 ms"),
    once("displacement-spike", amount(5.0, -100.0, 100.0, "mm"), |i, v| i.displacement_spike_mm = v, "one sample of the LVDT is off by this; with an end, one sample each 25 ms"),
    fault("force-noise", amount(10.0, 1.0, 1000.0, "-"), |i, v| i.force_noise = v - 1.0, "the noise of the load cell is this many times as high"),
    fault("displacement-noise", amount(10.0, 1.0, 1000.0, "-"), |i, v| i.displacement_noise = v - 1.0, "the noise of the LVDT is this many times as high"),
    fault("force-gain", amount(1.2, 0.1, 100.0, "-"), |i, v| i.force_gain_error = v - 1.0, "the load cell reads this many times the force"),
    fault("displacement-gain", amount(1.2, 0.1, 100.0, "-"), |i, v| i.displacement_gain_error = v - 1.0, "the LVDT reads this many times the displacement"),
    fault("force-zero", amount(100.0, -10_000.0, 10_000.0, "N"), |i, v| i.force_offset_n = v, "the zero of the load cell is off by this"),
    fault("force-sign", None, |i, _| i.force_inverted = true, "the sign of the load cell is inverted"),
    fault("displacement-sign", None, |i, _| i.displacement_inverted = true, "the sign of the LVDT is inverted"),
    // Firmware
    fault("firmware-hang", None, |i, _| i.firmware_hangs = true, "the firmware stands still"),
    once("firmware-reboot", None, |i, _| i.firmware_reboots = true, "the firmware restarts"),
    fault("limits-ignored", None, |i, _| i.limits_ignored = true, "the firmware enforces no limit and finds no fault of a sensor"),
    // Rig and specimen
    fault("valve-stuck", None, |i, _| i.valve_stuck = true, "the servo valve does not move"),
    fault("leak", amount(30.0, 0.0, 300.0, "mm/s"), |i, v| i.leak_mm_s = v, "oil leaks: the piston retracts at this speed with the valve closed"),
    fault("supply-lost", None, |i, _| i.supply_lost = true, "the supply pressure fails"),
    fault("emergency-stop", None, |i, _| i.emergency_stop = true, "the emergency stop is pressed"),
    fault("specimen-break", None, |i, _| i.specimen_broken = true, "the specimen carries no load"),
    fault("specimen-stiff", amount(2.0, 0.1, 100.0, "-"), |i, v| i.specimen_stiffer = v - 1.0, "the specimen gives this many times its force"),
];

/// Why a fault is not understood.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum FaultError {
    /// The text has no `@`, or a time is no time.
    #[error(
        "the fault \"{text}\" is not understood: write NAME@FROM..TO or NAME=AMOUNT@FROM..TO, with times such as 3s, 250ms or run+3s"
    )]
    Form {
        /// The fault as it was written.
        text: String,
    },
    /// No fault has this name.
    #[error("there is no fault \"{name}\"{}: choose one of {known}", nearest::question(meant.as_deref()))]
    Unknown {
        /// The name as it was written.
        name: String,
        /// The name that is probably meant.
        meant: Option<String>,
        /// Names of all faults.
        known: String,
    },
    /// The fault has no amount, or it is out of range.
    #[error("the amount of the fault \"{name}\" is {given}: {allowed}")]
    Amount {
        /// Name of the fault.
        name: &'static str,
        /// The amount as it was written.
        given: String,
        /// What is allowed.
        allowed: String,
    },
    /// The fault ends before it begins.
    #[error("the fault \"{text}\" ends before it begins: exchange its times")]
    Order {
        /// The fault as it was written.
        text: String,
    },
}

/// From which moment the times of a fault count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Since {
    /// The start of the mock rig.
    Start,
    /// The newest begin of a motion: the fault comes again in each run.
    Run,
}

/// A fault with its time, in ticks.
#[derive(Debug, Clone, Copy)]
struct TimedFault {
    fault: &'static FaultKind,
    amount: f64,
    since: Since,
    from: u64,
    /// The first tick without the fault; none where it stays.
    to: Option<u64>,
}

impl TimedFault {
    fn parse(text: &str) -> Result<TimedFault, FaultError> {
        let form = || FaultError::Form {
            text: text.to_owned(),
        };
        let (what, when) = text.split_once('@').ok_or_else(form)?;
        let (name, given) = match what.split_once('=') {
            Some((name, given)) => (name.trim(), Some(given.trim())),
            None => (what.trim(), None),
        };
        let fault = find(name)?;
        let amount = amount_of(fault, given)?;
        let (since, when) = match when.trim().strip_prefix("run+") {
            Some(rest) => (Since::Run, rest),
            None => (Since::Start, when.trim()),
        };
        let (from, to) = match when.split_once("..") {
            Some((from, to)) => (from, Some(to)),
            None => (when, None),
        };
        let from = ticks(from).ok_or_else(form)?;
        let to = to.map(|to| ticks(to).ok_or_else(form)).transpose()?;
        if to.is_some_and(|to| to <= from) {
            return Err(FaultError::Order {
                text: text.to_owned(),
            });
        }
        let to = to.or(fault.once.then_some(from + 1));
        Ok(TimedFault {
            fault,
            amount,
            since,
            from,
            to,
        })
    }

    fn is_on(&self, tick: u64, run_tick: Option<u64>) -> bool {
        let now = match self.since {
            Since::Start => Some(tick),
            Since::Run => run_tick,
        };
        now.is_some_and(|now| now >= self.from && self.to.is_none_or(|to| now < to))
    }
}

/// The fault of a name.
fn find(name: &str) -> Result<&'static FaultKind, FaultError> {
    FAULTS.iter().find(|fault| fault.name == name).ok_or_else(|| {
        let names: Vec<&str> = FAULTS.iter().map(|fault| fault.name).collect();
        FaultError::Unknown {
            name: name.to_owned(),
            meant: nearest::name(name, &names).map(str::to_owned),
            known: names.join(", "),
        }
    })
}

fn amount_of(fault: &'static FaultKind, given: Option<&str>) -> Result<f64, FaultError> {
    let wrong = |given: &str, allowed: String| FaultError::Amount {
        name: fault.name,
        given: given.to_owned(),
        allowed,
    };
    match (fault.amount, given) {
        (None, None) => Ok(0.0),
        (None, Some(given)) => Err(wrong(given, "this fault has no amount, leave it out".to_owned())),
        (Some(amount), None) => Ok(amount.default),
        (Some(amount), Some(given)) => {
            let [low, high] = amount.range;
            let value = given
                .parse::<f64>()
                .ok()
                .filter(|value| (low..=high).contains(value));
            let unit = if amount.unit == "-" {
                String::new()
            } else {
                format!(" {}", amount.unit)
            };
            value.ok_or_else(|| wrong(given, format!("set it to {low} to {high}{unit}")))
        }
    }
}

/// `3s`, `1.5s` or `250ms` in ticks.
fn ticks(text: &str) -> Option<u64> {
    let text = text.trim();
    let (number, unit_s) = match text.strip_suffix("ms") {
        Some(number) => (number, 1e-3),
        None => (text.strip_suffix('s')?, 1.0),
    };
    let seconds = number.trim().parse::<f64>().ok()? * unit_s;
    (0.0..=1e6)
        .contains(&seconds)
        .then(|| (seconds * TICKS_PER_S).round() as u64)
}

/// The faults of a mock rig with their times.
#[derive(Debug, Clone, Default)]
pub(crate) struct FaultSchedule(Vec<TimedFault>);

/// A file of faults, as `--faults` reads it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FaultFile {
    faults: Vec<String>,
}

impl FaultSchedule {
    /// The schedule of faults that are written as `NAME=AMOUNT@FROM..TO`.
    pub(crate) fn parse<S: AsRef<str>>(texts: &[S]) -> Result<FaultSchedule, FaultError> {
        let timed: Result<Vec<TimedFault>, FaultError> = texts
            .iter()
            .map(|text| TimedFault::parse(text.as_ref()))
            .collect();
        Ok(FaultSchedule(timed?))
    }

    /// True if it has no fault at all.
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// What is injected at `tick` since the start of the rig and `run_tick` since the newest begin of a motion.
    pub(super) fn injection(&self, tick: u64, run_tick: Option<u64>) -> Injection {
        let mut injection = Injection::default();
        for timed in self.0.iter().filter(|timed| timed.is_on(tick, run_tick)) {
            (timed.fault.inject)(&mut injection, timed.amount);
        }
        injection
    }
}

/// The faults of a file with the one key `faults`. The error says what is wrong, with the line where it is known.
pub(crate) fn read_faults(text: &str) -> Result<Vec<String>, String> {
    let file: FaultFile = toml::from_str(text).map_err(|error| error.to_string().trim_end().to_owned())?;
    Ok(file.faults)
}

/// A line for each fault: name, default amount with its range, what happens.
pub(crate) fn list_of_faults() -> String {
    let line = |fault: &FaultKind| match fault.amount {
        None => format!("  {:20} {}", fault.name, fault.what),
        Some(Amount {
            default,
            range: [low, high],
            unit,
        }) => {
            let unit = if unit == "-" {
                String::new()
            } else {
                format!(" {unit}")
            };
            format!(
                "  {:20} {} [default: {default}{unit}, {low} to {high}]",
                fault.name, fault.what
            )
        }
    };
    FAULTS.iter().map(line).collect::<Vec<_>>().join("\n")
}

/// Ticks between two spikes of a fault that lasts: 25 ms, so that four lie within 100 ms.
pub(super) const SPIKE_TICKS: u64 = (0.025 / TICK_S) as u64;

#[cfg(test)]
mod tests {
    use super::*;

    fn schedule(texts: &[&str]) -> FaultSchedule {
        FaultSchedule::parse(texts).expect("understood")
    }

    #[test]
    fn a_fault_is_on_between_its_times() {
        let schedule = schedule(&["status-lost=0.5@3s..8s", "valve-stuck@250ms"]);
        let at = |tick| schedule.injection(tick, None);
        assert_eq!((at(2999).wire.status_lost, at(3000).wire.status_lost), (0.0, 0.5));
        assert_eq!((at(7999).wire.status_lost, at(8000).wire.status_lost), (0.5, 0.0));
        assert!(!at(249).valve_stuck && at(250).valve_stuck && at(1_000_000).valve_stuck);
    }

    #[test]
    fn times_of_a_run_count_from_the_begin_of_its_motion() {
        let schedule = schedule(&["force-open@run+1s..2s"]);
        assert!(!schedule.injection(1500, None).force_open);
        assert!(schedule.injection(90_000, Some(1500)).force_open);
        assert!(!schedule.injection(1500, Some(2000)).force_open);
    }

    #[test]
    fn a_spike_or_a_reboot_happens_once() {
        let schedule = schedule(&["force-spike@1s", "firmware-reboot@2s"]);
        let spikes = (0..5000).filter(|&tick| schedule.injection(tick, None).force_spike_n != 0.0);
        assert_eq!(spikes.collect::<Vec<_>>(), [1000]);
        let reboots = (0..5000).filter(|&tick| schedule.injection(tick, None).firmware_reboots);
        assert_eq!(reboots.collect::<Vec<_>>(), [2000]);
    }

    #[test]
    fn every_fault_changes_something_and_its_default_is_in_its_range() {
        for fault in FAULTS {
            let injection = schedule(&[&format!("{}@0s", fault.name)]).injection(0, None);
            assert_ne!(injection, Injection::default(), "{}", fault.name);
            if let Some(amount) = fault.amount {
                let [low, high] = amount.range;
                assert!((low..=high).contains(&amount.default), "{}", fault.name);
            }
            let same = FAULTS.iter().filter(|other| other.name == fault.name).count();
            assert_eq!(same, 1, "{}", fault.name);
        }
    }

    #[test]
    fn mistakes_are_told_with_the_nearest_name() {
        let said = |text: &str| FaultSchedule::parse(&[text]).expect_err("refused").to_string();
        assert!(
            said("status-lots@3s").contains("did you mean status-lost?"),
            "{}",
            said("status-lots@3s")
        );
        assert!(said("status-lost").contains("write NAME@FROM..TO"));
        assert!(said("status-lost@3").contains("3s, 250ms or run+3s"));
        assert!(said("status-lost@-3s").contains("write NAME@FROM..TO"));
        assert!(said("status-lost@8s..3s").contains("ends before it begins"));
        assert!(
            said("status-lost=2@3s").contains("set it to 0 to 1"),
            "{}",
            said("status-lost=2@3s")
        );
        assert!(said("status-lost=nan@3s").contains("set it to 0 to 1"));
        assert!(said("leak=1e9@3s").contains("0 to 300 mm/s"));
        assert!(said("valve-stuck=1@3s").contains("has no amount"));
    }

    #[test]
    fn a_file_of_faults_is_read_and_its_mistakes_have_a_line() {
        let faults = read_faults("faults = [\"leak@1s\", \"e-stop@2s\"]").expect("a list");
        assert_eq!(faults, ["leak@1s", "e-stop@2s"]);
        let error = read_faults("fault = []").expect_err("another key");
        assert!(error.contains("line 1"), "{error}");
    }
}
