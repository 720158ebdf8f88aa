//! Figures of a bench for control and twin.

use super::{Bench, BenchLimits};
use crate::control::RigConfig;
use crate::control::channel::Channels;
use crate::control::detectors::DetectorLimits;
use crate::control::physical_limits::PhysicalLimits;
use crate::twin::Noise;

/// Commands sent in one cycle of the control loop: fills the queue in 50 ms and keeps the load of the bus below one half.
const COMMANDS_PER_POLL: u32 = 3;
/// Time after which a request is repeated (fault F5), as in firmware-protocol.md.
const ACK_TIMEOUT_MS: u64 = 20;
/// A tare is refused if a channel spreads more than this many times its calibrated noise.
const STILL_SIGMAS: f64 = 5.0;

impl Bench {
    /// Noise of the two channels including the rounding to counts: the residual of a correct twin stays within it.
    pub(crate) fn noise(&self) -> Noise {
        let (force, displacement) = (&self.force_channel, &self.displacement_channel);
        let rounding = |step: f64| step / 12f64.sqrt();
        Noise {
            force_n: force.noise_n.hypot(rounding(force.n_per_count)),
            displacement_mm: displacement.noise_mm.hypot(rounding(displacement.mm_per_count)),
        }
    }

    /// Figures for [`crate::control::Rig`]. `session`: 1 to 255, a new one for each start of the program.
    pub(crate) fn rig_config(&self, session: u8) -> RigConfig {
        let channels = Channels {
            force: self.force_channel.scale(),
            displacement: self.displacement_channel.scale(),
        };
        RigConfig {
            node: self.link.node,
            session,
            channels,
            limits: self.limits.physical(),
            calibration_hash: self.calibration_hash(),
            queue_lead_ms: self.link.queue_lead_ms,
            commands_per_poll: COMMANDS_PER_POLL,
            ack_timeout_ms: ACK_TIMEOUT_MS.max(self.link.silence_ms),
            detectors: DetectorLimits {
                silence_ms: self.link.silence_ms,
                // A bench that allows the samples a longer silence allows it the status too.
                status_silence_ms: DetectorLimits::default()
                    .status_silence_ms
                    .max(self.link.silence_ms),
                ..DetectorLimits::default()
            },
            tare_limit_n: self.limits.tare_max_n,
            tare_limit_mm: self.limits.tare_max_mm,
            still_sigma_n: STILL_SIGMAS * self.force_channel.noise_n,
            still_sigma_mm: STILL_SIGMAS * self.displacement_channel.noise_mm,
        }
    }
}

impl BenchLimits {
    /// The limits that the firmware enforces.
    pub(crate) fn physical(&self) -> PhysicalLimits {
        PhysicalLimits {
            force_max_n: self.force_max_n,
            force_min_n: self.force_min_n,
            displacement_max_mm: self.displacement_max_mm,
            displacement_min_mm: self.displacement_min_mm,
            velocity_max_mm_s: self.velocity_max_mm_s,
            following_error_mm: self.following_error_mm,
            following_error_n: self.following_error_n,
            lease_ms: self.lease_ms,
            hold_timeout_ms: self.hold_timeout_ms,
            unload_velocity_mm_s: self.unload_velocity_mm_s,
            queue_low_ms: self.queue_low_ms,
            unloaded_force_n: self.unloaded_force_n,
            retract_mm: self.retract_mm,
        }
    }
}
