//! How a ladder is made.

use std::time::Duration;

use shield_api::{Error, Learner, Result, Space, Spaces, SuccessCriticInfo};

use super::{
    explanation::Explanation,
    jury::Jury,
    ladder::{Ladder, LadderSettings},
    projection::Projector,
    rules::RuleTree,
    solver::Solver,
};
use crate::settings::ProjectionConfig;

/// What a ladder is made of, as an experiment and a drop-in give it.
#[derive(Default)]
pub struct LadderParts {
    /// All must allow an action.
    pub rules: Vec<RuleTree>,
    /// As in [`LadderSettings`].
    pub warm_up_steps: u64,
    /// As in [`LadderSettings`]; `None`: the action of the space that is nearest to 0.
    pub fallback_action: Option<Vec<f32>>,
    /// What is tried before an action is aborted.
    pub projection: Option<ProjectionConfig>,
    /// A decision that takes longer is an abort.
    pub deadline: Option<Duration>,
}

impl LadderParts {
    /// The ladder for a reset agent and a success critic like these.
    ///
    /// # Errors
    /// A part does not fit the spaces, the rules or the reset agent; the error names the field. A rule needs undo probabilities and there is
    /// no success critic: then the field is `success_critic`.
    pub fn build(
        self,
        spaces: &Spaces,
        reset_agent: &dyn Learner,
        success: Option<SuccessCriticInfo>,
    ) -> Result<Ladder> {
        let Self { rules, warm_up_steps, fallback_action, projection, deadline } = self;
        let fallback_action = fallback_action.unwrap_or_else(|| nearest_to_zero(&spaces.action));
        let settings = LadderSettings { spaces: spaces.clone(), warm_up_steps, fallback_action };
        let mut ladder = Ladder::new(RuleTree::All(rules), reset_agent, settings)?;
        match success {
            Some(critic) => ladder = ladder.with_success_critic(critic),
            None if ladder.needs().undo_probabilities() => {
                let message = "a rule needs undo probabilities: name a success critic";
                return Err(Error::invalid_config(message).in_field("success_critic"));
            }
            None => {}
        }
        if let Some(projection) = projection {
            ladder = ladder.with_projection(projection).map_err(|error| {
                let field = error.field().map_or("projection".into(), |field| format!("projection.{field}"));
                error.in_field(field)
            })?;
        }
        ladder.deadline = deadline;
        Ok(ladder)
    }
}

impl Ladder {
    /// A ladder over `rules`, for a reset agent like `reset_agent`: without projection, without deadline.
    ///
    /// # Errors
    /// The fallback action lies outside the action space; a group of rules is empty, or a priority is none; a rule needs values that a reset
    /// controller has not.
    pub fn new(
        rules: impl Into<RuleTree>,
        reset_agent: &dyn Learner,
        settings: LadderSettings,
    ) -> Result<Self> {
        let (action, fallback) = (&settings.spaces.action, &settings.fallback_action);
        action.check_action(fallback).map_err(|error| error.in_field("fallback_action"))?;
        let width = settings.spaces.action_len();
        let jury = Jury::new(rules.into(), reset_agent, width).map_err(|error| error.in_field("rules"))?;
        Ok(Self {
            jury,
            members: [reset_agent.info().members, 0],
            projector: None,
            deadline: None,
            settings,
            other_action: vec![0.0; width],
            why: Explanation::new(),
            is_frozen: false,
        })
    }

    /// For a success critic like this one; to be said before [`with_projection`](Self::with_projection).
    #[must_use]
    pub fn with_success_critic(mut self, critic: SuccessCriticInfo) -> Self {
        self.members[1] = critic.members;
        self.jury.expect_probabilities(critic.members);
        self
    }

    /// With something to try before an action is aborted.
    ///
    /// # Errors
    /// It does not fit the action space or the rules.
    pub fn with_projection(mut self, config: ProjectionConfig) -> Result<Self> {
        let needs = self.needs();
        let [values, probabilities] = self.members;
        let members =
            [if needs.values { values } else { 0 }, if needs.probabilities { probabilities } else { 0 }];
        self.projector = Some(Projector::new(config, &self.settings.spaces.action, members, &self.jury)?);
        Ok(self)
    }

    /// With another solver for its quadratic programs.
    ///
    /// # Errors
    /// There are no such programs: it takes [`with_projection`](Self::with_projection) with a `Qp` before.
    pub fn with_solver(mut self, solver: Box<dyn Solver>) -> Result<Self> {
        let Some(Projector::Qp(qp)) = &mut self.projector else {
            return Err(Error::invalid_config("a solver has nothing to do without a `Qp` projection"));
        };
        qp.set_solver(solver);
        Ok(self)
    }

    /// With a time after which a decision is an abort, measured from the call of [`filter`](Self::filter).
    #[must_use]
    pub fn with_deadline(mut self, deadline: Duration) -> Self {
        self.deadline = Some(deadline);
        self
    }
}

/// The action of the space that is nearest to zero: usually the one that does least.
pub fn nearest_to_zero(space: &Space) -> Vec<f32> {
    let mut action = vec![0.0; space.action_len()];
    space.clamp(&mut action);
    action
}
