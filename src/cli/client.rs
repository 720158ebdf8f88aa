//! Talks to the daemon of a data folder.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Arg, ArgMatches};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::CliError;
use crate::daemon::ENDPOINT_FILE;
use crate::daemon::client_types::{Endpoint, Failure};

/// Where runs are kept where nothing else is said, as in the shipped benches.
pub(super) const DEFAULT_DATA: &str = "leafbench-data";
/// A plan on a costly model takes its time.
const TIMEOUT: Duration = Duration::from_secs(120);

/// `--data` and its environment variable.
pub(super) fn data_argument() -> Arg {
    Arg::new("data").long("data").value_name("DIR").value_parser(clap::value_parser!(PathBuf)).help(
        "Folder of the run files; the daemon is found through it too [env LEAFBENCH_DATA, else leafbench-data]",
    )
}

/// The folder asked for.
pub(super) fn data_folder(matches: &ArgMatches) -> PathBuf {
    named_data_folder(matches).unwrap_or_else(|| DEFAULT_DATA.into())
}

/// The folder asked for, where one was named.
pub(super) fn named_data_folder(matches: &ArgMatches) -> Option<PathBuf> {
    matches
        .get_one::<PathBuf>("data")
        .cloned()
        .or_else(|| std::env::var_os("LEAFBENCH_DATA").map(PathBuf::from))
}

/// A daemon that can be asked.
pub(super) struct Client {
    agent: ureq::Agent,
    url: String,
    folder: PathBuf,
}

impl Client {
    /// The daemon that `--data` leads to.
    pub(super) fn of(matches: &ArgMatches) -> Result<Client, CliError> {
        Client::of_folder(&data_folder(matches))
    }

    fn of_folder(folder: &Path) -> Result<Client, CliError> {
        let path = folder.join(ENDPOINT_FILE);
        let endpoint: Option<Endpoint> = std::fs::read_to_string(&path)
            .ok()
            .and_then(|text| serde_json::from_str(&text).ok());
        let endpoint = endpoint.ok_or_else(|| CliError::NoDaemon {
            tried: format!("there is no {}", path.display()),
        })?;
        let agent = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(TIMEOUT))
            // The daemon is on this computer: no proxy has a say.
            .proxy(None)
            .build()
            .into();
        Ok(Client {
            agent,
            url: endpoint.url,
            folder: folder.to_owned(),
        })
    }

    /// Address of the technician's page.
    pub(super) fn page(&self) -> String {
        format!("{}/", self.url)
    }

    /// GET.
    pub(super) fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, CliError> {
        self.answer(self.agent.get(format!("{}{path}", self.url)).call())
    }

    /// POST.
    pub(super) fn post<T: DeserializeOwned>(&self, path: &str, body: &impl Serialize) -> Result<T, CliError> {
        self.answer(self.agent.post(format!("{}{path}", self.url)).send_json(body))
    }

    fn answer<T: DeserializeOwned>(
        &self,
        answer: Result<ureq::http::Response<ureq::Body>, ureq::Error>,
    ) -> Result<T, CliError> {
        let no_daemon = |error: ureq::Error| CliError::NoDaemon {
            tried: format!(
                "{} in {} is of a daemon that does not answer at {}: {error}",
                ENDPOINT_FILE,
                self.folder.display(),
                self.url
            ),
        };
        let mut answer = answer.map_err(no_daemon)?;
        if answer.status().is_success() {
            return answer.body_mut().read_json().map_err(no_daemon);
        }
        let status = answer.status();
        let failure: Failure = answer.body_mut().read_json().unwrap_or_else(|_| Failure {
            error: format!("the daemon answered {status}"),
            what_to_do: String::new(),
        });
        let parts = [failure.error, failure.what_to_do];
        Err(CliError::Refused(
            parts
                .into_iter()
                .filter(|p| !p.is_empty())
                .collect::<Vec<_>>()
                .join(": "),
        ))
    }
}
