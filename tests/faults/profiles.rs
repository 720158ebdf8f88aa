//! Rows P, as far as they are tested in virtual time: stops in every phase of a profile.

use super::outcome;
use crate::config::Bench;
use crate::control::Phase;
use crate::profile::{CycleSegment, Level, Profile, Segment, Wave};
use crate::recording::Ending;
use crate::tests::support::virtual_rig::{VirtualRig, profile};
use crate::units::Mode;

/// Speed change of a stop in one millisecond: the brake of the firmware, 5000 mm/s2, and what the servo loop adds to it.
const MOST_MM_S_PER_MS: f64 = 15.0;

/// A ramp, a hold and a sine, short ones.
fn ramp_hold_sine() -> Profile {
    let ramp = |to| Segment::Ramp {
        to: Level::Absolute(to),
        duration_s: 0.6,
    };
    profile(
        Mode::Displacement,
        vec![
            ramp(6.0),
            Segment::Hold { duration_s: 0.3 },
            Segment::Cycles(CycleSegment {
                wave: Wave::Sine,
                mean: Level::Absolute(6.0),
                amplitude: 4.0,
                frequency_hz: 2.0,
                cycles: 2,
                taper_cycles: 1,
                correct: false,
            }),
            ramp(0.0),
        ],
    )
}

/// A stop at 1000 moments of one profile, of which a test run takes a share: in each the rig unloads with a ramp and no step, and
/// the data are kept.
#[test]
fn p5_a_stop_in_every_phase_is_a_ramp_and_no_step() {
    let moments: usize = std::env::var("LEAFBENCH_MOMENTS")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(40);
    let length_ms = 3_600;
    for k in 0..moments {
        let at_ms = (k * length_ms / moments) as u64 + 7;
        let mut bench = VirtualRig::new();
        bench.start(ramp_hold_sine());
        bench.ticks(at_ms);
        let recorded = bench.memory.samples.len();
        bench.stop();
        let mut speeds = [0.0; 2];
        let mut before_mm = bench.mock.displacement_mm();
        let mut ticks = 0;
        while bench.rig.phase() != Phase::Ready {
            bench.tick();
            ticks += 1;
            assert!(ticks < 10_000, "at {at_ms} ms: {:#?}", bench.rig.status());
            let at_mm = bench.mock.displacement_mm();
            speeds = [speeds[1], (at_mm - before_mm) * 1e3];
            before_mm = at_mm;
            let change = (speeds[1] - speeds[0]).abs();
            assert!(
                ticks < 3 || change < MOST_MM_S_PER_MS,
                "at {at_ms} ms: {change:.1} mm/s in a millisecond"
            );
        }
        assert!(!bench.mock.pressure_on());
        let end = outcome(&bench);
        assert_eq!(end.ending, Ending::Stopped, "at {at_ms} ms: {}", end.cause);
        assert!(bench.memory.samples.len() > recorded, "the unload is recorded");
    }
}

/// A limit that is missing, or that leaves no room, is refused: limits cannot be switched off.
#[test]
fn p2_a_missing_or_impossible_limit_is_refused() {
    let bench = crate::tests::support::bench::mock();
    let text = bench.to_toml();
    let limits = toml::Value::try_from(&bench.limits).expect("a table");
    for (key, value) in limits.as_table().expect("a table") {
        let begin = format!("{key} = ");
        let without: Vec<&str> = text.lines().filter(|line| !line.starts_with(&begin)).collect();
        assert!(
            Bench::parse(&without.join("\n"), "mutant").is_err(),
            "{key} is missing"
        );
        if value.is_float() {
            let off = |written: &str| {
                let line = |line: &str| {
                    if line.starts_with(&begin) {
                        format!("{begin}{written}")
                    } else {
                        line.to_owned()
                    }
                };
                text.lines().map(line).collect::<Vec<_>>().join("\n")
            };
            for written in ["inf", "nan", "1e30", "false", "\"off\""] {
                assert!(
                    Bench::parse(&off(written), "mutant").is_err(),
                    "{key} = {written}"
                );
            }
        }
    }
}

/// No number that is none comes from a file into a run.
#[test]
fn x8_a_number_that_is_none_is_refused_in_bench_and_profile() {
    let text = crate::tests::support::bench::mock().to_toml();
    let mut numbers = 0;
    for (at, line) in text.lines().enumerate() {
        let Some((key, value)) = line.split_once(" = ") else {
            continue;
        };
        if value.parse::<f64>().is_err() || !value.contains('.') {
            continue;
        }
        numbers += 1;
        for none in ["nan", "inf", "-inf"] {
            let written: Vec<String> = text
                .lines()
                .enumerate()
                .map(|(k, l)| {
                    if k == at {
                        format!("{key} = {none}")
                    } else {
                        l.to_owned()
                    }
                })
                .collect();
            assert!(
                Bench::parse(&written.join("\n"), "mutant").is_err(),
                "line {}: {key} = {none}",
                at + 1
            );
        }
    }
    assert!(numbers > 15, "{numbers} numbers were tried");
    let ramp = "name = \"r\"\ncontrol = \"force\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\nto_n = 800.0\nduration_s = 6.0\n";
    Profile::from_toml(ramp, "sound").expect("sound");
    for (number, none) in [
        ("800.0", "nan"),
        ("800.0", "inf"),
        ("6.0", "nan"),
        ("6.0", "-inf"),
    ] {
        assert!(
            Profile::from_toml(&ramp.replace(number, none), "mutant").is_err(),
            "{number} -> {none}"
        );
    }
}

/// Text of people never reaches a CSV: a spreadsheet finds no formula in it, and a negative number stays a number.
#[test]
fn p9_a_csv_holds_numbers_only() {
    let mut bench = VirtualRig::new();
    bench.until(Phase::Ready, 2_000);
    bench.ticks(600);
    let mut order = crate::tests::support::virtual_rig::order(ramp_hold_sine());
    for text in [
        &mut order.header.operator,
        &mut order.header.specimen,
        &mut order.header.profile_name,
    ] {
        *text = "=1+1\t@x\"\r\n-2".to_owned();
    }
    bench.rig.start(order).expect("ready");
    bench.until(Phase::Running, 1_000);
    bench.until(Phase::Ready, 30_000);
    let header = bench.memory.header.as_ref().expect("a run");
    let format = crate::recording::csv::CsvFormat::new(header, &[Mode::Displacement]);
    let mut written = Vec::new();
    let mut writer = crate::recording::csv::CsvWriter::new(&mut written, format).expect("in memory");
    for sample in &bench.memory.samples {
        writer.sample(sample).expect("in memory");
    }
    let text = String::from_utf8(written).expect("text");
    let mut negative = 0;
    for row in text.lines().skip(1) {
        for cell in row.split(',').filter(|cell| !cell.is_empty()) {
            let value: f64 = cell.parse().unwrap_or_else(|_| panic!("{cell} in {row}"));
            negative += u32::from(value < 0.0);
        }
    }
    assert!(negative > 0, "the noise of the load cell at zero");
}
