//! The computer itself: clocks, rights, processors and disk.

use std::path::Path;

use super::finding::{DoctorFinding, SystemRoot, has_capability};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::run_file::{RunFileError, check_space};

/// Clock sources of the kernel that take a microsecond or more to read.
const SLOW_CLOCKS: [&str; 4] = ["hpet", "acpi_pm", "jiffies", "refined-jiffies"];
/// Bit of the capability CAP_SYS_NICE in `CapEff`.
const CAP_SYS_NICE: u32 = 23;
/// Bit of the capability CAP_SYS_RESOURCE in `CapEff`: it raises a limit above its hard value.
const CAP_SYS_RESOURCE: u32 = 24;
/// Real-time priority that the daemon takes.
const WANTED_PRIORITY: u64 = 40;
/// Length of the run that the disk should take at least, s.
const ROOM_FOR_S: f64 = 1800.0;

/// The clock that the control loop waits on.
pub(super) fn monotonic_clock(root: &SystemRoot) -> DoctorFinding {
    let file = "/sys/devices/system/clocksource/clocksource0/current_clocksource";
    match root.text(file) {
        Some(name) if SLOW_CLOCKS.contains(&name.as_str()) => DoctorFinding::warning(
            "clock",
            format!("the kernel counts time with {name}, which is slow to read"),
            "look for the reason with `sudo dmesg | grep -i clocksource`; on a computer of its own choose tsc in the firmware \
             settings or with the kernel argument tsc=reliable",
        )
        .at(file),
        Some(name) => DoctorFinding::ok("clock", format!("monotonic clock on {name}")).at(file),
        // Some kernels have no choice of clocks and no such file.
        None => DoctorFinding::ok("clock", "monotonic clock; the kernel does not name its source"),
    }
}

/// Whether something keeps the time of day right: the time in the header of each recording.
pub(super) fn time_of_day(root: &SystemRoot) -> DoctorFinding {
    const SIGNS: [(&str, &str); 5] = [
        (
            "/run/systemd/timesync/synchronized",
            "synchronised by systemd-timesyncd",
        ),
        (
            "/run/chrony/chronyd.pid",
            "kept by chronyd (ask it with `chronyc tracking`)",
        ),
        (
            "/run/chronyd.pid",
            "kept by chronyd (ask it with `chronyc tracking`)",
        ),
        ("/run/ntpd.pid", "kept by ntpd (ask it with `ntpq -p`)"),
        ("/run/ptp4l", "kept by ptp4l"),
    ];
    match SIGNS.iter().find(|(file, _)| root.has(file)) {
        Some((file, how)) => DoctorFinding::ok("time of day", *how).at(*file),
        None => DoctorFinding::warning(
            "time of day",
            "no sign that anything synchronises it: dates and run ids of recordings may be wrong (control does not use it)",
            "run `sudo timedatectl set-ntp true`, or install chrony; without a network set the clock by hand",
        ),
    }
}

/// A limit of `/proc/self/limits`: its soft value and its hard value.
fn limit(text: &str, name: &str) -> Option<(Option<u64>, Option<u64>)> {
    let rest = text.lines().find_map(|line| line.strip_prefix(name))?;
    let mut words = rest.split_whitespace();
    let mut value = || Some(words.next()?.parse::<u64>().ok());
    Some((value()?, value()?))
}

/// Real-time priority and locked memory of this user.
pub(super) fn rights(root: &SystemRoot) -> Vec<DoctorFinding> {
    let status = root.text("/proc/self/status").unwrap_or_default();
    let limits = root.text("/proc/self/limits").unwrap_or_default();
    vec![
        real_time(
            &status,
            &limits,
            root.number("/proc/sys/kernel/sched_rt_runtime_us"),
        ),
        locked_memory(&status, &limits),
    ]
}

fn real_time(status: &str, limits: &str, share_us: Option<i64>) -> DoctorFinding {
    let granted = limit(limits, "Max realtime priority").and_then(|(soft, _)| soft);
    if share_us == Some(0) {
        return DoctorFinding::problem(
            "real-time",
            "the kernel gives real-time programs no time at all",
            "run `sudo sysctl -w kernel.sched_rt_runtime_us=950000`",
        )
        .at("/proc/sys/kernel/sched_rt_runtime_us");
    }
    if has_capability(status, CAP_SYS_NICE) {
        return DoctorFinding::ok("real-time", "allowed by CAP_SYS_NICE").at("/proc/self/status");
    }
    match granted {
        Some(priority) if priority >= WANTED_PRIORITY => {
            DoctorFinding::ok("real-time", format!("allowed up to priority {priority}")).at("/proc/self/limits")
        }
        _ => DoctorFinding::warning(
            "real-time",
            format!(
                "priority {WANTED_PRIORITY} is not allowed to this user (limit {}): commands may be late under load",
                granted.unwrap_or(0)
            ),
            "start the daemon by its systemd unit, which sets LimitRTPRIO=50; or write `USER - rtprio 50` to \
             /etc/security/limits.d/leafbench.conf and log in again",
        )
        .at("/proc/self/limits"),
    }
}

fn locked_memory(status: &str, limits: &str) -> DoctorFinding {
    // As the daemon does it: it locks its memory only after it has taken the limit away.
    let unlimited = matches!(limit(limits, "Max locked memory"), Some((_, None)));
    if unlimited || has_capability(status, CAP_SYS_RESOURCE) {
        return DoctorFinding::ok("locked memory", "not limited").at("/proc/self/limits");
    }
    DoctorFinding::warning(
        "locked memory",
        "limited: the control loop may have to wait for a memory page",
        "start the daemon by its systemd unit, which sets LimitMEMLOCK=infinity; or write `USER - memlock unlimited` to \
         /etc/security/limits.d/leafbench.conf and log in again",
    )
    .at("/proc/self/limits")
}

/// Number of processors in a list of the kernel such as `0-3,6`.
fn count(list: &str) -> usize {
    let ranges = list.split(',').filter_map(|range| {
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        let (first, last): (usize, usize) = (first.trim().parse().ok()?, last.trim().parse().ok()?);
        Some(last.saturating_sub(first) + 1)
    });
    ranges.sum()
}

/// How many processors there are, whether one is kept free, and whether they save energy.
pub(super) fn processors(root: &SystemRoot) -> Vec<DoctorFinding> {
    const ONLINE: &str = "/sys/devices/system/cpu/online";
    let online = count(&root.text(ONLINE).unwrap_or_default());
    let isolated = root.text("/sys/devices/system/cpu/isolated").unwrap_or_default();
    let kept = match isolated.as_str() {
        "" => "none is kept free of other programs".to_owned(),
        list => {
            format!("{list} kept free of other programs: give it to the daemon with CPUAffinity= in its unit")
        }
    };
    let number = match online {
        0 => DoctorFinding::ok("processors", "the kernel does not say how many there are"),
        1 => DoctorFinding::warning(
            "processors",
            "only one: the page and the twin share it with the control loop",
            "use a computer with two cores or more",
        ),
        n => DoctorFinding::ok("processors", format!("{n}, {kept}")),
    };
    let mut findings = vec![number.at(ONLINE)];
    findings.extend(governor(root));
    findings
}

/// The governor of the processors' frequency, where the kernel has one.
fn governor(root: &SystemRoot) -> Option<DoctorFinding> {
    let governors: Vec<(String, String)> = (0..1024)
        .map(|n| format!("/sys/devices/system/cpu/cpu{n}/cpufreq/scaling_governor"))
        .map_while(|file| root.text(&file).map(|name| (file, name)))
        .collect();
    let saving = governors.iter().find(|(_, name)| name != "performance");
    Some(match (saving, governors.first()) {
        (Some((file, name)), _) => DoctorFinding::warning(
            "governor",
            format!("the frequency of the processors follows their load ({name}): a turn of control may be some 0.1 ms later"),
            "run `sudo cpupower frequency-set -g performance`",
        )
        .at(file),
        (None, Some((file, _))) => DoctorFinding::ok("governor", "performance").at(file),
        (None, None) => return None,
    })
}

/// Whether the disk of the run files takes a long run. A folder that is not there yet is made by the daemon.
pub(super) fn disk(folder: &Path) -> DoctorFinding {
    let absolute = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    let there = absolute.ancestors().find(|folder| folder.is_dir());
    let there = there.unwrap_or(Path::new("/"));
    let place = absolute.display().to_string();
    let writable = nix::unistd::access(there, nix::unistd::AccessFlags::W_OK);
    if let Err(errno) = writable {
        return DoctorFinding::problem(
            "disk",
            format!("no file can be written to {} ({})", there.display(), errno.desc()),
            "give the folder to the user of the daemon, or name another one with --data",
        )
        .at(place);
    }
    match check_space(there, ROOM_FOR_S, f64::from(SAMPLE_RATE_HZ)) {
        Ok(()) => DoctorFinding::ok("disk", "room for runs of half an hour").at(place),
        Err(RunFileError::NoSpace {
            free_mb, needed_mb, ..
        }) => DoctorFinding::problem(
            "disk",
            format!("only {free_mb:.0} MB free, and a run of half an hour needs {needed_mb:.0} MB"),
            "delete or move old runs, or name another folder with --data",
        )
        .at(place),
        Err(error) => {
            DoctorFinding::problem("disk", error.to_string(), "check the disk and the path").at(place)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::finding::Grade;
    use super::*;

    /// A computer of these files.
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

    #[test]
    fn a_slow_clock_and_a_clock_that_nothing_sets_are_warnings() {
        let source = "sys/devices/system/clocksource/clocksource0/current_clocksource";
        for (name, grade) in [
            ("tsc\n", Grade::Ok),
            ("hpet\n", Grade::Warning),
            ("arch_sys_counter\n", Grade::Ok),
        ] {
            let (_folder, root) = computer(&[(source, name)]);
            assert_eq!(monotonic_clock(&root).grade, grade, "{name}");
            assert_eq!(time_of_day(&root).grade, Grade::Warning);
        }
        let (_folder, root) = computer(&[("run/systemd/timesync/synchronized", "")]);
        assert_eq!(time_of_day(&root).grade, Grade::Ok);
        assert_eq!(monotonic_clock(&root).grade, Grade::Ok);
    }

    const LIMITS: &str = "Limit                     Soft Limit           Hard Limit           Units     \n\
                          Max locked memory         8388608              8388608              bytes     \n\
                          Max realtime priority     0                    0                    \n";

    #[test]
    fn rights_come_from_the_limits_or_from_capabilities() {
        let grades = |status: &str, limits: &str, share: &str| {
            let (_folder, root) = computer(&[
                ("proc/self/status", status),
                ("proc/self/limits", limits),
                ("proc/sys/kernel/sched_rt_runtime_us", share),
            ]);
            let found = rights(&root);
            (found[0].grade, found[1].grade)
        };
        let nobody = "Name:\tdoctor\nCapEff:\t0000000000000000\n";
        assert_eq!(
            grades(nobody, LIMITS, "950000\n"),
            (Grade::Warning, Grade::Warning)
        );
        let raised = LIMITS
            .replace("8388608              8388608", "8388608              unlimited")
            .replace("priority     0 ", "priority     50");
        assert_eq!(grades(nobody, &raised, "950000\n"), (Grade::Ok, Grade::Ok));
        let root = "CapEff:\t000001ffffffffff\n";
        // Root in a container: it may lock memory, but not raise the limit.
        let contained = "CapEff:\t000001fffeffffff\n";
        assert_eq!(grades(contained, LIMITS, "950000\n"), (Grade::Ok, Grade::Warning));
        assert_eq!(grades(root, LIMITS, "-1\n"), (Grade::Ok, Grade::Ok));
        assert_eq!(grades(root, LIMITS, "0\n"), (Grade::Problem, Grade::Ok));
    }

    #[test]
    fn processors_are_counted_and_a_governor_that_saves_energy_is_a_warning() {
        let (_folder, root) = computer(&[
            ("sys/devices/system/cpu/online", "0-2,4\n"),
            ("sys/devices/system/cpu/isolated", "4\n"),
            (
                "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor",
                "performance\n",
            ),
            (
                "sys/devices/system/cpu/cpu1/cpufreq/scaling_governor",
                "powersave\n",
            ),
        ]);
        let found = processors(&root);
        assert!(found[0].what.starts_with("4, 4 kept free"), "{found:?}");
        assert_eq!(found[1].grade, Grade::Warning);
        assert!(found[1].place.contains("cpu1"), "{found:?}");
        let (_folder, root) = computer(&[("sys/devices/system/cpu/online", "0\n")]);
        let found = processors(&root);
        assert_eq!((found.len(), found[0].grade), (1, Grade::Warning));
    }

    #[test]
    fn a_folder_that_is_not_there_yet_is_on_the_disk_of_its_parent() {
        let folder = tempfile::tempdir().expect("a folder");
        assert_eq!(disk(&folder.path().join("runs/of/today")).grade, Grade::Ok);
        // Nobody can write there, not even root.
        assert_eq!(disk(Path::new("/proc/runs")).grade, Grade::Problem);
    }
}
