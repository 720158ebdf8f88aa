//! What commands find on this computer: benches, profiles, models, links, a mock rig and the folder of shipped configs.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;

use super::client::DataArg;
use super::error::CliError;
use crate::config::Bench;
use crate::daemon::library::{self, Library};
use crate::daemon::store::{FindRunError, Store};
use crate::mockrig::{MockRig, MockRigConfig};
use crate::model;
use crate::nearest;
use crate::profile::Profile;
use crate::recording::atomic_file;
use crate::recording::run_file::RunListing;

/// The bench that needs no hardware, below the folder of shipped configs.
const DEFAULT_BENCH: &str = "benches/mock.toml";
/// Widest line of a list in a help text, in characters.
const HELP_WIDTH: usize = 96;

/// The bench of a command.
#[derive(Debug, Args)]
pub(crate) struct BenchArg {
    #[arg(
        long = "bench",
        value_name = "FILE",
        help = format!("Bench file [default: bench-configs/{DEFAULT_BENCH}, the mock rig in memory]")
    )]
    file: Option<PathBuf>,
}

impl BenchArg {
    /// The file of `--bench`, if it is given.
    pub(crate) fn path(&self) -> Option<&Path> {
        self.file.as_deref()
    }

    /// The bench of `--bench`. The default bench is built in, for folders where the shipped configs are not found.
    pub(crate) fn load(&self) -> Result<Bench, CliError> {
        Ok(match (&self.file, configs()) {
            (Some(path), _) => {
                require_file(path, WrittenKind::Bench)?;
                Bench::load(path)?
            }
            (None, Ok(folder)) => Bench::load(&folder.join(DEFAULT_BENCH))?,
            (None, Err(_)) => Bench::shipped()?,
        })
    }
}

/// The folder of the profiles that are called by name.
#[derive(Debug, Args)]
pub(crate) struct ProfilesArg {
    /// Folder of the profiles that are called by name [default: bench-configs/profiles]
    #[arg(long = "profiles", value_name = "DIR")]
    profiles: Option<PathBuf>,
}

impl ProfilesArg {
    /// The folder of `--profiles`, or the shipped one.
    pub(crate) fn folder(&self) -> Result<PathBuf, CliError> {
        match &self.profiles {
            Some(path) => Ok(path.clone()),
            None => Ok(configs()?.join("profiles")),
        }
    }
}

/// One profile, by name or by file.
#[derive(Debug, Args)]
pub(crate) struct ProfileArgs {
    #[arg(value_name = "PROFILE", help = profile_help())]
    profile: String,
    #[command(flatten)]
    folder: ProfilesArg,
    #[command(flatten)]
    data: DataArg,
}

impl ProfileArgs {
    /// The profile and its text, from its file, or by name from the technician's own ones and the folder of profiles.
    pub(crate) fn load(&self) -> Result<(Profile, String), CliError> {
        let path = Path::new(&self.profile);
        if path.extension().is_some_and(|e| e == "toml") {
            require_file(path, WrittenKind::Profile)?;
            return Ok(library::read(path)?);
        }
        let library = Library::open(&self.folder.folder()?)?;
        Ok(library
            .with_own(self.data.folder.join(library::OWN_PROFILES))
            .find(&self.profile)?)
    }
}

/// Help of an argument that takes a profile, with the names of the shipped ones.
pub(crate) fn profile_help() -> String {
    let what = "Name of a profile, or a profile file (.toml)";
    let names = shipped_profiles();
    match names.is_empty() {
        true => what.to_owned(),
        false => format!("{what}\nShipped: {}", wrapped(&names).replace('\n', "\n  ")),
    }
}

/// Names of the shipped profiles, sorted; none where their folder is not found.
fn shipped_profiles() -> Vec<String> {
    let folder = configs().map(|folder| folder.join("profiles"));
    folder.map_or(Vec::new(), |folder| toml_names(&folder))
}

/// Names of the TOML files of a folder without their extension, sorted; none where the folder cannot be read.
pub(crate) fn toml_names(folder: &Path) -> Vec<String> {
    let Ok(files) = std::fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut names: Vec<String> = files
        .filter_map(|file| Some(file.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .filter_map(|path| Some(path.file_stem()?.to_str()?.to_owned()))
        .collect();
    names.sort_unstable();
    names
}

/// Names of all models, for help texts.
pub(crate) fn model_names() -> String {
    let names: Vec<&str> = model::MODELS.iter().map(|m| m.name).collect();
    names.join(", ")
}

/// A list with commas in lines of at most [`HELP_WIDTH`] characters, for help texts.
pub(crate) fn wrapped<S: AsRef<str>>(words: &[S]) -> String {
    let mut lines: Vec<String> = Vec::new();
    for (i, word) in words.iter().enumerate() {
        let comma = if i + 1 < words.len() { "," } else { "" };
        let word = format!("{}{comma}", word.as_ref());
        match lines.last_mut() {
            Some(line) if line.len() + 1 + word.len() <= HELP_WIDTH => {
                line.push(' ');
                line.push_str(&word);
            }
            _ => lines.push(word),
        }
    }
    lines.join("\n")
}

/// The folder `bench-configs`: in the working folder or beside the binary, or in a folder above one of them, or in
/// `share/leafbench` of one of them, where a package puts it.
pub(crate) fn configs() -> Result<PathBuf, CliError> {
    let starts = [std::env::current_dir().ok(), std::env::current_exe().ok()];
    starts
        .iter()
        .flatten()
        .flat_map(|start| start.ancestors())
        .flat_map(|folder| ["bench-configs", "share/leafbench/bench-configs"].map(|below| folder.join(below)))
        .find(|folder| folder.join(DEFAULT_BENCH).is_file())
        .ok_or_else(|| {
            CliError::Input(
                "the folder bench-configs is neither in this folder nor in one above it: change to leafbench's folder, or name \
                 the files with --bench and --profiles"
                    .to_owned(),
            )
        })
}

/// A kind of file that a person writes and names on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum WrittenKind {
    Bench,
    Profile,
}

impl WrittenKind {
    /// Folder of the shipped files of this kind.
    fn folder(self) -> &'static str {
        match self {
            WrittenKind::Bench => "benches",
            WrittenKind::Profile => "profiles",
        }
    }
}

/// Asks about a file that is not there, where a file of nearly this name is: beside it, or among the shipped ones of its kind.
/// In all other cases the one who reads the file says what is wrong.
pub(crate) fn require_file(path: &Path, kind: WrittenKind) -> Result<(), CliError> {
    if path.exists() {
        return Ok(());
    }
    let beside = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
        _ => PathBuf::from("."),
    };
    let shipped = configs().map(|folder| folder.join(kind.folder())).ok();
    let wanted = path.file_stem().unwrap_or_default().to_string_lossy();
    for folder in [Some(beside), shipped].into_iter().flatten() {
        let names = toml_names(&folder);
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        if let Some(name) = nearest::name(&wanted, &names) {
            let there = folder.join(format!("{name}.toml"));
            let there = there.strip_prefix(".").unwrap_or(&there);
            return Err(CliError::Input(format!(
                "there is no file {}: did you mean {}?",
                path.display(),
                there.display()
            )));
        }
    }
    Ok(())
}

/// A run in a data folder, by its id, a short id or `latest`.
pub(crate) fn find_run(folder: &Path, id: &str) -> Result<RunListing, CliError> {
    Ok(store(folder, id)?.find(id)?)
}

/// As [`find_run`], but `latest` means the newest run that is over.
pub(crate) fn find_finished_run(folder: &Path, id: &str) -> Result<RunListing, CliError> {
    Ok(store(folder, id)?.find_finished(id)?)
}

/// The runs of a data folder. A folder that is not there has no runs, so that the id is what is missing.
fn store(folder: &Path, id: &str) -> Result<Store, CliError> {
    if folder.is_dir() {
        return Ok(Store::new(folder));
    }
    Err(CliError::FindRun(FindRunError::Unknown {
        id: id.to_owned(),
        folder: folder.to_owned(),
        meant: None,
    }))
}

/// Refuses to replace files that are there already, unless the user says so with `--force`.
pub(crate) fn require_new<P: AsRef<Path>>(paths: &[P], force: bool) -> Result<(), CliError> {
    let there = paths
        .iter()
        .map(AsRef::as_ref)
        .find(|path| path.symlink_metadata().is_ok());
    match there {
        Some(path) if !force => Err(CliError::Input(format!(
            "{} is there already: name another place with --out, or replace it with --force",
            path.display()
        ))),
        _ => Ok(()),
    }
}

/// Writes some texts into a folder, each as a whole file of its name; refuses to replace files as [`require_new`] does.
pub(crate) fn write_files<T: AsRef<str>>(
    folder: &Path,
    files: &[(&str, T)],
    force: bool,
) -> Result<(), CliError> {
    let paths: Vec<PathBuf> = files.iter().map(|(name, _)| folder.join(name)).collect();
    require_new(&paths, force)?;
    std::fs::create_dir_all(folder).map_err(CliError::file(folder, "creating the folder"))?;
    for (path, (_, text)) in paths.iter().zip(files) {
        atomic_file::write(path, |file| file.write_all(text.as_ref().as_bytes()))
            .map_err(CliError::file(path, "writing"))?;
    }
    Ok(())
}

/// The bench's mock rig, loaded with the bench's specimen. `seed` replaces the noise seed of the bench config.
pub(crate) fn mock_rig(bench: &Bench, seed: Option<u64>) -> Result<MockRig, CliError> {
    let mut config: MockRigConfig = bench.mock_rig.clone().try_into().map_err(|e| {
        CliError::Input(format!(
            "table [mock_rig] of bench {}: {}: correct it in the bench file",
            bench.name,
            e.message()
        ))
    })?;
    config.node = bench.link.node;
    config.calibration_hash = bench.calibration_hash();
    config.seed = seed.unwrap_or(config.seed);
    Ok(MockRig::new(&config, bench.specimen.model.plant()?)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrapped_list_keeps_the_width_and_every_word() {
        let words: Vec<String> = (0..60).map(|n| format!("word-{n}")).collect();
        let text = wrapped(&words);
        assert!(text.lines().count() > 1 && text.lines().all(|l| l.len() <= HELP_WIDTH));
        assert_eq!(text.replace('\n', " "), words.join(", "));
        assert_eq!(wrapped::<&str>(&[]), "");
    }

    #[test]
    fn a_mistyped_file_is_asked_about() {
        let folder = tempfile::tempdir().expect("a folder");
        let there = folder.path().join("my-test.toml");
        std::fs::write(&there, "").expect("written");
        require_file(&there, WrittenKind::Profile).expect("it is there");
        let said = |name: &str, kind: WrittenKind| {
            let asked = require_file(&folder.path().join(name), kind).map_err(|e| e.to_string());
            asked.err().unwrap_or_default()
        };
        let beside = said("my-tset.toml", WrittenKind::Profile);
        assert!(
            beside.ends_with(&format!("did you mean {}?", there.display())),
            "{beside}"
        );
        let shipped = said("mokc.toml", WrittenKind::Bench);
        assert!(shipped.ends_with("bench-configs/benches/mock.toml?"), "{shipped}");
        assert_eq!(said("no-such-thing.toml", WrittenKind::Bench), "");
    }

    #[test]
    fn the_help_lists_the_shipped_profiles() {
        assert!(profile_help().contains("static-ramp"), "{}", profile_help());
    }
}
