//! What control needs of a bench.

use super::Bench;
use crate::control::RigConfig;
use crate::control::channel::Channels;
use crate::control::limits::DetectorLimits;

/// Fills the queue in 50 ms and keeps the bus below half of its load meanwhile.
const COMMANDS_PER_POLL: u32 = 3;
/// As the protocol has it (faults.md, F5).
const ACK_TIMEOUT_MS: u64 = 20;
/// A channel that spreads more than this many times its calibrated noise is not still.
const STILL_SIGMAS: f64 = 5.0;

impl Bench {
    /// Figures for [`crate::control::Rig`]. `session`: 1 to 255, another one after each start of the program.
    pub fn rig_config(&self, session: u8) -> RigConfig {
        let channels = Channels {
            force: self.force_channel.scale(),
            displacement: self.displacement_channel.scale(),
        };
        RigConfig {
            node: self.link.node,
            session,
            channels,
            limits: self.wire_limits(&channels.force, &channels.displacement),
            calibration_hash: self.calibration_hash(),
            queue_lead_ms: self.link.queue_lead_ms,
            commands_per_poll: COMMANDS_PER_POLL,
            ack_timeout_ms: ACK_TIMEOUT_MS.max(self.link.silence_ms),
            detectors: DetectorLimits {
                silence_ms: self.link.silence_ms,
                ..DetectorLimits::default()
            },
            tare_limit_n: self.limits.tare_max_n,
            tare_limit_mm: self.limits.tare_max_mm,
            still_sigma_n: STILL_SIGMAS * self.force_channel.noise_n,
            still_sigma_mm: STILL_SIGMAS * self.displacement_channel.noise_mm,
        }
    }
}
