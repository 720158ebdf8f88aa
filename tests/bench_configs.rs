//! Every shipped file can be read and keeps the limits of its bench. Files with mistakes are refused with their place.

use std::path::{Path, PathBuf};

use crate::config::{Bench, ConfigError, Specimen};
use crate::profile::{Profile, ProfileError, violations};

fn files(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("bench-configs")
        .join(folder);
    let entries = std::fs::read_dir(&folder).expect("the folder is shipped");
    let mut files: Vec<_> = entries.map(|e| e.expect("readable").path()).collect();
    files.sort();
    assert!(!files.is_empty());
    files
}

fn mock() -> Bench {
    Bench::load(
        &files("benches")
            .into_iter()
            .find(|p| p.ends_with("mock.toml"))
            .expect("shipped"),
    )
    .unwrap()
}

#[test]
fn every_shipped_bench_and_specimen_is_read() {
    for path in files("benches") {
        let bench = Bench::load(&path).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(
            Some(bench.name.as_str()),
            path.file_stem().and_then(|s| s.to_str())
        );
        bench.model.plant().unwrap();
    }
    for path in files("specimens") {
        Specimen::load(&path).unwrap_or_else(|e| panic!("{e}"));
    }
}

#[test]
fn every_shipped_profile_keeps_the_default_limits() {
    for path in files("profiles") {
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        let profile = Profile::from_toml(&std::fs::read_to_string(&path).unwrap(), &name).unwrap();
        assert_eq!(format!("{}.toml", profile.name), name);
        let broken = violations(&profile, &mock().profile_limits(), 0.0, 1000.0).unwrap();
        assert!(broken.is_empty(), "{}", broken[0]);
    }
}

/// The text with another value for a key. The key must be in the text exactly once.
fn with(text: &str, key: &str, value: &str) -> String {
    let starts = format!("{key} = ");
    assert_eq!(
        text.lines().filter(|l| l.starts_with(&starts)).count(),
        1,
        "{key}"
    );
    let swap = |l: &str| {
        if l.starts_with(&starts) {
            format!("{starts}{value}")
        } else {
            l.to_owned()
        }
    };
    text.lines().map(swap).collect::<Vec<_>>().join("\n")
}

#[test]
fn p3_a_slip_of_a_thousand_in_any_limit_is_refused() {
    let bench = mock();
    let text = bench.to_toml();
    let limits = toml::Value::try_from(&bench.limits).unwrap();
    let limits = limits.as_table().unwrap();
    assert_eq!(limits.len(), 16);
    for (key, value) in limits {
        let value = value
            .as_float()
            .unwrap_or_else(|| value.as_integer().unwrap() as f64);
        let whole = key.ends_with("_ms");
        for mutant in [value * 1000.0, value / 1000.0, f64::NAN, -value, f64::INFINITY] {
            let written = match mutant {
                m if m.is_finite() && whole => format!("{}", m.round()),
                m if m.is_finite() => format!("{m:?}"),
                m => format!("{m}").to_lowercase(),
            };
            let error =
                Bench::parse(&with(&text, key, &written), "mutant").expect_err(&format!("{key} = {written}"));
            assert!(
                matches!(error, ConfigError::Invalid { line: 2.., .. }),
                "{key}: {error}"
            );
        }
        let missing: Vec<_> = text
            .lines()
            .filter(|l| !l.starts_with(&format!("{key} = ")))
            .collect();
        let error = Bench::parse(&missing.join("\n"), "mutant")
            .expect_err(key)
            .to_string();
        assert!(error.contains(&format!("missing field `{key}`")), "{error}");
    }
}

#[test]
fn a_bad_bench_is_refused_with_its_key() {
    let text = mock().to_toml();
    let cases = [
        ("address", "\"usb:0\"", "link.address"),
        ("address", "\"can:\"", "link.address"),
        ("address", "\"mock:x\"", "link.address"),
        ("node", "0", "link.node"),
        ("node", "127", "link.node"),
        ("node", "300", "toml"),
        ("n_per_count", "-0.1", "force_channel.n_per_count"),
        ("n_per_count", "0.0001", "force_channel.capacity_n"),
        ("mm_per_count", "0.5", "displacement_channel.capacity_mm"),
        ("capacity_n", "10.0", "force_channel.capacity_n"),
        ("capacity_n", "nan", "force_channel.capacity_n"),
        ("offset_n", "inf", "force_channel.offset_n"),
        ("noise_mm", "0.0", "displacement_channel.noise_mm"),
        ("listen", "\"0.0.0.0:80\"", "daemon.listen"),
        ("listen", "\"here\"", "toml"),
        ("data_folder", "\"\"", "daemon.data_folder"),
        ("lease_ms", "50.5", "toml"),
        ("force_max_n", "\"3 kN\"", "toml"),
    ];
    for (key, value, refused) in cases {
        let error = Bench::parse(&with(&text, key, value), "bad").expect_err(&format!("{key} = {value}"));
        let ConfigError::Invalid { line, key: found, .. } = &error else {
            panic!("{error}")
        };
        assert!(*line > 1 && found == refused, "{key} = {value}: {error}");
    }
    // Before the text they are at the top level, and the same keys follow later.
    for extra in ["speed = 3", "[limits]", "name = \"twice\"", "\u{1}"] {
        let error = Bench::parse(&format!("{extra}\n{text}\n"), "bad").expect_err(extra);
        assert!(matches!(error, ConfigError::Invalid { .. }), "{error}");
    }
    let unknown = text.replace("rate_n_per_mm = 72.0", "rate_kn_per_mm = 72.0");
    assert!(
        Bench::parse(&unknown, "bad")
            .unwrap_err()
            .to_string()
            .contains("has no parameter")
    );
}

const PROFILE_HEAD: &str = "name = \"p\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\n";
const RAMP: &str = "kind = \"ramp\"\nto_mm = 5.0\nduration_s = 1.0";
const SINE: &str = "kind = \"sine\"\nmean_mm = 0.0\namplitude_mm = 6.0\nfrequency_hz = 1.0\ncycles = 5";

/// A correct segment, a text in it, the mistake that replaces the text, a part of the message.
const SEGMENT_MISTAKES: &[(&str, &str, &str, &str)] = &[
    (RAMP, "duration_s = 1.0", "duration_s = 0.0", "not above 0"),
    (RAMP, "duration_s = 1.0", "duration_s = -1.0", "not above 0"),
    (RAMP, "duration_s = 1.0", "duration_s = nan", "not finite"),
    (RAMP, "duration_s = 1.0", "duration_s = inf", "not finite"),
    (
        RAMP,
        "duration_s = 1.0",
        "duration_s = 1e-5",
        "shorter than one sample",
    ),
    (RAMP, "duration_s = 1.0", "duration_s = 1e9", "longer than 1000 h"),
    (RAMP, "duration_s = 1.0", "duration_s = \"1\"", "invalid type"),
    (RAMP, "duration_s = 1.0", "duration = 1.0", "unknown field"),
    (
        RAMP,
        "duration_s = 1.0",
        "duration_s = 1.0\nduration_s = 2.0",
        "duplicate key",
    ),
    (RAMP, "duration_s = 1.0", "", "needs duration_s"),
    (RAMP, "to_mm = 5.0", "to_n = 5.0", "needs to_mm"),
    (
        RAMP,
        "to_mm = 5.0",
        "to_mm = 5.0\nto_n = 5.0",
        "keys that end in _mm",
    ),
    (RAMP, "to_mm = 5.0", "to_mm = inf", "not finite"),
    (
        RAMP,
        "to_mm = 5.0",
        "to_mm = 5.0\nby_mm = 1.0",
        "both give the level",
    ),
    (RAMP, "to_mm = 5.0", "", "needs to_mm"),
    (
        RAMP,
        "kind = \"ramp\"",
        "kind = \"rampe\"",
        "not a kind of segment",
    ),
    (RAMP, "kind = \"ramp\"", "", "has no kind"),
    (
        RAMP,
        "kind = \"ramp\"",
        "kind = \"hold\"",
        "does not belong to a hold",
    ),
    (SINE, "amplitude_mm = 6.0", "amplitude_mm = 0.0", "not above 0"),
    (SINE, "amplitude_mm = 6.0", "amplitude_mm = -6.0", "not above 0"),
    (
        SINE,
        "amplitude_mm = 6.0",
        "amplitude_n = 6.0",
        "needs amplitude_mm",
    ),
    (SINE, "frequency_hz = 1.0", "frequency_hz = 0.0", "not above 0"),
    (
        SINE,
        "frequency_hz = 1.0",
        "frequency_hz = 51.0",
        "outside 0.001 to 50",
    ),
    (
        SINE,
        "frequency_hz = 1.0",
        "frequency_hz = 1e-4",
        "outside 0.001 to 50",
    ),
    (SINE, "cycles = 5", "cycles = 0", "enter 1 or more"),
    (SINE, "cycles = 5", "cycles = -1", "invalid value"),
    (SINE, "cycles = 5", "cycles = 1.5", "invalid type"),
    (SINE, "cycles = 5", "cycles = 99999999999", "invalid value"),
    (
        SINE,
        "cycles = 5",
        "cycles = 5\ntaper_cycles = 0",
        "a step in speed",
    ),
    (
        SINE,
        "cycles = 5",
        "cycles = 5\nto_mm = 3.0",
        "does not belong to a sine",
    ),
    (SINE, "mean_mm = 0.0", "mean_mm = 20.0", "the run starts at 0"),
];

#[test]
fn p7_a_bad_profile_is_refused_with_its_line() {
    for &(segment, from, to, wanted) in SEGMENT_MISTAKES {
        let text = format!("{PROFILE_HEAD}{}", segment.replace(from, to));
        let error = Profile::from_toml(&text, "bad.toml").expect_err(to);
        // A profile that is too long as a whole has no line of its own.
        let at = if to.contains("1e9") { 1 } else { 4 };
        assert!(
            matches!(&error, ProfileError::File { line, .. } if *line >= at),
            "{to:?}: {error}"
        );
        assert!(
            error.to_string().contains(wanted),
            "{error} should say {wanted:?}"
        );
    }
    for head in [
        "",
        "name = \"p\"\n",
        "name = \"../p\"\ncontrol = \"force\"\n",
        "\u{0}",
        "name = \"p\"\ncontrol = \"force\"\n",
    ] {
        assert!(Profile::from_toml(head, "bad.toml").is_err(), "{head:?}");
    }
    let many = format!("{PROFILE_HEAD}{RAMP}").replace("[[block]]", "[[block]]\nrepeat = 4000000000");
    assert!(
        Profile::from_toml(&many, "bad.toml")
            .unwrap_err()
            .to_string()
            .contains("10000")
    );
}

#[test]
fn a_bad_table_is_refused_with_its_line() {
    for (time, level, wanted) in [
        ("[]", "[]", "time_s = 0 points are too few"),
        ("[0.0]", "[0.0]", "time_s = 1 points are too few"),
        ("[0.0, 1.0]", "[0.0]", "as many levels as times"),
        ("[0.5, 1.0]", "[0.0, 1.0]", "the first time must be 0"),
        ("[0.0, 1.0, 1.0]", "[0.0, 1.0, 2.0]", "does not rise"),
        ("[0.0, nan]", "[0.0, 1.0]", "does not rise"),
        ("[0.0, 1.0]", "[0.0, inf]", "not finite"),
        ("[0.0, 1.0]", "[3.0, 1.0]", "the run starts at 0"),
    ] {
        let text = format!("{PROFILE_HEAD}kind = \"table\"\ntime_s = {time}\nlevel_mm = {level}\n");
        let error = Profile::from_toml(&text, "bad.toml").expect_err(time);
        assert!(
            matches!(&error, ProfileError::File { line: 4.., .. }),
            "{time} {level}: {error}"
        );
        assert!(
            error.to_string().contains(wanted),
            "{error} should say {wanted:?}"
        );
    }
}
