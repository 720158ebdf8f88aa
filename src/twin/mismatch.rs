//! Where twin and measurement part while a run goes on: one "model mismatch" with its place on the loop.
//!
//! ```text
//! e = mean of (measured - twin) over 10 ms, in units of the noise: force channel, and displacement noise times stiffness;
//!     less what the play before the twin makes
//! |e| > ENTER begins a stretch, |e| < LEAVE, another sign or a reversal ends it; stretches add up to a share of the leg
//! ```
//! Stretches shorter than a twentieth of the leg before are forgotten. One that counts opens the case; after the whole cycle that follows
//! (or [`LATEST_S`], in a slow test) the largest is reported. No second report before a whole cycle without a stretch that counts.

use std::collections::VecDeque;

use crate::recording::play::Play;

/// Residual that begins a stretch, in units of the noise.
const ENTER: f64 = 6.0;
/// Residual that ends it.
const LEAVE: f64 = 3.0;
/// Smoothing, s.
const SMOOTH_S: f64 = 0.01;
/// Share of a leg that a stretch must last.
const LEAST_SHARE: f64 = 0.05;
/// And at least so long, s.
const LEAST_S: f64 = 0.03;
/// A case is reported after so long even where no cycle has ended, s.
const LATEST_S: f64 = 5.0;
/// A stiff stretch after a reversal is remembered: this share of it from step to step.
const FADE: f64 = 0.9;
/// A reversal is a way back of so many deviations of the displacement noise.
const BAND: f64 = 20.0;
/// And of at least this, mm: a servo's ripple at rest is no reversal.
const LEAST_BAND: f64 = 0.02;

/// What the channels' own noise is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Noise {
    /// Standard deviation of the force, N.
    pub force_n: f64,
    /// Standard deviation of the displacement, mm.
    pub displacement_mm: f64,
}

/// A stretch of the loop on which twin and measurement part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Mismatch {
    /// Displacement where it begins and ends, the lower first, mm.
    pub displacement_mm: [f64; 2],
    /// True while the displacement rises.
    pub loading: bool,
    /// Travel since the reversal, at its begin and its end, mm.
    pub after_reversal_mm: [f64; 2],
    /// Mean of measured minus twin, N.
    pub residual_n: f64,
    /// That in units of the noise.
    pub in_noise: f64,
}

impl std::fmt::Display for Mismatch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [from, to] = self.displacement_mm;
        let [near, far] = self.after_reversal_mm;
        write!(
            f,
            "model mismatch: measured is {:.1} N {} the twin ({:.0} times the noise) from {from:.2} to {to:.2} mm while {}, {near:.2} to \
             {far:.2} mm after the reversal: look at specimen and rig, then diagnose this run",
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

    /// What makes one stretch larger than another.
    fn weight(&self) -> f64 {
        self.sum_noise.abs()
    }
}

/// Legs between reversals, by a band.
#[derive(Debug, Clone, Copy)]
struct Leg {
    loading: bool,
    begin_mm: f64,
    extreme_mm: f64,
    samples: u64,
}

/// Watches one run.
#[derive(Debug, Clone)]
pub(crate) struct MismatchWatch {
    noise: Noise,
    rate_hz: f64,
    band_mm: f64,
    leg: Option<Leg>,
    leg_before: u64,
    legs: u64,
    /// Stiffness of the twin where it is now, N/mm: the last step's, or what is left of a larger one before.
    stiffness: f64,
    last: Option<(f64, f64)>,
    /// Residuals of the last [`SMOOTH_S`] and their sum.
    recent_n: VecDeque<f64>,
    recent_sum_n: f64,
    open: Option<Stretch>,
    largest: Option<Stretch>,
    /// Legs and samples since the case was opened.
    since_opened: Option<(u64, u64)>,
    /// Legs ended since the last stretch that counted; while told, nothing is told again.
    quiet_legs: u64,
    told: bool,
}

impl MismatchWatch {
    /// Nothing seen yet.
    pub(crate) fn new(noise: Noise) -> Self {
        MismatchWatch {
            noise,
            rate_hz: 1.0,
            band_mm: (BAND * noise.displacement_mm).max(LEAST_BAND),
            leg: None,
            leg_before: 0,
            legs: 0,
            stiffness: 0.0,
            last: None,
            recent_n: VecDeque::new(),
            recent_sum_n: 0.0,
            open: None,
            largest: None,
            since_opened: None,
            quiet_legs: 0,
            told: false,
        }
    }

    /// A run begins.
    pub(crate) fn begin(&mut self, rate_hz: f64) {
        *self = MismatchWatch {
            rate_hz,
            ..MismatchWatch::new(self.noise)
        };
    }

    /// One compared sample; a report where there is one to make.
    pub(crate) fn sample(&mut self, displacement_mm: f64, measured_n: f64, twin_n: f64) -> Option<Mismatch> {
        self.follow_stiffness(displacement_mm, twin_n);
        let reversed = self.follow_leg(displacement_mm);
        let leg = self.leg?;
        let residual_n = measured_n - twin_n;
        let smooth_n = self.smoothed(residual_n);
        let in_noise = self.in_noise(smooth_n);
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
        self.judge()
    }

    /// Mean over the last [`SMOOTH_S`].
    fn smoothed(&mut self, residual_n: f64) -> f64 {
        self.recent_n.push_back(residual_n);
        self.recent_sum_n += residual_n;
        if self.recent_n.len() as f64 > (SMOOTH_S * self.rate_hz).max(1.0) {
            self.recent_sum_n -= self.recent_n.pop_front().unwrap_or_default();
        }
        self.recent_sum_n / self.recent_n.len() as f64
    }

    /// A residual in units of the noise. The play before the twin shifts its displacement by its half width, one deviation more is
    /// noise: what that makes in force is no mismatch.
    fn in_noise(&self, residual_n: f64) -> f64 {
        let noise_n = self
            .noise
            .force_n
            .hypot(self.stiffness * self.noise.displacement_mm);
        let shift_n = (Play::SIGMAS + 1.0) * self.noise.displacement_mm * self.stiffness;
        residual_n.signum() * (residual_n.abs() - shift_n).max(0.0) / noise_n.max(f64::MIN_POSITIVE)
    }

    fn follow_stiffness(&mut self, displacement_mm: f64, twin_n: f64) {
        let (from_mm, from_n) = *self.last.get_or_insert((displacement_mm, twin_n));
        let step_mm = displacement_mm - from_mm;
        if step_mm.abs() > self.band_mm {
            let here = (twin_n - from_n).abs() / step_mm.abs();
            self.stiffness = here.max(FADE * self.stiffness);
            self.last = Some((displacement_mm, twin_n));
        }
    }

    /// True at a reversal.
    fn follow_leg(&mut self, displacement_mm: f64) -> bool {
        let Some(leg) = &mut self.leg else {
            // Before the first motion there is no branch.
            let (from_mm, _) = self.last.unwrap_or((displacement_mm, 0.0));
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

    fn counts(&self, stretch: &Stretch) -> bool {
        let leg = match self.leg_before {
            0 => self.leg.map_or(0, |l| l.samples),
            samples => samples,
        };
        let least = (LEAST_SHARE * leg as f64).max(LEAST_S * self.rate_hz);
        stretch.samples as f64 >= least
    }

    /// Ends the open stretch and keeps it where it counts.
    fn close(&mut self) {
        let Some(stretch) = self.open.take() else { return };
        if !self.counts(&stretch) {
            return;
        }
        self.quiet_legs = 0;
        if self.largest.is_none_or(|l| l.weight() < stretch.weight()) {
            self.largest = Some(stretch);
        }
    }

    fn judge(&mut self) -> Option<Mismatch> {
        if self.told {
            // The rest of the leg and a whole cycle after it without a stretch that counts end the case.
            if self.quiet_legs >= 3 && self.open.is_none_or(|s| !self.counts(&s)) {
                self.told = false;
                self.largest = None;
                self.since_opened = None;
            }
            return None;
        }
        let counting = self.open.filter(|s| self.counts(s));
        if self.largest.is_none() && counting.is_none() {
            return None;
        }
        let (legs, samples) = self.since_opened.get_or_insert((self.legs, 0));
        *samples += 1;
        // The rest of the leg it began on and a whole cycle after it: a taper has grown by then.
        let whole_cycle = self.legs >= *legs + 3;
        if !whole_cycle && (*samples as f64) < LATEST_S * self.rate_hz {
            return None;
        }
        let larger = |a: Option<Stretch>, b: Option<Stretch>| match (a, b) {
            (Some(a), Some(b)) if b.weight() > a.weight() => Some(b),
            (Some(a), _) => Some(a),
            (None, b) => b,
        };
        let report = larger(self.largest, counting)?.report();
        self.told = true;
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

    /// Reports over 1 Hz sines of 6 mm at 1 kHz; `residual` of displacement, branch, cycle.
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
            let report = watch.sample(x, twin + noise + residual(x, loading, k / 1000), twin);
            out.extend(report.map(|r| (f64::from(k) / 1000.0, r)));
        }
        out
    }

    #[test]
    fn noise_alone_is_no_mismatch() {
        assert_eq!(reports(100, |_, _, _| 0.0), []);
        // Three deviations of offset stay inside the band.
        assert_eq!(reports(20, |_, _, _| 1.5), []);
    }

    #[test]
    fn one_report_with_the_place_however_long_it_lasts() {
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
    fn it_is_told_again_only_after_a_cycle_in_peace() {
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
    fn a_blink_is_forgotten() {
        // 20 ms at 94 mm/s is nothing that a person can look for.
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
