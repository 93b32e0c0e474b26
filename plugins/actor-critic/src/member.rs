//! One network of an ensemble, with the steps of which an update consists.

use crate::{
    Adam, Architecture, Real,
    adam::Slices,
    batch_renorm::Statistics,
    kernels::{norm, scale},
    workspace::Workspace,
};

/// A network, its target network and its optimiser's state, in the hands of one thread.
///
/// The usual order: [`target_values`](Self::target_values); then [`observe`](Self::observe) and
/// [`values`](Self::values), write ∂L/∂values into [`outputs`](Self::outputs), [`backward`](Self::backward), [`step`](Self::step).
pub struct Member<'a, T: Real> {
    pub(crate) index: usize,
    pub(crate) architecture: &'a Architecture,
    pub(crate) slices: Slices<'a, T>,
    pub(crate) workspace: &'a mut Workspace<T>,
    /// Which step [`step`](Self::step) would be, from 1.
    pub(crate) next_step: u64,
}

impl<T: Real> Member<'_, T> {
    /// Its place in the ensemble.
    pub fn index(&self) -> usize {
        self.index
    }

    /// The target network's outputs: `size × output_len`. `actions` is empty for an actor.
    pub fn target_values(&mut self, observations: &[T], actions: &[T]) -> &[T] {
        self.workspace.statistics = Statistics::Running;
        self.architecture.trunk(self.slices.targets, observations, self.workspace);
        self.architecture.head(self.slices.targets, actions, self.workspace);
        self.workspace.outputs(self.architecture).0
    }

    /// Takes in the observations; everything that does not depend on the action is computed here, once.
    pub fn observe(&mut self, observations: &[T]) {
        self.workspace.statistics = Statistics::Running;
        self.architecture.trunk(self.slices.weights, observations, self.workspace);
    }

    /// The network's outputs for the observations last taken in: `size × output_len`. `actions` is empty for an actor.
    pub fn values(&mut self, actions: &[T]) -> &[T] {
        self.architecture.head(self.slices.weights, actions, self.workspace);
        self.workspace.outputs(self.architecture).0
    }

    /// The network's outputs for a batch, as [`observe`](Self::observe) and [`values`](Self::values) give them, but that batch
    /// renormalisation takes the batch's statistics.
    pub fn learn(&mut self, observations: &[T], actions: &[T]) -> &[T] {
        if let Some(settings) = self.architecture.batch_renorm() {
            let is_warm = self.next_step > settings.warm_up;
            self.workspace.statistics = Statistics::Batch { is_warm };
        }
        self.architecture.trunk(self.slices.weights, observations, self.workspace);
        self.architecture.head(self.slices.weights, actions, self.workspace);
        self.workspace.outputs(self.architecture).0
    }

    /// Moves the running statistics of batch renormalisation towards those of the last pass, which was [`learn`](Self::learn)'s.
    pub fn keep_statistics(&mut self) {
        self.architecture.move_statistics(self.slices.weights, self.workspace);
    }

    /// The last outputs, and the place for the gradient of the loss with respect to them.
    pub fn outputs(&mut self) -> (&[T], &mut [T]) {
        self.workspace.outputs(self.architecture)
    }

    /// Forms the gradient of the loss with respect to the weights, for the last observations and actions.
    pub fn backward(&mut self, observations: &[T], actions: &[T]) {
        self.architecture.backward(self.slices.weights, observations, actions, self.workspace);
    }

    /// Writes ∂value/∂action of each row's last value into `gradients` (`size × action_len`). Overwrites the gradient in
    /// [`outputs`](Self::outputs), not that of the weights.
    pub fn action_gradients(&mut self, gradients: &mut [T]) {
        self.outputs().1.fill(T::ONE);
        self.architecture.backward_to_action(self.slices.weights, gradients, self.workspace);
    }

    /// Euclidean norm of the gradient of the weights.
    pub fn gradient_norm(&self) -> T {
        norm(&self.workspace.gradients)
    }

    /// Shortens the gradient of the weights to the given norm if it is longer.
    pub fn clip_gradient(&mut self, longest: T) {
        let length = self.gradient_norm();
        if length > longest {
            scale(&mut self.workspace.gradients, longest / length);
        }
    }

    /// One step of the optimiser along the gradient, then target ← target + `tau` (weights − target).
    pub fn step(&mut self, adam: &Adam, tau: f64) {
        let Slices { weights, targets, first, second } = &mut self.slices;
        if adam.weight_decay > 0.0 {
            self.architecture.decay(weights, T::from_f64(1.0 - adam.rate * adam.weight_decay));
        }
        adam.apply(
            Slices { weights, targets, first, second },
            &self.workspace.gradients,
            self.next_step,
            tau,
        );
    }

    /// [`clip_gradient`](Self::clip_gradient) if a longest norm is given, then [`step`](Self::step).
    pub fn clipped_step(&mut self, longest: Option<f32>, adam: &Adam, tau: f64) {
        if let Some(longest) = longest {
            self.clip_gradient(T::from_f64(f64::from(longest)));
        }
        self.step(adam, tau);
    }

    /// The weights themselves.
    pub fn weights(&self) -> &[T] {
        self.slices.weights
    }
}

/// Successive members of an ensemble in the hands of one thread, for instance TD3's twins. They share the buffers of a pass, so that what
/// one member computed is gone once another was used, unless the ensemble [keeps more](crate::Ensemble::keep_passes).
pub struct Group<'a, T: Real> {
    pub(crate) index: usize,
    pub(crate) size: usize,
    pub(crate) architecture: &'a Architecture,
    pub(crate) slices: Slices<'a, T>,
    pub(crate) workspaces: &'a mut [Workspace<T>],
    pub(crate) next_step: u64,
}

impl<T: Real> Group<'_, T> {
    /// Its place among the groups.
    pub fn index(&self) -> usize {
        self.index
    }

    /// How many members it has.
    pub fn size(&self) -> usize {
        self.size
    }

    /// A member, counted from 0 within the group.
    pub fn member(&mut self, index: usize) -> Member<'_, T> {
        let length = self.architecture.parameter_len();
        let passes = self.workspaces.len();
        Member {
            index: self.index * self.size + index,
            architecture: self.architecture,
            slices: self.slices.part(index * length..(index + 1) * length),
            workspace: &mut self.workspaces[index % passes],
            next_step: self.next_step,
        }
    }
}
