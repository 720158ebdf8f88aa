//! Checks a bench or specimen that was read: ranges that follow from the sensors, and ranges narrow enough to find a wrong
//! unit (kN for N, m for mm), which is off by a factor of 1000. `document` finds line and column of a refused key.

use super::document::Document;
use super::{
    Bench, BenchLimits, ConfigError, DisplacementChannel, ForceChannel, LinkConfig, ModelConfig, Specimen,
};
use crate::calibration::{CalibratedChannel, CalibrationFile};
use crate::link::{address_forms, is_address};
use crate::mockrig::{MockRigConfig, MockRigError};
use crate::model;
use crate::protocol::message::COUNTS_MAX;

/// Checks a bench. Its models and its specimen are checked by [`model()`] and [`specimen()`].
pub(super) fn bench(document: &Document, bench: &Bench) -> Result<(), ConfigError> {
    not_empty(document, "name", &bench.name, "enter the name of the bench")?;
    link(document, &bench.link)?;
    channel(document, &ChannelValues::of_force(&bench.force_channel))?;
    channel(
        document,
        &ChannelValues::of_displacement(&bench.displacement_channel),
    )?;
    limits(document, bench)?;
    times(document, bench)?;
    if !bench.daemon.listen.ip().is_loopback() {
        let reason = format!(
            "{} can be reached from other computers: use 127.0.0.1",
            bench.daemon.listen
        );
        return Err(document.refuse("daemon.listen", reason));
    }
    let folder = bench.daemon.data_folder.to_string_lossy();
    not_empty(
        document,
        "daemon.data_folder",
        &folder,
        "enter a folder for the runs",
    )
}

/// Checks the settings of the mock rig, also on the bench of a real one.
pub(super) fn mock_rig(document: &Document, config: &MockRigConfig) -> Result<(), ConfigError> {
    config.check().map_err(|fault| match fault {
        MockRigError::Range {
            table,
            key,
            value,
            range,
        } => {
            let reason = format!("{value} is out of range: set it to {range}");
            document.refuse(&format!("mock_rig.{table}{key}"), reason)
        }
        MockRigError::Fault(error) => document.refuse("mock_rig.faults", error.to_string()),
    })
}

/// Checks a specimen. `table` is its place in the document with a point at the end, or empty.
pub(super) fn specimen(document: &Document, table: &str, specimen: &Specimen) -> Result<(), ConfigError> {
    let name = format!("{table}name");
    not_empty(
        document,
        &name,
        &specimen.name,
        "enter the name or the serial number of the specimen",
    )?;
    model(document, &format!("{table}model"), &specimen.model)
}

/// Largest zero of a force channel that is accepted, in N: above the zero of any load cell of a bench for leaf springs.
const LARGEST_FORCE_ZERO_N: f64 = 1e5;

/// Checks that name, parameters, structure and effects build a plant.
pub(super) fn model(document: &Document, key: &str, config: &ModelConfig) -> Result<(), ConfigError> {
    let found =
        model::find(&config.name).map_err(|e| document.refuse(&format!("{key}.name"), e.to_string()))?;
    for (name, value) in &config.parameters {
        let key = format!("{key}.parameters.{name}");
        let index = found
            .parameter_index(name)
            .map_err(|e| document.refuse(&key, e.to_string()))?;
        let [low, high] = found.parameters.get(index).map_or([0.0, 0.0], |p| p.bounds);
        within(document, &key, *value, low, high, "the bounds of the model")?;
    }
    let zero = format!("{key}.force_zero_n");
    let largest = LARGEST_FORCE_ZERO_N;
    within(
        document,
        &zero,
        config.force_zero_n,
        -largest,
        largest,
        "a zero, not a load",
    )?;
    let plant = config
        .plant_without_effects()
        .map_err(|e| document.refuse(&format!("{key}.structure"), e.to_string()))?;
    config
        .with_effects(plant)
        .map(|_| ())
        .map_err(|e| document.refuse(&format!("{key}.effect"), e.to_string()))
}

fn link(document: &Document, link: &LinkConfig) -> Result<(), ConfigError> {
    if !is_address(&link.address) {
        let reason = format!(
            "\"{}\" is not the address of a link: write {}",
            link.address,
            address_forms()
        );
        return Err(document.refuse("link.address", reason));
    }
    let rows = [
        ("node", f64::from(link.node), 1.0, 126.0, "the nodes of a bus"),
        (
            "queue_lead_ms",
            link.queue_lead_ms as f64,
            40.0,
            200.0,
            "the queue of the rig",
        ),
        (
            "silence_ms",
            link.silence_ms as f64,
            5.0,
            500.0,
            "longer than a late frame, short enough to react",
        ),
    ];
    all_within(document, "link", &rows)
}

/// The values of a calibration, the same for both channels.
struct ChannelValues<'a> {
    table: &'static str,
    /// Ending of the keys: `n` or `mm`.
    unit: &'static str,
    per_count: f64,
    sign: i32,
    offset: f64,
    capacity: f64,
    noise: f64,
    calibrated: &'a str,
    due: &'a str,
    polynomial: &'a [f64],
}

impl<'a> ChannelValues<'a> {
    fn of_force(f: &'a ForceChannel) -> Self {
        ChannelValues {
            table: "force_channel",
            unit: "n",
            per_count: f.n_per_count,
            sign: f.sign,
            offset: f.offset_n,
            capacity: f.capacity_n,
            noise: f.noise_n,
            calibrated: &f.calibrated,
            due: &f.due,
            polynomial: &f.polynomial,
        }
    }

    fn of_displacement(d: &'a DisplacementChannel) -> Self {
        ChannelValues {
            table: "displacement_channel",
            unit: "mm",
            per_count: d.mm_per_count,
            sign: d.sign,
            offset: d.offset_mm,
            capacity: d.capacity_mm,
            noise: d.noise_mm,
            calibrated: &d.calibrated,
            due: &d.due,
            polynomial: &d.polynomial,
        }
    }
}

impl<'a> ChannelValues<'a> {
    fn of_file(file: &'a CalibrationFile) -> Self {
        ChannelValues {
            table: "",
            unit: file.channel.suffix(),
            per_count: file.per_count,
            sign: 1,
            offset: 0.0,
            capacity: file.capacity,
            noise: file.noise,
            calibrated: &file.calibrated,
            due: &file.due,
            polynomial: &file.polynomial,
        }
    }
}

fn channel(document: &Document, c: &ChannelValues) -> Result<(), ConfigError> {
    let (table, unit, capacity) = (c.table, c.unit, c.capacity);
    let key = |name: &str| key_in(table, name);
    positive(document, &key(&format!("{unit}_per_count")), c.per_count)?;
    if c.sign != 1 {
        let reason = format!(
            "{} is not allowed, because the firmware unloads towards falling counts: make the counts of the sensor rise when \
             the spring is loaded (exchange its signal wires), and write 1",
            c.sign
        );
        return Err(document.refuse(&key("sign"), reason));
    }
    let wire = c.per_count * f64::from(COUNTS_MAX);
    let rows = [
        (
            format!("capacity_{unit}"),
            capacity,
            0.25 * wire,
            wire,
            "a quarter to all of the largest value that the counts can carry",
        ),
        (
            format!("offset_{unit}"),
            c.offset,
            -0.2 * capacity,
            0.2 * capacity,
            "a fifth of the capacity",
        ),
        (
            format!("noise_{unit}"),
            c.noise,
            1e-7 * capacity,
            0.01 * capacity,
            "0.1 ppm to 1 % of the capacity",
        ),
    ];
    all_within(document, table, &rows)?;
    for (name, date) in [("calibrated", c.calibrated), ("due", c.due)] {
        if date.parse::<jiff::civil::Date>().is_err() {
            let reason = format!("\"{date}\" is not a date: write YYYY-MM-DD");
            return Err(document.refuse(&key(name), reason));
        }
    }
    if c.due <= c.calibrated {
        let reason = format!("{} is not after the calibration: correct one of the dates", c.due);
        return Err(document.refuse(&key("due"), reason));
    }
    polynomial(document, c)
}

/// Slopes of a calibration's polynomial between which it may be used: beyond, a unit or a point is wrong.
const SLOPES: [f64; 2] = [0.5, 2.0];

/// Checks that the polynomial rises everywhere that counts can reach, and by nearly what the reading does.
fn polynomial(document: &Document, c: &ChannelValues) -> Result<(), ConfigError> {
    let refuse = |reason: String| Err(document.refuse(&key_in(c.table, "polynomial"), reason));
    let factors = c.polynomial;
    if factors.is_empty() {
        return Ok(());
    }
    if !(2..=4).contains(&factors.len()) || factors.iter().any(|factor| !factor.is_finite()) {
        return refuse(
            "needs two to four numbers: constant, slope, and where needed square and cube".to_owned(),
        );
    }
    let (zero, largest) = (factors[0], 0.2 * c.capacity);
    if zero.abs() > largest {
        return refuse(format!(
            "the constant {zero} is above {largest}, a fifth of the capacity: check the unit"
        ));
    }
    let term = |power: usize| factors.get(power).copied().unwrap_or(0.0);
    let slope = |reading: f64| factors[1] + reading * (2.0 * term(2) + 3.0 * term(3) * reading);
    let wire = c.per_count * f64::from(COUNTS_MAX);
    // The slope is a parabola: its extremes are at the ends or at its vertex.
    let vertex = (-term(2) / (3.0 * term(3))).clamp(-wire, wire);
    let at = [-wire, wire, if vertex.is_finite() { vertex } else { 0.0 }];
    let [low, high] = SLOPES;
    match at
        .into_iter()
        .find(|reading| !(low..=high).contains(&slope(*reading)))
    {
        Some(reading) => refuse(format!(
            "its slope at {reading:.3} {} is {:.3}, outside {low} to {high}: check the points and the order",
            c.unit,
            slope(reading)
        )),
        None => Ok(()),
    }
}

/// Checks a calibration file by itself.
pub(super) fn calibration(document: &Document, file: &CalibrationFile) -> Result<(), ConfigError> {
    let own = file.channel;
    let other = match own {
        CalibratedChannel::Force => CalibratedChannel::Displacement,
        CalibratedChannel::Displacement => CalibratedChannel::Force,
    };
    for name in CalibrationFile::DIMENSIONED {
        let (wrong, right) = (CalibrationFile::key(other, name), CalibrationFile::key(own, name));
        if document.has(&wrong) {
            let reason = format!("the channel is in {}: write {right}", own.unit());
            return Err(document.refuse(&wrong, reason));
        }
    }
    for (key, text) in [
        ("certificate", &file.certificate),
        ("serial", &file.serial),
        ("laboratory", &file.laboratory),
    ] {
        not_empty(document, key, text, "copy it from the certificate")?;
    }
    if file.polynomial.is_empty() {
        return Err(document.refuse(
            "polynomial",
            "is empty: write [0.0, 1.0] for a sensor without correction",
        ));
    }
    channel(document, &ChannelValues::of_file(file))?;
    let uncertainty = CalibrationFile::key(own, "expanded_uncertainty");
    let largest = 0.1 * file.capacity;
    within(
        document,
        &uncertainty,
        file.expanded_uncertainty,
        0.0,
        largest,
        "a tenth of the capacity",
    )?;
    let numbers = file
        .points
        .iter()
        .flat_map(|p| [p.reference, p.up, p.down.unwrap_or(0.0), p.reference_down()]);
    if numbers
        .into_iter()
        .any(|number| number.is_nan() || number.abs() > 2.0 * file.capacity)
    {
        return Err(document.refuse("point", "a point is above twice the capacity: check the unit"));
    }
    Ok(())
}

/// The key in its table; in no table where its name is empty.
fn key_in(table: &str, name: &str) -> String {
    match table {
        "" => name.to_owned(),
        table => format!("{table}.{name}"),
    }
}

/// Key without its table, value, least value, largest value, what the range is.
type RangeRow<K> = (K, f64, f64, f64, &'static str);

const OF_CELL: &str = "1 to 100 % of the capacity of the load cell";
const OF_LVDT: &str = "1 to 100 % of the range of the LVDT";
const BELOW_ZERO: &str = "0.5 to 100 % of the range below zero, clear of noise and drift";
const ERROR_OF_CELL: &str = "0.2 to 20 % of the capacity of the load cell";
const ERROR_OF_LVDT: &str = "0.2 to 20 % of the range of the LVDT";
const OF_BENCH: &str = "what a bench of this kind can do";

/// Each range is narrower than a factor of 1000 around any sensible value.
fn limits(document: &Document, bench: &Bench) -> Result<(), ConfigError> {
    let l = &bench.limits;
    let cell_n = bench.force_channel.capacity_n;
    let lvdt_mm = bench.displacement_channel.capacity_mm;
    if l.force_max_n > cell_n {
        let reason = format!(
            "force limit {} N is above the load cell's {cell_n} N: lower it or enter the larger cell",
            l.force_max_n
        );
        return Err(document.refuse("limits.force_max_n", reason));
    }
    all_within(document, "limits", &force_ranges(l, cell_n))?;
    all_within(document, "limits", &displacement_ranges(l, lvdt_mm))?;
    all_within(document, "limits", &time_ranges(l))
}

fn force_ranges(l: &BenchLimits, cell_n: f64) -> [RangeRow<&'static str>; 5] {
    [
        ("force_max_n", l.force_max_n, 0.01 * cell_n, cell_n, OF_CELL),
        ("force_min_n", l.force_min_n, -cell_n, -0.005 * cell_n, BELOW_ZERO),
        (
            "following_error_n",
            l.following_error_n,
            0.002 * cell_n,
            0.2 * cell_n,
            ERROR_OF_CELL,
        ),
        (
            "unloaded_force_n",
            l.unloaded_force_n,
            5e-4 * cell_n,
            0.05 * cell_n,
            "0.05 to 5 % of the capacity of the load cell",
        ),
        (
            "tare_max_n",
            l.tare_max_n,
            0.001 * cell_n,
            0.2 * cell_n,
            "0.1 to 20 % of the capacity of the load cell",
        ),
    ]
}

fn displacement_ranges(l: &BenchLimits, lvdt_mm: f64) -> [RangeRow<&'static str>; 8] {
    [
        (
            "displacement_max_mm",
            l.displacement_max_mm,
            0.01 * lvdt_mm,
            lvdt_mm,
            OF_LVDT,
        ),
        (
            "displacement_min_mm",
            l.displacement_min_mm,
            -lvdt_mm,
            -0.005 * lvdt_mm,
            BELOW_ZERO,
        ),
        (
            "following_error_mm",
            l.following_error_mm,
            0.002 * lvdt_mm,
            0.2 * lvdt_mm,
            ERROR_OF_LVDT,
        ),
        (
            "retract_mm",
            l.retract_mm,
            l.displacement_min_mm,
            -0.25,
            "from the lower displacement limit to clear of the specimen",
        ),
        (
            "tare_max_mm",
            l.tare_max_mm,
            0.001 * lvdt_mm,
            0.5 * lvdt_mm,
            "0.1 to 50 % of the range of the LVDT",
        ),
        ("velocity_max_mm_s", l.velocity_max_mm_s, 5.0, 1000.0, OF_BENCH),
        (
            "acceleration_max_mm_s2",
            l.acceleration_max_mm_s2,
            100.0,
            50_000.0,
            OF_BENCH,
        ),
        (
            "unload_velocity_mm_s",
            l.unload_velocity_mm_s,
            0.1,
            5.0,
            "a gentle unload, which the firmware accepts",
        ),
    ]
}

fn time_ranges(l: &BenchLimits) -> [RangeRow<&'static str>; 3] {
    [
        (
            "lease_ms",
            f64::from(l.lease_ms),
            20.0,
            500.0,
            "longer than two lost frames, short enough to react",
        ),
        (
            "hold_timeout_ms",
            f64::from(l.hold_timeout_ms),
            1000.0,
            600_000.0,
            "1 s to 10 min",
        ),
        (
            "queue_low_ms",
            f64::from(l.queue_low_ms),
            5.0,
            90.0,
            "within the 100 ms of the queue",
        ),
    ]
}

/// Times of the link that must fit the limits.
fn times(document: &Document, bench: &Bench) -> Result<(), ConfigError> {
    let (lead_ms, low_ms) = (bench.link.queue_lead_ms, bench.limits.queue_low_ms);
    if lead_ms <= u64::from(low_ms.unsigned_abs()) {
        let reason = format!(
            "{lead_ms} ms is not above limits.queue_low_ms = {low_ms} ms, so the rig would go to hold at once: enter a larger lead"
        );
        return Err(document.refuse("link.queue_lead_ms", reason));
    }
    let (silence_ms, lease_ms) = (bench.link.silence_ms, bench.limits.lease_ms);
    if silence_ms > u64::from(lease_ms.unsigned_abs()) {
        let reason = format!(
            "{silence_ms} ms is above limits.lease_ms = {lease_ms} ms, so the rig would unload before the run is aborted: \
             enter a shorter silence"
        );
        return Err(document.refuse("link.silence_ms", reason));
    }
    Ok(())
}

fn all_within<K: AsRef<str>>(
    document: &Document,
    table: &str,
    rows: &[RangeRow<K>],
) -> Result<(), ConfigError> {
    rows.iter().try_for_each(|(key, value, low, high, range)| {
        within(document, &key_in(table, key.as_ref()), *value, *low, *high, range)
    })
}

fn within(
    document: &Document,
    key: &str,
    value: f64,
    low: f64,
    high: f64,
    range: &str,
) -> Result<(), ConfigError> {
    // A NaN is in no range.
    if value >= low && value <= high {
        return Ok(());
    }
    let reason = format!(
        "{value} is outside {low} to {high} ({range}): check the unit and enter a value in this range"
    );
    Err(document.refuse(key, reason))
}

fn positive(document: &Document, key: &str, value: f64) -> Result<(), ConfigError> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    let reason =
        format!("{value} is not above 0: enter a positive number, and give the direction by the key sign");
    Err(document.refuse(key, reason))
}

fn not_empty(document: &Document, key: &str, text: &str, order: &str) -> Result<(), ConfigError> {
    if text.trim().is_empty() {
        return Err(document.refuse(key, format!("the text is empty: {order}")));
    }
    Ok(())
}
