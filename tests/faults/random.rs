//! Random faults at random times in virtual time, and what must hold in each millisecond whatever happens.
//! `LEAFBENCH_SCHEDULES=10000 cargo test --release random_schedules` plays more of them, `LEAFBENCH_SEED=n` begins at another seed.

use rand::rand_core::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::with_faults;
use crate::control::Phase;
use crate::control::physical_limits::PhysicalLimits;
use crate::mockrig::{FAULTS, Injection};
use crate::profile::Profile;
use crate::protocol::message::{RigState, ToRig, WireMode};
use crate::recording::EventKind;
use crate::tests::support::virtual_rig::{NODE, VirtualRig, order, profile};
use crate::units::Mode;

/// Schedules of an ordinary test run.
const SCHEDULES: u64 = 120;
/// Length of a schedule, ms.
const LENGTH_MS: u64 = 6_000;

/// Random numbers of one schedule.
struct Dice(ChaCha8Rng);

impl Dice {
    fn below(&mut self, n: u64) -> u64 {
        self.0.next_u64() % n
    }

    fn happens(&mut self, one_in: u64) -> bool {
        self.below(one_in) == 0
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// One to three faults with amounts and times.
fn faults(dice: &mut Dice) -> Vec<String> {
    (0..=dice.below(3))
        .map(|_| {
            let fault = &FAULTS[dice.below(FAULTS.len() as u64) as usize];
            let amount = match fault.amount {
                Some(amount) if dice.happens(2) => {
                    let [low, high] = amount.range;
                    format!("={}", dice.between(low, high))
                }
                _ => String::new(),
            };
            let from_ms = 1_200 + dice.below(LENGTH_MS - 2_000);
            let longest_ms = if dice.happens(2) { 30 } else { 2_000 };
            let to_ms = from_ms + 1 + dice.below(longest_ms);
            format!("{}{amount}@{from_ms}ms..{to_ms}ms", fault.name)
        })
        .collect()
}

fn profiles(dice: &mut Dice) -> Profile {
    use crate::profile::{CycleSegment, Level, Segment, Wave};
    let (mode, mean, amplitude) = match dice.happens(3) {
        true => (Mode::Force, 700.0, 300.0),
        false => (Mode::Displacement, 9.0, 4.0),
    };
    let ramp = |to| Segment::Ramp {
        to: Level::Absolute(to),
        duration_s: 1.0,
    };
    let cycles = Segment::Cycles(CycleSegment {
        wave: Wave::Sine,
        mean: Level::Absolute(mean),
        amplitude,
        frequency_hz: 2.0,
        cycles: 2,
        taper_cycles: 1,
        correct: dice.happens(2),
    });
    profile(
        mode,
        vec![ramp(mean), Segment::Hold { duration_s: 0.3 }, cycles, ramp(0.0)],
    )
}

/// What must hold after each millisecond.
struct Invariants {
    /// A reset was asked for, and no start since.
    after_reset: bool,
    /// A start was accepted at least once.
    started: bool,
    limits_crc: u32,
}

impl Invariants {
    fn check(&self, bench: &VirtualRig) -> Result<(), String> {
        let state = bench.mock.state();
        let loaded = matches!(state, RigState::Armed | RigState::Running | RigState::Hold);
        if loaded && bench.mock.lease_age_ticks() > 51 {
            return Err(format!(
                "{state} with a lease of {} ms ago",
                bench.mock.lease_age_ticks()
            ));
        }
        if self.after_reset && loaded {
            return Err(format!("{state} after a reset"));
        }
        if !self.started && loaded {
            return Err(format!("{state} before any start"));
        }
        if loaded && bench.mock.limits_crc() != self.limits_crc {
            return Err(format!("{state} with other limits than those of the bench"));
        }
        let status = bench.rig.status();
        let finite = [status.force_n, status.displacement_mm]
            .into_iter()
            .flatten()
            .all(f64::is_finite);
        if !finite || !bench.mock.displacement_mm().is_finite() {
            return Err("a number that is none".to_owned());
        }
        if self.started
            && bench.rig.phase() == Phase::Interlocked
            && bench.rig.status().interlock().is_empty()
        {
            return Err("an interlock without a cause".to_owned());
        }
        Ok(())
    }
}

/// The record of the newest run: what the rig's ticks span is stored or counted as lost, and each gap has its event.
fn account(bench: &VirtualRig) -> Result<(), String> {
    let memory = &bench.memory;
    let (Some(end), Some(first), Some(last)) =
        (&memory.outcome, memory.samples.first(), memory.samples.last())
    else {
        return Ok(());
    };
    if end.samples != memory.samples.len() as u64 || last.tick - first.tick + 1 != end.samples + end.lost {
        return Err(format!(
            "{} stored, {} in the outcome, {} lost of ticks {} to {}",
            memory.samples.len(),
            end.samples,
            end.lost,
            first.tick,
            last.tick
        ));
    }
    let gaps = memory.events.iter().filter(|e| e.kind == EventKind::Gap).count();
    let holes = memory
        .samples
        .windows(2)
        .filter(|w| w[1].tick != w[0].tick + 1)
        .count();
    (gaps == holes)
        .then_some(())
        .ok_or(format!("{holes} gaps, {gaps} of them told"))
}

/// Every frame that the host sends is one of the protocol, and each command is within the limits.
fn watch_the_wire(bench: &mut VirtualRig) {
    bench.to_rig = Box::new(|frame| {
        let message = ToRig::decode(&frame, NODE).expect("the host sends what the protocol knows");
        if let ToRig::Command(command) = message {
            let limits = PhysicalLimits::EXAMPLE;
            let (value, low, high) = match command.mode {
                WireMode::Force => (
                    f64::from(command.counts) * 0.1,
                    limits.force_min_n,
                    limits.force_max_n,
                ),
                WireMode::Displacement => (
                    f64::from(command.counts) * 0.0005,
                    limits.displacement_min_mm,
                    limits.displacement_max_mm,
                ),
            };
            // Rounding to counts.
            let slack = 1e-5 * (high - low);
            assert!(
                (low - slack..=high + slack).contains(&value),
                "a command of {value}"
            );
        }
        Some(frame)
    });
}

/// Plays the schedule of a seed. The error says what did not hold, and when.
fn play(seed: u64) -> Result<(), String> {
    let mut dice = Dice(ChaCha8Rng::seed_from_u64(seed));
    let faults = faults(&mut dice);
    let texts: Vec<&str> = faults.iter().map(String::as_str).collect();
    let mut bench = with_faults(&texts);
    watch_the_wire(&mut bench);
    let profile = profiles(&mut dice);
    let mut invariants = Invariants {
        after_reset: false,
        started: false,
        limits_crc: expected_limits(),
    };
    let mut frozen_ms = 0;
    let failed = |bench: &VirtualRig, what: String| {
        format!(
            "seed {seed}, {} ms, {faults:?}: {what}: {:?}",
            bench.now_ns / 1_000_000,
            bench.rig.status()
        )
    };
    for ms in 0..LENGTH_MS {
        if bench.host_alive && dice.happens(4_000) {
            frozen_ms = 5 + dice.below(150);
        }
        bench.host_alive = frozen_ms == 0;
        frozen_ms = frozen_ms.saturating_sub(1);
        act(&mut bench, &mut dice, &mut invariants, &profile, ms).map_err(|what| failed(&bench, what))?;
        bench.tick();
        invariants.check(&bench).map_err(|what| failed(&bench, what))?;
    }
    bench.host_alive = true;
    bench.mock.end_faults();
    bench.stop();
    for _ in 0..75_000 {
        bench.tick();
        invariants.check(&bench).map_err(|what| failed(&bench, what))?;
        if at_rest(&bench) {
            break;
        }
    }
    if !at_rest(&bench) {
        return Err(failed(
            &bench,
            format!("the stop did not end, the rig is {}", bench.mock.state()),
        ));
    }
    account(&bench).map_err(|what| failed(&bench, what))
}

/// The rig is without pressure, and the daemon has closed the run.
fn at_rest(bench: &VirtualRig) -> bool {
    !bench.mock.pressure_on() && matches!(bench.rig.phase(), Phase::Ready | Phase::Interlocked)
}

/// What a person does in this millisecond, at random.
fn act(
    bench: &mut VirtualRig,
    dice: &mut Dice,
    invariants: &mut Invariants,
    profile: &Profile,
    ms: u64,
) -> Result<(), String> {
    match bench.rig.phase() {
        Phase::Ready if ms > 900 && dice.happens(100) => {
            account(bench)?;
            bench.memory = crate::recording::memory::Memory::default();
            if bench.rig.start(order(profile.clone())).is_ok() {
                invariants.started = true;
                invariants.after_reset = false;
            }
        }
        Phase::Running if dice.happens(3_000) => bench.rig.hold().map_err(|e| e.to_string())?,
        Phase::Held if dice.happens(300) => bench.rig.resume().map_err(|e| e.to_string())?,
        Phase::Interlocked if dice.happens(300) => {
            bench.rig.reset().map_err(|e| e.to_string())?;
            invariants.after_reset = true;
        }
        _ if dice.happens(6_000) => bench.stop(),
        _ => {}
    }
    Ok(())
}

/// CRC of the limits that the bench writes.
fn expected_limits() -> u32 {
    let mut bench = VirtualRig::new();
    bench.until(Phase::Ready, 2_000);
    bench.mock.limits_crc()
}

#[test]
fn random_schedules_break_no_invariant() {
    let number = |name: &str| std::env::var(name).ok().and_then(|n| n.parse::<u64>().ok());
    let count = number("LEAFBENCH_SCHEDULES").unwrap_or(SCHEDULES);
    let first = number("LEAFBENCH_SEED").unwrap_or(1);
    let threads = if count > SCHEDULES { 2 } else { 1 };
    let failures: Vec<String> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads)
            .map(|k| {
                scope.spawn(move || {
                    let seeds = (first + k..first + count).step_by(threads as usize);
                    seeds.filter_map(|seed| play(seed).err()).collect::<Vec<_>>()
                })
            })
            .collect();
        workers
            .into_iter()
            .flat_map(|w| w.join().expect("no panic"))
            .collect()
    });
    let shown: Vec<&String> = failures.iter().take(10).collect();
    assert!(failures.is_empty(), "{} of {count}: {shown:#?}", failures.len());
}

/// The invariants are no decoration: a rig that keeps its load without a lease is seen.
#[test]
fn a_broken_invariant_is_seen() {
    let mut bench = super::moving();
    let invariants = Invariants {
        after_reset: false,
        started: true,
        limits_crc: expected_limits(),
    };
    invariants.check(&bench).expect("a sound run");
    {
        let _off = crate::detector::Off::new("D1");
        bench.mock.injection = Injection::default();
        bench.host_alive = false;
        bench.ticks(60);
    }
    let what = invariants.check(&bench).expect_err("no lease for 60 ms");
    assert!(what.contains("with a lease of"), "{what}");
    let reset = Invariants {
        after_reset: true,
        ..invariants
    };
    assert!(reset.check(&super::moving()).is_err());
}
