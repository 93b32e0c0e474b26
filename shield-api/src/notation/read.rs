//! From the tree to values, through `serde`.

use serde::de::{Deserializer, Visitor};

use super::{
    Entry, Fault, Kind, Node, RAW_VALUE,
    access::{Entries, Items, Named, Variant},
    fault::{one_of, shown, values},
};

/// A value that can be read.
#[derive(Clone, Copy)]
pub(super) struct Value<'de, 'tree> {
    pub text: &'de str,
    pub node: &'tree Node,
    /// The value is what stands behind the name: `(field: 1)` of `Some(field: 1)`.
    is_behind_name: bool,
}

impl<'de, 'tree> Value<'de, 'tree> {
    pub fn new(text: &'de str, node: &'tree Node) -> Self {
        Self { text, node, is_behind_name: false }
    }

    pub fn start(self) -> usize {
        self.node.span.start
    }

    /// The value as it is written.
    fn source(self) -> &'de str {
        let name = if self.is_behind_name { self.node.open_len - 1 } else { 0 };
        &self.text[self.start() + name..self.node.span.end]
    }

    /// The name before its bracket, or the bare name that it is; empty if it has none.
    pub fn name(self) -> &'de str {
        if self.is_behind_name { "" } else { self.node.name(self.text) }
    }

    fn is_bare(self, name: &str) -> bool {
        self.node.is_leaf() && self.node.name_len > 0 && self.name() == name
    }

    /// What stands inside the brackets of `Some(…)` or of a variant around one value, in both forms of a structure or tuple.
    pub fn content(self) -> Self {
        match &self.node.kind {
            Kind::Tuple(items) if items.len() == 1 => Self::new(self.text, &items[0]),
            _ => self.behind_name(),
        }
    }

    /// The brackets without the name before them.
    pub fn behind_name(self) -> Self {
        Self { is_behind_name: true, ..self }
    }

    pub fn fault(self, message: impl Into<String>) -> Fault {
        Fault::new(self.start(), message)
    }

    /// The fault that something else should stand here.
    pub fn unlike(self, wanted: &str) -> Fault {
        self.fault(format!("expected {wanted}, found {}", self.words()))
    }

    fn words(self) -> String {
        let what = match &self.node.kind {
            Kind::Leaf => return shown(self.source()),
            _ if !self.name().is_empty() => return format!("`{}(…)`", shown(self.name())),
            Kind::Tuple(items) if items.is_empty() => "`()`",
            Kind::Tuple(_) => "a tuple `(…)`",
            Kind::Struct(_) => "fields `(…)`",
            Kind::Map(_) => "a map `{…}`",
            Kind::List(_) => "a list `[…]`",
        };
        what.into()
    }

    fn placed<T>(self, result: Result<T, Fault>) -> Result<T, Fault> {
        result.map_err(|fault| fault.or_at(self.start()))
    }

    /// Reads a leaf with the `ron` crate.
    fn leaf<T>(
        self,
        wanted: &str,
        read: impl FnOnce(&mut ron::Deserializer<'de>) -> Result<T, ron::Error>,
    ) -> Result<T, Fault> {
        if !self.node.is_leaf() {
            return Err(self.unlike(wanted));
        }
        let mut leaf = ron::Deserializer::from_str(self.source()).map_err(|_| self.unlike(wanted))?;
        let read = read(&mut leaf).and_then(|value| leaf.end().map(|()| value));
        read.map_err(|error| match error {
            // What the receiving type says.
            ron::Error::Message(message) => self.fault(message),
            ron::Error::InvalidValueForType { expected, .. } => self.unlike(&expected),
            _ => self.unlike(wanted),
        })
    }

    /// The fields of a structure without its name.
    pub fn fields<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match &self.node.kind {
            Kind::Struct(entries) => self.entries(entries, true, visitor),
            Kind::Tuple(items) if items.is_empty() => self.entries(&[], true, visitor),
            _ => Err(self.unlike("fields in brackets, as in `(name: value)`")),
        }
    }

    /// The values of a tuple without its name.
    pub fn tuple<V: Visitor<'de>>(self, length: usize, visitor: V) -> Result<V::Value, Fault> {
        match &self.node.kind {
            Kind::Tuple(items) => self.items(items, visitor),
            _ => Err(self.unlike(&format!("{} in brackets `(…)`", values(length)))),
        }
    }

    fn items<V: Visitor<'de>>(self, items: &'tree [Node], visitor: V) -> Result<V::Value, Fault> {
        let mut access = Items::new(self.text, items);
        let value = self.placed(visitor.visit_seq(&mut access))?;
        let rest = access.rest();
        let Some(extra) = rest.first() else { return Ok(value) };
        let (taken, found) = (items.len() - rest.len(), items.len());
        Err(Self::new(self.text, extra).fault(format!("expected {}, found {found}", values(taken))))
    }

    fn entries<V: Visitor<'de>>(
        self,
        entries: &'tree [Entry],
        are_fields: bool,
        visitor: V,
    ) -> Result<V::Value, Fault> {
        self.placed(visitor.visit_map(&mut Entries::new(self.text, entries, are_fields)))
    }

    fn map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match &self.node.kind {
            Kind::Map(entries) => self.entries(entries, false, visitor),
            _ => self.fields(visitor),
        }
    }

    /// Refuses another name before the bracket than the type's own.
    fn check_name(self, name: &'static str) -> Result<(), Fault> {
        let found = self.name();
        if found.is_empty() || found == name {
            return Ok(());
        }
        let fault = self.fault(format!("expected `{name}(…)`, found `{}`", shown(found)));
        Err(fault.with_remedy(super::did_you_mean(found, [name])))
    }

    fn visit_name<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        self.placed(visitor.visit_borrowed_str(self.name()))
    }
}

macro_rules! leaves {
    ($($method:ident: $wanted:expr),* $(,)?) => { $(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
            self.leaf($wanted, |leaf| leaf.$method(visitor))
        }
    )* };
}

impl<'de> Deserializer<'de> for Value<'de, '_> {
    type Error = Fault;

    leaves! {
        deserialize_bool: "true or false",
        deserialize_i8: "a whole number from -128 to 127",
        deserialize_i16: "a whole number from -32768 to 32767",
        deserialize_i32: "a whole number from -2147483648 to 2147483647",
        deserialize_i64: "a whole number",
        deserialize_u8: "a whole number from 0 to 255",
        deserialize_u16: "a whole number from 0 to 65535",
        deserialize_u32: "a whole number from 0 to 4294967295",
        deserialize_u64: "a whole number of at least 0",
        deserialize_f32: "a number",
        deserialize_f64: "a number",
        deserialize_char: "a character, as in `'a'`",
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        let read = self.leaf("a text", |leaf| leaf.deserialize_str(visitor));
        let is_bare = self.node.is_leaf() && !self.source().contains('"');
        read.map_err(|fault| if is_bare { fault.with_remedy(Some("a text needs quotes")) } else { fault })
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        self.deserialize_str(visitor)
    }

    fn deserialize_bytes<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        self.deserialize_byte_buf(visitor)
    }

    fn deserialize_byte_buf<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match &self.node.kind {
            Kind::List(items) => self.items(items, visitor),
            _ => self.leaf("bytes, as in `b\"…\"`", |leaf| leaf.deserialize_byte_buf(visitor)),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        if self.is_bare("None") {
            return visitor.visit_none();
        }
        if self.is_bare("Some") {
            return Err(self.fault("`Some` needs a value in brackets: `Some(…)`"));
        }
        let is_some = self.node.is_named() && self.name() == "Some";
        self.placed(visitor.visit_some(if is_some { self.content() } else { self }))
    }

    fn deserialize_unit<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match &self.node.kind {
            Kind::Tuple(items) if items.is_empty() && self.name().is_empty() => visitor.visit_unit(),
            _ => Err(self.unlike("`()`")),
        }
    }

    fn deserialize_unit_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        visitor: V,
    ) -> Result<V::Value, Fault> {
        match self.is_bare(name) {
            true => visitor.visit_unit(),
            false if name == "RangeFull" => {
                self.leaf("`..`", |leaf| leaf.deserialize_unit_struct(name, visitor))
            }
            false => self.deserialize_unit(visitor),
        }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        visitor: V,
    ) -> Result<V::Value, Fault> {
        if name == RAW_VALUE {
            return self.placed(visitor.visit_borrowed_str(self.source()));
        }
        let wraps_one = self.node.items().len() == 1 && matches!(self.node.kind, Kind::Tuple(_));
        let is_own = self.node.is_named() && self.name() == name;
        let is_wrapper = is_own || self.name().is_empty() && wraps_one;
        self.placed(visitor.visit_newtype_struct(if is_wrapper { self.content() } else { self }))
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match &self.node.kind {
            Kind::List(items) => self.items(items, visitor),
            _ => Err(self.unlike("a list `[…]`")),
        }
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, length: usize, visitor: V) -> Result<V::Value, Fault> {
        self.check_name("")?;
        self.tuple(length, visitor)
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, Fault> {
        self.check_name(name)?;
        self.tuple(length, visitor)
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match &self.node.kind {
            // A structure with flattened fields asks for a map, too.
            Kind::Map(_) | Kind::Struct(_) => self.map(visitor),
            _ => Err(self.unlike("a map `{…}`")),
        }
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Fault> {
        if self.node.is_leaf() && name.starts_with("Range") {
            return self.leaf("a range, as in `0..5`", |leaf| leaf.deserialize_struct(name, fields, visitor));
        }
        if !self.node.is_leaf() {
            self.check_name(name)?;
        }
        self.fields(visitor)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Fault> {
        if !self.name().is_empty() {
            return self.placed(visitor.visit_enum(Variant(self)));
        }
        let wanted = one_of(variants.iter().copied());
        let Kind::Struct(entries) = &self.node.kind else {
            let is_quoted = variants.contains(&self.source().trim_matches('"'));
            return Err(self.unlike(&wanted).with_remedy(is_quoted.then_some("leave the quotes out")));
        };
        // A type may be written with and without a name; a visitor that knows no fields asks for none.
        let mut fields = Entries::new(self.text, entries, true);
        let read = visitor.visit_map(&mut fields);
        if read.is_err() && fields.are_untouched() { Err(self.unlike(&wanted)) } else { self.placed(read) }
    }

    fn deserialize_identifier<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        if self.name().is_empty() { self.deserialize_str(visitor) } else { self.visit_name(visitor) }
    }

    /// As a format without names of types has it: a bare name is a text, a named value a map of one entry.
    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match (&self.node.kind, self.name()) {
            (Kind::Leaf, "Some" | "None") => self.deserialize_option(visitor),
            (
                Kind::Leaf,
                "" | "true" | "false" | "inf" | "inff32" | "inff64" | "NaN" | "NaNf32" | "NaNf64",
            ) => self.leaf("a value", |leaf| leaf.deserialize_any(visitor)),
            (Kind::Leaf, _) => self.visit_name(visitor),
            (_, "Some") => self.deserialize_option(visitor),
            (Kind::Struct(_) | Kind::Map(_), "") => self.map(visitor),
            (Kind::Tuple(items), "") if items.is_empty() => visitor.visit_unit(),
            (Kind::List(items) | Kind::Tuple(items), "") => self.items(items, visitor),
            _ => self.placed(visitor.visit_map(Named::new(self))),
        }
    }

    fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        visitor.visit_unit()
    }
}
