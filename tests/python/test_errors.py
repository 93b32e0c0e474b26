import math
import os
import pathlib
import re
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
from worlds import BELOW_HALF, BY_VALUES, Table, near_start, table


def act(value):
    return np.array([value], np.float32)


class Broken(Exception):
    pass


@pytest.mark.parametrize("which", ["reset_reward", "in_reset_set"])
def test_an_error_of_a_callback_is_raised_and_requires_a_reset(which):
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


def test_a_callback_that_always_raises_lets_no_action_through():
    def fails(_):
        raise Broken

    env = shield.ShieldedEnv(table(), reset_reward=fails, overrides=BELOW_HALF)
    with pytest.raises(Broken):
        env.reset()
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(act(0.1))
    assert env.unwrapped.executed == []


def test_a_policy_that_raises_lets_no_action_through():
    def fails(_):
        raise Broken

    env = shield.ShieldedEnv(table(), in_reset_set=near_start, overrides=BELOW_HALF)
    with pytest.raises(Broken):
        env.run(fails, 3)
    assert env.unwrapped.executed == []


@pytest.mark.parametrize("during", ["reset", "step", "undo"])
def test_an_environment_without_info_is_an_error_and_requires_a_reset(during):
    class Silent(Table):
        is_silent = during == "reset"

        def reset(self, **arguments):
            observation, info = super().reset(**arguments)
            return observation, None if self.is_silent else info

        def step(self, action):
            *others, info = super().step(action)
            return *others, None if self.is_silent else info

    env = shield.ShieldedEnv(Silent(), in_reset_set=near_start, overrides=BELOW_HALF)
    if during != "reset":
        env.reset()
        env.step(act(0.1))
        env.unwrapped.is_silent = True
    with pytest.raises(TypeError):
        env.step(act(0.2)) if during == "step" else env.reset()
    executed = list(env.unwrapped.executed)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(act(0.3))
    assert env.unwrapped.executed == executed, "something was executed after it"
    env.unwrapped.is_silent = False
    assert env.reset()[1]["shield"]["cause"] == ("first" if during == "reset" else "lost")
    env.step(act(0.3))


class Once:
    """A function that raises when it is called for the nth time."""

    def __init__(self, nth, error=Broken):
        self.left, self.error = nth, error

    def __call__(self, _):
        self.left -= 1
        if self.left == 0:
            raise self.error
        return True


@pytest.mark.parametrize(
    ("seen", "in_reset_set", "error"),
    [
        ([0.0, 1.0], near_start, ValueError),
        (["a"], near_start, ValueError),
        ([math.nan], near_start, shield.ShieldError),
        ([0.0], Once(1), Broken),
        ([0.0], Once(1, KeyboardInterrupt), KeyboardInterrupt),
        ([0.0], lambda _: "no", TypeError),
    ],
)
def test_an_unknown_outcome_requires_a_hard_reset_before_any_action(seen, in_reset_set, error):
    guard = shield.Shield(spaces.Box(-9, 9, (1,)), spaces.Box(-1, 1, (1,)), in_reset_set=in_reset_set)
    assert guard.filter([0.0], act(0.1)).verdict == "allow"
    with pytest.raises(error):
        guard.observe(seen)
    assert guard.needs_hard_reset and not guard.resetting
    refused = guard.filter([0.0], act(0.1))
    assert (refused.verdict, refused.cause, refused.action.tolist()) == ("abort", "awaits_hard_reset", [0.0])


def test_a_hard_reset_that_fails_lets_no_action_through():
    guard = shield.Shield(spaces.Box(-9, 9, (1,)), spaces.Box(-1, 1, (1,)), in_reset_set=Once(2))
    guard.hard_reset_done([0.0])
    with pytest.raises(Broken):
        guard.hard_reset_done([0.0])
    assert guard.needs_hard_reset and not guard.filter([0.0], act(0.1)).allowed
    guard.hard_reset_done([0.0])
    assert guard.filter([0.0], act(0.1)).allowed


@pytest.mark.parametrize("reward", [None, 0.5])
@pytest.mark.parametrize("answer", [float("nan"), "no", None, 1, [True], np.array([True, True]), np.float64(1.0)])
def test_an_answer_of_in_reset_set_that_is_not_a_bool_is_refused(answer, reward):
    reset_reward = None if reward is None else lambda _: reward
    env = shield.ShieldedEnv(table(), reset_reward, in_reset_set=lambda _: answer, overrides=BELOW_HALF)
    with pytest.raises(TypeError, match=f"in_reset_set gave {re.escape(repr(answer))}, not a bool"):
        env.reset()


@pytest.mark.parametrize("answer", [True, np.bool_(False), np.array(True), np.zeros(1)[0] < 1.0])
def test_a_bool_of_numpy_is_accepted(answer):
    shield.ShieldedEnv(table(), in_reset_set=lambda _: answer, overrides=BELOW_HALF).reset()


@pytest.mark.parametrize(
    ("given", "error"),
    [
        (lambda _: "far", "reset_reward gave 'far', not a number"),
        (lambda _: "0.5", "reset_reward gave '0.5', not a number"),
        (lambda _: b"0.5", "reset_reward gave b'0.5', not a number"),
        (lambda _: None, "reset_reward gave None"),
        (lambda _: float("nan"), "not finite"),
    ],
)
def test_a_reset_reward_that_is_not_a_finite_number_is_refused(given, error):
    with pytest.raises((TypeError, ValueError), match=error):
        shield.ShieldedEnv(table(), reset_reward=given, overrides=BELOW_HALF).reset()


@pytest.mark.parametrize(
    "action", [[0.1, 0.2], 0.1, np.zeros((1, 1), np.float32), np.array(["a"]), np.array([1j]), None]
)
def test_an_action_of_the_wrong_shape_or_type_is_refused_with_both(action):
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
def test_a_discrete_action_of_the_wrong_shape_or_type_is_refused(action):
    env = shield.ShieldedEnv(table(chosen=True), in_reset_set=near_start)
    env.reset()
    with pytest.raises(ValueError, match="dtype"):
        env.step(action)
    assert env.unwrapped.executed == []


def test_an_observation_of_the_wrong_shape_is_refused_with_both_shapes():
    guard = shield.Shield(
        spaces.Box(-1, 1, (2,)), spaces.Box(-1, 1, (1,)), in_reset_set=near_start, overrides=BELOW_HALF
    )
    with pytest.raises(ValueError, match=r"shape \(3,\) and dtype float64.*shape \(2,\) and dtype float32"):
        guard.filter(np.zeros(3), act(0.1))


def test_an_action_space_of_whole_numbers_is_refused():
    with pytest.raises(ValueError, match="whole numbers only"):
        shield.Shield(spaces.Box(-1, 1, (1,)), spaces.Box(0, 5, (1,), np.int32), in_reset_set=near_start)


PARTS = spaces.Dict(a=spaces.Box(-9, 9, (2,)), b=spaces.Box(-9, 9, (3,)))
PAIR = spaces.Tuple([spaces.Discrete(4), spaces.Dict(c=spaces.MultiDiscrete([2, 3]))])
WHOLE = spaces.Dict(a=spaces.Box(0, 9, (1,), np.int32))


@pytest.mark.parametrize(
    ("space", "value", "says"),
    [
        (PARTS, {"a": [1, 2, 3], "b": [4, 5]}, r"the observation\['a'\] has shape \(3,\).* wants shape \(2,\)"),
        (PARTS, {"a": [1, 2], "b": "123"}, r"the observation\['b'\] has shape \(\) and dtype <U3"),
        (PARTS, {"a": [1, 2], "b": [3, 4, 5], "c": 6}, "the observation is .*'c'"),
        (PARTS, {"a": [1, 2]}, "the observation is "),
        (PARTS, [1, 2, 3, 4, 5], "the observation is "),
        (PARTS, None, "the observation is None"),
        (PAIR, (-1, {"c": [0, 0]}), r"the observation\[0\] is -1"),
        (PAIR, (1.0, {"c": [0, 0]}), r"the observation\[0\] is 1.0"),
        (PAIR, (1, {"c": [0, 3]}), r"the observation\[1\]\['c'\] is \[0, 3\]"),
        (PAIR, (1, {"c": np.array(["0", "1"])}), r"the observation\[1\]\['c'\] is "),
        (PAIR, (1, {"c": [0, 0]}, 2), "the observation is "),
        (PAIR, np.array(1), "the observation is "),
        (spaces.Discrete(4), -1, "the observation is -1"),
        (spaces.Discrete(4), 4, "the observation is 4"),
        (spaces.MultiBinary(2), np.array([0, 2]), "the observation is "),
        (spaces.MultiBinary(2), np.array(["0", "1"]), "the observation is "),
        (spaces.Text(3), "toolong", "the observation is 'toolong'"),
    ],
)
def test_a_value_outside_the_observation_space_is_refused_by_its_part(space, value, says):
    guard = shield.Shield(space, spaces.Box(-1, 1, (1,)), in_reset_set=near_start)
    with pytest.raises(ValueError, match=says):
        guard.filter(value, act(0.1))
    assert guard.filter(space.sample(), act(0.1)).allowed


def test_a_nested_nan_aborts():
    guard = shield.Shield(WHOLE, spaces.Box(-1, 1, (1,)), in_reset_set=lambda _: True)
    guard.hard_reset_done({"a": [1]})
    assert not guard.filter({"a": [math.nan]}, act(0.1)).allowed


@pytest.mark.parametrize(
    "space",
    [
        PARTS,
        PAIR,
        WHOLE,
        spaces.Tuple([spaces.Box(-1, 1, (2, 2)), spaces.MultiBinary([2, 2]), spaces.Discrete(3, start=-1)]),
        spaces.OneOf([spaces.Discrete(2), spaces.Box(-1, 1, (2,))]),
        spaces.Text(4),
    ],
)
def test_an_observation_is_flattened_in_the_order_of_gymnasium(space):
    guard = shield.Shield(space, spaces.Box(-1, 1, (1,)), in_reset_set=near_start)
    space.seed(0)
    for _ in range(5):
        sample = space.sample()
        guard.filter(sample, act(0.1))
        assert guard._seen.tolist() == spaces.flatten(space, sample).astype(np.float32).tolist()


@pytest.mark.parametrize(
    ("space", "says"),
    [
        (spaces.Box(-np.inf, np.inf, (1,)), "infinite bounds"),
        (spaces.Text(3), "Box, Discrete, MultiDiscrete or MultiBinary"),
    ],
)
def test_an_action_space_that_cannot_be_shielded_is_refused(space, says):
    with pytest.raises(ValueError, match=says):
        shield.Shield(spaces.Box(-1, 1, (2,)), space)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"q_min": 5}, "give accepted_risk="),
        ({"accepted_risk": "high"}, "accepted_risk='high'"),
        ({"accepted_risk": 1.5}, "accepted_risk"),
        ({"calibration_resets": -1}, "calibration_resets=-1"),
        ({"calibration_resets": 2, "in_reset_set": near_start}, "calibration_resets=2.*leave it out"),
        ({"q_min": "high", "overrides": BY_VALUES}, "q_min='high'"),
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
def test_a_wrong_setting_is_refused_by_name(arguments, says):
    with pytest.raises(shield.ConfigError, match=says):
        shield.ShieldedEnv(table(), **arguments)


def test_a_fault_in_a_file_is_refused_with_its_place(tmp_path):
    text = shield.usual_config(False)
    path = tmp_path / "shield.ron"
    path.write_text(text.replace("critics: 1", "critics: 1, actor_hiden: [4]"))
    with pytest.raises(shield.ConfigError) as raised:
        shield.ShieldedEnv(table(), config=path)
    line = next(number for number, line in enumerate(path.read_text().splitlines(), 1) if "actor_hiden" in line)
    assert f"{path}:{line}:" in str(raised.value) and "actor_hidden" in str(raised.value)
    path.write_text(text)
    env = shield.ShieldedEnv(table(), config=path)
    env.reset()
    env.step(act(0.1))


def test_a_shield_without_a_reset_task_is_refused(tmp_path):
    with pytest.raises(ValueError, match="reset_reward or in_reset_set"):
        shield.ShieldedEnv(table(), overrides={"reset_task": None})


def test_ctrl_c_ends_a_training_and_the_shield_stays_usable():
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


def test_a_forked_process_cannot_use_the_shield_of_its_parent():
    guard = shield.Shield(spaces.Box(-9, 9, (1,)), spaces.Box(-1, 1, (1,)), in_reset_set=lambda _: True, threads=2)
    guard.filter([0.0], act(0.1))
    child = os.fork()
    if child == 0:
        try:
            guard.filter([0.0], act(0.1))
        except shield.ShieldError as error:
            os._exit(7 if "another process" in str(error) else 1)
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    assert guard.filter([0.0], act(0.1)).allowed
