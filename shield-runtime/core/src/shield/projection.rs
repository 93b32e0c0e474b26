//! What is tried with a rejected action before it is aborted.

use shield_api::{ActMode, Error, Result, Space};

use super::{
    explanation::Explanation,
    jury::Jury,
    qp::Qp,
    rejected::{Failure, Rejected},
};
use crate::{
    decision::{Cause, Projection, ProjectionKind},
    settings::ProjectionConfig,
};

/// Finds another action.
pub(super) enum Projector {
    Qp(Box<Qp>),
    Replace,
    /// Of so many discrete actions.
    Best(usize),
}

impl Projector {
    pub fn new(config: ProjectionConfig, space: &Space, members: [usize; 2], jury: &Jury) -> Result<Self> {
        Ok(match (config, space) {
            (ProjectionConfig::Replace, _) => Self::Replace,
            (ProjectionConfig::Best, Space::Discrete { n }) => Self::Best(*n),
            (ProjectionConfig::Best, Space::Box { .. }) => {
                return Err(Error::invalid_config(
                    "the environment's actions are a box, which has no list of them: `Best` needs discrete ones; `Qp` works here",
                ));
            }
            (ProjectionConfig::Qp(config), Space::Box { low, high }) => {
                Self::Qp(Box::new(Qp::new(config, low, high, members, jury)?))
            }
            (ProjectionConfig::Qp(_), Space::Discrete { .. }) => {
                return Err(Error::invalid_config(
                    "the environment's actions are discrete, so that none is near another: `Qp` needs a box; `Best` and `Replace` work here",
                ));
            }
        })
    }

    /// Writes an action that the rules allow into `found`.
    pub fn find(&mut self, rejected: Rejected<'_, '_>, found: &mut [f32]) -> Result<Projection, Failure> {
        match self {
            Self::Qp(qp) => qp.find(rejected, found),
            Self::Replace => replace(rejected, found),
            Self::Best(actions) => best(rejected, *actions, found),
        }
    }
}

/// The reset agent's greedy action, if the rules allow it: it knows best how to undo, and a step of it keeps the episode alive.
fn replace(rejected: Rejected<'_, '_>, found: &mut [f32]) -> Result<Projection, Failure> {
    let Rejected { jury, agents, moment, proposed, rejection, .. } = rejected;
    agents
        .reset
        .act(moment.observation, ActMode::Greedy, found)
        .map_err(|error| (Cause::ValuesFailed, error.to_string()))?;
    let mut why = Explanation::new();
    jury.judge(agents, moment, found, &mut why).map_err(|abort| match abort.cause {
        Cause::Rejected => (Cause::StillRejected, why.text().to_owned()),
        cause => (cause, why.text().to_owned()),
    })?;
    let squared = found.iter().zip(proposed).map(|(new, old)| (f64::from(*new) - f64::from(*old)).powi(2));
    let distance = squared.sum::<f64>().sqrt() as f32;
    Ok(Projection { kind: ProjectionKind::Replace, iterations: 0, distance, rejection })
}

/// Of the discrete actions that the rules allow, the one that the forward ensemble values most in the mean; of equal ones the first.
fn best(rejected: Rejected<'_, '_>, actions: usize, found: &mut [f32]) -> Result<Projection, Failure> {
    let Rejected { jury, agents, moment, proposed, rejection, clock } = rejected;
    let mut why = Explanation::new();
    let mut best: Option<(f32, f32)> = None;
    for action in (0..actions).map(|index| index as f32).filter(|action| proposed != [*action]) {
        if clock.is_late() {
            return Err((Cause::Deadline, "no time is left".into()));
        }
        match jury.judge(agents, moment, &[action], &mut why) {
            Ok(()) => {}
            Err(abort) if abort.cause == Cause::Rejected => continue,
            Err(abort) => return Err((abort.cause, why.text().to_owned())),
        }
        let value = jury
            .forward_mean(agents, moment, &[action])
            .map_err(|error| (Cause::ValuesFailed, error.to_string()))?;
        if best.is_none_or(|(most, _)| value > most) {
            best = Some((value, action));
        }
    }
    let Some((_, action)) = best else {
        return Err((Cause::StillRejected, format!("none of the {actions} actions is allowed")));
    };
    found.fill(action);
    Ok(Projection { kind: ProjectionKind::Best, iterations: 0, distance: 0.0, rejection })
}
