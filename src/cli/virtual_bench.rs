//! A whole bench in virtual time: mock rig, link in memory, control and recorders in one thread, as fast as it can.
//! Same bench, same profile, same seed: same bits.

use crate::config::Bench;
use crate::control::run::RunOrder;
use crate::control::{Phase, Refusal, Rig, RigStatus};
use crate::link::{Link, loopback};
use crate::mockrig::{MockRig, MockRigConfig, MockRigError};
use crate::model::BuildError;
use crate::recording::Recorder;

const MS: u64 = 1_000_000;
/// Progress is told this often in virtual time.
const PROGRESS_MS: u64 = 500;
/// The hello takes 30 ms; a rig that is not ready by then never will be.
const HELLO_MS: u64 = 3_000;
/// A tare needs half a second of samples.
const SETTLE_MS: u64 = 700;
/// An unload from the largest travel at the slowest speed.
const UNLOAD_MS: u64 = 60_000;

/// Why a bench cannot run in virtual time.
#[derive(Debug, thiserror::Error)]
pub enum VirtualBenchError {
    /// `[mock_rig]` of the bench file.
    #[error("[mock_rig] of bench {bench}: {reason}")]
    MockRigTable {
        /// Bench.
        bench: String,
        /// What the reader said.
        reason: String,
    },
    /// A number of the mock rig.
    #[error(transparent)]
    MockRig(#[from] MockRigError),
    /// The specimen's model.
    #[error("the specimen's model cannot be built")]
    Specimen(#[from] BuildError),
    /// Control refused the run.
    #[error("the run was refused")]
    Refused(#[from] Refusal),
    /// The bench did not get where it should.
    #[error("the bench is {phase:?} where {wanted:?} was expected: {notice}")]
    Stuck {
        /// Where it is.
        phase: Phase,
        /// Where it should be.
        wanted: Phase,
        /// What control says.
        notice: String,
    },
}

/// The mock rig that a bench file describes, with the specimen as its plant.
pub fn mock_rig(bench: &Bench) -> Result<MockRig, VirtualBenchError> {
    let mut table = bench.mock_rig.clone();
    table.insert("node".into(), toml::Value::Integer(i64::from(bench.link.node)));
    table.insert(
        "calibration_hash".into(),
        toml::Value::Integer(i64::from(bench.calibration_hash())),
    );
    let config: MockRigConfig =
        table
            .try_into()
            .map_err(|e: toml::de::Error| VirtualBenchError::MockRigTable {
                bench: bench.name.clone(),
                reason: e.message().to_owned(),
            })?;
    Ok(MockRig::new(&config, bench.specimen.model.plant()?)?)
}

/// Mock rig and control over a link in memory.
pub struct VirtualBench {
    /// The host's side.
    pub rig: Rig,
    /// The rig's side.
    pub mock: MockRig,
    host: Link,
    far: Link,
    now_ns: u64,
}

impl VirtualBench {
    /// The bench at the moment that both sides are switched on.
    pub fn new(bench: &Bench) -> Result<Self, VirtualBenchError> {
        let (host, far) = loopback::pair();
        Ok(VirtualBench {
            rig: Rig::new(bench.rig_config(1)),
            mock: mock_rig(bench)?,
            host,
            far,
            now_ns: 0,
        })
    }

    /// Virtual time in ns since the start.
    pub fn now_ns(&self) -> u64 {
        self.now_ns
    }

    /// One millisecond.
    pub fn tick(&mut self, recorder: &mut dyn Recorder) {
        self.now_ns += MS;
        self.mock.tick(&mut self.far);
        self.rig.poll(self.now_ns, &mut self.host, recorder);
    }

    /// Ticks until control is in `wanted`, at most `limit_ms`.
    pub fn until(
        &mut self,
        wanted: Phase,
        limit_ms: u64,
        recorder: &mut dyn Recorder,
        progress: &mut dyn FnMut(&RigStatus),
    ) -> Result<(), VirtualBenchError> {
        for ms in 0..limit_ms {
            if self.rig.phase() == wanted {
                return Ok(());
            }
            if ms % PROGRESS_MS == 0 {
                progress(&self.rig.status());
            }
            self.tick(recorder);
        }
        Err(VirtualBenchError::Stuck {
            phase: self.rig.phase(),
            wanted,
            notice: self.rig.status().notice,
        })
    }

    /// Connects, tares, runs the order and unloads. How the run ended is told to `recorder`.
    pub fn run(
        &mut self,
        order: RunOrder,
        recorder: &mut dyn Recorder,
        progress: &mut dyn FnMut(&RigStatus),
    ) -> Result<(), VirtualBenchError> {
        self.until(Phase::Ready, HELLO_MS, recorder, progress)?;
        for _ in 0..SETTLE_MS {
            self.tick(recorder);
        }
        self.rig.tare()?;
        for _ in 0..SETTLE_MS {
            self.tick(recorder);
        }
        let limit_ms = (order.header.duration_planned_s * 1e3) as u64 + UNLOAD_MS;
        self.rig.start(order)?;
        self.until(Phase::Running, HELLO_MS, recorder, progress)?;
        let ended = |phase| matches!(phase, Phase::Ready | Phase::Interlocked);
        for ms in 0..limit_ms {
            if ended(self.rig.phase()) {
                return Ok(());
            }
            if ms % PROGRESS_MS == 0 {
                progress(&self.rig.status());
            }
            self.tick(recorder);
        }
        Err(VirtualBenchError::Stuck {
            phase: self.rig.phase(),
            wanted: Phase::Ready,
            notice: self.rig.status().notice,
        })
    }
}
