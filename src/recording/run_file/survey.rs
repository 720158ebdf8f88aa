//! One pass over all samples of a run file: counts, gaps, cycles, and whether the file is what was written.

use super::samples::{Gap, GapCause, SampleReader};
use crate::recording::cycle_follower::{CycleFollower, CyclePlace};
use crate::recording::{Ending, Flags, Outcome, Sample};
use crate::units::{Command, Mode};

/// Ticks of one counted cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct CycleSpan {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// Tick of its first sample.
    pub first_tick: u64,
    /// Tick of its last sample.
    pub last_tick: u64,
    /// True if the run went on after it: it ran to its end.
    pub complete: bool,
    /// True if a hold lies within it, after which it went on. A cycle that was repeated after a hold is two spans.
    pub held: bool,
}

impl CycleSpan {
    /// True if the sample belongs to this piece of the cycle.
    pub(crate) fn has(&self, sample: &Sample) -> bool {
        sample.cycle == self.cycle && (self.first_tick..=self.last_tick).contains(&sample.tick)
    }
}

/// Result of one pass. `samples + lost + damaged + unsaved` = ticks from first to last.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Survey {
    /// Number of readable samples.
    pub samples: u64,
    /// Number of ticks whose sample did not arrive.
    pub lost: u64,
    /// Number of samples that the link delivered too late.
    pub late: u64,
    /// Number of ticks in damaged blocks.
    pub damaged: u64,
    /// Number of ticks whose sample could not be written to the disk.
    pub unsaved: u64,
    /// Number of samples with any flag except [`Flags::AFTER_GAP`].
    pub flagged: u64,
    /// First and last tick of the run.
    pub ticks: Option<(u64, u64)>,
    /// Lost, damaged and unsaved ranges in order.
    pub gaps: Vec<Gap>,
    /// Counted cycles in order.
    pub cycles: Vec<CycleSpan>,
    /// Control modes of the commands, in the order of first use.
    pub modes: Vec<Mode>,
    /// What in the file is not what was written, one sentence each; empty if it is whole.
    pub damage: Vec<String>,
    follower: CycleFollower,
}

impl Survey {
    /// Reads all samples once.
    pub(super) fn of(mut reader: SampleReader, outcome: Option<&Outcome>) -> Survey {
        let mut survey = Survey::default();
        let mut ticks: Option<(u64, u64)> = None;
        for sample in reader.by_ref() {
            survey.add(&sample);
            ticks = Some((ticks.map_or(sample.tick, |(first, _)| first), sample.tick));
        }
        survey.gaps = reader.gaps;
        for gap in &survey.gaps {
            *match gap.cause {
                GapCause::Lost => &mut survey.lost,
                GapCause::Damaged => &mut survey.damaged,
                GapCause::Unsaved => &mut survey.unsaved,
            } += gap.ticks();
            let (first, last) = ticks.unwrap_or((gap.from_tick, gap.to_tick));
            ticks = Some((first.min(gap.from_tick), last.max(gap.to_tick)));
        }
        survey.ticks = ticks;
        // If the profile ends with a counted cycle, only the outcome says that it is complete.
        let completed = outcome.is_some_and(|outcome| outcome.ending == Ending::Completed);
        let ended = survey.follower.finish(completed);
        survey.end_cycle(ended);
        survey
    }

    /// Counted cycles that ran to their end.
    pub(crate) fn cycles_completed(&self) -> u32 {
        self.cycles.iter().filter(|cycle| cycle.complete).count() as u32
    }

    /// The samples of a cycle: of one that was repeated after a hold, the last piece.
    pub(crate) fn span_of(&self, cycle: u32) -> Option<&CycleSpan> {
        self.cycles.iter().rfind(|span| span.cycle == cycle)
    }

    /// The complete cycles without a hold: those that can be laid over each other tick by tick.
    pub(crate) fn unbroken_cycles(&self) -> impl Iterator<Item = &CycleSpan> {
        self.cycles.iter().filter(|span| span.complete && !span.held)
    }

    /// Why an export of this file is not all that the run recorded, as sentences; empty if it is.
    pub(crate) fn incomplete(&self) -> String {
        let unsaved = (self.unsaved > 0).then(|| format!("{} samples are not on the disk", self.unsaved));
        self.damage
            .iter()
            .cloned()
            .chain(unsaved)
            .collect::<Vec<_>>()
            .join("; ")
    }

    /// Ticks without a readable sample, for whatever reason.
    pub(crate) fn missing(&self) -> u64 {
        self.lost + self.damaged + self.unsaved
    }

    fn add(&mut self, sample: &Sample) {
        self.samples += 1;
        let other_bits = sample.flags.difference(Flags::AFTER_GAP);
        self.flagged += u64::from(!other_bits.is_empty());
        self.late += u64::from(sample.flags.contains(Flags::LATE));
        if let Some(mode) = sample.command.map(Command::mode)
            && !self.modes.contains(&mode)
        {
            self.modes.push(mode);
        }
        let (place, ended) = self.follower.add(sample);
        self.end_cycle(ended);
        match (place, self.cycles.last_mut()) {
            (CyclePlace::First, _) => self.cycles.push(CycleSpan {
                cycle: sample.cycle,
                first_tick: sample.tick,
                last_tick: sample.tick,
                complete: false,
                held: false,
            }),
            (CyclePlace::Further { after_hold }, Some(span)) => {
                span.last_tick = sample.tick;
                span.held |= after_hold;
            }
            _ => {}
        }
    }

    /// Notes whether the last cycle is complete, if it has ended.
    fn end_cycle(&mut self, ended: Option<bool>) {
        if let (Some(complete), Some(span)) = (ended, self.cycles.last_mut()) {
            span.complete = complete;
        }
    }
}
