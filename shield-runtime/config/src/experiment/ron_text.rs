//! RON as it is written.

use std::fmt;

use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{self, Visitor},
};
use shield_api::notation::{Fault, RAW_VALUE, parse};

/// The text of a value, without the comments around it: the configuration of a plugin, which only the plugin understands, and whose
/// positions count from there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RonText(Box<str>);

impl RonText {
    /// The value that `text` holds.
    ///
    /// # Errors
    /// The text is not RON.
    pub fn new(text: impl Into<Box<str>>) -> Result<Self, Fault> {
        let text = text.into();
        let span = parse(&text)?.span;
        Ok(Self(text[span].into()))
    }

    /// The text.
    pub fn get_ron(&self) -> &str {
        &self.0
    }
}

/// `()`, a configuration that leaves everything to its defaults.
impl Default for RonText {
    fn default() -> Self {
        Self("()".into())
    }
}

impl<'de> Deserialize<'de> for RonText {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Written;

        impl Visitor<'_> for Written {
            type Value = RonText;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("a value in RON")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<RonText, E> {
                Ok(RonText(text.into()))
            }
        }

        deserializer.deserialize_newtype_struct(RAW_VALUE, Written)
    }
}

impl Serialize for RonText {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_newtype_struct(RAW_VALUE, &*self.0)
    }
}

#[cfg(test)]
mod tests {
    use shield_api::notation::from_str;

    use super::*;

    #[test]
    fn a_value_is_read_and_written_as_it_stands() {
        let text = "[/* a */ (b: Some(c: 1), // d\n e: Name), 5 /* f */, \"g\"]";
        let read: Vec<RonText> = from_str(text).unwrap();
        let texts: Vec<&str> = read.iter().map(RonText::get_ron).collect();
        assert_eq!(texts, ["(b: Some(c: 1), // d\n e: Name)", "5", "\"g\""]);
        assert_eq!(ron::to_string(&read).unwrap(), "[(b: Some(c: 1), // d\n e: Name),5,\"g\"]");
        assert_eq!(RonText::new(" (a: 1) // b").unwrap().get_ron(), "(a: 1)");
        assert!(RonText::new("(a: 1").is_err());
    }
}
