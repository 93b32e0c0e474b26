//! What each kind but the environment is asked in one round, and what it must refuse.

use shield_api::{
    AbortRule, ActMode, Learner, ObservedAttempt, ObservedDecision, Policy, Reason, ResetTask,
    Result as ApiResult, Rows, RuleContext, Verdict,
};

use super::draw::Draw;
use crate::environment_check::{Guarded, bits};

/// Members of the ensembles whose values a rule is shown.
const MEMBERS: usize = 5;
pub(super) const BATCH: usize = 16;
const REASON_BYTES: usize = 256;

/// What a round gave, as bits, or what was wrong with it.
pub type Round = Result<Vec<u32>, String>;
/// Whether a call with something impossible in it was refused, and what it was.
pub type Refusals = Vec<(String, bool)>;

pub(super) fn call<T>(what: &str, result: ApiResult<T>) -> Result<T, String> {
    result.map_err(|error| format!("`{what}` fails: {error}"))
}

pub fn learner_round(learner: &mut (dyn Learner + 'static), draw: &mut Draw) -> Round {
    let members = learner.info().members;
    let action_space = draw.spaces.action.clone();
    let observation = Guarded::input("observation", &draw.observation());
    let proposed = Guarded::input("action", &draw.action());
    let mut seen = Vec::new();
    for mode in [ActMode::Greedy, ActMode::Explore] {
        let mut action = Guarded::output("action", action_space.action_len());
        call("act", learner.act(observation.slice(), mode, action.slice_mut()))?;
        call("act", action_space.check_action(action.checked()?))?;
        seen.extend(bits(action.slice()));
    }
    let mut values = Guarded::output("values", members);
    call("q_values", learner.q_values(observation.slice(), proposed.slice(), values.slice_mut()))?;
    seen.extend(bits(values.checked()?));

    let mut gradients = Guarded::output("gradients", members * action_space.action_len());
    let mut again = Guarded::output("values", members);
    match learner.q_gradients(observation.slice(), proposed.slice(), again.slice_mut(), gradients.slice_mut())
    {
        Err(error) if error.kind() == shield_api::ErrorKind::Unsupported => {}
        result => {
            call("q_gradients", result)?;
            seen.extend(bits(gradients.checked()?));
            same_values(values.slice(), again.checked()?)?;
        }
    }
    let batch = draw.batch(BATCH, members);
    call("update", learner.update(&batch.view()))?;
    batch.checked()?;
    observation.checked()?;
    proposed.checked()?;
    Ok(seen)
}

/// The two ways to the values may round differently, but must not be two opinions.
pub(super) fn same_values(one: &[f32], other: &[f32]) -> Result<(), String> {
    let near = |(one, other): (&f32, &f32)| (one - other).abs() <= 1e-2 * (1.0 + one.abs());
    if one.iter().zip(other).all(near) {
        Ok(())
    } else {
        Err(format!("{one:?} without gradients and {other:?} with them, for the same action"))
    }
}

pub fn learner_refusals(learner: &mut (dyn Learner + 'static), draw: &mut Draw, bad: f32) -> Refusals {
    let members = learner.info().members;
    let (observation, action) = (draw.observation(), draw.action());
    let (bad_observation, bad_action) = (with_last(&observation, bad), with_last(&action, bad));
    let (mut place, mut values) = (action.clone(), vec![0.0; members]);
    let mut refusals = vec![
        (
            "`act` with it in the observation",
            learner.act(&bad_observation, ActMode::Greedy, &mut place).is_err(),
        ),
        (
            "`q_values` with it in the observation",
            learner.q_values(&bad_observation, &action, &mut values).is_err(),
        ),
        (
            "`q_values` with it in the action",
            learner.q_values(&observation, &bad_action, &mut values).is_err(),
        ),
    ];
    for (part, what) in
        ["observations", "actions", "rewards", "next observations", "continuations"].iter().enumerate()
    {
        let mut batch = draw.batch(BATCH, members);
        if let Some(last) = batch.parts_mut()[part].slice_mut().last_mut() {
            *last = bad;
        }
        refusals.push((what, learner.update(&batch.view()).is_err()));
    }
    refusals.into_iter().map(|(what, is_refused)| (what.to_string(), is_refused)).collect()
}

pub fn policy_round(policy: &mut (dyn Policy + 'static), draw: &mut Draw) -> Round {
    let observation = Guarded::input("observation", &draw.observation());
    let mut action = Guarded::output("action", draw.spaces.action_len());
    call("act", policy.act(observation.slice(), action.slice_mut()))?;
    observation.checked()?;
    call("act", draw.spaces.action.check_action(action.checked()?))?;
    Ok(bits(action.slice()))
}

pub fn policy_refusals(policy: &mut (dyn Policy + 'static), draw: &mut Draw, bad: f32) -> Refusals {
    let observation = with_last(&draw.observation(), bad);
    let mut action = vec![0.0; draw.spaces.action_len()];
    vec![("`act` with it in the observation".into(), policy.act(&observation, &mut action).is_err())]
}

/// Keeps the rows as bits.
struct Collected(Vec<u32>);

impl Rows for Collected {
    fn push(&mut self, coefficients: &[f32], bound: f32) -> ApiResult<()> {
        self.0.extend(bits(coefficients));
        self.0.push(bound.to_bits());
        Ok(())
    }
}

/// What a rule is shown.
struct Shown {
    observation: Guarded,
    proposed: Guarded,
    previous: Guarded,
    values: [Guarded; 3],
    probabilities: [Guarded; 3],
    gradients: Guarded,
}

impl Shown {
    fn new(draw: &mut Draw) -> Self {
        let width = draw.spaces.action_len();
        Self {
            observation: Guarded::input("observation", &draw.observation()),
            proposed: Guarded::input("proposed action", &draw.action()),
            previous: Guarded::input("previous action", &draw.action()),
            values: [(); 3].map(|()| Guarded::input("values", &draw.values(MEMBERS))),
            probabilities: [(); 3]
                .map(|()| Guarded::input("undo probabilities", &draw.probabilities(MEMBERS))),
            gradients: Guarded::input("gradients", &draw.values(MEMBERS * width)),
        }
    }

    fn context(&self, step: u64) -> RuleContext<'_> {
        RuleContext {
            step,
            observation: self.observation.slice(),
            proposed: self.proposed.slice(),
            previous: Some(self.previous.slice()),
            values: self.values[0].slice(),
            greedy_values: self.values[1].slice(),
            forward_values: self.values[2].slice(),
            probabilities: self.probabilities[0].slice(),
            greedy_probabilities: self.probabilities[1].slice(),
            start_probabilities: self.probabilities[2].slice(),
            discount: 0.99,
            ..RuleContext::default()
        }
    }

    fn checked(&self) -> Result<(), String> {
        let parts = [&self.observation, &self.proposed, &self.previous, &self.gradients];
        let ensembles = self.values.iter().chain(&self.probabilities);
        parts.into_iter().chain(ensembles).try_for_each(|part| part.checked().map(|_| ()))
    }
}

pub fn rule_round(rule: &mut (dyn AbortRule + 'static), draw: &mut Draw) -> Round {
    let shown = Shown::new(draw);
    let context = shown.context(1);
    let judge = |rule: &dyn AbortRule| {
        let mut room = [0; REASON_BYTES];
        let verdict = call("evaluate", rule.evaluate(&context, &mut Reason::new(&mut room)))?;
        Ok::<_, String>((verdict, room))
    };
    let (verdict, _) = judge(rule)?;
    if judge(rule)?.0 != verdict {
        return Err(
            "`evaluate` gives two verdicts for one context: only `observe` and `observe_attempt` may change a rule's state"
                .into(),
        );
    }
    let mut seen = vec![u32::from(verdict.verdict == Verdict::Allow), verdict.score.to_bits()];
    let mut rows = Collected(Vec::new());
    match rule.linearise(&context, shown.gradients.slice(), &mut rows) {
        Err(error) if error.kind() == shield_api::ErrorKind::Unsupported => {}
        result => call("linearise", result)?,
    }
    seen.append(&mut rows.0);
    let aborted = verdict.verdict == Verdict::Reject;
    let decision = ObservedDecision { step: 1, aborted, action: shown.proposed.slice() };
    call("observe", rule.observe(&decision))?;
    let attempt = ObservedAttempt { step: 1, succeeded: !aborted };
    call("observe_attempt", rule.observe_attempt(&attempt))?;
    shown.checked()?;
    Ok(seen)
}

/// Nothing that is not a number may be allowed; an error rejects as well.
pub fn rule_refusals(rule: &mut (dyn AbortRule + 'static), draw: &mut Draw, bad: f32) -> Refusals {
    let needs = rule.needs();
    let mut refusals = Vec::new();
    let mut ask = |what: &str, spoil: fn(&mut Shown) -> &mut Guarded, draw: &mut Draw| {
        let mut shown = Shown::new(draw);
        if let Some(last) = spoil(&mut shown).slice_mut().last_mut() {
            *last = bad;
        }
        refusals.push((what.to_string(), !allows(rule, &shown)));
    };
    ask("`evaluate` with it in the proposed action", |shown| &mut shown.proposed, draw);
    // +∞ is a value far above every threshold; that it cannot be is for the host to find.
    if !bad.is_sign_positive() || bad.is_nan() {
        for (is_needed, what, spoil) in [
            (
                needs.values,
                "`evaluate` with it in the values",
                (|shown| &mut shown.values[0]) as fn(&mut Shown) -> &mut Guarded,
            ),
            (needs.forward_values, "`evaluate` with it in the forward values", |shown| &mut shown.values[2]),
            (needs.probabilities, "`evaluate` with it in the undo probabilities", |shown| {
                &mut shown.probabilities[0]
            }),
        ] {
            if is_needed {
                ask(what, spoil, draw);
            }
        }
    }
    refusals
}

fn allows(rule: &dyn AbortRule, shown: &Shown) -> bool {
    let mut room = [0; REASON_BYTES];
    let judged = rule.evaluate(&shown.context(1), &mut Reason::new(&mut room));
    judged.is_ok_and(|judged| judged.verdict == Verdict::Allow && !judged.score.is_nan())
}

pub fn reset_task_round(task: &mut (dyn ResetTask + 'static), draw: &mut Draw) -> Round {
    let start = Guarded::input("observation", &draw.observation());
    let next = Guarded::input("next observation", &draw.observation());
    let action = Guarded::input("action", &draw.action());
    call("observe_start", task.observe_start(start.slice()))?;
    let signal = call("evaluate", task.evaluate(start.slice(), action.slice(), next.slice()))?;
    if !(0.0..=1.0).contains(&signal.reward) {
        return Err(format!(
            "the reset reward is {}; values lie in [0, 1/(1 − γ)] only for rewards in [0, 1]",
            signal.reward
        ));
    }
    for part in [&start, &next, &action] {
        part.checked()?;
    }
    Ok(vec![signal.reward.to_bits(), u32::from(signal.in_reset_set)])
}

pub fn reset_task_refusals(task: &mut (dyn ResetTask + 'static), draw: &mut Draw, bad: f32) -> Refusals {
    let (observation, action) = (draw.observation(), draw.action());
    let bad_observation = with_last(&observation, bad);
    vec![
        (
            "`evaluate` with it in the next observation".into(),
            task.evaluate(&observation, &action, &bad_observation).is_err(),
        ),
        ("`observe_start` with it".into(), task.observe_start(&bad_observation).is_err()),
    ]
}

pub(super) fn with_last(values: &[f32], bad: f32) -> Vec<f32> {
    let mut spoilt = values.to_vec();
    if let Some(last) = spoilt.last_mut() {
        *last = bad;
    }
    spoilt
}
