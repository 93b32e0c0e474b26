//! Success critics behind the interface, and rules that are given their estimates.

use shield_api::*;
use shield_runtime::plugin::{Kind, LoadedSuccessCritic, PluginError, Registry, Selection, host};

use crate::fixtures::fixture;

fn setup() -> Setup {
    let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) };
    Setup::with_spaces(0, 1, host(), spaces)
}

fn choice(id: &str) -> Selection {
    Selection::new(id).at(fixture("undo"))
}

fn critic(fault: &str) -> Result<LoadedSuccessCritic, PluginError> {
    let config = format!("(fault: {fault:?})");
    Registry::default().success_critic(&choice("fixture/critic"), &config, &setup())
}

fn batch<'a>(outcomes: &'a [f32], columns: &'a [f32]) -> AttemptBatch<'a> {
    AttemptBatch {
        size: 2,
        observations: columns,
        actions: columns,
        next_observations: columns,
        next_actions: columns,
        successes: columns,
        continuations: columns,
        outcomes,
        outcome_weights: &[0.25, 0.5],
        masks: &[1.0; 4],
    }
}

#[test]
fn a_success_critic_estimates_differentiates_learns_and_keeps_its_state() {
    let mut critic = critic("").unwrap();
    assert_eq!(critic.info().members, 2);
    let (mut probabilities, mut gradients) = ([0.0; 2], [0.0; 2]);
    critic.probabilities(&[0.5], &[0.25], &mut probabilities).unwrap();
    assert_eq!(probabilities, [0.25; 2]);
    critic.gradients(&[0.75], &[0.25], &mut probabilities, &mut gradients).unwrap();
    assert_eq!((probabilities, gradients), ([0.5; 2], [-1.0; 2]));

    critic.update(&batch(&[1.0, 0.0], &[0.0; 2])).unwrap();
    critic.probabilities(&[0.5], &[0.25], &mut probabilities).unwrap();
    assert_eq!(probabilities, [0.5; 2], "the first outcome counts a quarter");
    let mut state = Vec::new();
    critic.save(&mut state).unwrap();
    let mut other = self::critic("").unwrap();
    other.load(&state).unwrap();
    other.probabilities(&[0.5], &[0.25], &mut probabilities).unwrap();
    assert_eq!(probabilities, [0.5; 2]);
}

#[test]
fn a_critic_whose_estimates_are_no_probabilities_is_refused() {
    for fault in ["NaN", "above 1", "panic", "forgets one"] {
        let mut critic = critic(fault).unwrap();
        let error = critic.probabilities(&[0.5], &[0.25], &mut [0.0; 2]).unwrap_err();
        assert!(error.message().contains("fixture/critic"), "{fault}: {error}");
    }
    let mut critic = critic("infinite gradient").unwrap();
    assert!(critic.gradients(&[0.5], &[0.25], &mut [0.0; 2], &mut [0.0; 2]).is_err());
    assert!(self::critic("no members").is_err());
}

#[test]
fn wrong_lengths_do_not_reach_a_critic() {
    let mut critic = critic("").unwrap();
    for (observation, action, room) in [(2, 1, 2), (1, 2, 2), (1, 1, 3), (0, 1, 2)] {
        let (observation, action) = (vec![0.5; observation], vec![0.25; action]);
        assert!(critic.probabilities(&observation, &action, &mut vec![0.0; room]).is_err());
    }
    assert!(critic.update(&batch(&[1.0], &[0.0; 2])).is_err());
    assert!(critic.update(&batch(&[1.0, 0.0], &[0.0; 3])).is_err());
    let short = AttemptBatch { masks: &[1.0; 3], ..batch(&[1.0, 0.0], &[0.0; 2]) };
    assert!(critic.update(&short).is_err());
}

#[test]
fn a_critic_is_no_learner_and_a_learner_no_critic() {
    let asked = Registry::default().learner(&choice("fixture/critic"), "()", &setup());
    assert!(matches!(asked, Err(PluginError::WrongKind { found: Kind::SuccessCritic, .. })), "{asked:?}");
    let learner = Selection::new("fixture/agent").at(fixture("every-kind"));
    let asked = Registry::default().success_critic(&learner, "()", &setup());
    assert!(matches!(asked, Err(PluginError::WrongKind { found: Kind::Learner, .. })), "{asked:?}");
}

#[test]
fn a_rule_is_given_probabilities_and_told_how_attempts_end() {
    let mut rule = Registry::default().abort_rule(&choice("fixture/undo-rule"), "()", &setup()).unwrap();
    assert!(rule.needs().probabilities && rule.needs().greedy_probabilities && !rule.needs().values);
    let context = RuleContext {
        observation: &[0.0],
        proposed: &[0.5],
        probabilities: &[0.5, 0.5],
        greedy_probabilities: &[0.75, 0.75],
        start_probabilities: &[0.875, 0.875],
        ..RuleContext::default()
    };
    let mut buffer = [0; 80];
    let mut judge = |rule: &dyn AbortRule| {
        let mut reason = Reason::new(&mut buffer);
        let verdict = rule.evaluate(&context, &mut reason).unwrap().verdict;
        let length = reason.len();
        (verdict, String::from_utf8_lossy(&buffer[..length]).into_owned())
    };
    assert_eq!(judge(&rule).0, Verdict::Allow);
    rule.observe_attempt(&ObservedAttempt { step: 40, succeeded: true }).unwrap();
    assert_eq!(judge(&rule).0, Verdict::Allow);
    rule.observe_attempt(&ObservedAttempt { step: 40, succeeded: false }).unwrap();
    assert_eq!(judge(&rule), (Verdict::Reject, "0.5 of 0.875, and 0.75 by itself".into()));

    struct Collected(Vec<(Vec<f32>, f32)>);
    impl Rows for Collected {
        fn push(&mut self, coefficients: &[f32], bound: f32) -> Result<()> {
            self.0.push((coefficients.to_vec(), bound));
            Ok(())
        }
    }
    let mut rows = Collected(Vec::new());
    rule.linearise(&context, &[-2.0, -1.0], &mut rows).unwrap();
    assert_eq!(rows.0, [(vec![2.0], 0.5)]);
    assert!(rule.linearise(&context, &[-2.0], &mut rows).is_err(), "one gradient of two is missing");
}
