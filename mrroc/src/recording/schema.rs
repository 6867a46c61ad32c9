//! Protobuf messages with their descriptor, from one declaration.
//!
//! Every field has its number in the source, so a field keeps its number when others are added. A number is never used
//! again.

use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, OneofDescriptorProto,
};

/// Package of all messages.
pub(super) const PACKAGE: &str = "mrroc";

/// A message with its name, for a channel of a recording.
pub(super) trait Schema: prost::Message {
    /// Name of the message without its package.
    const NAME: &'static str;
}

/// One field as it is declared.
pub(super) struct Field {
    pub(super) name: &'static str,
    pub(super) number: i32,
    /// The arguments of `#[prost(...)]`, for example `double , repeated`.
    pub(super) kind: &'static str,
    /// The Rust type, which names the message of a message field.
    pub(super) rust: &'static str,
}

/// Declares messages, and a function with all descriptors.
macro_rules! messages {
    ($($(#[$doc:meta])* $message:ident {
        $($(#[$field_doc:meta])* $field:ident = $number:tt: [$($kind:tt)*] $rust:ty,)*
    })*) => {
        $(
            $(#[$doc])*
            #[derive(Clone, PartialEq, ::prost::Message)]
            pub(super) struct $message {
                $($(#[$field_doc])* #[prost($($kind)*, tag = $number)] pub(super) $field: $rust,)*
            }

            impl $crate::recording::schema::Schema for $message {
                const NAME: &'static str = stringify!($message);
            }
        )*

        /// The descriptors of all messages, encoded as a `FileDescriptorSet`.
        pub(super) fn descriptors() -> Vec<u8> {
            use $crate::recording::schema::{Field, describe, encode};
            encode(vec![$(describe(stringify!($message), &[$(Field {
                name: stringify!($field),
                number: $number,
                kind: stringify!($($kind)*),
                rust: stringify!($rust),
            }),*])),*])
        }
    };
}
pub(super) use messages;

/// The descriptor of one message.
pub(super) fn describe(name: &str, fields: &[Field]) -> DescriptorProto {
    let mut message = DescriptorProto { name: Some(name.to_owned()), ..DescriptorProto::default() };
    for field in fields {
        let mut words = field.kind.split(',').map(str::trim);
        let kind = words.next().unwrap_or_default();
        let modifiers: Vec<_> = words.collect();
        let of = match kind.split('=').next().unwrap_or_default().trim() {
            "double" => Type::Double,
            "uint64" => Type::Uint64,
            "uint32" => Type::Uint32,
            "sint32" => Type::Sint32,
            "bool" => Type::Bool,
            "string" => Type::String,
            "bytes" => Type::Bytes,
            _ => Type::Message,
        };
        let inner = field.rust.rsplit(['<', ' ', ':']).find(|part| !part.trim_matches(['>', ' ']).is_empty());
        let type_name = inner.map(|inner| format!(".{PACKAGE}.{}", inner.trim_matches(['>', ' '])));
        let optional = modifiers.contains(&"optional");
        let oneof = optional.then(|| {
            let oneof = OneofDescriptorProto { name: Some(format!("_{}", field.name)), options: None };
            message.oneof_decl.push(oneof);
            message.oneof_decl.len() as i32 - 1
        });
        let label = if modifiers.contains(&"repeated") { Label::Repeated } else { Label::Optional };
        message.field.push(FieldDescriptorProto {
            name: Some(field.name.to_owned()),
            number: Some(field.number),
            label: Some(label as i32),
            r#type: Some(of as i32),
            type_name: type_name.filter(|_| of == Type::Message),
            oneof_index: oneof,
            proto3_optional: optional.then_some(true),
            ..FieldDescriptorProto::default()
        });
    }
    message
}

/// A file of messages as an encoded `FileDescriptorSet`.
pub(super) fn encode(messages: Vec<DescriptorProto>) -> Vec<u8> {
    let file = FileDescriptorProto {
        name: Some("mrroc.proto".to_owned()),
        package: Some(PACKAGE.to_owned()),
        message_type: messages,
        syntax: Some("proto3".to_owned()),
        ..FileDescriptorProto::default()
    };
    FileDescriptorSet { file: vec![file] }.encode_to_vec()
}
