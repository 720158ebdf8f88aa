//! Truth for concealed effects, written apart from the library: other elements (40 Jenkins elements with drawn lengths),
//! other step (a quarter of a sample, exact motion), velocity and acceleration from the motion's formula, own sensors.

use crate::recording::Recording;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A hidden effect with its size in natural units and one place parameter.
#[derive(Debug, Clone, Copy)]
pub struct Hidden {
    pub code: &'static str,
    pub size: f64,
    pub place: f64,
}

/// One programme of motion: mm at a time.
#[derive(Debug, Clone, Copy)]
pub enum Motion {
    Ramp {
        top_mm: f64,
        duration_s: f64,
        hold_s: f64,
    },
    Sine {
        mean_mm: f64,
        amplitude_mm: f64,
        frequency_hz: f64,
        cycles: f64,
    },
}

impl Motion {
    pub fn duration_s(&self) -> f64 {
        match *self {
            Motion::Ramp {
                duration_s, hold_s, ..
            } => duration_s + hold_s,
            Motion::Sine {
                frequency_hz, cycles, ..
            } => 2.0 + cycles / frequency_hz,
        }
    }

    /// Displacement, speed, acceleration.
    pub fn at(&self, t: f64) -> [f64; 3] {
        match *self {
            Motion::Ramp {
                top_mm,
                duration_s,
                hold_s,
            } => {
                let half = 0.5 * duration_s;
                let v = top_mm / half;
                if t < half {
                    [v * t, v, 0.0]
                } else if t < half + hold_s {
                    [top_mm, 0.0, 0.0]
                } else {
                    [top_mm - v * (t - half - hold_s), -v, 0.0]
                }
            }
            Motion::Sine {
                mean_mm,
                amplitude_mm,
                frequency_hz,
                ..
            } => {
                if t < 2.0 {
                    let low = mean_mm;
                    [0.5 * low * t, 0.5 * low, 0.0]
                } else {
                    let w = std::f64::consts::TAU * frequency_hz;
                    let p = w * (t - 2.0);
                    // Grows to full amplitude over half a cycle.
                    let grow = ((t - 2.0) * frequency_hz * 2.0).min(1.0);
                    let a = amplitude_mm * grow;
                    [mean_mm + a * p.sin(), a * w * p.cos(), -a * w * w * p.sin()]
                }
            }
        }
    }
}

/// The specimen without the hidden effect, and the sensors.
#[derive(Debug, Clone)]
pub struct Bench {
    pub preload_n: f64,
    pub rate: f64,
    pub mu: f64,
    pub lengths: Vec<f64>,
    pub noise_n: f64,
    pub noise_mm: f64,
    pub lsb_n: f64,
    pub lsb_mm: f64,
    pub rate_hz: f64,
    pub motions: Vec<Motion>,
    /// Friction with the load (true) or constant at 40 N.
    pub sharp: bool,
}

pub fn normal(random: &mut ChaCha8Rng) -> f64 {
    let u: f64 = random.random::<f64>().max(1e-12);
    let v: f64 = random.random();
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

impl Bench {
    pub fn drawn(random: &mut ChaCha8Rng) -> Bench {
        let rate = 50.0 + 60.0 * random.random::<f64>();
        let preload_n = 150.0 * random.random::<f64>();
        let mu = 0.04 + 0.1 * random.random::<f64>();
        let l0 = 0.15 + 0.8 * random.random::<f64>();
        let lengths = (0..40)
            .map(|_| l0 * (-(random.random::<f64>().max(1e-3)).ln()).powf(0.7))
            .collect();
        let range = 2000.0;
        let noise_n = range * 10f64.powf(-3.7 + 0.9 * random.random::<f64>());
        let top = 2000.0 / rate;
        let scale = top / 26.0;
        let rate_hz: f64 = [100.0, 200.0, 250.0, 500.0][random.random_range(0..4)];
        let cycles = (2900.0f64 / rate_hz).clamp(5.0, 12.0);
        let sine = |a: f64, f: f64, m: f64| Motion::Sine {
            mean_mm: m * scale,
            amplitude_mm: a * scale,
            frequency_hz: f,
            cycles: (cycles * f).min(20.0).floor(),
        };
        let motions = vec![
            Motion::Ramp {
                top_mm: top,
                duration_s: 60.0 + 60.0 * random.random::<f64>(),
                hold_s: if random.random_bool(0.5) { 5.0 } else { 0.0 },
            },
            sine(6.0, 1.0, 9.0),
            sine(10.0, 1.0, 12.0),
            sine(15.0, 1.0, 17.0),
            sine(6.0, 2.5, 9.0),
        ];
        Bench {
            preload_n,
            rate,
            mu,
            lengths,
            noise_n,
            noise_mm: 0.0005 + 0.003 * random.random::<f64>(),
            lsb_n: 0.15,
            lsb_mm: 0.0005,
            rate_hz,
            motions,
            sharp: false,
        }
    }

    /// True force over a motion at the sampling times, before the sensors.
    pub fn force(&self, hidden: &[Hidden], motion: Motion) -> Vec<(f64, f64, f64)> {
        let get = |code: &str| hidden.iter().find(|h| h.code == code);
        let rate_hz = if matches!(motion, Motion::Ramp { .. }) {
            (2900.0 / motion.duration_s()).max(20.0)
        } else {
            self.rate_hz
        };
        let sub = 4;
        let dt = 1.0 / rate_hz / sub as f64;
        let steps = (motion.duration_s() / dt) as usize;
        let n = self.lengths.len();
        let mut drag = vec![0.0f64; n];
        let (mut x_before, mut dir, mut extreme, mut reversals) = (0.0f64, 0.0f64, 0.0f64, 0u32);
        let mut inner = 0.0f64; // specimen side of backlash
        let mut q = 0.0;
        let mut const_drag = 0.0f64;
        let mut out = Vec::new();
        let delay = get("channel_delay").map_or(0.0, |h| h.size * 1e-3);
        for k in 0..steps {
            let t = k as f64 * dt;
            let te = (t - delay).max(0.0);
            let [x, v, a] = motion.at(te);
            let x_shown = motion.at(t)[0];
            let mut xs = x;
            if let Some(h) = get("backlash") {
                inner = f64::clamp(inner, x - 0.5 * h.size, x + 0.5 * h.size);
                xs = inner;
            }
            let dx = xs - x_before;
            // Direction events.
            if dx > 0.0 && dir <= 0.0 || dx < 0.0 && dir >= 0.0 {
                if dir != 0.0 && (xs - extreme).abs() >= 0.0f64 {
                    reversals += 1;
                }
                dir = dx.signum();
            }
            if dx != 0.0 {
                extreme = xs;
            }
            for (r, l) in drag.iter_mut().zip(&self.lengths) {
                let l: f64 = if self.sharp { 0.01 } else { *l };
                *r = (*r + dx / l).clamp(-1.0, 1.0);
            }
            let r = drag.iter().sum::<f64>() / n as f64;
            const_drag = (const_drag + dx / 0.03).clamp(-1.0, 1.0);
            x_before = xs;
            let mut carried = self.preload_n + self.rate * xs;
            if let Some(h) = get("geometric_stiffness") {
                carried += h.size * (0.5 * xs * xs + 0.01 * xs * xs * xs);
            }
            if let Some(h) = get("progressive_stiffness") {
                carried += h.size * (xs - h.place).max(0.0);
            }
            if let Some(h) = get("lift_off") {
                carried = (carried - self.rate * h.size).max(0.0);
            }
            carried = carried.max(0.0);
            let mut mu = self.mu;
            let cycles = 0.5 * f64::from(reversals);
            if let Some(h) = get("run_in") {
                mu += h.size * (1.0 - (-cycles / h.place).exp());
            }
            if let Some(h) = get("stribeck") {
                mu += h.size * (-(v / h.place).powi(2)).exp();
            }
            if let Some(h) = get("strength_loss")
                && cycles >= h.place
            {
                carried *= 1.0 - h.size;
            }
            if let Some(h) = get("local_friction")
                && (xs - h.place).abs() < 1.5
            {
                mu += h.size;
            }
            let mut f = carried * (1.0 + mu * r);
            if let Some(h) = get("ripple") {
                f += h.size * (std::f64::consts::TAU * xs / h.place).sin();
            }
            if let Some(h) = get("coulomb_friction") {
                f += h.size * const_drag;
            }
            if let Some(h) = get("viscous_damping") {
                f += h.size * v;
            }
            if let Some(h) = get("inertia") {
                f += h.size * a * 1e-3;
            }
            if let Some(h) = get("relaxation") {
                q += h.size * dx - q * dt / h.place;
                f += q;
            }
            if let Some(h) = get("sensor_drift") {
                f += h.size * t / 60.0;
            }
            if let Some(h) = get("sensor_saturation") {
                f = f.min(h.size);
            }
            if k % sub == 0 {
                out.push((t, x_shown, f));
            }
        }
        out
    }

    pub fn record(&self, hidden: &[Hidden], random: &mut ChaCha8Rng) -> Vec<Recording> {
        self.motions
            .iter()
            .enumerate()
            .map(|(i, &m)| {
                let rows = self.force(hidden, m);
                let mut r = Recording {
                    name: format!("recording {i}"),
                    ..Default::default()
                };
                for (t, x, f) in rows {
                    r.time_s.push(t);
                    r.displacement_mm
                        .push(((x + self.noise_mm * normal(random)) / self.lsb_mm).round() * self.lsb_mm);
                    r.force_n
                        .push(((f + self.noise_n * normal(random)) / self.lsb_n).round() * self.lsb_n);
                }
                r
            })
            .collect()
    }

    /// RMS over all motions of what an effect changes after offset, rate, friction level are refitted, in units of noise.
    pub fn visible(&self, hidden: Hidden, others: &[Hidden]) -> f64 {
        let mut rows: Vec<([f64; 6], f64)> = Vec::new();
        let sigma = self.noise_n.hypot(self.rate * self.noise_mm);
        for &m in &self.motions {
            let mut both = others.to_vec();
            both.push(hidden);
            let with = self.force(&both, m);
            let without = self.force(others, m);
            let mut s = 0.0f64;
            let mut d = 0.0f64;
            let mut before = 0.0;
            for (a, b) in with.iter().zip(&without) {
                let dx = a.1 - before;
                before = a.1;
                if dx * d < 0.0 {
                    s = 0.0;
                }
                if dx != 0.0 {
                    d = dx.signum();
                }
                s += dx.abs();
                let load = self.preload_n + self.rate * a.1;
                rows.push((
                    [
                        1.0,
                        a.1,
                        d * load,
                        d * load * (-s / 0.3).exp(),
                        d * load * (-s / 1.0).exp(),
                        0.0,
                    ],
                    a.2 - b.2,
                ));
            }
        }
        let n = 5;
        let mut ata = nalgebra::DMatrix::<f64>::zeros(n, n);
        let mut atb = nalgebra::DVector::<f64>::zeros(n);
        for (r, y) in &rows {
            for i in 0..n {
                atb[i] += r[i] * y;
                for j in 0..n {
                    ata[(i, j)] += r[i] * r[j];
                }
            }
        }
        for i in 0..n {
            ata[(i, i)] *= 1.0 + 1e-9;
        }
        let c = ata.lu().solve(&atb).unwrap();
        let sum: f64 = rows
            .iter()
            .map(|(r, y)| (y - (0..n).map(|i| c[i] * r[i]).sum::<f64>()).powi(2))
            .sum();
        (sum / rows.len() as f64).sqrt() / sigma
    }

    /// An effect of a code, sized to a strength (RMS of 0.5 noise a unit).
    pub fn effect(&self, code: &'static str, strength: f64, random: &mut ChaCha8Rng) -> Hidden {
        let top = 2000.0 / self.rate;
        let u: f64 = random.random();
        let place = match code {
            "progressive_stiffness" => top * (0.4 + 0.35 * u),
            "run_in" => 1.5 + 3.0 * u,
            "stribeck" => 2.0 + 15.0 * u,
            "relaxation" => 2.0 + 20.0 * u,
            "strength_loss" => 2.0,
            "local_friction" => top * (0.3 + 0.3 * u),
            "ripple" => 1.5 + 2.0 * u,
            _ => 0.0,
        };
        let sign = if matches!(
            code,
            "geometric_stiffness" | "sensor_drift" | "channel_delay" | "run_in"
        ) && random.random_bool(0.5)
        {
            -1.0
        } else {
            1.0
        };
        let wanted = 0.5 * strength;
        let make = |s: f64| {
            let size = match code {
                "sensor_saturation" => 2000.0 * (1.0 - s),
                "lift_off" => s * top,
                _ => sign * s,
            };
            Hidden { code, size, place }
        };
        let (mut low, mut high) = (
            1e-7f64,
            match code {
                "sensor_saturation" | "lift_off" => 0.5,
                "inertia" => 200.0,
                "coulomb_friction" => 500.0,
                "sensor_drift" => 500.0,
                "backlash" => 3.0,
                "run_in" | "stribeck" | "strength_loss" | "local_friction" => 0.5,
                _ => 50.0,
            },
        );
        for _ in 0..24 {
            let mid = (low * high).sqrt();
            if self.visible(make(mid), &[]) < wanted {
                low = mid
            } else {
                high = mid
            }
        }
        make((low * high).sqrt())
    }
}

pub fn seeded(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}
