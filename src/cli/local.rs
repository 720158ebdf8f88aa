//! What commands find on this computer: benches, profiles, a mock rig and the folder of shipped configs.

use std::path::{Path, PathBuf};

use clap::{Arg, ArgMatches};

use super::CliError;
use crate::config::Bench;
use crate::daemon::library::{self, Library};
use crate::mockrig::{MockRig, MockRigConfig};
use crate::profile::Profile;

/// The bench that needs no hardware, below the folder of shipped configs.
const DEFAULT_BENCH: &str = "benches/mock.toml";

/// `--bench`.
pub(super) fn bench_argument() -> Arg {
    Arg::new("bench")
        .long("bench")
        .value_name("FILE")
        .value_parser(clap::value_parser!(PathBuf))
        .help("Bench config [default: bench-configs/benches/mock.toml, the mock rig in memory]")
}

/// `--profiles`.
pub(super) fn profiles_argument() -> Arg {
    Arg::new("profiles")
        .long("profiles")
        .value_name("DIR")
        .value_parser(clap::value_parser!(PathBuf))
        .help("Folder of the profiles that go by name [default: bench-configs/profiles]")
}

/// The bench asked for; the default one is built in, for folders where the shipped configs are not.
pub(super) fn bench(matches: &ArgMatches) -> Result<Bench, CliError> {
    Ok(match (matches.get_one::<PathBuf>("bench"), configs()) {
        (Some(path), _) => Bench::load(path)?,
        (None, Ok(folder)) => Bench::load(&folder.join(DEFAULT_BENCH))?,
        (None, Err(_)) => Bench::shipped()?,
    })
}

/// The folder of profiles asked for.
pub(super) fn profiles_folder(matches: &ArgMatches) -> Result<PathBuf, CliError> {
    match matches.get_one::<PathBuf>("profiles") {
        Some(path) => Ok(path.clone()),
        None => Ok(configs()?.join("profiles")),
    }
}

/// A profile by its file, or by name from the folder of profiles.
pub(super) fn profile(matches: &ArgMatches, name: &str) -> Result<(Profile, String), CliError> {
    let path = Path::new(name);
    if path.extension().is_some_and(|e| e == "toml") {
        return Ok(library::read(path)?);
    }
    Ok(Library::open(&profiles_folder(matches)?)?.find(name)?)
}

/// `bench-configs`, beside the working folder or beside the binary, or above either.
pub(super) fn configs() -> Result<PathBuf, CliError> {
    let starts = [std::env::current_dir().ok(), std::env::current_exe().ok()];
    starts
        .iter()
        .flatten()
        .flat_map(|start| start.ancestors())
        .map(|folder| folder.join("bench-configs"))
        .find(|folder| folder.join(DEFAULT_BENCH).is_file())
        .ok_or_else(|| {
            CliError::Input(
                "the folder bench-configs is neither here nor above: change to leafbench's folder, or name the files \
                 with --bench and --profiles"
                    .to_owned(),
            )
        })
}

/// The bench's mock rig with the bench's specimen under its pusher.
pub(super) fn mock_rig(bench: &Bench, seed: Option<u64>) -> Result<MockRig, CliError> {
    let mut config: MockRigConfig = bench
        .mock_rig
        .clone()
        .try_into()
        .map_err(|e| CliError::Input(format!("[mock_rig] of bench {}: {}", bench.name, e.message())))?;
    config.node = bench.link.node;
    config.calibration_hash = bench.calibration_hash();
    config.seed = seed.unwrap_or(config.seed);
    Ok(MockRig::new(&config, bench.specimen.model.plant()?)?)
}
