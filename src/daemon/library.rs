//! The profiles that can be started by name: the files of a folder, and the technician's own ones, found by name and never by
//! path. An own profile goes before another one of its name.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use super::client_types::{ProfileOrigin, ProfileSummary, ProfileText};
use crate::nearest;
use crate::profile::{Player, Profile, ProfileError};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::atomic_file;
use crate::regular_file::{self, WRITTEN_MAX_BYTES};

/// Folder of the technician's own profiles in the data folder.
pub(crate) const OWN_PROFILES: &str = "profiles";

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
    /// A file would be replaced, and nobody has said that it may be.
    #[error(
        "there is {what} with the name \"{name}\" already: save under another name, or say that it is to be replaced"
    )]
    Exists {
        name: String,
        /// "a shipped profile" or "a profile of your own".
        what: &'static str,
    },
    /// A name that would be no name of a file.
    #[error("\"{name}\" cannot be the name of a file: begin with a letter or a digit")]
    Name { name: String },
    /// A profile that is not the technician's own.
    #[error("\"{name}\" is not a profile of your own: only those can be deleted")]
    NotOwn { name: String },
    #[error("profile {path} cannot be written: check the permissions and the free space of the disk")]
    Write { path: PathBuf, source: std::io::Error },
}

impl LibraryError {
    /// Line and column in the text, from 1, if the error is at one place.
    pub(crate) fn place(&self) -> Option<(usize, usize)> {
        match self {
            LibraryError::Profile(error) => error.place(),
            _ => None,
        }
    }
}

/// The folder of profile files that belong to the program or the bench, and the technician's own one.
#[derive(Debug, Clone)]
pub(crate) struct Library {
    folder: PathBuf,
    own: Option<PathBuf>,
}

/// A profile file.
struct ProfileFile {
    path: PathBuf,
    origin: ProfileOrigin,
    /// An own profile stands in the place of one of the same name.
    replaces: bool,
}

impl Library {
    /// The library of the profile files in `folder`. Each request reads the files again, so that an edited profile can be
    /// started without a restart of the daemon.
    pub(crate) fn open(folder: &Path) -> Result<Library, LibraryError> {
        let library = Library {
            folder: folder.to_owned(),
            own: None,
        };
        library.files()?;
        Ok(library)
    }

    /// The same with the technician's own profiles in `folder`, which is made when the first one is saved.
    pub(crate) fn with_own(self, folder: PathBuf) -> Library {
        Library {
            own: Some(folder),
            ..self
        }
    }

    /// A profile and the text of its file. `text` is the name of a profile, or the whole text of a profile file.
    pub(crate) fn find(&self, text: &str) -> Result<(Profile, String), LibraryError> {
        if text.contains(['\n', '=']) {
            return Ok((Profile::from_toml(text, "text")?, text.to_owned()));
        }
        read(&self.file(text)?.path)
    }

    /// The file of a name.
    fn file(&self, name: &str) -> Result<ProfileFile, LibraryError> {
        let mut files = self.files()?;
        if let Some(at) = files.iter().position(|file| name_of(&file.path) == name) {
            return Ok(files.swap_remove(at));
        }
        let known: Vec<&str> = files.iter().map(|file| name_of(&file.path)).collect();
        Err(LibraryError::Unknown {
            name: name.to_owned(),
            meant: nearest::name(name, &known).map(str::to_owned),
            known: known.join(", "),
        })
    }

    /// All profiles, sorted by name.
    pub(crate) fn list(&self) -> Result<Vec<ProfileSummary>, LibraryError> {
        Ok(self.files()?.iter().map(summary).collect())
    }

    /// The text of a profile, also of one that cannot be used.
    pub(crate) fn text(&self, name: &str) -> Result<ProfileText, LibraryError> {
        let file = self.file(name)?;
        Ok(ProfileText {
            name: name.to_owned(),
            origin: file.origin,
            file: file.path.display().to_string(),
            text: read_text(&file.path)?,
        })
    }

    /// Saves a text as an own profile under the name that it has in it. Another profile of that name is replaced only if
    /// `replace` says so; a shipped file is never changed, the own one goes before it.
    pub(crate) fn save(&self, text: &str, replace: bool) -> Result<ProfileSummary, LibraryError> {
        let profile = Profile::from_toml(text, "text")?;
        let name = profile.name;
        if !name.starts_with(|c: char| c.is_ascii_alphanumeric()) {
            return Err(LibraryError::Name { name });
        }
        let there = self.file(&name).ok();
        if let Some(file) = there.as_ref().filter(|_| !replace) {
            return Err(LibraryError::Exists {
                name,
                what: match file.origin {
                    ProfileOrigin::Shipped => "a shipped profile",
                    ProfileOrigin::Own => "a profile of your own",
                },
            });
        }
        let own = self
            .own
            .as_ref()
            .ok_or_else(|| LibraryError::NotOwn { name: name.clone() })?;
        let path = own.join(format!("{name}.toml"));
        let written = atomic_file::create_private_folder(own)
            .and_then(|()| atomic_file::write(&path, |file| file.write_all(text.as_bytes())));
        written.map_err(|source| LibraryError::Write {
            path: path.clone(),
            source,
        })?;
        Ok(summary(&ProfileFile {
            path,
            origin: ProfileOrigin::Own,
            replaces: there.is_some_and(|file| file.origin == ProfileOrigin::Shipped || file.replaces),
        }))
    }

    /// Deletes an own profile.
    pub(crate) fn delete(&self, name: &str) -> Result<(), LibraryError> {
        let file = self.file(name)?;
        if file.origin != ProfileOrigin::Own {
            return Err(LibraryError::NotOwn {
                name: name.to_owned(),
            });
        }
        std::fs::remove_file(&file.path).map_err(|source| LibraryError::Write {
            path: file.path,
            source,
        })
    }

    /// The files by name; of two with one name the own one.
    fn files(&self) -> Result<Vec<ProfileFile>, LibraryError> {
        let mut files: BTreeMap<PathBuf, ProfileFile> = BTreeMap::new();
        let mut take = |folder: &Path, origin| -> Result<(), LibraryError> {
            for path in toml_files(folder)? {
                let name = path.file_name().map(PathBuf::from).unwrap_or_default();
                let replaces = files.contains_key(&name);
                files.insert(
                    name,
                    ProfileFile {
                        path,
                        origin,
                        replaces,
                    },
                );
            }
            Ok(())
        };
        take(&self.folder, ProfileOrigin::Shipped)?;
        if let Some(own) = self.own.as_ref().filter(|own| own.is_dir()) {
            take(own, ProfileOrigin::Own)?;
        }
        Ok(files.into_values().collect())
    }
}

fn toml_files(folder: &Path) -> Result<Vec<PathBuf>, LibraryError> {
    let failed = |source| LibraryError::Folder {
        path: folder.to_owned(),
        source,
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.extension().is_some_and(|e| e == "toml") {
            files.push(path);
        }
    }
    Ok(files)
}

fn name_of(path: &Path) -> &str {
    path.file_stem()
        .and_then(|stem| stem.to_str())
        .unwrap_or_default()
}

/// Reads one profile file. Returns the profile and the text of the file.
pub(crate) fn read(path: &Path) -> Result<(Profile, String), LibraryError> {
    let text = read_text(path)?;
    Ok((Profile::from_toml(&text, &path.display().to_string())?, text))
}

fn read_text(path: &Path) -> Result<String, LibraryError> {
    regular_file::read_text(path, WRITTEN_MAX_BYTES).map_err(|error| LibraryError::File {
        path: path.to_owned(),
        reason: error.to_string(),
    })
}

fn summary(file: &ProfileFile) -> ProfileSummary {
    let player = read(&file.path).and_then(|(profile, _)| {
        let player = Player::new(&profile, 0.0, f64::from(SAMPLE_RATE_HZ))?;
        Ok((profile, player))
    });
    let (usable, problem) = match player {
        Ok(usable) => (Some(usable), String::new()),
        Err(error) => (None, error.to_string()),
    };
    let player = usable.as_ref().map(|(_, player)| player);
    ProfileSummary {
        name: name_of(&file.path).to_owned(),
        duration_s: player.map_or(0.0, Player::duration_s),
        cycles: player.map_or(0, Player::total_cycles),
        description: usable.map(|(profile, _)| profile.description).unwrap_or_default(),
        problem,
        origin: file.origin,
        replaces_shipped: file.replaces,
        file: file.path.display().to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped() -> Library {
        Library::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/profiles")).expect("there")
    }

    #[test]
    fn n6_names_are_looked_up_and_never_become_paths() {
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

    #[test]
    fn an_own_profile_is_saved_by_its_name_and_replaces_nothing_unasked() {
        let folder = tempfile::tempdir().expect("a folder");
        let library = shipped().with_own(folder.path().join("profiles"));
        let count = library.list().expect("listed").len();
        let ramp = |name: &str, to: &str| {
            format!(
                "# Mine.\nname = \"{name}\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\n\
                 to_mm = {to}\nduration_s = 2.0\n"
            )
        };
        let saved = library.save(&ramp("my-ramp", "3.0"), false).expect("new");
        assert_eq!(
            (saved.origin, saved.replaces_shipped),
            (ProfileOrigin::Own, false)
        );
        assert_eq!(
            library.text("my-ramp").expect("there").text,
            ramp("my-ramp", "3.0")
        );
        assert!(matches!(
            library.save(&ramp("my-ramp", "4.0"), false),
            Err(LibraryError::Exists { .. })
        ));
        library.save(&ramp("my-ramp", "4.0"), true).expect("asked for");

        let refused = library
            .save(&ramp("static-ramp", "3.0"), false)
            .expect_err("shipped");
        assert!(refused.to_string().contains("a shipped profile"), "{refused}");
        let replaced = library
            .save(&ramp("static-ramp", "3.0"), true)
            .expect("asked for");
        assert!(replaced.replaces_shipped);
        assert_eq!(
            library.find("static-ramp").expect("there").1,
            ramp("static-ramp", "3.0")
        );
        assert_eq!(library.list().expect("listed").len(), count + 1);
        library.delete("static-ramp").expect("own");
        assert!(library.find("static-ramp").expect("shipped").1.contains("2000"));
        assert!(matches!(
            library.delete("static-ramp"),
            Err(LibraryError::NotOwn { .. })
        ));
    }

    #[test]
    fn a_text_that_is_no_profile_or_no_name_of_a_file_is_not_saved() {
        let folder = tempfile::tempdir().expect("a folder");
        let library = shipped().with_own(folder.path().to_owned());
        let text = "name = \"..\"\ncontrol = \"force\"\n[[block]]\n[[block.segment]]\nkind = \"hold\"\nduration_s = 1.0\n";
        assert!(matches!(library.save(text, true), Err(LibraryError::Name { .. })));
        let bad = text.replace("1.0", "0.0");
        assert_eq!(
            library.save(&bad, true).expect_err("no time").place(),
            Some((6, 14))
        );
        assert_eq!(std::fs::read_dir(folder.path()).expect("there").count(), 0);
    }
}
