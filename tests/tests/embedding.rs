//! The shield embedded in other programs: in C, and in Rust.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{env, fs, process::Command};

use shield_tests::{compile_c_program, plugins_folder, succeed, text, without_plugins_elsewhere, workspace};

/// The numbers in a text.
fn numbers(text: &str) -> Vec<u32> {
    text.split(|character: char| !character.is_ascii_digit()).filter_map(|part| part.parse().ok()).collect()
}

#[test]
fn a_controller_in_c_learns_not_to_fall_and_finds_its_plugins() {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("cart");
    compile_c_program(&workspace().join("examples/c/cart.c"), &program);
    let config = workspace().join("examples/c/cart.ron");
    let said = succeed(without_plugins_elsewhere(Command::new(&program).arg(config)));
    let [aborts, hard_resets, last] = numbers(&said)[..] else { panic!("{said}") };
    assert!(aborts > 50 && (1..60).contains(&hard_resets) && last < 6_000, "{said}");
    // What is wrong is said with its place.
    let wrong = folder.path().join("wrong.ron");
    fs::write(&wrong, "DropIn(\n    reset: (plugin: \"ddgp\"),\n    shield: (rules: [(plugin: \"no\")]),\n)")
        .unwrap();
    let refused = without_plugins_elsewhere(Command::new(&program).arg(&wrong)).output().unwrap();
    let message = text(&refused.stderr);
    assert_eq!(refused.status.code(), Some(1));
    assert!(message.contains("wrong.ron:1:") && message.contains("spaces"), "{message}");
}

#[test]
fn a_program_in_c_gives_its_way_home_and_learns_how_far_it_leads() {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("controller");
    compile_c_program(&workspace().join("examples/c/controller.c"), &program);
    let config = workspace().join("examples/c/controller.ron");
    let said = succeed(without_plugins_elsewhere(Command::new(&program).arg(config)));
    let [aborts, hard_resets, of_late] = numbers(&said)[..] else { panic!("{said}") };
    assert!(aborts > 100 && hard_resets < 150 && 3 * of_late < hard_resets, "{said}");
}

const LOST: &str = r#"
#include <math.h>
#include <stdio.h>
#include <string.h>
#include "shield.h"

#define EXPECT(condition) if (!(condition)) { printf("line %d: %s\n", __LINE__, shield_last_error()); return 1; }

// Writes what it is told to, and fails where that is above 1.
static int32_t way_home(void *context, const float *observation, size_t observation_len, float *action,
                        size_t action_len) {
    action[0] = *(float *)context;
    return observation_len == 1 && action_len == 1 && observation[0] < 2.0f && !(action[0] > 1.0f) ? SHIELD_DONE : 7;
}

int main(int count, char **arguments) {
    float told = -0.25f, seen = 1.0f, action = 0.75f;
    EXPECT(count == 3 && shield_open_with_policy(NULL, way_home, &told) == NULL)
    EXPECT(shield_open_with_policy(arguments[1], NULL, NULL) == NULL && strstr(shield_last_error(), "null"))
    EXPECT(shield_open(arguments[1]) == NULL && strstr(shield_last_error(), "nothing undoes"))
    EXPECT(shield_open_with_policy(arguments[2], way_home, &told) == NULL && strstr(shield_last_error(), "`reset`"))
    Shield *shield = shield_open_with_policy(arguments[1], way_home, &told);
    EXPECT(shield)
    // A rejected action gives way to the policy's, in this step and in the next.
    EXPECT(shield_filter(shield, &seen, 1, &action, 1) == SHIELD_ABORT && action == -0.25f)
    EXPECT(shield_observe_reset(shield, &seen, 1, 0.0f, 0, 0) == SHIELD_DONE)
    EXPECT(shield_filter(shield, &seen, 1, &action, 1) == SHIELD_RESETTING && action == -0.25f)
    EXPECT(shield_observe_reset(shield, &seen, 1, 0.0f, 0, 0) == SHIELD_DONE)
    // One that is not finite, and none at all: nothing of it may be executed.
    told = NAN;
    EXPECT(shield_filter(shield, &seen, 1, &action, 1) == SHIELD_ABORT && action == 0.0f)
    EXPECT(strstr(shield_reason(shield), "NaN"))
    EXPECT(shield_observe_reset(shield, &seen, 1, 0.0f, 0, 0) == SHIELD_DONE)
    told = 1.5f;
    EXPECT(shield_filter(shield, &seen, 1, &action, 1) == SHIELD_ABORT && action == 0.0f)
    EXPECT(strstr(shield_reason(shield), "returned 7"))
    EXPECT(shield_save(shield, "state") == SHIELD_DONE && shield_load(shield, "state") == SHIELD_DONE)
    shield_close(shield);
    return 0;
}
"#;

#[test]
fn a_way_home_in_c_that_fails_is_not_executed() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("lost.c"), LOST).unwrap();
    fs::write(at("both.ron"), AT_MOST_HALF).unwrap();
    let reset = AT_MOST_HALF.lines().find(|line| line.contains("reset:")).unwrap();
    fs::write(at("given.ron"), AT_MOST_HALF.replace(reset, "")).unwrap();
    compile_c_program(&at("lost.c"), &at("lost"));
    let mut lost = Command::new(at("lost"));
    lost.args([at("given.ron"), at("both.ron")]).current_dir(folder.path());
    succeed(without_plugins_elsewhere(&mut lost));
}

const CARELESS: &str = r#"
#include <math.h>
#include <stdio.h>
#include <string.h>
#include "shield.h"

#define EXPECT(condition) if (!(condition)) { printf("line %d: %s\n", __LINE__, shield_last_error()); return 1; }

int main(int count, char **arguments) {
    float seen[2] = {0.0f, 0.0f}, action[2] = {0.5f, 0.5f};
    EXPECT(count == 2 && shield_open(NULL) == NULL && strlen(shield_last_error()) > 0)
    EXPECT(shield_filter(NULL, seen, 1, action, 1) == SHIELD_FAILED && action[0] == 0.0f)
    action[0] = 0.5f;
    EXPECT(shield_observe(NULL, seen, 1, 0) == SHIELD_FAILED && shield_is_resetting(NULL) == SHIELD_FAILED)
    shield_close(NULL);
    Shield *shield = shield_open(arguments[1]);
    EXPECT(shield && strlen(shield_last_error()) == 0)
    EXPECT(shield_filter(shield, NULL, 1, action, 1) == SHIELD_FAILED && action[0] == 0.0f)
    EXPECT(shield_is_resetting(shield) == 0 && strlen(shield_last_error()) == 0)
    action[0] = 0.5f;
    EXPECT(shield_filter(shield, seen, 1, NULL, 1) == SHIELD_FAILED)
    EXPECT(shield_observe(shield, seen, 1, 0) == SHIELD_FAILED && shield_needs_hard_reset(shield) == 1)
    EXPECT(shield_hard_reset_done(shield, seen, 1) == SHIELD_DONE && shield_needs_hard_reset(shield) == 0)
    EXPECT(shield_filter(shield, seen, 1, action, 1) == SHIELD_WARM_UP && action[0] == 0.5f)
    EXPECT(shield_observe(shield, NULL, 1, 0) == SHIELD_FAILED && shield_needs_hard_reset(shield) == 1)
    EXPECT(shield_hard_reset_done(shield, seen, 1) == SHIELD_DONE)
    EXPECT(shield_filter(shield, seen, 1, action, 1) == SHIELD_WARM_UP && action[0] == 0.5f)
    EXPECT(shield_observe_reset(shield, seen, 1, 1.0f, 1, 0) == SHIELD_FAILED)
    EXPECT(shield_hard_reset_done(shield, seen, 1) == SHIELD_DONE)
    // Too many numbers, too few, none, and none that is one: nothing of it may be executed.
    EXPECT(shield_filter(shield, seen, 1, action, 2) == SHIELD_FAILED && action[0] == 0.0f && action[1] == 0.0f)
    action[0] = 0.5f;
    EXPECT(shield_filter(shield, seen, 2, action, 1) == SHIELD_FAILED && action[0] == 0.0f)
    action[0] = NAN;
    EXPECT(shield_filter(shield, seen, 1, action, 1) == SHIELD_ABORT && action[0] == action[0])
    EXPECT(strlen(shield_reason(shield)) > 0 && shield_is_resetting(shield) == 1)
    EXPECT(shield_observe(shield, seen, 2, 0) == SHIELD_FAILED)
    EXPECT(shield_save(shield, NULL) == SHIELD_FAILED && shield_save(shield, "state") == SHIELD_DONE)
    EXPECT(shield_load(shield, "nowhere") == SHIELD_FAILED && shield_load(shield, "state") == SHIELD_DONE)
    shield_close(shield);
    return 0;
}
"#;

#[test]
fn a_careless_program_in_c_gets_errors_and_safe_actions() {
    let folder = tempfile::tempdir().unwrap();
    let (source, program) = (folder.path().join("careless.c"), folder.path().join("careless"));
    fs::write(&source, CARELESS).unwrap();
    compile_c_program(&source, &program);
    let config = workspace().join("examples/c/cart.ron");
    let mut careless = Command::new(&program);
    succeed(without_plugins_elsewhere(careless.arg(config).current_dir(folder.path())));
}

const AT_MOST_HALF: &str = r#"
DropIn(
    spaces: (observation: Unbounded(1), action: Box(low: [-1.0], high: [1.0])),
    reset: (plugin: "ddpg", config: (critics: 1, actor_hidden: [8], critic_hidden: [8])),
    shield: (rules: [(plugin: "linear-constraints", config: (constraints: [(a: [1.0], b: 0.5)]))], warm_up_steps: 0),
    experience: (capacity: 100, updates_per_step: 0),
    episode_length: 20,
)
"#;

#[test]
fn an_adversary_in_c_executes_nothing_that_the_rule_rejects() {
    let folder = tempfile::tempdir().unwrap();
    let (config, program) = (folder.path().join("half.ron"), folder.path().join("adversary"));
    fs::write(&config, AT_MOST_HALF).unwrap();
    compile_c_program(&workspace().join("tests/fixtures/adversary.c"), &program);
    let said = succeed(without_plugins_elsewhere(Command::new(&program).arg(config)));
    let [allowed, aborted, hard_resets] = numbers(&said)[..] else { panic!("{said}") };
    assert!(allowed > 10_000 && aborted > 10_000 && hard_resets > 1_000, "{said}");
}

/// Builds and runs an example in Rust. Gives the figure of a name.
fn example(name: &str) -> impl Fn(&str) -> f64 {
    let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    // Of the whole workspace: for one package, Cargo would choose other features and build every dependency once more.
    cargo.current_dir(workspace()).args(["build", "--quiet", "--workspace", "--example", name]);
    if !cfg!(debug_assertions) {
        cargo.arg("--release");
    }
    succeed(&mut cargo);
    let mut example = Command::new(plugins_folder().parent().unwrap().join("examples").join(name));
    let said =
        succeed(example.env("SHIELD_PLUGIN_PATH", plugins_folder()).env("XDG_DATA_HOME", "/nonexistent"));
    move |name| {
        let line = said.lines().find(|line| line.starts_with(name)).unwrap_or_else(|| panic!("{said}"));
        line.split_whitespace().last().unwrap().parse().unwrap()
    }
}

#[test]
fn the_example_in_rust_learns_not_to_fall() {
    let figure = example("wrap_policy");
    assert_eq!(figure("steps"), 6_000.0);
    assert!(figure("early_aborts") > 50.0 && figure("hard_resets") < 200.0);
}

#[test]
fn the_example_in_rust_learns_how_far_its_controller_leads_home() {
    let figure = example("reset_controller");
    assert_eq!(figure("steps"), 6_000.0);
    assert!(figure("reset_successes") > 100.0 && figure("hard_resets") < 0.5 * figure("reset_successes"));
    assert!(figure("success/success_loss").is_finite());
}
