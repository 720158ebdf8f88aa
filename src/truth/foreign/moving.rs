//! A specimen in motion, with its own steps in time: from the displacement of the board to the force that the amplifier shows.

use super::laws::{
    bow, damping_n, drift_n, fading, geometric_n, get, joint_mm, law, load_exponent, progressive_n, seated_mm,
};
use super::memory::{Arms, Filters, Fixture, Sliders, WornGap, delays_s, filters_of};
use super::operator::FrictionOperator;
use super::outside::Outside;
use super::stack::{Interfaces, LeafStack};
use crate::truth::{Form, Hidden, Programme, TruthSpecimen, World};

/// Largest time step of a ramp and of a fast motion, s.
const STEPS_S: [f64; 2] = [0.01, 0.002];
/// Travel in mm over which a friction of the contacts reverses that has no presliding.
const SHARP_MM: f64 = 0.004;
/// Travel in mm over which a bushing reverses.
const BUSHING_MM: f64 = 0.05;
/// Travel in mm over which an added friction reverses that fades with speed: smallest and largest.
const STICKY_MM: [f64; 2] = [0.02, 0.5];
/// Largest number of secant steps for a specimen in series with a joint, and the error in mm that ends them.
const SECANTS: (usize, f64) = (30, 1e-9);

/// True force in N at the rising times `times_s` of a motion, before the sensors.
pub(in crate::truth) fn forces(
    specimen: &TruthSpecimen,
    hidden: &[Hidden],
    motion: &Programme,
    times_s: &[f64],
) -> Vec<f64> {
    let mut moving = MovingSpecimen::new(specimen, hidden, motion);
    // Negative delays are of the displacement, see `seen_mm`.
    let delay = get(hidden, "channel_delay").filter(|h| h.size > 0.0 && filters_of(h).is_none());
    let delay_s = 1e-3 * delay.map_or(0.0, |h| h.size);
    let forces = times_s.iter().map(|&t| {
        let force_n = moving.go_to(t - delay_s);
        force_n + get(hidden, "sensor_drift").map_or(0.0, |h| drift_n(h, t))
    });
    forces.collect()
}

/// Displacement in mm that the LVDT shows, before its noise.
pub(in crate::truth) fn seen_mm(
    specimen: &TruthSpecimen,
    hidden: &[Hidden],
    motion: &Programme,
    times_s: &[f64],
) -> Vec<f64> {
    let late = get(hidden, "channel_delay").filter(|h| h.size < 0.0);
    let delays = late.map_or(vec![0.0], |h| delays_s(-1e-3 * h.size, filters_of(h)));
    let top_mm = specimen.top_mm();
    let bent = get(hidden, "sensor_curvature");
    let seen = times_s.iter().map(|t| {
        let x = delays.iter().map(|d| motion.at_mm(t - d)).sum::<f64>() / delays.len() as f64;
        x + bent.map_or(0.0, |h| h.size * top_mm * bow(h, x / top_mm))
    });
    seen.collect()
}

/// Friction between the leaves.
#[expect(clippy::large_enum_variant, reason = "a copy without an allocation")]
#[derive(Debug, Clone, Copy)]
enum LeafFriction {
    /// All contacts as one.
    Whole(FrictionOperator),
    /// Each contact of a pack.
    Single(Interfaces),
}

/// A specimen in motion: its state at one time.
struct MovingSpecimen<'a> {
    specimen: &'a TruthSpecimen,
    hidden: &'a [Hidden],
    motion: &'a Programme,
    step_s: f64,
    time_s: f64,
    /// Displacement of the specimen, mm.
    x_mm: f64,
    /// Direction of the last travel, -1 to 1.
    direction: f64,
    /// Displacement of the last reversal in mm, and how many reversals there were that were more than 2 % of the range apart.
    turned: (f64, f64),
    /// Travel in mm, and work of the friction in N mm.
    path: [f64; 2],
    /// The leaves in [`World::Pack`].
    stack: Option<LeafStack>,
    contacts: LeafFriction,
    bushing: Sliders,
    gap: Option<WornGap>,
    coulomb: Option<Sliders>,
    sticky: Sliders,
    arms: Option<Arms>,
    fixture: Fixture,
    filters: Filters,
    outside: Outside,
    /// Force at the last step, N.
    force_n: f64,
}

impl<'a> MovingSpecimen<'a> {
    fn new(specimen: &'a TruthSpecimen, hidden: &'a [Hidden], motion: &'a Programme) -> MovingSpecimen<'a> {
        let size = |code: &str| get(hidden, code).map_or(0.0, |h| h.size);
        let travel_mm = match (get(hidden, "presliding"), specimen.form) {
            (Some(h), _) => h.size,
            (None, Form::Sharp) => SHARP_MM,
            _ => specimen.presliding_mm,
        };
        let ratio =
            specimen.friction_ratio + size("load_dependent_friction") + size("rate_independent_friction");
        let sticky_mm = get(hidden, "stribeck").map_or(STICKY_MM[0], |h| {
            STICKY_MM[0] + (STICKY_MM[1] - STICKY_MM[0]) * law(h).shape
        });
        let stack = (specimen.world == World::Pack).then(|| LeafStack::of(specimen));
        let whole = FrictionOperator::at_rest(specimen, travel_mm, ratio * 0.5 * specimen.range_n);
        let single = stack.as_ref().map(Interfaces::at_rest);
        let mut moving = MovingSpecimen {
            specimen,
            hidden,
            motion,
            step_s: STEPS_S[usize::from(!matches!(motion, Programme::Ramp { .. }))],
            time_s: 0.0,
            x_mm: 0.0,
            direction: 0.0,
            turned: (0.0, 0.0),
            path: [0.0; 2],
            stack,
            contacts: single.map_or(LeafFriction::Whole(whole), LeafFriction::Single),
            bushing: Sliders::single(BUSHING_MM),
            gap: get(hidden, "backlash").copied().map(WornGap::at_rest),
            coulomb: get(hidden, "coulomb_friction").map(Sliders::of_law),
            sticky: Sliders::single(sticky_mm),
            arms: get(hidden, "relaxation").map(|h| Arms::of_law(h, specimen.top_mm())),
            fixture: Fixture::default(),
            filters: Filters::default(),
            outside: Outside::of(hidden),
            force_n: 0.0,
        };
        moving.force_n = moving.carried_n(0.0) + moving.arms.map_or(0.0, |a| a.force_n());
        moving
    }

    fn get(&self, code: &str) -> Option<&'a Hidden> {
        get(self.hidden, code)
    }

    /// Steps through the turning points up to a time in s, and returns the force there in N.
    fn go_to(&mut self, time_s: f64) -> f64 {
        let from_s = self.time_s;
        let steps = ((time_s - from_s) / self.step_s).ceil().max(1.0);
        for k in 1..=steps as usize {
            let to = from_s + (time_s - from_s) * k as f64 / steps;
            if to <= self.time_s {
                continue;
            }
            if let Some(turn) = self.motion.turning_point_s(self.time_s, to)
                && turn > self.time_s
            {
                self.advance(turn);
            }
            self.advance(to);
        }
        self.force_n
    }

    /// One step in one direction.
    fn advance(&mut self, to_s: f64) {
        let dt_s = to_s - self.time_s;
        self.time_s = to_s;
        let top_mm = self.specimen.top_mm();
        let board_mm = self.motion.at_mm(to_s);
        let pin_mm = self.gap.as_mut().map_or(board_mm, |g| g.follow(board_mm, top_mm));
        let x_mm = self.jointed_mm(
            self.get("lift_off").map_or(pin_mm, |h| seated_mm(h, pin_mm)),
            dt_s,
        );
        let travel_mm = x_mm - self.x_mm;
        self.count(travel_mm);
        let limit_n = self.limit_n(x_mm);
        self.contacts = self.slid(x_mm, dt_s, limit_n);
        self.bushing = self.bushing.moved(travel_mm);
        self.coulomb = self.coulomb.map(|s| s.moved(travel_mm));
        self.sticky = self.sticky.moved(travel_mm);
        self.arms = self.arms.map(|a| a.moved(travel_mm, dt_s));
        self.x_mm = x_mm;
        let friction_n = self.friction_n(&self.contacts, x_mm, limit_n);
        self.path[0] += travel_mm.abs();
        self.path[1] += (friction_n * travel_mm).abs();
        let warm = (friction_n * travel_mm).abs()
            / (self.specimen.friction_ratio.max(0.01) * 0.5 * self.specimen.range_n * top_mm);
        self.outside.step(x_mm, travel_mm, dt_s, warm, self.specimen);
        self.force_n = self.shown_n(limit_n, friction_n, dt_s);
    }

    /// Force in N behind the filters of the amplifier.
    fn shown_n(&mut self, limit_n: f64, friction_n: f64, dt_s: f64) -> f64 {
        let (t, x) = (self.time_s, self.x_mm);
        let speed = self.motion.speed_mm_s(t);
        let carried = self.carried_n(x);
        let mut force_n = carried + friction_n + self.outside.force_n(x, self.specimen);
        if let (Form::Smoothed { speed_mm_s }, None) =
            (self.specimen.form, self.get("rate_independent_friction"))
        {
            // The friction of the simulation, in the place of that of the contacts.
            force_n += limit_n * (speed / speed_mm_s).tanh() - friction_n;
        }
        if let Some(h) = self.get("stribeck") {
            force_n += carried * h.size * self.sticky.drag() * fading(h, speed);
        }
        if let (Some(h), Some(sliders)) = (self.get("coulomb_friction"), &self.coulomb) {
            force_n += h.size * sliders.drag();
        }
        if let Some(h) = self.get("viscous_damping") {
            force_n += damping_n(h, speed);
        }
        if let Some(h) = self.get("inertia") {
            let motion = [x, speed, self.motion.acceleration_mm_s2(t)];
            force_n += self.fixture.step(h, motion, dt_s, self.specimen.top_mm());
        }
        force_n += self.arms.map_or(0.0, |a| a.force_n());
        match self.get("channel_delay").filter(|h| h.size > 0.0) {
            Some(h) => filters_of(h).map_or(force_n, |count| {
                self.filters.step(force_n, dt_s, 1e-3 * h.size, count)
            }),
            None => force_n,
        }
    }

    /// Displacement in mm of a specimen in series with a joint: both carry the same force.
    fn jointed_mm(&self, board_mm: f64, dt_s: f64) -> f64 {
        let Some(h) = self.get("series_compliance") else {
            return board_mm;
        };
        let top_n = self.specimen.top_n();
        let short_mm = |x: f64| {
            let limit_n = self.limit_n(x);
            let contacts = self.slid(x, dt_s, limit_n);
            let force_n = self.carried_n(x) + self.friction_n(&contacts, x, limit_n);
            x + joint_mm(h, force_n, top_n) - board_mm
        };
        root(short_mm, board_mm - joint_mm(h, 2.0 * top_n, top_n), board_mm)
    }

    /// Counts reversals and remembers where the last one was.
    fn count(&mut self, travel_mm: f64) {
        if travel_mm == 0.0 {
            return;
        }
        if travel_mm * self.direction < 0.0 {
            if (self.x_mm - self.turned.0).abs() > 0.02 * self.specimen.top_mm() {
                self.turned.1 += 1.0;
            }
            self.turned.0 = self.x_mm;
        }
        self.direction = travel_mm.signum();
    }

    /// The contacts after a slide to a displacement in mm.
    fn slid(&self, x_mm: f64, dt_s: f64, limit_n: f64) -> LeafFriction {
        match (self.contacts, &self.stack) {
            (LeafFriction::Single(contacts), Some(stack)) => {
                LeafFriction::Single(contacts.moved(stack, x_mm))
            }
            (LeafFriction::Whole(contacts), _) => {
                LeafFriction::Whole(contacts.moved(x_mm - self.x_mm, dt_s, limit_n))
            }
            (contacts, None) => contacts,
        }
    }

    /// Friction in N of contacts and bushing.
    fn friction_n(&self, contacts: &LeafFriction, x_mm: f64, limit_n: f64) -> f64 {
        let of_leaves = match contacts {
            LeafFriction::Whole(contacts) => contacts.force_n(limit_n),
            LeafFriction::Single(contacts) => contacts.force_n(limit_n / self.carried_n(x_mm).max(1.0)),
        };
        of_leaves + self.specimen.bushing_n * self.bushing.drag()
    }

    /// Limiting friction of the contacts in N at a displacement.
    fn limit_n(&self, x_mm: f64) -> f64 {
        let s = self.specimen;
        let carried = self.carried_n(x_mm);
        let mut ratio = s.friction_ratio;
        if let Some(h) = self.get("load_dependent_friction") {
            ratio += h.size * (carried / s.top_n()).max(1e-6).powf(load_exponent(h) - 1.0);
        }
        ratio += self.get("rate_independent_friction").map_or(0.0, |h| h.size);
        ratio += self.get("run_in").map_or(0.0, |h| h.size * self.run_in(h));
        (carried * (ratio + self.outside.added_ratio(x_mm)) * self.outside.friction_factor(x_mm)).max(0.0)
    }

    /// Share of a run-in that is done.
    fn run_in(&self, h: &Hidden) -> f64 {
        let cycles = 0.5 * self.turned.1;
        let s = self.specimen;
        let shape = law(h).shape;
        match law(h).number {
            0 => 1.0 - (1.0 + cycles / h.place).powf(-0.7 - shape),
            // By travel, and by the work of the friction: one cycle has about the largest displacement.
            1 => 1.0 - (-self.path[0] / (h.place * s.top_mm())).exp(),
            2 => {
                let cycle_nmm = s.friction_ratio.max(0.01) * 0.5 * s.range_n * s.top_mm();
                1.0 - (-self.path[1] / (h.place * cycle_nmm)).exp()
            }
            // It sets in late.
            _ => {
                let sigmoid = |n: f64| 1.0 / (1.0 + (-(n - h.place) / (0.3 * h.place)).exp());
                sigmoid(cycles) - sigmoid(0.0)
            }
        }
    }

    /// Carried load in N, without friction; never tensile.
    fn carried_n(&self, x_mm: f64) -> f64 {
        let s = self.specimen;
        let top_mm = s.top_mm();
        // With a lost contact there is no preload: the load is zero at the first contact.
        let bare = s.preload_n + s.rate_n_per_mm * x_mm;
        let mut load = self.stack.as_ref().map_or(bare, |stack| stack.load_n(x_mm));
        load += self
            .get("geometric_stiffness")
            .map_or(0.0, |h| geometric_n(h, x_mm, top_mm));
        load += self
            .get("progressive_stiffness")
            .map_or(0.0, |h| progressive_n(h, x_mm, top_mm));
        load += self.outside.carried_n(x_mm, s);
        if let Some(h) = self.get("strength_loss") {
            // After a crack has opened, the load is lower in the middle of the travel.
            if 0.5 * self.turned.1 >= h.place {
                let middle = (x_mm / top_mm - 0.45) / 0.25;
                load *= 1.0 - h.size * (-middle * middle).exp();
            }
        }
        load.max(0.0)
    }
}

/// Zero of a rising function between `low` and `high`: false position of Illinois (M. Dowell and P. Jarratt 1971). The end that
/// is nearer to the zero if both have the same sign.
fn root(f: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    let (mut f_low, mut f_high) = (f(low), f(high));
    if f_high <= 0.0 {
        return high;
    }
    if f_low >= 0.0 {
        return low;
    }
    let mut side = 0;
    let mut x = high;
    for _ in 0..SECANTS.0 {
        x = high - f_high * (high - low) / (f_high - f_low);
        let at = f(x);
        if at.abs() < SECANTS.1 {
            break;
        }
        if at > 0.0 {
            (high, f_high) = (x, at);
            f_low *= if side == 1 { 0.5 } else { 1.0 };
            side = 1;
        } else {
            (low, f_low) = (x, at);
            f_high *= if side == -1 { 0.5 } else { 1.0 };
            side = -1;
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth::specimen::tests::{plain, sine};
    use crate::truth::world::Law;

    /// Worlds in which all contacts are one.
    const WHOLE: [World; 3] = [World::PrandtlIshlinskii, World::BoucWen, World::Lugre];

    fn specimen(world: World) -> TruthSpecimen {
        TruthSpecimen {
            world,
            power: if world == World::Lugre { 0.1 } else { 1.0 },
            build: 0.4,
            ..plain()
        }
    }

    fn frictionless(world: World) -> TruthSpecimen {
        TruthSpecimen {
            friction_ratio: 0.0,
            ..specimen(world)
        }
    }

    fn hidden(code: &'static str, number: usize, size: f64) -> Hidden {
        Hidden {
            code,
            size,
            place: 3.0,
            width: 2.0,
            law: Some(Law {
                number,
                name: "",
                shape: 0.3,
            }),
        }
    }

    /// Times of a 1 Hz sine after its approach of 0.5 s, at `rate_hz`.
    fn times(rate_hz: u32, cycles: u32) -> Vec<f64> {
        let count = rate_hz * cycles;
        (0..=count)
            .map(|k| 0.5 + f64::from(k) / f64::from(rate_hz))
            .collect()
    }

    #[test]
    fn forces_far_along_a_branch_are_those_of_dry_friction() {
        for world in WHOLE {
            let forces = forces(&specimen(world), &[], &sine(1.0, 4.0), &times(200, 2));
            // 1.25 cycles: upwards through the mean of 900 N; 1.75 cycles: downwards. The bristles still bend with the load.
            assert!((forces[250] - 990.0).abs() < 4.0, "{world:?}: {}", forces[250]);
            assert!((forces[350] - 810.0).abs() < 4.0, "{world:?}: {}", forces[350]);
        }
    }

    #[test]
    fn a_loop_takes_energy_in_every_world_and_a_slow_one_as_much_as_a_fast_one() {
        let loop_nmm = |world: World, frequency_hz: f64| {
            let motion = sine(frequency_hz, 4.0);
            let times: Vec<f64> = (0..=1000)
                .map(|k| (2.5 + f64::from(k) / 1000.0) / frequency_hz)
                .collect();
            let forces = forces(&specimen(world), &[], &motion, &times);
            (1..=1000)
                .map(|k| {
                    0.5 * (forces[k] + forces[k - 1]) * (motion.at_mm(times[k]) - motion.at_mm(times[k - 1]))
                })
                .sum::<f64>()
        };
        for world in World::ALL.into_iter().skip(1) {
            let [slow, fast] = [0.1, 2.0].map(|f| loop_nmm(world, f));
            assert!(slow > 500.0, "{world:?}: {slow}");
            // The damping of the bristles adds a little after each reversal.
            assert!((fast / slow - 1.0).abs() < 0.02, "{world:?}: {slow} and {fast}");
        }
    }

    #[test]
    fn the_force_does_not_depend_on_the_sampling_rate() {
        for world in World::ALL.into_iter().skip(1) {
            let [coarse, fine] =
                [50, 1000].map(|hz| forces(&specimen(world), &[], &sine(1.0, 3.0), &times(hz, 2)));
            for (k, force_n) in coarse.iter().enumerate() {
                // A fraction of the noise, 0.3 to 4 N.
                assert!(
                    (force_n - fine[20 * k]).abs() < 0.3,
                    "{world:?} at {k}: {force_n} and {}",
                    fine[20 * k]
                );
            }
        }
    }

    #[test]
    fn a_joint_and_its_spring_carry_the_same_force() {
        for number in 0..4 {
            let specimen = frictionless(World::BoucWen);
            let h = hidden("series_compliance", number, 3.0);
            let motion = sine(1.0, 3.0);
            let times = times(50, 1);
            for (t, force_n) in times.iter().zip(forces(&specimen, &[h], &motion, &times)) {
                let board_mm = (force_n - 100.0) / 80.0 + joint_mm(&h, force_n, specimen.top_n());
                assert!((board_mm - motion.at_mm(*t)).abs() < 1e-6, "{number} at {t} s");
            }
        }
    }

    #[test]
    fn a_delay_is_of_the_force_or_of_the_displacement() {
        let specimen = frictionless(World::Lugre);
        let motion = sine(1.0, 4.0);
        let times = times(100, 2);
        for number in 0..4 {
            let late = forces(
                &specimen,
                &[hidden("channel_delay", number, 8.0)],
                &motion,
                &times,
            );
            let seen = seen_mm(
                &specimen,
                &[hidden("channel_delay", number, -8.0)],
                &motion,
                &times,
            );
            for (k, t) in times.iter().enumerate().skip(100) {
                let x_mm = motion.at_mm(t - 0.008);
                // Filters round the wave: (w tau)^2 / 2 of 6 mm is 8 um.
                assert!((seen[k] - x_mm).abs() < 0.01, "{number}");
                assert!(
                    (late[k] - 100.0 - 80.0 * x_mm).abs() < 0.8,
                    "{number}: {}",
                    late[k]
                );
            }
        }
    }

    #[test]
    fn a_run_in_changes_the_friction_by_its_size() {
        for number in 0..4 {
            let h = hidden("run_in", number, 0.05);
            let motion = sine(1.0, 25.0);
            let times = [20.75, 24.75];
            let ran = forces(&specimen(World::PrandtlIshlinskii), &[h], &motion, &times);
            let before = forces(&specimen(World::PrandtlIshlinskii), &[], &motion, &times);
            // Upwards through 900 N after 24 cycles; a power of the cycles is slower than the others.
            let change = (ran[1] - before[1]) / 900.0;
            assert!(change > 0.035 && change < 0.0501, "{number}: {change}");
        }
    }
}
