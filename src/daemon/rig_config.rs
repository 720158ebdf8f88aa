//! What control needs of a bench config.

use crate::config::Bench;
use crate::control::RigConfig;
use crate::control::channel::Channels;
use crate::control::limits::DetectorLimits;

/// Commands stand this far ahead in the rig's queue: the daemon may be late by as much.
const QUEUE_LEAD_MS: u64 = 100;
/// Fills the queue in 50 turns and keeps the bus below half of its load meanwhile.
const COMMANDS_PER_POLL: u32 = 2;
/// As the protocol has it (faults.md, F5).
const ACK_TIMEOUT_MS: u64 = 20;
/// A channel that spreads more than this many times its calibrated noise is not still.
const STILL_SIGMAS: f64 = 5.0;

/// Figures for [`crate::control::Rig`]. `session`: 1 to 255, another one after each start of the program.
pub fn rig_config(bench: &Bench, session: u8) -> RigConfig {
    let channels =
        Channels { force: bench.force_channel.scale(), displacement: bench.displacement_channel.scale() };
    RigConfig {
        node: bench.link.node,
        session,
        channels,
        limits: bench.wire_limits(&channels.force, &channels.displacement),
        calibration_hash: bench.calibration_hash(),
        queue_lead_ms: QUEUE_LEAD_MS,
        commands_per_poll: COMMANDS_PER_POLL,
        ack_timeout_ms: ACK_TIMEOUT_MS,
        detectors: DetectorLimits::default(),
        tare_limit_n: bench.limits.tare_max_n,
        tare_limit_mm: bench.limits.tare_max_mm,
        still_sigma_n: STILL_SIGMAS * bench.force_channel.noise_n,
        still_sigma_mm: STILL_SIGMAS * bench.displacement_channel.noise_mm,
    }
}
