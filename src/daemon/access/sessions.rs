//! Sessions of the page, and the links that open them. A session has two secrets: a cookie, which the browser sends by itself,
//! and a key, which only our page can read. Their fingerprints are in a file, so that a session outlives the daemon. A link
//! works once, soon, and with this daemon only.

use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::private_file;
use super::secret::{Fingerprint, Secret};

/// File of the sessions in the data folder.
const SESSIONS_FILE: &str = "sessions.json";
/// A session ends after this time, s: a technician signs in four times a year.
pub(crate) const SESSION_LIFE_S: i64 = 90 * 24 * 3600;
/// A link works for this long.
pub(crate) const LINK_LIFE: Duration = Duration::from_secs(600);
/// Most sessions; beyond that the oldest one ends.
const MOST_SESSIONS: usize = 200;
/// Most links that wait for their use.
const MOST_LINKS: usize = 50;

/// A browser that is signed in.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct BrowserSession {
    cookie: Fingerprint,
    key: Fingerprint,
    /// The token that it was opened with. It ends with this token and has its role.
    token: Fingerprint,
    /// Start, s since 1970.
    since_s: i64,
}

/// A link that was not used yet.
#[derive(Debug)]
struct UnusedLink {
    secret: Fingerprint,
    token: Fingerprint,
    made: Instant,
}

/// What a browser gets when it signs in.
#[derive(Debug)]
pub(crate) struct SessionSecrets {
    pub cookie: Secret,
    pub key: Secret,
}

/// All sessions and links of a daemon.
#[derive(Debug, Default)]
pub(super) struct Sessions {
    sessions: Vec<BrowserSession>,
    links: Vec<UnusedLink>,
}

impl Sessions {
    /// Those of the data folder. A file that others could have written is not believed: everybody signs in again.
    pub(super) fn read(folder: &Path) -> Sessions {
        let path = folder.join(SESSIONS_FILE);
        let read = private_file::read(&path).and_then(|text| {
            text.map_or(Ok(Vec::new()), |text| {
                serde_json::from_str(&text).map_err(io::Error::other)
            })
        });
        let sessions = read.unwrap_or_else(|error| {
            tracing::warn!(
                "{} is not used, so all pages sign in again: {error}",
                path.display()
            );
            Vec::new()
        });
        Sessions {
            sessions,
            links: Vec::new(),
        }
    }

    /// The text of the file.
    pub(super) fn text(&self) -> io::Result<String> {
        serde_json::to_string(&self.sessions).map_err(io::Error::other)
    }

    /// The token of the session with this cookie.
    pub(super) fn by_cookie(&self, shown: &Fingerprint, now: Timestamp) -> Option<&Fingerprint> {
        self.find(now, |session| session.cookie.is(shown))
    }

    /// The token of the session with this key.
    pub(super) fn by_key(&self, shown: &Fingerprint, now: Timestamp) -> Option<&Fingerprint> {
        self.find(now, |session| session.key.is(shown))
    }

    /// Looks at all of them, so that the time does not tell which one it is.
    fn find(&self, now: Timestamp, is_it: impl Fn(&BrowserSession) -> bool) -> Option<&Fingerprint> {
        let age_s = |session: &BrowserSession| now.as_second().saturating_sub(session.since_s);
        self.sessions.iter().fold(None, |found, session| {
            match is_it(session) && age_s(session) < SESSION_LIFE_S {
                true => Some(&session.token),
                false => found,
            }
        })
    }

    /// Opens a session for somebody who has `token`.
    pub(super) fn open(&mut self, token: &Fingerprint, now: Timestamp) -> io::Result<SessionSecrets> {
        let secrets = SessionSecrets {
            cookie: Secret::new()?,
            key: Secret::new()?,
        };
        let now_s = now.as_second();
        self.sessions
            .retain(|session| now_s.saturating_sub(session.since_s) < SESSION_LIFE_S);
        if self.sessions.len() >= MOST_SESSIONS {
            self.sessions.remove(0);
        }
        self.sessions.push(BrowserSession {
            cookie: secrets.cookie.fingerprint(),
            key: secrets.key.fingerprint(),
            token: token.clone(),
            since_s: now_s,
        });
        Ok(secrets)
    }

    /// Forgets the sessions of tokens that are gone. Returns whether there were any.
    pub(super) fn keep(&mut self, is_valid: impl Fn(&Fingerprint) -> bool) -> bool {
        let before = self.sessions.len();
        self.sessions.retain(|session| is_valid(&session.token));
        self.links.retain(|link| is_valid(&link.token));
        self.sessions.len() != before
    }

    /// The secret of a new link for somebody who has `token`.
    pub(super) fn link(&mut self, token: &Fingerprint, now: Instant) -> io::Result<Secret> {
        let secret = Secret::new()?;
        self.links
            .retain(|link| now.saturating_duration_since(link.made) < LINK_LIFE);
        if self.links.len() >= MOST_LINKS {
            self.links.remove(0);
        }
        self.links.push(UnusedLink {
            secret: secret.fingerprint(),
            token: token.clone(),
            made: now,
        });
        Ok(secret)
    }

    /// The token of a link, which is used up by this.
    pub(super) fn use_link(&mut self, shown: &Fingerprint, now: Instant) -> Option<Fingerprint> {
        let at = self.links.iter().position(|link| link.secret.is(shown))?;
        let link = self.links.remove(at);
        (now.saturating_duration_since(link.made) < LINK_LIFE).then_some(link.token)
    }
}

/// Writes the file of the sessions.
pub(super) fn write(folder: &Path, text: &str) -> io::Result<()> {
    private_file::write(&folder.join(SESSIONS_FILE), text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_works_once_and_not_for_long() {
        let mut sessions = Sessions::default();
        let token = Fingerprint::of("token");
        let begun = Instant::now();
        let link = sessions.link(&token, begun).expect("made").fingerprint();
        assert_eq!(sessions.use_link(&Fingerprint::of("other"), begun), None);
        assert_eq!(sessions.use_link(&link, begun), Some(token.clone()));
        assert_eq!(sessions.use_link(&link, begun), None);
        let late = sessions.link(&token, begun).expect("made").fingerprint();
        assert_eq!(sessions.use_link(&late, begun + LINK_LIFE), None);
    }

    #[test]
    fn a_session_outlives_the_daemon_and_ends_with_its_token_and_its_time() {
        let folder = tempfile::tempdir().expect("a folder");
        let token = Fingerprint::of("token");
        let begun = Timestamp::now();
        let mut sessions = Sessions::default();
        let secrets = sessions.open(&token, begun).expect("opened");
        let text = sessions.text().expect("written");
        assert!(!text.contains(secrets.key.reveal()) && !text.contains(secrets.cookie.reveal()));
        write(folder.path(), &text).expect("written");
        let mut again = Sessions::read(folder.path());
        let cookie = secrets.cookie.fingerprint();
        assert_eq!(again.by_cookie(&cookie, begun), Some(&token));
        assert_eq!(again.by_key(&secrets.key.fingerprint(), begun), Some(&token));
        assert_eq!(again.by_key(&cookie, begun), None, "the cookie is no key");
        let later = begun + jiff::SignedDuration::from_secs(SESSION_LIFE_S);
        assert_eq!(again.by_cookie(&cookie, later), None);
        assert!(again.keep(|_| false));
        assert_eq!(again.by_cookie(&cookie, begun), None);
    }
}
