//! What stands inside a value, as `serde` asks for it.

use std::slice;

use serde::{
    Deserializer,
    de::{
        DeserializeSeed, EnumAccess, MapAccess, SeqAccess, VariantAccess, Visitor,
        value::BorrowedStrDeserializer,
    },
};

use super::{Entry, Fault, Node, read::Value};

/// The entries of a structure or a map.
pub(super) struct Entries<'de, 'tree> {
    text: &'de str,
    entries: &'tree [Entry],
    next: usize,
    /// Their keys are names of fields.
    are_fields: bool,
}

impl<'de, 'tree> Entries<'de, 'tree> {
    pub fn new(text: &'de str, entries: &'tree [Entry], are_fields: bool) -> Self {
        Self { text, entries, next: 0, are_fields }
    }

    /// Whether nothing was asked for.
    pub fn are_untouched(&self) -> bool {
        self.next == 0
    }
}

impl<'de> MapAccess<'de> for &mut Entries<'de, '_> {
    type Error = Fault;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, Fault> {
        let Some(Entry { key_node, .. }) = self.entries.get(self.next) else { return Ok(None) };
        self.next += 1;
        let key = Value::new(self.text, key_node);
        let read = if self.are_fields {
            seed.deserialize(BorrowedStrDeserializer::new(key.name()))
        } else {
            seed.deserialize(key)
        };
        read.map(Some).map_err(|fault: Fault| fault.or_at(key.start()))
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, Fault> {
        let entry = self.next.checked_sub(1).and_then(|last| self.entries.get(last));
        let entry = entry.expect("serde asks for a value behind its key");
        seed.deserialize(Value::new(self.text, &entry.value))
            .map_err(|fault| fault.or_at(entry.value.span.start))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.entries.len() - self.next)
    }
}

/// The elements of a list or a tuple.
pub(super) struct Items<'de, 'tree> {
    text: &'de str,
    rest: slice::Iter<'tree, Node>,
}

impl<'de, 'tree> Items<'de, 'tree> {
    pub fn new(text: &'de str, items: &'tree [Node]) -> Self {
        Self { text, rest: items.iter() }
    }

    /// Those that nobody asked for.
    pub fn rest(self) -> &'tree [Node] {
        self.rest.as_slice()
    }
}

impl<'de> SeqAccess<'de> for &mut Items<'de, '_> {
    type Error = Fault;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>, Fault> {
        let Some(item) = self.rest.next() else { return Ok(None) };
        let read = seed.deserialize(Value::new(self.text, item));
        read.map(Some).map_err(|fault| fault.or_at(item.span.start))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.rest.len())
    }
}

/// A variant of an enumeration, with what it holds.
pub(super) struct Variant<'de, 'tree>(pub Value<'de, 'tree>);

impl<'de, 'tree> Variant<'de, 'tree> {
    /// The value behind the name.
    fn value(&self) -> Result<Value<'de, 'tree>, Fault> {
        let name = self.0.name();
        if self.0.node.is_leaf() {
            return Err(self.0.fault(format!("`{name}` needs a value in brackets: `{name}(…)`")));
        }
        Ok(self.0.content())
    }

    /// All values behind the name.
    fn values(&self) -> Result<Value<'de, 'tree>, Fault> {
        self.value().map(|_| self.0.behind_name())
    }
}

impl<'de, 'tree> EnumAccess<'de> for Variant<'de, 'tree> {
    type Error = Fault;
    type Variant = Self;

    fn variant_seed<V: DeserializeSeed<'de>>(self, seed: V) -> Result<(V::Value, Self), Fault> {
        let variant = seed.deserialize(BorrowedStrDeserializer::new(self.0.name()));
        Ok((variant.map_err(|fault: Fault| fault.or_at(self.0.start()))?, self))
    }
}

impl<'de> VariantAccess<'de> for Variant<'de, '_> {
    type Error = Fault;

    fn unit_variant(self) -> Result<(), Fault> {
        match self.0.node.is_leaf() {
            true => Ok(()),
            false => Err(self.0.fault(format!("`{}` stands alone, without brackets", self.0.name()))),
        }
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value, Fault> {
        let value = self.value()?;
        seed.deserialize(value).map_err(|fault| fault.or_at(value.start()))
    }

    fn tuple_variant<V: Visitor<'de>>(self, length: usize, visitor: V) -> Result<V::Value, Fault> {
        self.values()?.tuple(length, visitor)
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Fault> {
        self.value()?.deserialize_struct("", fields, visitor)
    }
}

/// A value with a name, as a map of one entry.
pub(super) struct Named<'de, 'tree> {
    value: Value<'de, 'tree>,
    is_key_read: bool,
}

impl<'de, 'tree> Named<'de, 'tree> {
    pub fn new(value: Value<'de, 'tree>) -> Self {
        Self { value, is_key_read: false }
    }
}

impl<'de> MapAccess<'de> for Named<'de, '_> {
    type Error = Fault;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, Fault> {
        if std::mem::replace(&mut self.is_key_read, true) {
            return Ok(None);
        }
        seed.deserialize(BorrowedStrDeserializer::new(self.value.name())).map(Some)
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, Fault> {
        seed.deserialize(self.value.content())
    }
}
