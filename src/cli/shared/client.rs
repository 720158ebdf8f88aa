//! Talks to the daemon of a data folder over HTTP.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::super::{Done, Output};
use super::error::CliError;
use crate::daemon::ENDPOINT_FILE;
use crate::daemon::client_types::{Accepted, Endpoint, Failure, StartRun, Started, StopRequest};
use crate::regular_file;

/// Environment variable in place of `--data`.
pub(crate) const DATA_VARIABLE: &str = "LEAFBENCH_DATA";
/// Largest size of the endpoint file, in bytes: an address and a process id.
const ENDPOINT_MAX_BYTES: u64 = 4096;
/// Longest wait for an answer: the plan of a slow model takes its time.
const TIMEOUT: Duration = Duration::from_secs(120);

/// The data folder, through which a command finds its daemon and the runs.
#[derive(Debug, Args)]
pub(crate) struct DataArg {
    /// Folder of the run files; the daemon is also found through it
    #[arg(
        long = "data",
        value_name = "DIR",
        env = DATA_VARIABLE,
        default_value = "leafbench-data"
    )]
    pub folder: PathBuf,
}

impl DataArg {
    /// The daemon of this data folder.
    pub(crate) fn client(&self) -> Result<Client, CliError> {
        Client::of(&self.folder)
    }
}

/// A stop is sent again so often if the daemon closed its connection, as it may do under a flood of connections.
const STOP_TRIES: u32 = 5;
/// Pause before a stop is sent again.
const STOP_PAUSE: Duration = Duration::from_millis(100);

/// A connection to a running daemon.
#[derive(Clone)]
pub(crate) struct Client {
    agent: ureq::Agent,
    url: String,
    folder: PathBuf,
}

impl Client {
    fn of(folder: &Path) -> Result<Client, CliError> {
        let path = folder.join(ENDPOINT_FILE);
        let endpoint: Option<Endpoint> = regular_file::read_text(&path, ENDPOINT_MAX_BYTES)
            .ok()
            .and_then(|text| serde_json::from_str(&text).ok());
        let endpoint = endpoint.ok_or_else(|| CliError::NoDaemon {
            tried: format!("there is no {}", path.display()),
        })?;
        let agent = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(TIMEOUT))
            // The daemon is on this computer: a proxy of the environment does not apply.
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
    pub(crate) fn page(&self) -> String {
        format!("{}/", self.url)
    }

    /// Reads from the daemon (HTTP GET).
    pub(crate) fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, CliError> {
        self.answer(self.agent.get(format!("{}{path}", self.url)).call())
    }

    /// Sends to the daemon (HTTP POST).
    pub(crate) fn post<T: DeserializeOwned>(&self, path: &str, body: &impl Serialize) -> Result<T, CliError> {
        self.answer(self.agent.post(format!("{}{path}", self.url)).send_json(body))
    }

    /// Asks for a run. The daemon answers once its profile is checked, which takes as long as it takes: the caller may end it
    /// with [`Client::stop`], and the end of this process ends it too.
    pub(crate) fn start(&self, order: &StartRun) -> Result<Started, CliError> {
        let request = self.agent.post(format!("{}/api/run", self.url));
        self.answer(request.config().timeout_global(None).build().send_json(order))
    }

    /// Stops whatever the bench is doing.
    pub(crate) fn stop(&self, reason: Option<String>) -> Result<Accepted, CliError> {
        let request = StopRequest { reason };
        for _ in 1..STOP_TRIES {
            match self.post("/api/stop", &request) {
                Err(CliError::NoDaemon { .. }) => std::thread::sleep(STOP_PAUSE),
                answer => return answer,
            }
        }
        self.post("/api/stop", &request)
    }

    /// Sends an order and prints what the daemon does now.
    pub(crate) fn order(&self, path: &str, body: &impl Serialize, output: &Output) -> Result<Done, CliError> {
        let accepted: Accepted = self.post(path, body)?;
        output.result(&accepted, || accepted.message.clone())?;
        Ok(Done::Success)
    }

    fn answer<T: DeserializeOwned>(
        &self,
        answer: Result<ureq::http::Response<ureq::Body>, ureq::Error>,
    ) -> Result<T, CliError> {
        let no_daemon = |error: ureq::Error| CliError::NoDaemon {
            tried: format!(
                "{} in {} names {}, where no daemon answers: {error}",
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
