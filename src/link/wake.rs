//! Wakes a link's task when the control thread has put frames into a ring, by writing one byte to a pipe that never blocks:
//! no lock, no allocation.

use std::io;
use std::os::fd::OwnedFd;

use nix::fcntl::OFlag;
use nix::unistd;
use tokio::net::unix::pipe;

/// The control thread's end.
pub(super) struct Waker(OwnedFd);

/// The task's end before it is registered with a runtime.
pub(super) struct Sleep(OwnedFd);

/// The task's end, registered with its runtime.
pub(super) struct Wakeup(pipe::Receiver);

/// A new pipe: the control thread's end and the task's end.
pub(super) fn pair() -> io::Result<(Waker, Sleep)> {
    let (reader, writer) = unistd::pipe2(OFlag::O_NONBLOCK | OFlag::O_CLOEXEC)?;
    Ok((Waker(writer), Sleep(reader)))
}

impl Waker {
    /// Wakes the task, now or at its next wait.
    pub(super) fn wake(&self) {
        // Fails if the pipe is full (the task is woken anyway) or the task has ended (the link is closed then).
        let _ = unistd::write(&self.0, &[1]);
    }
}

impl Sleep {
    /// Registers with the current runtime.
    pub(super) fn wakeup(self) -> io::Result<Wakeup> {
        pipe::Receiver::from_owned_fd(self.0).map(Wakeup)
    }
}

impl Wakeup {
    /// Waits for a wake; several wakes since the last wait count as one. Fails after the [`Waker`] is dropped. Safe to cancel.
    pub(super) async fn wait(&self) -> io::Result<()> {
        loop {
            self.0.readable().await?;
            match self.0.try_read(&mut [0; 256]) {
                Ok(0) => return Err(io::ErrorKind::BrokenPipe.into()),
                Ok(_) => return Ok(()),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => return Err(error),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(test: impl Future<Output = ()>) {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .expect("a runtime");
        runtime.block_on(test);
    }

    #[test]
    fn a_wake_before_the_wait_is_not_lost_and_two_are_one() {
        let (waker, sleep) = pair().expect("a pipe");
        waker.wake();
        waker.wake();
        run(async {
            let wakeup = sleep.wakeup().expect("registered");
            wakeup.wait().await.expect("woken");
            let mut again = std::pin::pin!(wakeup.wait());
            let poll =
                std::future::poll_fn(|context| std::task::Poll::Ready(again.as_mut().poll(context))).await;
            assert!(poll.is_pending());
        });
    }

    #[test]
    fn the_end_of_the_waker_ends_the_wait() {
        let (waker, sleep) = pair().expect("a pipe");
        drop(waker);
        run(async {
            let wakeup = sleep.wakeup().expect("registered");
            assert!(wakeup.wait().await.is_err());
        });
    }
}
