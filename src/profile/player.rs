//! Plays a profile: one command per tick. It is computed from the number of the tick, so that end levels are exact and no
//! rounding accumulates. A slot is due at the end of its tick: 60 s at 1 kHz are slots 1 to 60 000, and the last one is the
//! end level. Sending slots, measuring cycles and stopping is left to `control`.

use std::f64::consts::TAU;

use super::correction::{Correction, CycleTarget};
use super::pieces::{self, CyclicMotion, Piece, PieceMotion};
use super::shape::{self, interpolate, smoother};
use super::{Profile, ProfileError};
use crate::units::{Command, Mode};

/// The command of one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Slot {
    pub command: Command,
    /// Number of the counted cycle in the profile, from 1; 0 outside the counted cycles.
    pub cycle: u32,
    /// Number of the segment, from 1, repeats written out.
    pub segment: u32,
    /// Phase within a cycle of a sine or triangle, above 0 to 1; 0 outside.
    pub phase: f64,
    /// True for the last slot of the profile.
    pub last: bool,
}

/// Part of a cycle in which a new correction is blended in: it is complete at the first peak of a sine.
const BLEND_PHASE: f64 = 0.25;
/// Mean speed of the approach of a resumed test, divided by the peak speed of the sine.
const APPROACH_SPEED: f64 = 0.1;
/// Shortest duration of that approach in s.
const APPROACH_LEAST_S: f64 = 2.0;

/// Plays one profile. `next` does not allocate and does not wait.
#[derive(Debug, Clone)]
pub(crate) struct Player {
    name: String,
    mode: Mode,
    sample_rate_hz: f64,
    start_level: f64,
    pieces: Vec<Piece>,
    total_cycles: u32,
    total_ticks: u64,
    elapsed: u64,
    piece: usize,
    tick_in_piece: u64,
    cycle_in_piece: Option<u64>,
    in_force: Correction,
    blend_to: Correction,
    pending: Option<Correction>,
}

impl Player {
    /// Resolves levels, repeats and ticks. `start_level` is the measured level of the rig, in the unit of the profile's mode.
    pub(crate) fn new(
        profile: &Profile,
        start_level: f64,
        sample_rate_hz: f64,
    ) -> Result<Player, ProfileError> {
        let (pieces, total_cycles) = pieces::resolve(profile, start_level, sample_rate_hz)?;
        Ok(Player {
            name: profile.name.clone(),
            mode: profile.mode,
            sample_rate_hz,
            start_level,
            total_ticks: pieces.iter().map(|p| p.ticks).sum(),
            pieces,
            total_cycles,
            elapsed: 0,
            piece: 0,
            tick_in_piece: 0,
            cycle_in_piece: None,
            in_force: Correction::NONE,
            blend_to: Correction::NONE,
            pending: None,
        })
    }

    /// Continues an interrupted test at counted cycle `cycle`: approach to the mean, growing taper, then the remaining cycles
    /// with their numbers. Call it before the first `next`.
    pub(crate) fn resume_at(mut self, cycle: u32) -> Result<Player, ProfileError> {
        let refusal = ProfileError::NoSuchCycle {
            name: self.name.clone(),
            cycle,
            total: self.total_cycles,
        };
        let holds = |p: &Piece| match &p.motion {
            PieceMotion::Cycles(c) => {
                (u64::from(c.first_cycle)..u64::from(c.first_cycle) + c.counted).contains(&u64::from(cycle))
            }
            _ => false,
        };
        let Some(index) = self.pieces.iter().position(holds) else {
            return Err(refusal);
        };
        self.pieces.drain(..index);
        let rate = self.sample_rate_hz;
        let Some(Piece {
            motion: PieceMotion::Cycles(cyclic),
            ticks,
            ..
        }) = self.pieces.first_mut()
        else {
            return Err(refusal);
        };
        let skipped = u64::from(cycle - cyclic.first_cycle);
        let all = cyclic.cycles();
        cyclic.first_cycle = cycle;
        cyclic.counted -= skipped;
        *ticks = (*ticks as f64 * cyclic.cycles() as f64 / all as f64).round() as u64;
        let (mean, speed) = (
            cyclic.target.mean,
            TAU * cyclic.frequency_hz * cyclic.target.amplitude,
        );
        let duration_s = ((mean - self.start_level).abs() / (APPROACH_SPEED * speed)).max(APPROACH_LEAST_S);
        let approach = Piece {
            segment: self.pieces.first().map_or(0, |p| p.segment),
            from: self.start_level,
            to: mean,
            ticks: (duration_s * rate).round() as u64,
            motion: PieceMotion::Approach,
        };
        self.pieces.insert(0, approach);
        self.total_ticks = self.pieces.iter().map(|p| p.ticks).sum();
        Ok(self)
    }

    /// The command for the next tick; `None` after the last.
    #[allow(
        clippy::should_implement_trait,
        reason = "not an iterator: corrections come between two slots"
    )]
    pub(crate) fn next(&mut self) -> Option<Slot> {
        while self
            .pieces
            .get(self.piece)
            .is_some_and(|p| self.tick_in_piece == p.ticks)
        {
            self.piece += 1;
            self.tick_in_piece = 0;
            self.cycle_in_piece = None;
            (self.in_force, self.blend_to, self.pending) = (Correction::NONE, Correction::NONE, None);
        }
        let piece = self.pieces.get(self.piece)?;
        self.tick_in_piece += 1;
        self.elapsed += 1;
        let mut slot = Slot {
            command: Command::new(self.mode, piece.to),
            cycle: 0,
            segment: piece.segment,
            phase: 0.0,
            last: self.elapsed == self.total_ticks,
        };
        let ends = self.tick_in_piece == piece.ticks;
        let share = self.tick_in_piece as f64 / piece.ticks as f64;
        let value = match &piece.motion {
            PieceMotion::Cycles(cyclic) => {
                let (cyclic, ticks, to) = (*cyclic, piece.ticks, piece.to);
                let value = self.cyclic_value(&cyclic, ticks, &mut slot);
                if ends { to } else { value }
            }
            _ if ends => piece.to,
            PieceMotion::Line => piece.from + (piece.to - piece.from) * share,
            PieceMotion::Approach => piece.from + (piece.to - piece.from) * smoother(share),
            PieceMotion::Table { time_s, level, base } => {
                base + interpolate(time_s, level, self.tick_in_piece as f64 / self.sample_rate_hz)
            }
        };
        slot.command = Command::new(self.mode, value);
        Some(slot)
    }

    fn cyclic_value(&mut self, cyclic: &CyclicMotion, ticks: u64, slot: &mut Slot) -> f64 {
        let cycles = cyclic.cycles();
        // In whole numbers, because a piece has a whole number of ticks for all its cycles together: the phase does not drift.
        let done = self.tick_in_piece * cycles;
        let index = (done - 1) / ticks;
        let phase = (done - index * ticks) as f64 / ticks as f64;
        let counted = index >= cyclic.taper && index < cyclic.taper + cyclic.counted;
        let shrinking = index >= cyclic.taper + cyclic.counted;
        if self.cycle_in_piece != Some(index) {
            self.cycle_in_piece = Some(index);
            self.in_force = self.blend_to;
            // While the amplitude shrinks, the correction fades with it and no new one is used.
            if let Some(next) = self.pending.take().filter(|_| !shrinking) {
                self.blend_to = next;
            }
        }
        slot.phase = phase;
        if counted {
            slot.cycle = cyclic.first_cycle + (index - cyclic.taper) as u32;
        }
        let correction = self
            .in_force
            .blend(self.blend_to, smoother((phase / BLEND_PHASE).min(1.0)));
        let position = index as f64 + phase;
        let envelope = match cyclic.taper as f64 {
            taper if position < taper => smoother(position / taper),
            taper if shrinking => smoother(((cycles as f64 - position) / taper).clamp(0.0, 1.0)),
            _ => 1.0,
        };
        let fade = if shrinking { envelope } else { 1.0 };
        let wave = shape::wave(cyclic.wave, phase);
        cyclic.target.mean
            + correction.mean_offset * fade
            + cyclic.target.amplitude * correction.amplitude_factor * envelope * wave
    }

    /// Sets the correction from the next cycle on, blended in over its first quarter. It is ignored if it is not finite, if the
    /// factor is not positive, or if the segment is not corrected.
    pub(crate) fn set_correction(&mut self, correction: Correction) {
        let usable = correction.mean_offset.is_finite()
            && correction.amplitude_factor.is_finite()
            && correction.amplitude_factor > 0.0;
        if usable && self.current_target().is_some_and(|t| t.corrected) {
            self.pending = Some(correction);
        }
    }

    /// Target of the cycles in the segment of the last slot; `None` outside sines and triangles.
    fn current_target(&self) -> Option<CycleTarget> {
        self.pieces.get(self.piece).and_then(Piece::target)
    }

    /// Target of the cycles in segment `segment` (from 1), for samples that are older than the last slot.
    pub(crate) fn target_of(&self, segment: u32) -> Option<CycleTarget> {
        self.pieces
            .iter()
            .filter(|p| p.segment == segment)
            .find_map(Piece::target)
    }

    /// Number of counted cycles in the whole profile, those before a resumed cycle included.
    pub(crate) fn total_cycles(&self) -> u32 {
        self.total_cycles
    }

    /// Number of slots from start to end.
    pub(crate) fn total_ticks(&self) -> u64 {
        self.total_ticks
    }

    /// Number of slots so far.
    pub(crate) fn elapsed_ticks(&self) -> u64 {
        self.elapsed
    }

    /// Duration in s from start to end.
    pub(crate) fn duration_s(&self) -> f64 {
        self.total_ticks as f64 / self.sample_rate_hz
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::{Block, CycleSegment, Level, Segment, Wave};

    const RATE_HZ: f64 = 1000.0;

    fn profile(mode: Mode, segments: Vec<Segment>) -> Profile {
        let blocks = vec![Block { repeat: 1, segments }];
        Profile {
            name: "t".into(),
            description: String::new(),
            mode,
            blocks,
            accept: Vec::new(),
        }
    }

    fn sine(frequency_hz: f64, cycles: u32, taper_cycles: u32) -> Profile {
        let mean = Level::Absolute(20.0);
        let approach = Segment::Ramp {
            to: mean,
            duration_s: 4.0,
        };
        let sine = Segment::Cycles(CycleSegment {
            wave: Wave::Sine,
            mean,
            amplitude: 6.0,
            frequency_hz,
            cycles,
            taper_cycles,
            correct: true,
        });
        profile(Mode::Displacement, vec![approach, sine])
    }

    fn play(mut player: Player) -> Vec<Slot> {
        std::iter::from_fn(|| player.next()).collect()
    }

    #[test]
    fn a_ramp_ends_exactly_at_its_tick() {
        let up = Segment::Ramp {
            to: Level::Absolute(2000.0),
            duration_s: 60.0,
        };
        let down = Segment::Ramp {
            to: Level::Relative(-2000.0),
            duration_s: 60.0,
        };
        let slots = play(Player::new(&profile(Mode::Force, vec![up, down]), 0.3, RATE_HZ).unwrap());
        assert_eq!(slots.len(), 120_000);
        assert_eq!(slots[59_999].command, Command::Force(2000.0));
        assert_eq!(slots[119_999].command, Command::Force(0.0));
        assert_eq!((slots[59_999].segment, slots[60_000].segment), (1, 2));
        assert!(slots[119_999].last && !slots[119_998].last);
    }

    #[test]
    fn cycles_are_counted_at_full_amplitude_only() {
        // 1000 is not a multiple of 3 Hz: the cycles differ by a tick, but they do not drift.
        for frequency_hz in [1.0, 2.5, 3.0] {
            let slots = play(Player::new(&sine(frequency_hz, 50, 3), 0.0, RATE_HZ).unwrap());
            assert_eq!(
                slots.len(),
                4000 + (56.0 / frequency_hz * RATE_HZ).round() as usize
            );
            assert_eq!(slots.iter().map(|s| s.cycle).max(), Some(50));
            for cycle in [1, 7, 50] {
                let values: Vec<f64> = slots
                    .iter()
                    .filter(|s| s.cycle == cycle)
                    .map(|s| s.command.value())
                    .collect();
                assert!((values.len() as f64 - RATE_HZ / frequency_hz).abs() <= 1.0);
                let peak = values.iter().fold(f64::MIN, |m, v| m.max(*v));
                // A peak between two samples is low by at most 1 - cos(pi f / rate) of the amplitude.
                assert!(
                    (peak - 26.0).abs() < 6.0 * 5e-5,
                    "{frequency_hz} Hz cycle {cycle}: {peak}"
                );
            }
            assert_eq!(slots.last().unwrap().command.value(), 20.0);
        }
    }

    #[test]
    fn sine_with_tapers_and_corrections_is_smooth() {
        let mut player = Player::new(&sine(2.5, 12, 2), 20.0, RATE_HZ).unwrap();
        let mut values = vec![20.0];
        let mut n = 0;
        while let Some(slot) = player.next() {
            if slot.segment == 2 {
                values.push(slot.command.value());
                n += 1;
                if n % 700 == 0 {
                    let sign = if n % 1400 == 0 { 1.0 } else { -1.0 };
                    player.set_correction(Correction {
                        amplitude_factor: 1.0 + 0.08 * sign,
                        mean_offset: 0.3 * sign,
                    });
                }
            }
        }
        let second = values
            .windows(3)
            .fold(0.0, |m: f64, w| m.max((w[2] - 2.0 * w[1] + w[0]).abs()));
        // A omega^2 is 1480 mm/s2; a change of 16 % of the amplitude and 0.6 mm within a tenth of a second adds about as much.
        let bound = 2.0 * 6.0 * (TAU * 2.5_f64).powi(2) / (RATE_HZ * RATE_HZ);
        assert!(second < bound, "second difference {second} mm, bound {bound} mm");
        // At rest at both ends: the first and the last step are of third order.
        assert!((values[1] - values[0]).abs() < 1e-6);
        assert!((values[values.len() - 1] - values[values.len() - 2]).abs() < 1e-6);
    }

    #[test]
    fn a_correction_waits_for_the_next_cycle() {
        let mut player = Player::new(&sine(1.0, 5, 1), 20.0, RATE_HZ).unwrap();
        let correction = Correction {
            amplitude_factor: 1.1,
            mean_offset: -0.2,
        };
        let mut peaks = [f64::MIN; 6];
        while let Some(slot) = player.next() {
            if slot.cycle == 2 && slot.phase == 0.1 {
                player.set_correction(correction);
                assert_eq!(player.blend_to, Correction::NONE);
            }
            let peak = &mut peaks[slot.cycle as usize];
            *peak = peak.max(slot.command.value());
        }
        assert_eq!(peaks[2], 26.0);
        // The blend is complete at the first peak.
        assert!((peaks[3] - (20.0 - 0.2 + 6.6)).abs() < 1e-9, "{}", peaks[3]);
        assert_eq!(peaks[5], peaks[4]);
    }

    #[test]
    fn a_resumed_profile_continues_the_cycle_numbers() {
        let player = Player::new(&sine(1.0, 50, 2), 0.0, RATE_HZ)
            .unwrap()
            .resume_at(31)
            .unwrap();
        assert_eq!(player.total_cycles(), 50);
        let slots = play(player);
        let counted: Vec<u32> = slots.iter().map(|s| s.cycle).filter(|&c| c > 0).collect();
        assert_eq!(
            (counted.len(), counted[0], *counted.last().unwrap()),
            (20_000, 31, 50)
        );
        assert!(slots[0].command.value().abs() < 1e-6);
        let jump = slots.windows(2).fold(0.0, |m: f64, w| {
            m.max((w[1].command.value() - w[0].command.value()).abs())
        });
        // The largest step is that of the sine: A omega / rate = 0.038 mm.
        assert!(jump < 0.04, "{jump}");
        let refused = Player::new(&sine(1.0, 50, 2), 0.0, RATE_HZ)
            .unwrap()
            .resume_at(51);
        assert!(matches!(
            refused,
            Err(ProfileError::NoSuchCycle {
                cycle: 51,
                total: 50,
                ..
            })
        ));
    }

    #[test]
    fn a_profile_that_would_begin_with_a_step_is_refused() {
        let mut p = sine(1.0, 5, 2);
        p.blocks[0].segments.remove(0);
        let first = Player::new(&p, 0.012, RATE_HZ).unwrap_err();
        assert!(matches!(first, ProfileError::Step { segment: 1, .. }));
        assert!(
            first
                .to_string()
                .contains("begins at 20 but the run starts at 0.012"),
            "{first}"
        );
        let mut later = sine(1.0, 5, 2);
        later.blocks[0].segments[0] = Segment::Hold { duration_s: 1.0 };
        let second = Player::new(&later, 0.0, RATE_HZ).unwrap_err().to_string();
        assert!(
            second.contains("begins at 20 but the one before ends at 0"),
            "{second}"
        );
        assert!(Player::new(&p, 20.0, RATE_HZ).is_ok());
        assert!(matches!(
            Player::new(&sine(1.0, 5, 0), 0.0, RATE_HZ),
            Err(ProfileError::Value { .. })
        ));
    }

    #[test]
    fn a_rig_that_stands_near_the_first_level_is_led_there_and_one_far_away_is_refused() {
        let shipped = include_str!("../../bench-configs/profiles/table.toml");
        let table = Profile::from_toml(shipped, "table").unwrap();
        // A count of the LVDT, what an unload leaves, the whole of the lead-in.
        for (start, lead_in_ticks) in [(-0.0005, 100), (0.25, 500), (1.0, 2000)] {
            let slots = play(Player::new(&table, start, RATE_HZ).unwrap());
            assert_eq!(slots.len(), 16_000 + lead_in_ticks, "from {start} mm");
            let level = |slot: &Slot| slot.command.value();
            assert_eq!(level(&slots[lead_in_ticks - 1]), 0.0);
            // 12 mm in 4 s: the table itself begins with 0.003 mm for each tick.
            assert!((level(&slots[lead_in_ticks]) - 0.003).abs() < 1e-12);
            assert!(slots.iter().all(|s| s.segment == 1 && s.cycle == 0));
            let mut before = start;
            for slot in &slots[..lead_in_ticks] {
                // 15/8 of the mean speed of 0.5 mm/s at the middle of the S-curve.
                assert!((level(slot) - before).abs() < 0.5e-3 * 1.9, "from {start} mm");
                before = level(slot);
            }
        }
        assert_eq!(play(Player::new(&table, 0.0, RATE_HZ).unwrap()).len(), 16_000);
        let far = Player::new(&table, 1.01, RATE_HZ).unwrap_err();
        assert!(matches!(far, ProfileError::Step { segment: 1, .. }), "{far}");
    }

    #[test]
    fn the_lead_in_of_a_force_profile_is_in_newtons_and_moves_no_segment_number() {
        let text = "name = \"f\"\ncontrol = \"force\"\n[[block]]\n[[block.segment]]\nkind = \"sine\"\nmean_n = 0.0\n\
                    amplitude_n = 5.0\nfrequency_hz = 1.0\ncycles = 2\n[[block.segment]]\nkind = \"hold\"\nduration_s = 1.0\n";
        let profile = Profile::from_toml(text, "f").unwrap();
        let slots = play(Player::new(&profile, 18.0, RATE_HZ).unwrap());
        // 18 of 50 N in 2 s are 0.72 s; 2 + 2 * 2 cycles of taper; 1 s.
        assert_eq!(slots.len(), 720 + 6000 + 1000);
        assert_eq!(
            (slots[0].segment, slots[719].segment, slots[720].segment),
            (1, 1, 1)
        );
        assert_eq!(slots.last().unwrap().segment, 2);
        assert!(Player::new(&profile, 51.0, RATE_HZ).is_err());
    }

    #[test]
    fn a_table_is_joined_by_straight_lines() {
        let table = Segment::Table {
            time_s: vec![0.0, 1.0, 3.0],
            level: vec![0.0, 5.0, -1.0],
            relative: true,
        };
        let p = profile(Mode::Displacement, vec![table]);
        let slots = play(Player::new(&p, 2.0, RATE_HZ).unwrap());
        assert_eq!(slots.len(), 3000);
        assert_eq!(slots[999].command.value(), 7.0);
        assert_eq!(slots[1999].command.value(), 4.0);
        assert_eq!(slots[2999].command.value(), 1.0);
    }
}
