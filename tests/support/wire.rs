//! Serial ports and wires without hardware.

use std::fs::File;
use std::os::unix::fs::OpenOptionsExt;

use nix::fcntl::OFlag;
use nix::pty::{grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};

/// A pseudo-terminal. No process that is started meanwhile inherits an end of it: so dropping `master` unplugs the port.
pub struct Terminal {
    /// The far end of the line.
    pub master: File,
    /// Keeps the port alive while no program has it open.
    pub slave: File,
    /// Device name of the port.
    pub port: String,
}

impl Terminal {
    pub fn new() -> Terminal {
        let master =
            posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC).expect("a pseudo-terminal");
        grantpt(&master).and_then(|()| unlockpt(&master)).expect("ours");
        let port = ptsname_r(&master).expect("a name");
        let slave = File::options()
            .read(true)
            .write(true)
            .custom_flags(OFlag::O_NOCTTY.bits())
            .open(&port)
            .expect("its other end");
        // As a link will set it; before that, bytes would be echoed and translated.
        let mut settings = tcgetattr(&slave).expect("a terminal");
        cfmakeraw(&mut settings);
        tcsetattr(&slave, SetArg::TCSANOW, &settings).expect("set");
        Terminal {
            master: File::from(std::os::fd::OwnedFd::from(master)),
            slave,
            port,
        }
    }
}

/// Two pseudo-terminals joined back to back: the wire between two processes.
pub struct Wire {
    /// Device names of both ends.
    pub ports: [String; 2],
    // The ports stay open until here, so that they can be opened, closed and opened again.
    _ends: [File; 2],
}

impl Wire {
    pub fn new() -> Wire {
        let (a, b) = (Terminal::new(), Terminal::new());
        for (from, to) in [(&a, &b), (&b, &a)] {
            let mut from = from.master.try_clone().expect("a handle");
            let mut to = to.master.try_clone().expect("a handle");
            std::thread::spawn(move || {
                // The wire is no program: it does not wait for its turn, where that is allowed.
                let _ = crate::link::priority::raise_this_thread();
                // Ends with the processes at the ends.
                let _ = std::io::copy(&mut from, &mut to);
            });
        }
        Wire {
            ports: [a.port, b.port],
            _ends: [a.slave, b.slave],
        }
    }
}
