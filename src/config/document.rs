//! The text of a bench or specimen file, and the place of a key in it. `file` reads values from it, `checks` refuses them.

use std::ops::Range;

use toml::de::{DeTable, DeValue};

use super::ConfigError;
use crate::profile::reader::line_column;

/// The text of a file, for errors with line and column.
pub(super) struct Document<'a> {
    text: &'a str,
    origin: &'a str,
}

impl<'a> Document<'a> {
    pub(super) fn read<T: serde::de::DeserializeOwned>(
        text: &'a str,
        origin: &'a str,
    ) -> Result<(Self, T), ConfigError> {
        let document = Document { text, origin };
        match toml::from_str(text) {
            Ok(value) => Ok((document, value)),
            Err(e) => Err(document.at(e.span().unwrap_or(0..0), "toml", e.message().replace('\n', "; "))),
        }
    }

    /// An error at `key` (with its tables, separated by points), or at its table if the key is not written.
    pub(super) fn refuse(&self, key: &str, reason: impl Into<String>) -> ConfigError {
        self.at(self.span(key).unwrap_or(0..0), key, reason.into())
    }

    /// True if the key is written.
    pub(super) fn has(&self, key: &str) -> bool {
        DeTable::parse(self.text).is_ok_and(|root| root.get_ref().contains_key(key))
    }

    fn at(&self, span: Range<usize>, key: &str, reason: String) -> ConfigError {
        let (line, column) = line_column(self.text, span.start);
        ConfigError::Invalid {
            origin: self.origin.to_owned(),
            line,
            column,
            key: key.to_owned(),
            reason,
        }
    }

    fn span(&self, key: &str) -> Option<Range<usize>> {
        let root = DeTable::parse(self.text).ok()?;
        let mut table = root.get_ref();
        let mut span = None;
        for part in key.split('.') {
            let Some(value) = table.get(part) else { break };
            span = Some(value.span());
            match value.get_ref() {
                DeValue::Table(inner) => table = inner,
                _ => break,
            }
        }
        span
    }
}
