//! Enumerations with fixed values on the wire.

/// Defines an enumeration whose variants have the given wire values, with `ALL` and `from_wire`.
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
    };
}

pub(super) use wire_enum;
