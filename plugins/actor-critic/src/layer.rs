//! One layer of a network: its shape, and where what belongs to it lies among the parameters.

use std::ops::Range;

use crate::{Activation, BatchRenorm, batch_renorm::Features};

/// One affine layer with what belongs to it. Its parameters lie at `offset`: the weights, `inputs × outputs` row-major; the rows of the action
/// (`action_inputs × outputs`); the bias (`outputs`); scale and shift of a layer normalisation (`outputs` each); scale, shift, running mean
/// and running variance of a batch renormalisation (`inputs + action_inputs` each). The running ones are no weights: their gradient is 0.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Layer {
    /// Its place among the layers.
    pub(crate) index: usize,
    pub(crate) inputs: usize,
    pub(crate) action_inputs: usize,
    pub(crate) outputs: usize,
    pub(crate) offset: usize,
    /// How many outputs the layers before have together.
    pub(crate) outputs_before: usize,
    pub(crate) activation: Option<Activation>,
    pub(crate) layer_norm: bool,
    pub(crate) dropout: f32,
    pub(crate) batch_renorm: Option<BatchRenorm>,
}

/// The three affine parts of a layer's weights.
pub(crate) struct Parts<S> {
    pub(crate) weights: S,
    pub(crate) action_weights: S,
    pub(crate) bias: S,
}

/// The inputs of a layer: those from below, or those of the action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    Below,
    Action,
}

impl Layer {
    /// How many values the layer sees.
    pub(crate) fn rows(&self) -> usize {
        self.inputs + self.action_inputs
    }

    fn affine_len(&self) -> usize {
        (self.rows() + 1) * self.outputs
    }

    pub(crate) fn layer_norm_len(&self) -> usize {
        if self.layer_norm { 2 * self.outputs } else { 0 }
    }

    pub(crate) fn parameter_len(&self) -> usize {
        let renorm_len = if self.batch_renorm.is_some() { 4 * self.rows() } else { 0 };
        self.affine_len() + self.layer_norm_len() + renorm_len
    }

    /// Where scale and shift of the layer normalisation lie together.
    pub(crate) fn layer_norm(&self) -> Range<usize> {
        let begin = self.offset + self.affine_len();
        begin..begin + self.layer_norm_len()
    }

    /// Where scale, shift, running mean and running variance of the batch renormalisation lie, of all features.
    pub(crate) fn batch_renorm(&self) -> [Range<usize>; 4] {
        let begin = self.layer_norm().end;
        std::array::from_fn(|part| begin + part * self.rows()..begin + (part + 1) * self.rows())
    }

    /// The same, of the features of one side.
    pub(crate) fn batch_renorm_of(&self, side: Side) -> [Range<usize>; 4] {
        let of_side = |all: Range<usize>| match side {
            Side::Below => all.start..all.start + self.inputs,
            Side::Action => all.start + self.inputs..all.end,
        };
        self.batch_renorm().map(of_side)
    }

    pub(crate) fn features<'a, T>(&self, side: Side, parameters: &'a [T]) -> Features<'a, T> {
        let [gain, shift, mean, variance] = self.batch_renorm_of(side).map(|range| &parameters[range]);
        Features { gain, shift, mean, variance }
    }

    /// Where the gradients of a batch renormalisation's scale and shift belong, of the features of one side.
    pub(crate) fn renorm_gradients<'a, T>(&self, side: Side, gradients: &'a mut [T]) -> [&'a mut [T]; 2] {
        let [gain, shift, ..] = self.batch_renorm_of(side);
        let (before, from) = gradients.split_at_mut(shift.start);
        [&mut before[gain], &mut from[..shift.len()]]
    }

    pub(crate) fn parts<'a, T>(&self, parameters: &'a [T]) -> Parts<&'a [T]> {
        let own = &parameters[self.offset..self.offset + self.affine_len()];
        let (weights, rest) = own.split_at(self.inputs * self.outputs);
        let (action_weights, bias) = rest.split_at(self.action_inputs * self.outputs);
        Parts { weights, action_weights, bias }
    }

    pub(crate) fn parts_mut<'a, T>(&self, parameters: &'a mut [T]) -> Parts<&'a mut [T]> {
        let own = &mut parameters[self.offset..self.offset + self.affine_len()];
        let (weights, rest) = own.split_at_mut(self.inputs * self.outputs);
        let (action_weights, bias) = rest.split_at_mut(self.action_inputs * self.outputs);
        Parts { weights, action_weights, bias }
    }
}
