//! Daemons, mock rigs and commands as processes: started on free ports, waited for by condition, ended with the test.

pub mod bench;
pub mod browser;
pub mod http;
pub mod virtual_rig;
pub mod wire;

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Longest wait for a condition: far longer than a machine needs that is busy with four times its cores.
pub const PATIENCE: Duration = Duration::from_secs(300);
/// Pause between two looks at a condition.
const LOOK_PERIOD: Duration = Duration::from_millis(20);

/// A file of the shipped configs.
pub fn config(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("bench-configs")
        .join(path)
}

/// The program as it was built for these tests: it lies one folder above this test binary.
pub fn program() -> PathBuf {
    let own = std::env::current_exe().expect("a test binary knows its path");
    let program = own
        .ancestors()
        .nth(2)
        .expect("target/PROFILE/deps/BINARY")
        .join("leafbench");
    assert!(
        program.is_file(),
        "{} is missing: run `cargo test --release`, which builds it, or `cargo build` first",
        program.display()
    );
    program
}

/// `leafbench` with arguments, as it was built for this test.
pub fn leafbench(arguments: &[&str]) -> Command {
    let mut command = Command::new(program());
    command
        .args(arguments)
        .env_remove("LEAFBENCH_DATA")
        .env_remove("LEAFBENCH_TOKEN")
        .current_dir(env!("CARGO_MANIFEST_DIR"));
    command
}

/// Runs to the end.
pub fn run(arguments: &[&str]) -> Output {
    leafbench(arguments).output().expect("leafbench starts")
}

/// Runs a command on the daemon of `data`; its stdout as JSON, its exit code.
pub fn json(data: &Path, arguments: &[&str]) -> (serde_json::Value, i32) {
    let output = leafbench(arguments)
        .arg("--json")
        .arg("--data")
        .arg(data)
        .output()
        .expect("leafbench starts");
    let text = if output.status.success() || !output.stdout.is_empty() {
        output.stdout
    } else {
        output.stderr
    };
    let value = serde_json::from_slice(&text).unwrap_or(serde_json::Value::Null);
    (value, output.status.code().unwrap_or(-1))
}

/// Waits until `condition` gives something.
pub fn until<T>(what: &str, mut condition: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + PATIENCE;
    loop {
        if let Some(value) = condition() {
            return value;
        }
        assert!(Instant::now() < deadline, "waited {PATIENCE:?} for {what}");
        std::thread::sleep(LOOK_PERIOD);
    }
}

/// A process that ends with the test.
pub struct Process(pub Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A daemon on a free port.
pub struct Daemon {
    pub process: Process,
    pub url: String,
    pub data: PathBuf,
    // Closing the pipe would be a closed terminal to the daemon.
    _stdout: BufReader<ChildStdout>,
}

impl Daemon {
    /// Starts one with `more` arguments and waits until it listens.
    pub fn start(data: &Path, more: &[&str]) -> Daemon {
        let mut command = leafbench(&["daemon", "--json", "--listen", "127.0.0.1:0", "--data"]);
        command.arg(data).args(more);
        Daemon::start_command(command, |_| data.to_owned())
    }

    /// Starts one with a command line of the test and waits until it listens. `data` gives the data folder as this process
    /// sees it, from the process id.
    pub fn start_command(command: Command, data: impl FnOnce(u32) -> PathBuf) -> Daemon {
        Daemon::spawn(command, Stdio::inherit(), data)
    }

    /// The same, with a file for its log.
    pub fn start_with_log(command: Command, data: &Path, log: File) -> Daemon {
        Daemon::spawn(command, log.into(), |_| data.to_owned())
    }

    fn spawn(mut command: Command, log: Stdio, data: impl FnOnce(u32) -> PathBuf) -> Daemon {
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(log)
            .spawn()
            .expect("leafbench starts");
        let mut stdout = BufReader::new(child.stdout.take().expect("piped"));
        let mut line = String::new();
        stdout.read_line(&mut line).expect("the daemon's line");
        let endpoint: serde_json::Value = serde_json::from_str(&line).expect("the daemon listens");
        let url = endpoint["url"].as_str().expect("an address").to_owned();
        Daemon {
            data: data(child.id()),
            process: Process(child),
            url,
            _stdout: stdout,
        }
    }

    /// Starts one and waits until the rig is ready.
    pub fn ready(data: &Path, more: &[&str]) -> Daemon {
        let daemon = Daemon::start(data, more);
        daemon.until_phase("ready");
        daemon
    }

    pub fn status(&self) -> serde_json::Value {
        json(&self.data, &["status"]).0
    }

    pub fn until_phase(&self, phase: &str) -> serde_json::Value {
        until(phase, || {
            Some(self.status()).filter(|s| s["rig"]["phase"] == phase)
        })
    }

    /// Resets an interlock, if there is one, and waits.
    pub fn back_to_ready(&self) {
        until("a rig at rest", || {
            let phase = self.status()["rig"]["phase"].as_str()?.to_owned();
            if phase == "interlocked" {
                json(&self.data, &["reset"]);
            }
            (phase == "ready").then_some(())
        });
    }

    /// Sends a signal to the daemon.
    pub fn signal(&self, signal: nix::sys::signal::Signal) {
        let pid = nix::unistd::Pid::from_raw(self.process.0.id() as i32);
        nix::sys::signal::kill(pid, signal).expect("the daemon is there");
    }

    /// The owner's token.
    pub fn token(&self) -> String {
        let text = std::fs::read_to_string(self.data.join("token")).expect("the daemon has made it");
        text.trim().to_owned()
    }

    /// The header line that shows the owner's token.
    pub fn bearer(&self) -> String {
        format!("Authorization: Bearer {}\r\n", self.token())
    }

    /// A link that opens the page and signs the browser in.
    pub fn link(&self) -> String {
        let (link, code) = json(&self.data, &["open"]);
        assert_eq!(code, 0, "{link}");
        link["url"].as_str().expect("an address").to_owned()
    }

    /// Host and port, as in a `Host` header.
    pub fn authority(&self) -> &str {
        self.url.trim_start_matches("http://")
    }
}
