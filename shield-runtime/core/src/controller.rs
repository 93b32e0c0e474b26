//! Reset controllers: a way back to the start that is given instead of learned.

use shield_api::{ActMode, Batch, Checkpoint, Error, Learner, LearnerInfo, Needs, Policy, Result};

/// A reset agent that is given instead of learned, such as a hand-written way home.
///
/// It acts, values nothing, and learns nothing. A success critic judges it as it judges every reset agent: by how its attempts end. Rules that
/// need the reset agent's values are refused beside it when the shield is built.
///
/// The policy is also asked about observations of the past, from which the success critic learns: its action must depend on the observation
/// alone. An action that is not finite is an error, and nothing of it is executed.
///
/// ```
/// use shield_api::{ResetSignal, Result, Space, Spaces};
/// use shield_core::{controller::Controller, decision::Decision, drop_in::DropIn};
/// # use shield_api::{AbortRule, Checkpoint, Needs, Reason, RuleContext, RuleVerdict};
/// # struct Fence;
/// # impl Checkpoint for Fence {}
/// # impl AbortRule for Fence {
/// #     fn needs(&self) -> Needs { Needs::default() }
/// #     fn evaluate(&self, context: &RuleContext<'_>, _: &mut Reason<'_>) -> Result<RuleVerdict> {
/// #         let next = context.observation[0] + context.proposed[0];
/// #         Ok(RuleVerdict::from_safe(next < 1.0, next))
/// #     }
/// # }
/// # fn main() -> Result<()> {
/// // The robot's own way home: a step towards 0.
/// let controller = Controller::from_fn(|position, action| {
///     action[0] = (-position[0]).clamp(-0.2, 0.2);
///     Ok(())
/// });
/// // `Fence` is a rule that ends at 1.
/// let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) };
/// let mut shield = DropIn::builder(spaces, Box::new(controller)).rule(Box::new(Fence)).build()?;
///
/// let (mut position, mut aborts) = (0.0_f32, 0);
/// for _ in 0..20 {
///     let mut action = [0.3];
///     aborts += u32::from(matches!(shield.filter(&[position], &mut action)?, Decision::Abort(_)));
///     position += action[0];
///     let home = ResetSignal { reward: -position.abs(), in_reset_set: position.abs() < 0.1 };
///     shield.observe(&[position], Some(home), false)?;
/// }
/// assert!(aborts > 1 && position < 1.0 && !shield.needs_hard_reset());
/// # Ok(())
/// # }
/// ```
pub struct Controller {
    policy: Box<dyn Policy>,
}

impl Controller {
    /// Makes a policy the reset agent. Checkpoints hold its state.
    pub fn new(policy: Box<dyn Policy>) -> Self {
        Self { policy }
    }

    /// Makes a function the reset agent. It writes an action for an observation; an error, or an action that is not finite, aborts. What it
    /// remembers is the caller's affair: no checkpoint holds it.
    pub fn from_fn(act: impl FnMut(&[f32], &mut [f32]) -> Result<()> + Send + 'static) -> Self {
        Self::new(Box::new(Function(act)))
    }
}

impl Checkpoint for Controller {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.policy.save(bytes)
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.policy.load(bytes)
    }
}

/// The cycle asks an agent for actions through this trait; one without members is asked for nothing else.
impl Learner for Controller {
    fn info(&self) -> LearnerInfo {
        LearnerInfo { members: 0, discount: 0.0 }
    }

    fn act(&mut self, observation: &[f32], _mode: ActMode, action: &mut [f32]) -> Result<()> {
        action.fill(f32::NAN);
        self.policy.act(observation, action)?;
        match action.iter().find(|value| !value.is_finite()) {
            None => Ok(()),
            Some(value) => Err(Error::failed(format!("the reset controller's action is {value}"))),
        }
    }

    fn q_values(&mut self, _observation: &[f32], _action: &[f32], _values: &mut [f32]) -> Result<()> {
        Err(Error::unsupported("valuing an action"))
    }

    fn update(&mut self, _batch: &Batch<'_>) -> Result<()> {
        Ok(())
    }
}

/// A function as a policy.
struct Function<F>(F);

impl<F: Send> Checkpoint for Function<F> {}

impl<F: FnMut(&[f32], &mut [f32]) -> Result<()> + Send> Policy for Function<F> {
    fn act(&mut self, observation: &[f32], action: &mut [f32]) -> Result<()> {
        (self.0)(observation, action)
    }
}

/// Refuses a rule that needs the values of a reset agent that has none.
///
/// # Errors
/// The remedy.
pub fn check_needs(needs: Needs, reset_agent: LearnerInfo) -> Result<()> {
    let are_met = reset_agent.members > 0 || !(needs.values || needs.greedy_values);
    if are_met {
        return Ok(());
    }
    Err(Error::invalid_config(
        "the rule needs the reset agent's values, and a reset policy has none: use the rule `undo-probability`, which judges any \
         reset agent by the success of its attempts",
    ))
}
