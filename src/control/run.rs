//! One run of a profile: which command is due at which tick, to which cycle a sample belongs, and the correction of
//! amplitude and mean from cycle to cycle.

use std::collections::VecDeque;

use super::detectors::Expected;
use crate::profile::{
    Correction, CycleController, CycleMeasurement, CycleTarget, Player, Profile, ProfileError, Slot,
};
use crate::recording::{Ending, Header, Outcome};
use crate::units::{Command, Mode};

/// Slots that the host keeps: the commands ahead of the rig and the newest that were due.
const KEPT_SLOTS: usize = 1024;

/// After a jog the rig keeps its position so long for the next one, s. Then it unloads.
pub(super) const JOG_KEEP_S: f64 = 10.0;

/// The order to start a run.
#[derive(Debug, Clone)]
pub(crate) struct RunOrder {
    /// Header of the recording. Control fills in firmware and channels.
    pub header: Header,
    /// The profile to play.
    pub profile: Profile,
    /// Counted cycle to begin with; 1 for a fresh test.
    pub first_cycle: u32,
}

/// What a motion without a recording is for. It is a run of one slow ramp, with all detectors and limits on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum SlowMotion {
    /// The return to the tared zero of the LVDT.
    Zero,
    /// A small step that a person asked for.
    Jog,
}

impl SlowMotion {
    /// The motion in words, as the subject of a sentence.
    pub(crate) fn words(self) -> &'static str {
        match self {
            SlowMotion::Zero => "a return to zero",
            SlowMotion::Jog => "a jog",
        }
    }
}

/// A cycle of a periodic segment that is complete.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct EndedCycle {
    /// Counted cycle; 0 in a taper.
    pub cycle: u32,
    /// Number of the segment in the expanded profile, from 1.
    pub segment: u32,
    /// Target amplitude and mean of the segment.
    pub target: CycleTarget,
    /// Peak and valley of feedback and command.
    pub measured: CycleMeasurement,
}

/// Turns of the control loop that came late.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LateTurns {
    /// Number of these turns.
    pub count: u64,
    /// Longest pause between two turns, ms.
    pub worst_ms: u64,
    /// The operator has been told.
    pub told: bool,
}

impl LateTurns {
    /// Counts a turn that came `gap_ms` after the one before.
    pub(super) fn count(&mut self, gap_ms: u64) {
        self.count += 1;
        self.worst_ms = self.worst_ms.max(gap_ms);
    }
}

/// A run under way.
#[derive(Debug)]
pub(crate) struct Run {
    /// Header of the recording.
    pub header: Header,
    /// What the run is for, if it is not recorded.
    pub motion: Option<SlowMotion>,
    /// Turns of control that came late in this run.
    pub late_turns: LateTurns,
    profile: Profile,
    player: Player,
    /// Commands that a hold dropped; they are played before the player goes on.
    replay: VecDeque<Slot>,
    /// Segment that is corrected, and its controller.
    controller: Option<(u32, CycleController)>,
    first_tick: u64,
    /// First tick since the start or the last resume.
    from_tick: u64,
    newest_tick: u64,
    /// Tick that the next command is for.
    next_tick: u64,
    /// Tick of the last command, once the player has ended.
    last_tick: Option<u64>,
    /// The newest commands with their ticks, at the index tick modulo [`KEPT_SLOTS`].
    planned: Vec<Option<(u64, Slot)>>,
    tracker: CycleTracker,
    cycles_completed: u32,
    samples: u64,
    lost: u64,
    late: u64,
    held: bool,
    /// Tick at which the rig began to hold.
    held_at: u64,
}

impl Run {
    /// A run whose time begins at `first_tick`, from `start_level` in the profile's unit.
    pub(crate) fn new(order: RunOrder, start_level: f64, first_tick: u64) -> Result<Self, ProfileError> {
        let player = player_from(
            &order.profile,
            start_level,
            order.header.sample_rate_hz,
            order.first_cycle,
        )?;
        let start = Slot {
            command: Command::new(order.profile.mode, start_level),
            cycle: 0,
            segment: 1,
            phase: 0.0,
            last: false,
        };
        Ok(Run {
            header: order.header,
            motion: None,
            late_turns: LateTurns::default(),
            profile: order.profile,
            player,
            replay: VecDeque::from([start]),
            controller: None,
            first_tick,
            from_tick: first_tick,
            newest_tick: first_tick,
            next_tick: first_tick,
            last_tick: None,
            planned: vec![None; KEPT_SLOTS],
            tracker: CycleTracker::default(),
            cycles_completed: order.first_cycle.saturating_sub(1),
            samples: 0,
            lost: 0,
            late: 0,
            held: false,
            held_at: first_tick,
        })
    }

    /// The channel under control.
    pub(crate) fn mode(&self) -> Mode {
        self.profile.mode
    }

    /// Tick of the run's first sample.
    pub(crate) fn first_tick(&self) -> u64 {
        self.first_tick
    }

    /// Tick of the newest sample of the run.
    pub(crate) fn newest_tick(&self) -> u64 {
        self.newest_tick
    }

    /// What the rig must be doing; nothing while it holds.
    pub(crate) fn expected(&self) -> Option<Expected> {
        (!self.held).then_some(Expected {
            from_tick: self.from_tick,
            last_tick: self.last_tick,
        })
    }

    /// Time of a tick in the run in s; negative before its start.
    pub(crate) fn time_s(&self, tick: u64) -> f64 {
        (tick as f64 - self.first_tick as f64) / self.header.sample_rate_hz
    }

    /// The next command, if it is due by the tick `horizon`.
    pub(crate) fn next_command(&mut self, horizon: u64) -> Option<(u64, Slot)> {
        if self.held || self.last_tick.is_some() || self.next_tick > horizon {
            return None;
        }
        let slot = self.replay.pop_front().or_else(|| self.player.next())?;
        let tick = self.next_tick;
        self.planned[tick as usize % KEPT_SLOTS] = Some((tick, slot));
        self.next_tick += 1;
        if slot.last {
            self.last_tick = Some(tick);
        }
        Some((tick, slot))
    }

    /// The command that was sent for a tick.
    pub(crate) fn due(&self, tick: u64) -> Option<Slot> {
        self.planned[tick as usize % KEPT_SLOTS]
            .filter(|(t, _)| *t == tick)
            .map(|(_, s)| s)
    }

    /// True once the last tick of the profile has passed.
    pub(crate) fn is_finished(&self, tick: u64) -> bool {
        self.last_tick.is_some_and(|last| tick >= last)
    }

    /// Counts a sample that the link delivered too late.
    pub(crate) fn count_late(&mut self) {
        self.late += 1;
    }

    /// Counts the sample of `tick` and follows the cycles; `feedback` is `None` where the reading cannot be used. Returns a cycle that ended.
    pub(crate) fn on_sample(
        &mut self,
        tick: u64,
        slot: Option<&Slot>,
        feedback: Option<f64>,
        lost: u64,
    ) -> Option<EndedCycle> {
        self.newest_tick = tick;
        self.samples += 1;
        self.lost += lost;
        let target = slot.and_then(|s| self.player.target_of(s.segment));
        let ended = self.tracker.follow(slot.zip(target), feedback)?;
        self.cycles_completed = self.cycles_completed.max(ended.cycle);
        Some(ended)
    }

    /// Corrects amplitude and mean after a cycle that ended. Returns the new correction if it changed.
    pub(crate) fn correct(&mut self, ended: &EndedCycle) -> Option<Correction> {
        if !ended.target.corrected || self.held {
            return None;
        }
        if self
            .controller
            .as_ref()
            .is_none_or(|(segment, _)| *segment != ended.segment)
        {
            self.controller = Some((ended.segment, CycleController::new(ended.target)));
        }
        let (_, controller) = self.controller.as_mut()?;
        let before = controller.correction();
        let next = controller.cycle(&ended.measured);
        self.player.set_correction(next);
        (next != before).then_some(next)
    }

    /// Stops the commands, because the rig holds from `tick` on, until [`Run::resume`].
    pub(crate) fn hold(&mut self, tick: u64) {
        if self.held {
            return;
        }
        self.held = true;
        self.held_at = tick;
        let in_cycle = self
            .due(tick)
            .is_some_and(|s| self.player.target_of(s.segment).is_some());
        self.replay = match in_cycle {
            // An interrupted sine tapers in again, so no command is played twice.
            true => VecDeque::new(),
            false => (tick + 1..self.next_tick).filter_map(|t| self.due(t)).collect(),
        };
        self.tracker = CycleTracker {
            interrupted: in_cycle,
            ..CycleTracker::default()
        };
    }

    /// Seconds from the begin of the hold to `tick`; nothing while the run does not hold.
    pub(crate) fn held_s(&self, tick: u64) -> Option<f64> {
        let ticks = tick.saturating_sub(self.held_at);
        self.held.then(|| ticks as f64 / self.header.sample_rate_hz)
    }

    /// Plays another profile from the newest command on. What was sent ahead of it is still done.
    pub(crate) fn turn_to(&mut self, profile: Profile) -> Result<(), ProfileError> {
        let newest = self.due(self.next_tick.saturating_sub(1));
        let start = newest.or(self.replay.front().copied());
        let level = start.map_or(0.0, |slot| slot.command.value());
        self.player = Player::new(&profile, level, self.header.sample_rate_hz)?;
        self.profile = profile;
        if newest.is_some() {
            self.replay.clear();
        }
        self.last_tick = None;
        Ok(())
    }

    /// Level of the newest command, from which [`Run::turn_to`] goes on; nothing before the first one.
    pub(crate) fn newest_level(&self) -> Option<f64> {
        self.due(self.next_tick.saturating_sub(1))
            .map(|slot| slot.command.value())
    }

    /// True between hold and resume.
    pub(crate) fn is_held(&self) -> bool {
        self.held
    }

    /// Goes on from `level` at `tick`. A sine tapers in again and repeats the interrupted cycle; any other segment goes on
    /// where it was interrupted.
    pub(crate) fn resume(&mut self, tick: u64, level: f64) -> Result<(), ProfileError> {
        let cycle = self.cycles_completed + 1;
        self.last_tick = None;
        if self.tracker.interrupted && cycle > self.player.total_cycles() {
            // All counted cycles are done; only the taper out was interrupted.
            self.last_tick = Some(tick);
        } else if self.tracker.interrupted {
            self.player = player_from(&self.profile, level, self.header.sample_rate_hz, cycle)?;
            self.controller = None;
        }
        self.tracker = CycleTracker::default();
        self.from_tick = tick;
        self.next_tick = tick;
        self.held = false;
        Ok(())
    }

    /// Samples recorded so far.
    pub(crate) fn samples(&self) -> u64 {
        self.samples
    }

    /// Counted cycles completed, including those of the test that is resumed.
    pub(crate) fn cycles_completed(&self) -> u32 {
        self.cycles_completed
    }

    /// Counted cycles of the whole profile.
    pub(crate) fn cycles_total(&self) -> u32 {
        self.player.total_cycles()
    }

    /// Seconds of the run after `tick`.
    pub(crate) fn remaining_s(&self, tick: u64) -> f64 {
        let unplayed = self
            .player
            .total_ticks()
            .saturating_sub(self.player.elapsed_ticks());
        let queued = self.next_tick.saturating_sub(tick.max(self.first_tick));
        (unplayed + self.replay.len() as u64 + queued) as f64 / self.header.sample_rate_hz
    }

    /// The outcome of this run if it ends now.
    pub(crate) fn outcome(&self, ending: Ending, cause: &str) -> Outcome {
        Outcome {
            ending,
            cause: cause.to_owned(),
            samples: self.samples,
            lost: self.lost,
            late: self.late,
            cycles_completed: self.cycles_completed,
            unsaved: None,
            punctuality: None,
        }
    }
}

fn player_from(profile: &Profile, level: f64, rate_hz: f64, cycle: u32) -> Result<Player, ProfileError> {
    let player = Player::new(profile, level, rate_hz)?;
    if cycle > 1 {
        player.resume_at(cycle)
    } else {
        Ok(player)
    }
}

/// Follows feedback and command through the cycles of periodic segments.
#[derive(Debug, Default)]
struct CycleTracker {
    /// The cycle under way.
    open: Option<EndedCycle>,
    last_phase: f64,
    /// A hold interrupted a cycle.
    interrupted: bool,
}

impl CycleTracker {
    /// Takes one sample. A cycle ends when the phase wraps or the periodic segment ends.
    fn follow(&mut self, due: Option<(&Slot, CycleTarget)>, feedback: Option<f64>) -> Option<EndedCycle> {
        let Some((slot, target)) = due else {
            return self.open.take();
        };
        let wrapped = slot.phase < self.last_phase || self.open.is_some_and(|o| o.segment != slot.segment);
        self.last_phase = slot.phase;
        let ended = if wrapped { self.open.take() } else { None };
        let command = slot.command.value();
        let open = self.open.get_or_insert(EndedCycle {
            cycle: slot.cycle,
            segment: slot.segment,
            target,
            measured: CycleMeasurement {
                peak: feedback.unwrap_or(command),
                valley: feedback.unwrap_or(command),
                command_peak: command,
                command_valley: command,
            },
        });
        let m = &mut open.measured;
        if let Some(feedback) = feedback {
            m.peak = m.peak.max(feedback);
            m.valley = m.valley.min(feedback);
        }
        m.command_peak = m.command_peak.max(command);
        m.command_valley = m.command_valley.min(command);
        ended
    }
}
