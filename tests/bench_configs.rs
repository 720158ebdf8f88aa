//! Every shipped file is read, keeps its bench's limits, and its bad neighbours are refused with a position.

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

/// One key's value replaced by another; the key must stand in the text once.
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
fn a_slip_of_a_thousand_in_any_limit_is_refused() {
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
    // Ahead of the text they stand at the top level; the same keys follow again further down.
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
    assert!(Bench::parse(&" ".repeat(1 << 21), "bad").is_err());
}

#[test]
fn a_bad_profile_is_refused_with_its_line() {
    const RAMP: &str = "kind = \"ramp\"\nto_mm = 5.0\nduration_s = 1.0";
    const SINE: &str = "kind = \"sine\"\nmean_mm = 0.0\namplitude_mm = 6.0\nfrequency_hz = 1.0\ncycles = 5";
    let head = "name = \"p\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\n";
    let cases = [
        (RAMP, "duration_s = 1.0", "duration_s = 0.0"),
        (RAMP, "duration_s = 1.0", "duration_s = -1.0"),
        (RAMP, "duration_s = 1.0", "duration_s = nan"),
        (RAMP, "duration_s = 1.0", "duration_s = inf"),
        (RAMP, "duration_s = 1.0", "duration_s = 1e-5"),
        (RAMP, "duration_s = 1.0", "duration_s = 1e9"),
        (RAMP, "duration_s = 1.0", "duration_s = \"1\""),
        (RAMP, "duration_s = 1.0", "duration = 1.0"),
        (RAMP, "duration_s = 1.0", "duration_s = 1.0\nduration_s = 2.0"),
        (RAMP, "duration_s = 1.0", ""),
        (RAMP, "to_mm = 5.0", "to_n = 5.0"),
        (RAMP, "to_mm = 5.0", "to_mm = inf"),
        (RAMP, "to_mm = 5.0", "to_mm = 5.0\nby_mm = 1.0"),
        (RAMP, "to_mm = 5.0", ""),
        (RAMP, "kind = \"ramp\"", "kind = \"rampe\""),
        (RAMP, "kind = \"ramp\"", ""),
        (RAMP, "kind = \"ramp\"", "kind = \"hold\""),
        (SINE, "amplitude_mm = 6.0", "amplitude_mm = 0.0"),
        (SINE, "amplitude_mm = 6.0", "amplitude_mm = -6.0"),
        (SINE, "amplitude_mm = 6.0", "amplitude_n = 6.0"),
        (SINE, "frequency_hz = 1.0", "frequency_hz = 0.0"),
        (SINE, "frequency_hz = 1.0", "frequency_hz = 51.0"),
        (SINE, "frequency_hz = 1.0", "frequency_hz = 1e-4"),
        (SINE, "cycles = 5", "cycles = 0"),
        (SINE, "cycles = 5", "cycles = -1"),
        (SINE, "cycles = 5", "cycles = 1.5"),
        (SINE, "cycles = 5", "cycles = 99999999999"),
        (SINE, "cycles = 5", "cycles = 5\ntaper_cycles = 0"),
        (SINE, "cycles = 5", "cycles = 5\nto_mm = 3.0"),
        (SINE, "mean_mm = 0.0", "mean_mm = 20.0"),
    ];
    for (segment, from, to) in cases {
        let text = format!("{head}{}", segment.replace(from, to));
        let error = Profile::from_toml(&text, "bad.toml").expect_err(to);
        // A profile that is too long as a whole has no line of its own.
        let at = if to.contains("1e9") { 1 } else { 4 };
        assert!(
            matches!(&error, ProfileError::File { line, .. } if *line >= at),
            "{to:?}: {error}"
        );
    }
    let table =
        |time: &str, level: &str| format!("{head}kind = \"table\"\ntime_s = {time}\nlevel_mm = {level}\n");
    for (time, level) in [
        ("[]", "[]"),
        ("[0.0]", "[0.0]"),
        ("[0.0, 1.0]", "[0.0]"),
        ("[0.5, 1.0]", "[0.0, 1.0]"),
        ("[0.0, 1.0, 1.0]", "[0.0, 1.0, 2.0]"),
        ("[0.0, nan]", "[0.0, 1.0]"),
        ("[0.0, 1.0]", "[0.0, inf]"),
        ("[0.0, 1.0]", "[3.0, 1.0]"),
    ] {
        let error = Profile::from_toml(&table(time, level), "bad.toml").expect_err(time);
        assert!(
            matches!(&error, ProfileError::File { line: 4.., .. }),
            "{time} {level}: {error}"
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
    let many = format!("{head}{RAMP}").replace("[[block]]", "[[block]]\nrepeat = 4000000000");
    assert!(
        Profile::from_toml(&many, "bad.toml")
            .unwrap_err()
            .to_string()
            .contains("10000")
    );
}
