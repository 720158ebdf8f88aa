//! Talks to the daemon of a data folder over HTTP.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::super::{Done, Output};
use super::error::CliError;
use crate::daemon::ENDPOINT_FILE;
use crate::daemon::access::secret::Secret;
use crate::daemon::access::tokens::TOKEN_FILE;
use crate::daemon::client_types::{
    Accepted, CALLER_HEADER, Caller, Endpoint, Failure, StartRun, Started, StopRequest,
};
use crate::regular_file;

/// Environment variable in place of `--data`.
pub(crate) const DATA_VARIABLE: &str = "LEAFBENCH_DATA";
/// Environment variable with a token.
const TOKEN_VARIABLE: &str = "LEAFBENCH_TOKEN";
/// File of a person's own token, below the folder for settings.
const OWN_TOKEN: &str = "leafbench/token";
/// Largest size of the endpoint file and of a token file, in bytes.
const ENDPOINT_MAX_BYTES: u64 = 4096;
/// Longest wait for an answer: the plan of a slow model takes its time.
const TIMEOUT: Duration = Duration::from_secs(120);

/// The data folder, through which a command finds its daemon and the runs.
#[derive(Debug, Args)]
pub(crate) struct DataArg {
    /// Folder of the run files and of your own profiles; the daemon is also found through it
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

/// How a command gives orders to the bench.
#[derive(Debug, Args)]
pub(crate) struct CommandArgs {
    #[command(flatten)]
    data: DataArg,
    /// Take the command over from the page or command line that has it; it is told there and recorded in the run
    #[arg(long)]
    take_over: bool,
}

impl CommandArgs {
    /// A client for one order.
    pub(crate) fn for_one_order(&self) -> Result<Client, CliError> {
        Ok(self.data.client()?.calling(false, self.take_over))
    }

    /// A client that keeps the command until this process ends.
    pub(crate) fn to_the_end(&self) -> Result<Client, CliError> {
        Ok(self.data.client()?.calling(true, self.take_over))
    }
}

/// The command lines of one user are one client: a run of one terminal can be held from another.
fn caller(stays: bool, take_over: bool) -> Caller {
    let user = ["USER", "LOGNAME"]
        .iter()
        .find_map(|name| std::env::var(name).ok());
    let user: String = user
        .unwrap_or_default()
        .chars()
        .filter(|c| !c.is_control())
        .take(40)
        .collect();
    let name = match user.as_str() {
        "" => "the command line".to_owned(),
        user => format!("the command line of {user}"),
    };
    let ascii = |c: char| if c.is_ascii() { c } else { '_' };
    Caller {
        id: name.chars().map(ascii).collect(),
        name,
        stays,
        take_over,
        person: String::new(),
    }
}

/// The token of the person who types the command: from the environment, from the data folder if it is theirs, or their own.
fn token(folder: &Path) -> Option<Secret> {
    if let Ok(token) = std::env::var(TOKEN_VARIABLE) {
        return Secret::read(&token);
    }
    let settings = std::env::var_os("XDG_CONFIG_HOME").map(PathBuf::from);
    let home = || Some(PathBuf::from(std::env::var_os("HOME")?).join(".config"));
    let own = settings.or_else(home).map(|folder| folder.join(OWN_TOKEN));
    let read = |path: PathBuf| Secret::read(&regular_file::read_text(&path, ENDPOINT_MAX_BYTES).ok()?);
    read(folder.join(TOKEN_FILE)).or_else(|| read(own?))
}

/// JSON that a header can carry: other characters than ASCII are escaped.
fn header_of(caller: &Caller) -> String {
    let json = serde_json::to_string(caller).unwrap_or_default();
    let mut text = String::with_capacity(json.len());
    for c in json.chars() {
        if c.is_ascii() {
            text.push(c);
            continue;
        }
        for unit in c.encode_utf16(&mut [0; 2]) {
            // Writing into a text does not fail.
            let _ = write!(text, "\\u{unit:04x}");
        }
    }
    text
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
    /// Of this person; without one the daemon says what to do.
    token: Option<Secret>,
    /// Who gives the orders; `None` for a client that only reads and stops.
    caller: Option<Caller>,
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
            token: token(folder),
            caller: None,
        })
    }

    /// The same with a name, for orders. `stays`: it keeps the command while it asks for the status.
    pub(crate) fn calling(self, stays: bool, take_over: bool) -> Client {
        Client {
            caller: Some(caller(stays, take_over)),
            ..self
        }
    }

    fn named<B>(&self, request: ureq::RequestBuilder<B>) -> ureq::RequestBuilder<B> {
        let request = match &self.token {
            Some(token) => request.header("Authorization", format!("Bearer {}", token.reveal())),
            None => request,
        };
        match &self.caller {
            Some(caller) => request.header(CALLER_HEADER, header_of(caller)),
            None => request,
        }
    }

    /// Address of the technician's page.
    pub(crate) fn page(&self) -> String {
        format!("{}/", self.url)
    }

    /// Reads from the daemon (HTTP GET).
    pub(crate) fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, CliError> {
        self.answer(self.named(self.agent.get(format!("{}{path}", self.url))).call())
    }

    /// Sends to the daemon (HTTP POST).
    pub(crate) fn post<T: DeserializeOwned>(&self, path: &str, body: &impl Serialize) -> Result<T, CliError> {
        let request = self.named(self.agent.post(format!("{}{path}", self.url)));
        self.answer(request.send_json(body))
    }

    /// Asks for a run. The daemon answers once its profile is checked, which takes as long as it takes: the caller may end it
    /// with [`Client::stop`], and the end of this process ends it too.
    pub(crate) fn start(&self, order: &StartRun) -> Result<Started, CliError> {
        let request = self.named(self.agent.post(format!("{}/api/run", self.url)));
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
            place: None,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_with_any_letters_goes_through_a_header_of_ascii() {
        let named = Caller {
            id: "a".to_owned(),
            name: "the command line of J\u{fc}rgen \u{1f600}".to_owned(),
            ..Caller::default()
        };
        let header = header_of(&named);
        assert!(header.is_ascii(), "{header}");
        assert_eq!(serde_json::from_str::<Caller>(&header).expect("JSON"), named);
    }
}
