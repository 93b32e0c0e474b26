import math
import pickle

import gymnasium
import numpy as np
import pytest
import shield
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from shield._settings import Settings
from worlds import BELOW_HALF, Ending, Table, act, near_start, shielded, table


def soft(steps):
    return {"hard_reset": False, "steps": steps, "cause": "", "is_repeated": True}


def hard(steps, cause):
    return {"hard_reset": True, "steps": steps, "cause": cause, "is_repeated": False}


@pytest.mark.parametrize(
    "make",
    [
        lambda: table(),
        lambda: table(observed="dict"),
        lambda: table(chosen=True),
        lambda: gymnasium.make("CartPole-v1"),
        lambda: gymnasium.make("Pendulum-v1"),
        lambda: gymnasium.make("InvertedPendulum-v5"),
    ],
)
def test_the_checker_of_gymnasium_accepts_the_wrapped_environment(make):
    check_env(shield.ShieldedEnv(make()), skip_render_check=True)


def test_a_registered_environment_can_be_made_again_from_its_spec():
    env = shield.ShieldedEnv(gymnasium.make("CartPole-v1"), accepted_risk=0.3)
    again = env.spec.make()
    assert isinstance(again, shield.ShieldedEnv)
    again.reset(seed=1)
    again.step(0)


def test_a_rejected_action_is_explained_and_not_executed():
    env = shielded()
    before, _ = env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step(act(0.25))
    assert (terminated, truncated, env.unwrapped.executed) == (False, False, [0.25])
    assert info["shield"]["verdict"] == "allow" and info["shield"]["executed"] is info["shield"]["proposed"]
    rejected = act(0.75)
    again, reward, terminated, truncated, info = env.step(rejected)
    assert again == observation and again is not observation and (reward, terminated, truncated) == (0.0, False, True)
    assert env.unwrapped.executed == [0.25], "it was executed"
    said = info["shield"]
    assert (said["verdict"], said["rule"], said["cause"]) == ("abort", "linear-constraints", "rejected")
    assert said["proposed"] is rejected and np.isnan(said["executed"]).all()
    assert said["reset_value"] is None and said["reason"]
    names = ("verdict", "proposed", "executed", "reset_value", "undo_probability", "rule", "cause", "reason", "is_repeated")
    assert tuple(said) == names
    with pytest.raises(gymnasium.error.ResetNeeded, match="aborted"):
        env.step(act(0.25))
    assert env.metrics()["early_aborts"] == 1


def test_an_abort_gives_the_abort_reward():
    env = shielded(abort_reward=-3)
    env.reset(seed=0)
    assert env.step(act(0.75))[1] == -3.0


def test_reset_lets_the_reset_agent_return_to_the_start():
    env = shielded(episode_length=500)
    env.reset(seed=0)
    for _ in range(20):
        observation, _, _, truncated, _ = env.step(act(0.4))
    assert truncated and observation[0] > 0.7
    executed = len(env.unwrapped.executed)
    observation, info = env.reset()
    assert near_start(observation) and env.unwrapped.resets == 1
    assert info["shield"] == soft(len(env.unwrapped.executed) - executed)
    # The clock begins anew, and a second reset has nothing to undo.
    assert env.reset()[0] == observation
    assert not env.step(act(0.5))[3]
    counted = env.metrics()
    assert (counted["hard_resets"], counted["reset_episodes"], counted["reset_successes"]) == (0, 1, 1)
    assert counted["steps"] == len(env.unwrapped.executed) and counted["forward_steps"] == 21


def test_a_hard_reset_follows_the_last_failed_attempt_and_is_counted():
    never = shielded(in_reset_set=lambda _: False, reset_attempts=2, episode_length=3)
    never.reset()
    never.step(act(0.1))
    assert not never.reset()[1]["shield"]["hard_reset"], "after one failure of two"
    never.step(act(0.1))
    assert never.reset()[1]["shield"]["hard_reset"]
    counted = never.metrics()
    assert (counted["hard_resets"], counted["hard_reset_cost"], never.unwrapped.resets) == (1, 1, 2)


@pytest.mark.parametrize("arguments", [{"seed": 3}, {"options": {"where": "left"}}])
def test_a_seed_or_options_require_a_hard_reset(arguments):
    env = shielded()
    env.reset()
    env.step(act(0.1))
    assert env.reset(**arguments)[1]["shield"]["hard_reset"]
    assert (env.metrics()["hard_resets"], env.unwrapped.resets) == (1, 2)


def test_a_terminated_environment_requires_a_hard_reset():
    env = shielded(table(terminates=True, limit=100))
    env.reset()
    while not env.step(act(0.5))[2]:
        pass
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(act(0.0))
    assert env.reset()[1]["shield"] == hard(0, "terminated")


@pytest.mark.parametrize("limit", [None, 1, 4, 5, 6])
def test_an_environment_that_truncates_itself_requires_a_hard_reset(limit):
    env = Ending(5)
    for each in filter(None, (limit, limit and limit + 2)):
        env = gymnasium.wrappers.TimeLimit(env, each)
    # The reset agent never arrives, so that it goes on beyond the limit.
    env = shielded(env, in_reset_set=lambda _: False, episode_length=100)
    env.reset()
    steps = 1
    while not env.step(act(0.1))[3]:
        steps += 1
    assert steps == min(limit or 5, 5)
    assert env.reset()[1]["shield"] == hard(5 - steps, "terminated")
    assert (env.unwrapped.resets, env.metrics()["hard_resets"]) == (2, 1)


def test_every_reset_restarts_the_clock():
    env = shielded(table(limit=4))
    env.reset()
    for reset in ({}, {"seed": 1}, {}):
        assert [env.step(act(0.1))[3] for _ in range(4)] == [False, False, False, True]
        assert env.reset(**reset)[1]["shield"]["hard_reset"] == bool(reset)


def test_a_step_before_any_reset_is_refused():
    with pytest.raises(gymnasium.error.ResetNeeded, match="before"):
        shielded().step(act(0.1))


@pytest.mark.parametrize("value", [1.5, math.nan, math.inf])
def test_the_warm_up_aborts_an_invalid_action(value):
    values = BELOW_HALF["shield.rules"][:-1] + ', (plugin: "ensemble-threshold", config: (q_min: 1e9))]'
    env = shielded(overrides={**BELOW_HALF, "shield.rules": values, "shield.warm_up_steps": 100})
    env.reset()
    assert env.step(act(0.25))[4]["shield"]["verdict"] == "warm_up"
    said = env.step(act(value))[4]["shield"]
    assert (said["verdict"], said["cause"], said["rule"]) == ("abort", "invalid_action", "")
    assert env.unwrapped.executed == [0.25]


def test_a_limit_holds_from_the_first_step():
    env = shielded(overrides={**BELOW_HALF, "shield.warm_up_steps": 100})
    env.reset()
    said = env.step(act(0.75))[4]["shield"]
    assert (said["verdict"], said["cause"]) == ("abort", "rejected")
    assert env.unwrapped.executed == []


@pytest.mark.parametrize(
    ("space", "action", "executed"),
    [
        (spaces.Box(-1, 1, (1,), np.float32), np.nextafter(1.0, 2), 1.0),
        (spaces.Box(-1, 1, (1,), np.float32), 0.3, np.float32(0.3)),
        (spaces.Box(-1, 1, (1,), np.float32), 1, 1.0),
        (spaces.Box(-1, 1, (1,), np.float16), 0.3, np.float16(0.3)),
        (spaces.Box(-1, 1, (1,), np.float64), 0.3, 0.3),
        (spaces.Box(-1, 1, (1,), np.float64), np.nextafter(1.0, 2), None),
        (spaces.Box(-1, 1, (1,), np.float64), np.nextafter(-1.0, -2), None),
    ],
)
def test_the_executed_action_is_the_judged_one(space, action, executed):
    guard = shield.Shield(spaces.Box(-1, 1, (1,)), space, in_reset_set=near_start)
    for given in ([action], np.array([action])):
        guard.hard_reset_done(np.zeros(1))
        decision = guard.filter(np.zeros(1), given)
        assert decision.proposed is given and decision.action.dtype == space.dtype
        if executed is None:
            assert (decision.verdict, decision.cause) == ("abort", "invalid_action") and "outside" in decision.reason
        else:
            assert decision.verdict == "allow" and decision.action.tolist() == [executed]


def test_a_projected_action_is_the_one_that_is_executed():
    env = shielded(overrides={**BELOW_HALF, "shield.projection": "Qp()"})
    env.reset()
    said = env.step(act(0.75))[4]["shield"]
    assert said["verdict"] == "project" and said["executed"].dtype == np.float32
    assert env.unwrapped.executed == [pytest.approx(0.5, abs=1e-5)]
    assert float(said["executed"][0]) == env.unwrapped.executed[0]


def test_discrete_actions_keep_their_offset():
    discrete = {"shield.rules": '[(plugin: "ensemble-threshold", config: (q_min: 1e9))]', "shield.warm_up_steps": 1}
    env = shielded(table(chosen=True), overrides=discrete)
    env.reset()
    said = env.step(np.int64(-1))[4]["shield"]
    assert (said["verdict"], env.unwrapped.executed) == ("warm_up", [-1])
    said = env.step(np.int64(1))[4]["shield"]
    assert (said["verdict"], said["executed"], said["rule"]) == ("abort", -2, "ensemble-threshold")
    assert math.isfinite(said["reset_value"])
    env.reset()
    assert set(env.unwrapped.executed) <= {-1, 0, 1}


def test_an_unsigned_discrete_space_can_be_shielded():
    class Few(Table):
        def __init__(self):
            super().__init__(chosen=True)
            self.action_space = spaces.Discrete(3, dtype=np.uint8)

    env = shielded(Few(), overrides={"shield.warm_up_steps": 9})
    env.reset()
    assert env.step(np.uint8(2))[4]["shield"]["executed"] == 2
    said = env.step(np.uint8(3))[4]["shield"]
    assert (said["executed"], said["cause"], env.unwrapped.executed) == (-1, "invalid_action", [2])


def test_an_invalid_discrete_action_is_explained_with_its_own_numbers():
    guard = shield.Shield(spaces.Box(-1, 1, (1,)), spaces.Discrete(3, start=3), in_reset_set=near_start)
    assert guard.filter(np.zeros(1), 6).reason == "action 6 is not one of 3 to 5"


def test_a_nested_observation_arrives_whole():
    env = shielded(table(observed="dict"), in_reset_set=lambda seen: near_start(seen["position"]))
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    observation, *_ = env.step(act(0.5))
    assert env.observation_space.contains(observation)
    assert sorted(env.shield._seen.tolist()) == pytest.approx(sorted([0, 1, observation["position"][0]]))


def test_run_asks_the_policy_and_shields_it():
    env = shielded()
    returns = env.run(lambda observation: act(0.75 if observation[0] > 0.2 else 0.5), 50, seed=0)
    assert len(returns) > 1 and max(env.unwrapped.executed) <= 1.0
    assert env.metrics()["early_aborts"] > 0


def test_run_stops_after_its_last_step():
    env = shielded(table(limit=5))
    returns = env.run(lambda _: act(0.1), 10, seed=0)
    assert len(returns) == 2 and env.metrics()["forward_steps"] == 10
    assert env.metrics()["reset_episodes"] == 1, "the reset agent acted after the last step"
    assert len(env.run(lambda _: act(0.1), 7)) == 2
    assert env.run(lambda _: act(0.1), 0) == []


def test_a_vector_of_environments_passes_the_report_on():
    def make():
        return shielded(table())

    envs = gymnasium.vector.SyncVectorEnv([make, make])
    envs.reset(seed=0)
    for action in ([[0.1], [0.9]], [[0.1], [0.1]], [[0.9], [0.9]], [[0.2], [0.2]]):
        _, _, _, _, info = envs.step(np.array(action, np.float32))
    assert "shield" in info


def test_every_argument_is_documented():
    for name in Settings.__annotations__:
        assert f"`{name}" in shield.Shield.__doc__, name
    for method in (shield.ShieldedEnv.step, shield.ShieldedEnv.reset):
        assert "shield" in (method.__doc__ or ""), method


def test_a_misspelt_argument_is_refused_with_the_name_that_was_meant():
    for make in (lambda: shielded(warm_up_step=3), lambda: shield.Shield(*[None] * 2, warm_up_step=3)):
        with pytest.raises(TypeError, match="no argument 'warm_up_step'; did you mean 'warm_up_steps'"):
            make()


def test_the_same_seed_gives_the_same_run():
    def run():
        env = shielded(overrides={"shield.warm_up_steps": 30, "reset.config.random_steps": 20, "experience.batch": 8})
        env.action_space.seed(1)
        returns = env.run(lambda _: env.action_space.sample(), 150, seed=5)
        return returns, env.unwrapped.executed, env.metrics()

    first, second = run(), run()
    assert pickle.dumps(first) == pickle.dumps(second)


def test_the_usual_configuration_rarely_aborts_after_the_warm_up():
    env = shield.ShieldedEnv(table(limit=50), in_reset_set=near_start, seed=0)
    random = np.random.default_rng(0)
    env.reset(seed=0)
    while env.metrics()["steps"] < 2_000:
        _, _, terminated, truncated, _ = env.step(random.uniform(-0.4, 0.4, 1).astype(np.float32))
        if terminated or truncated:
            env.reset()
    metrics = env.metrics()
    assert metrics["early_aborts"] < 50 and metrics["forward_steps"] > 1_200, metrics


def test_the_report_says_what_the_shield_did():
    env = shielded(is_irreversible=lambda observation: abs(float(observation[0])) > 0.02)
    env.reset()
    for value in (0.25, 0.25, 0.25, 0.75):
        env.step(act(value))
    env.reset()
    report, counted = env.report(as_dict=True), env.metrics()
    assert (report["steps"], report["forward_steps"], report["aborts"]) == (counted["steps"], 3, 1)
    assert report["attempts"] == 1 and report["reset_successes"] + report["hard_resets"] == 1
    assert report["realised_risk"] == 1 - report["reset_successes"]
    assert report["irreversible_entries"] == counted["irreversible_entries"] >= 1
    text = env.report()
    for part in ("of them your agent's 3", "compare with a training without the shield", "too early to say"):
        assert part in text, text


def test_calibration_resets_are_shown_to_the_reset_task_and_not_counted():
    class Counted(gymnasium.Wrapper):
        resets = 0

        def reset(self, **arguments):
            self.resets += 1
            return super().reset(**arguments)

    counted = Counted(table())
    env = shield.ShieldedEnv(counted, calibration_resets=20)
    env.reset(seed=0)
    assert (counted.resets, env.metrics()["hard_resets"]) == (21, 0)
    with pytest.raises(shield.ConfigError, match="calibration_resets=3: .*there is no reset task"):
        shielded(calibration_resets=3)


def test_only_simulators_of_gymnasium_are_reset_for_calibration_without_being_asked():
    pendulum = gymnasium.make("Pendulum-v1")
    assert shield.ShieldedEnv(pendulum).shield.calibration_resets == 20
    assert shield.ShieldedEnv(pendulum, calibration_resets=0).shield.calibration_resets == 0
    assert shield.ShieldedEnv(pendulum, in_reset_set=lambda _: False).shield.calibration_resets == 0
    assert shield.ShieldedEnv(table()).shield.calibration_resets == 0


def test_an_attempt_lasts_as_long_as_it_is_said_to():
    lost = {"in_reset_set": lambda _: False, "overrides": {}, "episode_length": 300}
    for length, steps in ((None, 200), ("Episode", 300), (7, 7), (400, 400)):
        env = shielded(**lost, attempt_length=length)
        env.reset(seed=0)
        env.step(act(0.1))
        assert env.reset()[1]["shield"] == hard(steps, "cycle_over"), length
    with pytest.raises(shield.ConfigError, match="attempt_length=0: .*an attempt needs at least one step"):
        shielded(attempt_length=0)


def test_the_accepted_risk_is_that_of_the_usual_rule():
    shielded(overrides={}, accepted_risk=0.3)
    with pytest.raises(shield.ConfigError, match="accepted_risk=1.5"):
        shielded(overrides={}, accepted_risk=1.5)
    with pytest.raises(shield.ConfigError, match="accepted_risk"):
        shielded(overrides={}, q_min=0.5)
