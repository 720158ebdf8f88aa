//! The link to the rig, and what the bench file says of its sensors.
//!
//! Presence and kind of a CAN interface are files below `/sys`; its bit rate and state come from `ip -details -json link show`
//! (package iproute2), which asks the kernel over netlink.

use std::path::Path;
use std::process::Command;

use jiff::ToSpan;
use jiff::civil::Date;
use nix::errno::Errno;
use nix::unistd::{AccessFlags, access};
use serde_json::Value;

use super::finding::{DoctorFinding, SystemRoot, has_capability};
use crate::config::Bench;
use crate::link::{self, CAN_RECEIVE_BUFFER_BYTES};

/// Bit rate of the protocol on CAN, bit/s (firmware-protocol.md, chapter 11).
const BIT_RATE: u64 = 1_000_000;
/// Kind of a CAN interface in `/sys/class/net/NAME/type`.
const CAN_KIND: &str = "280";
/// Bit of the capability CAP_NET_ADMIN in `CapEff`.
const CAP_NET_ADMIN: u32 = 12;
/// Largest wait of an FTDI adapter before it delivers what it has, ms.
const LATENCY_MAX_MS: i64 = 1;
/// A calibration that is due within this time is reported, days.
const DUE_SOON_DAYS: i32 = 30;

/// All findings on the link of this address.
pub(super) fn link(root: &SystemRoot, address: &str) -> Vec<DoctorFinding> {
    if !link::is_address(address) {
        return vec![
            DoctorFinding::problem(
                "link",
                format!("\"{address}\" is no address of a link"),
                format!("write one of {}", link::address_forms()),
            )
            .at("--link, or [link] address of the bench file"),
        ];
    }
    match address.split_once(':') {
        Some(("can", name)) => can(root, name, ask_ip(name).as_deref()),
        Some(("serial", port)) => serial(root, port.split('?').next().unwrap_or(port)),
        _ => vec![DoctorFinding::ok("link", "the mock rig in memory needs no port")],
    }
}

/// What `ip` says of an interface; `None` if there is no `ip` or no such interface.
fn ask_ip(name: &str) -> Option<String> {
    let mut ip = Command::new("ip");
    let output = ip
        .args(["-details", "-json", "link", "show", "dev", name])
        .output();
    let output = output.ok().filter(|output| output.status.success())?;
    String::from_utf8(output.stdout).ok()
}

/// The CAN interface: is it there, is it up, bit rate and state.
fn can(root: &SystemRoot, name: &str, ip: Option<&str>) -> Vec<DoctorFinding> {
    const SUBJECT: &str = "CAN interface";
    let folder = format!("/sys/class/net/{name}");
    let Some(kind) = root.text(&format!("{folder}/type")) else {
        let loaded = root.has("/sys/module/can_raw") || root.has("/proc/net/can");
        let to_do = match loaded {
            true => "plug the adapter in and look for its name with `ip link`",
            false => {
                "this kernel has no CAN yet: run `sudo modprobe can-raw`, plug the adapter in, and look for its name with `ip link`"
            }
        };
        return vec![
            DoctorFinding::problem(SUBJECT, format!("there is no interface {name}"), to_do).at(folder),
        ];
    };
    if kind != CAN_KIND {
        let what = format!("{name} is no CAN interface (kind {kind}, not {CAN_KIND})");
        return vec![
            DoctorFinding::problem(SUBJECT, what, "name a CAN interface of `ip link show type can`")
                .at(folder),
        ];
    }
    let flags = root.text(&format!("{folder}/flags")).unwrap_or_default();
    let flags = u32::from_str_radix(flags.trim_start_matches("0x"), 16).unwrap_or(0);
    let up = match flags & 1 {
        1 => DoctorFinding::ok(SUBJECT, format!("{name} is there and up")),
        _ => DoctorFinding::problem(
            SUBJECT,
            format!("{name} is down"),
            format!(
                "run `sudo ip link set {name} up type can bitrate {BIT_RATE} sample-point 0.8 restart-ms 0`"
            ),
        ),
    };
    let mut findings = vec![up.at(folder)];
    findings.extend(bus(name, ip));
    findings.push(buffer(root));
    findings
}

/// Whether the kernel gives the CAN socket the receive buffer that bridges a long stall of this computer.
fn buffer(root: &SystemRoot) -> DoctorFinding {
    const SUBJECT: &str = "CAN buffer";
    const FILE: &str = "/proc/sys/net/core/rmem_max";
    let granted = root.number(FILE).unwrap_or(0);
    let status = root.text("/proc/self/status").unwrap_or_default();
    if granted >= CAN_RECEIVE_BUFFER_BYTES as i64 {
        return DoctorFinding::ok(SUBJECT, format!("up to {granted} bytes")).at(FILE);
    }
    if has_capability(&status, CAP_NET_ADMIN) {
        return DoctorFinding::ok(SUBJECT, "not limited for CAP_NET_ADMIN").at("/proc/self/status");
    }
    DoctorFinding::warning(
        SUBJECT,
        format!("at most {granted} bytes: a stall of this computer of some 0.1 s loses samples"),
        format!("run `sudo sysctl -w net.core.rmem_max={CAN_RECEIVE_BUFFER_BYTES}`, or install packaging/60-leafbench.conf in /etc/sysctl.d"),
    )
    .at(FILE)
}

/// Bit rate, state and restart of the bus, as `ip` reports them.
fn bus(name: &str, ip: Option<&str>) -> Vec<DoctorFinding> {
    let place = format!("ip -details link show {name}");
    let report: Option<Value> = ip.and_then(|text| serde_json::from_str(text).ok());
    let Some(report) = report else {
        let to_do = "install the package iproute2, then check bit rate and state by hand";
        let what = "bit rate and state are not known, because `ip` does not answer";
        return vec![DoctorFinding::warning("CAN bit rate", what, to_do).at(place)];
    };
    let info = &report[0]["linkinfo"];
    if info["info_kind"] != "can" {
        let kind = info["info_kind"].as_str().unwrap_or("unknown");
        let what = format!("{name} is virtual ({kind}): it has no bit rate, no state and no wire");
        return vec![DoctorFinding::ok("CAN bit rate", what).at(place)];
    }
    let data = &info["info_data"];
    let findings = [bit_rate(name, data), bus_state(name, data), restart(name, data)];
    findings.into_iter().map(|finding| finding.at(&place)).collect()
}

fn bit_rate(name: &str, data: &Value) -> DoctorFinding {
    match data["bittiming"]["bitrate"].as_u64() {
        Some(BIT_RATE) => DoctorFinding::ok("CAN bit rate", "1 Mbit/s"),
        other => DoctorFinding::problem(
            "CAN bit rate",
            match other {
                Some(rate) => format!("{rate} bit/s, and the protocol needs {BIT_RATE}"),
                None => "not set".to_owned(),
            },
            format!(
                "run `sudo ip link set {name} down`, then `sudo ip link set {name} up type can bitrate {BIT_RATE} sample-point 0.8 \
                 restart-ms 0`"
            ),
        ),
    }
}

fn bus_state(name: &str, data: &Value) -> DoctorFinding {
    const SUBJECT: &str = "CAN state";
    let wiring =
        "check power of the rig, bit rate, wiring, and 60 ohm between CAN_H and CAN_L with the power off";
    let errors = |key: &str| data["berr_counter"][key].as_u64().unwrap_or(0);
    let counters = format!("error counters: {} sent, {} received", errors("tx"), errors("rx"));
    match data["state"].as_str().unwrap_or("unknown") {
        "ERROR-ACTIVE" => DoctorFinding::ok(SUBJECT, format!("error active, as it should be; {counters}")),
        "BUS-OFF" => DoctorFinding::problem(
            SUBJECT,
            format!("bus-off: the adapter has given up; {counters}"),
            format!("{wiring}; then run `sudo ip link set {name} down` and `sudo ip link set {name} up`"),
        ),
        "STOPPED" => DoctorFinding::problem(
            SUBJECT,
            "stopped: the interface is down",
            format!("run `sudo ip link set {name} up`"),
        ),
        state @ ("ERROR-WARNING" | "ERROR-PASSIVE") => DoctorFinding::problem(
            SUBJECT,
            format!("{}; {counters}", state.to_lowercase().replace('-', " ")),
            wiring,
        ),
        other => DoctorFinding::warning(SUBJECT, format!("\"{other}\"; {counters}"), wiring),
    }
}

fn restart(name: &str, data: &Value) -> DoctorFinding {
    match data["restart_ms"].as_u64().unwrap_or(0) {
        0 => DoctorFinding::ok("CAN restart", "no automatic restart, so a bus-off is seen"),
        ms => DoctorFinding::warning(
            "CAN restart",
            format!("the adapter restarts {ms} ms after a bus-off by itself, which hides the fault"),
            format!(
                "run `sudo ip link set {name} down`, then `sudo ip link set {name} up type can restart-ms 0`"
            ),
        ),
    }
}

/// The serial port: is it there, may this user open it, does its adapter deliver at once.
fn serial(root: &SystemRoot, port: &str) -> Vec<DoctorFinding> {
    let path = root.path(port);
    let allowed = access(&path, AccessFlags::R_OK | AccessFlags::W_OK);
    let mut findings = vec![serial_access(port, allowed)];
    // The stable name is a link to the device, whose own name the kernel uses below /sys.
    let device = path.canonicalize().ok();
    let device = device
        .as_deref()
        .and_then(Path::file_name)
        .and_then(|name| name.to_str());
    if let Some(device) = device {
        let file = format!("/sys/bus/usb-serial/devices/{device}/latency_timer");
        findings.extend(root.number(&file).map(|ms| latency(ms, &file)));
        findings.extend(stable_name(root, port, device));
    }
    findings
}

fn serial_access(port: &str, allowed: Result<(), Errno>) -> DoctorFinding {
    const SUBJECT: &str = "serial port";
    match allowed {
        Ok(()) => DoctorFinding::ok(SUBJECT, "this user may open it").at(port),
        Err(Errno::ENOENT) => DoctorFinding::problem(
            SUBJECT,
            "there is no such port",
            "plug the adapter in and list the ports with `ls -l /dev/serial/by-id`",
        )
        .at(port),
        Err(errno) => DoctorFinding::problem(
            SUBJECT,
            format!("this user may not open it ({})", errno.desc()),
            "add the user to the group of the port, then log in again: `sudo usermod -aG dialout USER`",
        )
        .at(port),
    }
}

fn latency(ms: i64, file: &str) -> DoctorFinding {
    if ms <= LATENCY_MAX_MS {
        return DoctorFinding::ok("serial latency", format!("{ms} ms")).at(file);
    }
    DoctorFinding::warning(
        "serial latency",
        format!("the adapter keeps data back for up to {ms} ms: samples come in lumps and faults are seen later"),
        format!("run `echo 1 | sudo tee {file}`, or install the udev rule packaging/99-leafbench.rules, which the Debian package has"),
    )
    .at(file)
}

/// A name that stays the same when the adapter is plugged in again, if the port was given by another one.
fn stable_name(root: &SystemRoot, port: &str, device: &str) -> Option<DoctorFinding> {
    const NAMES: &str = "/dev/serial/by-id";
    if port.starts_with(NAMES) {
        return None;
    }
    let names = std::fs::read_dir(root.path(NAMES)).ok()?;
    let same = names.filter_map(|name| Some(name.ok()?.path())).find(|name| {
        let target = std::fs::read_link(name).ok();
        target
            .as_deref()
            .and_then(Path::file_name)
            .is_some_and(|target| target == device)
    })?;
    let name = same.file_name()?.to_string_lossy().into_owned();
    Some(
        DoctorFinding::warning(
            "serial name",
            format!("{port} may be another adapter after the next restart"),
            format!("write serial:{NAMES}/{name} in the bench file"),
        )
        .at(port),
    )
}

/// Whether the calibrations of the bench file hold today.
pub(super) fn calibrations(bench: &Bench, today: Date) -> Vec<DoctorFinding> {
    let (force, displacement) = (&bench.force_channel, &bench.displacement_channel);
    let channels = [
        ("load cell", &force.certificate, &force.due),
        ("LVDT", &displacement.certificate, &displacement.due),
    ];
    let checked = channels.into_iter().map(|(sensor, certificate, due)| {
        let finding = calibration(sensor, certificate, due, today);
        finding.at(format!("bench {}", bench.name))
    });
    checked.collect()
}

fn calibration(sensor: &str, certificate: &str, due: &str, today: Date) -> DoctorFinding {
    const SUBJECT: &str = "calibration";
    let what = format!("{sensor}, certificate {certificate}, due on {due}");
    let to_do = "have it calibrated, and write certificate, date and constants to the bench file";
    let soon = today.saturating_add(DUE_SOON_DAYS.days());
    // The config has checked that the text is a date.
    match due.parse::<Date>() {
        Ok(due) if due < today => {
            DoctorFinding::problem(SUBJECT, format!("overdue: {what}; runs are refused"), to_do)
        }
        Ok(due) if due < soon => DoctorFinding::warning(SUBJECT, format!("due soon: {what}"), to_do),
        Ok(_) => DoctorFinding::ok(SUBJECT, what),
        Err(_) => DoctorFinding::problem(SUBJECT, format!("no date: {what}"), "write due = \"YYYY-MM-DD\""),
    }
}

#[cfg(test)]
mod tests {
    use super::super::finding::Grade;
    use super::*;

    /// A computer with these files.
    fn computer(files: &[(&str, &str)]) -> (tempfile::TempDir, SystemRoot) {
        let folder = tempfile::tempdir().expect("a folder");
        for (file, text) in files {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().expect("a folder")).expect("made");
            std::fs::write(path, text).expect("written");
        }
        let root = SystemRoot::faked(folder.path());
        (folder, root)
    }

    fn grades(findings: &[DoctorFinding]) -> Vec<(&str, Grade)> {
        findings.iter().map(|f| (f.subject, f.grade)).collect()
    }

    /// What iproute2 6.1 prints of a CAN interface, without the keys that are not read.
    fn of_ip(state: &str, rate: u64, restart_ms: u64) -> String {
        serde_json::json!([{
            "ifname": "can0", "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"], "link_type": "can",
            "linkinfo": { "info_kind": "can", "info_data": {
                "state": state, "berr_counter": { "tx": 128, "rx": 3 }, "restart_ms": restart_ms,
                "bittiming": { "bitrate": rate, "sample_point": "0.800" } } }
        }])
        .to_string()
    }

    #[test]
    fn a_can_interface_that_is_up_at_1_mbit_and_error_active_is_well() {
        let (_folder, root) = computer(&[
            ("sys/class/net/can0/type", "280\n"),
            ("sys/class/net/can0/flags", "0x40081\n"),
            ("proc/sys/net/core/rmem_max", "8388608\n"),
        ]);
        let found = can(&root, "can0", Some(&of_ip("ERROR-ACTIVE", 1_000_000, 0)));
        assert!(found.iter().all(|f| f.grade == Grade::Ok), "{found:?}");
        assert_eq!(found.len(), 5);
    }

    #[test]
    fn every_fault_of_the_can_bus_is_a_finding_of_its_own() {
        let (_folder, root) = computer(&[
            ("sys/class/net/can0/type", "280\n"),
            ("sys/class/net/can0/flags", "0x40080\n"),
            ("sys/class/net/eth0/type", "1\n"),
        ]);
        let found = can(&root, "can0", Some(&of_ip("BUS-OFF", 500_000, 100)));
        assert_eq!(
            grades(&found),
            [
                ("CAN interface", Grade::Problem),
                ("CAN bit rate", Grade::Problem),
                ("CAN state", Grade::Problem),
                ("CAN restart", Grade::Warning),
                ("CAN buffer", Grade::Warning),
            ]
        );
        assert!(found[2].what.contains("128 sent, 3 received"), "{:?}", found[2]);
        for (state, grade) in [("ERROR-PASSIVE", Grade::Problem), ("SLEEPING", Grade::Warning)] {
            let found = can(&root, "can0", Some(&of_ip(state, 1_000_000, 0)));
            assert_eq!(found[2].grade, grade, "{state}");
        }
        assert_eq!(
            grades(&can(&root, "can0", None))[1],
            ("CAN bit rate", Grade::Warning)
        );
        for name in ["can7", "eth0"] {
            assert_eq!(
                grades(&can(&root, name, None)),
                [("CAN interface", Grade::Problem)],
                "{name}"
            );
        }
    }

    #[test]
    fn a_virtual_interface_has_no_bit_rate_and_that_is_well() {
        let (_folder, root) = computer(&[
            ("sys/class/net/vcan0/type", "280\n"),
            ("sys/class/net/vcan0/flags", "0xc1\n"),
            ("proc/sys/net/core/rmem_max", "212992\n"),
            ("proc/self/status", "CapEff:\t000001ffffffffff\n"),
        ]);
        let ip = r#"[{"ifname":"vcan0","link_type":"can","linkinfo":{"info_kind":"vcan"}}]"#;
        let found = can(&root, "vcan0", Some(ip));
        assert!(found.iter().all(|f| f.grade == Grade::Ok), "{found:?}");
    }

    #[test]
    fn a_slow_adapter_and_a_name_that_may_change_are_warnings() {
        let (folder, root) = computer(&[
            ("dev/ttyUSB0", ""),
            ("sys/bus/usb-serial/devices/ttyUSB0/latency_timer", "16\n"),
            ("dev/serial/by-id/note", ""),
        ]);
        std::os::unix::fs::symlink("../../ttyUSB0", folder.path().join("dev/serial/by-id/usb-FTDI_1"))
            .expect("linked");
        let found = serial(&root, "/dev/ttyUSB0");
        assert_eq!(
            grades(&found),
            [
                ("serial port", Grade::Ok),
                ("serial latency", Grade::Warning),
                ("serial name", Grade::Warning),
            ]
        );
        assert!(
            found[2]
                .what_to_do
                .contains("serial:/dev/serial/by-id/usb-FTDI_1")
        );
        let found = serial(&root, "/dev/serial/by-id/usb-FTDI_1");
        assert_eq!(grades(&found).len(), 2, "the kernel's name is found: {found:?}");
        assert_eq!(latency(1, "").grade, Grade::Ok);
    }

    #[test]
    fn a_port_that_is_not_there_and_one_that_is_forbidden_need_different_things() {
        let (_folder, root) = computer(&[]);
        let found = serial(&root, "/dev/ttyUSB9");
        assert!(found[0].what.contains("no such port"), "{found:?}");
        let forbidden = serial_access("/dev/ttyUSB0", Err(Errno::EACCES));
        assert!(forbidden.what_to_do.contains("dialout"), "{forbidden:?}");
    }

    #[test]
    fn an_address_without_a_scheme_is_a_problem_and_the_mock_rig_needs_no_port() {
        let root = SystemRoot::real();
        assert_eq!(grades(&link(&root, "can0")), [("link", Grade::Problem)]);
        assert_eq!(grades(&link(&root, "mock:")), [("link", Grade::Ok)]);
    }

    #[test]
    fn a_calibration_is_overdue_after_its_day_and_announced_a_month_before() {
        let grade = |due: &str| calibration("LVDT", "7", due, Date::constant(2026, 11, 23)).grade;
        assert_eq!(grade("2026-11-22"), Grade::Problem);
        assert_eq!(grade("2026-11-23"), Grade::Warning);
        assert_eq!(grade("2026-12-22"), Grade::Warning);
        assert_eq!(grade("2026-12-23"), Grade::Ok);
    }
}
