//! Cycles of a run: reversals larger than the noise, and peak, valley, energy and rate of each counted cycle. The numbers
//! themselves are defined in `metrics`.

use std::io::{self, Write};

use super::csv::push_fixed;
use super::cycle_follower::{CycleFollower, CyclePlace};
use super::metrics::{LoopIntegral, NrmseMeter, Range, secant_rate_n_per_mm};
use super::{Flags, Sample};

/// A reversal of a signal: peak or valley.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Reversal {
    /// Index of the extreme value, counted from the first value given.
    pub index: usize,
    /// The extreme value.
    pub value: f64,
    /// True for a peak, false for a valley.
    pub is_peak: bool,
}

/// Finds reversals value by value. An extreme value counts once the signal has come back from it by more than `band`.
/// The sign of the velocity is not used, because it is noisy.
#[derive(Debug, Clone)]
pub(crate) struct ReversalFinder {
    band: f64,
    next_index: usize,
    highest: Option<(usize, f64)>,
    lowest: Option<(usize, f64)>,
    rising: Option<bool>,
}

impl ReversalFinder {
    /// `band` in the signal's unit: more than its noise from peak to peak, less than the smallest motion of interest.
    pub(crate) fn new(band: f64) -> ReversalFinder {
        ReversalFinder {
            band,
            next_index: 0,
            highest: None,
            lowest: None,
            rising: None,
        }
    }

    /// Takes the next value; returns a reversal at the value that confirms it.
    pub(crate) fn add(&mut self, value: f64) -> Option<Reversal> {
        let here = (self.next_index, value);
        self.next_index += 1;
        let highest = self.highest.filter(|&(_, high)| high >= value).unwrap_or(here);
        let lowest = self.lowest.filter(|&(_, low)| low <= value).unwrap_or(here);
        (self.highest, self.lowest) = (Some(highest), Some(lowest));
        let fell = highest.1 - value > self.band;
        let rose = value - lowest.1 > self.band;
        let turned = match self.rising {
            Some(true) if fell => Some((highest, true)),
            Some(false) if rose => Some((lowest, false)),
            _ => None,
        };
        if turned.is_some() || self.rising.is_none() {
            match (fell, rose) {
                (true, _) if self.rising != Some(false) => self.rising = Some(false),
                (_, true) => self.rising = Some(true),
                _ => return None,
            }
            // The search for the next extreme starts here.
            (self.highest, self.lowest) = (Some(here), Some(here));
        }
        turned.map(|((index, value), is_peak)| Reversal {
            index,
            value,
            is_peak,
        })
    }
}

/// All reversals of a signal that came back by more than `band`.
pub(crate) fn reversals(values: &[f64], band: f64) -> Vec<Reversal> {
    let mut finder = ReversalFinder::new(band);
    values.iter().filter_map(|&value| finder.add(value)).collect()
}

/// Peak, valley, energy and rate of one counted cycle.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct CycleSummary {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// Time of its first sample in s.
    pub from_s: f64,
    /// Time of its last sample in s.
    pub to_s: f64,
    /// Number of samples in it.
    pub samples: u64,
    /// Number of ticks in it without a sample.
    pub lost: u64,
    /// Samples left out of the values below because of their flags.
    pub excluded: u64,
    /// False if the run ended within it, or a hold interrupted it and it was repeated.
    pub complete: bool,
    /// Peak and valley of the displacement in mm.
    pub displacement_mm: Range,
    /// Peak and valley of the force in N.
    pub force_n: Range,
    /// Integral of F dx around the loop in J.
    pub loop_energy_j: f64,
    /// Rate from valley to peak in N/mm; `None` if nothing moved.
    pub secant_rate_n_per_mm: Option<f64>,
    /// NRMSE of the twin over this cycle; `None` if the twin was off.
    pub twin_nrmse: Option<f64>,
}

/// Computes the summary of each counted cycle, sample by sample.
#[derive(Debug, Clone, Default)]
pub(crate) struct CycleMeter {
    follower: CycleFollower,
    open: Option<OpenCycle>,
}

#[derive(Debug, Clone)]
struct OpenCycle {
    cycle: u32,
    last_tick: u64,
    from_s: f64,
    to_s: f64,
    samples: u64,
    lost: u64,
    excluded: u64,
    displacement_mm: Option<Range>,
    force_n: Option<Range>,
    integral: LoopIntegral,
    twin: NrmseMeter,
}

impl CycleMeter {
    /// Takes the next sample; returns the summary of the cycle that ended before it.
    pub(crate) fn add(&mut self, sample: &Sample) -> Option<CycleSummary> {
        let (place, ended) = self.follower.add(sample);
        let ended = ended.and_then(|complete| self.open.take()?.summary(complete));
        match place {
            CyclePlace::Outside => {}
            CyclePlace::First => self.open.insert(OpenCycle::new(sample)).add(sample),
            CyclePlace::Further { after_hold } => {
                if let Some(open) = &mut self.open {
                    // The ticks of a hold are not lost.
                    if !after_hold {
                        open.lost += (sample.tick - open.last_tick).saturating_sub(1);
                    }
                    open.add(sample);
                }
            }
        }
        ended
    }

    /// The run is over: returns the summary of its last cycle. `completed`: the profile ran to its end.
    pub(crate) fn finish(&mut self, completed: bool) -> Option<CycleSummary> {
        let complete = self.follower.finish(completed)?;
        self.open.take()?.summary(complete)
    }
}

impl OpenCycle {
    fn new(sample: &Sample) -> OpenCycle {
        OpenCycle {
            cycle: sample.cycle,
            last_tick: sample.tick,
            from_s: sample.time_s,
            to_s: sample.time_s,
            samples: 0,
            lost: 0,
            excluded: 0,
            displacement_mm: None,
            force_n: None,
            integral: LoopIntegral::default(),
            twin: NrmseMeter::default(),
        }
    }

    fn add(&mut self, sample: &Sample) {
        self.samples += 1;
        self.last_tick = sample.tick;
        self.to_s = sample.time_s;
        if sample.flags.intersects(Flags::UNUSABLE) {
            self.excluded += 1;
            return;
        }
        self.displacement_mm = Some(Range::including(self.displacement_mm, sample.displacement_mm));
        self.force_n = Some(Range::including(self.force_n, sample.force_n));
        self.integral.add(sample.displacement_mm, sample.force_n);
        if let Some(twin_force_n) = sample.twin_force_n {
            self.twin.add(sample.force_n, twin_force_n);
        }
    }

    /// `None` if no sample was usable.
    fn summary(self, complete: bool) -> Option<CycleSummary> {
        let (displacement_mm, force_n) = (self.displacement_mm?, self.force_n?);
        Some(CycleSummary {
            cycle: self.cycle,
            from_s: self.from_s,
            to_s: self.to_s,
            samples: self.samples,
            lost: self.lost,
            excluded: self.excluded,
            complete,
            displacement_mm,
            force_n,
            loop_energy_j: self.integral.energy_j(),
            secant_rate_n_per_mm: secant_rate_n_per_mm(displacement_mm, force_n),
            twin_nrmse: self.twin.value(),
        })
    }
}

/// Columns of the cycles CSV, in order.
pub(crate) const CYCLE_COLUMNS: [&str; 18] = [
    "cycle",
    "from_s",
    "to_s",
    "samples",
    "lost",
    "excluded",
    "complete",
    "displacement_peak_mm",
    "displacement_valley_mm",
    "displacement_amplitude_mm",
    "displacement_mean_mm",
    "force_peak_n",
    "force_valley_n",
    "force_amplitude_n",
    "force_mean_n",
    "loop_energy_j",
    "secant_rate_n_per_mm",
    "twin_nrmse",
];

/// Writes the cycles CSV: one row for each counted cycle.
pub(crate) fn write_csv(sink: &mut impl Write, cycles: &[CycleSummary]) -> io::Result<()> {
    write!(sink, "{}\r\n", CYCLE_COLUMNS.join(","))?;
    let mut row = Vec::new();
    for c in cycles {
        row.clear();
        write!(row, "{}", c.cycle)?;
        push_cells(&mut row, &[c.from_s, c.to_s], 6);
        write!(
            row,
            ",{},{},{},{}",
            c.samples,
            c.lost,
            c.excluded,
            u8::from(c.complete)
        )?;
        let (x, f) = (c.displacement_mm, c.force_n);
        push_cells(&mut row, &[x.peak, x.valley, x.amplitude(), x.mean()], 5);
        push_cells(&mut row, &[f.peak, f.valley, f.amplitude(), f.mean()], 3);
        push_cells(&mut row, &[c.loop_energy_j], 6);
        let or_empty = |value: Option<f64>| value.unwrap_or(f64::NAN);
        push_cells(&mut row, &[or_empty(c.secant_rate_n_per_mm)], 4);
        push_cells(&mut row, &[or_empty(c.twin_nrmse)], 6);
        row.extend_from_slice(b"\r\n");
        sink.write_all(&row)?;
    }
    Ok(())
}

/// Appends cells, each after a comma; the cell is empty where the value is not finite.
fn push_cells(row: &mut Vec<u8>, values: &[f64], decimals: u32) {
    for &value in values {
        row.push(b',');
        push_fixed(row, value, decimals);
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use rand::{RngExt, SeedableRng};

    use super::super::run_file::test_support::sample;
    use super::*;

    #[test]
    fn noise_makes_no_reversal() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        // 10 cycles of a unit sine with noise of +-0.05; the band is a little more than its peak-to-peak value.
        let noisy: Vec<f64> = (0..10_000)
            .map(|i| (TAU * f64::from(i) / 1000.0).sin() + random.random_range(-0.05..0.05))
            .collect();
        let found = reversals(&noisy, 0.11);
        assert_eq!(found.len(), 20);
        for (i, reversal) in found.iter().enumerate() {
            assert_eq!(reversal.is_peak, i % 2 == 0);
            let exact = 250 + 500 * i;
            // Noise of 0.1 peak to peak can move the extreme by acos(0.9) = 26 degrees = 72 samples.
            assert!(reversal.index.abs_diff(exact) <= 72, "{reversal:?}");
        }
        assert_eq!(reversals(&[3.0; 50], 0.1), []);
    }

    #[test]
    fn a_zigzag_is_found_point_by_point() {
        let found = reversals(&[0.0, 2.0, 1.95, 2.5, -1.0, -0.95, 4.0], 0.1);
        let points: Vec<(usize, f64, bool)> = found.iter().map(|r| (r.index, r.value, r.is_peak)).collect();
        assert_eq!(points, [(3, 2.5, true), (4, -1.0, false)]);
    }

    /// x = 6 sin p mm and F = 300 sin (p - 0.2) N enclose -pi 6 300 sin 0.2: the force lags, so the energy is negative.
    #[test]
    fn a_cycle_is_summarised_when_it_ends() {
        let mut meter = CycleMeter::default();
        let ended: Vec<CycleSummary> = (0..2500).filter_map(|tick| meter.add(&sample(tick))).collect();
        assert_eq!(
            ended
                .iter()
                .map(|c| (c.cycle, c.samples, c.lost))
                .collect::<Vec<_>>(),
            [(1, 1000, 0), (2, 1000, 0)]
        );
        let first = ended[0];
        let exact_j = -PI * 6.0 * 300.0 * 0.2f64.sin() * 1e-3;
        // A count is 0.1 N and 0.0005 mm: the rounding is far below 1e-4 of the loop energy.
        assert!(
            (first.loop_energy_j / exact_j - 1.0).abs() < 1e-4,
            "{}",
            first.loop_energy_j
        );
        assert!((first.displacement_mm.amplitude() - 6.0).abs() < 0.0005);
        assert!((first.secant_rate_n_per_mm.unwrap() - 50.0).abs() < 0.02);
        let last = meter.finish(false).unwrap();
        assert_eq!((last.cycle, last.complete, last.samples), (3, false, 500));
        assert_eq!(meter.finish(false), None);
    }

    /// The samples of a hold or of an unloading: in no cycle.
    fn paused(tick: u64) -> Sample {
        let mut s = Sample {
            cycle: 0,
            ..sample(tick)
        };
        s.flags.insert(Flags::NOT_PROFILE);
        s
    }

    /// Number, samples, lost samples, complete.
    fn told(ended: &[CycleSummary]) -> Vec<(u32, u64, u64, bool)> {
        ended
            .iter()
            .map(|c| (c.cycle, c.samples, c.lost, c.complete))
            .collect()
    }

    #[test]
    fn a_cycle_that_is_repeated_after_a_hold_counts_once() {
        let mut meter = CycleMeter::default();
        let taper = (1800..2000).map(|tick| Sample {
            cycle: 0,
            ..sample(tick)
        });
        let again = (2000..3000).map(|tick| Sample {
            cycle: 2,
            ..sample(tick)
        });
        let run = (0..1300)
            .map(sample)
            .chain((1300..1800).map(paused))
            .chain(taper)
            .chain(again);
        let mut ended: Vec<CycleSummary> = run.filter_map(|s| meter.add(&s)).collect();
        ended.extend(meter.finish(true));
        assert_eq!(
            told(&ended),
            [(1, 1000, 0, true), (2, 300, 0, false), (2, 1000, 0, true)]
        );
    }

    #[test]
    fn a_cycle_that_goes_on_after_a_hold_is_one_and_a_hold_is_no_loss() {
        let mut meter = CycleMeter::default();
        let later = |tick: u64| Sample {
            tick: tick + 500,
            ..sample(tick)
        };
        let run = (0..300)
            .map(sample)
            .chain((300..800).map(paused))
            .chain((300..1000).map(later));
        assert_eq!(run.filter_map(|s| meter.add(&s)).count(), 0);
        assert_eq!(
            told(&[meter.finish(true).expect("a cycle")]),
            [(1, 1000, 0, true)]
        );
    }

    #[test]
    fn a_cycle_in_which_the_rig_was_stopped_is_not_complete() {
        let mut meter = CycleMeter::default();
        let run = (0..1300).map(sample).chain((1300..1800).map(paused));
        let mut ended: Vec<CycleSummary> = run.filter_map(|s| meter.add(&s)).collect();
        ended.extend(meter.finish(false));
        assert_eq!(told(&ended), [(1, 1000, 0, true), (2, 300, 0, false)]);
    }

    #[test]
    fn unusable_samples_are_left_out_and_counted() {
        let mut meter = CycleMeter::default();
        for tick in (0..1000).filter(|tick| !(100..110).contains(tick)) {
            let mut s = sample(tick);
            if tick == 500 {
                s.force_n = 99_999.0;
                s.flags.insert(Flags::SPIKE);
            }
            meter.add(&s);
        }
        let cycle = meter.finish(true).unwrap();
        assert_eq!((cycle.samples, cycle.lost, cycle.excluded), (990, 10, 1));
        assert!(cycle.force_n.peak < 301.0);
    }

    #[test]
    fn every_row_of_the_cycles_csv_has_all_columns() {
        let mut meter = CycleMeter::default();
        for tick in 0..1000 {
            let mut s = sample(tick);
            s.twin_force_n = None;
            meter.add(&s);
        }
        let mut out = Vec::new();
        write_csv(&mut out, &[meter.finish(true).unwrap()]).unwrap();
        let text = String::from_utf8(out).unwrap();
        let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
        assert_eq!(rows[0], CYCLE_COLUMNS);
        assert_eq!(rows[1].len(), CYCLE_COLUMNS.len());
        assert_eq!(rows[1][..7], ["1", "0.000000", "0.999000", "1000", "0", "0", "1"]);
        assert_eq!(rows[1][17], "", "no twin, no NRMSE");
    }
}
