//! A plugin's own configuration: declared once, parsed strictly, listed in the manifest.

use ron::extensions::Extensions;
use serde::de::DeserializeOwned;

use crate::{Error, Result};

/// One field of a plugin's configuration, as the manifest lists it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Its name in RON.
    pub name: &'static str,
    /// Its Rust type.
    pub kind: &'static str,
    /// Its default value, as RON text.
    pub default: &'static str,
    /// What it does.
    pub doc: &'static str,
}

/// A configuration that was declared with [`config!`](crate::config!).
pub trait PluginConfig: DeserializeOwned + Default {
    /// The fields, in the order of declaration.
    const FIELDS: &'static [Field];

    /// Parses RON text; unknown fields are refused, missing ones take their defaults.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidConfig`](crate::ErrorKind::InvalidConfig) with the position of the fault.
    fn parse(text: &str) -> Result<Self> {
        // With its extension for `Some(field: 1)`, `ron` refuses `Some((field: 1))`, which is the form that a host can send.
        let long = ron::Options::default().with_default_extension(Extensions::IMPLICIT_SOME).from_str(text);
        let read = long.or_else(|long: ron::error::SpannedError| {
            ron_options().from_str(text).map_err(|short| {
                let got_further = short.span.start > long.span.start;
                if got_further { short } else { long }
            })
        });
        read.map_err(|error| {
            let start = error.span.start;
            Error::invalid_config(error.code.to_string()).at(start.line as u32, start.col as u32)
        })
    }
}

/// How RON is read everywhere: `Some(field: 1)` may stand for `Some((field: 1))`, and `Some(…)` may be left out.
pub fn ron_options() -> ron::Options {
    ron::Options::default()
        .with_default_extension(Extensions::UNWRAP_VARIANT_NEWTYPES | Extensions::IMPLICIT_SOME)
}

/// Declares a plugin's configuration: a struct with documented fields and defaults.
///
/// ```
/// shield_api::config! {
///     /// Settings of a learner.
///     pub struct Settings {
///         /// How many Q-functions (paper, appendix C: 20).
///         critics: usize = 20,
///         /// Sizes of the hidden layers. Where the default's Rust text is not RON, the RON text follows.
///         hidden: Vec<usize> = vec![400, 300] => "[400, 300]",
///     }
/// }
/// use shield_api::PluginConfig;
/// let settings = Settings::parse("(critics: 5)").unwrap();
/// assert_eq!((settings.critics, settings.hidden), (5, vec![400, 300]));
/// assert_eq!(Settings::FIELDS[1].default, "[400, 300]");
/// let error = Settings::parse("(critics: 5, crtics: 5)").unwrap_err();
/// assert!(error.to_string().contains("crtics"));
/// ```
#[macro_export]
macro_rules! config {
    (
        $(#[$attribute:meta])*
        $visibility:vis struct $name:ident {
            $( $(#[doc = $doc:literal])* $field:ident : $kind:ty = $default:expr $(=> $text:literal)? ),* $(,)?
        }
    ) => {
        $(#[$attribute])*
        #[derive(Debug, Clone, $crate::reexports::serde::Deserialize)]
        #[serde(crate = "shield_api::reexports::serde", default, deny_unknown_fields)]
        $visibility struct $name {
            $( $(#[doc = $doc])* pub $field: $kind, )*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $( $field: $default, )* }
            }
        }

        impl $crate::PluginConfig for $name {
            const FIELDS: &'static [$crate::Field] = &[
                $( $crate::Field {
                    name: stringify!($field),
                    kind: stringify!($kind),
                    default: $crate::config!(@text $default $(, $text)?),
                    doc: concat!("" $(, $doc)*),
                }, )*
            ];
        }
    };
    (@text $default:expr, $text:literal) => { $text };
    (@text $default:expr) => { stringify!($default) };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Clone, PartialEq, serde::Deserialize)]
    pub struct Range {
        low: f32,
    }

    config! {
        /// A plugin's.
        pub struct Settings {
            range: Option<Range> = None,
            count: usize = 1,
        }
    }

    #[test]
    fn an_optional_structure_may_be_written_in_every_form() {
        for text in [
            "(range: Some((low: 1.0)))",
            "(range: Some(low: 1.0), count: 2)",
            "(range: (low: 1.0), count: 2)",
        ] {
            let range = Settings::parse(text).unwrap().range;
            assert_eq!(range, Some(Range { low: 1.0 }), "{text}");
        }
    }

    #[test]
    fn an_error_beside_an_optional_structure_keeps_its_place() {
        for text in ["(range: Some((low: 1.0)),\n count: x)", "(range: Some(low: 1.0),\n count: x)"] {
            let position = Settings::parse(text).unwrap_err().position().unwrap();
            assert_eq!(position.line, 2, "{text}");
        }
    }
}
