//! The figures of plugins belong to the loop or the shield whose call is running. The plugins here are Rust types with the host of a `Setup`.
#![allow(clippy::unwrap_used, reason = "a test")]

mod common;

use common::{Rule, Scene, Scripted, forward_learner, spaces};
use shield_api::{AbortRule, Error, ResetSignal, RuleVerdict};
use shield_runtime::{
    drop_in::{DropIn, Learning},
    experience::Experience,
    observer::{Observer, Scene as Stage, Step},
    plugin::host,
};

/// Allows everything, and says what it compared.
fn reporting_rule() -> Box<dyn AbortRule> {
    let host = host();
    Rule::judging(move |context| {
        host.metric("score", context.proposed[0].into());
        Ok(RuleVerdict::from_safe(true, 0.0))
    })
}

/// Goes left, and reports its updates: `loss`, then one more each time.
fn reporting_learner(mut loss: f64) -> Scripted {
    let host = host();
    Scripted::acting(|_, _| -1.0).updating(move || {
        host.metric("loss", loss);
        loss += 1.0;
        Ok(())
    })
}

/// A shield whose reset agent learns from every step.
fn drop_in(loss: f64) -> DropIn {
    let experience = Experience::new(10, &spaces(), [0, 1], 1.0).unwrap();
    let shield = DropIn::builder(spaces(), Box::new(reporting_learner(loss))).rule(reporting_rule());
    shield.learning(Learning::new(experience, 1, 0)).build().unwrap()
}

fn step(drop_in: &mut DropIn, proposed: f32) {
    let signal = Some(ResetSignal { reward: 0.0, in_reset_set: false });
    drop_in.filter(&[0.0], &mut [proposed]).unwrap();
    drop_in.observe(&[0.0], signal, false).unwrap();
}

/// What its plugins reported, behind what it counts itself.
fn figures(drop_in: &DropIn) -> Vec<(String, f64)> {
    let mut found = Vec::new();
    drop_in.metrics(&mut |name, value| found.push((name.to_owned(), value)));
    let end = found.iter().position(|(name, _)| name == "hard_reset_cost").unwrap();
    found.split_off(end + 1)
}

fn named<const N: usize>(figures: [(&str, f64); N]) -> Vec<(String, f64)> {
    figures.map(|(name, value)| (name.to_owned(), value)).to_vec()
}

#[test]
fn two_shields_that_take_turns_on_one_thread_keep_their_figures_apart() {
    let (mut one, mut other) = (drop_in(1.0), drop_in(100.0));
    for _ in 0..3 {
        step(&mut one, 0.25);
        step(&mut other, 0.5);
    }
    assert_eq!(figures(&one), named([("score", 0.25), ("reset/loss", 2.0)]));
    assert_eq!(figures(&other), named([("score", 0.5), ("reset/loss", 101.0)]));
}

/// Keeps the figures of a loop, and lets another shield decide after each of its steps.
struct Beside {
    figures: Vec<(String, f64)>,
    shield: DropIn,
}

impl Beside {
    fn new() -> Self {
        Self { figures: Vec::new(), shield: drop_in(100.0) }
    }
}

impl Observer for Beside {
    fn on_step(&mut self, _: &Step<'_>, _: &mut Stage<'_>) -> anyhow::Result<()> {
        step(&mut self.shield, 0.5);
        Ok(())
    }

    fn on_metric(&mut self, _: u64, name: &str, mean: f64) -> anyhow::Result<()> {
        self.figures.push((name.to_owned(), mean));
        Ok(())
    }
}

/// Each forward step ends its episode; the reset agent never acts.
fn scene(forward: Scripted) -> Scene {
    let mut scene = Scene::new(2);
    scene.forward = forward_learner(forward);
    scene.reset = Some(reporting_learner(10.0));
    scene.rules = vec![reporting_rule()];
    scene.line.terminates_at = Some(1);
    scene
}

#[test]
fn a_loop_reports_the_figures_of_its_own_plugins_in_the_order_of_their_first_sight() {
    let host = host();
    let mut scene = Scene::new(12);
    scene.forward = forward_learner(Scripted::acting(|_, _| 0.75).updating(move || {
        host.metric("loss", 1.0);
        host.metric("noise", 2.0);
        Ok(())
    }));
    scene.reset = Some(reporting_learner(10.0));
    scene.rules = vec![reporting_rule()];
    let mut beside = Beside::new();
    scene.run_with(&mut beside).unwrap();
    // Six steps forward, then six of an attempt, in which nobody judges.
    let forward = named([("score", 0.75), ("forward/loss", 1.0), ("forward/noise", 2.0)]);
    assert_eq!(beside.figures, [forward, named([("reset/loss", 12.5)])].concat());
    assert_eq!(figures(&beside.shield), named([("score", 0.5), ("reset/loss", 105.5)]));
}

#[test]
fn a_loop_that_failed_leaves_no_figure_to_the_next_on_its_thread() {
    let host = host();
    let failing = Scripted::acting(|_, _| 1.0).updating(move || {
        host.metric("last words", 1.0);
        Err(Error::failed("on purpose"))
    });
    let mut first = Beside::new();
    assert!(scene(failing).run_with(&mut first).is_err());
    assert_eq!(first.figures, []);
    let mut second = Beside::new();
    scene(Scripted::acting(|_, _| 1.0)).run_with(&mut second).unwrap();
    let names: Vec<&str> = second.figures.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["score", "score"]);
}
