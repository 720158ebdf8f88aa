//! The order of starts and stops. One run at a time is prepared; a stop withdraws it for good.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::http::StatusCode;

use super::error::ApiError;
use super::wanted::{Wanted, Withdrawal};

/// The run that is being prepared, if there is one. Clones share it.
#[derive(Clone, Default)]
pub(super) struct Starts {
    pending: Arc<Mutex<PendingStart>>,
    turn: Arc<tokio::sync::Mutex<()>>,
}

#[derive(Default)]
struct PendingStart {
    start: Option<Wanted>,
    /// Set when the daemon ends: no further start is taken.
    ends: Option<Withdrawal>,
}

/// The only start that is being prepared. Dropping it gives the place free.
pub(super) struct StartClaim {
    starts: Starts,
    wanted: Wanted,
}

impl Starts {
    fn lock(&self) -> MutexGuard<'_, PendingStart> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes the place of the one start. Refused while another run is being prepared, and once the daemon ends.
    pub(super) fn claim(&self) -> Result<StartClaim, ApiError> {
        let mut pending = self.lock();
        if let Some(why) = &pending.ends {
            return Err(why.into());
        }
        if pending.start.is_some() {
            return Err(ApiError::new(
                StatusCode::CONFLICT,
                "another run is being prepared".to_owned(),
                "wait until it runs, or stop it".to_owned(),
            ));
        }
        let wanted = Wanted::default();
        pending.start = Some(wanted.clone());
        Ok(StartClaim {
            starts: self.clone(),
            wanted,
        })
    }

    /// A run is being prepared.
    pub(super) fn is_pending(&self) -> bool {
        self.lock().start.is_some()
    }

    /// Withdraws the run that is being prepared. Returns whether there was one.
    pub(super) fn withdraw(&self, why: Withdrawal) -> bool {
        let pending = self.lock();
        let start = pending.start.as_ref();
        start.inspect(|wanted| wanted.withdraw(why)).is_some()
    }

    /// Withdraws the run that is being prepared, and refuses all further ones.
    pub(super) fn end(&self, why: Withdrawal) {
        self.lock().ends = Some(why.clone());
        self.withdraw(why);
    }

    /// The turn to ask control for a start or a stop. A start looks whether it is still wanted and asks control within one
    /// turn, a stop withdraws the start before its turn: so the stop is either before that look, and the start asks for
    /// nothing, or after the request, and stops the run. A turn lasts until control answers, some milliseconds.
    pub(super) async fn turn(&self) -> tokio::sync::MutexGuard<'_, ()> {
        self.turn.lock().await
    }
}

impl StartClaim {
    /// Whether this start is still wanted.
    pub(super) fn wanted(&self) -> Wanted {
        self.wanted.clone()
    }
}

impl Drop for StartClaim {
    fn drop(&mut self) {
        self.starts.lock().start = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stopped() -> Withdrawal {
        Withdrawal::Stopped("oil leak".to_owned())
    }

    #[test]
    fn one_run_at_a_time_is_prepared() {
        let starts = Starts::default();
        let first = starts.claim().expect("free");
        assert!(starts.is_pending() && starts.claim().is_err());
        drop(first);
        assert!(!starts.is_pending() && starts.claim().is_ok());
    }

    #[test]
    fn a_stop_withdraws_the_start_for_good_and_spares_the_next_one() {
        let starts = Starts::default();
        assert!(!starts.withdraw(stopped()), "nothing is prepared");
        let first = starts.claim().expect("free");
        assert!(starts.withdraw(stopped()));
        drop(first.wanted().while_client_waits());
        assert_eq!(
            first.wanted().withdrawn(),
            Some(&stopped()),
            "the first reason stays"
        );
        drop(first);
        let next = starts.claim().expect("free");
        assert!(next.wanted().check().is_ok());
    }

    #[test]
    fn a_daemon_that_ends_takes_no_further_start() {
        let starts = Starts::default();
        let first = starts.claim().expect("free");
        starts.end(Withdrawal::DaemonEnds("SIGTERM".to_owned()));
        assert!(first.wanted().check().is_err());
        drop(first);
        let refusal = starts.claim().err().expect("refused");
        assert_eq!(refusal.status(), StatusCode::SERVICE_UNAVAILABLE);
    }
}
