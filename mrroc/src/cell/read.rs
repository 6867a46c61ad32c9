//! Conversion of the TOML text of a cell file to the values of a cell. The size is checked before parsing. Every element
//! is used, or refused with its key and line.
//!
//! The arrays of serde silently ignore surplus elements. This module refuses them, and also a table with two variants
//! of an enumeration. All messages name the permitted values in the words of TOML.

use std::fmt::Display;

use serde::Deserialize;
use serde::de::value::StrDeserializer;
use serde::de::{
    self, DeserializeOwned, DeserializeSeed, Deserializer, EnumAccess, IntoDeserializer, MapAccess, SeqAccess,
    VariantAccess, Visitor,
};
use serde::forward_to_deserialize_any;
use thiserror::Error;
use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};
use toml::map::Iter;

use super::error::{CellError, Path, Step, line_at};
use super::text::{excerpt, one_of, quoted};
use super::{Cell, Range, out_of_range};
use can::counted;

/// Greatest size of a cell file, bytes. The largest example has 26 kB.
pub const LARGEST: usize = 1 << 20;

/// Greatest number of characters in a cell file that make elements: `.`, `,`, `=`, `[` and `{`. Each may create a
/// table, which takes a kilobyte of memory. A taught pose of six joints has thirteen such characters.
const MOST_ELEMENTS: usize = 1 << 16;

/// Range of all numbers of a cell. No SI quantity of a robot is beyond it, and squares and products stay finite.
const MOST: Range = Range::new(-1e12, 1e12, "");

/// The table with the parameters of the task.
const TASK: &str = "task";

pub(super) fn parse(text: &str) -> Result<DeValue<'_>, CellError> {
    Cell::text(text.as_bytes())?;
    let elements = |byte: &u8| matches!(byte, b'.' | b',' | b'=' | b'[' | b'{');
    if let Some((offset, _)) = text.bytes().enumerate().filter(|(_, byte)| elements(byte)).nth(MOST_ELEMENTS) {
        let problem =
            format!("the file has too many elements: it may have {MOST_ELEMENTS} of the characters . , = [ and {{");
        return Err(CellError::of_text(line_at(text.as_bytes(), offset), problem));
    }
    let document = DeTable::parse(text).map_err(|error| {
        let span = error.span().unwrap_or_default();
        let message = error.message().lines().collect::<Vec<_>>().join(", ");
        let found = text.get(span.clone()).unwrap_or_default();
        let (key, problem) = match message.as_str() {
            "duplicate key" => (excerpt(found), "is given twice".to_owned()),
            _ => (String::new(), excerpt(&message)),
        };
        let line = line_at(text.as_bytes(), span.start);
        CellError { line, key, problem }
    })?;
    Ok(DeValue::Table(document.into_inner()))
}

pub(super) fn read<'de, T: Deserialize<'de>>(text: &str, document: &'de DeValue<'de>) -> Result<T, CellError> {
    let whole = Value { value: document, offset: 0 };
    T::deserialize(whole).map_err(|refusal| refusal.of(text))
}

/// Reads a whole text.
pub(crate) fn from_text<T: DeserializeOwned>(text: &str) -> Result<T, CellError> {
    let document = parse(text)?;
    read(text, &document)
}

/// Reads the element at `path`, which the document has.
pub(crate) fn element<T: DeserializeOwned>(text: &str, document: &DeValue<'_>, path: &Path) -> Result<T, CellError> {
    let (value, refused) = at(document, path);
    T::deserialize(value).map_err(|refusal| refused(refusal).of(text))
}

/// The element at `path`, and its place in a refusal. The document must have the element.
fn at<'de>(document: &'de DeValue<'de>, path: &'de Path) -> (Value<'de>, impl Fn(ValueError) -> ValueError + use<'de>) {
    let mut value = Value { value: document, offset: 0 };
    for step in &path.0 {
        let inner = match step {
            Step::Key(key) => value.value.get(&**key),
            Step::At(index) => value.value.get(*index),
        };
        value = Value::of(inner.expect("the path leads to an element"), value.offset);
    }
    let offset = value.offset;
    let refused = move |refusal: ValueError| path.0.iter().rev().cloned().fold(refusal.from(offset), ValueError::below);
    (value, refused)
}

/// Reads the entries with `wanted` keys of the table at `path`. The document must have the table.
pub(crate) fn entries<T: DeserializeOwned>(
    text: &str,
    document: &DeValue<'_>,
    path: &Path,
    wanted: impl Fn(&str) -> bool,
) -> Result<T, CellError> {
    let (value, refused) = at(document, path);
    let table = value.value.as_table().cloned().unwrap_or_default();
    let table = DeValue::Table(table.into_iter().filter(|(key, _)| wanted(key.get_ref())).collect());
    let read = T::deserialize(Value { value: &table, offset: value.offset });
    read.map_err(|refusal| refused(refusal).of(text))
}

/// Tables in the table `task` that belong to tasks of the command.
const NAMED: [&str; 2] = ["teach", "replay"];

/// Reads the first of the tables `task.NAME` that the document has, for `names` in their order. Without any, reads the
/// table `task`, empty where absent, without the tables that belong to tasks of the command.
pub(super) fn parameters<T: DeserializeOwned>(text: &str, names: &[&str]) -> Result<T, CellError> {
    let mut document = parse(text)?;
    for name in names {
        let Some(table) = document.get(TASK).and_then(|task| task.get_ref().get(*name)) else {
            continue;
        };
        let value = Value::of(table, 0);
        let refused = |refusal: ValueError| refusal.from(value.offset).below(step(name)).below(step(TASK)).of(text);
        return T::deserialize(value).map_err(refused);
    }
    if let DeValue::Table(cell) = &mut document
        && let Some(task) = cell.get_mut(TASK)
        && let DeValue::Table(task) = task.get_mut()
    {
        NAMED.iter().for_each(|name| drop(task.remove(*name)));
    }
    let empty = DeValue::Table(DeTable::new());
    let value = match document.get(TASK) {
        Some(table) => Value::of(table, 0),
        None => Value { value: &empty, offset: 0 },
    };
    let read = T::deserialize(value).map_err(|refusal| refusal.from(value.offset).below(step(TASK)));
    read.map_err(|refusal| {
        let mut error = refusal.of(text);
        if let [name, ..] = names {
            error.problem += &format!("; or give the table {TASK}.{name}");
        }
        error
    })
}

#[derive(Debug, Error)]
#[error("{problem}")]
struct ValueError {
    /// The key, its last step first.
    steps: Vec<Step>,
    /// Offset in the text.
    offset: Option<usize>,
    problem: String,
}

impl ValueError {
    fn new(problem: impl Into<String>) -> Self {
        Self { steps: Vec::new(), offset: None, problem: problem.into() }
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

    /// The error of a file with this text.
    fn of(self, text: &str) -> CellError {
        CellError {
            line: line_at(text.as_bytes(), self.offset.unwrap_or(0)),
            key: Path(self.steps.into_iter().rev().collect()).to_string(),
            problem: self.problem,
        }
    }
}

impl de::Error for ValueError {
    fn custom<T: Display>(message: T) -> Self {
        Self::new(message.to_string())
    }

    fn unknown_field(field: &str, expected: &'static [&'static str]) -> Self {
        Self::new(format!("is an unknown key, must be {}", one_of(expected))).below(step(field))
    }

    fn missing_field(field: &'static str) -> Self {
        Self::new("is missing").below(step(field))
    }
}

fn step(name: &str) -> Step {
    Step::Key(name.to_owned().into())
}

struct Entries<'de> {
    left: Iter<'de, Spanned<DeString<'de>>, Spanned<DeValue<'de>>>,
    /// The value of the last key.
    value: Option<(&'de str, &'de Spanned<DeValue<'de>>)>,
    offset: usize,
}

impl<'de> MapAccess<'de> for Entries<'de> {
    type Error = ValueError;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, ValueError> {
        let Some((key, value)) = self.left.next() else {
            return Ok(None);
        };
        self.value = Some((key.get_ref(), value));
        let name: StrDeserializer<'_, ValueError> = key.get_ref().as_ref().into_deserializer();
        seed.deserialize(name).map(Some).map_err(|error| error.from(key.span().start))
    }

    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<S::Value, ValueError> {
        let (name, value) = self.value.take().expect("serde asks for a key before its value");
        let value = Value::of(value, self.offset);
        seed.deserialize(value).map_err(|error| error.from(value.offset).below(step(name)))
    }
}

#[derive(Clone, Copy)]
struct Value<'de> {
    value: &'de DeValue<'de>,
    offset: usize,
}

impl<'de> Value<'de> {
    /// A table of dotted keys alone has no offset in the text, and gets the offset of the enclosing table.
    fn of(value: &'de Spanned<DeValue<'de>>, around: usize) -> Self {
        let span = value.span();
        Self { value: value.get_ref(), offset: if span.is_empty() { around } else { span.start } }
    }

    /// The refusal of a value that differs from `expected`.
    fn wrong(&self, expected: impl Display) -> ValueError {
        let found = match self.value {
            DeValue::String(text) => quoted(text),
            DeValue::Integer(number) => excerpt(&number.to_string()),
            DeValue::Float(number) => excerpt(number.as_str()),
            DeValue::Boolean(truth) => truth.to_string(),
            DeValue::Datetime(_) => "a date or time".into(),
            DeValue::Array(_) => "an array".into(),
            DeValue::Table(_) => "a table".into(),
        };
        ValueError::new(format!("is {found}, must be {expected}")).from(self.offset)
    }

    fn integer(&self, low: i128, high: i128) -> Result<i128, ValueError> {
        let number = match self.value {
            DeValue::Integer(number) => i128::from_str_radix(number.as_str(), number.radix()).ok(),
            _ => None,
        };
        let number = number.filter(|number| (low..=high).contains(number));
        number.ok_or_else(|| match high > i128::from(u32::MAX) {
            true => self.wrong(format!("a whole number of at least {low}")),
            false => self.wrong(format!("a whole number from {low} to {high}")),
        })
    }

    fn number(&self) -> Result<f64, ValueError> {
        let number = match self.value {
            DeValue::Float(number) => number.as_str().parse().ok(),
            DeValue::Integer(number) if number.radix() == 10 => number.as_str().parse().ok(),
            DeValue::Integer(number) => {
                i128::from_str_radix(number.as_str(), number.radix()).ok().map(|number| number as f64)
            }
            _ => None,
        };
        let problem = match number {
            Some(value) if MOST.has(value) => return Ok(value),
            Some(value) if f64::is_finite(value) => out_of_range(value, MOST),
            Some(_) => "must be a finite number".to_owned(),
            None => return Err(self.wrong("a number")),
        };
        Err(ValueError::new(problem).from(self.offset))
    }

    fn table<V: Visitor<'de>>(&self, visitor: V) -> Result<V::Value, ValueError> {
        let DeValue::Table(table) = self.value else {
            return Err(self.wrong("a table"));
        };
        let entries = Entries { left: table.iter(), value: None, offset: self.offset };
        visitor.visit_map(entries).map_err(|error| error.from(self.offset))
    }

    /// Passes an array to `visitor`, which must take all elements.
    fn array<V: Visitor<'de>>(&self, length: Option<usize>, visitor: V) -> Result<V::Value, ValueError> {
        let DeValue::Array(array) = self.value else {
            let elements = length.map_or(String::new(), |length| format!(" of {}", counted(length, "element")));
            return Err(self.wrong(format!("an array{elements}")));
        };
        let found = counted(array.len(), "element");
        let count = |expected| ValueError::new(format!("has {found}, must have {expected}")).from(self.offset);
        if let Some(expected) = length.filter(|length| *length != array.len()) {
            return Err(count(expected));
        }
        let mut elements = Elements { array, next: 0, offset: self.offset };
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
            DeValue::Table(_) => self.table(visitor),
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
        match self.value {
            DeValue::String(text) => visitor.visit_borrowed_str(text),
            _ => Err(self.wrong("a string in quotes")),
        }
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

    fn deserialize_tuple<V: Visitor<'de>>(self, length: usize, visitor: V) -> Result<V::Value, ValueError> {
        self.array(Some(length), visitor)
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueError> {
        self.table(visitor)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        _fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, ValueError> {
        self.table(visitor)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, ValueError> {
        match self.value {
            DeValue::String(text) if variants.contains(&text.as_ref()) => {
                visitor.visit_enum(Variant { name: text, whole: self, content: None })
            }
            DeValue::Table(table) => {
                let mut entries = table.iter();
                let (Some((key, content)), None) = (entries.next(), entries.next()) else {
                    let problem = format!("has {} keys, must have one: {}", table.len(), one_of(variants));
                    return Err(ValueError::new(problem).from(self.offset));
                };
                let name = key.get_ref().as_ref();
                if !variants.contains(&name) {
                    let unknown = <ValueError as de::Error>::unknown_field(name, variants);
                    return Err(unknown.from(key.span().start));
                }
                let chosen = Variant { name, whole: self, content: Some(Self::of(content, self.offset)) };
                visitor.visit_enum(chosen).map_err(|error| error.below(step(name)))
            }
            _ => Err(self.wrong(one_of(variants))),
        }
    }

    forward_to_deserialize_any! {
        i128 u128 f32 char bytes byte_buf unit unit_struct tuple_struct identifier ignored_any
    }
}

struct Elements<'de> {
    array: &'de [Spanned<DeValue<'de>>],
    next: usize,
    offset: usize,
}

impl<'de> SeqAccess<'de> for &mut Elements<'de> {
    type Error = ValueError;

    fn next_element_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, ValueError> {
        let Some(value) = self.array.get(self.next) else {
            return Ok(None);
        };
        let index = self.next;
        self.next += 1;
        let value = Value::of(value, self.offset);
        seed.deserialize(value).map(Some).map_err(|error| error.from(value.offset).below(Step::At(index)))
    }
}

/// A variant of an enumeration: its name, or a table with its name and content.
struct Variant<'de> {
    name: &'de str,
    whole: Value<'de>,
    content: Option<Value<'de>>,
}

impl<'de> Variant<'de> {
    /// The content of a variant that is not given by its name alone.
    fn content(&self) -> Result<Value<'de>, ValueError> {
        self.content.ok_or_else(|| self.whole.wrong(format!("a table with the key {}", self.name)))
    }
}

impl<'de> EnumAccess<'de> for Variant<'de> {
    type Error = ValueError;
    type Variant = Self;

    fn variant_seed<S: DeserializeSeed<'de>>(self, seed: S) -> Result<(S::Value, Self), ValueError> {
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

    fn newtype_variant_seed<S: DeserializeSeed<'de>>(self, seed: S) -> Result<S::Value, ValueError> {
        let content = self.content()?;
        seed.deserialize(content).map_err(|error| error.from(content.offset))
    }

    fn tuple_variant<V: Visitor<'de>>(self, length: usize, visitor: V) -> Result<V::Value, ValueError> {
        self.content()?.array(Some(length), visitor)
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        _fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, ValueError> {
        self.content()?.table(visitor)
    }
}
