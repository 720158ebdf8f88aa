//! The open connections of the HTTP interface, and which of them gives way to a new one.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};

use tokio::task::AbortHandle;

/// One open connection. Its place is free once all clones are dropped: those of its task, its answers and its WebSocket.
#[derive(Debug, Default)]
pub(super) struct Connection {
    /// Requests whose answer is not sent yet.
    in_use: AtomicUsize,
    /// All ordinary places were taken: only a stop is answered.
    pub reserved: bool,
    task: OnceLock<AbortHandle>,
}

/// Marks a connection as in use as long as it lives.
#[derive(Debug)]
pub(super) struct InUse(Arc<Connection>);

impl Connection {
    /// The task that serves this connection, which [`Connections::admit`] may abort.
    pub(super) fn served_by(&self, task: AbortHandle) {
        let _ = self.task.set(task);
    }

    /// Marks the beginning of a request.
    pub(super) fn begin_request(self: &Arc<Self>) -> InUse {
        self.in_use.fetch_add(1, Ordering::Relaxed);
        InUse(Arc::clone(self))
    }

    /// No complete request has arrived, or the last one is answered.
    fn is_idle(&self) -> bool {
        self.in_use.load(Ordering::Relaxed) == 0
    }

    fn close(&self) {
        if let Some(task) = self.task.get() {
            task.abort();
        }
    }
}

impl Drop for InUse {
    fn drop(&mut self) {
        self.0.in_use.fetch_sub(1, Ordering::Relaxed);
    }
}

/// All open connections, oldest first.
#[derive(Debug)]
pub(super) struct Connections {
    open: Mutex<Vec<Weak<Connection>>>,
    most: usize,
    reserve: usize,
}

impl Connections {
    /// At most `most` connections, and `reserve` more on which only a stop is answered.
    pub(super) fn new(most: usize, reserve: usize) -> Self {
        Connections {
            open: Mutex::default(),
            most,
            reserve,
        }
    }

    /// A place for a new connection. If all are taken, the oldest idle connection is closed for it, so that clients that open
    /// connections and send nothing cannot keep an operator out. `None` if all are in use, the reserve too.
    pub(super) fn admit(&self) -> Option<Arc<Connection>> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        open.retain(|connection| connection.strong_count() > 0);
        if open.len() >= self.most {
            let idle = open.iter().position(|c| c.upgrade().is_some_and(|c| c.is_idle()));
            if let Some(closed) = idle.map(|at| open.remove(at)).and_then(|c| c.upgrade()) {
                closed.close();
            }
        }
        if open.len() >= self.most + self.reserve {
            return None;
        }
        let connection = Arc::new(Connection {
            reserved: open.len() >= self.most,
            ..Connection::default()
        });
        open.push(Arc::downgrade(&connection));
        Some(connection)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_idle_connection_gives_way_and_one_in_use_does_not() {
        let connections = Connections::new(3, 1);
        let held: Vec<_> = (0..3).filter_map(|_| connections.admit()).collect();
        let busy = held[0].begin_request();
        let fourth = connections.admit().expect("the second one gave way");
        assert!(!fourth.reserved);
        assert!(held[1].is_idle() && !held[0].is_idle());
        let all_busy: Vec<_> = [&held[2], &fourth].map(|c| c.begin_request()).into();
        let reserved = connections.admit().expect("the reserve");
        assert!(reserved.reserved);
        let _busy_reserve = reserved.begin_request();
        assert!(connections.admit().is_none(), "everything is in use");
        drop((busy, all_busy));
        assert!(connections.admit().is_some_and(|c| c.reserved));
    }

    #[test]
    fn a_place_is_free_again_when_its_connection_has_ended() {
        let connections = Connections::new(1, 0);
        let first = connections.admit().expect("free");
        let busy = first.begin_request();
        assert!(connections.admit().is_none());
        drop((first, busy));
        assert!(connections.admit().is_some());
    }
}
