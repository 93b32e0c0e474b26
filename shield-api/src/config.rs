//! A plugin's own configuration: declared once, parsed strictly, listed in the manifest.

use serde::de::DeserializeOwned;

use crate::{Error, Result, notation};

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
        notation::from_str(text).map_err(|fault| {
            let place = fault.position(text);
            Error::invalid_config(fault.to_string()).at(place.line, place.column)
        })
    }
}

impl Error {
    /// The same error with the place of its field in the configuration `text`, if it names one and has no place yet. A field that is not
    /// written has the place of the value around it.
    #[must_use]
    pub(crate) fn located_in(self, text: &str) -> Self {
        let (None, Some(field), Ok(root)) = (self.position(), self.field(), notation::parse(text)) else {
            return self;
        };
        let (node, _) = notation::nearest(&root, field);
        let place = notation::position_at(text, node.span.start);
        self.at(place.line, place.column)
    }
}

/// What the `ron` crate alone can read of the dialect.
#[deprecated(since = "1.1.0", note = "configurations are read by `shield_api::notation`")]
pub fn ron_options() -> ron::Options {
    use ron::extensions::Extensions;
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
    #[serde(deny_unknown_fields)]
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
        let mixed =
            Mixed::parse("(one: Some(low: 1.0), other: Some((low: 2.0)), third: (low: 3.0))").unwrap();
        let lows = [mixed.one, mixed.other, mixed.third].map(|range| range.unwrap().low);
        assert_eq!(lows, [1.0, 2.0, 3.0]);
    }

    config! {
        /// Another's.
        pub struct Mixed {
            one: Option<Range> = None,
            other: Option<Range> = None,
            third: Option<Range> = None,
        }
    }

    #[test]
    fn a_fault_has_its_place_in_every_form() {
        for text in ["(range: Some((low: 1.0)),\n count: x)", "(range: Some(low: 1.0),\n count: x)"] {
            let error = Settings::parse(text).unwrap_err();
            assert_eq!(error.message(), "expected a whole number of at least 0, found x");
            assert_eq!(error.position(), Some(crate::Position { line: 2, column: 9 }), "{text}");
        }
        for text in ["(range: Some((lov: 1.0)))", "(range: Some(lov: 1.0))", "(range: (lov: 1.0))"] {
            let error = Settings::parse(text).unwrap_err();
            assert_eq!(error.message(), "there is no field `lov`, only `low`; did you mean `low`?");
            let column = 1 + text.find("lov").unwrap() as u32;
            assert_eq!(error.position(), Some(crate::Position { line: 1, column }), "{text}");
        }
    }

    #[test]
    fn a_field_is_found_in_the_text_or_the_value_around_it_is() {
        let text = "(\n  range: Some(low: 1.0),\n  count: 2)";
        let place = |field: &str| {
            let located = Error::invalid_config("odd").in_field(field).located_in(text);
            located.position().map(|place| (place.line, place.column))
        };
        assert_eq!(place("range.low"), Some((2, 20)));
        assert_eq!(place("count"), Some((3, 10)));
        assert_eq!(place("range.high"), Some((2, 10)));
        assert_eq!(place("other"), Some((1, 1)));
        assert_eq!(Error::invalid_config("odd").located_in(text).position(), None);
        let placed = Error::invalid_config("odd").in_field("count").at(7, 8).located_in(text);
        assert_eq!(placed.position(), Some(crate::Position { line: 7, column: 8 }));
        assert_eq!(Error::invalid_config("odd").in_field("count").located_in("").position(), None);
    }
}
