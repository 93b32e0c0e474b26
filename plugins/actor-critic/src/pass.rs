//! One network's forward and backward pass over a batch.
//!
//! Layer k: Yₖ = f(Yₖ₋₁ Wₖ + bₖ). At the layer where the action A enters, Z = Y W + A Wₐ + b: the concatenation is never built.
//! That also splits the forward pass: the *trunk* depends on the observation alone, so the values of several actions in the
//! same states share it. With Δₖ = ∂L/∂Zₖ: ∂L/∂Wₖ = Yₖ₋₁ᵀ Δₖ, ∂L/∂bₖ = Σ rows of Δₖ, ∂L/∂Yₖ₋₁ = Δₖ Wₖᵀ, ∂L/∂A = Δ Wₐᵀ.
//!
//! Where a layer has them, batch renormalisation stands before the product, then dropout and layer normalisation between it and f; each has a
//! file of its own.

use faer::Accum;

use crate::{
    Architecture, Real,
    batch_renorm::{Renormed, Statistics},
    dropout::{Dropout, multiply},
    kernels::{
        activate, activate_sums, differentiate, product, product_left_transposed, product_right_transposed,
        sum_rows,
    },
    layer::{Layer, Side},
    layer_norm::{self, LayerNorms},
    workspace::Workspace,
};

/// What a layer's product takes: the values themselves, or what batch renormalisation makes of them.
pub(crate) fn take_in<'a, T: Real>(
    layer: &Layer,
    side: Side,
    parameters: &[T],
    values: &'a [T],
    renormed: &'a mut [[Renormed<T>; 2]],
    statistics: Statistics,
) -> &'a [T] {
    if layer.batch_renorm.is_none() {
        return values;
    }
    let renormed = &mut renormed[layer.index][side as usize];
    renormed.forward(values, &layer.features(side, parameters), statistics);
    &renormed.outputs[..values.len()]
}

/// From the products to the layer's output.
pub(crate) fn finish<T: Real>(layer: &Layer, parameters: &[T], workspace: &mut Workspace<T>) {
    let range = workspace.range(layer);
    let drops = layer.dropout > 0.0 && workspace.dropout.is_on();
    let (output, bias) = (&mut workspace.activations[range.clone()], layer.parts(parameters).bias);
    if !drops && !layer.layer_norm {
        return activate(output, bias, layer.activation);
    }
    activate(output, bias, None);
    if drops {
        workspace.dropout.apply(layer.dropout, output, range.clone());
    }
    if !layer.layer_norm {
        return activate_sums(output, layer.activation);
    }
    let spreads = layer.index * workspace.size..(layer.index + 1) * workspace.size;
    layer_norm::normalise(output, layer.outputs, &mut workspace.norms.spreads[spreads]);
    workspace.norms.normal[range].copy_from_slice(output);
    let (gain, shift) = parameters[layer.layer_norm()].split_at(layer.outputs);
    output.chunks_exact_mut(layer.outputs).for_each(|row| multiply(row, gain));
    activate(output, shift, layer.activation);
}

impl Architecture {
    /// What depends on the observation alone. Sets the size of the batch.
    pub(crate) fn trunk<T: Real>(&self, parameters: &[T], observations: &[T], workspace: &mut Workspace<T>) {
        let size = observations.len() / self.observation_len();
        workspace.resize(self, size);
        for layer in &self.layers[..(self.join + 1).min(self.layers.len())] {
            let weights = layer.parts(parameters).weights;
            let io = workspace.io(layer, observations);
            let input = take_in(layer, Side::Below, parameters, io.input, io.renormed, io.statistics);
            let shape = (size, layer.inputs, layer.outputs);
            if layer.index == self.join {
                product(&mut io.joint[..size * layer.outputs], Accum::Replace, input, weights, shape);
            } else {
                product(io.output, Accum::Replace, input, weights, shape);
                finish(layer, parameters, workspace);
            }
        }
    }

    /// The rest, for one action per observation of the trunk.
    pub(crate) fn head<T: Real>(&self, parameters: &[T], actions: &[T], workspace: &mut Workspace<T>) {
        let size = workspace.size;
        for layer in self.layers.iter().skip(self.join) {
            let parts = layer.parts(parameters);
            let io = workspace.io(layer, &[]);
            if layer.index == self.join {
                io.output.copy_from_slice(&io.joint[..io.output.len()]);
                let actions = take_in(layer, Side::Action, parameters, actions, io.renormed, io.statistics);
                let shape = (size, layer.action_inputs, layer.outputs);
                product(io.output, Accum::Add, actions, parts.action_weights, shape);
            } else {
                let input = take_in(layer, Side::Below, parameters, io.input, io.renormed, io.statistics);
                product(io.output, Accum::Replace, input, parts.weights, (size, layer.inputs, layer.outputs));
            }
            finish(layer, parameters, workspace);
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
        for layer in self.layers.iter().rev() {
            let Workspace { deltas, activations, gradients, renormed, below_deltas, norms, dropout, .. } =
                &mut *workspace;
            let range = size * layer.outputs_before..size * (layer.outputs_before + layer.outputs);
            let (before, from) = deltas.split_at_mut(range.start);
            let delta = &mut from[..range.len()];
            differentiate(delta, &activations[range.clone()], layer.activation);
            let (gain, shift) = gradients[layer.layer_norm()].split_at_mut(layer.layer_norm().len() / 2);
            undo_normalisation(layer, parameters, delta, (norms, dropout), size, Some([gain, shift]));

            let shape = (size, layer.inputs, layer.outputs);
            let action_shape = (size, layer.action_inputs, layer.outputs);
            let weights = layer.parts(parameters);
            let input = match layer.index {
                0 => observations,
                _ => &activations[range.start - size * layer.inputs..range.start],
            };
            let parts = layer.parts_mut(gradients);
            if layer.batch_renorm.is_none() {
                product_left_transposed(parts.weights, input, delta, shape);
                if layer.index == self.join {
                    product_left_transposed(parts.action_weights, actions, delta, action_shape);
                }
                sum_rows(parts.bias, delta);
                if layer.index > 0 {
                    let below = &mut before[range.start - size * layer.inputs..];
                    product_right_transposed(below, delta, weights.weights, shape);
                }
                continue;
            }
            let [of_below, of_action] = &mut renormed[layer.index];
            product_left_transposed(parts.weights, &of_below.outputs[..input.len()], delta, shape);
            sum_rows(parts.bias, delta);
            if layer.index == self.join {
                let outputs = &of_action.outputs[..actions.len()];
                product_left_transposed(parts.action_weights, outputs, delta, action_shape);
                let deltas = &mut below_deltas[..actions.len()];
                product_right_transposed(deltas, delta, weights.action_weights, action_shape);
                let gain = layer.features(Side::Action, parameters).gain;
                of_action.backward(deltas, gain, Some(layer.renorm_gradients(Side::Action, gradients)));
            }
            let below = match layer.index {
                0 => &mut below_deltas[..input.len()],
                _ => &mut before[range.start - size * layer.inputs..],
            };
            product_right_transposed(below, delta, weights.weights, shape);
            let gain = layer.features(Side::Below, parameters).gain;
            of_below.backward(below, gain, Some(layer.renorm_gradients(Side::Below, gradients)));
        }
    }

    /// From ∂L/∂output in the workspace to ∂L/∂action (`size × action_len`); no gradient of the parameters is formed.
    pub(crate) fn backward_to_action<T: Real>(
        &self,
        parameters: &[T],
        action_gradients: &mut [T],
        workspace: &mut Workspace<T>,
    ) {
        let size = workspace.size;
        for layer in self.layers.iter().skip(self.join).rev() {
            let Workspace { deltas, activations, renormed, norms, dropout, .. } = &mut *workspace;
            let range = size * layer.outputs_before..size * (layer.outputs_before + layer.outputs);
            let (before, from) = deltas.split_at_mut(range.start);
            let delta = &mut from[..range.len()];
            differentiate(delta, &activations[range.clone()], layer.activation);
            undo_normalisation(layer, parameters, delta, (norms, dropout), size, None);
            let parts = layer.parts(parameters);
            let (side, below, weights, inputs) = if layer.index == self.join {
                (Side::Action, &mut *action_gradients, parts.action_weights, layer.action_inputs)
            } else {
                let below = &mut before[range.start - size * layer.inputs..];
                (Side::Below, below, parts.weights, layer.inputs)
            };
            product_right_transposed(below, delta, weights, (size, inputs, layer.outputs));
            if layer.batch_renorm.is_some() {
                let gain = layer.features(side, parameters).gain;
                renormed[layer.index][side as usize].backward(below, gain, None);
            }
        }
    }

    /// Moves the running statistics towards those of the last pass, which was over a batch.
    pub(crate) fn move_statistics<T: Real>(&self, parameters: &mut [T], workspace: &Workspace<T>) {
        for layer in &self.layers {
            let Some(settings) = layer.batch_renorm else { continue };
            for side in [Side::Below, Side::Action] {
                if side == Side::Action && layer.index != self.join {
                    continue;
                }
                let [.., mean, variance] = layer.batch_renorm_of(side);
                let (before, from) = parameters.split_at_mut(variance.start);
                let renormed = &workspace.renormed[layer.index][side as usize];
                renormed.move_statistics(settings.momentum, &mut before[mean], &mut from[..variance.len()]);
            }
        }
    }
}

/// From ∂L/∂(input of the activation) to ∂L/∂(sums), through layer normalisation and dropout.
fn undo_normalisation<T: Real>(
    layer: &Layer,
    parameters: &[T],
    delta: &mut [T],
    (norms, dropout): (&LayerNorms<T>, &Dropout<T>),
    size: usize,
    gradients: Option<[&mut [T]; 2]>,
) {
    let range = size * layer.outputs_before..size * (layer.outputs_before + layer.outputs);
    if layer.layer_norm {
        let gain = &parameters[layer.layer_norm()][..layer.outputs];
        let spreads = &norms.spreads[layer.index * size..(layer.index + 1) * size];
        layer_norm::differentiate(delta, &norms.normal[range.clone()], spreads, gain, gradients);
    }
    if layer.dropout > 0.0 && dropout.is_on() {
        multiply(delta, &dropout.factors[range]);
    }
}
