//! Who may do what. A request shows a token, or the cookie or key of a session; this says who it is and which role they have.
//!
//! | file | subject |
//! |---|---|
//! | `role` | roles, and what a route asks for |
//! | `secret` | 256 random bits and their fingerprint |
//! | `private_file` | files that only one user can read |
//! | `tokens` | the owner's token and those with a name |
//! | `guesses` | wrong secrets of each peer |
//! | `sessions` | signed-in browsers, and the links that open a session |
//!
//! Cross-site requests: orders need the header `Authorization`, which a browser does not send by itself and another page cannot
//! set without a preflight request, which is refused. The cookie is `HttpOnly` and `SameSite=Strict`. But browsers send a cookie
//! to every port of its host, so a program of another user at another port of 127.0.0.1 could get it: therefore it watches and
//! stops only.

mod guesses;
mod private_file;
pub(crate) mod role;
pub(crate) mod secret;
pub(crate) mod sessions;
pub(crate) mod tokens;

use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Instant, SystemTime};

use jiff::Timestamp;

use guesses::Guesses;
pub(super) use guesses::{MOST_WRONG, WINDOW};
use role::Role;
use secret::{Fingerprint, Secret};
use sessions::{SessionSecrets, Sessions};
use tokens::{NamedToken, OWNER, TOKENS_FILE, TokenError, TokenList};

/// Who sends a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Person {
    /// Name of the token; `owner` for the owner's.
    pub name: String,
    pub role: Role,
    /// The request shows a token or the key of a session, and not only a cookie.
    pub has_key: bool,
    /// The token itself, or that of the session.
    token: Fingerprint,
}

/// What a request shows.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Shown<'a> {
    /// Of the header `Authorization: Bearer`.
    pub bearer: Option<&'a str>,
    /// The cookie of the page.
    pub cookie: Option<&'a str>,
    /// The request came over the loopback address, with its name as host. The owner's token is good for that only.
    pub is_local: bool,
}

/// What a request's secrets say.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Known {
    /// Somebody who belongs here.
    Person(Person),
    /// No secret is shown.
    Nobody,
    /// A secret is shown, and it is none of ours.
    Wrong,
}

/// Size, time and place of a file: another one means other content.
type ListStamp = Option<(u64, u64, SystemTime)>;

/// Tokens, sessions and wrong guesses of a daemon. Requests are checked in memory: no disk is between a person and a stop.
#[derive(Debug)]
pub(super) struct AccessControl {
    folder: PathBuf,
    keys: Mutex<KnownKeys>,
    guesses: Mutex<Guesses>,
}

#[derive(Debug)]
struct KnownKeys {
    owner: Fingerprint,
    tokens: Vec<NamedToken>,
    sessions: Sessions,
    /// That of the list of tokens when it was read.
    stamp: ListStamp,
}

impl KnownKeys {
    /// Name and role of a token.
    fn whose(&self, token: &Fingerprint, is_local: bool) -> Option<(String, Role)> {
        let named = self.tokens.iter().fold(None, |found, named| {
            if named.sha256.is(token) {
                Some(named)
            } else {
                found
            }
        });
        let owner = (OWNER.to_owned(), Role::Administer);
        match named {
            Some(named) => Some((named.name.clone(), named.role)),
            None => (self.owner.is(token) && is_local).then_some(owner),
        }
    }

    fn person(&self, token: &Fingerprint, has_key: bool, is_local: bool) -> Option<Person> {
        let (name, role) = self.whose(token, is_local)?;
        Some(Person {
            name,
            role,
            has_key,
            token: token.clone(),
        })
    }
}

impl AccessControl {
    /// Reads tokens and sessions of a data folder; the owner's token is made where there is none.
    pub(super) fn open(folder: &Path) -> Result<AccessControl, TokenError> {
        let (owner, told) = tokens::owner(folder)?;
        if let Some(sentence) = told {
            tracing::warn!("{sentence}");
        }
        let stamp = stamp(folder);
        let tokens = TokenList::read(folder)?.tokens;
        let mut keys = KnownKeys {
            owner,
            tokens,
            sessions: Sessions::read(folder),
            stamp,
        };
        forget_orphans(&mut keys);
        Ok(AccessControl {
            folder: folder.to_owned(),
            keys: Mutex::new(keys),
            guesses: Mutex::default(),
        })
    }

    fn keys(&self) -> MutexGuard<'_, KnownKeys> {
        self.keys.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Who shows these secrets. A valid one counts, also beside one that is not: an old key does not keep a page from a stop.
    pub(super) fn identify(&self, shown: Shown) -> Known {
        let keys = self.keys();
        let now = Timestamp::now();
        let bearer = shown.bearer.map(Fingerprint::of);
        let cookie = shown.cookie.map(Fingerprint::of);
        let by_key = bearer.and_then(|bearer| {
            let session = keys.sessions.by_key(&bearer, now);
            keys.person(session.unwrap_or(&bearer), true, shown.is_local)
        });
        let by_cookie = || {
            let session = keys.sessions.by_cookie(&cookie?, now)?;
            keys.person(session, false, shown.is_local)
        };
        match by_key.or_else(by_cookie) {
            Some(person) => Known::Person(person),
            None if shown.bearer.is_none() && shown.cookie.is_none() => Known::Nobody,
            None => Known::Wrong,
        }
    }

    /// Notes a wrong secret of a peer; how many it has sent in the last seconds.
    pub(super) fn note_wrong(&self, peer: IpAddr) -> u32 {
        let mut guesses = self.guesses.lock().unwrap_or_else(PoisonError::into_inner);
        guesses.note(peer, Instant::now())
    }

    /// The secret of a link that signs a browser in as this person.
    pub(super) fn link(&self, person: &Person) -> io::Result<Secret> {
        self.keys().sessions.link(&person.token, Instant::now())
    }

    /// The secret of a link for the owner.
    pub(super) fn owner_link(&self) -> io::Result<Secret> {
        let mut keys = self.keys();
        let owner = keys.owner.clone();
        keys.sessions.link(&owner, Instant::now())
    }

    /// Opens a session for the secret of a link, or for a token. `None` if it is neither. Writes a file.
    pub(super) fn sign_in(
        &self,
        secret: &str,
        is_local: bool,
    ) -> io::Result<Option<(Person, SessionSecrets)>> {
        let shown = Fingerprint::of(secret);
        let mut keys = self.keys();
        let token = keys.sessions.use_link(&shown, Instant::now()).unwrap_or(shown);
        let Some(person) = keys.person(&token, true, is_local) else {
            return Ok(None);
        };
        let secrets = keys.sessions.open(&token, Timestamp::now())?;
        let text = keys.sessions.text()?;
        // A slow disk holds up nobody else.
        drop(keys);
        sessions::write(&self.folder, &text)?;
        Ok(Some((person, secrets)))
    }

    /// Reads the list of tokens again if it has changed. Returns one sentence for each change. A list that cannot be read
    /// changes nothing, and is told once. Reads a file.
    pub(super) fn refresh(&self) -> Result<Vec<String>, TokenError> {
        let now = stamp(&self.folder);
        if self.keys().stamp == now {
            return Ok(Vec::new());
        }
        let list = TokenList::read(&self.folder);
        let mut keys = self.keys();
        keys.stamp = now;
        let tokens = list?.tokens;
        let told = changes(&keys.tokens, &tokens);
        keys.tokens = tokens;
        if forget_orphans(&mut keys)
            && let Ok(text) = keys.sessions.text()
        {
            drop(keys);
            if let Err(error) = sessions::write(&self.folder, &text) {
                tracing::warn!("the sessions cannot be written: {error}");
            }
        }
        Ok(told)
    }

    /// Names and roles of all tokens, for the audit log.
    pub(super) fn words(&self) -> String {
        let keys = self.keys();
        let named = keys.tokens.iter().map(|t| format!("{} ({})", t.name, t.role));
        let words: Vec<String> = std::iter::once(OWNER.to_owned()).chain(named).collect();
        words.join(", ")
    }
}

/// Forgets sessions whose token is gone.
fn forget_orphans(keys: &mut KnownKeys) -> bool {
    let valid: Vec<Fingerprint> = std::iter::once(keys.owner.clone())
        .chain(keys.tokens.iter().map(|token| token.sha256.clone()))
        .collect();
    keys.sessions
        .keep(|token| valid.iter().any(|valid| valid.is(token)))
}

fn stamp(folder: &Path) -> ListStamp {
    use std::os::unix::fs::MetadataExt;
    let metadata = std::fs::symlink_metadata(folder.join(TOKENS_FILE)).ok()?;
    Some((metadata.ino(), metadata.len(), metadata.modified().ok()?))
}

fn changes(before: &[NamedToken], after: &[NamedToken]) -> Vec<String> {
    let gone = before.iter().filter(|token| !after.contains(token));
    let new = after.iter().filter(|token| !before.contains(token));
    gone.map(|t| format!("token {} ({}) removed", t.name, t.role))
        .chain(new.map(|t| format!("token {} ({}) added", t.name, t.role)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bearer(text: &str) -> Shown<'_> {
        Shown {
            bearer: Some(text),
            cookie: None,
            is_local: true,
        }
    }

    fn role(access: &AccessControl, shown: Shown) -> Option<Role> {
        match access.identify(shown) {
            Known::Person(person) => Some(person.role),
            _ => None,
        }
    }

    #[test]
    fn a_session_has_the_role_of_its_token_and_ends_with_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let token = TokenList::add(folder.path(), "wall", Role::Watch).expect("added");
        let access = AccessControl::open(folder.path()).expect("opened");
        let Known::Person(person) = access.identify(bearer(token.reveal())) else {
            panic!("known");
        };
        assert_eq!((person.name.as_str(), person.role), ("wall", Role::Watch));
        let link = access.link(&person).expect("made");
        assert_eq!(role(&access, bearer(link.reveal())), None, "a link is no token");
        let (_, secrets) = access
            .sign_in(link.reveal(), true)
            .expect("written")
            .expect("known");
        assert_eq!(role(&access, bearer(secrets.key.reveal())), Some(Role::Watch));
        let cookie = Shown {
            cookie: Some(secrets.cookie.reveal()),
            is_local: true,
            ..Shown::default()
        };
        let Known::Person(by_cookie) = access.identify(cookie) else {
            panic!("known");
        };
        assert!(!by_cookie.has_key);
        assert_eq!(role(&access, bearer(secrets.cookie.reveal())), None);
        // The next daemon knows the session; without the token it ends.
        let access = AccessControl::open(folder.path()).expect("opened");
        assert_eq!(role(&access, bearer(secrets.key.reveal())), Some(Role::Watch));
        TokenList::remove(folder.path(), "wall").expect("removed");
        let told = access.refresh().expect("read");
        assert_eq!(told, ["token wall (watch) removed"]);
        assert_eq!(access.identify(bearer(secrets.key.reveal())), Known::Wrong);
        assert_eq!(access.identify(cookie), Known::Wrong);
        assert_eq!(access.identify(Shown::default()), Known::Nobody);
    }

    #[test]
    fn the_owners_token_is_good_on_this_computer_only() {
        let folder = tempfile::tempdir().expect("a folder");
        let access = AccessControl::open(folder.path()).expect("opened");
        let text = std::fs::read_to_string(folder.path().join(tokens::TOKEN_FILE)).expect("made");
        let owner = bearer(text.trim());
        assert_eq!(role(&access, owner), Some(Role::Administer));
        let elsewhere = Shown {
            is_local: false,
            ..owner
        };
        assert_eq!(access.identify(elsewhere), Known::Wrong);
        let link = access.owner_link().expect("made");
        assert!(access.sign_in(link.reveal(), false).expect("read").is_none());
    }

    #[test]
    fn a_damaged_list_changes_nothing() {
        let folder = tempfile::tempdir().expect("a folder");
        let token = TokenList::add(folder.path(), "meyer", Role::Operate).expect("added");
        let access = AccessControl::open(folder.path()).expect("opened");
        std::fs::write(folder.path().join(TOKENS_FILE), "damaged").expect("written");
        assert!(access.refresh().is_err());
        assert_eq!(role(&access, bearer(token.reveal())), Some(Role::Operate));
        assert!(access.refresh().expect("told once").is_empty());
    }
}
