"""What keeps a shield from helping is told once, and `doctor` finds it before any training."""

import warnings

import gymnasium
import numpy as np
import pytest
import shield
from gymnasium import spaces
from worlds import BELOW_HALF, Ending, Table, near_start, table


def told(run):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run()
    return [entry.message for entry in caught if isinstance(entry.message, shield.ShieldWarning)]


def shielded(env=None, in_reset_set=near_start, overrides=BELOW_HALF, **settings):
    return shield.ShieldedEnv(env or table(), in_reset_set=in_reset_set, overrides=overrides, **settings)


def act(env, episodes, action=0.25, **reset):
    for _ in range(episodes):
        env.reset(**reset)
        is_over = False
        while not is_over:
            *_, terminated, truncated, _ = env.step(np.array([action], np.float32))
            is_over = terminated or truncated


def test_a_seed_for_each_episode_is_told_once_with_the_remedy():
    env = shielded()
    caught = told(lambda: act(env, 20, seed=3))
    assert [warning.name for warning in caught] == ["resets-requested"]
    assert "reset(seed=…)" in str(caught[0]) and "first reset only" in str(caught[0])
    assert [name for name, _ in env.findings()] == ["resets-requested"]


def test_a_clock_inside_the_environment_is_told():
    env = shielded(Ending(15), episode_length=50)
    caught = told(lambda: act(env, 12))
    assert [warning.name for warning in caught] == ["resets-truncated"]
    assert "episode_length" in str(caught[0])


def test_a_reset_set_without_the_starts_or_with_every_state_is_told():
    nowhere = shielded(in_reset_set=lambda _: False)
    names = [warning.name for warning in told(lambda: act(nowhere, 80))]
    assert "starts-outside" in names and "no-success" in names and len(names) == len(set(names))
    everywhere = shielded(in_reset_set=lambda _: True)
    assert [warning.name for warning in told(lambda: act(everywhere, 60))] == ["every-state-inside"]


def test_an_agent_that_may_not_act_is_told():
    env = shielded(reset_attempts="Unlimited", overrides=BELOW_HALF | {"shield.projection": "None"})
    names = [warning.name for warning in told(lambda: act(env, 1_500, action=0.75))]
    assert names.count("nothing-allowed") == 1


def test_a_shield_that_works_is_silent():
    env = shielded(in_reset_set=lambda observation: bool(abs(float(observation[0])) < 0.6), episode_length=200)
    assert told(lambda: act(env, 40)) == []


def test_what_was_told_is_not_told_again_after_loading(tmp_path):
    env = shielded()
    told(lambda: act(env, 20, seed=3))
    env.save(tmp_path / "kept")
    again = shielded()
    again.load(tmp_path / "kept")
    assert told(lambda: act(again, 20, seed=3)) == []
    assert [name for name, _ in again.findings()] == ["resets-requested"]


def standing(checkup, name):
    return next(check.standing for check in checkup.checks if check.name == name)


def test_the_doctor_finds_nothing_in_the_way_and_leaves_time_limits_where_they_are(capsys):
    env = table()
    checkup = shield.doctor(env, in_reset_set=near_start)
    assert checkup.verdict == "works", checkup.text
    assert isinstance(env, gymnasium.wrappers.TimeLimit)
    assert capsys.readouterr().out == checkup.text + "\n"
    # The reset task of the usual configuration does as well.
    assert shield.doctor(table(), verbose=False).verdict == "works"
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("env", "in_reset_set", "check", "verdict"),
    [
        (Table(), lambda _: False, "starts", "change"),
        (Table(), lambda _: True, "reset set", "change"),
        (Ending(15), near_start, "clock", "change"),
    ],
)
def test_the_doctor_names_the_setting_to_change(env, in_reset_set, check, verdict):
    checkup = shield.doctor(env, in_reset_set=in_reset_set, verbose=False)
    assert (checkup.verdict, standing(checkup, check)) == (verdict, "CHANGE"), checkup.text
    assert "verdict: change this setting" in checkup.text


class Anywhere(gymnasium.Env):
    """Starts everywhere: there is nothing to undo."""

    observation_space, action_space = spaces.Box(-1, 1, (1,)), spaces.Box(-1, 1, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.position = self.np_random.uniform(-1, 1, (1,)).astype(np.float32)
        return self.position, {}

    def step(self, action):
        self.position = np.clip(self.position + 0.3 * action, -1, 1).astype(np.float32)
        return self.position, 0.0, False, False, {}


class Broken(Anywhere):
    def step(self, action):
        return np.array([np.nan], np.float32), 0.0, False, False, {}


def test_the_doctor_says_where_a_shield_cannot_help():
    checkup = shield.doctor(Anywhere(), in_reset_set=lambda _: True, verbose=False)
    assert checkup.verdict == "cannot_help" and "start" in checkup.text.splitlines()[-1]
    broken = shield.doctor(Broken(), verbose=False)
    assert (broken.verdict, standing(broken, "observations")) == ("change", "CHANGE")


def test_the_doctor_of_a_shielded_environment_has_its_settings():
    checkup = shield.doctor(shielded(in_reset_set=lambda _: False), verbose=False)
    assert standing(checkup, "starts") == "CHANGE"
    with pytest.raises(TypeError, match="did you mean"):
        shield.doctor(table(), in_reset_sets=near_start)
