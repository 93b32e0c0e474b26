//! Reset controllers: a way back that is given, in a drop-in and in the joint loop.
#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use std::sync::{
    Arc, Mutex,
    atomic::{AtomicBool, Ordering},
};

use common::{EPISODE, Line, Notebook, Rule, Scripted, forward_learner, settings, spaces};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::{
    AbortRule, AttemptBatch, Checkpoint, Error, Needs, Phase, Policy, ResetSignal, Result, RuleVerdict,
    SuccessCritic, SuccessCriticInfo,
};
use shield_runtime::{
    agent::Agent,
    controller::Controller,
    cycle::{CycleParts, Memory},
    decision::{Cause, Decision, ProjectionKind},
    drop_in::{DropIn, DropInBuilder, Learning},
    experience::{AgentRole, Experience, UndoSettings},
    joint_loop::{JointLoop, LoopParts},
    settings::ProjectionConfig,
    shield::{Ladder, LadderSettings},
    world::World,
};

const FALLBACK: f32 = -0.25;

/// Rejects actions above a half; it needs nothing learned.
fn moderate() -> Box<dyn AbortRule> {
    let judge = |context: &shield_api::RuleContext<'_>| {
        Ok(RuleVerdict::from_safe(context.proposed[0] <= 0.5, context.proposed[0]))
    };
    Box::new(Rule { needs: Needs::default(), judge: Box::new(judge) })
}

/// Its action is a function of where it is; none where that gives −∞.
fn controller(act: impl Fn(f32) -> f32 + Send + 'static) -> Controller {
    Controller::from_fn(move |observation, action| {
        action[0] = act(observation[0]);
        if action[0] == f32::NEG_INFINITY { Err(Error::failed("no way home")) } else { Ok(()) }
    })
}

fn builder(controller: Controller) -> DropInBuilder {
    let builder = DropIn::builder(spaces(), Box::new(controller)).fallback_action(vec![FALLBACK]);
    builder.attempt_length(EPISODE as u64)
}

/// One step of a loop in which every action leads by as much, and 0 is home.
fn step(drop_in: &mut DropIn, position: &mut f32, proposed: f32) -> Result<(Decision, f32)> {
    let mut action = [proposed];
    let decision = drop_in.filter(&[*position], &mut action)?;
    *position = (*position + action[0]).max(0.0);
    let home = ResetSignal { reward: -*position, in_reset_set: *position == 0.0 };
    drop_in.observe(&[*position], Some(home), false)?;
    Ok((decision, action[0]))
}

fn cause(decision: Decision) -> Option<Cause> {
    decision.abort().map(|abort| abort.cause)
}

#[test]
fn a_function_leads_home_after_an_abort_also_where_others_would_explore() {
    let experience = Experience::new(100, &spaces(), [0, 0], 1.0).unwrap();
    let drop_in = builder(controller(|_| -0.5)).rule(moderate());
    let mut drop_in = drop_in.learning(Learning::new(experience, 1, 0)).build().unwrap();
    let mut position = 0.0;
    for _ in 0..3 {
        assert_eq!(step(&mut drop_in, &mut position, 0.5).unwrap(), (Decision::Allow, 0.5));
    }
    let (decision, executed) = step(&mut drop_in, &mut position, 0.75).unwrap();
    assert_eq!((cause(decision), executed, drop_in.phase()), (Some(Cause::Rejected), -0.5, Phase::Reset));
    for _ in 0..2 {
        assert_eq!(step(&mut drop_in, &mut position, 0.5).unwrap(), (Decision::Resetting, -0.5));
    }
    assert_eq!((position, drop_in.phase()), (0.0, Phase::Forward));
    let mut names = Vec::new();
    drop_in.metrics(&mut |name, value| {
        assert!(value.is_finite(), "{name}");
        names.push(name.to_owned());
    });
    assert!(names.iter().all(|name| !name.starts_with("reset/")), "{names:?}");
    assert!(drop_in.reset_value().is_nan());
}

#[test]
fn a_controller_that_fails_never_moves_anything() {
    for (failure, words) in
        [(f32::NAN, "NaN"), (f32::INFINITY, "inf"), (f32::NEG_INFINITY, "no way home"), (1.5, "[-1, 1]")]
    {
        let mut drop_in = builder(controller(move |_| failure)).rule(moderate()).build().unwrap();
        let mut position = 1.0;
        let (decision, executed) = step(&mut drop_in, &mut position, 0.75).unwrap();
        assert_eq!((cause(decision), executed), (Some(Cause::Rejected), FALLBACK), "{failure}");
        let (decision, executed) = step(&mut drop_in, &mut position, 0.5).unwrap();
        assert_eq!((cause(decision), executed), (Some(Cause::ResetFailed), FALLBACK), "{failure}");
        assert!(drop_in.reason().contains(words), "{failure}: {}", drop_in.reason());
        assert_eq!(drop_in.counters().failed_closed, 1);
    }
}

#[test]
fn a_function_that_writes_nothing_fails() {
    let idle = Controller::from_fn(|_, _| Ok(()));
    let mut drop_in = builder(idle).rule(moderate()).build().unwrap();
    step(&mut drop_in, &mut 1.0, 0.75).unwrap();
    let (decision, executed) = step(&mut drop_in, &mut 1.0, 0.5).unwrap();
    assert_eq!((cause(decision), executed), (Some(Cause::ResetFailed), FALLBACK));
}

#[test]
fn a_controllers_action_can_replace_a_rejected_one() {
    let drop_in = builder(controller(|_| -0.5)).rule(moderate()).projection(ProjectionConfig::Replace);
    let mut drop_in = drop_in.build().unwrap();
    let (decision, executed) = step(&mut drop_in, &mut 1.0, 0.75).unwrap();
    assert_eq!(decision.projection().map(|found| found.kind), Some(ProjectionKind::Replace));
    assert_eq!((executed, drop_in.phase()), (-0.5, Phase::Forward));
}

#[test]
fn a_rule_that_needs_reset_values_is_refused_with_the_remedy() {
    for needs in
        [Needs { values: true, ..Needs::default() }, Needs { greedy_values: true, ..Needs::default() }]
    {
        let judge = |_: &shield_api::RuleContext<'_>| Ok(RuleVerdict::from_safe(true, 1.0));
        let rule = Box::new(Rule { needs, judge: Box::new(judge) });
        let refused = builder(controller(|_| -0.5)).rule(moderate()).rule(rule).build();
        let message = refused.err().unwrap().to_string();
        assert!(message.starts_with("rule 1: ") && message.contains("`undo-probability`"), "{message}");
    }
}

/// A critic that says what it was asked to learn from.
#[derive(Clone, Default)]
struct Pupil {
    /// Outcome and next action of each row.
    seen: Arc<Mutex<Vec<(f32, f32)>>>,
}

impl Checkpoint for Pupil {}

impl SuccessCritic for Pupil {
    fn info(&self) -> SuccessCriticInfo {
        SuccessCriticInfo { members: 1 }
    }

    fn probabilities(&mut self, _: &[f32], _: &[f32], probabilities: &mut [f32]) -> Result<()> {
        probabilities.fill(0.75);
        Ok(())
    }

    fn gradients(&mut self, _: &[f32], _: &[f32], _: &mut [f32], _: &mut [f32]) -> Result<()> {
        Err(Error::unsupported("gradients"))
    }

    fn update(&mut self, batch: &AttemptBatch<'_>) -> Result<()> {
        self.seen.lock().unwrap().push((batch.outcomes[0], batch.next_actions[0]));
        Ok(())
    }
}

const UNDO: UndoSettings = UndoSettings {
    bootstrap_probability: 1.0,
    failure_share: 0.25,
    success_share: 0.125,
    outcome_half_life: 1e5,
};

/// It leads home from within 1; beyond, it does not move. Undoing is judged by a critic.
fn judged(act: impl Fn(f32) -> f32 + Send + 'static) -> (DropIn, Pupil) {
    let pupil = Pupil::default();
    let experience = Experience::new(100, &spaces(), [0, 0], 1.0).unwrap().with_undo(UNDO).unwrap();
    let judge = |context: &shield_api::RuleContext<'_>| {
        let probability = context.probabilities[0].min(context.greedy_probabilities[0]);
        Ok(RuleVerdict::from_safe(probability >= 0.5 && context.proposed[0] <= 0.5, probability))
    };
    let needs = Needs { probabilities: true, greedy_probabilities: true, ..Needs::default() };
    let drop_in = builder(controller(act))
        .rule(Box::new(Rule { needs, judge: Box::new(judge) }))
        .success_critic(Box::new(pupil.clone()))
        .learning(Learning::new(experience, 1, 0));
    (drop_in.build().unwrap(), pupil)
}

#[test]
fn a_critic_learns_from_the_outcomes_of_a_controllers_attempts() {
    let (mut drop_in, pupil) = judged(|position| if position <= 1.0 { -0.5 } else { 0.0 });
    for _ in 0..20 {
        let mut position = 0.0;
        for proposed in [0.5, 0.5, 0.75, 0.5, 0.5] {
            step(&mut drop_in, &mut position, proposed).unwrap();
        }
        position = 2.0;
        for proposed in [0.5; EPISODE + 1] {
            if !drop_in.needs_hard_reset() {
                drop_in.begin_reset();
                step(&mut drop_in, &mut position, proposed).unwrap();
            }
        }
        if drop_in.needs_hard_reset() {
            drop_in.hard_reset_done(&[0.0]).unwrap();
        }
    }
    let seen = pupil.seen.lock().unwrap();
    for expected in [(1.0, -0.5), (0.0, 0.0)] {
        assert!(seen.contains(&expected), "{expected:?} is not among {seen:?}");
    }
}

#[test]
fn a_controller_that_fails_aborts_where_a_rule_asks_what_it_would_do() {
    for failure in [f32::NAN, f32::NEG_INFINITY] {
        let (mut drop_in, _) = judged(move |_| failure);
        let mut action = [0.5];
        let decision = drop_in.filter(&[1.0], &mut action).unwrap();
        assert_eq!((cause(decision), action), (Some(Cause::ValuesFailed), [FALLBACK]), "{failure}");
    }
}

/// A policy that counts how often it was asked.
struct Counting(u8);

impl Checkpoint for Counting {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        bytes.push(self.0);
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.0 = bytes[0];
        Ok(())
    }
}

impl Policy for Counting {
    fn act(&mut self, _: &[f32], action: &mut [f32]) -> Result<()> {
        self.0 += 1;
        action[0] = -f32::from(self.0) / 100.0;
        Ok(())
    }
}

#[test]
fn a_policys_state_is_kept_and_a_functions_is_the_callers_affair() {
    let policy = || builder(Controller::new(Box::new(Counting(0)))).rule(moderate()).build().unwrap();
    let (mut first, mut second) = (policy(), policy());
    for _ in 0..3 {
        step(&mut first, &mut 1.0, 0.75).unwrap();
    }
    second.restore(first.state().unwrap()).unwrap();
    second.hard_reset_done(&[1.0]).unwrap();
    assert_eq!(step(&mut second, &mut 1.0, 0.75).unwrap().1, -0.04);

    let function = || builder(controller(|_| -0.5)).rule(moderate()).build().unwrap();
    function().restore(function().state().unwrap()).unwrap();
}

#[test]
fn in_the_joint_loop_a_controller_resets_without_values_and_does_not_explore() {
    let rule = Rule {
        needs: Needs { forward_values: true, ..Needs::default() },
        judge: Box::new(|context| Ok(RuleVerdict::from_safe(context.observation[0] < 2.0, 1.0))),
    };
    let reset = controller(|_| -1.0);
    let ladder_settings =
        LadderSettings { spaces: spaces(), warm_up_steps: 0, fallback_action: vec![FALLBACK] };
    let rules: Vec<Box<dyn AbortRule>> = vec![Box::new(rule)];
    let ladder = Ladder::new(rules, &reset, ladder_settings).unwrap();
    let experience = Experience::new(100, &spaces(), [1, 0], 1.0).unwrap();
    let agents = CycleParts {
        forward: forward_learner(Scripted::acting(|_, _| 1.0)),
        reset: Some(Agent::new(AgentRole::Reset, Box::new(reset), 1, &spaces(), Pcg64::seed_from_u64(0))),
        success: None,
        ladder: Some(ladder),
        memory: Some(Memory { experience, masks: Pcg64::seed_from_u64(1) }),
    };
    let world = World::new(Box::new(Line::new()), None).unwrap();
    let (mut notebook, stop) = (Notebook::default(), AtomicBool::new(false));
    let mut settings = settings(40);
    settings.cycle.shield_exploration = true;
    let resets = Pcg64::seed_from_u64(2);
    let parts = LoopParts { settings, world, agents, evaluator: None, resets };
    let mut joint = JointLoop::new(parts, &mut notebook, &stop);
    joint.run().unwrap();
    let counters = *joint.counters();
    assert_eq!((counters.hard_resets, counters.exploration_replaced, counters.steps), (0, 0, 40));
    assert!(counters.early_aborts > 5 && !stop.load(Ordering::Relaxed));
    let attempts: Vec<_> =
        notebook.episodes.iter().filter(|episode| episode.role == AgentRole::Reset).collect();
    assert!(attempts.len() > 5 && attempts.iter().all(|attempt| attempt.reset_value.is_none()));
    assert!(attempts[..5].iter().all(|attempt| attempt.has_reset));
}
