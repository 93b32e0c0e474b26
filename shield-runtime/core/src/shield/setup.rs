//! How a ladder is made.

use std::time::Duration;

use shield_api::{Error, Learner, Result, Space, SuccessCriticInfo};

use super::{
    explanation::Explanation,
    jury::Jury,
    ladder::{Ladder, LadderSettings},
    projection::Projector,
    rules::RuleTree,
    solver::Solver,
};
use crate::settings::ProjectionConfig;

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
        settings.spaces.action.check_action(&settings.fallback_action)?;
        let width = settings.spaces.action_len();
        Ok(Self {
            jury: Jury::new(rules.into(), reset_agent, width)?,
            members: [reset_agent.info().members, 0],
            projector: None,
            deadline: None,
            settings,
            other_action: vec![0.0; width],
            why: Explanation::new(),
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
