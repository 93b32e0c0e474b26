"""A way home that is a function of the user's."""

import gc
import pathlib
import re
import weakref

import gymnasium
import numpy as np
import pytest
import shield
from gymnasium import spaces
from worlds import BELOW_HALF, Table, near_start, table

SPACES = (spaces.Box(-2, 2, (1,)), spaces.Box(-1, 1, (1,)))
#: The usual rule asks what the way home would do, at the start of each cycle and after a rejection.
JUDGED = {"experience.batch": 8, "shield.projection": "None"}
#: A rule that does not.
LIMITED = BELOW_HALF | {"shield.projection": "None"}


def act(value):
    return np.array([value], np.float32)


def way_home(observation):
    return np.array([-0.5 if observation[0] > 0.0 else 0.5])


class Slope(Table):
    """Beyond 0.6 it slides towards the edge, faster than the way home leads back."""

    def step(self, action):
        if self.position > 0.6:
            self.position += 0.06
        return super().step(action)


class Broken(Exception):
    pass


def test_a_reset_policy_leads_home_after_an_abort():
    guard = shield.Shield(*SPACES, in_reset_set=near_start, reset_policy=way_home, overrides=LIMITED)
    position, resetting = 0.0, []
    for step in range(300):
        decision = guard.filter(np.array([position]), act(0.75 if step == 9 else 0.5))
        position += 0.1 * float(decision.action[0])
        guard.observe(np.array([position]))
        if decision.verdict != "allow":
            resetting.append((decision.verdict, float(decision.action[0])))
        if resetting and not guard.resetting:
            break
    assert resetting[0] == ("abort", -0.5) and set(resetting[1:]) == {("resetting", -0.5)}
    metrics = guard.metrics()
    assert (metrics["reset_successes"], metrics["hard_resets"]) == (1, 0)
    assert not any(name.startswith("reset/") for name in metrics)


def test_the_shield_learns_how_far_a_reset_policy_leads_home():
    env = shield.ShieldedEnv(
        gymnasium.wrappers.TimeLimit(Slope(terminates=True), 20),
        in_reset_set=lambda observation: bool(abs(observation[0]) < 0.1),
        reset_policy=way_home,
        overrides={
            "shield.rules": '[(plugin: "undo-probability", config: (accepted_risk: 0.1))]',
            "shield.success_critic": '(plugin: "success-critic", config: (members: 3, hidden: [32, 32]))',
            "experience.batch": 32,
        },
    )
    halves = []
    for _ in range(2):
        before = env.metrics()
        env.run(lambda _: act(0.6), 2_000)
        after = env.metrics()
        halves.append({name: after[name] - before[name] for name in ("hard_resets", "reset_episodes")})
    first, second = halves
    assert first["hard_resets"] > 2 and second["hard_resets"] < 0.2 * second["reset_episodes"], halves
    assert env.metrics()["success/success_loss"] < 0.5
    env.reset()
    assert env.step(act(0.1))[4]["shield"]["reset_value"] is None


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (lambda: 1 / 0, "division"),
        (lambda: act(np.nan), "reset_policy gave .*nan.*not in the action space"),
        (lambda: act(1.5), "reset_policy gave .*1.5.*not in the action space"),
        (lambda: np.zeros(2), r"the action of reset_policy has shape \(2,\)"),
        (lambda: None, "the action of reset_policy has shape"),
    ],
)
@pytest.mark.parametrize("asked", ["to judge", "to reset"])
def test_a_reset_policy_that_fails_raises_and_lets_nothing_move(answer, words, asked):
    fails = []

    def sometimes(observation):
        return answer() if fails else way_home(observation)

    overrides = JUDGED if asked == "to judge" else LIMITED
    env = shield.ShieldedEnv(table(), in_reset_set=near_start, reset_policy=sometimes, overrides=overrides)
    env.reset()
    for _ in range(6):
        env.step(act(0.5))
    if asked == "to judge":
        env.reset(seed=0)
    executed = list(env.unwrapped.executed)
    fails.append(True)
    with pytest.raises((ZeroDivisionError, ValueError), match=words):
        env.step(act(0.25)) if asked == "to judge" else env.reset()
    with pytest.raises(gymnasium.error.ResetNeeded, match="interrupted"):
        env.step(act(0.25))
    assert env.unwrapped.executed == executed, "something was executed"
    fails.clear()
    assert env.reset()[1]["shield"]["hard_reset"]
    assert not env.step(act(0.25))[3]


def test_a_reset_policy_that_fails_while_the_critic_learns_requires_a_reset():
    fails = []

    def sometimes(observation):
        if fails and observation[0] < 0.12:
            raise Broken("far from here")
        return way_home(observation)

    env = shield.ShieldedEnv(table(), in_reset_set=lambda _: False, reset_policy=sometimes, overrides=JUDGED)
    env.reset()
    for _ in range(12):
        env.step(act(0.5))
    fails.append(True)
    # Asked to judge, it answers; of what it is asked about the past, something fails.
    with pytest.raises(Broken, match="far from here"):
        for _ in range(5):
            env.step(act(0.1))
    with pytest.raises(gymnasium.error.ResetNeeded, match="interrupted"):
        env.step(act(0.1))


def test_an_interrupt_in_a_reset_policy_is_raised():
    def interrupted(_):
        raise KeyboardInterrupt

    guard = shield.Shield(*SPACES, in_reset_set=near_start, reset_policy=interrupted, overrides=JUDGED)
    with pytest.raises(KeyboardInterrupt):
        guard.filter(np.zeros(1), act(0.1))
    assert guard.needs_hard_reset


@pytest.mark.parametrize("observed", ["box", "dict"])
@pytest.mark.parametrize("chosen", [False, True])
def test_a_reset_policy_sees_and_gives_what_the_spaces_say(observed, chosen):
    env, seen = table(8, observed=observed, chosen=chosen), []

    def position(observation):
        return (observation["position"] if observed == "dict" else observation)[0]

    def home(observation):
        assert env.observation_space.contains(observation), observation
        seen.append(observation)
        direction = -1 if position(observation) > 0 else 1
        return direction if chosen else np.array([0.5 * direction], np.float64)

    def is_home(observation):
        return bool(abs(position(observation)) < 0.1)

    shielded = shield.ShieldedEnv(env, in_reset_set=is_home, reset_policy=home, overrides=JUDGED)
    shielded.run(lambda _: 1 if chosen else act(0.5), 40)
    metrics = shielded.metrics()
    assert metrics["reset_successes"] >= 1 and metrics["failed_closed"] == 0 and metrics["steps"] > 40
    # Nobody else keeps or changes what it was given.
    assert len({id(observation) for observation in seen}) == len(seen)


def test_a_reset_policy_that_uses_its_shield_is_an_error_and_not_the_end():
    def curious(observation):
        guard.metrics()
        return way_home(observation)

    guard = shield.Shield(*SPACES, in_reset_set=near_start, reset_policy=curious, overrides=JUDGED)
    with pytest.raises(shield.ShieldError, match="reset_policy used the shield"):
        guard.filter(np.zeros(1), act(0.1))


def test_what_does_not_fit_a_reset_policy_is_refused():
    given = {"in_reset_set": near_start, "reset_policy": way_home}
    with pytest.raises(TypeError, match="reset_policy is 7, not a function"):
        shield.Shield(*SPACES, **{**given, "reset_policy": 7})
    rules = {"shield.rules": '[(plugin: "ensemble-threshold")]'}
    with pytest.raises(shield.ConfigError, match=r"`shield.rules\[0\]` \(`ensemble-threshold`\).*`undo-probability`"):
        shield.Shield(*SPACES, overrides=rules, **given)


def test_a_file_without_a_reset_agent_takes_a_reset_policy(tmp_path):
    path = tmp_path / "shield.ron"
    path.write_text('DropIn(shield: (rules: [(plugin: "undo-probability")]))')
    with pytest.raises(shield.ConfigError, match="nothing undoes"):
        shield.Shield(*SPACES, in_reset_set=near_start, config=path)
    guard = shield.Shield(*SPACES, in_reset_set=near_start, config=path, reset_policy=way_home)
    assert guard.filter(np.zeros(1), act(0.1)).allowed


def test_what_the_critic_learned_is_kept_and_the_function_is_given_anew(tmp_path):
    def guard():
        return shield.Shield(*SPACES, in_reset_set=near_start, reset_policy=way_home, overrides=JUDGED)

    first, second = guard(), guard()
    for _ in range(20):
        first.filter(np.zeros(1), act(0.1))
        first.observe(np.zeros(1))
    first.save(tmp_path / "state")
    second.load(tmp_path / "state")
    assert second.metrics()["steps"] == 20 and second.needs_hard_reset
    second.hard_reset_done(np.zeros(1))
    assert second.filter(np.zeros(1), act(0.1)).allowed


def test_an_environment_that_its_reset_policy_knows_is_freed():
    class Owner:
        def __init__(self):
            self.env = shield.ShieldedEnv(table(), in_reset_set=near_start, reset_policy=self.home, overrides=JUDGED)

        def home(self, observation):
            return way_home(observation)

    owner = Owner()
    owner.env.reset()
    freed = weakref.ref(owner)
    del owner
    gc.collect()
    assert freed() is None


def test_the_example_of_the_documentation_works():
    text = (pathlib.Path(__file__).parents[2] / "shield-python/README.md").read_text()
    examples = [code for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "def go_home" in code]
    assert len(examples) == 1
    scope = {"YourEnv": lambda: gymnasium.wrappers.TimeLimit(Slope(), 20), "np": np}
    exec(examples[0], scope)
    scope["env"].run(lambda _: act(0.2), 200)
    assert scope["env"].metrics()["reset_successes"] > 3
