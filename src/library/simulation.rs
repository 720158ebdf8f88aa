//! A profile on the model, on the mock rig in virtual time, or compared with the limits of the bench.

use std::ops::ControlFlow;

use super::{CallFailure, FailureKind};
use crate::cancel::{self, CancelFlag};
use crate::cli::{CliError, virtual_bench};
use crate::config::Bench;
use crate::daemon::plan::{self as planning, Plan, PlanError};
use crate::profile::{Player, Profile};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::Recording;
use crate::twin::dry_run_with;
use crate::units::Command;

/// A simulation looks this often whether it is cancelled, in ticks.
const LOOK_TICKS: usize = 1000;
/// Most samples of a recording in memory: as many as the reader of CSV takes. They need about 2.5 GB.
const MOST_SAMPLES: u64 = 50_000_000;

/// Why a run on the mock rig gave no recording. The text says what is wrong, where, and what to do.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct RecordError(#[from] Box<CliError>);

/// Runs a profile on the bench's mock rig in virtual time and returns what was recorded: from the first to the last sample
/// of the profile, without the unloading after it. The same bench gives the same bits.
pub fn record(bench: &Bench, profile: &Profile) -> Result<Recording, RecordError> {
    let memory = virtual_bench::record_in_memory(bench, profile, &CancelFlag::default()).map_err(Box::new)?;
    Ok(memory.recording(&profile.name))
}

/// As [`record`], with the seed of the sensor noise (`None`: that of the bench) and a flag that ends it.
pub fn record_run(
    bench: &Bench,
    profile: &Profile,
    seed: Option<u32>,
    flag: &CancelFlag,
) -> Result<Recording, CallFailure> {
    within_memory(profile)?;
    let mut bench = bench.clone();
    if let Some(seed) = seed {
        bench.mock_rig.insert("seed".to_owned(), i64::from(seed).into());
    }
    let memory = cancel::caught(|| virtual_bench::record_in_memory(&bench, profile, flag));
    Ok(memory.ok_or_else(cancelled)??.recording(&profile.name))
}

/// Steps the bench's model along the profile, at 1 kHz: no noise, no hydraulics, no limits.
pub fn simulate(bench: &Bench, profile: &Profile, flag: &CancelFlag) -> Result<Recording, CallFailure> {
    within_memory(profile)?;
    let plant = bench.model.plant().map_err(CliError::from)?;
    let mut recording = Recording {
        name: profile.name.clone(),
        command: Some(Vec::new()),
        command_mode: Some(profile.mode),
        cycle: Some(Vec::new()),
        ..Recording::default()
    };
    let rate_hz = f64::from(SAMPLE_RATE_HZ);
    let limits = bench.profile_limits();
    dry_run_with(profile, plant.as_ref(), &limits, rate_hz, &mut |predicted| {
        let ticks = recording.len() + 1;
        if ticks.is_multiple_of(LOOK_TICKS) && flag.is_cancelled() {
            return ControlFlow::Break(());
        }
        recording.time_s.push(ticks as f64 / rate_hz);
        recording.displacement_mm.push(predicted.displacement_mm);
        recording.force_n.push(predicted.force_n);
        if let Some(command) = &mut recording.command {
            command.push(Command::value(predicted.slot.command));
        }
        if let Some(cycle) = &mut recording.cycle {
            cycle.push(predicted.slot.cycle);
        }
        ControlFlow::Continue(())
    })?;
    match flag.is_cancelled() {
        true => Err(cancelled()),
        false => Ok(recording),
    }
}

/// Predicts a profile on the bench's model and compares it with the limits: the JSON of `leafbench plan --json`.
pub fn plan(
    bench: &Bench,
    profile: &Profile,
    flag: &CancelFlag,
) -> Result<impl serde::Serialize + use<>, CallFailure> {
    let wanted = || !flag.is_cancelled();
    let planned: Result<Plan, PlanError> = planning::check_while(bench, profile, false, &wanted);
    planned.map_err(|error| match error {
        PlanError::Model(error) => CliError::Model(error).into(),
        PlanError::Profile(error) => error.into(),
        PlanError::BrokenOff => cancelled(),
    })
}

/// Refuses a profile with more samples than a recording in memory may have.
fn within_memory(profile: &Profile) -> Result<(), CallFailure> {
    let samples = Player::new(profile, 0.0, f64::from(SAMPLE_RATE_HZ))?.total_ticks();
    match samples <= MOST_SAMPLES {
        true => Ok(()),
        false => Err(CallFailure::input(format!(
            "profile {} has {samples} samples, and at most {MOST_SAMPLES} are kept in memory: shorten it, or use `leafbench simulate`, \
             which writes to a file",
            profile.name
        ))),
    }
}

fn cancelled() -> CallFailure {
    CallFailure {
        kind: FailureKind::Cancelled,
        ..CallFailure::input("the simulation was cancelled: start it again".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> Profile {
        ramp_of_s(2.0)
    }

    /// Up in `up_s`, down in 2 s.
    fn ramp_of_s(up_s: f64) -> Profile {
        let text = format!(
            "name = \"ramp\"\ncontrol = \"displacement\"\n[[block]]\nsegment = [\n\
             {{ kind = \"ramp\", to_mm = 5.0, duration_s = {up_s:?} }},\n\
             {{ kind = \"ramp\", to_mm = 0.0, duration_s = 2.0 }},\n]\n"
        );
        Profile::from_toml(&text, "ramp").expect("a profile")
    }

    #[test]
    fn a_cancelled_simulation_ends_with_its_error() {
        let bench = Bench::shipped().expect("built in");
        let flag = CancelFlag::default();
        assert_eq!(simulate(&bench, &ramp(), &flag).map(|r| r.len()), Ok(4000));
        flag.cancel();
        let kinds = [
            simulate(&bench, &ramp(), &flag).map(drop),
            record_run(&bench, &ramp(), None, &flag).map(drop),
            plan(&bench, &ramp(), &flag).map(drop),
        ]
        .map(|result| result.expect_err("cancelled").kind);
        assert_eq!(kinds, [FailureKind::Cancelled; 3]);
    }

    #[test]
    fn a_profile_that_does_not_fit_into_memory_is_refused() {
        let bench = Bench::shipped().expect("built in");
        let long = ramp_of_s(3e6);
        let flag = CancelFlag::default();
        for refused in [
            simulate(&bench, &long, &flag),
            record_run(&bench, &long, None, &flag),
        ] {
            let text = refused.expect_err("too long").text;
            assert!(text.contains("3000002000 samples"), "{text}");
        }
    }

    #[test]
    fn another_seed_gives_another_noise_and_the_same_seed_the_same() {
        let bench = Bench::shipped().expect("built in");
        let flag = CancelFlag::default();
        let force_n = |seed| record_run(&bench, &ramp(), seed, &flag).map(|r| r.force_n);
        assert_eq!(force_n(Some(7)), force_n(Some(7)));
        assert_ne!(force_n(Some(7)), force_n(Some(8)));
    }
}
