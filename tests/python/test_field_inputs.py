"""What code that people already have gives to a shield and gets from it: each case was tried, and went wrong once."""

import copy
import pickle
import re
import warnings

import gymnasium
import numpy as np
import pytest
import shield
from gymnasium import spaces
from worlds import BELOW_HALF, Table, act, near_start, shielded, table


def test_an_action_outside_is_clipped_where_that_is_wanted():
    env = shielded(overrides=BELOW_HALF | {"shield.rules": '[(plugin: "undo-probability")]'}, clip=True)
    env.reset(seed=0)
    proposed = np.array([3.0])
    info = env.step(proposed)[4]
    assert info["shield"]["verdict"] == "allow" and info["shield"]["proposed"] is proposed
    assert env.unwrapped.executed == [1.0]
    assert env.step(np.array([np.nan]))[4]["shield"]["cause"] == "invalid_action"
    with pytest.raises(ValueError, match="clip=True is for a box"):
        shielded(table(chosen=True), clip=True)


def test_many_actions_outside_are_told_once_with_the_remedy():
    env = shielded(overrides=BELOW_HALF | {"shield.rules": '[(plugin: "undo-probability")]'})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(25):
            env.reset()
            env.step(np.array([1.5]))
    told = [str(each.message) for each in caught if getattr(each.message, "name", "") == "invalid-actions"]
    assert len(told) == 1 and "Put ClipAction around the shield" in told[0] and "clip=True" in told[0]


def test_clip_action_inside_is_refused_and_works_around():
    with pytest.raises(ValueError, match="Put ClipAction around the shield.*clip=True"):
        shielded(gymnasium.wrappers.ClipAction(Table()))
    env = gymnasium.wrappers.ClipAction(shielded(overrides=BELOW_HALF | {"shield.rules": '[(plugin: "undo-probability")]'}))
    env.reset(seed=0)
    env.step(np.array([7.0], np.float32))
    assert env.unwrapped.executed == [1.0]


class Levers(gymnasium.Env):
    """Remembers what was done to it, which must be of its space."""

    def __init__(self, space):
        self.observation_space, self.action_space = spaces.Box(-1, 1, (1,)), space
        self.executed = []

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        assert self.action_space.contains(action), f"{action!r} reached the environment"
        self.executed.append(action)
        return np.full(1, 0.9, np.float32), 0.0, False, False, {}


@pytest.mark.filterwarnings("error::UserWarning")
@pytest.mark.parametrize(
    "space",
    [
        spaces.MultiDiscrete([3, 2, 4]),
        spaces.MultiDiscrete([3, 2], start=[-1, 5]),
        spaces.MultiDiscrete([[2, 2], [3, 1]]),
        spaces.MultiBinary(4),
        spaces.MultiBinary([2, 2]),
        spaces.Box(-1.0, 1.0, ()),
        spaces.Box(-1.0, 1.0, (), np.float64),
        spaces.Box(-1.0, 1.0, (2, 3)),
    ],
    ids=str,
)
def test_actions_of_several_parts_or_of_any_shape_reach_the_environment_as_its_space_has_them(space):
    env = shield.ShieldedEnv(Levers(space), in_reset_set=lambda seen: bool(seen[0] < 0.5), episode_length=5, updates_per_step=0)
    env = gymnasium.wrappers.PassiveEnvChecker(env)
    space.seed(0)
    env.reset(seed=0)
    for _ in range(3):
        proposed = space.sample()
        info = env.step(proposed)[4]
        assert info["shield"]["verdict"] in ("allow", "project")
        if info["shield"]["verdict"] == "allow":
            assert np.array_equal(env.unwrapped.executed[-1], proposed)
    env.reset()
    assert len(env.unwrapped.executed) == 8, "the reset agent made five steps"


def test_a_choice_outside_is_aborted_and_too_many_combinations_are_refused():
    guard = shield.Shield(spaces.Box(-1, 1, (1,)), spaces.MultiDiscrete([3, 2]), in_reset_set=lambda _: True)
    decision = guard.filter(np.zeros(1), np.array([3, 0]))
    assert (decision.verdict, decision.cause) == ("abort", "invalid_action") and "[3, 0] is not one of" in decision.reason
    with pytest.raises(ValueError, match="wants shape"):
        guard.filter(np.zeros(1), np.array([1]))
    with pytest.raises(ValueError, match="1,048,576 combinations"):
        shield.Shield(spaces.Box(-1, 1, (1,)), spaces.MultiBinary(20), in_reset_set=lambda _: True)


class Masked(Levers):
    def __init__(self):
        super().__init__(spaces.Discrete(4))

    def action_masks(self):
        return np.array([True, False, True, False])

    def step(self, action):
        assert self.action_masks()[action], "a masked action"
        return super().step(action)


def test_action_masks_are_refused_unless_a_reset_policy_keeps_to_them():
    with pytest.raises(ValueError, match="action masks.*reset_policy"):
        shield.ShieldedEnv(Masked(), in_reset_set=near_start)
    env = shield.ShieldedEnv(Masked(), in_reset_set=lambda _: False, reset_policy=lambda _: 2, episode_length=3)
    env.reset(seed=0)
    env.step(np.int64(0))
    env.reset()
    assert [int(action) for action in env.unwrapped.executed] == [0, 2, 2, 2]


def test_a_mask_in_the_info_is_there_after_a_soft_reset_and_told_of_once():
    class Told(Levers):
        def __init__(self):
            super().__init__(spaces.Discrete(2))

        def reset(self, **arguments):
            return super().reset(**arguments)[0], {"action_mask": np.array([1, 1], np.int8)}

        def step(self, action):
            return *super().step(action)[:4], {"action_mask": np.array([1, 0], np.int8)}

    with pytest.warns(shield.ShieldWarning, match="action mask in its info") as caught:
        env = shield.ShieldedEnv(Told(), in_reset_set=lambda _: True)
        env.reset(seed=0)
        env.step(np.int64(0))
        _, info = env.reset()
        assert not info["shield"]["hard_reset"] and info["action_mask"].tolist() == [1, 0]
        env.reset(seed=1)
    assert len([each for each in caught if getattr(each.message, "name", "") == "masks-ignored"]) == 1


@pytest.mark.parametrize(("abort_reward", "pays"), [(0.0, True), (-50.0, False)])
def test_a_reward_of_an_abort_that_pays_is_told(abort_reward, pays):
    class Costly(Table):
        def step(self, action):
            observation, _, *others = super().step(action)
            return observation, -1.0, *others

    env = shielded(gymnasium.wrappers.TimeLimit(Costly(), 50), abort_reward=abort_reward, updates_per_step=0)
    env.reset(seed=0)
    while env.metrics()["forward_steps"] < 600:
        if env.step(act(0.1))[3]:
            env.reset()
    findings = dict(env.findings())
    assert ("aborts-pay" in findings) == pays
    if pays:
        assert "500 of the last 500 rewards were below 0" in findings["aborts-pay"]


def test_an_observation_that_the_caller_changes_is_not_the_one_that_is_kept():
    env = shielded()
    observation, _ = env.reset(seed=0)
    observation *= 0
    observation = env.step(act(0.4))[0]
    seen = observation.copy()
    observation *= 0
    again = env.step(act(0.75))[0]
    assert again == seen and again != 0
    again *= 0
    assert env.reset()[0] != 0


def test_an_environment_that_writes_over_its_observations_does_not_change_what_was_given():
    class Reusing(Table):
        buffer = np.zeros(1)

        def observation(self):
            self.buffer[0] = self.position
            return self.buffer

    env = shielded(Reusing())
    env.reset(seed=0)
    first = env.step(act(0.4))[0]
    before = first.copy()
    env.step(act(0.4))
    assert first == before


IMAGE = spaces.Box(0, 255, (84, 84, 4), np.uint8)


def test_images_are_kept_as_bytes_and_the_memory_is_told_before_it_is_used():
    small = {"experience.capacity": 1_000, "reset.config.actor_hidden": [4], "reset.config.critic_hidden": [4]}
    steering = spaces.Box(-1, 1, (1,))
    home = {"in_reset_set": lambda _: True, "updates_per_step": 0}
    with pytest.warns(shield.ShieldWarning, match=r"takes (\d+\.\d) GiB once it is full.*28,224 numbers.*experience.capacity") as caught:
        shield.Shield(IMAGE, steering, **home, overrides=small | {"experience.capacity": 100_000})
    as_bytes = float(str(caught[0].message).split("takes ")[1].split(" ")[0])
    with pytest.warns(shield.ShieldWarning, match="GiB") as caught:
        floats = spaces.Box(0.0, 255.0, (84, 84, 4))
        shield.Shield(floats, steering, **home, overrides=small | {"experience.capacity": 100_000})
    as_floats = float(str(caught[0].message).split("takes ")[1].split(" ")[0])
    assert 5.0 < as_bytes < 8.0 and as_floats > 3 * as_bytes
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        guard = shield.Shield(IMAGE, steering, **home, overrides=small)
    IMAGE.seed(0)
    guard.filter(IMAGE.sample(), act(0.1))
    guard.observe(IMAGE.sample())
    assert guard.metrics()["steps"] == 1


SCAN = spaces.Dict(scan=spaces.Box(-np.inf, np.inf, (2, 3)), speed=spaces.Box(-np.inf, np.inf, (), np.float64))


@pytest.mark.parametrize(
    ("part", "value", "says"),
    [
        ("scan", np.array([[0, 0, 0], [0, np.inf, 0]], np.float32), r"the observation\['scan'\] has inf at index \(1, 1\): clip it"),
        ("scan", np.full((2, 3), -np.inf, np.float32), r"has -inf at index \(0, 0\) \(and 5 more\)"),
        ("speed", np.array(np.nan), r"the observation\['speed'\] has NaN: find out"),
        ("speed", np.array(1e39), r"the observation\['speed'\] has .*1e\+39.*more than a 32-bit float holds.*scale it"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_reading_that_is_not_finite_is_named_by_its_part_and_index_with_a_remedy(part, value, says):
    good = {"scan": np.zeros((2, 3), np.float32), "speed": np.array(0.0)}
    guard = shield.Shield(SCAN, spaces.Box(-1, 1, (1,)), in_reset_set=lambda _: True)
    bad = good | {part: value}
    with pytest.raises(shield.ShieldError, match=says):
        guard.hard_reset_done(bad)
    guard.hard_reset_done(good)
    refused = guard.filter(bad, act(0.1))
    assert refused.cause == "invalid_observation" and re.search(says, refused.reason)
    with pytest.raises(shield.ShieldError, match=says):
        guard.observe(bad)
    assert guard.needs_hard_reset


def test_normalised_observations_inside_are_told_and_around_are_not():
    with pytest.warns(shield.ShieldWarning, match=r"NormalizeObservation\(shield.ShieldedEnv\(env\)\)"):
        shielded(gymnasium.wrappers.NormalizeObservation(Table()))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gymnasium.wrappers.NormalizeObservation(shielded())


def test_an_end_of_the_environment_that_shows_its_start_is_no_success():
    class Restarting(Table):
        def step(self, action):
            *_, info = super().step(action)
            is_over = len(self.executed) >= 3
            return np.zeros(1) if is_over else np.full(1, 0.9), 0.0, is_over, False, info

    env = shielded(Restarting())
    env.reset(seed=0)
    env.step(act(0.3))
    _, info = env.reset()
    assert info["shield"] == {"hard_reset": True, "steps": 2, "cause": "terminated", "is_repeated": False}
    assert env.metrics()["reset_successes"] == 0


def test_a_simulation_that_mujoco_reset_by_itself_is_lost_and_no_success():
    env = gymnasium.make("Reacher-v5")
    random = np.random.default_rng(0)
    is_home = lambda _: bool(env.unwrapped.data.time < 0.05)  # noqa: E731
    env = shield.ShieldedEnv(env, in_reset_set=is_home, overrides={"experience.batch": 100_000}, episode_length=50)
    env.reset(seed=0)
    for _ in range(5):
        env.step(random.uniform(-0.4, 0.4, 2).astype(np.float32))
    step = env.unwrapped.step

    def explodes(action):
        env.unwrapped.data.qvel[:] = 1e12
        return step(action)

    env.unwrapped.step = explodes
    with pytest.warns(shield.ShieldWarning, match="MuJoCo reset the simulation by itself"):
        _, info = env.reset()
    assert (info["shield"]["hard_reset"], info["shield"]["cause"]) == (True, "lost")
    assert env.metrics()["reset_successes"] == 0
    env.unwrapped.step = step
    env.step(np.zeros(2, np.float32))


def test_a_vector_of_environments_is_refused_with_where_the_shield_belongs():
    from stable_baselines3.common.vec_env import DummyVecEnv

    for envs in (gymnasium.vector.SyncVectorEnv([Table]), DummyVecEnv([Table])):
        with pytest.raises(TypeError, match="vector of environments.*around each.*wrapper_class=shield.ShieldedEnv"):
            shield.ShieldedEnv(envs, in_reset_set=near_start)
    with pytest.raises(TypeError, match="int is not a gymnasium.Env"):
        shield.ShieldedEnv(3, in_reset_set=near_start)


@pytest.mark.parametrize(
    ("values", "says"),
    [(6, "gave 6 values, not the five.*SafetyGymnasium2Gymnasium"), (4, "gave 4 values.*shimmy")],
)
def test_a_step_with_other_than_five_values_is_refused_with_the_wrapper_that_helps(values, says):
    class Other(Table):
        def step(self, action):
            return (*super().step(action), 0.0)[:values]

    env = shielded(Other())
    env.reset(seed=0)
    with pytest.raises(ValueError, match=says):
        env.step(act(0.1))
    assert env.shield.needs_hard_reset


def test_an_environment_of_safety_gymnasium_is_refused_before_it_acts():
    class Costs(Table):
        pass

    Costs.__module__ = "safety_gymnasium.builder"
    with pytest.raises(TypeError, match="six values.*SafetyGymnasium2Gymnasium"):
        shielded(Costs())


@pytest.mark.parametrize("take", [pickle.dumps, copy.copy, copy.deepcopy])
def test_a_shield_is_not_copied_and_says_what_to_use(take):
    env = shielded()
    for each in (env, env.shield):
        with pytest.raises(TypeError, match="cannot be pickled or copied.*save\\(path\\).*frozen"):
            take(each)
