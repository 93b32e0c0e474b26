//! What both learners consist of: an actor, an ensemble of critics, and the body of an agent of `actor-critic`.

use std::marker::PhantomData;

use actor_critic::{
    Agent, AgentSettings, AgentState, Body, Ensemble, Loss, Regularisation, Valuation, check_finite_output,
};
use learner_kit::{Backend, CriticReport, plugin_error};
use shield_api::{Batch, Error, Result, check_length};
use tch::{Device, Kind, TchError, Tensor, no_grad};

use crate::networks::{Networks, Shape, failed, norms, numbers, read};

/// In which numbers products are computed; weights, sums over losses and the optimiser stay in `f32`.
pub trait Precision: Send + 'static {
    /// As torch calls it.
    const KIND: Kind;
}

/// Everything in `f32`.
#[derive(Debug)]
pub struct F32;

/// Products in bfloat16.
#[derive(Debug)]
pub struct Bf16;

impl Precision for F32 {
    const KIND: Kind = Kind::Float;
}

impl Precision for Bf16 {
    const KIND: Kind = Kind::BFloat16;
}

/// An agent on libtorch.
#[derive(Debug)]
pub struct TorchAgent<P> {
    /// π, with its target network.
    pub actor: Networks,
    /// Q₁ … Qₙ, with their target networks; a member's networks are successive.
    pub critics: Networks,
    /// Scales, exploration, the last batch.
    pub body: Body,
    members: usize,
    networks_per_member: usize,
    valuation: Valuation,
    device: Device,
    precision: PhantomData<P>,
}

/// A batch where the networks are, scaled.
pub struct Rows {
    /// `1 × rows × observation_len`.
    pub observations: Tensor,
    /// Likewise.
    pub next_observations: Tensor,
    /// `1 × rows × action_len`.
    pub actions: Tensor,
    /// `1 × rows × 1`.
    rewards: Tensor,
    continuations: Tensor,
    /// `networks × rows × 1`.
    masks: Tensor,
}

impl<P: Precision> Backend for TorchAgent<P> {
    /// With the weights that `actor-critic` draws for the same settings.
    fn new(settings: AgentSettings<'_>) -> Result<Self> {
        let Regularisation { layer_norm, dropout, .. } = settings.regularisation;
        for (field, is_wanted) in [("layer_norm", layer_norm), ("dropout", dropout > 0.0)] {
            if is_wanted {
                let message = format!(
                    "there is no `{field}` on libtorch: leave it out, or use the learner without torch"
                );
                return Err(Error::invalid_config(message).in_field(field));
            }
        }
        let (observation_len, activation) = (settings.observation_len, settings.activation);
        let (members, networks_per_member) = (settings.members, settings.networks_per_member);
        let (actor_hidden, critic_hidden) = (settings.actor_hidden, settings.critic_hidden);
        let (action_layer, valuation, threads) =
            (settings.action_layer, settings.valuation, settings.threads);
        let Agent { mut actor, mut critics, body, .. } = Agent::new(settings).map_err(plugin_error)?;
        tch::set_num_threads(threads as i32);
        let device = Device::cuda_if_available();
        let action_len = body.scale.len();
        let actor_shape = Shape::actor(observation_len, actor_hidden, action_len, activation);
        let critic_shape =
            Shape::critic(observation_len, critic_hidden, action_layer, action_len, activation);
        let networks = members * networks_per_member;
        Ok(Self {
            actor: Networks::new(actor_shape, 1, &weights(&mut actor), device, P::KIND)?,
            critics: Networks::new(critic_shape, networks, &weights(&mut critics), device, P::KIND)?,
            body,
            members,
            networks_per_member,
            valuation,
            device,
            precision: PhantomData,
        })
    }

    fn act(&mut self, observation: &[f32], explores: bool, action: &mut [f32]) -> Result<()> {
        let (actor, device) = (&self.actor, self.device);
        let policy = |observation: &[f32], unit: &mut [f32]| {
            let acted = no_grad(|| actor.outputs(&rows(observation, 1, device)?, None));
            let acted = acted.map_err(failed).and_then(|acted| read(&acted, unit));
            acted.map_err(|error| actor_critic::Error::Backend(error.to_string()))
        };
        self.body.act(observation, explores, action, policy).map_err(plugin_error)
    }

    /// As `actor-critic`'s: a member's value is that of its network whose value is smallest, and so is its gradient.
    fn value(
        &mut self,
        observation: &[f32],
        action: &[f32],
        values: &mut [f32],
        gradients: Option<&mut [f32]>,
    ) -> Result<()> {
        self.body.take_one(observation, action).map_err(plugin_error)?;
        check_length("values", values, self.members)?;
        let seen = rows(&self.body.buffers.observation, 1, self.device).map_err(failed)?;
        let unit = rows(&self.body.buffers.action, 1, self.device).map_err(failed)?;
        let Some(gradients) = gradients else {
            let outputs = no_grad(|| match self.valuation {
                Valuation::F32 => self.critics.outputs(&seen, Some(&unit)),
                Valuation::Half => self.critics.outputs_in_half(&seen, Some(&unit)),
            });
            self.smallest(&numbers(&outputs.map_err(failed)?)?, values);
            return check_finite_output("the values", values).map_err(plugin_error);
        };
        check_length("gradients", gradients, self.members * self.body.scale.len())?;
        let of_value = || -> Result<(Tensor, Tensor), TchError> {
            let networks = (self.members * self.networks_per_member) as i64;
            let unit = unit.f_expand([networks, 1, -1], false)?.f_contiguous()?.f_set_requires_grad(true)?;
            let outputs = self.critics.outputs(&seen, Some(&unit))?;
            let gradient = Tensor::f_run_backward(&[outputs.f_sum(Kind::Float)?], &[&unit], false, false)?;
            Ok((outputs.f_detach()?, gradient[0].shallow_clone()))
        };
        let (outputs, found) = of_value().map_err(failed)?;
        let (outputs, found) = (numbers(&outputs)?, numbers(&found)?);
        let chosen = self.smallest(&outputs, values);
        let width = self.body.scale.len();
        for (gradient, network) in gradients.chunks_exact_mut(width).zip(chosen) {
            gradient.copy_from_slice(&found[network * width..(network + 1) * width]);
            self.body.scale.gradient_to_box(gradient);
        }
        check_finite_output("the values", values).map_err(plugin_error)?;
        check_finite_output("the gradients", gradients).map_err(plugin_error)
    }

    /// In the form of `actor-critic`.
    fn save(&self, magic: &[u8], bytes: &mut Vec<u8>) -> Result<()> {
        let (actor, critics) = (self.actor.state()?, self.critics.state()?);
        self.body.save(magic, &actor, &critics, bytes).map_err(plugin_error)
    }

    /// That of a learner without torch too; on an error nothing has changed.
    fn load(&mut self, magic: &[u8], bytes: &[u8]) -> Result<()> {
        let AgentState { actor, critics, body } = self.body.read(magic, bytes).map_err(plugin_error)?;
        self.actor.check(&actor)?;
        self.critics.check(&critics)?;
        self.actor.restore(&actor)?;
        self.critics.restore(&critics)?;
        self.body.restore(body);
        Ok(())
    }
}

impl<P: Precision> TorchAgent<P> {
    /// Writes each member's smallest value, and returns whose it is. NaN is smaller than anything.
    fn smallest(&self, outputs: &[f32], values: &mut [f32]) -> Vec<usize> {
        let members = outputs.chunks_exact(self.networks_per_member).enumerate();
        let chosen = members.zip(values).map(|((member, outputs), value)| {
            let mut best = 0;
            for (index, output) in outputs.iter().enumerate() {
                if *output < outputs[best] || output.is_nan() {
                    best = index;
                }
            }
            *value = outputs[best];
            member * self.networks_per_member + best
        });
        chosen.collect()
    }

    /// Checks the whole batch before anything changes, and brings it to the networks.
    pub fn take_batch(&mut self, batch: &Batch<'_>) -> Result<Rows> {
        let size = batch.size;
        learner_kit::take_batch(&mut self.body, batch, self.members)?;
        let (buffers, device) = (&self.body.buffers, self.device);
        let bring = || -> Result<Rows, TchError> {
            // Members side by side in a row; each network of a member learns from the same rows.
            let masks = rows(batch.masks, size, device)?.f_permute([2, 1, 0])?;
            Ok(Rows {
                observations: rows(&buffers.observations, size, device)?,
                next_observations: rows(&buffers.next_observations, size, device)?,
                actions: rows(&buffers.actions, size, device)?,
                rewards: rows(batch.rewards, size, device)?,
                continuations: rows(batch.continuations, size, device)?,
                masks: masks.f_repeat_interleave_self_int(self.networks_per_member as i64, 0, None::<i64>)?,
            })
        };
        bring().map_err(failed)
    }

    /// Rows of the batch's length, brought to the networks: `1 × rows × n`.
    pub fn rows_of(&self, values: &[f32], size: usize) -> Result<Tensor, TchError> {
        rows(values, size, self.device)
    }

    /// y = r + γ c Q', with Q' `… × rows × 1`.
    pub fn targets(&self, rows: &Rows, discount: f32, next_values: &Tensor) -> Tensor {
        &rows.rewards + &rows.continuations * f64::from(discount) * next_values
    }

    /// The gradient of each critic's mean loss over the rows that its mask selects.
    pub fn critics_gradient(
        &self,
        leaves: &[Tensor],
        rows: &Rows,
        targets: &Tensor,
        loss: Loss,
    ) -> Result<(Tensor, CriticReport)> {
        let compute = || -> Result<(Tensor, Tensor, f64), TchError> {
            let values = self.critics.outputs_of(leaves, &rows.observations, Some(&rows.actions))?;
            let error = &values - targets;
            let each = match loss {
                Loss::Squared => error.f_square()? * 0.5,
                Loss::Huber => error.f_huber_loss(&error.f_zeros_like()?, tch::Reduction::None, 1.0)?,
            };
            let dims = [1_i64, 2];
            let total = rows.masks.f_sum_dim_intlist(dims.as_slice(), false, Kind::Float)?;
            // Where all masks are 0, so is the loss.
            let share = total.f_clamp_min(f64::from(f32::MIN_POSITIVE))?.f_reciprocal()?;
            let losses = (each * &rows.masks).f_sum_dim_intlist(dims.as_slice(), false, Kind::Float)? * share;
            let gradient = self.critics.gradient(&losses.f_sum(Kind::Float)?, leaves)?;
            let mean = values.f_mean(Kind::Float)?.f_double_value(&[])?;
            Ok((gradient, losses.f_detach()?, mean))
        };
        let (gradient, losses, value) = compute().map_err(failed)?;
        let losses = numbers(&losses)?;
        if let Some((critic, loss)) = losses.iter().enumerate().find(|(_, loss)| !loss.is_finite()) {
            return Err(Error::failed(format!(
                "the loss of critic {} is {loss}",
                critic / self.networks_per_member
            )));
        }
        let loss = losses.iter().map(|loss| f64::from(*loss)).sum::<f64>() / losses.len() as f64;
        Ok((gradient, CriticReport { loss, value }))
    }

    /// The gradient of −mean Q(s, π(s)) with respect to the actor, over the batch and each member's first network; and its norm.
    pub fn actor_gradient(&self, critics: &[Tensor], rows: &Rows) -> Result<(Tensor, f64)> {
        let compute = || -> Result<(Tensor, f64), TchError> {
            let leaves = self.actor.leaves()?;
            let actions = self.actor.outputs_of(&leaves, &rows.observations, None)?;
            let first = self.networks_per_member as i64;
            let critics: Vec<Tensor> = critics
                .iter()
                .map(|leaf| leaf.f_detach()?.f_slice(0, 0, None::<i64>, first))
                .collect::<Result<_, _>>()?;
            let values = self.critics.outputs_of(&critics, &rows.observations, Some(&actions))?;
            let gradient = self.actor.gradient(&values.f_mean(Kind::Float)?.f_neg()?, &leaves)?;
            let norm = norms(&gradient)?.f_double_value(&[0, 0])?;
            Ok((gradient, norm))
        };
        let (gradient, norm) = compute().map_err(failed)?;
        if !norm.is_finite() {
            return Err(Error::failed(format!("the actor's gradient is {norm}")));
        }
        Ok((gradient, norm))
    }
}

/// `1 × size × n`.
fn rows(values: &[f32], size: usize, device: Device) -> Result<Tensor, TchError> {
    Tensor::f_from_slice(values)?.f_view([1, size as i64, -1])?.f_to_device(device)
}

fn weights(ensemble: &mut Ensemble<f32>) -> Vec<f32> {
    (0..ensemble.members()).flat_map(|index| ensemble.member(index).weights().to_vec()).collect()
}
