//! The messages of a trajectory and the schema that every file carries, so that any reader can decode it.

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet};

/// Protobuf package of all messages.
const PACKAGE: &str = "flare_pipe";

/// `/base`: prescribed acceleration of the base.
#[derive(Clone, PartialEq, Message)]
pub struct Base {
    /// Time since the first sample, s.
    #[prost(double, tag = "1")]
    pub time_s: f64,
    /// Absolute horizontal acceleration, m/s².
    #[prost(double, tag = "2")]
    pub acceleration_m_s2: f64,
}

/// `/response`: acceleration of the element centres, surface down, and of the surface node.
#[derive(Clone, PartialEq, Message)]
pub struct Response {
    /// Time since the first sample, s.
    #[prost(double, tag = "1")]
    pub time_s: f64,
    /// Absolute horizontal acceleration at the element centres, surface down, m/s².
    #[prost(float, repeated, packed = "true", tag = "2")]
    pub acceleration_m_s2: Vec<f32>,
    /// Absolute horizontal acceleration of the surface node, m/s².
    #[prost(double, tag = "3")]
    pub surface_m_s2: f64,
}

/// `/sensors`: acceleration at the instrumented depths.
#[derive(Clone, PartialEq, Message)]
pub struct Sensors {
    /// Time since the first sample, s.
    #[prost(double, tag = "1")]
    pub time_s: f64,
    /// One reading a sensor, in the order of the manifest.
    #[prost(message, repeated, tag = "2")]
    pub readings: Vec<Reading>,
}

/// Reading of one sensor.
#[derive(Clone, PartialEq, Message)]
pub struct Reading {
    /// Sensor name as in the manifest.
    #[prost(string, tag = "1")]
    pub name: String,
    /// Absolute horizontal acceleration, m/s².
    #[prost(double, tag = "2")]
    pub acceleration_m_s2: f64,
}

/// Schema name of a message: `flare_pipe.Base`.
pub fn schema_name(message: &str) -> String {
    format!("{PACKAGE}.{message}")
}

/// The encoded descriptor set of all messages, as MCAP's `protobuf` schema encoding asks for.
pub fn descriptor_set() -> Vec<u8> {
    let double = |name, number| field(name, number, Type::Double, Label::Optional, None);
    let file = FileDescriptorProto {
        name: Some("flare_pipe/trajectory.proto".into()),
        package: Some(PACKAGE.into()),
        syntax: Some("proto3".into()),
        message_type: vec![
            message("Base", vec![double("time_s", 1), double("acceleration_m_s2", 2)]),
            message(
                "Response",
                vec![
                    double("time_s", 1),
                    field("acceleration_m_s2", 2, Type::Float, Label::Repeated, None),
                    double("surface_m_s2", 3),
                ],
            ),
            message(
                "Sensors",
                vec![
                    double("time_s", 1),
                    field("readings", 2, Type::Message, Label::Repeated, Some(".flare_pipe.Reading")),
                ],
            ),
            message(
                "Reading",
                vec![field("name", 1, Type::String, Label::Optional, None), double("acceleration_m_s2", 2)],
            ),
        ],
        ..FileDescriptorProto::default()
    };
    FileDescriptorSet { file: vec![file] }.encode_to_vec()
}

fn message(name: &str, field: Vec<FieldDescriptorProto>) -> DescriptorProto {
    DescriptorProto { name: Some(name.into()), field, ..DescriptorProto::default() }
}

fn field(name: &str, number: i32, kind: Type, label: Label, type_name: Option<&str>) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.into()),
        number: Some(number),
        label: Some(label as i32),
        r#type: Some(kind as i32),
        type_name: type_name.map(Into::into),
        json_name: None,
        ..FieldDescriptorProto::default()
    }
}
