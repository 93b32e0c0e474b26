"""What a wrapped environment has learned and counted, in files."""

import os

import pytest
import shield
from worlds import act, near_start, shielded, table


def test_a_loaded_shield_keeps_what_was_learned_and_counted(tmp_path):
    quick = {"reset.config.random_steps": 0, "experience.batch": 8, "shield.warm_up_steps": 10_000}
    first = shielded(overrides=quick)
    first.run(lambda _: first.action_space.sample() * 0.1, 60, seed=0)
    assert first.metrics()["reset/critic_loss"] >= 0.0
    first.save(tmp_path / "state")
    second = shielded(overrides=quick)
    second.load(tmp_path / "state")
    counted = second.metrics()
    assert counted["steps"] == first.metrics()["steps"] > 0 and second.shield.needs_hard_reset
    second.reset(seed=0)
    second.step(act(0.1))
    assert second.metrics()["hard_resets"] == counted["hard_resets"], "the first placing was counted"
    with pytest.raises(shield.ShieldError, match="observations of 1 and actions of 1"):
        other = shielded(table(observed="dict"), in_reset_set=lambda seen: near_start(seen["position"]))
        other.load(tmp_path / "state")
    (tmp_path / "torn").write_bytes((tmp_path / "state").read_bytes()[:-3])
    with pytest.raises(shield.ShieldError, match="damaged"):
        second.load(tmp_path / "torn")


def test_a_shield_with_another_capacity_takes_over_the_experience(tmp_path):
    quick = {"reset.config.random_steps": 0, "experience.batch": 8, "shield.warm_up_steps": 10_000}

    def remembering(capacity):
        return shielded(overrides=quick | {"experience.capacity": capacity})

    first = remembering(20)
    first.run(lambda _: first.action_space.sample() * 0.1, 60, seed=0)
    first.save(tmp_path / "state")
    for capacity in (10, 30):
        second = remembering(capacity)
        second.load(tmp_path / "state")
        second.run(lambda _: second.action_space.sample() * 0.1, 60, seed=0)
        assert second.metrics()["steps"] >= first.metrics()["steps"] + 60


def test_a_state_is_saved_over_a_regular_file_only(tmp_path):
    env = shielded()
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("precious")
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "state.partial").write_text("mine")
    os.mkfifo(tmp_path / "pipe")
    for trap, reason in (("folder", "a folder"), ("link", "a symbolic link"), ("pipe", "a pipe")):
        with pytest.raises(shield.ShieldError, match=reason):
            env.save(tmp_path / trap)
    env.save(tmp_path / "state")
    env.save(tmp_path / "state")
    kept = {"folder", "link", "precious", "state.partial", "pipe", "state"}
    assert {path.name for path in tmp_path.iterdir()} == kept
    assert (tmp_path / "precious").read_text() == "precious"
    assert (tmp_path / "state.partial").read_text() == "mine"


def test_counts_are_written_for_tensorboard(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    env = shielded(tensorboard=tmp_path)
    env.reset()
    for _ in range(3):
        env.step(act(0.75))
        env.reset()
    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    assert [event.value for event in events.Scalars("counts/early_aborts")][-1] == 3.0
