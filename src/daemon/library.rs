//! The profiles that can be started by name: the files of one folder, found by name and never by path.

use std::path::{Path, PathBuf};

use super::client_types::ProfileSummary;
use super::nearest;
use crate::profile::{Player, Profile, ProfileError};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::regular_file::{self, WRITTEN_MAX_BYTES};

/// Why a profile cannot be read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum LibraryError {
    #[error("the profiles folder {path} cannot be read: give the right folder with --profiles")]
    Folder { path: PathBuf, source: std::io::Error },
    #[error("profile {path} cannot be read ({reason}): check the name and the permissions of the file")]
    File {
        path: PathBuf,
        /// What the operating system says, or what the path leads to.
        reason: String,
    },
    /// The folder has no profile with this name.
    #[error("there is no profile \"{name}\"{}: choose one of {known}", nearest::question(meant.as_deref()))]
    Unknown {
        name: String,
        /// The name that is probably meant.
        meant: Option<String>,
        /// Names of the profiles in the folder, with commas between them.
        known: String,
    },
    #[error(transparent)]
    Profile(#[from] ProfileError),
}

/// One folder of profile files.
#[derive(Debug, Clone)]
pub(crate) struct Library {
    folder: PathBuf,
}

impl Library {
    /// The library of the profile files in `folder`. Each request reads the files again, so that an edited profile can be
    /// started without a restart of the daemon.
    pub(crate) fn open(folder: &Path) -> Result<Library, LibraryError> {
        let library = Library {
            folder: folder.to_owned(),
        };
        library.files()?;
        Ok(library)
    }

    /// A profile and the text of its file. `text` is the name of a profile, or the whole text of a profile file.
    pub(crate) fn find(&self, text: &str) -> Result<(Profile, String), LibraryError> {
        if text.contains(['\n', '=']) {
            return Ok((Profile::from_toml(text, "profile")?, text.to_owned()));
        }
        let files = self.files()?;
        let Some(path) = files.iter().find(|path| name_of(path) == text) else {
            let known: Vec<&str> = files.iter().map(|path| name_of(path)).collect();
            return Err(LibraryError::Unknown {
                name: text.to_owned(),
                meant: nearest::name(text, &known).map(str::to_owned),
                known: known.join(", "),
            });
        };
        read(path)
    }

    /// All profiles of the folder, sorted by file name.
    pub(crate) fn list(&self) -> Result<Vec<ProfileSummary>, LibraryError> {
        Ok(self.files()?.iter().map(|path| summary(path)).collect())
    }

    fn files(&self) -> Result<Vec<PathBuf>, LibraryError> {
        let failed = |source| LibraryError::Folder {
            path: self.folder.clone(),
            source,
        };
        let mut files = Vec::new();
        for entry in std::fs::read_dir(&self.folder).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            if path.extension().is_some_and(|e| e == "toml") {
                files.push(path);
            }
        }
        files.sort();
        Ok(files)
    }
}

fn name_of(path: &Path) -> &str {
    path.file_stem()
        .and_then(|stem| stem.to_str())
        .unwrap_or_default()
}

/// Reads one profile file. Returns the profile and the text of the file.
pub(crate) fn read(path: &Path) -> Result<(Profile, String), LibraryError> {
    let text = regular_file::read_text(path, WRITTEN_MAX_BYTES).map_err(|error| LibraryError::File {
        path: path.to_owned(),
        reason: error.to_string(),
    })?;
    Ok((Profile::from_toml(&text, &path.display().to_string())?, text))
}

fn summary(path: &Path) -> ProfileSummary {
    let name = name_of(path).to_owned();
    let player = read(path).and_then(|(profile, _)| {
        let player = Player::new(&profile, 0.0, f64::from(SAMPLE_RATE_HZ))?;
        Ok((profile, player))
    });
    match player {
        Ok((profile, player)) => ProfileSummary {
            name,
            description: profile.description,
            duration_s: player.duration_s(),
            cycles: player.total_cycles(),
            problem: String::new(),
        },
        Err(error) => ProfileSummary {
            name,
            description: String::new(),
            duration_s: 0.0,
            cycles: 0,
            problem: error.to_string(),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped() -> Library {
        Library::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/profiles")).expect("there")
    }

    #[test]
    fn names_are_looked_up_and_never_become_paths() {
        let library = shipped();
        assert_eq!(
            library.find("static-ramp").expect("shipped").0.name,
            "static-ramp"
        );
        for name in ["../benches/mock", "/etc/passwd", "static-ramp.toml", "", "."] {
            assert!(
                matches!(library.find(name), Err(LibraryError::Unknown { .. })),
                "{name}"
            );
        }
    }

    #[test]
    fn a_mistyped_name_is_asked_about() {
        let said = |name: &str| shipped().find(name).expect_err("unknown").to_string();
        let typed = said("static-rmp");
        assert!(
            typed
                .starts_with("there is no profile \"static-rmp\": did you mean static-ramp?: choose one of "),
            "{typed}"
        );
        assert!(!said("no-such-profile").contains("did you mean"));
    }

    #[test]
    fn every_shipped_profile_is_listed_without_a_problem() {
        let list = shipped().list().expect("listed");
        assert!(list.len() >= 5);
        assert!(
            list.iter().all(|p| p.problem.is_empty() && p.duration_s > 0.0),
            "{list:?}"
        );
    }
}
