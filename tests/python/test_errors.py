import os
import pathlib
import signal
import subprocess
import sys
import textwrap
import time
import traceback

import gymnasium
import numpy as np
import pytest
import shield
from gymnasium import spaces
from worlds import BELOW_HALF, near_start, table


def act(value):
    return np.array([value], np.float32)


class Broken(Exception):
    pass


@pytest.mark.parametrize("which", ["reset_reward", "in_reset_set"])
def test_a_callback_that_raises_is_swallowed_or_acted_on(which):
    calls = []

    def fails_later(observation):
        calls.append(observation)
        if len(calls) == 3:
            raise Broken("of mine")
        return True

    env = shield.ShieldedEnv(table(), overrides=BELOW_HALF, **{which: fails_later})
    env.reset()
    env.step(act(0.1))
    with pytest.raises(Broken, match="of mine") as raised:
        env.step(act(0.2))
    assert any(frame.name == "fails_later" for frame in traceback.extract_tb(raised.tb))
    executed = list(env.unwrapped.executed)
    with pytest.raises(gymnasium.error.ResetNeeded, match="interrupted"):
        env.step(act(0.3))
    assert env.unwrapped.executed == executed, "something was executed after it"
    assert env.reset()[1]["shield"]["hard_reset"]
    env.step(act(0.3))


def test_a_callback_that_always_raises_lets_an_action_through():
    def fails(_):
        raise Broken

    env = shield.ShieldedEnv(table(), reset_reward=fails, overrides=BELOW_HALF)
    with pytest.raises(Broken):
        env.reset()
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(act(0.1))
    assert env.unwrapped.executed == []


def test_a_policy_that_raises_lets_an_action_through():
    def fails(_):
        raise Broken

    env = shield.ShieldedEnv(table(), in_reset_set=near_start, overrides=BELOW_HALF)
    with pytest.raises(Broken):
        env.run(fails, 3)
    assert env.unwrapped.executed == []


@pytest.mark.parametrize(
    ("given", "error"),
    [
        (lambda _: "far", "reset_reward gave 'far', not a number"),
        (lambda _: None, "reset_reward gave None"),
        (lambda _: float("nan"), "not finite"),
    ],
)
def test_a_reward_that_is_none_is_learned_from(given, error):
    with pytest.raises((TypeError, ValueError), match=error):
        shield.ShieldedEnv(table(), reset_reward=given, overrides=BELOW_HALF).reset()


@pytest.mark.parametrize(
    "action", [[0.1, 0.2], 0.1, np.zeros((1, 1), np.float32), np.array(["a"]), np.array([1j]), None]
)
def test_an_action_of_the_wrong_shape_or_type_names_only_one_of_them(action):
    env = shield.ShieldedEnv(table(), in_reset_set=near_start, overrides=BELOW_HALF)
    env.reset()
    with pytest.raises(ValueError) as raised:
        env.step(action)
    values = np.asarray(action)
    for part in (f"shape {values.shape}", f"dtype {values.dtype}", "shape (1,)", "dtype float32"):
        assert part in str(raised.value)
    assert env.unwrapped.executed == []
    env.step(act(0.1))


@pytest.mark.parametrize("action", [1.0, np.array([1]), "1", True])
def test_a_choice_of_the_wrong_shape_or_type_is_converted(action):
    env = shield.ShieldedEnv(table(chosen=True), in_reset_set=near_start)
    env.reset()
    with pytest.raises(ValueError, match="dtype"):
        env.step(action)
    assert env.unwrapped.executed == []


def test_an_observation_of_the_wrong_shape_names_only_one_of_them():
    guard = shield.Shield(
        spaces.Box(-1, 1, (2,)), spaces.Box(-1, 1, (1,)), in_reset_set=near_start, overrides=BELOW_HALF
    )
    with pytest.raises(ValueError, match=r"shape \(3,\) and dtype float64.*shape \(2,\) and dtype float32"):
        guard.filter(np.zeros(3), act(0.1))


@pytest.mark.parametrize(
    ("space", "says"),
    [
        (spaces.Box(-np.inf, np.inf, (1,)), "infinite bounds"),
        (spaces.MultiDiscrete([2, 2]), "Box or Discrete"),
    ],
)
def test_an_action_space_that_cannot_be_shielded_is_accepted(space, says):
    with pytest.raises(ValueError, match=says):
        shield.Shield(spaces.Box(-1, 1, (2,)), space)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"q_min": "high"}, "q_min='high'"),
        ({"warm_up_steps": -1}, "warm_up_steps=-1"),
        ({"episode_length": 0}, "at least one step"),
        ({"reset_attempts": 0}, "1 failed attempt or more"),
        ({"overrides": {"shield.rulse": "[]"}}, "did you mean `rules`"),
        ({"overrides": {"shield.rules": "[]"}}, "never abort"),
        ({"overrides": {"reset.plugin": '"ddgp"'}}, 'did you mean .*ddpg|similar.*ddpg|"ddpg"'),
        ({"overrides": {"reset.config.critcs": 3}}, "critics"),
        ({"overrides": {"shield.projection": "Best"}}, "Replace"),
        ({"overrides": {"shield.on_abort": "Truncate"}}, "the reward that you give it"),
        ({"config": "nowhere.ron"}, "nowhere.ron"),
    ],
)
def test_a_wrong_setting_is_accepted_or_not_named(arguments, says):
    with pytest.raises(shield.ConfigError, match=says):
        shield.ShieldedEnv(table(), **arguments)


def test_a_fault_in_a_file_has_no_place(tmp_path):
    text = shield.usual_config(False)
    path = tmp_path / "shield.ron"
    path.write_text(text.replace("critics: 5", "critics: 5, actor_hiden: [4]"))
    with pytest.raises(shield.ConfigError) as raised:
        shield.ShieldedEnv(table(), config=path)
    line = next(number for number, line in enumerate(path.read_text().splitlines(), 1) if "actor_hiden" in line)
    assert f"{path}:{line}:" in str(raised.value) and "actor_hidden" in str(raised.value)
    path.write_text(text)
    env = shield.ShieldedEnv(table(), config=path)
    env.reset()
    env.step(act(0.1))


def test_nothing_says_what_reset_means(tmp_path):
    with pytest.raises(ValueError, match="reset_reward or in_reset_set"):
        shield.ShieldedEnv(table(), overrides={"reset_task": None})


def test_ctrl_c_does_not_end_a_training_or_leaves_the_shield_open():
    program = """
        import signal, sys, gymnasium, shield, numpy
        # Where the tests run in the background, Ctrl-C would be ignored.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.path.insert(0, {folder!r})
        from worlds import table, near_start
        env = shield.ShieldedEnv(table(), in_reset_set=near_start, overrides={{"experience.batch": 256}})
        try:
            print("begun", flush=True)
            while True:
                env.run(lambda _: env.action_space.sample(), 1000)
        except KeyboardInterrupt:
            env.reset()
            env.step(numpy.zeros(1, numpy.float32))
            print("stopped", flush=True)
    """
    folder = str(pathlib.Path(__file__).parent)
    program = textwrap.dedent(program).format(folder=folder)
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout.readline() == "begun\n"
        # Into the midst of an update.
        time.sleep(1.0)
        os.kill(child.pid, signal.SIGINT)
        rest, _ = child.communicate(timeout=60)
    finally:
        child.kill()
    assert (rest, child.returncode) == ("stopped\n", 0)
