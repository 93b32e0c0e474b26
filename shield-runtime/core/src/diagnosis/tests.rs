use super::*;

/// A diagnosis, and a world as a test describes it.
struct Story {
    diagnosis: Diagnosis,
    metrics: Metrics,
}

impl Story {
    fn new() -> Self {
        let mut story = Self { diagnosis: Diagnosis::default(), metrics: Metrics::default() };
        story.diagnosis.placed(true);
        story
    }

    /// After so many steps that a judgement is fair.
    fn settled() -> Self {
        let mut story = Self::new();
        story.steps(AgentRole::Forward, SETTLED_STEPS, |step| step % 2 == 0);
        story
    }

    /// With a rule that reports this accepted risk.
    fn accepting(risk: f64) -> Self {
        let story = Self::new();
        story.metrics.collect(|| shield_api::metrics::report("accepted_risk", risk));
        story
    }

    fn names(&self) -> Vec<&'static str> {
        self.diagnosis.findings().map(Finding::name).collect()
    }

    fn text(&self, name: &str) -> String {
        self.diagnosis.findings().find(|finding| finding.name() == name).unwrap().to_string()
    }

    fn steps(&mut self, role: AgentRole, count: u64, is_inside: impl Fn(u64) -> bool) {
        for step in 0..count {
            let outcome = StepOutcome { in_reset_set: is_inside(step), ..StepOutcome::default() };
            if role == AgentRole::Forward {
                self.diagnosis.decided(true);
            }
            self.diagnosis.step(role, &outcome, &self.metrics);
        }
    }

    fn forward(&mut self, length: u64, end: EpisodeEnd) {
        self.steps(AgentRole::Forward, length, |step| step < length / 2);
        self.diagnosis.episode(AgentRole::Forward, &Tally { length, ..Tally::default() }, end, false);
        if end == EpisodeEnd::Terminated {
            self.hard_reset(HardResetDue::Terminated, true);
        }
    }

    /// An attempt, and the hard reset after one that failed.
    fn attempt(&mut self, length: u64, has_reset: bool) {
        self.steps(AgentRole::Reset, length, |step| has_reset && step + 1 == length);
        let end = if has_reset { EpisodeEnd::ResetSet } else { EpisodeEnd::TimeLimit };
        self.diagnosis.episode(AgentRole::Reset, &Tally { length, ..Tally::default() }, end, has_reset);
        if !has_reset {
            self.hard_reset(HardResetDue::CycleOver, true);
        }
    }

    fn hard_reset(&mut self, cause: HardResetDue, is_own: bool) {
        self.diagnosis.hard_reset_due(cause, is_own);
        self.diagnosis.placed(false);
    }
}

#[test]
fn nothing_is_found_where_all_is_well() {
    let mut story = Story::accepting(0.05);
    for cycle in 0..200 {
        story.forward(40, EpisodeEnd::Abort);
        story.attempt(10, cycle % 40 != 3);
        if cycle % 10 == 0 {
            story.diagnosis.start(cycle % 50 != 0);
        }
        if cycle % 40 == 0 {
            story.forward(40, EpisodeEnd::Terminated);
        }
    }
    assert!(story.names().is_empty(), "{:?}", story.names());
}

#[test]
fn an_untrained_reset_agent_that_improves_leaves_no_finding_that_holds() {
    let mut story = Story::accepting(0.05);
    for _ in 0..6 {
        story.forward(20, EpisodeEnd::Abort);
        story.attempt(200, false);
        story.forward(20, EpisodeEnd::Abort);
        story.attempt(150, true);
    }
    for _ in 0..200 {
        story.forward(60, EpisodeEnd::Abort);
        story.attempt(30, true);
    }
    // Until then the task had a tenth of the steps, and nobody could know that it would have more.
    assert_eq!(story.names(), ["few-forward-steps"]);
    assert!(story.diagnosis.found().all(|found| found.is_over));
}

#[test]
fn starts_outside_the_reset_set_are_told_and_others_are_not() {
    for (inside, expected) in [("11111", false), ("10100", true), ("0000", false), ("1101001011", false)] {
        let mut story = Story::settled();
        inside.chars().for_each(|is_inside| story.diagnosis.start(is_inside == '1'));
        assert_eq!(story.names() == ["starts-outside"], expected, "{inside}");
    }
    let mut learned = Story::settled();
    (0..2).for_each(|_| learned.diagnosis.start(false));
    (0..40).for_each(|_| learned.diagnosis.start(true));
    assert!(learned.names().is_empty());
}

#[test]
fn a_reset_task_says_whether_starts_are_inside() {
    let mut story = Story::new();
    for _ in 0..300 {
        story.metrics.collect(|| shield_api::metrics::report("start_inside", 0.0));
        story.forward(4, EpisodeEnd::Terminated);
        story.metrics.drain(&mut |_, _| {});
    }
    assert_eq!(story.names()[0], "starts-outside", "{:?}", story.names());
    assert!(story.text("starts-outside").starts_with("only 0 of the last 10 starts"));
}

#[test]
fn unknown_starts_are_suspected_only_if_no_attempt_ever_succeeds() {
    let story = |has_reset: bool| {
        let mut story = Story::new();
        for _ in 0..12 {
            story.steps(AgentRole::Forward, 80, |_| false);
            story.attempt(20, has_reset);
            story.hard_reset(HardResetDue::CycleOver, true);
        }
        story.names()
    };
    assert_eq!(story(false), ["no-success", "starts-unlikely"]);
    assert_eq!(story(true), [""; 0]);
}

#[test]
fn a_reset_set_with_every_state_in_it_is_told() {
    for (outside, expected) in [(0, true), (4, true), (20, false)] {
        let mut story = Story::new();
        story.steps(AgentRole::Forward, 600, |step| step >= outside);
        assert_eq!(story.names() == ["every-state-inside"], expected, "{outside} states outside");
    }
    let mut short = Story::new();
    short.steps(AgentRole::Forward, 400, |_| true);
    assert!(short.names().is_empty());
}

#[test]
fn attempts_that_all_fail_are_told_and_an_accepted_risk_counts() {
    let failures = |risk: f64, lengths: &[u64]| {
        let mut story = Story::accepting(risk);
        story.steps(AgentRole::Forward, SETTLED_STEPS, |step| step % 2 == 0);
        for length in lengths {
            story.forward(4, EpisodeEnd::Abort);
            story.attempt(*length, false);
        }
        story.names().contains(&"no-success")
    };
    assert!(failures(0.05, &[20; 10]) && !failures(0.05, &[20; 9]));
    assert!(!failures(0.4, &[20; 15]) && failures(0.4, &[20; 16]));
    let mut ending = Story::settled();
    for _ in 0..10 {
        let (length, end) = (12, EpisodeEnd::Terminated);
        ending.diagnosis.episode(AgentRole::Reset, &Tally { length, ..Tally::default() }, end, false);
    }
    assert!(
        ending
            .text("no-success")
            .contains("in 10 of them the environment terminated. If that goes on: do not let it")
    );
    assert!(failures(0.05, &[500; 3]) && !failures(0.05, &[200; 3]) && !failures(0.05, &[1_000; 2]));
}

#[test]
fn an_agent_that_may_not_act_is_told() {
    let rejected = |allows_one: bool| {
        let mut story = Story::new();
        for attempt in 0..30 {
            story.diagnosis.decided(allows_one && attempt % 10 == 9);
            story.steps(AgentRole::Reset, 50, |step| step == 49);
        }
        story.diagnosis.decided(false);
        story.names().contains(&"nothing-allowed")
    };
    assert!(rejected(false) && !rejected(true));
}

#[test]
fn hard_resets_that_attempts_did_not_cause_are_told_by_cause() {
    let after = |causes: &[(HardResetDue, bool)]| {
        let mut story = Story::new();
        for (cause, is_own) in causes {
            story.steps(AgentRole::Forward, 100, |step| step < 50);
            story.hard_reset(*cause, *is_own);
        }
        story.names()
    };
    let requested = (HardResetDue::Requested, false);
    let truncated = (HardResetDue::Terminated, false);
    let failed = (HardResetDue::CycleOver, true);
    assert_eq!(after(&[requested; 5]), ["resets-requested"]);
    assert_eq!(after(&[truncated; 5]), ["resets-truncated"]);
    assert_eq!(after(&[failed; 20]), [""; 0]);
    assert_eq!(after(&[(HardResetDue::Lost, false); 20]), [""; 0]);
    assert_eq!(after(&[[requested; 4].as_slice(), &[failed; 8], &[requested; 3]].concat()), [""; 0]);
}

#[test]
fn the_cause_of_a_hard_reset_is_the_first_one() {
    let mut story = Story::new();
    for _ in 0..10 {
        story.steps(AgentRole::Forward, 20, |step| step < 10);
        story.diagnosis.hard_reset_due(HardResetDue::Terminated, true);
        // `reset(seed=…)` after the environment has ended: it would have been reset all the same.
        story.hard_reset(HardResetDue::Requested, false);
    }
    assert!(story.names().is_empty());
}

#[test]
fn an_environment_that_ends_most_episodes_is_told_once_the_shield_had_time() {
    let ends = |length: u64, every: usize, episodes: usize| {
        let mut story = Story::new();
        for episode in 0..episodes {
            let is_end = episode % every != 0;
            story.forward(length, if is_end { EpisodeEnd::Terminated } else { EpisodeEnd::Abort });
        }
        story.names().contains(&"episodes-terminate")
    };
    assert!(ends(60, 10, 20) && ends(20, 10, 60));
    assert!(!ends(20, 10, 40), "too early");
    assert!(!ends(60, 2, 100), "half of them end otherwise");
}

#[test]
fn a_risk_above_the_accepted_one_is_told_if_chance_does_not_explain_it() {
    let failing = |accepted: f64, every: u32, attempts: u32| {
        let mut story = Story::accepting(accepted);
        for attempt in 0..attempts {
            story.forward(20, EpisodeEnd::Abort);
            story.attempt(10, attempt % every != 0);
        }
        story.names().contains(&"risk-exceeded")
    };
    assert!(failing(0.05, 4, 60));
    assert!(!failing(0.05, 4, 30), "too few steps");
    assert!(!failing(0.05, 4, 39), "too few attempts");
    assert!(!failing(0.05, 10, 200), "10% of 100 may be chance");
    assert!(!failing(0.4, 4, 200));
    let mut ending = Story::accepting(0.05);
    (0..101).for_each(|_| ending.forward(10, EpisodeEnd::Terminated));
    assert!(ending.text("risk-exceeded").contains("Most of them because the environment terminated"));
}

#[test]
fn attempts_that_take_most_of_the_steps_are_told_with_what_it_would_take() {
    let share = |forward: u64, attempt: u64, count: u32| {
        let mut story = Story::accepting(0.05);
        for _ in 0..count {
            story.forward(forward, EpisodeEnd::Abort);
            story.attempt(attempt, true);
        }
        story
    };
    let slow = share(12, 60, 40);
    assert_eq!(slow.names(), ["few-forward-steps", "slow-return"]);
    let text = slow.text("slow-return");
    assert!(text.contains("takes 60 steps") && text.contains("17% of the steps"), "{text}");
    assert!(text.contains("at most 8 steps"), "{text}");
    assert!(share(40, 30, 200).names().is_empty());
    assert!(share(12, 60, 20).names().is_empty(), "it may learn yet");
}

#[test]
fn an_agent_that_never_comes_back_is_told_within_a_long_attempt() {
    let after = |inside: u64, attempt: u64, has_succeeded: bool| {
        let mut story = Story::new();
        story.steps(AgentRole::Forward, 1_000, |step| step < inside);
        if has_succeeded {
            story.attempt(10, true);
        }
        story.steps(AgentRole::Reset, attempt, |_| false);
        story.diagnosis.found().map(|found| (found.finding.name(), found.step)).collect::<Vec<_>>()
    };
    assert_eq!(after(0, 940, false), [("no-success", 1_900)]);
    assert_eq!(after(0, 899, false), []);
    assert_eq!(after(11, 940, false), [], "the task leads into the reset set by chance");
    assert_eq!(after(0, 930, true), []);
}

#[test]
fn a_task_that_gets_few_steps_is_told_before_the_2_000th_with_the_cause() {
    let story = |forward: u64, end: EpisodeEnd, has_reset: bool, cycles: u32| {
        let mut story = Story::settled();
        for _ in 0..cycles {
            story.steps(AgentRole::Forward, forward, |step| step < forward / 2);
            story.steps(AgentRole::Reset, 50 - forward, |_| false);
            let tally = Tally { length: 50 - forward, ..Tally::default() };
            story.diagnosis.episode(AgentRole::Reset, &tally, end, has_reset);
        }
        story
    };
    let text = |story: &Story| story.text("few-forward-steps");
    let slow = story(10, EpisodeEnd::ResetSet, true, 19);
    assert_eq!(slow.diagnosis.found().next().unwrap().step, 1_950);
    assert!(
        text(&slow).contains("only 190 of the last 950 steps")
            && text(&slow).contains("18 of 18 with success")
    );
    assert!(text(&slow).contains("easier to reach"), "{}", text(&slow));
    let failing = story(10, EpisodeEnd::TimeLimit, false, 19);
    assert!(text(&failing).contains("let episodes be shorter"), "{}", text(&failing));
    let ending = story(10, EpisodeEnd::Terminated, false, 19);
    assert!(text(&ending).contains("terminate_when_unhealthy"), "{}", text(&ending));
    assert!(!story(15, EpisodeEnd::ResetSet, true, 19).names().contains(&"few-forward-steps"));
    let mut long = Story::settled();
    long.steps(AgentRole::Reset, 950, |step| step % 2 == 0);
    assert!(long.names().is_empty(), "a first attempt says nothing of the next: {:?}", long.names());
    let mut later = story(15, EpisodeEnd::ResetSet, true, 19);
    (0..60).for_each(|_| later.attempt(50, true));
    assert!(!later.names().contains(&"few-forward-steps"), "whole attempts tell more by then");
    let mut better = slow;
    better.steps(AgentRole::Forward, 950, |step| step % 2 == 0);
    let found = better.diagnosis.found().find(|found| found.finding.name() == "few-forward-steps").unwrap();
    assert!(found.is_over);
}

#[test]
fn a_finding_that_holds_no_more_is_over() {
    let mut story = Story::settled();
    (0..10).for_each(|_| story.attempt(20, false));
    let found = |story: &Story| *story.diagnosis.found().next().unwrap();
    assert!(!found(&story).is_over && found(&story).step >= SETTLED_STEPS);
    story.attempt(20, true);
    assert!(found(&story).is_over);
    (0..10).for_each(|_| story.attempt(20, false));
    assert!(!found(&story).is_over, "it holds again");
    assert_eq!(story.names(), ["no-success"]);
}

#[test]
fn each_finding_is_told_once_and_there_is_room_for_all() {
    let mut diagnosis = Diagnosis::default();
    let all = [
        Finding::StartsOutside { inside: 0, starts: 5 },
        Finding::StartsUnlikely { starts: 5, attempts: 3 },
        Finding::EveryStateInside { inside: 500, states: 500 },
        Finding::NoSuccess { attempts: 10, ended: 0, steps: 100, has_succeeded: false },
        Finding::NothingAllowed { decisions: 3, steps: 1_000 },
        Finding::ResetsRequested { requested: 5, hard_resets: 5 },
        Finding::ResetsTruncated { truncated: 5, hard_resets: 5, mean_steps: 200.0 },
        Finding::EpisodesTerminate { terminated: 20, episodes: 20, mean_length: 20.0 },
        Finding::RiskExceeded { failures: 50, ended: 0, attempts: 100, accepted: 0.05 },
        Finding::FewForwardSteps { forward: 100, steps: 950, attempts: 9, successes: 1, ended: 0 },
        Finding::SlowReturn { successes: 20, attempts: 20, attempt_length: 50.0, forward_length: 10.0 },
        Finding::AbortsPay { below: 500, rewards: 500, mean: -1.0, abort_reward: 0.0 },
    ];
    assert_eq!(all.len(), Finding::KINDS);
    for finding in all.iter().chain(&all) {
        diagnosis.note(true, *finding);
    }
    let names: std::collections::BTreeSet<_> = diagnosis.findings().map(Finding::name).collect();
    assert_eq!((diagnosis.findings().count(), names.len()), (Finding::KINDS, Finding::KINDS));
}
