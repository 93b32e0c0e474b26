//! Weights for others to read: safetensors, which Python opens with `safetensors.numpy.load_file`.
//!
//! A layer of network `i` of `critics` is `critics.i.layers.k.weight` (inputs × outputs) and `critics.i.layers.k.bias` (outputs):
//! y = f(x W + b). Where the action enters, its rows follow the input's in the same matrix: x is the input, then the action.
//! With layer normalisation, y = f(weight · (z − mean of z)/√(variance of z + 1e-5) + bias) of z = x W + b, with `critics.i.layers.k.norm.weight`
//! and `.norm.bias`. With batch renormalisation, x is first weight · (x − mean)/√(variance + 1e-3) + bias, with
//! `critics.i.layers.k.input_norm.weight`, `.bias`, `.mean` and `.variance`.
//! `actor` is one network. Target networks have the same names under `target_`.

use std::borrow::Cow;

use safetensors::{Dtype, View};

use crate::{ActionScale, Architecture, Ensemble, Error, Normaliser};

/// Values with a name and a shape, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor<'a> {
    /// As the module says.
    pub name: String,
    /// Rows and columns, or a length.
    pub shape: Vec<usize>,
    /// As many as the shape says.
    pub values: Cow<'a, [f32]>,
}

impl<'a> Tensor<'a> {
    fn new(name: String, shape: &[usize], values: &'a [f32]) -> Self {
        Self { name, shape: shape.to_vec(), values: values.into() }
    }

    fn vector(name: &str, values: impl Into<Cow<'a, [f32]>>) -> Self {
        let values = values.into();
        Self { name: name.into(), shape: vec![values.len()], values }
    }
}

impl Tensor<'_> {
    /// The first columns of a matrix, or the first values of a vector.
    pub(crate) fn first_columns(&self, columns: usize) -> Self {
        let mut shape = self.shape.clone();
        let width = shape.last_mut().map_or(1, |width| std::mem::replace(width, columns));
        let rows = self.values.chunks_exact(width);
        Self {
            name: self.name.clone(),
            shape,
            values: rows.flat_map(|row| &row[..columns]).copied().collect(),
        }
    }
}

impl View for &Tensor<'_> {
    fn dtype(&self) -> Dtype {
        Dtype::F32
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        self.values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<_>>().into()
    }

    fn data_len(&self) -> usize {
        4 * self.values.len()
    }
}

impl Architecture {
    /// The layers of a network whose parameters are these.
    fn tensors<'a>(&self, network: &str, parameters: &'a [f32]) -> Vec<Tensor<'a>> {
        let layers = self.layers.iter().enumerate().flat_map(|(index, layer)| {
            let inputs = layer.inputs + layer.action_inputs;
            let weights = &parameters[layer.offset..layer.offset + inputs * layer.outputs];
            let bias = layer.parts(parameters).bias;
            let name = |part: &str| format!("{network}.layers.{index}.{part}");
            let mut tensors = vec![
                Tensor::new(name("weight"), &[inputs, layer.outputs], weights),
                Tensor::new(name("bias"), &[layer.outputs], bias),
            ];
            if layer.layer_norm {
                let (gain, shift) = parameters[layer.layer_norm()].split_at(layer.outputs);
                tensors.push(Tensor::new(name("norm.weight"), &[layer.outputs], gain));
                tensors.push(Tensor::new(name("norm.bias"), &[layer.outputs], shift));
            }
            if layer.batch_renorm.is_some() {
                let parts = ["weight", "bias", "mean", "variance"].iter().zip(layer.batch_renorm());
                tensors.extend(parts.map(|(part, range)| {
                    Tensor::new(name(&format!("input_norm.{part}")), &[inputs], &parameters[range])
                }));
            }
            tensors
        });
        layers.collect()
    }
}

impl Ensemble<f32> {
    /// The layers of every network and of its target network. `name` alone is the network's where `is_single`, else followed by
    /// its number.
    pub fn tensors(&self, name: &str, is_single: bool) -> Vec<Tensor<'_>> {
        let length = self.architecture().parameter_len();
        let mut tensors = Vec::new();
        for (prefix, parameters) in [("", self.weights()), ("target_", self.target_weights())] {
            for (index, parameters) in parameters.chunks_exact(length).enumerate() {
                let number = if is_single { String::new() } else { format!(".{index}") };
                tensors.extend(self.architecture().tensors(&format!("{prefix}{name}{number}"), parameters));
            }
        }
        tensors
    }
}

impl ActionScale {
    /// `action.low` and `action.high`, between which the networks' [-1, 1] is spread.
    pub fn tensors(&self) -> [Tensor<'_>; 2] {
        [Tensor::vector("action.low", self.low()), Tensor::vector("action.high", self.high())]
    }
}

impl Normaliser {
    /// `observation.mean` and `observation.deviation`: the networks see (x − mean) / deviation, cut at ±[`BOUND`](Self::BOUND).
    pub fn tensors(&self) -> [Tensor<'static>; 2] {
        let [means, deviations] = self.statistics();
        [Tensor::vector("observation.mean", means), Tensor::vector("observation.deviation", deviations)]
    }
}

/// Appends a file in the format safetensors.
///
/// # Errors
/// [`Error::Tensors`].
pub fn write_tensors(tensors: &[Tensor<'_>], bytes: &mut Vec<u8>) -> Result<(), Error> {
    let named = tensors.iter().map(|tensor| (tensor.name.as_str(), tensor));
    let file = safetensors::serialize(named, None).map_err(|error| Error::Tensors(error.to_string()))?;
    bytes.extend(file);
    Ok(())
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;
    use safetensors::SafeTensors;

    use super::*;
    use crate::{Activation, Initialisation};

    /// What a reader computes from the file: y = x W + b, tanh in between.
    fn forward(
        file: &SafeTensors<'_>,
        network: &str,
        layers: usize,
        mut x: Vec<f32>,
        action: &[f32],
    ) -> Vec<f32> {
        let numbers = |name: String| -> (Vec<usize>, Vec<f32>) {
            let tensor = file.tensor(&name).unwrap();
            let values = tensor.data().chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap()));
            (tensor.shape().to_vec(), values.collect())
        };
        for layer in 0..layers {
            if layer == 1 {
                x.extend(action);
            }
            let (shape, weights) = numbers(format!("{network}.layers.{layer}.weight"));
            let (_, bias) = numbers(format!("{network}.layers.{layer}.bias"));
            assert_eq!(shape, [x.len(), bias.len()]);
            let sums = (0..bias.len()).map(|column| {
                let products = x.iter().enumerate().map(|(row, x)| x * weights[row * bias.len() + column]);
                bias[column] + products.sum::<f32>()
            });
            x = if layer + 1 < layers { sums.map(f32::tanh).collect() } else { sums.collect() };
        }
        x
    }

    #[test]
    fn the_written_tensors_give_the_same_values() {
        let architecture = Architecture::critic(3, 2, &[5, 4], 1, Activation::Tanh).unwrap();
        let mut critics =
            Ensemble::<f32>::new(architecture, Initialisation::Lillicrap, 3, 1, &mut Pcg64::seed_from_u64(1))
                .unwrap();
        critics.raise_outputs(1.0);
        let mut bytes = Vec::new();
        write_tensors(&critics.tensors("critics", false), &mut bytes).unwrap();
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let (observation, action) = ([0.1, -0.4, 0.9], [0.5, -0.2]);
        for index in 0..3 {
            let mut critic = critics.member(index);
            critic.observe(&observation);
            let expected = critic.values(&action)[0];
            for network in [format!("critics.{index}"), format!("target_critics.{index}")] {
                let found = forward(&file, &network, 3, observation.to_vec(), &action)[0];
                assert!((found - expected).abs() < 1e-6, "{network}: {found} against {expected}");
            }
        }
    }

    #[test]
    fn the_written_scales_are_those_of_the_networks() {
        let mut normaliser = Normaliser::new(1);
        normaliser.observe(&[1.0, 3.0, 8.0]);
        let scale = ActionScale::new(&[-2.0], &[4.0]).unwrap();
        let [mean, deviation] = normaliser.tensors();
        let mut seen = [0.0];
        normaliser.normalise(&[5.0], &mut seen);
        assert!((seen[0] - (5.0 - mean.values[0]) / deviation.values[0]).abs() < 1e-6);
        let [low, high] = scale.tensors();
        assert_eq!((&*low.values, &*high.values), (&[-2.0][..], &[4.0][..]));
    }
}
