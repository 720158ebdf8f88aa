//! Load cell and LVDT with their amplifiers: anti-alias filter, gain and zero error, noise, counts, rail, delay. The scale of
//! a count is that of the protocol; calibration is left to `control`.

use rand::rand_core::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::{OutOfRange, first_out_of_range};
use crate::protocol::message::{COUNTS_INVALID, COUNTS_MAX};
use crate::protocol::tick::ticks_in_ms;

/// Length of the delay line in ticks: 64 ms.
const DELAY_LINE_TICKS: usize = ticks_in_ms(64) as usize;

/// Properties of one channel; a table of `[mock_rig]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct SensorConfig {
    /// Corner of the two-pole (Butterworth) anti-alias filter in Hz.
    pub filter_hz: f64,
    /// Standard deviation of the noise in counts, white at the sample rate.
    pub noise_rms_counts: f64,
    /// Gain error as a factor: 1.01 reads 1 % high.
    pub gain: f64,
    /// Error of shape: this share of the rail at the rail, growing with the square of the reading.
    pub curvature: f64,
    /// Zero error in counts.
    pub zero_counts: f64,
    /// Counts at the amplifier's rail; readings beyond are invalid.
    pub rail_counts: i32,
    /// Extra delay of the channel in whole milliseconds, 0 to 63.
    pub delay_ms: u32,
}

impl Default for SensorConfig {
    fn default() -> Self {
        SensorConfig {
            filter_hz: 300.0,
            noise_rms_counts: 1.0,
            gain: 1.0,
            curvature: 0.0,
            zero_counts: 0.0,
            rail_counts: 120_000,
            delay_ms: 0,
        }
    }
}

impl SensorConfig {
    /// The first field that is out of range, with its range.
    pub(super) fn fault(&self) -> Option<OutOfRange> {
        first_out_of_range([
            ("filter_hz", self.filter_hz, 1.0..=450.0, "1 to 450"),
            (
                "noise_rms_counts",
                self.noise_rms_counts,
                0.0..=10_000.0,
                "0 to 10000",
            ),
            ("gain", self.gain, -10.0..=10.0, "-10 to 10"),
            ("curvature", self.curvature, -0.2..=0.2, "-0.2 to 0.2"),
            ("zero_counts", self.zero_counts, -1e5..=1e5, "-100000 to 100000"),
            (
                "rail_counts",
                f64::from(self.rail_counts),
                1.0..=f64::from(COUNTS_MAX),
                "1 to 131071",
            ),
            ("delay_ms", f64::from(self.delay_ms), 0.0..=63.0, "0 to 63"),
        ])
    }
}

/// One channel with its state.
#[derive(Debug, Clone)]
pub(crate) struct Sensor {
    config: SensorConfig,
    counts_per_unit: f64,
    /// Share of the counts by which the curvature bends one count.
    bend_per_count: f64,
    filter: TwoPole,
    noise: ChaCha8Rng,
    delayed: [i32; DELAY_LINE_TICKS],
    head: usize,
    last_counts: i32,
    /// Injected fault: the reading no longer changes.
    pub frozen: bool,
    /// Injected fault: wire open, no valid reading.
    pub open: bool,
    /// Injected fault: another factor on the gain; 1 without fault.
    pub gain_fault: f64,
    /// Injected fault: another factor on the noise; 1 without fault.
    pub noise_fault: f64,
    /// Injected fault: error of the zero, in the unit of the channel.
    pub offset_fault: f64,
}

impl Sensor {
    /// A channel with `units_per_count` whose filter is stepped every `step_s`. Channels of one seed have independent noise
    /// if their `stream` differs.
    pub(crate) fn new(
        config: &SensorConfig,
        units_per_count: f64,
        step_s: f64,
        seed: u64,
        stream: u64,
    ) -> Self {
        let mut noise = ChaCha8Rng::seed_from_u64(seed);
        noise.set_stream(stream);
        Sensor {
            counts_per_unit: 1.0 / units_per_count,
            bend_per_count: config.curvature / f64::from(config.rail_counts),
            filter: TwoPole::new(config.filter_hz, 0.5f64.sqrt(), step_s),
            noise,
            delayed: [0; DELAY_LINE_TICKS],
            head: 0,
            last_counts: 0,
            frozen: false,
            open: false,
            gain_fault: 1.0,
            noise_fault: 1.0,
            offset_fault: 0.0,
            config: config.clone(),
        }
    }

    /// Sets filter and delay line to the steady state at `value`, as at boot.
    pub(crate) fn settle(&mut self, value: f64) {
        self.filter.settle(value);
        let counts = self.counts(0.0);
        self.delayed = [counts; DELAY_LINE_TICKS];
        self.last_counts = counts;
    }

    /// Steps the analogue filter with the true value.
    pub(crate) fn step(&mut self, value: f64) {
        self.filter.step(value);
    }

    /// The reading of this tick in counts, or `COUNTS_INVALID`. `spike` is an error of this one reading, in the unit of the
    /// channel.
    pub(crate) fn read(&mut self, spike: f64) -> i32 {
        let noise = self.gaussian() * self.config.noise_rms_counts * self.noise_fault;
        self.head = (self.head + 1) % DELAY_LINE_TICKS;
        self.delayed[self.head] = self.counts(noise);
        let delay = ticks_in_ms(u64::from(self.config.delay_ms)) as usize;
        let due = (self.head + DELAY_LINE_TICKS - delay % DELAY_LINE_TICKS) % DELAY_LINE_TICKS;
        if self.open {
            return COUNTS_INVALID;
        }
        if !self.frozen {
            self.last_counts = self.delayed[due];
        }
        if spike != 0.0 && self.last_counts != COUNTS_INVALID {
            let counts = self.last_counts + (spike * self.counts_per_unit) as i32;
            return counts.clamp(-self.config.rail_counts, self.config.rail_counts);
        }
        self.last_counts
    }

    fn counts(&self, noise_counts: f64) -> i32 {
        let gain = self.config.gain * self.gain_fault * self.counts_per_unit;
        let straight = self.filter.value() * gain + self.offset_fault * self.counts_per_unit;
        let bent = straight * (1.0 + self.bend_per_count * straight);
        let counts = bent + self.config.zero_counts + noise_counts;
        if counts.abs() > f64::from(self.config.rail_counts) {
            COUNTS_INVALID
        } else {
            // Rounds half away from zero, without the call of `round` on plain x86-64.
            (counts + 0.5f64.copysign(counts)) as i32
        }
    }

    /// Approximately normal noise of variance 1: the scaled sum of four uniform numbers, limited to 3.46 sigma, which is four
    /// times as fast as an exact one.
    fn gaussian(&mut self) -> f64 {
        let bits = self.noise.next_u64();
        let sum = (bits & 0xFFFF) + (bits >> 16 & 0xFFFF) + (bits >> 32 & 0xFFFF) + (bits >> 48);
        (sum as f64 / 65_535.0 - 2.0) * 3f64.sqrt()
    }
}

/// A two-pole low-pass with unity gain; the step is exact for an input that is constant over the step.
#[derive(Debug, Clone)]
pub(super) struct TwoPole {
    /// Transition matrix of (value - input, rate) over one step.
    a: [[f64; 2]; 2],
    state: [f64; 2],
}

impl TwoPole {
    /// Natural frequency `corner_hz`, damping ratio below 1.
    pub(super) fn new(corner_hz: f64, damping: f64, step_s: f64) -> Self {
        let w = std::f64::consts::TAU * corner_hz;
        let (decay, wd) = (damping * w, w * (1.0 - damping * damping).sqrt());
        let (sin, cos) = (wd * step_s).sin_cos();
        let e = (-decay * step_s).exp();
        TwoPole {
            a: [
                [e * (cos + decay / wd * sin), e * sin / wd],
                [-e * w * w / wd * sin, e * (cos - decay / wd * sin)],
            ],
            state: [0.0; 2],
        }
    }

    pub(super) fn settle(&mut self, value: f64) {
        self.state = [value, 0.0];
    }

    pub(super) fn value(&self) -> f64 {
        self.state[0]
    }

    /// Limits the rate of the state to `max` per second.
    pub(super) fn limit_rate(&mut self, max: f64) {
        self.state[1] = self.state[1].clamp(-max, max);
    }

    pub(super) fn step(&mut self, input: f64) -> f64 {
        let [off, rate] = [self.state[0] - input, self.state[1]];
        self.state = [
            input + self.a[0][0] * off + self.a[0][1] * rate,
            self.a[1][0] * off + self.a[1][1] * rate,
        ];
        self.state[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensor(config: &SensorConfig) -> Sensor {
        Sensor::new(config, 0.1, 2e-4, 7, 0)
    }

    #[test]
    fn noise_has_its_standard_deviation_and_a_seed_fixes_all_bits() {
        let config = SensorConfig {
            noise_rms_counts: 20.0,
            ..SensorConfig::default()
        };
        let (mut a, mut b) = (sensor(&config), sensor(&config));
        let mut sum = [0.0f64; 2];
        for _ in 0..20_000 {
            let counts = a.read(0.0);
            assert_eq!(counts, b.read(0.0));
            sum[0] += f64::from(counts);
            sum[1] += f64::from(counts).powi(2);
        }
        // Mean within 4 sigma / sqrt(n) = 0.57; spread within 2 % (sampling error 0.5 %).
        assert!((sum[0] / 20_000.0).abs() < 0.57);
        assert!(((sum[1] / 20_000.0).sqrt() / 20.0 - 1.0).abs() < 0.02);
    }

    #[test]
    fn counts_gain_zero_rail_and_delay() {
        let config = SensorConfig {
            noise_rms_counts: 0.0,
            gain: 1.01,
            zero_counts: -5.0,
            delay_ms: 3,
            ..SensorConfig::default()
        };
        let mut sensor = sensor(&config);
        sensor.settle(0.0);
        sensor.filter.settle(100.0);
        let readings: Vec<i32> = (0..5).map(|_| sensor.read(0.0)).collect();
        assert_eq!(readings, [-5, -5, -5, 1005, 1005]);
        sensor.settle(12_000.0);
        assert_eq!(sensor.read(0.0), COUNTS_INVALID);
    }

    #[test]
    fn filter_has_3_db_at_its_corner() {
        let mut filter = TwoPole::new(300.0, 0.5f64.sqrt(), 1e-5);
        let w = std::f64::consts::TAU * 300.0;
        let peak = (0..100_000)
            .map(|i| filter.step((w * 1e-5 * f64::from(i)).sin()))
            .skip(50_000)
            .fold(0.0, f64::max);
        // The input is held over a step of 10 us: an error of the order of (w dt)^2 = 4e-4.
        assert!((peak - 0.5f64.sqrt()).abs() < 1e-3, "{peak}");
    }
}
