//! Enumerations with fixed values on the wire.

use std::fmt::{self, Write as _};

/// Defines an enumeration whose variants have the given wire values, with `ALL`, `from_wire` and its name in words.
macro_rules! wire_enum {
    ($(#[$meta:meta])* pub(crate) enum $name:ident: $repr:ident {
        $($(#[$doc:meta])* $variant:ident = $value:literal,)+
    }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr($repr)]
        pub(crate) enum $name {
            $($(#[$doc])* $variant = $value,)+
        }

        impl $name {
            /// All variants, in the order of the definition.
            pub(crate) const ALL: [$name; [$($value),+].len()] = [$($name::$variant),+];

            /// The variant whose wire value is `value`.
            pub(crate) fn from_wire(value: $repr) -> Option<Self> {
                Self::ALL.into_iter().find(|&one| one as $repr == value)
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                $crate::protocol::wire_enum::as_words(self, f)
            }
        }
    };
}

pub(super) use wire_enum;

/// Writes the name of a variant as words for a person: `ForceLimit` as "force limit".
pub(crate) fn as_words(variant: &impl fmt::Debug, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    for (i, letter) in format!("{variant:?}").chars().enumerate() {
        if i > 0 && letter.is_uppercase() {
            f.write_char(' ')?;
        }
        write!(f, "{}", letter.to_lowercase())?;
    }
    Ok(())
}
