//! Samples, events and recordings: what a run leaves behind, and the trait [`Recorder`] that passes a run on while it lasts.
//! Files are in `run_file`, `csv` and `mdf`, exports in `export`; control, twin and models are elsewhere.

pub(crate) mod atomic_file;
mod channel;
mod check;
pub(crate) mod columns;
pub(crate) mod csv;
mod cycle_follower;
pub(crate) mod cycles;
pub(crate) mod datapackage;
pub(crate) mod export;
pub(crate) mod import;
pub(crate) mod mdf;
pub(crate) mod memory;
pub(crate) mod metrics;
pub(crate) mod overlay;
pub(crate) mod play;
pub(crate) mod punctuality;
pub(crate) mod recorder;
pub(crate) mod run_file;
pub(crate) mod run_recording;
mod stream_event;
pub(crate) mod xml;

use crate::units::Command;

pub(crate) use channel::{ChannelScale, SensorIdentity};
pub use check::RecordingError;
pub(crate) use punctuality::RunPunctuality;
pub(crate) use stream_event::{StreamEvent, StreamFinding};

bitflags::bitflags! {
    /// Quality of one sample; empty = good. CSV and run file hold the sum of the bits.
    #[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
    pub(crate) struct Flags: u16 {
        /// One or more samples before this one did not arrive.
        const AFTER_GAP = 1 << 0;
        /// The link delivered the sample later than the fastest ones by more than its `silence_ms`. Time that it waited in this
        /// computer does not count.
        const LATE = 1 << 1;
        /// The load cell is at its rail or open.
        const FORCE_INVALID = 1 << 2;
        /// The LVDT is at its rail or open.
        const DISPLACEMENT_INVALID = 1 << 3;
        /// A value did not change although the piston or the command moved (fault X3).
        const STUCK = 1 << 4;
        /// A value jumped faster than the channel can change (fault X4).
        const SPIKE = 1 << 5;
        /// The rig had no command for this tick (queue empty, hold, taper to a stop).
        const NO_COMMAND = 1 << 6;
        /// Motion of a stop, a hold or an unload, not of the profile.
        const NOT_PROFILE = 1 << 7;
    }
}

impl Flags {
    /// Samples with any of these bits are left out of cycle values, mean loops, fits and diagnoses.
    pub(crate) const UNUSABLE: Flags = Flags::FORCE_INVALID
        .union(Flags::DISPLACEMENT_INVALID)
        .union(Flags::STUCK)
        .union(Flags::SPIKE);
}

/// One sample of a run in physical units, with the counts it came from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sample {
    /// The rig's tick without the overflow of the wire: it rises by one per sample period from the boot of the rig.
    pub tick: u64,
    /// Seconds since the run's first sample: (tick - first tick) / sample rate.
    pub time_s: f64,
    /// Force in N after calibration and tare; positive loads the spring.
    pub force_n: f64,
    /// Displacement in mm after calibration and tare; positive loads the spring.
    pub displacement_mm: f64,
    /// Load-cell counts as received.
    pub force_counts: i32,
    /// LVDT counts as received.
    pub displacement_counts: i32,
    /// The command that was due at this tick.
    pub command: Option<Command>,
    /// Counted cycle, from 1; 0 outside the counted cycles.
    pub cycle: u32,
    /// Segment of the profile, from 1, repeats written out; 0 outside the profile.
    pub segment: u32,
    /// Force of the virtual twin at this displacement in N; `None` if the twin was off or late.
    pub twin_force_n: Option<f64>,
    /// Quality of this sample.
    pub flags: Flags,
}

/// What an event is about. The words are stable: scripts may rely on them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum EventKind {
    /// The run started.
    Start,
    /// A tare was taken: old, new, spread.
    Tare,
    /// Samples were lost: how many, where.
    Gap,
    /// Amplitude and mean correction of one cycle.
    Correction,
    /// The rig changed its state.
    RigState,
    /// A limit or a detector tripped.
    Limit,
    /// A fault of the link: frame dropped, error frame, queue full.
    Link,
    /// An operator's request: stop, hold, resume, reset.
    Operator,
    /// The twin's residual left its band.
    ModelMismatch,
    /// A fault of the host: late loop, slow disk.
    Host,
    /// The run ended.
    End,
}

impl EventKind {
    /// The word in files: the name in lower case with underscores.
    pub(crate) fn word(self) -> String {
        // An enum without fields always becomes a text.
        let value = serde_json::to_value(self).ok();
        value
            .and_then(|v| v.as_str().map(str::to_owned))
            .unwrap_or_default()
    }
}

/// Something that happened during a run.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Event {
    /// The rig's tick, as in [`Sample`].
    pub tick: u64,
    /// Seconds since the run's first sample; negative before it.
    pub time_s: f64,
    pub kind: EventKind,
    /// One sentence: what, where, what to do.
    pub text: String,
}

/// Head of a run: everything needed to read and to repeat it.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Header {
    /// Generated id: letters, digits and dashes only.
    pub run_id: String,
    /// Start, UTC, RFC 3339.
    pub started_utc: String,
    /// Name of the specimen, from the bench or from the request.
    pub specimen: String,
    /// Operator's name; may be empty.
    pub operator: String,
    pub profile_name: String,
    /// Text of the profile file as it was run.
    pub profile_toml: String,
    /// Text of the bench as it was run.
    pub bench_toml: String,
    /// Hex SHA-256 of `bench_toml`.
    pub bench_sha256: String,
    pub firmware: FirmwareIdentity,
    /// Version of leafbench.
    pub program_version: String,
    /// Samples per second.
    pub sample_rate_hz: f64,
    /// Load-cell scaling at the start of the run.
    pub force_channel: ChannelScale,
    /// LVDT scaling at the start of the run.
    pub displacement_channel: ChannelScale,
    /// Which load cell measured, and by which calibration.
    #[serde(default)]
    pub force_sensor: SensorIdentity,
    /// Which LVDT measured, and by which calibration.
    #[serde(default)]
    pub displacement_sensor: SensorIdentity,
    /// Name of the twin's model; empty without a twin.
    pub twin: String,
    /// Counted cycle at which the run starts: 1, or more where it resumes an interrupted test.
    pub first_cycle: u32,
    /// Id of the run that this one resumes; empty otherwise.
    pub resumes_run: String,
    /// Counted cycles of the profile.
    pub cycles_planned: u32,
    /// Planned length in seconds.
    pub duration_planned_s: f64,
    /// Limitations at the start (no real-time rights ...), one sentence each.
    pub remarks: Vec<String>,
    /// Run id of the file that this one continues after an error of the disk; empty otherwise.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub continues: String,
}

/// What the rig's firmware reported at the hello.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct FirmwareIdentity {
    /// CANopen vendor id (0x1018:1).
    pub vendor: u32,
    /// Product code (0x1018:2).
    pub product: u32,
    /// Firmware revision (0x1018:3), major << 16 | minor.
    pub revision: u32,
    /// Serial number (0x1018:4).
    pub serial: u32,
    /// Protocol version (0x2000), major << 16 | minor.
    pub protocol: u32,
    /// Boot id (0x2001); it changes when the firmware restarts.
    pub boot_id: u32,
    /// Calibration hash (0x2003).
    pub calibration_hash: u32,
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Ending {
    /// All segments ran.
    Completed,
    /// An operator stopped it; the data are kept.
    Stopped,
    /// A limit, the link or the host ended it.
    Aborted,
}

/// The end of a run: how, why, and how much was recorded.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Outcome {
    pub ending: Ending,
    /// Cause in a sentence; empty if completed.
    pub cause: String,
    /// Number of samples recorded.
    pub samples: u64,
    /// Number of ticks without a sample.
    pub lost: u64,
    /// Samples that the link delivered too late; 0 in files of earlier programs, which did not count them.
    #[serde(default)]
    pub late: u64,
    /// Counted cycles completed in this run.
    pub cycles_completed: u32,
    /// Samples that were recorded and are not on the disk; `None` if all are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unsaved: Option<Unsaved>,
    /// RunPunctuality of the control loop during the run; `None` in virtual time and in files of earlier programs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub punctuality: Option<RunPunctuality>,
}

impl Outcome {
    /// Number of samples that were recorded and are not on the disk.
    pub(crate) fn unsaved_samples(&self) -> u64 {
        self.unsaved.as_ref().map_or(0, |unsaved| unsaved.samples)
    }
}

/// Samples of a run that are not on the disk, because it could not be written.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Unsaved {
    /// Number of these samples.
    pub samples: u64,
    /// Tick of the first one.
    pub from_tick: u64,
    /// Tick of the last one.
    pub to_tick: u64,
    /// Why the disk could not be written.
    pub cause: String,
}

impl Unsaved {
    /// The same in words. `zero_tick` is the tick of time 0.
    pub(crate) fn text(&self, zero_tick: u64, sample_rate_hz: f64) -> String {
        let time_s = |tick: u64| (tick as f64 - zero_tick as f64) / sample_rate_hz;
        format!(
            "{} samples from {:.3} s to {:.3} s are not on the disk ({})",
            self.samples,
            time_s(self.from_tick),
            time_s(self.to_tick),
            self.cause
        )
    }
}

/// Receives a run while it lasts. Run file, twin and live view are recorders; none can delay or change a run.
pub(crate) trait Recorder {
    /// The run begins.
    fn begin(&mut self, header: &Header);
    /// The next sample, in the order of ticks.
    fn sample(&mut self, sample: &Sample);
    /// The next event, in the order of time.
    fn event(&mut self, event: &Event);
    /// The next event, not in words yet. A recorder that wraps another one on the control thread passes the call on, because
    /// words need an allocation.
    fn stream_event(&mut self, event: &StreamEvent) {
        self.event(&event.in_words());
    }
    /// The run is over.
    fn end(&mut self, outcome: &Outcome);
    /// A sample that no run records: the rig is heard, but idle. A recorder of a run ignores it.
    fn watch(&mut self, _sample: &Sample) {}
    /// Called about every 10 ms during a live run: what came so far must survive a kill of this process.
    /// A recorder that wraps another one passes the call on.
    fn flush(&mut self) {}
}

impl<R: Recorder + ?Sized> Recorder for Box<R> {
    fn begin(&mut self, header: &Header) {
        (**self).begin(header);
    }

    fn sample(&mut self, sample: &Sample) {
        (**self).sample(sample);
    }

    fn event(&mut self, event: &Event) {
        (**self).event(event);
    }

    fn stream_event(&mut self, event: &StreamEvent) {
        (**self).stream_event(event);
    }

    fn end(&mut self, outcome: &Outcome) {
        (**self).end(outcome);
    }

    fn watch(&mut self, sample: &Sample) {
        (**self).watch(sample);
    }

    fn flush(&mut self) {
        (**self).flush();
    }
}

/// A recording in memory, from this bench or from another program: columns of equal length, time strictly increasing.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Recording {
    /// File name or run id, for messages.
    pub name: String,
    /// Time in s, strictly increasing, evenly spaced or not.
    pub time_s: Vec<f64>,
    /// Displacement in mm.
    pub displacement_mm: Vec<f64>,
    /// Force in N.
    pub force_n: Vec<f64>,
    /// Command in the unit of `command_mode`, where recorded; NaN in rows without a command.
    pub command: Option<Vec<f64>>,
    /// Mode of the command column, where recorded.
    pub command_mode: Option<crate::units::Mode>,
    /// Counted cycle, 0 outside the counted cycles, where recorded.
    pub cycle: Option<Vec<u32>>,
    /// Quality bits of each sample (docs/formats.md), where recorded; those of another program may have more.
    pub flags: Option<Vec<u16>>,
}

impl Recording {
    /// Number of samples in every column.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True for a recording without samples.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Turns the sign of one channel or both. 0 stays 0 and does not become -0.
    pub(crate) fn turn_signs(&mut self, force: bool, displacement: bool) {
        let turn = |values: &mut Vec<f64>| values.iter_mut().for_each(|value| *value = 0.0 - *value);
        if force {
            turn(&mut self.force_n);
        }
        if displacement {
            turn(&mut self.displacement_mm);
        }
    }
}
