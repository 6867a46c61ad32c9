//! Conversion of a TOML document to the values of a cell. Every element is used, or refused with its key and line.
//!
//! The arrays of serde silently ignore surplus elements. This module refuses them, and also a table with two variants
//! of an enumeration. All messages name the permitted values in the words of TOML.

use std::fmt;

use serde::Deserialize;
use serde::de::value::StrDeserializer;
use serde::de::{
    DeserializeSeed, Deserializer, EnumAccess, Error, IntoDeserializer, MapAccess, SeqAccess,
    VariantAccess, Visitor,
};
use serde::forward_to_deserialize_any;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::Range;
use super::error::{CellError, Problem};
use super::locate::line_at;
use super::text::{excerpt, one_of, quoted};

/// Range of all numbers of a cell. No SI quantity of a robot is beyond it, and squares and products stay finite.
const MOST: Range = Range::new(-1e12, 1e12, "");

/// Reads a value from a document that was parsed from `text`.
pub(super) fn read<'de, T: Deserialize<'de>>(
    text: &str,
    document: &'de DeTable<'de>,
) -> Result<T, CellError> {
    let table = Table {
        table: document,
        offset: 0,
    };
    T::deserialize(table).map_err(|refusal| CellError {
        line: line_at(text, refusal.offset.unwrap_or(0)),
        key: refusal.key(),
        problem: refusal.problem,
    })
}

/// A problem and its location.
#[derive(Debug)]
struct ValueError {
    /// The key, its last step first.
    steps: Vec<Step>,
    /// Offset in the text.
    offset: Option<usize>,
    problem: Problem,
}

#[derive(Debug)]
enum Step {
    Key(String),
    At(usize),
}

impl ValueError {
    fn new(problem: Problem) -> Self {
        Self {
            steps: Vec::new(),
            offset: None,
            problem,
        }
    }

    fn shape(problem: String) -> Self {
        Self::new(Problem::Shape(problem))
    }

    /// The refusal at this offset, unless it has an offset already.
    fn from(mut self, offset: usize) -> Self {
        self.offset.get_or_insert(offset);
        self
    }

    /// The refusal one step deeper.
    fn below(mut self, step: Step) -> Self {
        self.steps.push(step);
        self
    }

    fn key(&self) -> String {
        let mut key = String::new();
        for step in self.steps.iter().rev() {
            match step {
                Step::At(index) => key += &format!("[{index}]"),
                Step::Key(name) => {
                    key += if key.is_empty() { "" } else { "." };
                    let bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
                    let is_bare = !name.is_empty() && name.chars().all(bare);
                    key += &if is_bare { excerpt(name) } else { quoted(name) };
                }
            }
        }
        key
    }
}

impl fmt::Display for ValueError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.problem.fmt(f)
    }
}

impl std::error::Error for ValueError {}

impl Error for ValueError {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self::shape(message.to_string())
    }

    fn unknown_field(field: &str, expected: &'static [&'static str]) -> Self {
        let expected = one_of(expected);
        Self::shape(format!("is an unknown key, must be {expected}"))
            .below(Step::Key(field.to_owned()))
    }

    fn missing_field(field: &'static str) -> Self {
        Self::new(Problem::Missing).below(Step::Key(field.to_owned()))
    }
}

/// A table at an offset.
#[derive(Clone, Copy)]
struct Table<'de> {
    table: &'de DeTable<'de>,
    offset: usize,
}

impl<'de> Deserializer<'de> for Table<'de> {
    type Error = ValueError;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueError> {
        let entries = Entries {
            left: self.table.iter(),
            value: None,
            offset: self.offset,
        };
        visitor
            .visit_map(entries)
            .map_err(|error| error.from(self.offset))
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map struct enum identifier ignored_any
    }
}

/// The entries of a table.
struct Entries<'de, I> {
    left: I,
    /// The value of the last key.
    value: Option<(&'de str, &'de Spanned<DeValue<'de>>)>,
    offset: usize,
}

impl<'de, I> MapAccess<'de> for Entries<'de, I>
where
    I: Iterator<
        Item = (
            &'de Spanned<std::borrow::Cow<'de, str>>,
            &'de Spanned<DeValue<'de>>,
        ),
    >,
{
    type Error = ValueError;

    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, ValueError> {
        let Some((key, value)) = self.left.next() else {
            return Ok(None);
        };
        self.value = Some((key.get_ref(), value));
        let name: StrDeserializer<'_, ValueError> = key.get_ref().as_ref().into_deserializer();
        seed.deserialize(name)
            .map(Some)
            .map_err(|error| error.from(key.span().start))
    }

    fn next_value_seed<S: DeserializeSeed<'de>>(
        &mut self,
        seed: S,
    ) -> Result<S::Value, ValueError> {
        let (key, value) = self
            .value
            .take()
            .expect("serde asks for a key before its value");
        let value = Value::of(value, self.offset);
        seed.deserialize(value)
            .map_err(|error| error.from(value.offset).below(Step::Key(key.to_owned())))
    }
}

/// A value at an offset.
#[derive(Clone, Copy)]
struct Value<'de> {
    value: &'de DeValue<'de>,
    offset: usize,
}

impl<'de> Value<'de> {
    /// A table of dotted keys alone has no offset in the text, and gets the offset of the enclosing table.
    fn of(value: &'de Spanned<DeValue<'de>>, around: usize) -> Self {
        let span = value.span();
        Self {
            value: value.get_ref(),
            offset: if span.is_empty() { around } else { span.start },
        }
    }

    /// The refusal of a value that differs from `expected`.
    fn wrong(&self, expected: impl fmt::Display) -> ValueError {
        let found = match self.value {
            DeValue::String(text) => quoted(text),
            DeValue::Integer(number) => excerpt(&number.to_string()),
            DeValue::Float(number) => excerpt(number.as_str()),
            DeValue::Boolean(truth) => truth.to_string(),
            DeValue::Datetime(_) => "a date or time".into(),
            DeValue::Array(_) => "an array".into(),
            DeValue::Table(_) => "a table".into(),
        };
        ValueError::shape(format!("is {found}, must be {expected}")).from(self.offset)
    }

    fn integer(&self, low: i128, high: i128) -> Result<i128, ValueError> {
        let number = match self.value {
            DeValue::Integer(number) => i128::from_str_radix(number.as_str(), number.radix()).ok(),
            _ => None,
        };
        number
            .filter(|number| (low..=high).contains(number))
            .ok_or_else(|| {
                self.wrong(if high > i128::from(u32::MAX) {
                    format!("a whole number of at least {low}")
                } else {
                    format!("a whole number from {low} to {high}")
                })
            })
    }

    fn number(&self) -> Result<f64, ValueError> {
        let number = match self.value {
            DeValue::Float(number) => number.as_str().parse().ok(),
            DeValue::Integer(number) if number.radix() == 10 => number.as_str().parse().ok(),
            DeValue::Integer(number) => {
                let number = i128::from_str_radix(number.as_str(), number.radix());
                number.ok().map(|number| number as f64)
            }
            _ => None,
        };
        match number {
            Some(value) if MOST.has(value) => Ok(value),
            Some(value) if f64::is_finite(value) => {
                let range = MOST;
                Err(ValueError::new(Problem::OutOfRange { value, range }).from(self.offset))
            }
            Some(_) => Err(ValueError::new(Problem::NotFinite).from(self.offset)),
            None => Err(self.wrong("a number")),
        }
    }

    fn text(&self) -> Result<&'de str, ValueError> {
        match self.value {
            DeValue::String(text) => Ok(text),
            _ => Err(self.wrong("a string in quotes")),
        }
    }

    fn table(&self) -> Result<Table<'de>, ValueError> {
        match self.value {
            DeValue::Table(table) => Ok(Table {
                table,
                offset: self.offset,
            }),
            _ => Err(self.wrong("a table")),
        }
    }

    /// Passes an array to `visitor`, which must take all elements.
    fn array<V: Visitor<'de>>(
        &self,
        length: Option<usize>,
        visitor: V,
    ) -> Result<V::Value, ValueError> {
        let DeValue::Array(array) = self.value else {
            return Err(match length {
                Some(length) => self.wrong(format!("an array of {length} elements")),
                None => self.wrong("an array"),
            });
        };
        let count = |expected| {
            let (found, what) = (array.len(), "elements");
            ValueError::new(Problem::Count {
                found,
                expected,
                what,
            })
            .from(self.offset)
        };
        if let Some(expected) = length.filter(|length| *length != array.len()) {
            return Err(count(expected));
        }
        let mut elements = Elements {
            array,
            next: 0,
            offset: self.offset,
        };
        let value = visitor.visit_seq(&mut elements)?;
        if elements.next < array.len() {
            return Err(count(elements.next));
        }
        Ok(value)
    }
}

macro_rules! integers {
    ($($method:ident $visit:ident $type:ty),* $(,)?) => {$(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueError> {
            let (low, high) = (i128::from(<$type>::MIN), i128::from(<$type>::MAX));
            visitor.$visit(self.integer(low, high)? as $type)
        }
    )*};
}

impl<'de> Deserializer<'de> for Value<'de> {
    type Error = ValueError;

    integers! {
        deserialize_u8 visit_u8 u8, deserialize_u16 visit_u16 u16, deserialize_u32 visit_u32 u32,
        deserialize_u64 visit_u64 u64, deserialize_i8 visit_i8 i8, deserialize_i16 visit_i16 i16,
        deserialize_i32 visit_i32 i32, deserialize_i64 visit_i64 i64,
    }

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueError> {
        match self.value {
            DeValue::String(text) => visitor.visit_borrowed_str(text),
            DeValue::Integer(_) => self.deserialize_i64(visitor),
            DeValue::Float(_) => self.deserialize_f64(visitor),
            DeValue::Boolean(truth) => visitor.visit_bool(*truth),
            DeValue::Datetime(_) => Err(self.wrong("no date or time")),
            DeValue::Array(_) => self.array(None, visitor),
            DeValue::Table(_) => self.table()?.deserialize_any(visitor),
        }
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueError> {
        match self.value {
            DeValue::Boolean(truth) => visitor.visit_bool(*truth),
            _ => Err(self.wrong("true or false")),
        }
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueError> {
        visitor.visit_f64(self.number()?)
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueError> {
        visitor.visit_borrowed_str(self.text()?)
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueError> {
        self.deserialize_str(visitor)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueError> {
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        visitor: V,
    ) -> Result<V::Value, ValueError> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueError> {
        self.array(None, visitor)
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, ValueError> {
        self.array(Some(length), visitor)
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueError> {
        self.table()?.deserialize_any(visitor)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        _fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, ValueError> {
        self.table()?.deserialize_any(visitor)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, ValueError> {
        match self.value {
            DeValue::String(text) if variants.contains(&text.as_ref()) => {
                let chosen = Variant {
                    name: text,
                    whole: self,
                    content: None,
                };
                visitor.visit_enum(chosen)
            }
            DeValue::Table(table) => {
                let mut entries = table.iter();
                let (Some((key, content)), None) = (entries.next(), entries.next()) else {
                    let found = table.len();
                    let problem = format!("has {found} keys, must have one: {}", one_of(variants));
                    return Err(ValueError::shape(problem).from(self.offset));
                };
                let name = key.get_ref().as_ref();
                if !variants.contains(&name) {
                    let unknown = <ValueError as Error>::unknown_field(name, variants);
                    return Err(unknown.from(key.span().start));
                }
                let chosen = Variant {
                    name,
                    whole: self,
                    content: Some(Self::of(content, self.offset)),
                };
                let visited = visitor.visit_enum(chosen);
                visited.map_err(|error| error.below(Step::Key(name.to_owned())))
            }
            _ => Err(self.wrong(one_of(variants))),
        }
    }

    forward_to_deserialize_any! {
        i128 u128 f32 char bytes byte_buf unit unit_struct tuple_struct identifier ignored_any
    }
}

/// The elements of an array.
struct Elements<'de> {
    array: &'de [Spanned<DeValue<'de>>],
    next: usize,
    offset: usize,
}

impl<'de> SeqAccess<'de> for &mut Elements<'de> {
    type Error = ValueError;

    fn next_element_seed<S: DeserializeSeed<'de>>(
        &mut self,
        seed: S,
    ) -> Result<Option<S::Value>, ValueError> {
        let Some(value) = self.array.get(self.next) else {
            return Ok(None);
        };
        let index = self.next;
        self.next += 1;
        let value = Value::of(value, self.offset);
        let element = seed.deserialize(value).map(Some);
        element.map_err(|error| error.from(value.offset).below(Step::At(index)))
    }
}

/// A variant of an enumeration: its name, or a table with its name and content.
struct Variant<'de> {
    name: &'de str,
    whole: Value<'de>,
    content: Option<Value<'de>>,
}

impl<'de> EnumAccess<'de> for Variant<'de> {
    type Error = ValueError;
    type Variant = Self;

    fn variant_seed<S: DeserializeSeed<'de>>(
        self,
        seed: S,
    ) -> Result<(S::Value, Self), ValueError> {
        let name: StrDeserializer<'_, ValueError> = self.name.into_deserializer();
        Ok((seed.deserialize(name)?, self))
    }
}

impl<'de> VariantAccess<'de> for Variant<'de> {
    type Error = ValueError;

    fn unit_variant(self) -> Result<(), ValueError> {
        match self.content {
            None => Ok(()),
            Some(_) => Err(self.whole.wrong(format!("the string {:?}", self.name))),
        }
    }

    fn newtype_variant_seed<S: DeserializeSeed<'de>>(
        self,
        seed: S,
    ) -> Result<S::Value, ValueError> {
        match self.content {
            Some(content) => seed
                .deserialize(content)
                .map_err(|error| error.from(content.offset)),
            None => Err(self
                .whole
                .wrong(format!("a table with the key {}", self.name))),
        }
    }

    fn tuple_variant<V: Visitor<'de>>(
        self,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, ValueError> {
        match self.content {
            Some(content) => content.array(Some(length), visitor),
            None => Err(self
                .whole
                .wrong(format!("a table with the key {}", self.name))),
        }
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        _fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, ValueError> {
        match self.content {
            Some(content) => content.table()?.deserialize_any(visitor),
            None => Err(self
                .whole
                .wrong(format!("a table with the key {}", self.name))),
        }
    }
}
