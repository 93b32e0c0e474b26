//! A policy as an ONNX model: what other programs play, without anything of ours.
//!
//! One input, `observation` (1 × n), and one output, `action` (1 × m), in the units of its box; scaling and normalising are part of the graph. The messages
//! below are the part of ONNX's `onnx.proto` that this needs, with its names and numbers.

use prost::Message;

use crate::{Activation, Normaliser, Policy, PolicyAgent, Tensor, layer::Side};

/// Of the format, and of its operators: what every reader since 2021 knows.
const IR_VERSION: i64 = 8;
const OPERATORS: i64 = 13;
/// `TensorProto.DataType.FLOAT`.
const FLOAT: i32 = 1;

#[derive(Clone, PartialEq, Message)]
struct ModelProto {
    #[prost(int64, tag = "1")]
    ir_version: i64,
    #[prost(string, tag = "2")]
    producer_name: String,
    #[prost(message, optional, tag = "7")]
    graph: Option<GraphProto>,
    #[prost(message, repeated, tag = "8")]
    opset_import: Vec<OperatorSetIdProto>,
}

#[derive(Clone, PartialEq, Message)]
struct OperatorSetIdProto {
    #[prost(string, tag = "1")]
    domain: String,
    #[prost(int64, tag = "2")]
    version: i64,
}

#[derive(Clone, PartialEq, Message)]
struct GraphProto {
    #[prost(message, repeated, tag = "1")]
    node: Vec<NodeProto>,
    #[prost(string, tag = "2")]
    name: String,
    #[prost(message, repeated, tag = "5")]
    initializer: Vec<TensorProto>,
    #[prost(message, repeated, tag = "11")]
    input: Vec<ValueInfoProto>,
    #[prost(message, repeated, tag = "12")]
    output: Vec<ValueInfoProto>,
}

#[derive(Clone, PartialEq, Message)]
struct NodeProto {
    #[prost(string, repeated, tag = "1")]
    input: Vec<String>,
    #[prost(string, repeated, tag = "2")]
    output: Vec<String>,
    #[prost(string, tag = "3")]
    name: String,
    #[prost(string, tag = "4")]
    op_type: String,
}

#[derive(Clone, PartialEq, Message)]
struct TensorProto {
    #[prost(int64, repeated, packed = "false", tag = "1")]
    dims: Vec<i64>,
    #[prost(int32, tag = "2")]
    data_type: i32,
    #[prost(string, tag = "8")]
    name: String,
    #[prost(bytes = "vec", tag = "9")]
    raw_data: Vec<u8>,
}

#[derive(Clone, PartialEq, Message)]
struct ValueInfoProto {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(message, optional, tag = "2")]
    r#type: Option<TypeProto>,
}

#[derive(Clone, PartialEq, Message)]
struct TypeProto {
    #[prost(message, optional, tag = "1")]
    tensor_type: Option<TensorType>,
}

/// `TypeProto.Tensor`.
#[derive(Clone, PartialEq, Message)]
struct TensorType {
    #[prost(int32, tag = "1")]
    elem_type: i32,
    #[prost(message, optional, tag = "2")]
    shape: Option<TensorShapeProto>,
}

#[derive(Clone, PartialEq, Message)]
struct TensorShapeProto {
    #[prost(message, repeated, tag = "1")]
    dim: Vec<Dimension>,
}

/// `TensorShapeProto.Dimension`.
#[derive(Clone, PartialEq, Message)]
struct Dimension {
    #[prost(int64, tag = "1")]
    dim_value: i64,
}

/// A chain of operators, each with the output of the one before as its first input.
struct Chain {
    graph: GraphProto,
    /// What the last operator gives.
    last: String,
}

impl Chain {
    fn new(input: &str) -> Self {
        Self { graph: GraphProto { name: "policy".into(), ..GraphProto::default() }, last: input.into() }
    }

    /// Another operator, with constants as its further inputs.
    fn then(&mut self, operator: &str, constants: &[Tensor<'_>]) {
        let name = format!("{}.{}", operator.to_lowercase(), self.graph.node.len());
        let mut input = vec![std::mem::replace(&mut self.last, name.clone())];
        for constant in constants {
            input.push(constant.name.clone());
            self.graph.initializer.push(TensorProto {
                dims: constant.shape.iter().map(|length| *length as i64).collect(),
                data_type: FLOAT,
                name: constant.name.clone(),
                raw_data: constant.values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            });
        }
        let node = NodeProto { input, output: vec![name.clone()], name, op_type: operator.into() };
        self.graph.node.push(node);
    }

    fn model(mut self, observation_len: usize, action_len: usize) -> ModelProto {
        if let Some(node) = self.graph.node.last_mut() {
            node.output = vec!["action".into()];
        }
        self.graph.input = vec![row("observation", observation_len)];
        self.graph.output = vec![row("action", action_len)];
        ModelProto {
            ir_version: IR_VERSION,
            producer_name: "actor-critic".into(),
            graph: Some(self.graph),
            opset_import: vec![OperatorSetIdProto { domain: String::new(), version: OPERATORS }],
        }
    }
}

/// A matrix of one row.
fn row(name: &str, length: usize) -> ValueInfoProto {
    let dim = [1, length as i64].map(|dim_value| Dimension { dim_value }).to_vec();
    let tensor_type = Some(TensorType { elem_type: FLOAT, shape: Some(TensorShapeProto { dim }) });
    ValueInfoProto { name: name.into(), r#type: Some(TypeProto { tensor_type }) }
}

impl<P: Policy> PolicyAgent<P> {
    /// Appends the greedy policy as an ONNX model: of a stochastic policy, its mean.
    pub fn write_onnx(&self, bytes: &mut Vec<u8>) {
        let mut chain = Chain::new("observation");
        if let Some(normaliser) = &self.body.normaliser {
            let [mean, deviation] = normaliser.tensors();
            chain.then("Sub", &[mean]);
            chain.then("Div", &[deviation]);
            let bound =
                |name: &str, value| Tensor { name: name.into(), shape: vec![], values: vec![value].into() };
            let bounds = [
                bound("observation.least", -Normaliser::BOUND),
                bound("observation.largest", Normaliser::BOUND),
            ];
            chain.then("Clip", &bounds);
        }
        let network = self.actor.weights();
        for layer in &self.actor.architecture().layers {
            let named = |part: &str, shape: &[usize], values: &[f32]| {
                let name = format!("actor.layers.{}.{part}", layer.index);
                Tensor { name, shape: shape.to_vec(), values: values.to_vec().into() }
            };
            if layer.batch_renorm.is_some() {
                let [factor, summand] = layer.features(Side::Below, network).affine();
                chain.then("Mul", &[named("input_factor", &[layer.inputs], &factor)]);
                chain.then("Add", &[named("input_summand", &[layer.inputs], &summand)]);
            }
            let is_last = layer == self.actor.architecture().last();
            // Of a Gaussian's outputs, the means come first.
            let columns = if is_last { self.action_len() } else { layer.outputs };
            let parts = layer.parts(network);
            let weight = named("weight", &[layer.inputs, layer.outputs], parts.weights);
            chain.then("MatMul", &[weight.first_columns(columns)]);
            chain.then("Add", &[named("bias", &[layer.outputs], parts.bias).first_columns(columns)]);
            match layer.activation {
                Some(Activation::Relu) => chain.then("Relu", &[]),
                // Where the network ends without tanh, the policy squashes its mean.
                Some(Activation::Tanh) | None => chain.then("Tanh", &[]),
            }
        }
        let [low, high] = self.body.scale.tensors();
        let each = |name: &str, of: fn(f32, f32) -> f32| Tensor {
            name: name.into(),
            shape: low.shape.clone(),
            values: low.values.iter().zip(&*high.values).map(|(low, high)| of(*low, *high)).collect(),
        };
        chain.then("Mul", &[each("action.half_range", |low, high| (high - low) / 2.0)]);
        chain.then("Add", &[each("action.centre", |low, high| low + (high - low) / 2.0)]);
        chain.then("Max", &[low]);
        chain.then("Min", &[high]);
        bytes.extend(chain.model(self.observation_len(), self.action_len()).encode_to_vec());
    }
}
