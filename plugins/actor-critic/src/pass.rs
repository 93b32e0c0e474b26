//! One network's forward and backward pass over a batch.
//!
//! Layer k: Yₖ = f(Yₖ₋₁ Wₖ + bₖ). At the layer where the action A enters, Z = Y W + A Wₐ + b: the concatenation is never built.
//! That also splits the forward pass: the *trunk* depends on the observation alone, so the values of several actions in the
//! same states share it. With Δₖ = ∂L/∂Zₖ: ∂L/∂Wₖ = Yₖ₋₁ᵀ Δₖ, ∂L/∂bₖ = Σ rows of Δₖ, ∂L/∂Yₖ₋₁ = Δₖ Wₖᵀ, ∂L/∂A = Δ Wₐᵀ.

use faer::Accum;

use crate::{
    Architecture, Real,
    architecture::Layer,
    kernels::{
        activate, differentiate, product, product_left_transposed, product_right_transposed, sum_rows,
    },
};

/// Buffers of one thread; they grow to the largest batch seen and stay.
#[derive(Debug, Clone, Default)]
pub(crate) struct Workspace<T> {
    /// Rows of the batch in work.
    pub(crate) size: usize,
    /// Outputs of all layers, one layer after the other, `size` rows each.
    activations: Vec<T>,
    /// ∂L/∂output, laid out as the activations.
    deltas: Vec<T>,
    /// The observation's share of the pre-activation where the action enters.
    joint: Vec<T>,
    /// ∂L/∂parameters, laid out as the parameters.
    pub(crate) gradients: Vec<T>,
}

impl<T: Real> Workspace<T> {
    pub(crate) fn resize(&mut self, architecture: &Architecture, size: usize) {
        let grow = |buffer: &mut Vec<T>, length: usize| {
            if buffer.len() < length {
                buffer.resize(length, T::ZERO);
            }
        };
        self.size = size;
        grow(&mut self.activations, size * architecture.activation_len());
        grow(&mut self.deltas, size * architecture.activation_len());
        grow(&mut self.joint, size * architecture.layers.get(architecture.join).map_or(0, |l| l.outputs));
        grow(&mut self.gradients, architecture.parameter_len());
    }

    /// Outputs of the network, and the place for ∂L/∂output.
    pub(crate) fn outputs(&mut self, architecture: &Architecture) -> (&[T], &mut [T]) {
        let range = self.range(architecture.last());
        (&self.activations[range.clone()], &mut self.deltas[range])
    }

    fn range(&self, layer: &Layer) -> std::ops::Range<usize> {
        self.size * layer.outputs_before..self.size * (layer.outputs_before + layer.outputs)
    }

    /// Input and output of a layer.
    pub(crate) fn layer_io<'a>(
        &'a mut self,
        layer: &Layer,
        observations: &'a [T],
    ) -> (&'a [T], &'a mut [T], &'a mut [T]) {
        let (before, from) = self.activations.split_at_mut(self.size * layer.outputs_before);
        let input = match layer.outputs_before {
            0 => observations,
            _ => &before[before.len() - self.size * layer.inputs..],
        };
        (input, &mut from[..self.size * layer.outputs], &mut self.joint)
    }
}

impl Architecture {
    /// What depends on the observation alone. Sets the size of the batch.
    pub(crate) fn trunk<T: Real>(&self, parameters: &[T], observations: &[T], workspace: &mut Workspace<T>) {
        let size = observations.len() / self.observation_len();
        workspace.resize(self, size);
        for layer in &self.layers[..self.join.min(self.layers.len())] {
            let parts = layer.parts(parameters);
            let (input, output, _) = workspace.layer_io(layer, observations);
            product(output, Accum::Replace, input, parts.weights, (size, layer.inputs, layer.outputs));
            activate(output, parts.bias, layer.activation);
        }
        if let Some(layer) = self.layers.get(self.join) {
            let weights = layer.parts(parameters).weights;
            let (input, _, joint) = workspace.layer_io(layer, observations);
            let joint = &mut joint[..size * layer.outputs];
            product(joint, Accum::Replace, input, weights, (size, layer.inputs, layer.outputs));
        }
    }

    /// The rest, for one action per observation of the trunk.
    pub(crate) fn head<T: Real>(&self, parameters: &[T], actions: &[T], workspace: &mut Workspace<T>) {
        let size = workspace.size;
        for (index, layer) in self.layers.iter().enumerate().skip(self.join) {
            let parts = layer.parts(parameters);
            let (input, output, joint) = workspace.layer_io(layer, &[]);
            if index == self.join {
                output.copy_from_slice(&joint[..output.len()]);
                let shape = (size, layer.action_inputs, layer.outputs);
                product(output, Accum::Add, actions, parts.action_weights, shape);
            } else {
                product(output, Accum::Replace, input, parts.weights, (size, layer.inputs, layer.outputs));
            }
            activate(output, parts.bias, layer.activation);
        }
    }

    /// From ∂L/∂output in the workspace to ∂L/∂parameters in `workspace.gradients`.
    pub(crate) fn backward<T: Real>(
        &self,
        parameters: &[T],
        observations: &[T],
        actions: &[T],
        workspace: &mut Workspace<T>,
    ) {
        let size = workspace.size;
        for (index, layer) in self.layers.iter().enumerate().rev() {
            let range = workspace.range(layer);
            let (before, from) = workspace.deltas.split_at_mut(range.start);
            let delta = &mut from[..range.len()];
            differentiate(delta, &workspace.activations[range.clone()], layer.activation);

            let input = match index {
                0 => observations,
                _ => &workspace.activations[range.start - size * layer.inputs..range.start],
            };
            let gradients = layer.parts_mut(&mut workspace.gradients);
            let shape = (size, layer.inputs, layer.outputs);
            product_left_transposed(gradients.weights, input, delta, shape);
            if index == self.join {
                let shape = (size, layer.action_inputs, layer.outputs);
                product_left_transposed(gradients.action_weights, actions, delta, shape);
            }
            sum_rows(gradients.bias, delta);
            if index > 0 {
                let below = &mut before[range.start - size * layer.inputs..];
                product_right_transposed(below, delta, layer.parts(parameters).weights, shape);
            }
        }
    }

    /// From ∂L/∂output in the workspace to ∂L/∂action (`size × action_len`); no gradient of the parameters is formed.
    pub(crate) fn backward_to_action<T: Real>(
        &self,
        parameters: &[T],
        gradients: &mut [T],
        workspace: &mut Workspace<T>,
    ) {
        let size = workspace.size;
        for (index, layer) in self.layers.iter().enumerate().skip(self.join).rev() {
            let range = workspace.range(layer);
            let (before, from) = workspace.deltas.split_at_mut(range.start);
            let delta = &mut from[..range.len()];
            differentiate(delta, &workspace.activations[range.clone()], layer.activation);
            let parts = layer.parts(parameters);
            if index == self.join {
                let shape = (size, layer.action_inputs, layer.outputs);
                product_right_transposed(gradients, delta, parts.action_weights, shape);
            } else {
                let below = &mut before[range.start - size * layer.inputs..];
                let shape = (size, layer.inputs, layer.outputs);
                product_right_transposed(below, delta, parts.weights, shape);
            }
        }
    }
}
