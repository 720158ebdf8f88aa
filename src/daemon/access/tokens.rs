//! The tokens of a data folder. `token` is the owner's: whoever can read the file may do everything, on this computer. Further
//! tokens have a name and a role; `tokens.toml` has their fingerprints only.

use std::io;
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::private_file;
use super::role::Role;
use super::secret::{Fingerprint, Secret};

/// File of the owner's token in the data folder.
pub(crate) const TOKEN_FILE: &str = "token";
/// File of the tokens with a name.
pub(crate) const TOKENS_FILE: &str = "tokens.toml";
/// Name under which the owner's token appears in the audit log.
pub(crate) const OWNER: &str = "owner";
/// Longest name of a token, characters.
const NAME_MAX_CHARS: usize = 40;
/// Most tokens with a name.
const MOST_TOKENS: usize = 500;
/// First lines of the file.
const HEAD: &str = "# Written by `leafbench token`. It has the SHA-256 of each token, not the token.\n\n";

/// Why the tokens cannot be read or changed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TokenError {
    /// A file of the tokens cannot be read or written.
    #[error("{path} cannot be used: it must belong to the user of the daemon, with mode 0600")]
    File { path: PathBuf, source: io::Error },
    /// The file with the names is damaged.
    #[error("{path} is no list of tokens: correct it, or delete it and add the tokens again")]
    Text {
        path: PathBuf,
        source: Box<toml::de::Error>,
    },
    /// A name that cannot be used.
    #[error(
        "\"{0}\" cannot be the name of a token: use 1 to 40 letters, digits, dots, hyphens and underscores; not \"owner\""
    )]
    Name(String),
    /// The name is taken.
    #[error(
        "there is a token \"{0}\" already: remove it first with `leafbench token remove {0}`, or use another name"
    )]
    Taken(String),
    /// No token has the name.
    #[error("there is no token \"{0}\": `leafbench token list` shows all")]
    Unknown(String),
    /// The list is full.
    #[error(
        "there are {MOST_TOKENS} tokens: remove those that nobody uses with `leafbench token remove NAME`"
    )]
    Full,
}

/// A token with a name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct NamedToken {
    /// Of the person or program that has it.
    pub name: String,
    pub role: Role,
    /// When it was made, UTC, RFC 3339.
    pub since_utc: String,
    pub sha256: Fingerprint,
}

/// The tokens with a name.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TokenList {
    #[serde(default, rename = "token")]
    pub tokens: Vec<NamedToken>,
}

impl TokenList {
    /// Reads those of a data folder.
    pub(crate) fn read(folder: &Path) -> Result<TokenList, TokenError> {
        let path = folder.join(TOKENS_FILE);
        match private_file::read(&path) {
            Ok(None) => Ok(TokenList::default()),
            Ok(Some(text)) => toml::from_str(&text).map_err(|source| TokenError::Text {
                path,
                source: Box::new(source),
            }),
            Err(source) => Err(TokenError::File { path, source }),
        }
    }

    fn write(&self, folder: &Path) -> Result<(), TokenError> {
        let path = folder.join(TOKENS_FILE);
        let text = toml::to_string(self).map_err(io::Error::other);
        text.and_then(|text| private_file::write(&path, &format!("{HEAD}{text}")))
            .map_err(|source| TokenError::File { path, source })
    }

    /// Makes a token. It is returned once and is stored nowhere.
    pub(crate) fn add(folder: &Path, name: &str, role: Role) -> Result<Secret, TokenError> {
        let is_letter = |c: char| c.is_alphanumeric() || matches!(c, '.' | '-' | '_');
        let is_right = (1..=NAME_MAX_CHARS).contains(&name.chars().count()) && name.chars().all(is_letter);
        if !is_right || name == OWNER {
            return Err(TokenError::Name(name.chars().take(NAME_MAX_CHARS).collect()));
        }
        let mut list = TokenList::read(folder)?;
        if list.tokens.iter().any(|token| token.name == name) {
            return Err(TokenError::Taken(name.to_owned()));
        }
        if list.tokens.len() >= MOST_TOKENS {
            return Err(TokenError::Full);
        }
        let secret = Secret::new().map_err(|source| TokenError::File {
            path: PathBuf::from("/dev/urandom"),
            source,
        })?;
        list.tokens.push(NamedToken {
            name: name.to_owned(),
            role,
            since_utc: Timestamp::now().strftime("%Y-%m-%dT%H:%M:%SZ").to_string(),
            sha256: secret.fingerprint(),
        });
        list.write(folder)?;
        Ok(secret)
    }

    /// Removes a token: with it end the sessions that were opened with it.
    pub(crate) fn remove(folder: &Path, name: &str) -> Result<(), TokenError> {
        let mut list = TokenList::read(folder)?;
        let before = list.tokens.len();
        list.tokens.retain(|token| token.name != name);
        if list.tokens.len() == before {
            return Err(TokenError::Unknown(name.to_owned()));
        }
        list.write(folder)
    }
}

/// The fingerprint of the owner's token. It is made if it is not there, and made again if others could have read it: then all
/// sessions of the owner end. Also returns a sentence if it was made again.
pub(super) fn owner(folder: &Path) -> Result<(Fingerprint, Option<String>), TokenError> {
    let path = folder.join(TOKEN_FILE);
    let read = private_file::read(&path);
    if let Ok(Some(text)) = &read
        && let Some(secret) = Secret::read(text)
    {
        return Ok((secret.fingerprint(), None));
    }
    let told = match read {
        Ok(None) => None,
        Ok(Some(_)) => Some("it was no token".to_owned()),
        Err(error) => Some(error.to_string()),
    };
    let made = Secret::new().and_then(|secret| {
        private_file::write(&path, &format!("{}\n", secret.reveal()))?;
        Ok(secret.fingerprint())
    });
    match made {
        Ok(fingerprint) => {
            let sentence = told.map(|why| format!("{} was made again, because {why}", path.display()));
            Ok((fingerprint, sentence))
        }
        Err(source) => Err(TokenError::File { path, source }),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_token_is_stored_as_its_fingerprint_and_can_be_removed() {
        let folder = tempfile::tempdir().expect("a folder");
        let secret = TokenList::add(folder.path(), "meyer", Role::Operate).expect("added");
        let path = folder.path().join(TOKENS_FILE);
        let text = std::fs::read_to_string(&path).expect("written");
        assert!(!text.contains(secret.reveal()), "{text}");
        assert_eq!(
            std::fs::metadata(&path).expect("there").permissions().mode() & 0o777,
            0o600
        );
        let list = TokenList::read(folder.path()).expect("read");
        assert!(list.tokens[0].sha256.is(&secret.fingerprint()));
        assert_eq!(list.tokens[0].role, Role::Operate);
        for wrong in ["", "owner", "a b", "../x", "a\nb", &"x".repeat(41)] {
            let refused = TokenList::add(folder.path(), wrong, Role::Watch);
            assert!(matches!(refused, Err(TokenError::Name(_))), "{wrong}");
        }
        let again = TokenList::add(folder.path(), "meyer", Role::Watch);
        assert!(matches!(again, Err(TokenError::Taken(_))));
        TokenList::remove(folder.path(), "meyer").expect("removed");
        assert!(TokenList::read(folder.path()).expect("read").tokens.is_empty());
        assert!(matches!(
            TokenList::remove(folder.path(), "meyer"),
            Err(TokenError::Unknown(_))
        ));
    }

    #[test]
    fn the_owners_token_is_kept_and_made_again_once_others_could_read_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join(TOKEN_FILE);
        let (first, told) = owner(folder.path()).expect("made");
        assert_eq!(told, None);
        let mode = std::fs::metadata(&path).expect("there").permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        assert_eq!(owner(folder.path()).expect("kept").0, first);
        std::fs::set_permissions(&path, PermissionsExt::from_mode(0o644)).expect("set");
        let (second, told) = owner(folder.path()).expect("made again");
        assert_ne!(first, second);
        assert!(told.expect("a sentence").contains("other users may read"));
    }
}
