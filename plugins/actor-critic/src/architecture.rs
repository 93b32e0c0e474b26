//! The shape of a network: its layers, where their weights lie in the flat buffer, and where the action enters.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use crate::{BatchRenorm, Error, Real, kernels::scale, layer::Layer};

/// What follows the affine part of a hidden layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Activation {
    /// tanh.
    Tanh,
    /// max(x, 0).
    Relu,
}

/// How initial weights are drawn. In a layer of n inputs and m outputs:
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Initialisation {
    /// Weights and biases uniform in ±1/√n, those of the last layer in ±3e-3 (Lillicrap et al. 2015, section 7).
    Lillicrap,
    /// Weights and biases of every layer uniform in ±1/√n, as PyTorch's linear layers.
    FanIn,
    /// Weights uniform in ±√(6/(n + m)), biases 0 (Glorot and Bengio 2010); made for tanh.
    Glorot,
    /// Weights uniform in ±√(6/n), biases 0 (He et al. 2015); made for ReLU.
    He,
}

impl Initialisation {
    /// The bounds of a layer's weights and of its biases.
    fn bounds(self, layer: &Layer, is_last: bool) -> [f64; 2] {
        let (inputs, outputs) = ((layer.inputs + layer.action_inputs) as f64, layer.outputs as f64);
        match self {
            Self::Lillicrap if is_last => [3e-3; 2],
            Self::Lillicrap | Self::FanIn => [1.0 / inputs.sqrt(); 2],
            Self::Glorot => [(6.0 / (inputs + outputs)).sqrt(), 0.0],
            Self::He => [(6.0 / inputs).sqrt(), 0.0],
        }
    }
}

/// What a network has beside affine layers and activations; without, it is a plain one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Regularisation {
    /// Normalises the sums of each hidden layer, before the activation (Ba et al. 2016).
    pub layer_norm: bool,
    /// Probability with which an update drops a hidden unit, before the normalisation (DroQ, Hiraoka et al. 2022).
    pub dropout: f32,
    /// Normalises the inputs of each layer, the action's values too (CrossQ, Bhatt et al. 2024).
    pub batch_renorm: Option<BatchRenorm>,
}

/// A multi-layer perceptron.
#[derive(Debug, Clone, PartialEq)]
pub struct Architecture {
    pub(crate) layers: Vec<Layer>,
    /// The layer whose input is concatenated with the action; the number of layers if there is none.
    pub(crate) join: usize,
    observation_len: usize,
    action_len: usize,
}

impl Architecture {
    /// Q(s, a): the action is concatenated with the input of hidden layer `action_layer`, or of the last if there are fewer. 0 is beside the
    /// observation (Fujimoto et al. 2018), 1 before the second (Lillicrap et al. 2015; Leave no Trace, appendix C).
    ///
    /// # Errors
    /// [`Error::Shape`] for an empty layer or none.
    pub fn critic(
        observation_len: usize,
        action_len: usize,
        hidden: &[usize],
        action_layer: usize,
        activation: Activation,
    ) -> Result<Self, Error> {
        let join = action_layer.min(hidden.len().saturating_sub(1));
        Self::new(observation_len, hidden, 1, activation, None, Some((join, action_len)))
    }

    /// Q(s, ·) of discrete actions: hidden layers, then one output per action.
    ///
    /// # Errors
    /// [`Error::Shape`] for an empty layer or none.
    pub fn action_values(
        observation_len: usize,
        actions: usize,
        hidden: &[usize],
        activation: Activation,
    ) -> Result<Self, Error> {
        Self::new(observation_len, hidden, actions, activation, None, None)
    }

    /// π(s) in [-1, 1]: hidden layers, then tanh.
    ///
    /// # Errors
    /// [`Error::Shape`] for an empty layer or none.
    pub fn actor(
        observation_len: usize,
        action_len: usize,
        hidden: &[usize],
        activation: Activation,
    ) -> Result<Self, Error> {
        Self::new(observation_len, hidden, action_len, activation, Some(Activation::Tanh), None)
    }

    /// The mean and the logarithm of the deviation of a Gaussian over actions: hidden layers, then first all means, then all logarithms.
    ///
    /// # Errors
    /// [`Error::Shape`] for an empty layer or none.
    pub fn gaussian(
        observation_len: usize,
        action_len: usize,
        hidden: &[usize],
        activation: Activation,
    ) -> Result<Self, Error> {
        Self::new(observation_len, hidden, 2 * action_len, activation, None, None)
    }

    fn new(
        observation_len: usize,
        hidden: &[usize],
        outputs: usize,
        activation: Activation,
        output_activation: Option<Activation>,
        joined: Option<(usize, usize)>,
    ) -> Result<Self, Error> {
        let (join, action_len) = joined.unwrap_or((hidden.len() + 1, 0));
        let is_buildable = observation_len > 0 && outputs > 0 && !hidden.is_empty() && !hidden.contains(&0);
        if !is_buildable {
            return Err(Error::Shape { inputs: observation_len, hidden: hidden.to_vec() });
        }
        let mut layers: Vec<Layer> = Vec::new();
        for (index, outputs) in hidden.iter().chain([&outputs]).enumerate() {
            let before = layers.last();
            layers.push(Layer {
                inputs: before.map_or(observation_len, |layer| layer.outputs),
                action_inputs: if index == join { action_len } else { 0 },
                outputs: *outputs,
                offset: before.map_or(0, |layer| layer.offset + layer.parameter_len()),
                outputs_before: before.map_or(0, |layer| layer.outputs_before + layer.outputs),
                activation: if index == hidden.len() { output_activation } else { Some(activation) },
                index,
                layer_norm: false,
                dropout: 0.0,
                batch_renorm: None,
            });
        }
        Ok(Self { layers, join, observation_len, action_len })
    }

    /// The same network with these normalisations.
    #[must_use]
    pub fn regularised(mut self, regularisation: Regularisation) -> Self {
        let Regularisation { layer_norm, dropout, batch_renorm } = regularisation;
        let last = self.layers.len() - 1;
        let mut offset = 0;
        for layer in &mut self.layers {
            let is_hidden = layer.index < last;
            layer.layer_norm = layer_norm && is_hidden;
            layer.dropout = if is_hidden { dropout } else { 0.0 };
            layer.batch_renorm = batch_renorm;
            layer.offset = offset;
            offset += layer.parameter_len();
        }
        self
    }

    /// The batch renormalisation, if there is one.
    pub(crate) fn batch_renorm(&self) -> Option<BatchRenorm> {
        self.layers[0].batch_renorm
    }

    /// Whether an update drops units.
    pub(crate) fn drops_units(&self) -> bool {
        self.layers.iter().any(|layer| layer.dropout > 0.0)
    }

    /// How many values an observation has.
    pub fn observation_len(&self) -> usize {
        self.observation_len
    }

    /// How many values the action has that enters; 0 where none does.
    pub fn action_len(&self) -> usize {
        self.action_len
    }

    /// How many values the network returns for one row.
    pub fn output_len(&self) -> usize {
        self.last().outputs
    }

    /// How many weights and biases there are.
    pub fn parameter_len(&self) -> usize {
        self.last().offset + self.last().parameter_len()
    }

    /// How many values all layers return for one row.
    pub(crate) fn activation_len(&self) -> usize {
        self.last().outputs_before + self.last().outputs
    }

    pub(crate) fn last(&self) -> &Layer {
        &self.layers[self.layers.len() - 1]
    }

    /// Draws initial weights.
    pub(crate) fn initialise<T: Real>(
        &self,
        initialisation: Initialisation,
        parameters: &mut [T],
        rng: &mut impl Rng,
    ) {
        for (index, layer) in self.layers.iter().enumerate() {
            let bounds = initialisation.bounds(layer, index + 1 == self.layers.len());
            let parts = layer.parts_mut(parameters);
            for (values, bound) in
                [(parts.weights, bounds[0]), (parts.action_weights, bounds[0]), (parts.bias, bounds[1])]
            {
                for value in values {
                    *value = T::from_f64(if bound > 0.0 { rng.random_range(-bound..bound) } else { 0.0 });
                }
            }
            let (norm, [gain, shift, mean, variance]) = (layer.layer_norm(), layer.batch_renorm());
            parameters[norm.clone()].fill(T::ZERO);
            parameters[norm][..layer.layer_norm_len() / 2].fill(T::ONE);
            if layer.batch_renorm.is_some() {
                for (range, value) in [(gain, T::ONE), (shift, T::ZERO), (mean, T::ZERO), (variance, T::ONE)]
                {
                    parameters[range].fill(value);
                }
            }
        }
    }

    /// Multiplies the matrices by `factor`; biases and normalisations keep their size.
    pub(crate) fn decay<T: Real>(&self, parameters: &mut [T], factor: T) {
        for layer in &self.layers {
            let matrices = layer.offset..layer.offset + layer.rows() * layer.outputs;
            scale(&mut parameters[matrices], factor);
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;
    use crate::layer::Parts;

    #[test]
    fn the_papers_critic_has_its_published_number_of_weights() {
        let critic = Architecture::critic(18, 6, &[400, 300], 1, Activation::Tanh).unwrap();
        assert_eq!(critic.parameter_len(), 18 * 400 + 400 + 406 * 300 + 300 + 300 + 1);
        assert_eq!((critic.join, critic.output_len(), critic.activation_len()), (1, 1, 701));
        let critic = Architecture::critic(18, 6, &[400, 300], 0, Activation::Tanh).unwrap();
        assert_eq!((critic.join, critic.parameter_len()), (0, 24 * 400 + 400 + 400 * 300 + 300 + 300 + 1));
        let critic = Architecture::critic(18, 6, &[400], 1, Activation::Tanh).unwrap();
        assert_eq!(critic.join, 0);
        let actor = Architecture::actor(18, 6, &[400, 300], Activation::Tanh).unwrap();
        assert_eq!(actor.parameter_len(), 18 * 400 + 400 + 400 * 300 + 300 + 300 * 6 + 6);
        let values = Architecture::action_values(25, 4, &[64], Activation::Relu).unwrap();
        assert_eq!((values.parameter_len(), values.output_len()), (25 * 64 + 64 + 64 * 4 + 4, 4));
    }

    #[test]
    fn networks_without_layers_or_units_are_refused() {
        for hidden in [&[][..], &[0], &[4, 0]] {
            assert!(Architecture::critic(3, 1, hidden, 1, Activation::Tanh).is_err(), "{hidden:?}");
        }
        assert!(Architecture::actor(0, 1, &[4], Activation::Tanh).is_err());
    }

    #[test]
    fn initial_weights_fill_their_published_bounds() {
        let critic = Architecture::critic(14, 2, &[100, 64], 1, Activation::Tanh).unwrap();
        let sources = [
            (Initialisation::Lillicrap, [1.0 / 14f64.sqrt(), 1.0 / 102f64.sqrt(), 3e-3], true),
            (Initialisation::FanIn, [1.0 / 14f64.sqrt(), 1.0 / 102f64.sqrt(), 1.0 / 8.0], true),
            (
                Initialisation::Glorot,
                [(6.0 / 114f64).sqrt(), (6.0 / 166f64).sqrt(), (6.0 / 65f64).sqrt()],
                false,
            ),
            (Initialisation::He, [(6.0 / 14f64).sqrt(), (6.0 / 102f64).sqrt(), (6.0 / 64f64).sqrt()], false),
        ];
        for (initialisation, bounds, has_biases) in sources {
            let mut parameters = vec![f64::NAN; critic.parameter_len()];
            critic.initialise(initialisation, &mut parameters, &mut Pcg64::seed_from_u64(1));
            for (layer, bound) in critic.layers.iter().zip(bounds) {
                let Parts { weights, action_weights, bias } = layer.parts(&parameters);
                let largest =
                    |values: &[f64]| values.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
                for values in [weights, action_weights].into_iter().filter(|values| !values.is_empty()) {
                    let share = largest(values) / bound;
                    assert!((0.9..1.0).contains(&share), "{initialisation:?}: {share}");
                }
                assert_eq!(largest(bias) > 0.0, has_biases, "{initialisation:?}");
            }
        }
    }
}
