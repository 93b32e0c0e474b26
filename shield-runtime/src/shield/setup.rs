//! How a shield is made.

use std::time::Duration;

use shield_api::{AbortRule, Error, Learner, Result, Spaces};

use super::{Shield, explanation::Explanation, jury::Jury, projection::Projector, solver::Solver};
use crate::experiment::ProjectionConfig;

/// Settings of a [`Shield`] beside its rules.
#[derive(Debug, Clone)]
pub struct ShieldSettings {
    /// The spaces of the environment.
    pub spaces: Spaces,
    /// Steps at the beginning during which nothing is aborted.
    pub warm_up_steps: u64,
    /// What the buffer holds after an abort where the reset agent's action is not usable. Must lie in the action space.
    pub fallback_action: Vec<f32>,
}

impl Shield {
    /// A shield over `rules`, for a reset agent like `reset_agent`: without projection, without deadline.
    ///
    /// # Errors
    /// The fallback action lies outside the action space.
    pub fn new(
        rules: Vec<Box<dyn AbortRule>>,
        reset_agent: &dyn Learner,
        settings: ShieldSettings,
    ) -> Result<Self> {
        settings.spaces.action.check_action(&settings.fallback_action)?;
        let width = settings.spaces.action_len();
        Ok(Self {
            jury: Jury::new(rules, reset_agent, width),
            members: reset_agent.info().members,
            projector: None,
            deadline: None,
            settings,
            other_action: vec![0.0; width],
            why: Explanation::new(),
        })
    }

    /// With something to try before an action is aborted.
    ///
    /// # Errors
    /// It does not fit the action space or the rules.
    pub fn with_projection(mut self, config: ProjectionConfig) -> Result<Self> {
        if self.needs().forward_values {
            return Err(Error::invalid_config(
                "a rule needs the forward agent's values, which the shield cannot compute for another action",
            ));
        }
        let members = if self.needs().values { self.members } else { 0 };
        self.projector = Some(Projector::new(config, &self.settings.spaces.action, members)?);
        Ok(self)
    }

    /// With another solver for its quadratic programs; of no effect before [`with_projection`](Self::with_projection).
    #[must_use]
    pub fn with_solver(mut self, solver: Box<dyn Solver>) -> Self {
        if let Some(Projector::Qp(qp)) = &mut self.projector {
            qp.set_solver(solver);
        }
        self
    }

    /// With a time after which a decision is an abort, measured from the call of [`filter`](Self::filter).
    #[must_use]
    pub fn with_deadline(mut self, deadline: Duration) -> Self {
        self.deadline = Some(deadline);
        self
    }
}
