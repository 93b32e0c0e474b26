import csv
import gc
import json
import pathlib
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
import shield
from worlds import BELOW_HALF, near_start, table


def shielded(folder, in_reset_set=near_start, **arguments):
    return shield.ShieldedEnv(table(), in_reset_set=in_reset_set, record=folder, overrides=BELOW_HALF, **arguments)


def drive(env, steps):
    """Random actions, of which every other is beyond the limit of a half."""
    random = np.random.default_rng(0)
    is_over = True
    for _ in range(steps):
        if is_over:
            env.reset()
        _, _, terminated, truncated, _ = env.step(random.uniform(0.0, 1.0, 1).astype(np.float32))
        is_over = terminated or truncated


def rows(folder, name="interventions"):
    with open(pathlib.Path(folder) / f"{name}.csv", newline="") as file:
        return list(csv.DictReader(file))


def parts(folder):
    return sorted((pathlib.Path(folder) / "decisions").glob("part-*.parquet"))


def test_decisions_and_what_they_were_made_from_are_recorded(tmp_path):
    env = shielded(tmp_path / "record")
    drive(env, 200)
    env.close()
    counted = env.metrics()
    rejected = [row for row in rows(tmp_path / "record") if row["phase"] == "forward"]
    assert len(rejected) == counted["early_aborts"] > 0
    assert {row["rule"] for row in rejected} == {"linear-constraints"} and all(row["reason"] for row in rejected)
    episodes = rows(tmp_path / "record", "metrics")
    assert int(episodes[-1]["hard_resets"]) == counted["hard_resets"]
    assert sum(row["hard_reset"] == "1" for row in episodes) == counted["hard_resets"]
    attempts = [row["attempt"] for row in episodes if row["attempt"]]
    assert attempts.count("succeeded") == counted["reset_successes"]
    assert len(parts(tmp_path / "record")) == 1
    plugins = json.loads((tmp_path / "record" / "plugins.json").read_text())
    assert plugins["shield.rules[0]"]["id"] == "linear-constraints"
    # The configuration is whole: it makes the same shield.
    again = shield.ShieldedEnv(table(), in_reset_set=near_start, config=tmp_path / "record" / "config.ron")
    again.reset(seed=0)
    assert again.step(np.array([0.75], np.float32))[4]["shield"]["rule"] == "linear-constraints"


@pytest.mark.parametrize("name", ["CartPole-v1", "Pendulum-v1", "InvertedPendulum-v5"])
def test_the_usual_configuration_is_written_whole(tmp_path, name):
    shield.ShieldedEnv(gymnasium.make(name), record=tmp_path / "record")
    shield.ShieldedEnv(gymnasium.make(name), config=tmp_path / "record" / "config.ron").reset(seed=0)
    assert "success-critic" in (tmp_path / "record" / "plugins.json").read_text() or name == "CartPole-v1"


def test_recording_changes_no_decision(tmp_path):
    decided = []
    for record in (None, tmp_path / "record"):
        env = shield.ShieldedEnv(gymnasium.make("Pendulum-v1"), record=record, overrides={"experience.batch": 16})
        env.reset(seed=0)
        env.action_space.seed(0)
        seen = []
        for _ in range(1_500):
            observation, _, terminated, truncated, info = env.step(env.action_space.sample())
            seen.append((info["shield"]["verdict"], info["shield"]["undo_probability"], observation.tolist()))
            if terminated or truncated:
                env.reset()
        decided.append(seen)
    assert decided[0] == decided[1]


@pytest.mark.parametrize("end", ["close", "save", "drop"])
def test_nothing_is_lost_at_the_end(tmp_path, end):
    env = shielded(tmp_path / "record")
    drive(env, 100)
    counted = env.metrics()["early_aborts"]
    assert not parts(tmp_path / "record")
    if end == "close":
        env.close()
    elif end == "save":
        env.save(tmp_path / "state")
    else:
        del env
        gc.collect()
    assert len([row for row in rows(tmp_path / "record") if row["phase"] == "forward"]) == counted
    assert len(parts(tmp_path / "record")) == 1


@pytest.mark.parametrize("end", ["", "raise ValueError('mine')", "raise KeyboardInterrupt", "sys.exit(3)"])
def test_a_program_that_ends_in_any_way_leaves_a_whole_record(tmp_path, end):
    program = f"""
import pathlib, sys
sys.path.insert(0, {str(pathlib.Path(__file__).parent)!r})
from test_record import drive, shielded
env = shielded({str(tmp_path / "record")!r})
drive(env, 100)
print(int(env.metrics()["early_aborts"]), flush=True)
{end}
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode == 0) == (end == ""), done.stderr
    recorded = [row for row in rows(tmp_path / "record") if row["phase"] == "forward"]
    assert len(recorded) == int(done.stdout) and len(parts(tmp_path / "record")) == 1, done.stderr


def test_an_episode_that_an_exception_ends_is_recorded_as_interrupted(tmp_path):
    fails = False

    def is_home(observation):
        if fails:
            raise RuntimeError("mine")
        return near_start(observation)

    env = shielded(tmp_path / "record", is_home)
    env.reset()
    for _ in range(3):
        env.step(np.array([0.25], np.float32))
    fails = True
    with pytest.raises(RuntimeError, match="mine"):
        env.step(np.array([0.25], np.float32))
    fails = False
    drive(env, 50)
    env.close()
    first = rows(tmp_path / "record", "metrics")[0]
    assert (first["end"], first["length"], first["hard_reset"], first["attempt"]) == ("interrupted", "3", "1", "")
    assert len(parts(tmp_path / "record")) == 1


def test_a_folder_that_holds_something_is_refused(tmp_path):
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "thesis.txt").write_text("mine")
    with pytest.raises(shield.ConfigError, match="foreign.* is not empty"):
        shielded(tmp_path / "foreign")
    assert [path.name for path in (tmp_path / "foreign").iterdir()] == ["thesis.txt"]
    shielded(tmp_path / "record")
    with pytest.raises(shield.ConfigError, match="already holds the record of a shield"):
        shielded(tmp_path / "record")


@pytest.mark.parametrize(
    "wrong", [{"record_every": 0}, {"record_limit": -1}, {"record_every": 1.5}, {"record_limit": True}, {"seed": -1}]
)
def test_a_wrong_setting_leaves_no_folder(tmp_path, wrong):
    with pytest.raises(shield.ConfigError, match=next(iter(wrong))):
        shielded(tmp_path / "record", **wrong)
    assert not (tmp_path / "record").exists()
    with pytest.raises(shield.ConfigError, match="there is no reset task"):
        shielded(tmp_path / "record", calibration_resets=3)
    assert not (tmp_path / "record").exists()
    with pytest.raises(shield.ConfigError, match="record_every=5: nothing is recorded"):
        shielded(None, record_every=5)


def test_a_record_that_ends_is_told_once_and_the_shield_goes_on(tmp_path):
    env = shielded(tmp_path / "record", record_limit=30)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", shield.ShieldWarning)
        drive(env, 200)
        env.close()
    told = [warning.message for warning in caught if getattr(warning.message, "name", "") == "record"]
    assert len(told) == 1 and "30 decisions, which is its limit" in str(told[0])
    assert env.metrics()["early_aborts"] > 30


def test_a_record_that_cannot_be_written_is_told(tmp_path):
    env = shielded(tmp_path / "record")
    drive(env, 50)
    (tmp_path / "record" / "decisions").write_text("in the way")
    with pytest.warns(shield.ShieldWarning, match="cannot be written.*decides as before"):
        env.close()
    drive(env, 50)
    env.close()


def test_a_shield_in_a_loop_of_ones_own_is_recorded(tmp_path):
    guard = shield.Shield(
        table().observation_space, table().action_space, in_reset_set=near_start, record=tmp_path / "record", record_every=10
    )
    position = 0.0
    guard.hard_reset_done(np.array([position]))
    for _ in range(100):
        decision = guard.filter(np.array([position]), np.array([0.4], np.float32))
        position = min(position + 0.1 * float(decision.action[0]), 0.9)
        guard.observe(np.array([position]))
        if guard.needs_hard_reset:
            position = 0.0
            guard.hard_reset_done(np.array([position]))
    guard.close()
    assert len(parts(tmp_path / "record")) == 1
    assert json.loads((tmp_path / "record" / "recording.json").read_text()) == {"decisions": 10, "limit": 1_000_000}


@pytest.mark.skipif(sys.platform == "win32", reason="it limits the size of files as Unix does")
def test_a_full_disk_ends_the_record_with_whole_rows(tmp_path):
    program = f"""
import pathlib, resource, sys, warnings
sys.path.insert(0, {str(pathlib.Path(__file__).parent)!r})
from test_record import drive, shielded
env = shielded({str(tmp_path / "record")!r})
# No file may grow beyond so many bytes: what is written then fails as on a full disk, in the middle of a row.
resource.setrlimit(resource.RLIMIT_FSIZE, (6_000, 6_000))
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    drive(env, 1_000)
    env.close()
    drive(env, 100)
    env.close()
told = [str(warning.message) for warning in caught if getattr(warning.message, "name", "") == "record"]
assert len(told) == 1 and "cannot be written" in told[0], told
print(int(env.metrics()["early_aborts"]))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 100, "the shield goes on"
    for name in ("interventions", "metrics", "learning"):
        text = (tmp_path / "record" / f"{name}.csv").read_text()
        assert text.endswith("\n") and len(text) <= 6_000
        assert all(None not in row and None not in row.values() for row in rows(tmp_path / "record", name))
    assert not [path for path in (tmp_path / "record").rglob("*") if path.suffix == ".partial"]
