"""What a shield says of itself: further starts, irreversible states, and whether it helps."""

import warnings

import numpy as np
import pytest
import shield
from shield._report import figures_of, text_of
from worlds import BELOW_HALF, EDGE, near_start, table


def act(value):
    return np.array([value], np.float32)


def is_down(observation):
    return bool(observation[0] >= EDGE)


def shielded(env=None, **settings):
    settings = {"in_reset_set": near_start, "overrides": BELOW_HALF} | settings
    return shield.ShieldedEnv(env or table(limit=50), **settings)


def test_calibration_resets_show_the_reset_task_further_starts_once_and_uncounted(tmp_path):
    env, plain = (
        shielded(in_reset_set=None, overrides={"experience.batch": 100_000}, calibration_resets=number)
        for number in (20, 0)
    )
    first, _ = env.reset(seed=3)
    assert first == plain.reset(seed=3)[0], "the first start is another"
    assert (env.unwrapped.resets, plain.unwrapped.resets) == (21, 1)
    radius = []
    for each in (env, plain):
        for _ in range(3):
            each.step(act(0.4))
        each.reset(seed=4)
        radius.append(each.metrics()["radius"])
        assert each.metrics()["hard_resets"] == 1
    assert env.unwrapped.resets == 22, "the environment was reset again"
    assert radius[0] != radius[1], "the reset task did not see them"
    env.save(tmp_path / "state")
    again = shielded(in_reset_set=None, overrides={"experience.batch": 100_000}, calibration_resets=20)
    again.load(tmp_path / "state")
    again.reset()
    assert again.unwrapped.resets == 1, "what they were for is in the file"


def test_entries_into_irreversible_states_of_both_agents_are_counted_once_each(tmp_path):
    env = shielded(is_irreversible=is_down, episode_length=30)
    for episode in range(3):
        env.reset(seed=episode)
        while not env.step(act(0.5))[3]:
            pass
    # It stays down, and each episode entered once.
    assert env.metrics()["irreversible_entries"] == 3
    env.save(tmp_path / "state")
    again = shielded(is_irreversible=is_down)
    again.load(tmp_path / "state")
    assert again.metrics()["irreversible_entries"] == 3
    assert "irreversible_entries" not in shielded().metrics()


def test_an_entry_by_the_reset_agent_is_counted():
    far = {"in_reset_set": lambda observation: bool(observation[0] > 5.0), "episode_length": 2_000}
    env = shielded(is_irreversible=lambda observation: bool(abs(observation[0]) > 0.1), **far)
    env.reset(seed=0)
    env.step(act(0.0))
    assert env.metrics()["irreversible_entries"] == 0
    env.reset()
    assert env.metrics()["irreversible_entries"] > 0


@pytest.mark.parametrize("answer", [1, None, "yes"])
def test_an_answer_of_is_irreversible_that_is_not_a_bool_requires_a_reset(answer):
    env = shielded(is_irreversible=lambda _: answer)
    env.reset()
    with pytest.raises(TypeError, match="is_irreversible gave"):
        env.step(act(0.1))
    assert env.shield.needs_hard_reset
    with pytest.raises(TypeError, match="not a function"):
        shielded(is_irreversible=3)


def test_a_report_has_the_figures_of_the_metrics():
    env = shielded(in_reset_set=None, overrides={"experience.batch": 100_000}, is_irreversible=is_down, accepted_risk=0.1)
    env.run(lambda observation: act(0.6), 200, seed=0)
    figures, counted = env.report(as_dict=True), env.metrics()
    assert figures["steps"] == counted["steps"] and figures["forward_steps"] == counted["forward_steps"]
    assert figures["attempts"] == counted["reset_episodes"] and figures["hard_resets"] == counted["hard_resets"]
    assert (figures["accepted_risk"], figures["threshold"]) == (0.1, counted["threshold"])
    assert figures["irreversible_entries"] == counted["irreversible_entries"]
    assert figures["verdict"] == "too_early"
    text = env.report()
    assert "accepted 10.0%" in text and f"{figures['steps']:,} steps" in text and figures["judgement"] in text


COUNTS = {
    "steps": 10_000.0,
    "forward_steps": 8_000.0,
    "forward_episodes": 80.0,
    "early_aborts": 10.0,
    "projections": 0.0,
    "reset_episodes": 80.0,
    "reset_successes": 78.0,
    "hard_resets": 2.0,
}


@pytest.mark.parametrize(
    ("changed", "verdict", "says"),
    [
        ({}, "helps", "2 hard resets instead of about 100"),
        ({"forward_steps": 3_000.0}, "helps", "only 30% of the steps"),
        ({"reset_successes": 60.0, "hard_resets": 20.0}, "helps", "25% of the attempts failed, and 5% are accepted"),
        ({"reset_successes": 10.0, "hard_resets": 70.0}, "helps_little", "70 of 80 attempts to get back failed"),
        ({"reset_successes": 0.0, "hard_resets": 120.0}, "does_not_help", "does not help: 120 hard resets"),
        ({"reset_episodes": 0.0, "reset_successes": 0.0, "hard_resets": 120.0}, "does_not_help", "never in charge"),
        ({"hard_resets": 120.0}, "does_not_help", "followed an end of the environment"),
        ({"forward_steps": 2_000.0, "hard_resets": 75.0}, "helps_little", "75 hard resets instead of about 350"),
        ({"forward_steps": 2_000.0, "hard_resets": 75.0}, "helps_little", "of your agent there would have been about 70"),
        ({"steps": 900.0}, "too_early", "too early"),
    ],
)
def test_the_judgement_says_whether_the_shield_helps_and_why_not(changed, verdict, says):
    figures = figures_of(COUNTS | changed, 0.05, None, 100)
    assert figures["verdict"] == verdict and says in figures["judgement"], figures["judgement"]
    assert text_of(figures).endswith(figures["judgement"])


def test_what_was_found_is_in_the_report():
    env = shielded(in_reset_set=lambda _: False, episode_length=20)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", shield.ShieldWarning)
        env.run(lambda _: act(0.1), 2_000, seed=0)
    found = [sentence for _, sentence in env.findings()]
    assert found and env.report(as_dict=True)["findings"] == found and found[0] in env.report()


def test_nothing_was_done_yet():
    text = shielded().report()
    assert "too early" in text and "0, of them your agent's 0" in text
