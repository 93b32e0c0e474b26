"""Evaluations, infos and resets as code that people already have wants them: each case was tried, and went wrong once."""

import warnings

import gymnasium
import numpy as np
import pytest
import shield
from gymnasium import spaces
from worlds import BELOW_HALF, Ending, Table, act, shielded, table


class Telling(Table):
    """Says in its info where it is, and whether that is where it should be."""

    def reset(self, **arguments):
        observation, _ = super().reset(**arguments)
        return observation, {"is_success": False, "position": self.position}

    def step(self, action):
        *others, _ = super().step(action)
        return *others, {"is_success": self.position > 0.5, "position": self.position}


def kept(env, folder):
    env.save(folder / "state")
    return (folder / "state").read_bytes()


def test_a_frozen_environment_is_shielded_and_neither_learns_nor_counts(tmp_path):
    quick = BELOW_HALF | {"experience.batch": 8, "reset.config.random_steps": 0}
    env = shielded(overrides=quick)
    env.run(lambda _: act(0.3), 60, seed=0)
    before, counted = kept(env, tmp_path), env.metrics()
    other = env.frozen(table())
    returns = other.run(lambda _: act(0.3), 100, seed=1)
    assert len(returns) > 1 and len(other.unwrapped.executed) >= 100
    assert kept(env, tmp_path) == before and env.metrics() == counted == other.metrics()
    other.reset()
    assert other.step(act(0.75))[4]["shield"]["rule"] == "linear-constraints"
    assert kept(env, tmp_path) == before
    with pytest.raises(shield.ShieldError, match="frozen"):
        other.save(tmp_path / "other")


def test_a_training_goes_on_after_an_evaluation_as_if_there_had_been_none(tmp_path):
    def trained(evaluates):
        # Its threshold follows how attempts end.
        env = shielded(table(), overrides={"experience.batch": 8}, seed=3)
        random = np.random.default_rng(0)
        for part in range(3):
            env.run(lambda _: random.uniform(-1.0, 1.0, 1), 100, seed=part)
            if evaluates:
                env.frozen(table()).run(lambda _: act(0.9), 150, seed=9)
        return kept(env, tmp_path)

    assert trained(True) == trained(False)


def test_a_frozen_environment_has_no_warm_up_of_its_own_and_no_state_in_common():
    rules = {"shield.rules": '[(plugin: "ensemble-threshold", config: (q_min: 1e9))]'}
    env = shielded(overrides=rules, warm_up_steps=10)
    env.run(lambda _: act(0.1), 15, seed=0)
    env.reset(seed=0)
    other = env.frozen(table())
    with pytest.raises(gymnasium.error.ResetNeeded, match="before"):
        other.step(act(0.1))
    other.reset(seed=1)
    assert other.step(act(0.1))[4]["shield"]["verdict"] == "abort"
    # The abort was elsewhere.
    assert not env.shield.resetting and other.shield.resetting
    assert env.step(act(0.1))[4]["shield"]["verdict"] == "abort"


def test_a_frozen_environment_with_other_spaces_is_refused():
    with pytest.raises(ValueError, match="the action_space of the other environment is Discrete"):
        shielded().frozen(table(chosen=True))


def test_a_frozen_environment_keeps_to_a_time_limit():
    env = shielded(table(limit=7))
    for other, steps in ((table(limit=3), 3), (Table(), 7)):
        other = env.frozen(other)
        other.reset(seed=0)
        assert [other.step(act(0.1))[3] for _ in range(steps)] == [False] * (steps - 1) + [True]


def test_the_callback_of_stable_baselines_evaluates_behind_the_trained_shield():
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import EvalCallback
    from stable_baselines3.common.monitor import Monitor

    env = shielded()
    other = env.frozen(table())
    callback = EvalCallback(Monitor(other), eval_freq=50, n_eval_episodes=2, verbose=0)
    PPO("MlpPolicy", env, n_steps=64, batch_size=32, n_epochs=1, policy_kwargs={"net_arch": [8]}, seed=0).learn(128, callback)
    assert np.isfinite(callback.last_mean_reward) and other.unwrapped.executed
    assert max(other.unwrapped.executed) <= 1.0
    assert env.metrics()["steps"] == len(env.unwrapped.executed)


def test_an_aborted_step_and_a_soft_reset_bring_the_last_info_of_the_environment_again():
    env = shielded(Telling())
    _, info = env.reset(seed=0)
    assert info["position"] == env.unwrapped.position and not info["shield"]["is_repeated"]
    info = env.step(act(0.25))[4]
    assert not info["shield"]["is_repeated"]
    aborted = env.step(act(0.75))[4]
    assert aborted["position"] == info["position"] and aborted["shield"]["is_repeated"]
    _, info = env.reset()
    assert info["position"] == env.unwrapped.position and info["shield"]["is_repeated"]


def test_the_monitor_of_stable_baselines_finds_its_keywords_after_an_abort():
    from stable_baselines3.common.monitor import Monitor

    env = Monitor(shielded(Telling()), info_keywords=("is_success",))
    env.reset(seed=0)
    assert env.step(act(0.75))[4]["episode"]["is_success"] is False


def test_what_a_wrapper_inside_tells_at_the_end_of_an_episode_is_told_once():
    class Ends(Telling):
        def step(self, action):
            *others, info = super().step(action)
            return *others, info | {"episode": {"r": 1.0}}

    env = shielded(Ends())
    env.reset(seed=0)
    assert "episode" in env.step(act(0.25))[4]
    aborted = env.step(act(0.75))[4]
    assert "episode" not in aborted and "position" in aborted


def test_a_reset_tells_the_cause_of_a_hard_one():
    env = shielded(table(terminates=True, limit=100), in_reset_set=lambda _: False, episode_length=3)
    causes = [env.reset()[1]["shield"]["cause"]]
    env.step(act(0.1))
    causes.append(env.reset()[1]["shield"]["cause"])
    causes.append(env.reset(seed=1)[1]["shield"]["cause"])
    while not env.step(act(0.5))[2]:
        pass
    causes.append(env.reset()[1]["shield"]["cause"])
    with pytest.raises(AssertionError):
        env.env.unwrapped.action_space = spaces.Box(5, 6, (1,), np.float32)
        env.step(act(0.1))
    causes.append(env.reset()[1]["shield"]["cause"])
    assert causes == ["first", "cycle_over", "requested", "terminated", "lost"]


def test_empty_options_are_no_options():
    env = shielded()
    env.reset(seed=0)
    env.step(act(0.1))
    assert not env.reset(options={})[1]["shield"]["hard_reset"]


def test_a_vector_of_environments_that_resets_by_a_mask_resets_softly():
    mode = gymnasium.vector.AutoresetMode.DISABLED
    envs = gymnasium.vector.SyncVectorEnv([shielded, shielded], autoreset_mode=mode)
    envs.reset(seed=0)
    envs.step(np.array([[0.3], [0.3]], np.float32))
    _, _, _, truncated, _ = envs.step(np.array([[0.75], [0.3]], np.float32))
    assert truncated.tolist() == [True, False]
    _, info = envs.reset(options={"reset_mask": np.array([True, False])})
    assert not info["shield"]["hard_reset"][0] and envs.envs[0].unwrapped.resets == 1


def test_a_soft_reset_with_a_seed_can_be_asked_for():
    drawn = []
    env = shielded(on_soft_reset=lambda inside: drawn.append(float(inside.unwrapped.np_random.random())))
    env.reset(seed=0)
    for seed in (5, 5, 6):
        env.step(act(0.1))
        assert not env.reset(seed=seed, options={"soft_reset": True})[1]["shield"]["hard_reset"]
    assert drawn[0] == drawn[1] != drawn[2] and env.unwrapped.resets == 1
    assert env.reset(options={"soft_reset": False})[1]["shield"] == {
        "hard_reset": True,
        "steps": 0,
        "cause": "requested",
        "is_repeated": False,
    }
    with pytest.raises(TypeError, match="soft_reset.* is 'yes', not a bool"):
        env.reset(options={"soft_reset": "yes"})


def test_a_soft_reset_that_fails_gives_seed_and_options_to_the_hard_one():
    given = []

    class Noting(Table):
        def reset(self, *, seed=None, options=None):
            given.append((seed, options))
            return super().reset(seed=seed)

    env = shielded(Noting(), in_reset_set=lambda _: False, episode_length=2)
    env.reset(seed=0)
    env.step(act(0.1))
    env.reset(seed=7, options={"soft_reset": True, "where": "left"})
    assert given == [(0, None), (7, {"where": "left"})]


@pytest.mark.parametrize(
    ("make", "reset", "name", "says"),
    [
        (lambda: table(limit=3), {"seed": 1}, "resets-requested", "Give a seed to the first reset only"),
        (lambda: Ending(3), {}, "resets-truncated", "clock of its own"),
    ],
)
def test_resets_that_are_always_hard_are_told_once_with_the_remedy(make, reset, name, says):
    env = shielded(make())
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(12):
            env.reset(**reset)
            while not env.step(act(0.1))[3]:
                pass
    told = [str(each.message) for each in caught if getattr(each.message, "name", "") == name]
    assert len(told) == 1 and says in told[0]


class Goals(gymnasium.Env):
    """A cart that shall go to a goal, as hindsight experience replay wants it."""

    def __init__(self):
        box = spaces.Box(-2.0, 2.0, (1,), np.float64)
        self.observation_space = spaces.Dict(observation=box, achieved_goal=box, desired_goal=box)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.goals, self.position = [], 0.0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.position = 0.0
        return self.draw(), {}

    def draw(self):
        self.goals.append(float(self.np_random.uniform(-1.0, 1.0)))
        return self.observation()

    def observation(self):
        position, goal = np.array([self.position]), np.array([self.goals[-1]])
        return {"observation": position, "achieved_goal": position, "desired_goal": goal}

    def compute_reward(self, achieved, desired, _):
        return -(np.abs(achieved - desired)[..., 0] > 0.1).astype(float)

    def step(self, action):
        self.position = float(np.clip(self.position + 0.1 * float(action[0]), -1.0, 1.0))
        seen = self.observation()
        return seen, float(self.compute_reward(seen["achieved_goal"], seen["desired_goal"], {})), False, False, {}


def test_every_episode_has_a_new_goal_where_a_soft_reset_draws_one():
    env = shield.ShieldedEnv(
        gymnasium.wrappers.TimeLimit(Goals(), 10),
        in_reset_set=lambda seen: bool(abs(seen["observation"][0]) < 0.3),
        on_soft_reset=lambda inside: inside.unwrapped.draw(),
        overrides=BELOW_HALF,
    )
    seen = []
    for episode in range(20):
        observation, _ = env.reset(seed=None if episode else 0)
        assert observation["desired_goal"][0] == env.unwrapped.goals[-1]
        seen.append(observation["desired_goal"][0])
        first = env.step(act(0.3))[0]
        assert first["desired_goal"][0] == seen[-1]
    assert len(set(seen)) == 20


def test_a_hook_that_raises_requires_a_hard_reset():
    def fails(_):
        raise OSError("the door is stuck")

    env = shielded(on_soft_reset=fails)
    env.reset(seed=0)
    env.step(act(0.1))
    with pytest.raises(OSError, match="stuck"):
        env.reset()
    assert env.reset()[1]["shield"]["cause"] == "lost"


def test_hindsight_experience_replay_trains_over_a_goal_environment():
    from stable_baselines3 import SAC, HerReplayBuffer

    env = shield.ShieldedEnv(
        gymnasium.wrappers.TimeLimit(Goals(), 10),
        in_reset_set=lambda seen: bool(abs(seen["observation"][0]) < 0.3),
        on_soft_reset=lambda inside: inside.unwrapped.draw(),
        overrides=BELOW_HALF,
    )
    SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        learning_starts=60,
        batch_size=16,
        policy_kwargs={"net_arch": [8]},
        seed=0,
    ).learn(120)
    assert env.metrics()["reset_successes"] > 0


def test_a_first_action_that_is_rejected_leaves_nothing_to_undo():
    rules = '[(plugin: "undo-probability"), (plugin: "linear-constraints", config: (constraints: [(a: [1.0], b: 0.5)]))]'
    env = shielded(in_reset_set=lambda _: False, overrides=BELOW_HALF | {"shield.rules": rules})
    env.reset(seed=0)
    assert env.step(act(0.75))[4]["shield"]["verdict"] == "abort"
    assert env.reset()[1]["shield"]["steps"] == 0 and env.unwrapped.executed == []
    assert (env.unwrapped.resets, env.metrics()["hard_resets"]) == (1, 0)
