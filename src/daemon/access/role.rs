//! What a person may do. Each role may do everything that those before it may.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a token allows, the least first.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema, clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Role {
    /// See everything, predict tests, stop the bench
    Watch,
    /// Also give orders: run, hold, reset, tare, jog, save profiles
    Operate,
    /// Also answer for an override, and read the audit log
    Administer,
}

impl Role {
    const ALL: [Role; 3] = [Role::Watch, Role::Operate, Role::Administer];

    /// The word on the command line and in files.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Role::Watch => "watch",
            Role::Operate => "operate",
            Role::Administer => "administer",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Role, String> {
        let role = Role::ALL.into_iter().find(|role| role.word() == text);
        role.ok_or_else(|| format!("\"{text}\" is no role: write watch, operate or administer"))
    }
}

/// What a route asks of the person who sends a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Needs {
    /// The least role; `None` for everybody.
    pub role: Option<Role>,
    /// The cookie of the page is enough. A browser sends a cookie by itself, and to each port of the computer; so it watches and
    /// stops only. Orders need a token, or the key that only our page can read.
    pub by_cookie: bool,
}

impl Needs {
    /// Open to everybody: what is needed to sign in.
    pub(crate) const NOTHING: Needs = Needs {
        role: None,
        by_cookie: true,
    };
    /// Everybody who belongs here, with whatever role. Stop is among these routes: see `docs/safety.md`.
    pub(crate) const WATCH: Needs = Needs {
        role: Some(Role::Watch),
        by_cookie: true,
    };
    /// Any role, with a token or the key of a page: what makes a new session.
    pub(crate) const OWN_KEY: Needs = Needs {
        role: Some(Role::Watch),
        by_cookie: false,
    };
    /// Orders to the bench and changes of its data.
    pub(crate) const OPERATE: Needs = Needs {
        role: Some(Role::Operate),
        by_cookie: false,
    };
    /// What is about people.
    pub(crate) const ADMINISTER: Needs = Needs {
        role: Some(Role::Administer),
        by_cookie: false,
    };
}
