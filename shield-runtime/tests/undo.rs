//! The ladder with a success critic: what rules are given of it, and that whatever fails in it aborts.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use std::sync::{Arc, Mutex};

use common::{Rule, Scripted, spaces};
use shield_api::{
    AbortRule, AttemptBatch, Checkpoint, Error, Needs, ObservedAttempt, Reason, Result, Rows, RuleContext,
    RuleVerdict, SuccessCritic, SuccessCriticInfo,
};
use shield_runtime::{
    decision::{Cause, Decision},
    settings::{ProjectionConfig, QpConfig},
    shield::{Agents, Ladder, LadderSettings, Moment},
};

const NEEDS: Needs = Needs {
    values: false,
    greedy_values: false,
    forward_values: false,
    probabilities: true,
    greedy_probabilities: true,
    greedy_on_rejection: false,
};

/// P(s, a) = observation − action for both members, and its gradient.
struct Slope;

impl Checkpoint for Slope {}

impl SuccessCritic for Slope {
    fn info(&self) -> SuccessCriticInfo {
        SuccessCriticInfo { members: 2 }
    }

    fn probabilities(
        &mut self,
        observation: &[f32],
        action: &[f32],
        probabilities: &mut [f32],
    ) -> Result<()> {
        probabilities.fill(observation[0] - action[0]);
        Ok(())
    }

    fn gradients(
        &mut self,
        observation: &[f32],
        action: &[f32],
        probabilities: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        self.probabilities(observation, action, probabilities)?;
        gradients.fill(-1.0);
        Ok(())
    }

    fn update(&mut self, _: &AttemptBatch<'_>) -> Result<()> {
        Ok(())
    }
}

fn ladder(rule: Box<dyn AbortRule>, reset: &Scripted) -> Ladder {
    warming_up(rule, reset, 0)
}

fn warming_up(rule: Box<dyn AbortRule>, reset: &Scripted, warm_up_steps: u64) -> Ladder {
    let settings = LadderSettings { spaces: spaces(), warm_up_steps, fallback_action: vec![-0.25] };
    Ladder::new(vec![rule], reset, settings).unwrap().with_success_critic(Slope.info())
}

/// A reset agent whose own action is 0.1.
fn reset_agent() -> Scripted {
    Scripted::acting(|_, _| 0.1)
}

fn filter(ladder: &mut Ladder, observation: f32, action: &mut f32) -> Decision {
    filter_at(0, ladder, observation, action)
}

fn filter_at(step: u64, ladder: &mut Ladder, observation: f32, action: &mut f32) -> Decision {
    let (mut reset, mut critic) = (reset_agent(), Slope);
    let agents = Agents { reset: &mut reset, forward: None, success: Some(&mut critic) };
    let moment = Moment { step, observation: &[observation], previous: None };
    ladder.filter(agents, &moment, std::slice::from_mut(action))
}

#[test]
fn a_rule_is_given_the_probabilities_of_the_action_of_the_reset_agents_action_and_of_the_start() {
    let seen = Arc::new(Mutex::new(Vec::new()));
    let notes = Arc::clone(&seen);
    let judge = move |context: &RuleContext<'_>| {
        let means = [context.probabilities, context.greedy_probabilities, context.start_probabilities];
        notes.lock().unwrap().push(means.map(|members| {
            assert_eq!(members.len(), 2);
            (members[0] * 100.0).round()
        }));
        Ok(RuleVerdict::from_safe(true, 1.0))
    };
    let mut ladder = ladder(Box::new(Rule { needs: NEEDS, judge: Box::new(judge) }), &reset_agent());
    assert!(ladder.start_probabilities().is_none());
    assert_eq!(filter(&mut ladder, 0.9, &mut 0.2), Decision::Allow);
    assert_eq!(filter(&mut ladder, 0.6, &mut 0.2), Decision::Allow);
    ladder.begin_cycle();
    assert_eq!(filter(&mut ladder, 0.5, &mut 0.3), Decision::Allow);
    assert_eq!(*seen.lock().unwrap(), [[70.0, 80.0, 80.0], [40.0, 50.0, 80.0], [20.0, 40.0, 40.0]]);

    // What was kept of the start is gone on from.
    let start = ladder.start_probabilities().unwrap().to_vec();
    ladder.begin_cycle();
    ladder.go_on_from(Some(&start));
    assert_eq!(filter(&mut ladder, 0.9, &mut 0.2), Decision::Allow);
    assert_eq!(seen.lock().unwrap().last(), Some(&[70.0, 80.0, 40.0]));
}

#[test]
fn the_reset_agents_own_action_is_valued_for_a_rule_that_rejects_and_always_for_a_record() {
    // Per evaluation: how many estimates it was given for the reset agent's action.
    let asked = |is_thorough: bool| {
        let seen = Arc::new(Mutex::new(Vec::new()));
        let notes = Arc::clone(&seen);
        let judge = move |context: &RuleContext<'_>| {
            notes.lock().unwrap().push(context.greedy_probabilities.len());
            assert!(context.start_probabilities.iter().all(|start| (start - 0.8).abs() < 1e-6));
            let probability = context.probabilities[0];
            // Undoing from 0.5 is no safer than 0.1 itself.
            let gains_nothing = context.greedy_probabilities.first().is_some_and(|own| *own <= probability);
            Ok(RuleVerdict::from_safe(probability >= 0.5 || gains_nothing, probability))
        };
        let needs = Needs { probabilities: true, greedy_on_rejection: true, ..Needs::default() };
        let mut ladder = ladder(Box::new(Rule { needs, judge: Box::new(judge) }), &reset_agent());
        ladder.be_thorough(is_thorough);
        let decisions = [(0.9, 0.2), (0.9, 0.3), (0.5, 0.3), (0.5, 0.1)].map(|(observation, action)| {
            let aborted = filter(&mut ladder, observation, &mut { action }).abort().is_some();
            let known = ladder.judgement().greedy_probabilities.iter().all(|value| value.is_finite());
            (aborted, known)
        });
        let evaluations = seen.lock().unwrap().clone();
        (decisions, evaluations)
    };
    // The first decision measures the start.
    let (decisions, evaluations) = asked(false);
    assert_eq!(decisions, [(false, true), (false, false), (true, true), (false, true)]);
    assert_eq!(evaluations, [2, 0, 0, 2, 0, 2]);
    let (decisions, evaluations) = asked(true);
    assert_eq!(decisions, [(false, true), (false, true), (true, true), (false, true)]);
    assert_eq!(evaluations, [2; 4]);
}

#[test]
fn the_start_is_measured_at_the_first_decision_of_a_cycle_also_in_the_warm_up() {
    let seen = Arc::new(Mutex::new(Vec::new()));
    let notes = Arc::clone(&seen);
    let judge = move |context: &RuleContext<'_>| {
        let start = context.start_probabilities[0];
        notes.lock().unwrap().push((start * 100.0).round());
        Ok(RuleVerdict::from_safe(true, 1.0))
    };
    // It needs values too, and is not asked before these are learned.
    let rule = Rule { needs: Needs { values: true, ..NEEDS }, judge: Box::new(judge) };
    let reset = reset_agent().valuing(1, |_, _| vec![1.0]);
    let mut ladder = warming_up(Box::new(rule), &reset, 2);
    assert_eq!(filter_at(0, &mut ladder, 0.9, &mut 0.2), Decision::WarmUp);
    assert_eq!(ladder.start_probabilities().map(|start| (start[0] * 100.0).round()), Some(80.0));
    assert_eq!(filter_at(1, &mut ladder, 0.7, &mut 0.2), Decision::WarmUp);
    assert_eq!(filter_at(2, &mut ladder, 0.6, &mut 0.2), Decision::Allow);
    assert_eq!(*seen.lock().unwrap(), [80.0]);
    // The reset agent's own decisions measure nothing.
    ladder.begin_cycle();
    let (mut reset, mut critic) = (reset_agent(), Slope);
    let agents = Agents { reset: &mut reset, forward: None, success: Some(&mut critic) };
    ladder.guard(agents, &Moment { step: 3, observation: &[0.3], previous: None }, &mut [0.2]);
    assert!(ladder.start_probabilities().is_none());
    assert_eq!(filter_at(4, &mut ladder, 0.5, &mut 0.2), Decision::Allow);
    assert_eq!(ladder.start_probabilities().map(|start| (start[0] * 100.0).round()), Some(40.0));
}

#[test]
fn a_start_that_was_kept_of_another_ensemble_is_measured_anew() {
    let rule = Rule { needs: NEEDS, judge: Box::new(|_| Ok(RuleVerdict::from_safe(true, 1.0))) };
    let mut ladder = ladder(Box::new(rule), &reset_agent());
    for kept in [&[][..], &[0.5], &[0.5; 3]] {
        ladder.go_on_from(Some(kept));
        assert!(ladder.start_probabilities().is_none());
        assert_eq!(filter(&mut ladder, 0.9, &mut 0.2), Decision::Allow);
    }
}

#[test]
fn what_is_no_probability_aborts() {
    let allow =
        || Box::new(Rule { needs: NEEDS, judge: Box::new(|_| Ok(RuleVerdict::from_safe(true, 1.0))) });
    for observation in [1.2, 0.2, f32::MAX] {
        let mut action = 0.15;
        let decision = filter(&mut ladder(allow(), &reset_agent()), observation, &mut action);
        let is_probability = (0.0..=1.0).contains(&(observation - 0.1));
        let cause = decision.abort().map(|abort| abort.cause);
        assert_eq!(cause, (!is_probability).then_some(Cause::ValuesFailed), "{observation}");
        assert_eq!(action, if is_probability { 0.15 } else { 0.1 });
        // Nor is the start measured by it, while no rule is asked yet.
        let decision = filter(&mut warming_up(allow(), &reset_agent(), 1), observation, &mut 0.15);
        let warm_up = decision.abort().map(|abort| abort.cause);
        assert_eq!(warm_up, (!is_probability).then_some(Cause::ValuesFailed), "{observation}");
    }
}

#[test]
fn a_rule_that_needs_probabilities_aborts_without_a_critic() {
    let rule = Rule { needs: NEEDS, judge: Box::new(|_| Ok(RuleVerdict::from_safe(true, 1.0))) };
    let mut reset = reset_agent();
    let mut ladder = ladder(Box::new(rule), &reset);
    let agents = Agents { reset: &mut reset, forward: None, success: None };
    let moment = Moment { step: 0, observation: &[0.5], previous: None };
    let decision = ladder.filter(agents, &moment, &mut [0.2]);
    assert_eq!(decision.abort().map(|abort| abort.cause), Some(Cause::ValuesFailed));
    assert!(ladder.reason().contains("no success critic"), "{}", ladder.reason());
}

/// Allows P ≥ 0.5, and says so in rows.
struct Half {
    attempts: Arc<Mutex<Vec<ObservedAttempt>>>,
}

impl Checkpoint for Half {}

impl AbortRule for Half {
    fn needs(&self) -> Needs {
        Needs { probabilities: true, ..Needs::default() }
    }

    fn evaluate(&self, context: &RuleContext<'_>, _: &mut Reason<'_>) -> Result<RuleVerdict> {
        let least = context.probabilities[0];
        Ok(RuleVerdict::from_safe(least >= 0.5, least))
    }

    fn linearise(&self, context: &RuleContext<'_>, gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        assert_eq!(gradients, [-1.0, -1.0]);
        // P + gradient · (a − proposed) ≥ 0.5.
        let slope = gradients[0];
        rows.push(&[-slope], context.probabilities[0] - slope * context.proposed[0] - 0.5)
    }

    fn observe_attempt(&mut self, attempt: &ObservedAttempt) -> Result<()> {
        self.attempts.lock().unwrap().push(*attempt);
        if attempt.step == 7 { Err(Error::failed("not this one")) } else { Ok(()) }
    }
}

#[test]
fn an_action_is_projected_by_the_gradients_of_the_probabilities() {
    let rule = Half { attempts: Arc::default() };
    let projection = ProjectionConfig::Qp(QpConfig { margin: 0.01, ..QpConfig::default() });
    let mut ladder = ladder(Box::new(rule), &reset_agent()).with_projection(projection).unwrap();
    let mut action = 0.6;
    let decision = filter(&mut ladder, 0.9, &mut action);
    assert!(decision.projection().is_some(), "{decision:?}: {}", ladder.reason());
    assert!((0.38..=0.4).contains(&action), "{action} is not the nearest with P ≥ 0.5");
}

#[test]
fn every_rule_is_told_how_an_attempt_ended() {
    let attempts = Arc::default();
    let rule = Half { attempts: Arc::clone(&attempts) };
    let mut ladder = ladder(Box::new(rule), &reset_agent());
    let told = [ObservedAttempt { step: 3, succeeded: true }, ObservedAttempt { step: 5, succeeded: false }];
    told.iter().for_each(|attempt| ladder.observe_attempt(attempt));
    assert_eq!(*attempts.lock().unwrap(), told);
    assert!(!ladder.is_broken());
    ladder.observe_attempt(&ObservedAttempt { step: 7, succeeded: true });
    assert!(ladder.is_broken() && ladder.reason() == "not this one", "{}", ladder.reason());
}
