//! The loops of a profile whose values are predicted, and what a model says of them.
//!
//! The cycles of a segment are alike, and so are the repeats of a block: the model plays two of each.

use std::collections::BTreeMap;
use std::ops::ControlFlow;

use super::next_run::PredictError;
use crate::model::Plant;
use crate::profile::accept::{CycleValue, LimitSide};
use crate::profile::{Profile, ProfileLimits, Segment};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::cycles::{CycleMeter, CycleSummary};
use crate::recording::{Flags, Sample};
use crate::twin::{Predicted, dry_run_with};
use crate::units::Mode;

/// Values of a loop that are predicted.
pub(crate) const VALUES: usize = 4;
/// Cycles of a segment, and repeats of a block, that are played.
const PLAYED: u32 = 2;
/// Most stretches of cycles that get limits; a profile with more is judged in the first ones.
const MOST_STRETCHES: usize = 40;

/// The largest or the smallest value of some cycles: what a limit is about.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LoopVariable {
    /// First and last counted cycle; `None` for the whole motion of a profile that counts none.
    pub cycles: Option<[u32; 2]>,
    pub value: CycleValue,
    /// `Max` for the largest value, of which a limit is the upper one.
    pub side: LimitSide,
}

/// A profile with the variables that are predicted.
#[derive(Debug, Clone)]
pub(crate) struct ProfileLoops {
    pub variables: Vec<LoopVariable>,
    /// The profile without the cycles that are like others.
    short: Profile,
    /// Cycles of `short` that stand for each variable.
    played: Vec<Option<[u32; 2]>>,
}

/// What the loops of one run measured, by the number of the cycle; the whole motion has the number 0.
pub(crate) type LoopValues = BTreeMap<u32, LoopMeasurement>;

/// The values of one loop that can be predicted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LoopMeasurement {
    pub force_n: [f64; 2],
    pub displacement_mm: [f64; 2],
    pub loop_energy_j: f64,
    pub secant_rate_n_per_mm: f64,
}

impl LoopMeasurement {
    /// `None` if the loop has no rate.
    fn of(c: &CycleSummary) -> Option<LoopMeasurement> {
        Some(LoopMeasurement {
            force_n: [c.force_n.valley, c.force_n.peak],
            displacement_mm: [c.displacement_mm.valley, c.displacement_mm.peak],
            loop_energy_j: c.loop_energy_j,
            secant_rate_n_per_mm: c.secant_rate_n_per_mm?,
        })
    }

    fn value(&self, value: CycleValue) -> f64 {
        match value {
            CycleValue::ForcePeak => self.force_n[1],
            CycleValue::ForceValley => self.force_n[0],
            CycleValue::DisplacementPeak => self.displacement_mm[1],
            CycleValue::DisplacementValley => self.displacement_mm[0],
            CycleValue::LoopEnergy => self.loop_energy_j,
            CycleValue::SecantRate => self.secant_rate_n_per_mm,
            _ => f64::NAN,
        }
    }

    /// Change of a value if the force were wrong by its whole range. The error differs between the two branches of a loop, so it
    /// changes the area of the loop.
    fn of_full_misfit(&self, value: CycleValue) -> f64 {
        let (range_n, travel_mm) = (
            self.force_n[1] - self.force_n[0],
            self.displacement_mm[1] - self.displacement_mm[0],
        );
        match value {
            CycleValue::ForcePeak | CycleValue::ForceValley => range_n,
            CycleValue::DisplacementPeak | CycleValue::DisplacementValley => travel_mm,
            CycleValue::LoopEnergy => crate::units::joules_from_nmm(range_n * travel_mm),
            _ => std::f64::consts::SQRT_2 * range_n / travel_mm,
        }
    }
}

/// The values that a mode leaves free: a rig that controls one channel reaches its levels whatever the specimen is.
fn free_values(mode: Mode) -> [CycleValue; VALUES] {
    use CycleValue::{DisplacementPeak, DisplacementValley, ForcePeak, ForceValley, LoopEnergy, SecantRate};
    match mode {
        Mode::Displacement => [ForcePeak, ForceValley, LoopEnergy, SecantRate],
        Mode::Force => [DisplacementPeak, DisplacementValley, LoopEnergy, SecantRate],
    }
}

/// Cycles that are alike: their numbers in the profile, and those of the ones that are played.
#[derive(Debug, Clone, Copy, PartialEq)]
struct AlikeCycles {
    of: (usize, usize),
    cycles: [u32; 2],
    played: [u32; 2],
}

impl ProfileLoops {
    /// The loops of a profile: each segment of cycles is a stretch of its own, and a profile without counted cycles is one loop.
    pub(crate) fn of(profile: &Profile) -> ProfileLoops {
        let (short, mut stretches) = shortened(profile);
        stretches.truncate(MOST_STRETCHES);
        let mut loops: Vec<_> = stretches
            .iter()
            .map(|s| (Some(s.cycles), Some(s.played)))
            .collect();
        if loops.is_empty() {
            loops.push((None, None));
        }
        let (mut variables, mut played) = (Vec::new(), Vec::new());
        for (cycles, of_short) in loops {
            for value in free_values(profile.mode) {
                for side in [LimitSide::Min, LimitSide::Max] {
                    variables.push(LoopVariable { cycles, value, side });
                    played.push(of_short);
                }
            }
        }
        ProfileLoops {
            variables,
            short,
            played,
        }
    }

    /// Each variable in a run that was measured; `None` if one of its cycles is missing.
    pub(crate) fn measured(&self, run: &LoopValues) -> Option<Vec<f64>> {
        let of = |variable: &LoopVariable| extreme(run, variable, variable.cycles);
        self.variables.iter().map(of).collect()
    }

    /// Each variable as a model says, and what a misfit by the whole range of the force would change in it.
    pub(crate) fn played(
        &self,
        plant: &dyn Plant,
        limits: &ProfileLimits,
    ) -> Result<Vec<[f64; 2]>, PredictError> {
        let run = play(&self.short, plant, limits)?;
        let of = |(variable, played): (&LoopVariable, &Option<[u32; 2]>)| {
            let first = run.get(&played.map_or(0, |[first, _]| first))?;
            Some([
                extreme(&run, variable, *played)?,
                first.of_full_misfit(variable.value),
            ])
        };
        let all: Option<Vec<[f64; 2]>> = self.variables.iter().zip(&self.played).map(of).collect();
        all.ok_or_else(|| PredictError::NoMotion {
            profile: self.short.name.clone(),
        })
    }
}

/// The largest or smallest value of some cycles; `None` if one is missing.
fn extreme(run: &LoopValues, variable: &LoopVariable, cycles: Option<[u32; 2]>) -> Option<f64> {
    let [first, last] = cycles.unwrap_or([0, 0]);
    let mut all = (first..=last).map(|cycle| run.get(&cycle).map(|l| l.value(variable.value)));
    all.try_fold(f64::NAN, |extreme, value| {
        let value = value?;
        Some(match variable.side {
            LimitSide::Min => value.min(extreme),
            LimitSide::Max => value.max(extreme),
        })
    })
}

/// The profile with at most [`PLAYED`] cycles and repeats, and its stretches of cycles.
fn shortened(profile: &Profile) -> (Profile, Vec<AlikeCycles>) {
    let mut short = profile.clone();
    let mut stretches: Vec<AlikeCycles> = Vec::new();
    let (mut next, mut next_played) = (1, 1);
    for (b, (block, short)) in profile.blocks.iter().zip(&mut short.blocks).enumerate() {
        short.repeat = block.repeat.min(PLAYED);
        for segment in &mut short.segments {
            if let Segment::Cycles(cycles) = segment {
                cycles.cycles = cycles.cycles.min(PLAYED);
            }
        }
        let mut of_repeat: Vec<[u32; 2]> = Vec::new();
        for repeat in 0..block.repeat {
            let is_played = repeat < PLAYED;
            let counted = block
                .segments
                .iter()
                .enumerate()
                .filter_map(|(s, segment)| match segment {
                    Segment::Cycles(cycles) => Some((s, cycles.cycles)),
                    _ => None,
                });
            if is_played {
                of_repeat.clear();
            }
            for (n, (s, count)) in counted.enumerate() {
                if is_played {
                    let last = next_played + count.min(PLAYED) - 1;
                    of_repeat.push([next_played, last]);
                    next_played = last + 1;
                }
                let stretch = AlikeCycles {
                    of: (b, s),
                    cycles: [next, next + count - 1],
                    played: of_repeat[n],
                };
                next += count;
                match stretches.last_mut() {
                    Some(last) if last.of == stretch.of => {
                        last.cycles[1] = stretch.cycles[1];
                        last.played[1] = stretch.played[1];
                    }
                    _ => stretches.push(stretch),
                }
            }
        }
    }
    (short, stretches)
}

/// Plays a profile on a model and measures its loops.
fn play(profile: &Profile, plant: &dyn Plant, limits: &ProfileLimits) -> Result<LoopValues, PredictError> {
    let rate_hz = f64::from(SAMPLE_RATE_HZ);
    let (mut counted, mut whole) = (CycleMeter::default(), CycleMeter::default());
    let mut loops: Vec<CycleSummary> = Vec::new();
    let mut tick = 0;
    dry_run_with(profile, plant, limits, rate_hz, &mut |predicted| {
        tick += 1;
        let sample = sample(tick, rate_hz, predicted);
        loops.extend(counted.add(&sample));
        whole.add(&Sample { cycle: 1, ..sample });
        ControlFlow::Continue(())
    })?;
    loops.extend(counted.finish(true));
    let whole = whole.finish(true).map(|whole| CycleSummary { cycle: 0, ..whole });
    Ok(loop_values(loops.iter().chain(&whole)))
}

/// The values of some loops by the number of their cycle.
pub(crate) fn loop_values<'c>(loops: impl Iterator<Item = &'c CycleSummary>) -> LoopValues {
    loops
        .filter_map(|c| Some((c.cycle, LoopMeasurement::of(c)?)))
        .collect()
}

fn sample(tick: u64, rate_hz: f64, p: &Predicted) -> Sample {
    Sample {
        tick,
        time_s: tick as f64 / rate_hz,
        force_n: p.force_n,
        displacement_mm: p.displacement_mm,
        force_counts: 0,
        displacement_counts: 0,
        command: Some(p.slot.command),
        cycle: p.slot.cycle,
        segment: p.slot.segment,
        twin_force_n: None,
        flags: Flags::default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model;

    const LIMITS: ProfileLimits = ProfileLimits::EXAMPLE;

    fn profile(blocks: &str) -> Profile {
        Profile::from_toml(
            &format!("name = \"p\"\ncontrol = \"displacement\"\n{blocks}"),
            "p",
        )
        .expect("a profile")
    }

    fn sine(amplitude_mm: f64, cycles: u32) -> String {
        format!(
            "[[block.segment]]\nkind = \"sine\"\nmean_mm = 10.0\namplitude_mm = {amplitude_mm:?}\nfrequency_hz = 1.0\n\
             cycles = {cycles}\ntaper_cycles = 1\n"
        )
    }

    const TO_MEAN: &str = "[[block]]\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 10.0\nduration_s = 1.0\n";

    fn played(profile: &Profile) -> (ProfileLoops, Vec<f64>) {
        let loops = ProfileLoops::of(profile);
        let plant = model::find("equivalent").expect("there");
        let plant = plant
            .plant(&[0.0, 80.0, 0.1, 0.2], &toml::Table::new())
            .expect("built");
        let values = loops.played(plant.as_ref(), &LIMITS).expect("played");
        (loops, values.into_iter().map(|[value, _]| value).collect())
    }

    #[test]
    fn each_segment_of_cycles_has_limits_over_its_cycles_whatever_is_played_of_them() {
        let text = format!("{TO_MEAN}[[block]]\nrepeat = 3\n{}{}", sine(2.0, 5), sine(4.0, 1));
        let (loops, _) = played(&profile(&text));
        let mut cycles: Vec<[u32; 2]> = loops.variables.iter().filter_map(|v| v.cycles).collect();
        cycles.dedup();
        assert_eq!(cycles, [[1, 5], [6, 6], [7, 11], [12, 12], [13, 17], [18, 18]]);
        let mut shown = loops.played.clone();
        shown.dedup();
        // The third repeat is like the second.
        let [first, second, third] = [[[1, 2], [3, 3]], [[4, 5], [6, 6]], [[4, 5], [6, 6]]];
        assert_eq!(
            shown,
            [first, second, third]
                .concat()
                .into_iter()
                .map(Some)
                .collect::<Vec<_>>()
        );
        let alone = format!("{TO_MEAN}[[block]]\nrepeat = 300\n{}", sine(2.0, 5));
        let (loops, values) = played(&profile(&alone));
        assert!(loops.variables.iter().all(|v| v.cycles == Some([1, 1500])) && values.len() == 8);
    }

    #[test]
    fn the_model_says_what_each_loop_will_measure() {
        let (loops, values) = played(&profile(&format!("{TO_MEAN}[[block]]\n{}", sine(4.0, 3))));
        let of = |value, side| {
            let is = |v: &LoopVariable| v.value == value && v.side == side;
            values[loops.variables.iter().position(is).expect("there")]
        };
        // 14 mm on the way up, 6 mm on the way down; with friction that follows within 0.2 mm.
        assert!((of(CycleValue::ForcePeak, LimitSide::Max) - 80.0 * 14.0 * 1.1).abs() < 1.0);
        assert!((of(CycleValue::ForceValley, LimitSide::Min) - 80.0 * 6.0 * 0.9).abs() < 1.0);
        // 2 * 0.1 * 800 N * 8 mm = 1.28 J, less what the reversals round off.
        let energy = of(CycleValue::LoopEnergy, LimitSide::Max);
        assert!((1.15..1.28).contains(&energy), "{energy}");
    }

    #[test]
    fn a_profile_without_cycles_is_one_loop() {
        let (loops, values) = played(&profile(TO_MEAN));
        assert!(loops.variables.iter().all(|v| v.cycles.is_none()));
        assert_eq!(values.len(), 8);
        let measured = LoopMeasurement {
            force_n: [0.0, 880.0],
            displacement_mm: [0.0, 10.0],
            loop_energy_j: 4.4,
            secant_rate_n_per_mm: 88.0,
        };
        let run = LoopValues::from([(0, measured)]);
        let values = loops.measured(&run).expect("whole");
        assert_eq!(values[2..4], [0.0, 0.0]);
        assert_eq!(loops.measured(&LoopValues::new()), None);
    }
}
