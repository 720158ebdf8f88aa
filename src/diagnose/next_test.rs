//! The test that would tell two explanations apart, within what the recordings covered: displacement, speed, frequency.
//!
//! Both are simulated over a set of profiles; the rival may refit itself to the other's prediction, as far as the recordings
//! at hand let it (T-criterion, Atkinson and Fedorov 1975, linearised). The profile with the most separation for its time wins.

use nalgebra::{DMatrix, DVector};

use super::diagnosis::NextTest;
use super::problem::Structure;
use super::select::{Bench, Node};
use crate::identify::Residuals;
use crate::identify::jacobian::typical;

/// Separation that settles the matter, in standard deviations.
const ENOUGH_SIGMA: f64 = 5.0;
/// Samples a second of the simulated test.
const SAMPLE_HZ: f64 = 250.0;

enum Piece {
    Ramp {
        to_mm: f64,
        duration_s: f64,
    },
    Hold {
        duration_s: f64,
    },
    Sine {
        mean_mm: f64,
        amplitude_mm: f64,
        frequency_hz: f64,
        cycles: u32,
    },
}

struct Test {
    name: &'static str,
    pieces: Vec<Piece>,
}

impl Test {
    /// Time and displacement, coarser where nothing is fast.
    fn motion(&self) -> Vec<(f64, f64)> {
        let mut points = vec![(0.0, 0.0)];
        let mut at_mm = 0.0;
        for piece in &self.pieces {
            let start_s = points.last().map_or(0.0, |p| p.0);
            let (duration_s, step_s) = match piece {
                Piece::Ramp { duration_s, .. } | Piece::Hold { duration_s } => {
                    (*duration_s, (duration_s / 400.0).max(1.0 / SAMPLE_HZ))
                }
                Piece::Sine {
                    frequency_hz, cycles, ..
                } => (
                    f64::from(*cycles) / frequency_hz,
                    (1.0 / frequency_hz / 120.0).max(1.0 / SAMPLE_HZ),
                ),
            };
            let steps = (duration_s / step_s).ceil().max(1.0);
            for k in 1..=steps as usize {
                let share = k as f64 / steps;
                let x = match piece {
                    Piece::Ramp { to_mm, .. } => at_mm + (to_mm - at_mm) * share,
                    Piece::Hold { .. } => at_mm,
                    Piece::Sine {
                        mean_mm,
                        amplitude_mm,
                        frequency_hz,
                        ..
                    } => {
                        let angle = std::f64::consts::TAU * frequency_hz * duration_s * share;
                        mean_mm + amplitude_mm * angle.sin()
                    }
                };
                points.push((start_s + duration_s * share, x));
            }
            at_mm = points.last().map_or(0.0, |p| p.1);
        }
        points
    }

    fn toml(&self, description: &str) -> String {
        let mut text = format!(
            "name = \"next-test-{}\"\ndescription = {}\ncontrol = \"displacement\"\n\n[[block]]\nrepeat = 1\n",
            self.name,
            toml::Value::String(description.to_owned())
        );
        for piece in &self.pieces {
            text += "\n[[block.segment]]\n";
            text += &match piece {
                Piece::Ramp { to_mm, duration_s } => {
                    format!("kind = \"ramp\"\nto_mm = {to_mm:.3}\nduration_s = {duration_s:.2}\n")
                }
                Piece::Hold { duration_s } => format!("kind = \"hold\"\nduration_s = {duration_s:.2}\n"),
                Piece::Sine {
                    mean_mm,
                    amplitude_mm,
                    frequency_hz,
                    cycles,
                } => format!(
                    "kind = \"sine\"\nmean_mm = {mean_mm:.3}\namplitude_mm = {amplitude_mm:.3}\nfrequency_hz = {frequency_hz:?}\ncycles = {cycles}\n"
                ),
            };
        }
        text
    }
}

/// Runnable profiles inside what the recordings covered.
fn tests(bench: &Bench<'_>) -> Vec<Test> {
    let [low, high] = bench.span.displacement_mm;
    let low = low.max(0.0);
    let travel = high - low;
    let at = |share: f64| low + share * travel;
    let fastest = bench.span.speed_mm_s.max(1.0);
    let ramp = |to_mm: f64, duration_s: f64| Piece::Ramp {
        to_mm,
        duration_s: duration_s.max(2.0 * travel / fastest),
    };
    let sine = |mean: f64, amplitude: f64, frequency_hz: f64, cycles: u32| {
        let amplitude_mm = (amplitude * travel).min(0.9 * fastest / (std::f64::consts::TAU * frequency_hz));
        vec![
            ramp(at(mean), 5.0),
            Piece::Sine {
                mean_mm: at(mean),
                amplitude_mm,
                frequency_hz,
                cycles,
            },
            ramp(at(0.02), 5.0),
        ]
    };
    let nests = |mean: f64| {
        let mut pieces = vec![ramp(at(mean), 5.0)];
        for size in [0.2, 0.5, 1.0, 2.0, 4.0] {
            let size: f64 = f64::min(size, 0.3 * travel);
            for _ in 0..2 {
                pieces.push(ramp(at(mean) - size, (2.0 * size).max(0.5)));
                pieces.push(ramp(at(mean), (2.0 * size).max(0.5)));
            }
        }
        pieces.push(ramp(at(0.02), 5.0));
        pieces
    };
    let up_and_down = |duration_s: f64| vec![ramp(at(0.98), duration_s), ramp(at(0.02), duration_s)];
    vec![
        Test {
            name: "ramp-2-s",
            pieces: up_and_down(2.0),
        },
        Test {
            name: "ramp-20-s",
            pieces: up_and_down(20.0),
        },
        Test {
            name: "ramp-120-s",
            pieces: up_and_down(60.0),
        },
        Test {
            name: "two-holds",
            pieces: vec![
                ramp(at(0.9), 5.0),
                Piece::Hold { duration_s: 60.0 },
                ramp(at(0.3), 5.0),
                Piece::Hold { duration_s: 60.0 },
                ramp(at(0.02), 5.0),
            ],
        },
        Test {
            name: "nests-high",
            pieces: nests(0.85),
        },
        Test {
            name: "nests-low",
            pieces: nests(0.35),
        },
        Test {
            name: "sine-slow",
            pieces: sine(0.5, 0.4, 0.1, 4),
        },
        Test {
            name: "sine-low-load",
            pieces: sine(0.25, 0.2, 1.0, 12),
        },
        Test {
            name: "sine-high-load",
            pieces: sine(0.8, 0.15, 1.0, 12),
        },
        Test {
            name: "sine-5-hz",
            pieces: sine(0.5, 0.15, 5.0, 40),
        },
        Test {
            name: "sine-8-hz",
            pieces: sine(0.5, 0.1, 8.0, 60),
        },
        Test {
            name: "sine-60-cycles",
            pieces: sine(0.5, 0.3, 1.0, 60),
        },
    ]
}

/// The most telling profile between the set chosen and a rival; `None` where none tells enough.
pub(super) fn propose(
    bench: &Bench<'_>,
    chosen: &Node,
    rival: &Node,
    names: (&str, &str),
) -> Option<NextTest> {
    let ours = Structure::new(bench.setup, bench.data, chosen.attached.clone());
    let theirs = Structure::new(bench.setup, bench.data, rival.attached.clone());
    let (known, scale) = theirs.sensitivities(&rival.values, &theirs.fitted(&rival.values)?);
    let prior = known.tr_mul(&known);
    let noise_n = {
        let weights: Vec<f64> = bench.data.weight.iter().copied().filter(|w| *w > 0.0).collect();
        1.0 / super::smoothing::median(weights).max(1e-12)
    };
    let tests = tests(bench);
    let scored = bench.side_by_side(&tests, |test| {
        let motion = test.motion();
        let run = |structure: &Structure<'_>, values: &[f64]| -> Option<DVector<f64>> {
            let own = &values[..values.len() - 1];
            let mut plant = super::baseline::build(bench.setup, &structure.attached, own, 0.0).ok()?;
            let mut before_s = 0.0;
            Some(DVector::from_iterator(
                motion.len(),
                motion.iter().map(|&(t, x)| {
                    let force_n = plant.step(x, t - before_s);
                    before_s = t;
                    force_n / noise_n
                }),
            ))
        };
        let (a, b) = (run(&ours, &chosen.values)?, run(&theirs, &rival.values)?);
        let mut jacobian = DMatrix::zeros(motion.len(), rival.values.len());
        for (n, p) in theirs
            .parameters()
            .iter()
            .enumerate()
            .take(rival.values.len() - 1)
        {
            if bench.setup.surrogate.as_ref().is_some_and(|s| s.holds(n)) {
                continue;
            }
            let size = typical(rival.values[n], p.belief, p.bounds);
            let mut moved = rival.values.clone();
            let step = if moved[n] + 1e-4 * size <= p.bounds[1] {
                1e-4
            } else {
                -1e-4
            };
            moved[n] += step * size;
            let column = (run(&theirs, &moved)? - &b) * (scale[n] / (step * size));
            jacobian.set_column(n, &column);
        }
        let difference = a - b;
        let mut normal = jacobian.tr_mul(&jacobian) + &prior;
        for i in 0..normal.nrows() {
            normal[(i, i)] = normal[(i, i)] * (1.0 + 1e-9) + 1e-9;
        }
        let moves = normal.cholesky()?.solve(&jacobian.tr_mul(&difference));
        let left = (&difference - &jacobian * &moves).norm_squared() + (&known * &moves).norm_squared();
        let duration_s = motion.last().map_or(0.0, |p| p.0);
        Some((left.sqrt(), duration_s))
    });
    let (test, (separation_sigma, duration_s)) = tests
        .iter()
        .zip(scored)
        .filter_map(|(test, score)| Some((test, score?)))
        .filter(|(_, (sigma, _))| *sigma >= ENOUGH_SIGMA * bench_correlation(chosen, bench))
        .max_by(|(_, a), (_, b)| (a.0 / a.1.max(10.0).sqrt()).total_cmp(&(b.0 / b.1.max(10.0).sqrt())))?;
    let why = format!(
        "over this profile {} and {} differ by {separation_sigma:.0} times the noise, after {} has been refitted to all that is known",
        names.0, names.1, names.1
    );
    Some(NextTest {
        profile_toml: test.toml(&format!("Tells {} from {}.", names.0, names.1)),
        why,
        separation_sigma,
        duration_s,
    })
}

/// Root of the correlation time: correlated samples count for less.
fn bench_correlation(node: &Node, bench: &Bench<'_>) -> f64 {
    let worth = super::select::Worth::of(bench.data, &node.residuals);
    (worth.spread * worth.correlation).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_and_file_say_the_same() {
        let test = Test {
            name: "example",
            pieces: vec![
                Piece::Ramp {
                    to_mm: 5.0,
                    duration_s: 10.0,
                },
                Piece::Hold { duration_s: 2.0 },
                Piece::Sine {
                    mean_mm: 5.0,
                    amplitude_mm: 2.0,
                    frequency_hz: 1.0,
                    cycles: 3,
                },
            ],
        };
        let motion = test.motion();
        assert_eq!(motion.last().map(|p| (p.0 * 1e6).round()), Some(15e6));
        assert!(motion.windows(2).all(|w| w[1].0 > w[0].0));
        let top = motion.iter().map(|p| p.1).fold(0.0, f64::max);
        // 120 points a cycle: the peak is met to 2 (1 - cos(1.5 deg)).
        assert!((top - 7.0).abs() < 1e-3, "{top}");
        let file: toml::Table = test.toml("Tells \"a\" from b.").parse().expect("valid TOML");
        assert_eq!(file["control"].as_str(), Some("displacement"));
        let segments = file["block"][0]["segment"].as_array().expect("segments");
        assert_eq!(segments.len(), 3);
        assert_eq!(segments[2]["cycles"].as_integer(), Some(3));
    }
}
