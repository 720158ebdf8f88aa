//! Who commands the bench: one client at a time, everybody else watches. A client that commands keeps the command while it is
//! there; a few seconds after it is gone the command is free. A free command is taken by the first order. Taking over from
//! another client is asked for, and told in the log and in the run under way. A stop needs no command.
//!
//! A client chooses its id, and its token says who it belongs to: nobody keeps or takes the command of another person by
//! using their id.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use axum::http::StatusCode;
use jiff::Timestamp;

use super::client_types::{Caller, CommanderStatus};
use super::error::ApiError;

/// A commanding client that is gone for this long has lost the command. Half of it is too short for a page that is reloaded on
/// a busy computer; twice as long keeps the next person waiting.
const GONE: Duration = Duration::from_secs(5);

/// The command of the bench. Clones share it.
#[derive(Clone, Default)]
pub(super) struct Commander {
    inner: Arc<Mutex<Desk>>,
}

#[derive(Default)]
struct Desk {
    holder: Option<Holder>,
    /// Number of sockets and requests that each client has open.
    present: BTreeMap<ClientId, usize>,
}

/// A client: the name of its token, and the id that it chose.
pub(super) type ClientId = (String, String);

/// The client that commands.
struct Holder {
    id: ClientId,
    name: String,
    since: Timestamp,
    /// When it was last there.
    seen: Instant,
}

/// A client is there as long as this lives.
pub(super) struct Presence {
    commander: Commander,
    id: ClientId,
}

impl Commander {
    fn lock(&self) -> MutexGuard<'_, Desk> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The client that commands; `None` if the command is free.
    pub(super) fn status(&self) -> Option<CommanderStatus> {
        let mut desk = self.lock();
        desk.forget_gone(Instant::now());
        desk.holder.as_ref().map(|holder| CommanderStatus {
            id: holder.id.1.clone(),
            name: holder.name.clone(),
            since_utc: holder.since.to_string(),
        })
    }

    /// Notes that a client is there.
    pub(super) fn presence(&self, id: ClientId) -> Presence {
        *self.lock().present.entry(id.clone()).or_default() += 1;
        Presence {
            commander: self.clone(),
            id,
        }
    }

    /// Takes an order of `caller`, and the command with it where it is free or asked for. Returns one sentence if the command
    /// has changed hands.
    pub(super) fn claim(&self, caller: &Caller, now: Instant) -> Result<Option<String>, ApiError> {
        let mut desk = self.lock();
        desk.forget_gone(now);
        let id = client_id(caller);
        let before = match &mut desk.holder {
            Some(holder) if holder.id == id && !caller.id.is_empty() => {
                holder.seen = now;
                holder.name.clone_from(&caller.name);
                return Ok(None);
            }
            Some(holder) if !caller.take_over => return Err(refusal(holder)),
            Some(holder) => Some(std::mem::take(&mut holder.name)),
            None if caller.stays || caller.take_over => None,
            None => return Ok(None),
        };
        desk.holder = Some(Holder {
            id,
            name: caller.name.clone(),
            since: Timestamp::now(),
            seen: now,
        });
        Ok(Some(match before {
            Some(before) => format!("{} took over the command from {before}", caller.name),
            None => format!("{} commands the bench from now on", caller.name),
        }))
    }
}

impl Desk {
    /// Frees the command of a client that is gone.
    fn forget_gone(&mut self, now: Instant) {
        let present = &self.present;
        let is_gone = |holder: &mut Holder| {
            !present.contains_key(&holder.id) && now.saturating_duration_since(holder.seen) >= GONE
        };
        if let Some(gone) = self.holder.take_if(is_gone) {
            tracing::info!("{} is gone: nobody commands the bench now", gone.name);
        }
    }
}

impl Drop for Presence {
    fn drop(&mut self) {
        let mut desk = self.commander.lock();
        if let Some(holder) = desk.holder.as_mut().filter(|holder| holder.id == self.id) {
            holder.seen = Instant::now();
        }
        if let Some(count) = desk.present.get_mut(&self.id) {
            *count -= 1;
            if *count == 0 {
                desk.present.remove(&self.id);
            }
        }
    }
}

/// The client that sends a request.
pub(super) fn client_id(caller: &Caller) -> ClientId {
    (caller.person.clone(), caller.id.clone())
}

fn refusal(holder: &Holder) -> ApiError {
    let since = holder.since.strftime("%H:%M");
    ApiError::new(
        StatusCode::CONFLICT,
        format!("{} commands the bench since {since} UTC", holder.name),
        "ask there first; then take over, with the button of the page or with --take-over; a stop is taken from everyone"
            .to_owned(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page(id: &str) -> Caller {
        Caller {
            id: id.to_owned(),
            name: format!("page of {id}"),
            stays: true,
            take_over: false,
            person: "owner".to_owned(),
        }
    }

    fn holder(commander: &Commander) -> Option<String> {
        commander.status().map(|status| status.name)
    }

    #[test]
    fn the_first_order_takes_a_free_command_and_others_are_refused_with_words() {
        let commander = Commander::default();
        let now = Instant::now();
        let told = commander.claim(&page("A"), now).expect("free");
        assert_eq!(told.as_deref(), Some("page of A commands the bench from now on"));
        assert_eq!(commander.claim(&page("A"), now).expect("its own"), None);
        for other in [page("B"), Caller::default()] {
            let refused = commander.claim(&other, now).expect_err("taken");
            assert_eq!(refused.status(), StatusCode::CONFLICT);
            assert!(format!("{refused:?}").contains("page of A commands the bench since "));
        }
    }

    #[test]
    fn an_order_that_does_not_stay_leaves_the_command_free() {
        let commander = Commander::default();
        let once = Caller {
            stays: false,
            ..page("command line")
        };
        for caller in [once, Caller::default()] {
            assert_eq!(commander.claim(&caller, Instant::now()).expect("free"), None);
            assert_eq!(holder(&commander), None);
        }
    }

    #[test]
    fn taking_over_is_told_with_both_names() {
        let commander = Commander::default();
        commander.claim(&page("A"), Instant::now()).expect("free");
        let asks = Caller {
            take_over: true,
            ..page("B")
        };
        let told = commander.claim(&asks, Instant::now()).expect("asked for");
        assert_eq!(
            told.as_deref(),
            Some("page of B took over the command from page of A")
        );
        assert_eq!(holder(&commander).as_deref(), Some("page of B"));
        assert!(commander.claim(&page("A"), Instant::now()).is_err());
    }

    #[test]
    fn a_client_that_is_there_keeps_the_command_and_one_that_is_gone_loses_it() {
        let commander = Commander::default();
        let begun = Instant::now();
        let socket = commander.presence(client_id(&page("A")));
        commander.claim(&page("A"), begun).expect("free");
        assert!(
            commander.claim(&page("B"), begun + 10 * GONE).is_err(),
            "A is there"
        );
        drop(socket);
        let left = Instant::now();
        assert!(
            commander.claim(&page("B"), left + GONE / 2).is_err(),
            "A may come back"
        );
        // A second socket of the same page, as after a reload.
        let again = commander.presence(client_id(&page("A")));
        assert!(commander.claim(&page("B"), left + 10 * GONE).is_err());
        drop(again);
        assert!(commander.claim(&page("B"), Instant::now() + GONE).is_ok());
    }

    #[test]
    fn another_person_with_the_id_of_the_commander_is_another_client() {
        let commander = Commander::default();
        let begun = Instant::now();
        commander.claim(&page("A"), begun).expect("free");
        let other = Caller {
            person: "meyer".to_owned(),
            ..page("A")
        };
        assert!(commander.claim(&other, begun).is_err());
        // Nor does the socket of another person keep the command for a client that is gone.
        let _socket = commander.presence(client_id(&other));
        assert!(commander.claim(&page("B"), begun + 2 * GONE).is_ok());
    }
}
