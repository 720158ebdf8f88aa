//! `leafbench export`.

use std::path::{Path, PathBuf};

use clap::{Arg, ArgAction, ArgGroup, ArgMatches};

use super::client::{data_argument, data_folder};
use super::{CliError, Command, Done, Output};
use crate::daemon::store::Store;
use crate::recording::export::{self, Selection};
use crate::recording::run_file::{EXTENSION, RunFile};

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "export",
    what: "Write a run as CSV with its data package, and its cycles as a second CSV; needs no daemon",
    arguments,
    run,
};

fn arguments(command: clap::Command) -> clap::Command {
    let number = || clap::value_parser!(u32).range(1..);
    command
        .arg(
            Arg::new("run")
                .value_name("RUN")
                .required(true)
                .help("Run id, `latest`, or a .leafrun file"),
        )
        .arg(
            Arg::new("out")
                .long("out")
                .value_name("DIR")
                .value_parser(clap::value_parser!(PathBuf))
                .default_value(".")
                .help("Folder to write to"),
        )
        .arg(
            Arg::new("cycle")
                .long("cycle")
                .value_name("N")
                .value_parser(number())
                .help("One counted cycle"),
        )
        .arg(
            Arg::new("mean-loop")
                .long("mean-loop")
                .action(ArgAction::SetTrue)
                .help("The mean over the complete counted cycles"),
        )
        .arg(
            Arg::new("every")
                .long("every")
                .value_name("N")
                .value_parser(number())
                .help("Every n-th sample"),
        )
        .group(ArgGroup::new("part").args(["cycle", "mean-loop", "every"]))
        .arg(data_argument())
}

#[derive(serde::Serialize)]
struct Written {
    csv: PathBuf,
    datapackage: PathBuf,
    cycles_csv: Option<PathBuf>,
    rows: u64,
    lost: u64,
    damaged: u64,
}

fn run(matches: &ArgMatches, output: &Output) -> Result<Done, CliError> {
    let id = matches
        .get_one::<String>("run")
        .map(String::as_str)
        .unwrap_or_default();
    let file = RunFile::open(&run_path(matches, id)?)?;
    let folder = matches
        .get_one::<PathBuf>("out")
        .cloned()
        .unwrap_or_else(|| ".".into());
    std::fs::create_dir_all(&folder).map_err(CliError::file(&folder, "making the folder"))?;
    let (selection, suffix) = selection(matches);
    let run_id = file.header().run_id.clone();
    let exported = export::export(&file, selection, &folder.join(format!("{run_id}{suffix}.csv")))?;
    let cycles_csv = match exported.survey.cycles.is_empty() {
        true => None,
        false => {
            let path = folder.join(format!("{run_id}.cycles.csv"));
            export::export_cycles(&file, &path)?;
            Some(path)
        }
    };
    let partial = exported.is_partial();
    let written = Written {
        rows: exported.rows,
        lost: exported.survey.lost,
        damaged: exported.survey.damaged,
        csv: exported.csv,
        datapackage: exported.datapackage,
        cycles_csv,
    };
    output.result(&written, || text(&written))?;
    Ok(if partial { Done::Otherwise } else { Done::Well })
}

fn text(w: &Written) -> String {
    let mut lines = vec![
        format!("{}  ({} rows, {} samples lost)", w.csv.display(), w.rows, w.lost),
        w.datapackage.display().to_string(),
    ];
    lines.extend(w.cycles_csv.as_ref().map(|path| path.display().to_string()));
    if w.damaged > 0 {
        lines.push(format!(
            "{} samples of the run file are damaged and left out",
            w.damaged
        ));
    }
    lines.join("\n")
}

fn run_path(matches: &ArgMatches, id: &str) -> Result<PathBuf, CliError> {
    let path = Path::new(id);
    if path.extension().is_some_and(|e| e == EXTENSION) {
        return Ok(path.to_owned());
    }
    find_run(&data_folder(matches), id)
}

/// The run file of a run by its id.
pub(super) fn find_run(folder: &Path, id: &str) -> Result<PathBuf, CliError> {
    let missing = || {
        CliError::Input(format!(
            "there is no run \"{id}\" in {}: `leafbench runs` lists them; --data names another folder",
            folder.display()
        ))
    };
    if !folder.is_dir() {
        return Err(missing());
    }
    Ok(Store::new(folder).find(id)?.ok_or_else(missing)?.path)
}

fn selection(matches: &ArgMatches) -> (Selection, String) {
    if let Some(&cycle) = matches.get_one::<u32>("cycle") {
        return (Selection::Cycle(cycle), format!("-cycle-{cycle}"));
    }
    if let Some(&n) = matches.get_one::<u32>("every") {
        return (Selection::Every(u64::from(n)), format!("-every-{n}"));
    }
    match matches.get_flag("mean-loop") {
        true => (Selection::MeanLoop, "-mean-loop".to_owned()),
        false => (Selection::Whole, String::new()),
    }
}
