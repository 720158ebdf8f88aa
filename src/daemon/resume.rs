//! What a start plays: the requested profile from its beginning, or the rest of an interrupted run. A run is only resumed on
//! the bench on which it began: the cycles of both recordings are evaluated as those of one test.

use std::collections::BTreeMap;

use axum::http::StatusCode;

use super::client_types::StartRun;
use super::error::ApiError;
use super::state::DaemonState;
use crate::config::Bench;
use crate::profile::{Player, Profile};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::run_file::{self, RunFile, RunListing};
use crate::recording::{FirmwareIdentity, Header};

/// Parts of a bench that may not change between a run and its resumption. Link, data folder and model do not change what is
/// recorded.
const FIXED: [&str; 5] = [
    "name",
    "force_channel",
    "displacement_channel",
    "limits",
    "specimen.name",
];

/// The profile of a run and the cycle at which the run begins.
pub(super) struct ChosenProfile {
    pub profile: Profile,
    /// Text of the profile file.
    pub toml: String,
    /// Counted cycles begin at 1.
    pub first_cycle: u32,
    /// Name of the specimen: that of the request, of the run to resume, or of the bench.
    pub specimen: String,
    /// Full id of the run to resume; empty otherwise.
    pub resumes_run: String,
}

/// The requested profile, or the profile of the run to resume.
pub(super) fn choose(state: &DaemonState, request: &StartRun) -> Result<ChosenProfile, ApiError> {
    let requested = request.specimen.as_deref().map(str::trim);
    let requested = requested.filter(|specimen| !specimen.is_empty());
    if let Some(run_id) = &request.resume_run {
        return resumed(state, request.profile.as_deref(), requested, run_id);
    }
    let name = request.profile.as_deref().unwrap_or_default();
    let (profile, toml) = state.library.find(name).map_err(|e| ApiError::invalid(&e))?;
    Ok(ChosenProfile {
        profile,
        toml,
        first_cycle: 1,
        specimen: requested
            .unwrap_or(&state.settings.bench.specimen.name)
            .to_owned(),
        resumes_run: String::new(),
    })
}

fn resumed(
    state: &DaemonState,
    profile: Option<&str>,
    specimen: Option<&str>,
    run_id: &str,
) -> Result<ChosenProfile, ApiError> {
    let listing = state.store.find(run_id).map_err(ApiError::not_found)?;
    let run = RunFile::open(&listing.path).map_err(ApiError::disk)?;
    let before = run.header();
    same_profile(state, before, profile)?;
    let specimen = specimen.unwrap_or(&before.specimen);
    let rig = state.control.status().0.firmware;
    let different = differences(before, &state.settings.bench, &rig, specimen);
    if !different.is_empty() {
        return Err(refusal(
            format!(
                "run {} cannot be resumed here: {}",
                before.run_id,
                different.join("; ")
            ),
            "start the daemon with the bench of that run, or start a new run",
        ));
    }
    not_resumed_before(state, &listing)?;
    let profile = Profile::from_toml(&before.profile_toml, run_id).map_err(|e| ApiError::invalid(&e))?;
    Ok(ChosenProfile {
        first_cycle: next_cycle(before, &listing, &profile)?,
        profile,
        toml: before.profile_toml.clone(),
        specimen: specimen.to_owned(),
        resumes_run: before.run_id.clone(),
    })
}

fn refusal(error: String, what_to_do: &str) -> ApiError {
    ApiError::new(StatusCode::CONFLICT, error, what_to_do.to_owned())
}

/// Refuses a profile, given by name or text, that is not the profile of the run to resume.
fn same_profile(state: &DaemonState, before: &Header, requested: Option<&str>) -> Result<(), ApiError> {
    let Some(requested) = requested else {
        return Ok(());
    };
    let (requested, _) = state.library.find(requested).map_err(|e| ApiError::invalid(&e))?;
    let profile =
        Profile::from_toml(&before.profile_toml, &before.run_id).map_err(|e| ApiError::invalid(&e))?;
    if requested == profile {
        return Ok(());
    }
    let text = match requested.name == profile.name {
        true => format!(
            "run {} used another text of profile {}",
            before.run_id, profile.name
        ),
        false => format!(
            "run {} used profile {}, not {}",
            before.run_id, profile.name, requested.name
        ),
    };
    Err(refusal(
        text,
        "leave the profile out to resume that run, or start a new run",
    ))
}

/// The cycle after the last complete one of the run.
fn next_cycle(before: &Header, listing: &RunListing, profile: &Profile) -> Result<u32, ApiError> {
    let done = listing.cycles_completed.max(before.first_cycle.saturating_sub(1));
    let player = Player::new(profile, 0.0, f64::from(SAMPLE_RATE_HZ)).map_err(|e| ApiError::invalid(&e))?;
    let total = player.total_cycles();
    if done < total {
        return Ok(done + 1);
    }
    Err(refusal(
        format!(
            "run {} has no cycles left: {done} of {total} are complete",
            before.run_id
        ),
        "start a new run",
    ))
}

/// Refuses a run that another run resumes already: two recordings would have the same cycles.
fn not_resumed_before(state: &DaemonState, before: &RunListing) -> Result<(), ApiError> {
    let runs = state.store.runs().map_err(ApiError::disk)?;
    let listings = runs.iter().map(|run| &run.listing);
    // A run that cannot be read is listed with its problem, and it cannot be the one.
    let child = listings
        .filter(|run| run.resumes_run == before.run_id)
        .find(|run| run.problem.is_empty() && run_file::check(&run.path).is_empty());
    child.map_or(Ok(()), |child| {
        Err(refusal(
            format!(
                "run {} was resumed already, by run {}",
                before.run_id, child.run_id
            ),
            "resume that run, or start a new one",
        ))
    })
}

/// What differs between the bench of a run and the bench as it is now, one phrase for each difference.
fn differences(before: &Header, bench: &Bench, rig: &FirmwareIdentity, specimen: &str) -> Vec<String> {
    let mut different = Vec::new();
    if before.bench_sha256 != bench.sha256() {
        let (old, new) = (fixed_values(&before.bench_toml), fixed_values(&bench.to_toml()));
        let keys: std::collections::BTreeSet<&String> = old.keys().chain(new.keys()).collect();
        let shown = |values: &BTreeMap<String, String>, key: &str| {
            values
                .get(key)
                .map_or_else(|| "not written".to_owned(), Clone::clone)
        };
        let phrases = keys.into_iter().filter(|key| old.get(*key) != new.get(*key));
        different.extend(phrases.map(|key| {
            format!(
                "{key} of its bench was {} and is now {}",
                shown(&old, key),
                shown(&new, key)
            )
        }));
    }
    let was = &before.firmware;
    for (what, was, is) in [
        ("vendor", was.vendor, rig.vendor),
        ("product", was.product, rig.product),
        ("serial number", was.serial, rig.serial),
        ("calibration hash", was.calibration_hash, rig.calibration_hash),
    ] {
        if was != is {
            different.push(format!("the {what} of its rig was {was:#x} and is now {is:#x}"));
        }
    }
    if before.specimen != specimen {
        different.push(format!(
            "its specimen was \"{}\" and is now \"{specimen}\"",
            before.specimen
        ));
    }
    different
}

/// Key and value of everything in the text of a bench that is fixed. Empty if it is no TOML, so that everything differs.
fn fixed_values(bench_toml: &str) -> BTreeMap<String, String> {
    fn collect(name: &str, value: &toml::Value, into: &mut BTreeMap<String, String>) {
        match value {
            toml::Value::Table(table) => {
                for (key, value) in table {
                    let name = if name.is_empty() {
                        key.clone()
                    } else {
                        format!("{name}.{key}")
                    };
                    collect(&name, value, into);
                }
            }
            value => {
                into.insert(name.to_owned(), value.to_string());
            }
        }
    }
    let mut values = BTreeMap::new();
    if let Ok(bench) = bench_toml.parse::<toml::Table>() {
        collect("", &toml::Value::Table(bench), &mut values);
    }
    let is_fixed = |key: &str| {
        FIXED.iter().any(|fixed| {
            key.strip_prefix(fixed)
                .is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
        })
    };
    values.retain(|key, _| is_fixed(key));
    values
}

#[cfg(test)]
mod tests {
    use super::super::header::{self, Planned};
    use super::*;

    fn before(bench: &Bench) -> Header {
        let profile = include_str!("../../bench-configs/profiles/sine-6mm-1hz.toml");
        let now = jiff::Timestamp::from_second(0).expect("a time");
        let planned = Planned {
            cycles: 1,
            duration_s: 1.0,
        };
        let parsed = Profile::from_toml(profile, "p").expect("a profile");
        header::new("run".to_owned(), now, bench, &parsed, profile.to_owned(), planned)
    }

    /// The differences after `change` of the bench.
    fn after(change: impl FnOnce(&mut Bench)) -> Vec<String> {
        let mut bench = Bench::shipped().expect("built in");
        let before = before(&bench);
        change(&mut bench);
        differences(&before, &bench, &before.firmware.clone(), &before.specimen)
    }

    #[test]
    fn what_is_recorded_may_not_change_and_the_difference_is_named() {
        assert_eq!(after(|_| ()), Vec::<String>::new());
        assert_eq!(
            after(|b| b.limits.force_max_n = 3000.0),
            ["limits.force_max_n of its bench was 3200.0 and is now 3000.0"]
        );
        assert_eq!(
            after(|b| b.force_channel.certificate = "C-2".to_owned()),
            ["force_channel.certificate of its bench was \"mock\" and is now \"C-2\""]
        );
        assert_eq!(
            after(|b| b.name = "other".to_owned()),
            ["name of its bench was \"mock\" and is now \"other\""]
        );
        let two = after(|b| {
            b.specimen.name = "leaf".to_owned();
            b.displacement_channel.offset_mm = 0.1;
        });
        assert_eq!(two.len(), 2, "{two:?}");
    }

    #[test]
    fn link_folder_and_model_may_change() {
        let changed = after(|b| {
            b.link.address = "can:can0".to_owned();
            b.daemon.data_folder = "elsewhere".into();
            b.model.parameters.insert("rate_n_per_mm".to_owned(), 81.0);
        });
        assert_eq!(changed, Vec::<String>::new());
    }

    #[test]
    fn another_rig_and_another_specimen_are_named() {
        let bench = Bench::shipped().expect("built in");
        let before = before(&bench);
        let rig = FirmwareIdentity {
            serial: 0x17,
            ..before.firmware.clone()
        };
        let found = differences(&before, &bench, &rig, "samurai-front 8");
        assert_eq!(
            found,
            [
                "the serial number of its rig was 0x0 and is now 0x17",
                "its specimen was \"samurai-front\" and is now \"samurai-front 8\""
            ]
        );
    }
}
