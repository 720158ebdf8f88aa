//! Watches the residual (measured minus twin force) during a run and reports a model mismatch with its place on the loop.
//!
//! ```text
//! e = mean of (measured - twin) over 10 ms, in units of the noise: force noise, and displacement noise times stiffness;
//!     less the force by which the play in front of the twin shifts it (`lost_motion`)
//! a stretch begins at |e| > ENTER and ends at |e| < LEAVE, at a change of sign or at a reversal
//! ```
//! A leg is the travel between two reversals. A stretch shorter than 5 % of the leg before it is ignored. The first long
//! stretch starts an observation; after one whole cycle more (or [`LATEST_S`] in a slow test) the largest stretch is reported.
//! The next report needs a whole cycle without a long stretch first. What a report does to the run is up to `daemon`.

use super::lost_motion::{LostMotion, ShiftError, TwinStep};
use super::moving_mean::MovingMean;
use crate::model::Plant;

/// Residual at which a stretch begins, in units of the noise.
const ENTER: f64 = 4.0;
/// Residual at which a stretch ends, in units of the noise.
const LEAVE: f64 = 2.0;
/// Window of the mean of the residual, s.
const SMOOTH_S: f64 = 0.01;
/// Shortest stretch that counts, as a share of the samples of a leg.
const LEAST_SHARE: f64 = 0.05;
/// Shortest stretch that counts, s.
const LEAST_S: f64 = 0.03;
/// A mismatch is reported after this time even if no cycle has ended, s.
const LATEST_S: f64 = 5.0;
/// A reversal is a way back of this many standard deviations of the displacement noise.
const BAND: f64 = 20.0;
/// A reversal is a way back of at least this, mm: the servo's ripple at rest is no reversal.
const LEAST_BAND: f64 = 0.02;

/// Noise of the two channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Noise {
    /// Standard deviation of the force, N.
    pub force_n: f64,
    /// Standard deviation of the displacement, mm.
    pub displacement_mm: f64,
}

/// A stretch of the loop on which twin and measurement differ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Mismatch {
    /// Displacement at its two ends, the lower first, mm.
    pub displacement_mm: [f64; 2],
    /// True where the displacement rises.
    pub loading: bool,
    /// Travel since the reversal where it begins and where it ends, mm.
    pub after_reversal_mm: [f64; 2],
    /// Mean of measured minus twin, N.
    pub residual_n: f64,
    /// Mean of the residual in units of the noise.
    pub in_noise: f64,
}

impl std::fmt::Display for Mismatch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [from, to] = self.displacement_mm;
        let [near, far] = self.after_reversal_mm;
        write!(
            f,
            "model mismatch: the measured force is {:.1} N {} the twin ({:.0} times the noise) from {from:.2} to {to:.2} mm while {}, \
             {near:.2} to {far:.2} mm after the reversal: check the specimen and the load frame, then diagnose this run",
            self.residual_n.abs(),
            if self.residual_n > 0.0 { "above" } else { "below" },
            self.in_noise.abs(),
            if self.loading { "loading" } else { "unloading" },
        )
    }
}

#[derive(Debug, Clone, Copy)]
struct Stretch {
    sign: f64,
    from_mm: f64,
    to_mm: f64,
    since_mm: [f64; 2],
    loading: bool,
    sum_n: f64,
    sum_noise: f64,
    samples: u64,
}

impl Stretch {
    fn report(&self) -> Mismatch {
        let count = self.samples as f64;
        Mismatch {
            displacement_mm: [self.from_mm.min(self.to_mm), self.from_mm.max(self.to_mm)],
            loading: self.loading,
            after_reversal_mm: self.since_mm,
            residual_n: self.sum_n / count,
            in_noise: self.sum_noise / count,
        }
    }

    /// Size of the stretch: its residual summed over its samples.
    fn size(&self) -> f64 {
        self.sum_noise.abs()
    }
}

/// Travel since the last reversal.
#[derive(Debug, Clone, Copy)]
struct Leg {
    loading: bool,
    begin_mm: f64,
    extreme_mm: f64,
    samples: u64,
}

/// Watches the residual of one run.
#[derive(Debug, Clone)]
pub(crate) struct MismatchWatch {
    noise: Noise,
    rate_hz: f64,
    band_mm: f64,
    leg: Option<Leg>,
    leg_before: u64,
    legs: u64,
    /// Displacement at the first sample, mm.
    first_mm: Option<f64>,
    lost_motion: LostMotion,
    /// Residual over the last [`SMOOTH_S`], N.
    residual_n: MovingMean,
    open: Option<Stretch>,
    largest: Option<Stretch>,
    /// Leg at which the observation began, and samples since then.
    observing: Option<(u64, u64)>,
    /// Legs that ended since the last long stretch.
    quiet_legs: u64,
    /// A report was made and the mismatch has not ended since.
    reported: bool,
}

impl MismatchWatch {
    /// A watch before its first run.
    pub(crate) fn new(noise: Noise) -> Self {
        MismatchWatch::at_rate(noise, 1.0)
    }

    fn at_rate(noise: Noise, rate_hz: f64) -> Self {
        let band_mm = (BAND * noise.displacement_mm).max(LEAST_BAND);
        let window = (SMOOTH_S * rate_hz).max(1.0) as usize;
        MismatchWatch {
            noise,
            rate_hz,
            band_mm,
            leg: None,
            leg_before: 0,
            legs: 0,
            first_mm: None,
            lost_motion: LostMotion::new(noise.displacement_mm, band_mm, window),
            residual_n: MovingMean::over(window),
            open: None,
            largest: None,
            observing: None,
            quiet_legs: 0,
            reported: false,
        }
    }

    /// Starts a run with this sample rate.
    pub(crate) fn begin(&mut self, rate_hz: f64) {
        *self = MismatchWatch::at_rate(self.noise, rate_hz);
    }

    /// Takes one sample and returns a mismatch when it is time to report one. `twin` is the model that made this step.
    pub(super) fn sample(&mut self, step: &TwinStep, force_n: f64, twin: &dyn Plant) -> Option<Mismatch> {
        let displacement_mm = step.twin_mm;
        self.lost_motion.take(step);
        let reversed = self.follow_leg(displacement_mm);
        let leg = self.leg?;
        let residual_n = force_n - step.twin_n;
        let smooth_n = self.residual_n.take(residual_n);
        let in_noise = self.judged(smooth_n, twin);
        let over = reversed || self.open.is_some_and(|s| in_noise * s.sign < LEAVE);
        if over {
            self.close();
        }
        let since_mm = (displacement_mm - leg.begin_mm).abs();
        match &mut self.open {
            Some(stretch) => {
                stretch.to_mm = displacement_mm;
                stretch.since_mm[1] = since_mm;
                stretch.sum_n += residual_n;
                stretch.sum_noise += in_noise;
                stretch.samples += 1;
            }
            None if in_noise.abs() > ENTER => {
                self.open = Some(Stretch {
                    sign: in_noise.signum(),
                    from_mm: displacement_mm,
                    to_mm: displacement_mm,
                    since_mm: [since_mm; 2],
                    loading: leg.loading,
                    sum_n: residual_n,
                    sum_noise: in_noise,
                    samples: 1,
                });
            }
            None => {}
        }
        self.due()
    }

    /// A residual in units of the noise. The twin is asked for its stiffness at a turn only where the residual is large.
    fn judged(&mut self, residual_n: f64, twin: &dyn Plant) -> f64 {
        let along = self.in_noise(residual_n, self.lost_motion.along_branch());
        if along.abs() < LEAVE {
            return along;
        }
        let at_a_turn = self.lost_motion.at_a_turn(twin);
        at_a_turn.map_or(along, |error| self.in_noise(residual_n, error))
    }

    /// What the error of the twin's displacement leaves of a residual, in units of the noise.
    fn in_noise(&self, residual_n: f64, error: ShiftError) -> f64 {
        let noise_n = self
            .noise
            .force_n
            .hypot(error.stiffness * self.noise.displacement_mm);
        residual_n.signum() * (residual_n.abs() - error.shift_n).max(0.0) / noise_n.max(f64::MIN_POSITIVE)
    }

    /// Follows the leg; true at a reversal.
    fn follow_leg(&mut self, displacement_mm: f64) -> bool {
        let Some(leg) = &mut self.leg else {
            // Before the first motion there is no leg.
            let from_mm = *self.first_mm.get_or_insert(displacement_mm);
            if (displacement_mm - from_mm).abs() >= 0.5 * self.band_mm {
                self.leg = Some(Leg {
                    loading: displacement_mm > from_mm,
                    begin_mm: from_mm,
                    extreme_mm: displacement_mm,
                    samples: 0,
                });
            }
            return false;
        };
        leg.samples += 1;
        let ahead = if leg.loading {
            displacement_mm - leg.extreme_mm
        } else {
            leg.extreme_mm - displacement_mm
        };
        if ahead >= 0.0 {
            leg.extreme_mm = displacement_mm;
            return false;
        }
        if -ahead < self.band_mm {
            return false;
        }
        self.leg_before = leg.samples;
        *leg = Leg {
            loading: !leg.loading,
            begin_mm: leg.extreme_mm,
            extreme_mm: displacement_mm,
            samples: 0,
        };
        self.legs += 1;
        self.quiet_legs += 1;
        true
    }

    fn is_long(&self, stretch: &Stretch) -> bool {
        let leg = match self.leg_before {
            0 => self.leg.map_or(0, |l| l.samples),
            samples => samples,
        };
        let least = (LEAST_SHARE * leg as f64).max(LEAST_S * self.rate_hz);
        stretch.samples as f64 >= least
    }

    /// Ends the open stretch and keeps it if it is long and the largest so far.
    fn close(&mut self) {
        let Some(stretch) = self.open.take() else { return };
        if !self.is_long(&stretch) {
            return;
        }
        self.quiet_legs = 0;
        if self.largest.is_none_or(|l| l.size() < stretch.size()) {
            self.largest = Some(stretch);
        }
    }

    /// The largest stretch when the observation is over.
    fn due(&mut self) -> Option<Mismatch> {
        if self.reported {
            // The mismatch has ended after the rest of the leg and a whole cycle without a long stretch.
            if self.quiet_legs >= 3 && self.open.is_none_or(|s| !self.is_long(&s)) {
                self.reported = false;
                self.largest = None;
                self.observing = None;
            }
            return None;
        }
        let open = self.open.filter(|s| self.is_long(s));
        if self.largest.is_none() && open.is_none() {
            return None;
        }
        let (legs, samples) = self.observing.get_or_insert((self.legs, 0));
        *samples += 1;
        // The rest of the leg and a whole cycle: a stretch that grows gradually is large by then.
        let whole_cycle = self.legs >= *legs + 3;
        if !whole_cycle && (*samples as f64) < LATEST_S * self.rate_hz {
            return None;
        }
        let larger = |a: Option<Stretch>, b: Option<Stretch>| match (a, b) {
            (Some(a), Some(b)) if b.size() > a.size() => Some(b),
            (Some(a), _) => Some(a),
            (None, b) => b,
        };
        let report = larger(self.largest, open)?.report();
        self.reported = true;
        Some(report)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOISE: Noise = Noise {
        force_n: 0.5,
        displacement_mm: 0.001,
    };

    /// 80 N/mm without friction.
    #[derive(Clone)]
    struct Linear;

    impl Plant for Linear {
        fn reset(&mut self) {}
        fn step(&mut self, displacement_mm: f64, _dt_s: f64) -> f64 {
            80.0 * displacement_mm
        }
        fn boxed_clone(&self) -> Box<dyn Plant> {
            Box::new(self.clone())
        }
    }

    /// Reports with their time, s, over 1 Hz sines of 6 mm at 1 kHz; `residual` of displacement, loading, cycle.
    fn reports(cycles: u32, residual: impl Fn(f64, bool, u32) -> f64) -> Vec<(f64, Mismatch)> {
        let mut watch = MismatchWatch::new(NOISE);
        watch.begin(1000.0);
        let mut out = Vec::new();
        let mut state = 1u32;
        for k in 0..cycles * 1000 {
            let phase = std::f64::consts::TAU * f64::from(k) / 1000.0;
            let (x, loading) = (3.0 - 3.0 * phase.cos(), phase.sin() >= 0.0);
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let noise = (f64::from(state >> 8) / f64::from(1u32 << 24) - 0.5) * 12f64.sqrt() * NOISE.force_n;
            let twin = 80.0 * x;
            let step = TwinStep {
                measured_mm: x,
                twin_mm: x,
                twin_n: twin,
            };
            let force_n = twin + noise + residual(x, loading, k / 1000);
            let report = watch.sample(&step, force_n, &Linear);
            out.extend(report.map(|r| (f64::from(k) / 1000.0, r)));
        }
        out
    }

    #[test]
    fn noise_alone_is_no_mismatch() {
        assert_eq!(reports(100, |_, _, _| 0.0), []);
        // An offset of three standard deviations stays below ENTER.
        assert_eq!(reports(20, |_, _, _| 1.5), []);
    }

    #[test]
    fn a_lasting_mismatch_is_reported_once_with_its_place() {
        let found = reports(50, |x, loading, _| if loading && x > 4.0 { 20.0 } else { 0.0 });
        assert_eq!(found.len(), 1, "{found:?}");
        let (at_s, m) = found[0];
        assert!(at_s < 2.6, "{at_s}");
        assert!(
            m.loading && (m.displacement_mm[0] - 4.0).abs() < 0.3 && m.displacement_mm[1] > 5.7,
            "{m:?}"
        );
        assert!(
            (m.after_reversal_mm[0] - 4.0).abs() < 0.3 && (m.residual_n - 20.0).abs() < 2.0,
            "{m:?}"
        );
        assert!(m.in_noise > 30.0 && m.in_noise < 45.0, "{m:?}");
    }

    #[test]
    fn the_next_report_needs_a_cycle_without_mismatch() {
        let bad = |cycle: u32| cycle < 3 || (10..12).contains(&cycle);
        let found = reports(20, |x, loading, cycle| {
            if bad(cycle) && loading && x > 4.0 {
                20.0
            } else {
                0.0
            }
        });
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found[1].0 > 10.0);
    }

    #[test]
    fn a_short_deviation_is_ignored() {
        // 0.3 mm at 19 mm/s: 16 ms, shorter than LEAST_S.
        assert_eq!(
            reports(5, |x, loading, _| if loading && (3.0..3.3).contains(&x) {
                30.0
            } else {
                0.0
            }),
            []
        );
    }
}
