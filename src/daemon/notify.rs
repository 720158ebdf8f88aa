//! Tells the service manager that started this daemon (systemd, `Type=notify`) that it is ready, that control turns, and that it
//! ends. The protocol is a datagram with lines such as `READY=1` (sd_notify(3)). Without a service manager nothing is sent.

use std::ffi::{OsStr, OsString};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::Duration;

use crate::control::realtime::ControlHandle;

/// The watchdog is fed so often within the time after which it bites.
const LOOKS_A_PERIOD: u32 = 4;

/// The service manager, if there is one.
#[derive(Debug, Default)]
pub(super) struct ServiceManager {
    socket: Option<UnixDatagram>,
    /// After this time without a sign of life the service manager kills the daemon.
    watchdog: Option<Duration>,
}

impl ServiceManager {
    /// The one that the environment variables of this process name.
    pub(super) fn of_this_process() -> ServiceManager {
        let own = |pid: OsString| pid.to_str() == Some(&std::process::id().to_string());
        let for_us = std::env::var_os("WATCHDOG_PID").is_none_or(own);
        let usec = std::env::var("WATCHDOG_USEC").ok().filter(|_| for_us);
        ServiceManager::at(std::env::var_os("NOTIFY_SOCKET").as_deref(), usec.as_deref())
    }

    /// The one that listens at `address`: a path, or `@` and a name without a file.
    fn at(address: Option<&OsStr>, watchdog_us: Option<&str>) -> ServiceManager {
        let Some(address) = address else {
            return ServiceManager::default();
        };
        let connected = connect(address).inspect_err(|error| {
            tracing::warn!(
                "the service manager cannot be reached at {}: {error}",
                address.display()
            );
        });
        let watchdog = watchdog_us
            .and_then(|us| us.parse().ok())
            .filter(|us| *us > 0)
            .map(Duration::from_micros);
        ServiceManager {
            socket: connected.ok(),
            watchdog,
        }
    }

    /// Sends lines such as `READY=1`. Never waits; a manager that does not read misses them.
    pub(super) fn tell(&self, lines: &str) {
        if let Some(socket) = &self.socket
            && let Err(error) = socket.send(lines.as_bytes())
        {
            tracing::warn!("the service manager was not told \"{lines}\": {error}");
        }
    }

    /// Feeds the watchdog as long as the control loop turns. A control thread that hangs, or an async runtime that hangs, starves
    /// it.
    pub(super) async fn watch(&self, control: ControlHandle) {
        let Some(period) = self.watchdog.map(|bites| bites / LOOKS_A_PERIOD) else {
            return;
        };
        let mut seen = None;
        loop {
            let turns = control.status().1.turns;
            if seen != Some(turns) {
                self.tell("WATCHDOG=1");
            }
            seen = Some(turns);
            tokio::time::sleep(period).await;
        }
    }
}

fn connect(address: &OsStr) -> std::io::Result<UnixDatagram> {
    let socket = UnixDatagram::unbound()?;
    match address.as_bytes().strip_prefix(b"@") {
        Some(name) => socket.connect_addr(&SocketAddr::from_abstract_name(name)?)?,
        None => socket.connect(address)?,
    }
    socket.set_nonblocking(true)?;
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::Instant;

    use super::*;
    use crate::config::Bench;
    use crate::control::Rig;
    use crate::control::realtime::NoRecorder;
    use crate::link::loopback;

    /// Longest wait on a busy machine.
    const PATIENCE: Duration = Duration::from_secs(60);
    /// Pause between two looks at the socket.
    const LOOK: Duration = Duration::from_millis(10);

    fn received(socket: &UnixDatagram) -> Option<String> {
        let mut buffer = [0; 256];
        let length = socket.recv(&mut buffer).ok()?;
        Some(String::from_utf8_lossy(&buffer[..length]).into_owned())
    }

    /// Waits for the next sign of life.
    fn until_fed(socket: &UnixDatagram) {
        let began = Instant::now();
        while received(socket).is_none_or(|text| text != "WATCHDOG=1") {
            assert!(began.elapsed() < PATIENCE, "no sign of life");
        }
    }

    /// The control thread itself hangs, in the step of its far end, and not a copy of it.
    #[test]
    fn the_watchdog_starves_while_control_hangs_and_is_fed_again_after() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("notify");
        let socket = UnixDatagram::bind(&path).expect("bound");
        socket.set_read_timeout(Some(LOOK)).expect("set");
        let manager = ServiceManager::at(Some(path.as_os_str()), Some("200000"));

        let hangs = Arc::new(AtomicBool::new(false));
        let (hang, end) = (Arc::clone(&hangs), Instant::now() + 4 * PATIENCE);
        let link = loopback::stepped(move |_| {
            while hang.load(Ordering::Relaxed) && Instant::now() < end {
                std::thread::sleep(LOOK);
            }
        });
        let rig = Rig::new(Bench::shipped().expect("built in").rig_config(1));
        let (control, _thread) = ControlHandle::spawn(rig, link, Box::new(NoRecorder)).expect("a thread");
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        runtime.spawn(async move { manager.watch(control).await });
        for _ in 0..3 {
            until_fed(&socket);
        }
        hangs.store(true, Ordering::Relaxed);
        // A look may have been under way, and what was sent before is still in the socket.
        std::thread::sleep(Duration::from_millis(300));
        while received(&socket).is_some() {}
        std::thread::sleep(Duration::from_millis(600));
        assert_eq!(received(&socket), None, "a hanging control feeds the watchdog");
        hangs.store(false, Ordering::Relaxed);
        until_fed(&socket);
    }

    #[test]
    fn without_a_manager_or_a_watchdog_nothing_is_sent() {
        let silent = ServiceManager::at(None, Some("200000"));
        silent.tell("READY=1");
        assert!(silent.socket.is_none());
        let gone = ServiceManager::at(Some(OsStr::new("/nowhere/notify")), None);
        assert!(gone.socket.is_none());
        let zero = ServiceManager::at(Some(OsStr::new("@leafbench-nobody")), Some("0"));
        assert_eq!(zero.watchdog, None);
    }
}
