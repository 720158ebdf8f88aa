//! `leafbench new`.

use std::io::Write;
use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::shared::local;
use super::{CliCommand, CliError, Done, Output};
use crate::recording::atomic_file;

/// Longest name of a profile, in characters.
const NAME_MAX_CHARS: usize = 64;

/// Write a commented profile, bench or specimen file to start from
#[derive(Debug, Args)]
pub(super) struct NewArgs {
    /// What to write
    #[arg(value_name = "KIND", value_enum)]
    kind: NewKind,
    /// Name inside the file, and of the file: 1 to 64 letters, digits, dashes, points and underscores
    #[arg(value_name = "NAME", value_parser = new_name)]
    name: String,
    /// File to write [default: NAME.toml here]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replace the file if it is there already
    #[arg(long)]
    force: bool,
}

/// A kind of file that a person writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum NewKind {
    /// A test: commanded motion over time
    Profile,
    /// A rig: link, calibration, limits, specimen
    Bench,
    /// A spring and its model
    Specimen,
}

/// A name that is allowed in every kind of file and as the name of a file.
fn new_name(text: &str) -> Result<String, String> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "-._".contains(c);
    let right = text.chars().count() <= NAME_MAX_CHARS && text.chars().all(allowed);
    match right && text.contains(|c: char| c.is_ascii_alphanumeric()) {
        true => Ok(text.strip_suffix(".toml").unwrap_or(text).to_owned()),
        false => Err("use 1 to 64 letters, digits, dashes, points and underscores".to_owned()),
    }
}

impl NewKind {
    /// The template; `NAME` stands for the name.
    fn template(self) -> &'static str {
        match self {
            NewKind::Profile => include_str!("new/profile.toml"),
            NewKind::Bench => include_str!("new/bench.toml"),
            NewKind::Specimen => include_str!("new/specimen.toml"),
        }
    }

    /// What to do next with the file.
    fn next(self, file: &str) -> String {
        match self {
            NewKind::Profile => format!("edit it, then: leafbench plan {file}"),
            NewKind::Bench => format!(
                "every value is an example: put in those of your rig, then: leafbench plan static-ramp --bench {file}"
            ),
            NewKind::Specimen => {
                format!("edit it, then name it in your bench file: file = \"{file}\" under [specimen]")
            }
        }
    }
}

/// The file that was written.
#[derive(serde::Serialize)]
struct NewFile {
    file: PathBuf,
    next: String,
}

impl CliCommand for NewArgs {
    const NAME: &'static str = "new";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench new profile my-test",
        "leafbench new bench my-rig --out my-rig.toml",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let path = self
            .out
            .unwrap_or_else(|| PathBuf::from(format!("{}.toml", self.name)));
        local::require_new(&[&path], self.force)?;
        let text = self.kind.template().replace("NAME", &self.name);
        atomic_file::write(&path, |file| file.write_all(text.as_bytes()))
            .map_err(CliError::file(&path, "writing"))?;
        let written = NewFile {
            next: self.kind.next(&path.display().to_string()),
            file: path,
        };
        output.result(&written, || {
            format!("{}\n{}", written.file.display(), written.next)
        })?;
        Ok(Done::Success)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Bench, Specimen};
    use crate::daemon::plan;
    use crate::profile::Profile;

    #[test]
    fn every_template_passes_the_plan() {
        let folder = tempfile::tempdir().expect("a folder");
        let written = |kind: NewKind, name: &str| {
            let args = NewArgs {
                kind,
                name: name.to_owned(),
                out: Some(folder.path().join(format!("{name}.toml"))),
                force: false,
            };
            let path = args.out.clone().expect("named");
            args.run(&Output { json: true }).expect("written");
            path
        };
        let profile = std::fs::read_to_string(written(NewKind::Profile, "my-test")).expect("written");
        let profile = Profile::from_toml(&profile, "my-test").expect("a profile");
        assert_eq!(profile.name, "my-test");
        let specimen = Specimen::load(&written(NewKind::Specimen, "my-spring")).expect("a specimen");
        assert_eq!(specimen.name, "my-spring");
        let mut bench = Bench::load(&written(NewKind::Bench, "my-rig")).expect("a bench");
        assert_eq!(bench.name, "my-rig");
        for model in [bench.model.clone(), specimen.model] {
            bench.model = model;
            let plan = plan::check(&bench, &profile).expect("planned");
            assert_eq!(plan.trips, Vec::<String>::new());
        }
    }

    #[test]
    fn a_file_that_is_there_is_kept() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.toml");
        std::fs::write(&path, "mine").expect("written");
        let args = |force| NewArgs {
            kind: NewKind::Profile,
            name: "a".to_owned(),
            out: Some(path.clone()),
            force,
        };
        let refused = args(false)
            .run(&Output { json: true })
            .expect_err("there")
            .to_string();
        assert!(
            refused.contains("is there already") && refused.contains("--force"),
            "{refused}"
        );
        assert_eq!(std::fs::read_to_string(&path).expect("there"), "mine");
        args(true).run(&Output { json: true }).expect("replaced");
        assert!(
            std::fs::read_to_string(&path)
                .expect("there")
                .contains("name = \"a\"")
        );
    }

    #[test]
    fn a_name_is_no_path_and_may_have_the_extension() {
        assert_eq!(new_name("my-test.toml").as_deref(), Ok("my-test"));
        for name in ["", "..", "a/b", "a b", "ä"] {
            assert!(new_name(name).is_err(), "{name}");
        }
    }
}
