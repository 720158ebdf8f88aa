//! Makes the header of a recording from bench and profile.

use crate::config::Bench;
use crate::profile::Profile;
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::{FirmwareIdentity, Header};

/// Length of a profile as it was planned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Planned {
    /// Number of counted cycles.
    pub cycles: u32,
    pub duration_s: f64,
}

/// The header of a run that begins at `now`. Control later adds the firmware and the channel scalings that are in use.
pub(crate) fn new(
    run_id: String,
    now: jiff::Timestamp,
    bench: &Bench,
    profile: &Profile,
    profile_toml: String,
    planned: Planned,
) -> Header {
    Header {
        run_id,
        started_utc: now.strftime("%Y-%m-%dT%H:%M:%S%.3fZ").to_string(),
        specimen: bench.specimen.name.clone(),
        operator: String::new(),
        profile_name: profile.name.clone(),
        profile_toml,
        bench_toml: bench.to_toml(),
        bench_sha256: bench.sha256(),
        firmware: FirmwareIdentity::default(),
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        sample_rate_hz: f64::from(SAMPLE_RATE_HZ),
        force_channel: bench.force_channel.scale(),
        displacement_channel: bench.displacement_channel.scale(),
        force_sensor: bench.force_channel.sensor(),
        displacement_sensor: bench.displacement_channel.sensor(),
        twin: bench.model.name.clone(),
        first_cycle: 1,
        resumes_run: String::new(),
        cycles_planned: planned.cycles,
        duration_planned_s: planned.duration_s,
        remarks: Vec::new(),
        continues: String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs are listed by their start: two of one second must differ.
    #[test]
    fn the_start_has_milliseconds() {
        let profile = Profile::from_toml(include_str!("../../bench-configs/profiles/static-ramp.toml"), "p");
        let bench = Bench::shipped().expect("built in");
        let planned = Planned {
            cycles: 0,
            duration_s: 1.0,
        };
        let started = |ms: i64| {
            let now = jiff::Timestamp::from_millisecond(ms).expect("a time");
            let profile = profile.as_ref().expect("shipped");
            new("run".to_owned(), now, &bench, profile, String::new(), planned).started_utc
        };
        assert_eq!(started(1_007), "1970-01-01T00:00:01.007Z");
        assert!(started(1_007) < started(1_010) && started(1_010) < started(2_000));
    }
}
