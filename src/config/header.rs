//! The head of a run, as far as the bench knows it.

use super::Bench;
use crate::profile::{Player, Profile, ProfileError};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::{FirmwareIdentity, Header};

impl Bench {
    /// Head of a fresh run of `profile`. Control fills in what the rig says of itself; operator, resumed run and
    /// remarks are the caller's.
    pub fn header(
        &self,
        run_id: &str,
        started_utc: &str,
        profile: &Profile,
        profile_toml: &str,
    ) -> Result<Header, ProfileError> {
        let sample_rate_hz = f64::from(SAMPLE_RATE_HZ);
        let player = Player::new(profile, 0.0, sample_rate_hz)?;
        Ok(Header {
            run_id: run_id.to_owned(),
            started_utc: started_utc.to_owned(),
            specimen: self.specimen.name.clone(),
            operator: String::new(),
            profile_name: profile.name.clone(),
            profile_toml: profile_toml.to_owned(),
            bench_toml: self.to_toml(),
            bench_sha256: self.sha256(),
            firmware: FirmwareIdentity::default(),
            program_version: env!("CARGO_PKG_VERSION").to_owned(),
            sample_rate_hz,
            force_channel: self.force_channel.scale(),
            displacement_channel: self.displacement_channel.scale(),
            twin: self.model.name.clone(),
            first_cycle: 1,
            resumes_run: String::new(),
            cycles_planned: player.total_cycles(),
            duration_planned_s: player.duration_s(),
            remarks: Vec::new(),
        })
    }
}
