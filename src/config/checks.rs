//! What a bench config may say: ranges that follow from the sensors, and plausibility against slips of unit (N for kN, m for
//! mm), which put a limit a thousandfold off.

use super::file::Document;
use super::{Bench, BenchLimits, ConfigError, LinkConfig, ModelConfig};
use crate::link::{address_forms, is_address};
use crate::model;
use crate::protocol::message::COUNTS_MAX;

/// Everything that does not need another file.
pub(super) fn bench(document: &Document, bench: &Bench) -> Result<(), ConfigError> {
    if bench.name.trim().is_empty() {
        return Err(document.refuse("name", "is empty: name the bench"));
    }
    if bench.specimen.name.trim().is_empty() {
        return Err(document.refuse("specimen.name", "is empty: name the specimen"));
    }
    link(document, &bench.link)?;
    channels(document, bench)?;
    limits(document, bench)?;
    if !bench.daemon.listen.ip().is_loopback() {
        let reason = format!("{} is reachable from outside: use 127.0.0.1", bench.daemon.listen);
        return Err(document.refuse("daemon.listen", reason));
    }
    if bench.daemon.data_folder.as_os_str().is_empty() {
        return Err(document.refuse("daemon.data_folder", "is empty: name a folder for the runs"));
    }
    Ok(())
}

/// Name, parameters and structure build a plant.
pub(super) fn model(document: &Document, key: &str, config: &ModelConfig) -> Result<(), ConfigError> {
    let found =
        model::find(&config.name).map_err(|e| document.refuse(&format!("{key}.name"), e.to_string()))?;
    for (name, value) in &config.parameters {
        let key = format!("{key}.parameters.{name}");
        let index = found
            .parameter_index(name)
            .map_err(|e| document.refuse(&key, e.to_string()))?;
        let [low, high] = found.parameters.get(index).map_or([0.0, 0.0], |p| p.bounds);
        within(document, &key, *value, low, high, "the model's bounds")?;
    }
    config
        .plant()
        .map(|_| ())
        .map_err(|e| document.refuse(&format!("{key}.structure"), e.to_string()))
}

fn link(document: &Document, link: &LinkConfig) -> Result<(), ConfigError> {
    if !is_address(&link.address) {
        let reason = format!("\"{}\" is no link: write {}", link.address, address_forms());
        return Err(document.refuse("link.address", reason));
    }
    within(
        document,
        "link.node",
        f64::from(link.node),
        1.0,
        126.0,
        "the nodes of a bus",
    )?;
    within(
        document,
        "link.queue_lead_ms",
        link.queue_lead_ms as f64,
        40.0,
        200.0,
        "what the rig's queue holds",
    )?;
    within(
        document,
        "link.silence_ms",
        link.silence_ms as f64,
        5.0,
        500.0,
        "a silence that can be told from a late frame and still trips in time",
    )
}

fn channels(document: &Document, bench: &Bench) -> Result<(), ConfigError> {
    let (f, d) = (&bench.force_channel, &bench.displacement_channel);
    let force = [
        "n_per_count",
        "sign",
        "offset_n",
        "capacity_n",
        "noise_n",
        "calibrated",
        "due",
    ];
    let displacement = [
        "mm_per_count",
        "sign",
        "offset_mm",
        "capacity_mm",
        "noise_mm",
        "calibrated",
        "due",
    ];
    let rows = [
        (
            "force_channel",
            force,
            [f.n_per_count, f.offset_n, f.capacity_n, f.noise_n],
            f.sign,
            [&f.calibrated, &f.due],
        ),
        (
            "displacement_channel",
            displacement,
            [d.mm_per_count, d.offset_mm, d.capacity_mm, d.noise_mm],
            d.sign,
            [&d.calibrated, &d.due],
        ),
    ];
    for (table, keys, [scale, offset, capacity, noise], sign, [calibrated, due]) in rows {
        let key = |i: usize| format!("{table}.{}", keys[i]);
        positive(document, &key(0), scale)?;
        if sign.abs() != 1 {
            return Err(document.refuse(&key(1), format!("{sign} is no sign: write 1 or -1")));
        }
        let wire = scale * f64::from(COUNTS_MAX);
        let why = "a quarter to all of what the wire's counts reach at this scale";
        within(document, &key(3), capacity, 0.25 * wire, wire, why)?;
        within(
            document,
            &key(2),
            offset,
            -0.2 * capacity,
            0.2 * capacity,
            "a fifth of the capacity",
        )?;
        within(
            document,
            &key(4),
            noise,
            1e-7 * capacity,
            0.01 * capacity,
            "0.1 ppm to 1 % of the capacity",
        )?;
        for (i, date) in [(5, calibrated), (6, due)] {
            if date.parse::<jiff::civil::Date>().is_err() {
                return Err(document.refuse(&key(i), format!("\"{date}\" is no date: write YYYY-MM-DD")));
            }
        }
        if due <= calibrated {
            return Err(document.refuse(
                &key(6),
                format!("{due} is not after the calibration: check both dates"),
            ));
        }
    }
    Ok(())
}

fn limits(document: &Document, bench: &Bench) -> Result<(), ConfigError> {
    let l: &BenchLimits = &bench.limits;
    let (cell_n, lvdt_mm) = (
        bench.force_channel.capacity_n,
        bench.displacement_channel.capacity_mm,
    );
    if l.force_max_n > cell_n {
        let reason = format!(
            "force limit {} N is above the load cell's {cell_n} N: lower it or enter the larger cell",
            l.force_max_n
        );
        return Err(document.refuse("limits.force_max_n", reason));
    }
    let cell = "1 to 100 % of the load cell's capacity";
    let lvdt = "1 to 100 % of the LVDT's range";
    let below = "0.5 to 100 % of the range below zero, clear of noise and drift";
    // key, value, least, most, what the range is. Each is narrower than a factor of 1000 around any sensible value.
    let rows = [
        ("force_max_n", l.force_max_n, 0.01 * cell_n, cell_n, cell),
        ("force_min_n", l.force_min_n, -cell_n, -0.005 * cell_n, below),
        (
            "displacement_max_mm",
            l.displacement_max_mm,
            0.01 * lvdt_mm,
            lvdt_mm,
            lvdt,
        ),
        (
            "displacement_min_mm",
            l.displacement_min_mm,
            -lvdt_mm,
            -0.005 * lvdt_mm,
            below,
        ),
        (
            "velocity_max_mm_s",
            l.velocity_max_mm_s,
            5.0,
            1000.0,
            "what a bench of this kind does",
        ),
        (
            "acceleration_max_mm_s2",
            l.acceleration_max_mm_s2,
            100.0,
            50_000.0,
            "what a bench of this kind does",
        ),
        (
            "following_error_mm",
            l.following_error_mm,
            0.002 * lvdt_mm,
            0.2 * lvdt_mm,
            "0.2 to 20 % of the LVDT's range",
        ),
        (
            "following_error_n",
            l.following_error_n,
            0.002 * cell_n,
            0.2 * cell_n,
            "0.2 to 20 % of the cell's capacity",
        ),
        (
            "unload_velocity_mm_s",
            l.unload_velocity_mm_s,
            0.1,
            20.0,
            "a gentle unload",
        ),
        (
            "unloaded_force_n",
            l.unloaded_force_n,
            5e-4 * cell_n,
            0.05 * cell_n,
            "0.05 to 5 % of the cell's capacity",
        ),
        (
            "retract_mm",
            l.retract_mm,
            l.displacement_min_mm,
            -0.25,
            "the lower displacement limit and clear of the specimen",
        ),
        (
            "lease_ms",
            f64::from(l.lease_ms),
            20.0,
            500.0,
            "two lost leases and a rig that still reacts",
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
            "what the 100 ms of the queue allow",
        ),
        (
            "tare_max_n",
            l.tare_max_n,
            0.001 * cell_n,
            0.2 * cell_n,
            "0.1 to 20 % of the cell's capacity",
        ),
        (
            "tare_max_mm",
            l.tare_max_mm,
            0.001 * lvdt_mm,
            0.5 * lvdt_mm,
            "0.1 to 50 % of the LVDT's range",
        ),
    ];
    for (key, value, low, high, why) in rows {
        within(document, &format!("limits.{key}"), value, low, high, why)?;
    }
    Ok(())
}

fn within(doc: &Document, key: &str, value: f64, low: f64, high: f64, why: &str) -> Result<(), ConfigError> {
    // A NaN is in no range.
    if value >= low && value <= high {
        return Ok(());
    }
    let reason =
        format!("{value} is outside {low} to {high} ({why}): check the unit and enter a value within");
    Err(doc.refuse(key, reason))
}

fn positive(document: &Document, key: &str, value: f64) -> Result<(), ConfigError> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(document.refuse(
        key,
        format!("{value} is not above 0: enter a positive number, and the direction as sign"),
    ))
}
