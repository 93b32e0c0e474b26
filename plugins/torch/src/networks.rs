//! Networks of one shape as one tensor, with target networks and Adam's moments. Layout, initial weights and arithmetic are those of
//! `actor-critic`, so that a state of one is a state of the other.

use actor_critic::{Activation, Adam, EnsembleState};
use learner_kit::plugin_error;
use shield_api::{Error, Result};
use tch::{Device, Kind, TchError, Tensor, no_grad};

/// Where one layer's weights lie in a network's, and its shape. Rows of the action follow those of the input, then the bias.
#[derive(Debug, Clone, Copy)]
struct Layer {
    offset: i64,
    inputs: i64,
    outputs: i64,
}

/// The shape of a network.
#[derive(Debug, Clone)]
pub struct Shape {
    layers: Vec<Layer>,
    /// The layer where the action enters.
    join: Option<usize>,
    activation: Activation,
}

impl Shape {
    /// π(s): tanh at the end.
    pub fn actor(
        observation_len: usize,
        hidden: &[usize],
        action_len: usize,
        activation: Activation,
    ) -> Self {
        Self::new(observation_len, hidden, action_len, None, activation)
    }

    /// Q(s, a): the action enters at hidden layer `action_layer`, or at the last if there are fewer.
    pub fn critic(
        observation_len: usize,
        hidden: &[usize],
        action_layer: usize,
        action_len: usize,
        activation: Activation,
    ) -> Self {
        let join = action_layer.min(hidden.len() - 1);
        Self::new(observation_len, hidden, 1, Some((join, action_len)), activation)
    }

    fn new(
        observation_len: usize,
        hidden: &[usize],
        outputs: usize,
        joined: Option<(usize, usize)>,
        activation: Activation,
    ) -> Self {
        let (mut layers, mut inputs, mut offset) = (Vec::new(), observation_len, 0);
        for (index, outputs) in hidden.iter().copied().chain([outputs]).enumerate() {
            let action = joined.map_or(0, |(join, length)| if join == index { length } else { 0 });
            let rows = inputs + action;
            layers.push(Layer { offset: offset as i64, inputs: rows as i64, outputs: outputs as i64 });
            offset += (rows + 1) * outputs;
            inputs = outputs;
        }
        Self { layers, join: joined.map(|(join, _)| join), activation }
    }

    /// The layers' weights and biases of all networks, as views: `networks × inputs × outputs` and `networks × 1 × outputs`.
    fn parts(&self, flat: &Tensor) -> Result<Vec<Tensor>, TchError> {
        let networks = flat.size()[0];
        let mut parts = Vec::new();
        for Layer { offset, inputs, outputs } in &self.layers {
            let weights = flat.f_narrow(1, *offset, inputs * outputs)?;
            parts.push(weights.f_view([networks, *inputs, *outputs])?);
            let bias = flat.f_narrow(1, offset + inputs * outputs, *outputs)?;
            parts.push(bias.f_view([networks, 1, *outputs])?);
        }
        Ok(parts)
    }

    /// Outputs, `networks × rows × outputs`. Observations and actions have one entry per network, or one for all.
    fn forward(
        &self,
        parts: &[Tensor],
        observations: &Tensor,
        actions: Option<&Tensor>,
        kind: Kind,
    ) -> Result<Tensor, TchError> {
        let networks = parts[0].size()[0];
        let spread = |rows: &Tensor| rows.f_to_kind(kind)?.f_expand([networks, -1, -1], false);
        let mut x = spread(observations)?;
        for (index, layer) in parts.chunks_exact(2).enumerate() {
            if let Some(actions) = actions.filter(|_| self.join == Some(index)) {
                x = Tensor::f_cat(&[x, spread(actions)?], 2)?;
            }
            let (weights, bias) = (layer[0].f_to_kind(kind)?, layer[1].f_to_kind(kind)?);
            x = bias.f_baddbmm(&x, &weights, 1.0, 1.0)?;
            let is_last = index + 1 == self.layers.len();
            x = match (is_last, self.activation) {
                (true, _) if self.join.is_some() => x,
                (true, _) | (false, Activation::Tanh) => x.f_tanh()?,
                (false, Activation::Relu) => x.f_relu()?,
            };
        }
        x.f_to_kind(Kind::Float)
    }
}

/// Some networks; every tensor is `networks × parameters`.
#[derive(Debug)]
pub struct Networks {
    shape: Shape,
    weights: Tensor,
    targets: Tensor,
    first: Tensor,
    second: Tensor,
    steps: u64,
    /// In which products are computed.
    kind: Kind,
    /// Copies in half precision for valuing one (s, a), until the weights change.
    halves: Option<Vec<Tensor>>,
}

impl Networks {
    /// With these weights, one network's after the other's; target networks alike.
    pub fn new(shape: Shape, networks: usize, flat: &[f32], device: Device, kind: Kind) -> Result<Self> {
        let made = || -> Result<Self, TchError> {
            let weights = Tensor::f_from_slice(flat)?.f_view([networks as i64, -1])?.f_to_device(device)?;
            Ok(Self {
                targets: weights.copy(),
                first: weights.f_zeros_like()?,
                second: weights.f_zeros_like()?,
                weights: weights.copy(),
                shape,
                steps: 0,
                kind,
                halves: None,
            })
        };
        made().map_err(failed)
    }

    /// How many steps they have taken.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// The target networks' outputs.
    pub fn target_outputs(
        &self,
        observations: &Tensor,
        actions: Option<&Tensor>,
    ) -> Result<Tensor, TchError> {
        self.shape.forward(&self.shape.parts(&self.targets)?, observations, actions, self.kind)
    }

    /// The networks' outputs.
    pub fn outputs(&self, observations: &Tensor, actions: Option<&Tensor>) -> Result<Tensor, TchError> {
        self.shape.forward(&self.shape.parts(&self.weights)?, observations, actions, self.kind)
    }

    /// The networks' outputs from copies of the weights in half precision, with which the products are then computed as well.
    pub fn outputs_in_half(
        &mut self,
        observations: &Tensor,
        actions: Option<&Tensor>,
    ) -> Result<Tensor, TchError> {
        if self.halves.is_none() {
            let parts = self.shape.parts(&self.weights)?;
            self.halves =
                Some(parts.iter().map(|part| part.f_to_kind(Kind::Half)).collect::<Result<_, _>>()?);
        }
        self.shape.forward(self.halves.as_deref().unwrap_or_default(), observations, actions, Kind::Half)
    }

    /// The layers as leaves of a graph, for [`outputs_of`](Self::outputs_of) and [`gradient`](Self::gradient).
    pub fn leaves(&self) -> Result<Vec<Tensor>, TchError> {
        self.shape
            .parts(&self.weights)?
            .iter()
            .map(|part| part.f_detach()?.f_set_requires_grad(true))
            .collect()
    }

    /// The outputs as a function of the leaves.
    pub fn outputs_of(
        &self,
        leaves: &[Tensor],
        observations: &Tensor,
        actions: Option<&Tensor>,
    ) -> Result<Tensor, TchError> {
        self.shape.forward(leaves, observations, actions, self.kind)
    }

    /// The gradient of a scalar with respect to the leaves, `networks × parameters`.
    pub fn gradient(&self, of: &Tensor, leaves: &[Tensor]) -> Result<Tensor, TchError> {
        let networks = self.weights.size()[0];
        let parts = Tensor::f_run_backward(&[of], leaves, true, false)?;
        let flat: Vec<Tensor> =
            parts.iter().map(|part| part.f_reshape([networks, -1])).collect::<Result<_, _>>()?;
        Tensor::f_cat(&flat, 1)
    }

    /// A step of Adam along the gradient, each network's shortened to `clip`; then target ← target + τ (weights − target).
    pub fn step(
        &mut self,
        gradient: &Tensor,
        clip: Option<f32>,
        adam: &Adam,
        tau: f64,
    ) -> Result<(), TchError> {
        self.steps += 1;
        self.halves = None;
        let step = i32::try_from(self.steps).unwrap_or(i32::MAX);
        let rate = adam.rate / (1.0 - adam.beta1.powi(step));
        let root = 1.0 / (1.0 - adam.beta2.powi(step)).sqrt();
        no_grad(|| {
            let gradient = match clip {
                Some(longest) => {
                    let norms = norms(gradient)?.f_clamp_min(f64::from(longest))?;
                    gradient * (norms.f_reciprocal()? * f64::from(longest))
                }
                None => gradient.shallow_clone(),
            };
            if adam.weight_decay > 0.0 {
                for layer in &self.shape.layers {
                    let mut matrix = self.weights.f_narrow(1, layer.offset, layer.inputs * layer.outputs)?;
                    matrix.f_mul_scalar_(1.0 - adam.rate * adam.weight_decay).map(drop)?;
                }
            }
            self.first.f_lerp_(&gradient, 1.0 - adam.beta1).map(drop)?;
            self.second.f_lerp_(&gradient.f_square()?, 1.0 - adam.beta2).map(drop)?;
            let size = self.second.f_sqrt()? * root + adam.epsilon;
            self.weights -= self.first.f_div(&size)? * rate;
            self.targets.f_lerp_(&self.weights, tau).map(drop)
        })
    }

    /// Everything that must be kept to continue.
    pub fn state(&self) -> Result<EnsembleState<f32>> {
        Ok(EnsembleState {
            weights: numbers(&self.weights)?,
            targets: numbers(&self.targets)?,
            first_moments: numbers(&self.first)?,
            second_moments: numbers(&self.second)?,
            steps: self.steps,
        })
    }

    /// Whether the state belongs here.
    pub fn check(&self, state: &EnsembleState<f32>) -> Result<()> {
        state.check(self.weights.numel()).map_err(plugin_error)
    }

    /// Continues from a state that was [checked](Self::check).
    pub fn restore(&mut self, state: &EnsembleState<f32>) -> Result<()> {
        let put = |values: &[f32]| -> Result<Tensor, TchError> {
            Tensor::f_from_slice(values)?.f_view_as(&self.weights)?.f_to_device(self.weights.device())
        };
        let [weights, targets, first, second] =
            [&state.weights, &state.targets, &state.first_moments, &state.second_moments]
                .map(|part| put(part));
        let restored = (
            weights.map_err(failed)?,
            targets.map_err(failed)?,
            first.map_err(failed)?,
            second.map_err(failed)?,
        );
        (self.weights, self.targets, self.first, self.second) = restored;
        self.steps = state.steps;
        self.halves = None;
        Ok(())
    }
}

/// The Euclidean norm of each row, `rows × 1`.
pub fn norms(rows: &Tensor) -> Result<Tensor, TchError> {
    rows.f_square()?.f_sum_dim_intlist([1_i64].as_slice(), true, Kind::Float)?.f_sqrt()
}

/// A tensor's values.
pub fn numbers(tensor: &Tensor) -> Result<Vec<f32>> {
    let mut values = vec![0.0; tensor.numel()];
    read(tensor, &mut values)?;
    Ok(values)
}

/// Writes a tensor's values into a slice of the same length.
pub fn read(tensor: &Tensor, values: &mut [f32]) -> Result<()> {
    let flat = tensor.f_contiguous().and_then(|tensor| tensor.f_to_device(Device::Cpu)).map_err(failed)?;
    flat.f_copy_data(values, values.len()).map_err(failed)
}

/// torch's errors are the plugin's own.
pub fn failed(error: TchError) -> Error {
    Error::failed(format!("torch: {error}"))
}
