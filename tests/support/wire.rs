//! A serial wire without hardware.

use std::os::fd::AsRawFd;

/// Two pseudo-terminals joined back to back: the wire between two processes.
pub struct Wire {
    /// Device names of both ends.
    pub ports: [String; 2],
    _pump: std::thread::JoinHandle<()>,
}

impl Wire {
    pub fn new() -> Wire {
        let open = || nix::pty::openpty(None, None).expect("a pseudo-terminal");
        let (a, b) = (open(), open());
        let ports = [&a, &b].map(|end| {
            let mut settings = nix::sys::termios::tcgetattr(&end.slave).expect("a terminal");
            nix::sys::termios::cfmakeraw(&mut settings);
            nix::sys::termios::tcsetattr(&end.slave, nix::sys::termios::SetArg::TCSANOW, &settings)
                .expect("set");
            nix::unistd::ttyname(&end.slave)
                .expect("a name")
                .display()
                .to_string()
        });
        let pump = std::thread::spawn(move || {
            let copy = |from: std::os::fd::OwnedFd, to: std::os::fd::OwnedFd| {
                std::thread::spawn(move || {
                    // The wire is no program: it does not wait for its turn, where that is allowed.
                    let _ = crate::link::priority::raise_this_thread();
                    let (mut from, mut to) = (std::fs::File::from(from), std::fs::File::from(to));
                    // Ends with the processes at the ends.
                    let _ = std::io::copy(&mut from, &mut to);
                })
            };
            let twice = |fd: &std::os::fd::OwnedFd| fd.try_clone().expect("a handle");
            let there = copy(twice(&a.master), twice(&b.master));
            let back = copy(twice(&b.master), twice(&a.master));
            // The far ends stay open until here, so that a port can be opened, closed and opened again.
            let _held = (a.slave.as_raw_fd(), b.slave.as_raw_fd());
            let _ = (there.join(), back.join());
            drop((a, b));
        });
        Wire { ports, _pump: pump }
    }
}
