//! Names of models and of parameters in cell files.

use std::fmt;

use serde::de::{DeserializeSeed, EnumAccess, Error, VariantAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::own::{BUILT_IN, OwnModel, OwnParameters};
use super::{Model, Parameters};
use crate::cell::{one_of, quoted};
use crate::each_robot;

impl<'de> Deserialize<'de> for Model {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        Self::named(&name).ok_or_else(|| {
            let names: Vec<_> = Self::all().into_iter().map(Self::name).collect();
            let problem = format!("is {}, must be {}", quoted(&name), one_of(&names));
            D::Error::custom(format!("{problem}; a model of another program is known to that program alone"))
        })
    }
}

impl Serialize for Model {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for Parameters {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_enum("Parameters", names(), OfOneRobot)
    }
}

impl Serialize for Parameters {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if let Self::Chain(_) = self {
            return Err(serde::ser::Error::custom("the numbers of a chain are those of the key chain"));
        }
        each_robot!(self, it => serializer.serialize_newtype_variant("Parameters", 0, self.name(), it))
    }
}

/// The tables that `parameters` can have.
fn names() -> &'static [&'static str] {
    let own = OwnModel::all();
    if own.is_empty() {
        return &BUILT_IN;
    }
    // A program registers few robots, and reads few cells.
    let all: Vec<_> = BUILT_IN.into_iter().chain(own.into_iter().map(OwnModel::name)).collect();
    Box::leak(all.into_boxed_slice())
}

struct OfOneRobot;

impl<'de> Visitor<'de> for OfOneRobot {
    type Value = Parameters;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a table with the key {}", one_of(names()))
    }

    fn visit_enum<A: EnumAccess<'de>>(self, data: A) -> Result<Parameters, A::Error> {
        let (name, numbers): (String, _) = data.variant()?;
        Ok(match &*name {
            "irb6" => Parameters::Irb6(numbers.newtype_variant()?),
            "irp6" => Parameters::Irp6(numbers.newtype_variant()?),
            "irp6-track" => Parameters::Irp6Track(numbers.newtype_variant()?),
            "rnt" => Parameters::Rnt(numbers.newtype_variant()?),
            "polycrank" => Parameters::Polycrank(numbers.newtype_variant()?),
            "gripper" => Parameters::Gripper(numbers.newtype_variant()?),
            "conveyor" => Parameters::Conveyor(numbers.newtype_variant()?),
            _ => match OwnModel::named(&name) {
                Some(own) => Parameters::Own(numbers.newtype_variant_seed(own)?),
                None => return Err(A::Error::unknown_variant(&name, names())),
            },
        })
    }
}

impl<'de> DeserializeSeed<'de> for OwnModel {
    type Value = OwnParameters;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<OwnParameters, D::Error> {
        let value = toml::Value::deserialize(deserializer)?;
        self.read(value).map_err(|error| D::Error::custom(error.message()))
    }
}
