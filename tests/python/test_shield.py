import threading
import time

import numpy as np
import pytest
import shield
from gymnasium import spaces
from worlds import BELOW_HALF, BY_VALUES, near_start

SPACES = (spaces.Box(-2, 2, (1,)), spaces.Box(-1, 1, (1,)))


def test_a_control_loop_without_gymnasium_is_aborted_and_brought_back():
    guard = shield.Shield(*SPACES, in_reset_set=near_start, overrides=BELOW_HALF, episode_length=10_000)
    position, seen = 0.0, []
    for step in range(300):
        decision = guard.filter(np.array([position]), np.array([0.75 if step == 9 else 0.5], np.float32))
        seen.append(decision.verdict)
        assert decision.allowed == (decision.verdict == "allow")
        position += 0.1 * float(decision.action[0])
        guard.observe(np.array([position]))
        if seen[-1] == "resetting" and not guard.resetting:
            break
    assert seen[:10] == ["allow"] * 9 + ["abort"] and set(seen[10:]) == {"resetting"}
    assert near_start([position]) and guard.metrics()["reset_successes"] == 1


def test_failed_attempts_require_a_hard_reset():
    guard = shield.Shield(*SPACES, in_reset_set=lambda _: False, overrides=BELOW_HALF, episode_length=2)
    start = np.zeros(1)
    guard.filter(start, np.array([0.75], np.float32))
    for _ in range(2):
        assert guard.resetting
        guard.filter(start, np.zeros(1, np.float32))
        guard.observe(start)
    assert guard.needs_hard_reset
    refused = guard.filter(start, np.array([0.25], np.float32))
    assert (refused.verdict, refused.cause, refused.action.tolist()) == ("abort", "awaits_hard_reset", [0.0])
    guard.hard_reset_done(start)
    assert guard.filter(start, np.array([0.25], np.float32)).allowed
    assert guard.metrics()["hard_resets"] == 1


RULE = '[(plugin: "ensemble-threshold", config: ({}))]'
RISING = "q_min: -9.0, schedule: Linear, final_q_min: Some(-9.0), schedule_steps: 1"


@pytest.mark.parametrize(
    "rule",
    ["q_min: -9.0", RISING, "q_min: -9.0 /* schedule: Linear */", "q_min: -9.0, schedule: /* none */ Constant"],
)
@pytest.mark.parametrize("is_file", [True, False])
def test_q_min_is_where_a_schedule_ends_or_all_along_without_one(rule, is_file, tmp_path):
    rules = RULE.format(rule)
    if is_file:
        usual, own = shield.usual_config(False), 'rules: [(plugin: "undo-probability")]'
        assert own in usual
        (tmp_path / "shield.ron").write_text(usual.replace(own, f"rules: {rules}"))
        arguments = {"config": tmp_path / "shield.ron"}
    else:
        arguments = {"overrides": {"shield.rules": rules}}
    for q_min, verdicts in ((-9.0, {"allow"}), (1e6, {"abort", "resetting"})):
        guard = shield.Shield(*SPACES, in_reset_set=near_start, q_min=q_min, warm_up_steps=2, **arguments)
        for _ in range(4):
            verdict = guard.filter(np.zeros(1), np.zeros(1, np.float32)).verdict
            guard.observe(np.zeros(1))
            if guard.metrics()["steps"] > 2:
                assert verdict in verdicts


def test_the_accepted_risk_is_that_of_the_first_rule():
    def metrics(**arguments):
        guard = shield.Shield(*SPACES, in_reset_set=near_start, updates_per_step=0, **arguments)
        guard.filter(np.zeros(1), np.zeros(1, np.float32))
        guard.observe(np.zeros(1))
        return guard.metrics()

    assert metrics()["accepted_risk"] == pytest.approx(0.2)
    assert metrics(accepted_risk=0.4)["accepted_risk"] == pytest.approx(0.4)
    # The threshold begins at what must succeed.
    assert metrics(accepted_risk=0.4)["threshold"] == pytest.approx(0.6)
    assert "accepted_risk" not in metrics(overrides=BELOW_HALF)


def test_a_setting_of_another_rule_is_refused_with_the_remedy():
    with pytest.raises(shield.ConfigError, match="q_min=5.*'undo-probability'.*give accepted_risk="):
        shield.Shield(*SPACES, q_min=5)
    with pytest.raises(shield.ConfigError, match="accepted_risk=0.1: .*'ensemble-threshold'.*q_min="):
        shield.Shield(*SPACES, accepted_risk=0.1, overrides=BY_VALUES)
    composed = {"shield.rules": '[Any([(plugin: "undo-probability"), (plugin: "undo-probability")])]'}
    with pytest.raises(shield.ConfigError, match="accepted_risk=0.1: the first rule is composed"):
        shield.Shield(*SPACES, accepted_risk=0.1, overrides=composed)
    shield.Shield(*SPACES, q_min=5, overrides=BY_VALUES)


def test_the_undo_probability_of_the_proposed_action_is_told():
    guard = shield.Shield(*SPACES, in_reset_set=near_start)
    decision = guard.filter(np.zeros(1), np.zeros(1, np.float32))
    assert 0.0 <= decision.undo_probability <= 1.0 and decision.reset_value is None
    by_values = shield.Shield(*SPACES, in_reset_set=near_start, overrides=BY_VALUES, warm_up_steps=0)
    decision = by_values.filter(np.zeros(1), np.zeros(1, np.float32))
    assert decision.undo_probability is None and np.isfinite(decision.reset_value)


def test_other_threads_run_while_the_ensemble_learns():
    large = {
        "reset.config.critic_hidden": [400, 300],
        "reset.config.actor_hidden": [400, 300],
        "reset.config.critics": 20,
        "experience.batch": 256,
    }
    guard = shield.Shield(*SPACES, in_reset_set=near_start, overrides=large, updates_per_step=20)
    ticks, stop = [], threading.Event()

    def tick():
        while not stop.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.001)

    observation, action = np.zeros(1), np.zeros(1, np.float32)
    for _ in range(255):
        guard.filter(observation, action)
        guard.observe(observation)
    thread = threading.Thread(target=tick)
    thread.start()
    before = len(ticks)
    guard.filter(observation, action)
    guard.observe(observation)
    during = len(ticks) - before
    stop.set()
    thread.join()
    assert during > 5, f"another thread ran {during} times during twenty updates"


def test_two_shields_keep_their_metrics_separate():
    quick = {"experience.batch": 4}
    learning, idle = (
        shield.Shield(*SPACES, in_reset_set=near_start, overrides=quick, updates_per_step=updates)
        for updates in (1, 0)
    )
    for _ in range(10):
        for guard in (learning, idle):
            guard.filter(np.zeros(1), np.zeros(1, np.float32))
            guard.observe(np.zeros(1))
    assert "reset/critic_loss" in learning.metrics() and "reset/critic_loss" not in idle.metrics()


def test_the_reset_agent_learns_after_every_nth_step_only():
    rare = shield.Shield(*SPACES, in_reset_set=near_start, overrides={"experience.batch": 4}, update_every=9)
    for step in range(1, 10):
        rare.filter(np.zeros(1), np.zeros(1, np.float32))
        rare.observe(np.zeros(1))
        assert ("reset/critic_loss" in rare.metrics()) == (step == 9)
