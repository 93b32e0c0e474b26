//! The buffers of a pass.

use crate::{
    Architecture, Real,
    batch_renorm::{Renormed, Statistics},
    dropout::Dropout,
    layer::Layer,
    layer_norm::LayerNorms,
};

/// Buffers of one thread; they grow to the largest batch seen and stay.
#[derive(Debug, Clone, Default)]
pub(crate) struct Workspace<T> {
    /// Rows of the batch in work.
    pub(crate) size: usize,
    /// Outputs of all layers, one layer after the other, `size` rows each.
    pub(crate) activations: Vec<T>,
    /// ∂L/∂output, laid out as the activations.
    pub(crate) deltas: Vec<T>,
    /// The observation's share of the pre-activation where the action enters.
    joint: Vec<T>,
    /// ∂L/∂parameters, laid out as the parameters.
    pub(crate) gradients: Vec<T>,
    pub(crate) norms: LayerNorms<T>,
    pub(crate) dropout: Dropout<T>,
    /// Of each layer, from below and of the action.
    pub(crate) renormed: Vec<[Renormed<T>; 2]>,
    /// With which statistics these are made.
    pub(crate) statistics: Statistics,
    /// ∂L/∂ of an observation or action, which only a batch renormalisation asks for.
    pub(crate) below_deltas: Vec<T>,
}

/// What a layer reads and writes.
pub(crate) struct LayerIo<'a, T> {
    pub(crate) input: &'a [T],
    pub(crate) output: &'a mut [T],
    pub(crate) joint: &'a mut [T],
    pub(crate) renormed: &'a mut [[Renormed<T>; 2]],
    pub(crate) statistics: Statistics,
}

impl<T: Real> Workspace<T> {
    /// For another group of networks: drops units if a seed is given, and uses running statistics.
    pub(crate) fn begin(&mut self, seed: Option<u64>, group: usize) {
        self.dropout.begin(seed, group);
        self.statistics = Statistics::Running;
    }

    pub(crate) fn resize(&mut self, architecture: &Architecture, size: usize) {
        let grow = |buffer: &mut Vec<T>, length: usize| {
            if buffer.len() < length {
                buffer.resize(length, T::ZERO);
            }
        };
        self.size = size;
        let length = size * architecture.activation_len();
        grow(&mut self.activations, length);
        grow(&mut self.deltas, length);
        grow(&mut self.joint, size * architecture.layers.get(architecture.join).map_or(0, |l| l.outputs));
        grow(&mut self.gradients, architecture.parameter_len());
        let layers = &architecture.layers;
        if layers[0].layer_norm {
            grow(&mut self.norms.normal, length);
            grow(&mut self.norms.spreads, size * layers.len());
        }
        if layers[0].dropout > 0.0 {
            grow(&mut self.dropout.factors, length);
        }
        if layers[0].batch_renorm.is_some() {
            grow(
                &mut self.below_deltas,
                size * architecture.observation_len().max(architecture.action_len()),
            );
            self.renormed.resize_with(layers.len(), Default::default);
        }
    }

    /// Outputs of the network, and the place for ∂L/∂output.
    pub(crate) fn outputs(&mut self, architecture: &Architecture) -> (&[T], &mut [T]) {
        let range = self.range(architecture.last());
        (&self.activations[range.clone()], &mut self.deltas[range])
    }

    /// Where a layer's outputs lie.
    pub(crate) fn range(&self, layer: &Layer) -> std::ops::Range<usize> {
        self.size * layer.outputs_before..self.size * (layer.outputs_before + layer.outputs)
    }

    /// Input and output of a layer, and what a pass keeps.
    pub(crate) fn io<'a>(&'a mut self, layer: &Layer, observations: &'a [T]) -> LayerIo<'a, T> {
        let (before, from) = self.activations.split_at_mut(self.size * layer.outputs_before);
        let input = match layer.index {
            0 => observations,
            _ => &before[before.len() - self.size * layer.inputs..],
        };
        LayerIo {
            input,
            output: &mut from[..self.size * layer.outputs],
            joint: &mut self.joint,
            renormed: &mut self.renormed,
            statistics: self.statistics,
        }
    }
}
