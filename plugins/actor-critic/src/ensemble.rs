//! Networks of one shape, their weights side by side, worked on by a fixed number of threads.

use rand::{Rng, RngExt};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::{
    Architecture, Error, Group, Initialisation, Member, Real,
    adam::Slices,
    half::{self, Copies},
    workspace::Workspace,
};

/// What an ensemble remembers: everything that the next step depends on. Each member's parameters lie together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct EnsembleState<T: Real> {
    /// The networks' weights.
    pub weights: Vec<T>,
    /// Those of the target networks.
    pub targets: Vec<T>,
    /// Adam's running means of the gradients.
    pub first_moments: Vec<T>,
    /// And of their squares.
    pub second_moments: Vec<T>,
    /// How many steps were taken.
    pub steps: u64,
}

impl<T: Real> EnsembleState<T> {
    /// Whether it belongs to networks with so many weights altogether.
    ///
    /// # Errors
    /// [`Error::StateLength`] for another number, [`Error::StateNotFinite`] for NaN or infinity.
    pub fn check(&self, expected: usize) -> Result<(), Error> {
        for part in [&self.weights, &self.targets, &self.first_moments, &self.second_moments] {
            if part.len() != expected {
                return Err(Error::StateLength { found: part.len(), expected });
            }
            if !part.iter().all(|value| Real::is_finite(*value)) {
                return Err(Error::StateNotFinite);
            }
        }
        Ok(())
    }
}

/// An ensemble of networks with target networks and optimiser state.
///
/// Members are dealt out to threads in contiguous runs and each is worked on by one thread alone, so results are bitwise
/// independent of the number of threads. A member is taken through all steps of an update before the next, while its weights
/// are in the cache. After the first call with the largest batch nothing is allocated, except, with several threads, one
/// block per 63 calls in rayon's queue.
#[derive(Debug)]
pub struct Ensemble<T: Real> {
    architecture: Architecture,
    members: usize,
    state: EnsembleState<T>,
    /// Per thread, one after the other, as many as a group keeps passes.
    workspaces: Vec<Workspace<T>>,
    passes: usize,
    /// In an update, if units are dropped.
    dropout_seed: Option<u64>,
    copies: Option<Copies>,
    pool: Option<rayon::ThreadPool>,
}

impl<T: Real> Ensemble<T> {
    /// Draws initial weights; target networks begin equal.
    ///
    /// # Errors
    /// [`Error::NoMembers`], or [`Error::Threads`] if they cannot be started.
    pub fn new(
        architecture: Architecture,
        initialisation: Initialisation,
        members: usize,
        threads: usize,
        rng: &mut impl Rng,
    ) -> Result<Self, Error> {
        if members == 0 {
            return Err(Error::NoMembers);
        }
        let length = architecture.parameter_len();
        let mut weights = vec![T::ZERO; members * length];
        for weights in weights.chunks_exact_mut(length) {
            architecture.initialise(initialisation, weights, rng);
        }
        let workers = threads.clamp(1, members);
        let pool = match workers {
            1 => None,
            _ => Some(
                rayon::ThreadPoolBuilder::new()
                    .num_threads(workers)
                    .build()
                    .map_err(|error| Error::Threads(error.to_string()))?,
            ),
        };
        let zeros = vec![T::ZERO; weights.len()];
        let state = EnsembleState {
            targets: weights.clone(),
            weights,
            first_moments: zeros.clone(),
            second_moments: zeros,
            steps: 0,
        };
        let workspaces = vec![Workspace::default(); workers];
        Ok(Self {
            architecture,
            members,
            state,
            workspaces,
            passes: 1,
            dropout_seed: None,
            copies: None,
            pool,
        })
    }

    /// Lets each of the first `passes` members of a group have buffers of its own, so that their passes can be used together.
    pub fn keep_passes(&mut self, passes: usize) {
        let threads = self.threads();
        self.passes = passes.max(1);
        self.workspaces.resize(threads * self.passes, Workspace::default());
    }

    fn threads(&self) -> usize {
        self.workspaces.len() / self.passes
    }

    /// How many networks there are.
    pub fn members(&self) -> usize {
        self.members
    }

    /// Their common shape.
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// How many optimiser steps every member has taken.
    pub fn steps(&self) -> u64 {
        self.state.steps
    }

    /// Begins an update, in which networks with dropout drop units, which others never do. Where none are, no random number is drawn.
    pub fn begin_update(&mut self, rng: &mut impl Rng) {
        self.dropout_seed = self.architecture.drops_units().then(|| rng.random());
    }

    /// Says that every member has taken a step. To be called once per update, after the members' own steps; it ends the update.
    pub fn count_step(&mut self) {
        self.dropout_seed = None;
        self.state.steps += 1;
        self.weights_have_changed();
    }

    fn weights_have_changed(&mut self) {
        if let Some(copies) = &mut self.copies {
            copies.is_stale = true;
        }
    }

    /// Adds `value` to the bias of every network's outputs, target networks included: optimistic initial values.
    pub fn raise_outputs(&mut self, value: T) {
        let (architecture, length) = (&self.architecture, self.architecture.parameter_len());
        for parameters in [&mut self.state.weights, &mut self.state.targets] {
            for member in parameters.chunks_exact_mut(length) {
                for bias in architecture.last().parts_mut(member).bias {
                    *bias += value;
                }
            }
        }
        self.weights_have_changed();
    }

    /// One member, worked on by the calling thread.
    pub fn member(&mut self, index: usize) -> Member<'_, T> {
        let length = self.architecture.parameter_len();
        let EnsembleState { weights, targets, first_moments, second_moments, steps } = &mut self.state;
        let all = Slices { weights, targets, first: first_moments, second: second_moments };
        self.workspaces[0].begin(None, 0);
        Member {
            index,
            architecture: &self.architecture,
            slices: all.into_part(index * length..(index + 1) * length),
            workspace: &mut self.workspaces[0],
            next_step: *steps + 1,
        }
    }

    /// Calls `work` once per member, with that member's entry of `results`, spread over the threads.
    ///
    /// # Panics
    /// If `results` has not one entry per member.
    pub fn for_each_member<R: Send>(
        &mut self,
        results: &mut [R],
        work: impl Fn(&mut Member<'_, T>, &mut R) + Sync,
    ) {
        self.for_each_group(1, results, |group, result| work(&mut group.member(0), result));
    }

    /// Calls `work` once per group of `size` successive members, with that group's entry of `results`, spread over the
    /// threads. A group is worked on by one thread.
    ///
    /// # Panics
    /// If the members cannot be divided into such groups, or `results` has not one entry per group.
    pub fn for_each_group<R: Send>(
        &mut self,
        size: usize,
        results: &mut [R],
        work: impl Fn(&mut Group<'_, T>, &mut R) + Sync,
    ) {
        assert_eq!(results.len() * size, self.members, "one result per group");
        let length = size * self.architecture.parameter_len();
        let share = results.len().div_ceil(self.threads());
        let (next_step, passes, seed) = (self.state.steps + 1, self.passes, self.dropout_seed);
        let architecture = &self.architecture;
        let EnsembleState { weights, targets, first_moments, second_moments, .. } = &mut self.state;

        let run =
            |first: usize, mut slices: Slices<'_, T>, results: &mut [R], workspaces: &mut [Workspace<T>]| {
                for (offset, result) in results.iter_mut().enumerate() {
                    let slices = slices.part(offset * length..(offset + 1) * length);
                    let index = first + offset;
                    for (pass, workspace) in workspaces.iter_mut().enumerate() {
                        workspace.begin(seed, index * passes + pass);
                    }
                    work(&mut Group { index, size, architecture, slices, workspaces, next_step }, result);
                }
            };
        let Some(pool) = &self.pool else {
            let slices = Slices { weights, targets, first: first_moments, second: second_moments };
            return run(0, slices, results, &mut self.workspaces);
        };
        let workspaces = &mut self.workspaces;
        pool.install(|| {
            weights
                .par_chunks_mut(share * length)
                .zip(targets.par_chunks_mut(share * length))
                .zip(first_moments.par_chunks_mut(share * length))
                .zip(second_moments.par_chunks_mut(share * length))
                .zip(results.par_chunks_mut(share))
                .zip(workspaces.par_chunks_mut(passes))
                .enumerate()
                .for_each(|(chunk, (((((weights, targets), first), second), results), workspaces))| {
                    run(chunk * share, Slices { weights, targets, first, second }, results, workspaces);
                });
        });
    }

    /// All networks' weights, one network after the other.
    pub(crate) fn weights(&self) -> &[T] {
        &self.state.weights
    }

    /// The same of the target networks.
    pub(crate) fn target_weights(&self) -> &[T] {
        &self.state.targets
    }

    /// Everything that must be kept to continue exactly.
    pub fn state(&self) -> &EnsembleState<T> {
        &self.state
    }

    /// Whether `state` could be restored.
    ///
    /// # Errors
    /// As [`EnsembleState::check`].
    pub fn check_state(&self, state: &EnsembleState<T>) -> Result<(), Error> {
        state.check(self.state.weights.len())
    }

    /// Continues from a state.
    ///
    /// # Errors
    /// As [`check_state`](Self::check_state); nothing has changed then.
    pub fn restore(&mut self, state: EnsembleState<T>) -> Result<(), Error> {
        self.check_state(&state)?;
        self.state = state;
        self.weights_have_changed();
        Ok(())
    }
}

impl Ensemble<f32> {
    /// Keeps copies of the weights in 16 bits, for [`value_in_half`](Self::value_in_half).
    pub fn keep_halves(&mut self) {
        let (weights, fits) = (vec![0; self.state.weights.len()], vec![false; self.members]);
        self.copies = Some(Copies { weights, fits, is_stale: true });
    }

    /// Writes the first output of every network for one row into `values` (`members`), computed from the copies of the weights,
    /// which are renewed first if a step was taken since. A copy is within 2⁻¹¹ of its weight's size (below 2⁻²², within that); a
    /// network with a weight of 512 or more is valued in full. Returns false, and has done nothing, where no copies are kept.
    ///
    /// # Panics
    /// If `values` has not one entry per network.
    pub fn value_in_half(&mut self, observation: &[f32], action: &[f32], values: &mut [f32]) -> bool {
        assert_eq!(values.len(), self.members, "one value per network");
        let (share, passes) = (self.members.div_ceil(self.threads()), self.passes);
        let Some(copies) = &mut self.copies else { return false };
        let architecture = &self.architecture;
        let length = architecture.parameter_len();
        let is_stale = std::mem::replace(&mut copies.is_stale, false);
        let run = |weights: &[f32],
                   halves: &mut [u16],
                   fits: &mut [bool],
                   values: &mut [f32],
                   workspace: &mut Workspace<f32>| {
            workspace.begin(None, 0);
            let networks = weights.chunks_exact(length).zip(halves.chunks_exact_mut(length));
            for (((weights, halves), fits), value) in networks.zip(fits).zip(values) {
                if is_stale {
                    *fits = half::copy(halves, weights);
                }
                let halves = (*fits).then_some(&*halves);
                *value = value_of(architecture, halves, weights, (observation, action), workspace);
            }
        };
        let Some(pool) = &self.pool else {
            run(&self.state.weights, &mut copies.weights, &mut copies.fits, values, &mut self.workspaces[0]);
            return true;
        };
        let (weights, workspaces) = (&self.state.weights, &mut self.workspaces);
        pool.install(|| {
            weights
                .par_chunks(share * length)
                .zip(copies.weights.par_chunks_mut(share * length))
                .zip(copies.fits.par_chunks_mut(share))
                .zip(values.par_chunks_mut(share))
                .zip(workspaces.par_chunks_mut(passes))
                .for_each(|((((weights, halves), fits), values), workspaces)| {
                    run(weights, halves, fits, values, &mut workspaces[0]);
                });
        });
        true
    }
}

/// The first output for one row: from the copies where there are any, else from the weights.
fn value_of(
    architecture: &Architecture,
    halves: Option<&[u16]>,
    weights: &[f32],
    (observation, action): (&[f32], &[f32]),
    workspace: &mut Workspace<f32>,
) -> f32 {
    match halves {
        Some(halves) => half::forward(architecture, halves, weights, observation, action, workspace),
        None => {
            architecture.trunk(weights, observation, workspace);
            architecture.head(weights, action, workspace);
        }
    }
    workspace.outputs(architecture).0[0]
}

#[cfg(test)]
mod tests;
