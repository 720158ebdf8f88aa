//! Recordings, benches and profiles: from a file, from a text, or by the name of a shipped one.

use std::path::Path;

use super::CallFailure;
use crate::cli::{diagnose_inputs as inputs, local};
use crate::config::Bench;
use crate::daemon::library::{self, Library};
use crate::nearest;
use crate::profile::Profile;
use crate::recording::Recording;
use crate::recording::run_file::EXTENSION;

/// A recording with what its file says besides.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadRecording {
    /// Its samples, in the columns of a CSV.
    pub recording: Recording,
    /// Name of the specimen, from the run file or the data package beside the CSV.
    pub specimen: Option<String>,
    /// What is not whole about the file, one sentence each.
    pub notes: Vec<String>,
}

/// Reads a run file (`.leafrun`) or, with any other name, a CSV.
pub fn read_recording(path: &Path) -> Result<ReadRecording, CallFailure> {
    let mut notes = Vec::new();
    let given = match path.extension().is_some_and(|e| e == EXTENSION) {
        true => inputs::of_run(path, &path.display().to_string(), &mut |note| notes.push(note))?,
        false => inputs::of_csv(path)?,
    };
    Ok(ReadRecording {
        recording: given.recording,
        specimen: given.file.specimen,
        notes,
    })
}

/// Refuses recordings of different specimens. Each is given by its name and its specimen; those without one may be of any.
pub fn require_one_specimen<'a>(
    recordings: impl Iterator<Item = (&'a str, Option<&'a str>)>,
) -> Result<(), CallFailure> {
    Ok(inputs::one_specimen(recordings)?)
}

/// A bench: the text of a bench file, the path of one (`.toml`), or the name of a file in `configs/benches`. `None` is the mock
/// rig in memory.
pub fn find_bench(word: Option<&str>, configs: &Path) -> Result<Bench, CallFailure> {
    let Some(word) = word else {
        return Ok(Bench::shipped()?);
    };
    if word.contains('\n') {
        return Ok(Bench::parse(word, "the text of the bench")?);
    }
    let path = Path::new(word);
    if path.extension().is_some_and(|e| e == "toml") {
        local::require_file(path, local::WrittenKind::Bench)?;
        return Ok(Bench::load(path)?);
    }
    let folder = configs.join("benches");
    let names = local::toml_names(&folder);
    if names.iter().any(|name| name == word) {
        return Ok(Bench::load(&folder.join(format!("{word}.toml")))?);
    }
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    Err(CallFailure::input(format!(
        "there is no bench \"{word}\"{}: choose one of {}, or give the path of a bench file (.toml)",
        nearest::question(nearest::name(word, &names)),
        names.join(", ")
    )))
}

/// A profile: the text of a profile file, the path of one (`.toml`), or the name of a file in `configs/profiles`.
pub fn find_profile(word: &str, configs: &Path) -> Result<Profile, CallFailure> {
    let path = Path::new(word);
    if !word.contains('\n') && path.extension().is_some_and(|e| e == "toml") {
        local::require_file(path, local::WrittenKind::Profile)?;
        return Ok(library::read(path)?.0);
    }
    Ok(Library::open(&configs.join("profiles"))?.find(word)?.0)
}

#[cfg(test)]
mod tests {
    use super::super::FailureKind;
    use super::*;

    fn configs() -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs")
    }

    #[test]
    fn benches_are_found_by_name_path_and_text() {
        let configs = configs();
        let path = configs.join("benches/samurai-rail.toml");
        let by_name = find_bench(Some("samurai-rail"), &configs).expect("shipped");
        assert_eq!(find_bench(path.to_str(), &configs), Ok(by_name.clone()));
        assert_eq!(find_bench(Some(&by_name.to_toml()), &configs), Ok(by_name));
        let asked = find_bench(Some("samurai-rial"), &configs)
            .expect_err("a typo")
            .text;
        assert!(asked.contains("did you mean samurai-rail?"), "{asked}");
    }

    #[test]
    fn profiles_are_found_by_name_path_and_text() {
        let configs = configs();
        let path = configs.join("profiles/static-ramp.toml");
        let text = std::fs::read_to_string(&path).expect("shipped");
        let by_name = find_profile("static-ramp", &configs).expect("shipped");
        assert_eq!(
            find_profile(&path.display().to_string(), &configs),
            Ok(by_name.clone())
        );
        assert_eq!(find_profile(&text, &configs), Ok(by_name));
        let asked = find_profile("static-rmap", &configs).expect_err("a typo").text;
        assert!(asked.contains("did you mean static-ramp?"), "{asked}");
        let missing = find_profile("no-such-folder/x.toml", &configs).expect_err("not there");
        assert_eq!(missing.kind, FailureKind::File { os_error: 2 });
    }
}
