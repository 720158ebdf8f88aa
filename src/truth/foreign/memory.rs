//! Laws with memory: lost motion, sliders, relaxing arms, a mass on its fixture, the filters of a channel.

use super::laws::law;
use crate::truth::Hidden;
use crate::truth::world::Law;
use crate::units::inertia_force_n;

/// Number of sliders of a friction, and of pins with play.
const SLIDERS: usize = 8;
/// Largest number of relaxing arms.
const ARMS: usize = 10;

/// Lost motion of a gap whose pins differ or which is lined with rubber.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WornGap {
    hidden: Hidden,
    /// Displacement of the board, mm.
    board_mm: f64,
    /// Displacements of the pins behind it, mm.
    pins_mm: [f64; SLIDERS],
}

impl WornGap {
    pub(super) fn at_rest(hidden: Hidden) -> WornGap {
        WornGap {
            hidden,
            board_mm: 0.0,
            pins_mm: [0.0; SLIDERS],
        }
    }

    /// Displacement in mm behind the gap after the board has moved. `top_mm` is the largest displacement.
    pub(super) fn follow(&mut self, board_mm: f64, top_mm: f64) -> f64 {
        let Law { number, shape, .. } = law(&self.hidden);
        let half = 0.5 * self.hidden.size.max(1e-9);
        let travel = board_mm - self.board_mm;
        self.board_mm = board_mm;
        let play = |pin: f64, half: f64| pin.clamp(board_mm - half, board_mm + half);
        match number {
            // Pins with different wear.
            0 => {
                for (k, pin) in self.pins_mm.iter_mut().enumerate() {
                    let share = (k as f64 + 0.5) / SLIDERS as f64;
                    *pin = play(*pin, half * (1.0 + (0.5 + shape) * (share - 0.5)));
                }
                self.pins_mm.iter().sum::<f64>() / SLIDERS as f64
            }
            // A wedge: worn more where the load is higher.
            2 => {
                self.pins_mm[0] = play(self.pins_mm[0], half * (0.5 + board_mm / top_mm));
                self.pins_mm[0]
            }
            // Rubber: on both sides, or below only.
            _ => {
                let lined = number == 1 || travel > 0.0;
                self.pins_mm[0] = if lined {
                    rubber(self.pins_mm[0], board_mm, travel, half, 1.0 + 2.0 * shape)
                } else {
                    play(self.pins_mm[0], half)
                };
                self.pins_mm[0]
            }
        }
    }
}

/// Displacement in mm of a pin in a lined gap: the lining takes less of the travel the more it is pressed.
fn rubber(pin_mm: f64, board_mm: f64, travel_mm: f64, half_mm: f64, power: f64) -> f64 {
    let steps = (travel_mm.abs() / (0.1 * half_mm)).ceil().clamp(1.0, 100.0);
    let (h, sign) = (travel_mm.abs() / steps, travel_mm.signum());
    // Offset of the board from the pin, along the travel.
    let mut offset = (sign * (board_mm - travel_mm - pin_mm)).clamp(-half_mm, half_mm);
    for _ in 0..steps as usize {
        let pressed = 0.5 * (1.0 + offset / half_mm);
        offset = (offset + h * (1.0 - pressed.powf(power))).min(half_mm);
    }
    board_mm - sign * offset
}

/// A dry friction that does not depend on the load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sliders {
    number: usize,
    /// 1 / length in 1/mm and drag of each slider.
    sliders: [[f64; 2]; SLIDERS],
    /// Travel in mm since the last reversal, with the sign of the direction.
    since_mm: f64,
}

impl Sliders {
    /// Sliders of the law of a Coulomb friction.
    pub(super) fn of_law(hidden: &Hidden) -> Sliders {
        let Law { number, shape, .. } = law(hidden);
        let mean_mm = 0.05 + 0.25 * shape;
        Sliders::new(number, |share| match number {
            // One stop, elastic and then plastic.
            0 => mean_mm,
            // Lengths over two decades.
            1 => 0.2 * mean_mm * 100f64.powf(share),
            // A bushing and a seal.
            2 => {
                if share < 0.5 {
                    0.02
                } else {
                    2.0 * mean_mm
                }
            }
            _ => 0.5 * mean_mm,
        })
    }

    /// One slider that reverses over `length_mm`.
    pub(super) fn single(length_mm: f64) -> Sliders {
        Sliders::new(0, |_| length_mm)
    }

    fn new(number: usize, length_mm: impl Fn(f64) -> f64) -> Sliders {
        let mut sliders = [[0.0; 2]; SLIDERS];
        for (k, slider) in sliders.iter_mut().enumerate() {
            slider[0] = 2.0 / length_mm((k as f64 + 0.5) / SLIDERS as f64);
        }
        Sliders {
            number,
            sliders,
            since_mm: 0.0,
        }
    }

    pub(super) fn moved(mut self, travel_mm: f64) -> Sliders {
        for [stiffness, drag] in &mut self.sliders {
            *drag = (*drag + travel_mm * *stiffness).clamp(-1.0, 1.0);
        }
        if travel_mm * self.since_mm < 0.0 {
            self.since_mm = 0.0;
        }
        self.since_mm += travel_mm;
        self
    }

    /// Mean drag, about -1 to 1.
    pub(super) fn drag(&self) -> f64 {
        let mean = self.sliders.iter().map(|s| s[1]).sum::<f64>() / SLIDERS as f64;
        match self.number {
            // The friction rises by a fifth over some millimetres of sliding.
            3 => mean * (1.0 - 0.2 * (-self.since_mm.abs() / 2.0).exp()),
            _ => mean,
        }
    }
}

/// Springs that relax, in parallel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Arms {
    /// Rate in N/mm, time constant in s and force in N of each.
    arms: [[f64; 3]; ARMS],
}

impl Arms {
    /// Arms of the law of a relaxation. With a shape above 0.5 the specimen was loaded until just before the recording, at 30 %
    /// of `top_mm`, and the arms still pull; else they have relaxed.
    pub(super) fn of_law(hidden: &Hidden, top_mm: f64) -> Arms {
        let Law { number, shape, .. } = law(hidden);
        let at = hidden.place;
        // Weight and time constant.
        let list: Vec<[f64; 2]> = match number {
            0 => vec![[0.6, at], [0.4, at * (4.0 + 6.0 * shape)]],
            1 => (0..4)
                .map(|k| [0.25, at * 4f64.powf(f64::from(k) - 1.5)])
                .collect(),
            // (1 + t / tau)^-p is a gamma distribution of rates.
            2 => {
                let power = 0.2 + 0.4 * shape;
                let rates = (0..ARMS).map(|k| 2e-3 * 2.4f64.powf(k as f64));
                rates.map(|s| [s.powf(power) * (-s).exp(), at / s]).collect()
            }
            // Logarithmic in time over two decades and a half.
            _ => (0..7)
                .map(|k| [1.0, at * 10f64.powf(-1.0 + 2.5 * f64::from(k) / 6.0)])
                .collect(),
        };
        let sum: f64 = list.iter().map(|a| a[0]).sum();
        let mut arms = [[0.0, 1.0, 0.0]; ARMS];
        for (arm, [weight, time_constant_s]) in arms.iter_mut().zip(list) {
            let rate = hidden.size * weight / sum;
            let pulled = if shape > 0.5 { -0.3 * top_mm * rate } else { 0.0 };
            *arm = [rate, time_constant_s, pulled];
        }
        Arms { arms }
    }

    pub(super) fn moved(mut self, travel_mm: f64, dt_s: f64) -> Arms {
        for [rate, time_constant_s, force_n] in &mut self.arms {
            // Implicit (Euler), so that fast arms are stable.
            *force_n = (*force_n + *rate * travel_mm) / (1.0 + dt_s / *time_constant_s);
        }
        self
    }

    pub(super) fn force_n(&self) -> f64 {
        self.arms.iter().map(|a| a[2]).sum()
    }
}

/// A mass between load cell and specimen, on a fixture that vibrates.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Fixture {
    /// Acceleration that the load cell sees in mm/s2, and its rate.
    seen: [f64; 2],
}

impl Fixture {
    /// Force in N after a step at this displacement in mm, speed in mm/s and acceleration in mm/s2.
    pub(super) fn step(&mut self, h: &Hidden, motion: [f64; 3], dt_s: f64, top_mm: f64) -> f64 {
        let Law { number, shape, .. } = law(h);
        let [x, speed, acceleration] = motion;
        let seen = match number {
            // A lever: the mass that is felt grows with the displacement.
            1 => acceleration * (1.0 + 0.4 * x / top_mm) + 0.2 * speed * speed / top_mm,
            // A loose part that follows late.
            3 => {
                let constant_s = 0.005 + 0.01 * shape;
                self.seen[0] += (acceleration - self.seen[0]) * (1.0 - (-dt_s / constant_s).exp());
                0.5 * (acceleration + self.seen[0])
            }
            _ => {
                let turn = std::f64::consts::TAU * (12.0 + 20.0 * shape);
                let (stiff, damped) = (turn * turn * dt_s, 0.3 * turn * dt_s);
                // Implicit in the rate, so that a long step damps and does not grow.
                self.seen[1] =
                    (self.seen[1] + stiff * (acceleration - self.seen[0])) / (1.0 + damped + stiff * dt_s);
                self.seen[0] += self.seen[1] * dt_s;
                let rigid = if number == 2 { 0.6 } else { 0.0 };
                rigid * acceleration + (1.0 - rigid) * self.seen[0]
            }
        };
        inertia_force_n(h.size, seen)
    }
}

/// Equal first-order filters in a row; none for a pure delay.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Filters {
    /// Input and output in N of each filter at the last step; `None` before the first.
    last: Option<[f64; 5]>,
}

/// Number of filters of a delay law; `None` for a pure delay.
pub(super) fn filters_of(h: &Hidden) -> Option<usize> {
    [None, Some(1), Some(2), Some(4)][law(h).number.min(3)]
}

impl Filters {
    /// Output in N after a step, of `count` filters with a total delay in s.
    pub(super) fn step(&mut self, force_n: f64, dt_s: f64, delay_s: f64, count: usize) -> f64 {
        let mut last = self.last.unwrap_or([force_n; 5]);
        let steps = dt_s * count as f64 / delay_s.max(1e-9);
        let left = (-steps).exp();
        // Share of the new input in an input that changes in proportion to time.
        let share = if steps > 1e-6 {
            1.0 - (1.0 - left) / steps
        } else {
            0.5 * steps
        };
        let mut input = force_n;
        for k in 0..count.min(4) {
            let output = last[k + 1] * left + last[k] * (1.0 - left - share) + input * share;
            last[k] = input;
            input = output;
        }
        last[count.min(4)] = input;
        self.last = Some(last);
        input
    }
}

/// Delays in s, all with the same weight, whose mean over a motion is what `count` filters in a row show of it.
pub(super) fn delays_s(delay_s: f64, count: Option<usize>) -> Vec<f64> {
    const QUANTILES: usize = 16;
    let Some(count) = count else {
        return vec![delay_s];
    };
    // Probability that the sum of `count` exponential delays is below u.
    let below = |u: f64| {
        let mut term = 1.0;
        let mut sum = 1.0;
        for k in 1..count {
            term *= u / k as f64;
            sum += term;
        }
        1.0 - (-u).exp() * sum
    };
    let quantile = |share: f64| {
        let (mut low, mut high) = (0.0f64, 40.0f64);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if below(middle) < share {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    };
    let list: Vec<f64> = (0..QUANTILES)
        .map(|k| quantile((k as f64 + 0.5) / QUANTILES as f64))
        .collect();
    let mean = list.iter().sum::<f64>() / QUANTILES as f64;
    list.into_iter().map(|u| u * delay_s / mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hidden(number: usize, size: f64, place: f64, shape: f64) -> Hidden {
        Hidden {
            code: "",
            size,
            place,
            width: 2.0,
            law: Some(Law {
                number,
                name: "",
                shape,
            }),
        }
    }

    /// Up to 10 mm and back to 5 mm in steps of 0.01 mm.
    fn travel() -> impl Iterator<Item = f64> {
        let up = (1..=1000).map(|k| 0.01 * f64::from(k));
        up.chain((500..1000).rev().map(|k| 0.01 * f64::from(k)))
    }

    #[test]
    fn a_gap_is_lost_between_the_branches() {
        for number in 0..4 {
            let mut gap = WornGap::at_rest(hidden(number, 0.4, 0.0, 0.5));
            let pins: Vec<(f64, f64)> = travel().map(|x| (x, gap.follow(x, 20.0))).collect();
            let up = pins[499];
            let down = pins[pins.len() - 1];
            assert!((up.0 - down.0).abs() < 1e-9);
            // The rubber is pressed over a longer travel than here for a high power; the wedge has 0.5 + 5 / 20 of the gap.
            let lost = down.1 - up.1;
            assert!(lost > 0.25 && lost < 0.41, "{number}: {lost}");
            assert!(
                pins.windows(2).all(|w| (w[1].1 - w[0].1).abs() <= 0.011),
                "{number}"
            );
        }
    }

    #[test]
    fn a_friction_that_slides_has_its_full_drag() {
        for number in 0..4 {
            let end = travel().fold(
                (Sliders::of_law(&hidden(number, 1.0, 0.0, 0.5)), 0.0),
                |(s, last), x| (s.moved(x - last), x),
            );
            let drag = end.0.drag();
            assert!(drag < -0.8 && drag > -1.0 - 1e-9, "{number}: {drag}");
        }
    }

    #[test]
    fn arms_have_the_whole_rate_at_once_and_lose_it() {
        for number in 0..4 {
            let arms = Arms::of_law(&hidden(number, 8.0, 4.0, 0.4), 20.0).moved(1.0, 1e-6);
            assert!(
                (arms.force_n() - 8.0).abs() < 1e-3,
                "{number}: {}",
                arms.force_n()
            );
            let later = (0..4000).fold(arms, |a, _| a.moved(0.0, 0.01));
            assert!(later.force_n() < 0.75 * arms.force_n(), "{number}");
        }
    }

    #[test]
    fn filters_delay_a_ramp_by_their_delay() {
        for count in [1, 2, 4] {
            let mut filters = Filters::default();
            let shown = (0..1000)
                .map(|k| filters.step(f64::from(k), 1e-3, 0.02, count))
                .last();
            // 1 N a millisecond, 20 ms.
            assert!(
                (shown.expect("steps") - (999.0 - 20.0)).abs() < 1e-3,
                "{count}: {shown:?}"
            );
            let delays = delays_s(0.02, Some(count));
            let mean = delays.iter().sum::<f64>() / delays.len() as f64;
            assert!((mean - 0.02).abs() < 1e-9);
        }
        assert_eq!(delays_s(0.02, None), [0.02]);
    }

    #[test]
    fn a_steady_acceleration_is_felt_as_that_of_the_mass() {
        for number in [0, 2, 3] {
            let mut fixture = Fixture::default();
            let force = (0..4000)
                .map(|_| fixture.step(&hidden(number, 10.0, 0.0, 0.5), [0.0, 0.0, 500.0], 2e-3, 20.0))
                .last();
            assert!((force.expect("steps") - 5.0).abs() < 1e-6, "{number}");
        }
    }
}
