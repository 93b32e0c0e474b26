"""An adversary at the wrapper: whatever it proposes and wherever it is interrupted, the environment receives nothing that the rule rejects."""

import math

import gymnasium
import numpy as np
import pytest
import shield
from worlds import BELOW_HALF, Table, near_start

STEPS = 100_000


class Interrupted(Exception):
    pass


class Fragile(Table):
    """Is interrupted now and then, before or after it has moved."""

    def __init__(self, rng):
        super().__init__(terminates=True)
        self.rng, self.in_attempt, self.forward = rng, lambda: False, []

    def step(self, action):
        if self.rng.random() < 0.002:
            raise Interrupted
        if not self.in_attempt():
            self.forward.append(float(action[0]))
        outcome = super().step(action)
        if self.rng.random() < 0.002:
            raise Interrupted
        return outcome


def anything(rng):
    match rng.integers(20):
        case 0:
            value = math.nan
        case 1:
            value = math.inf
        case 2:
            value = 1.0001
        case _:
            value = rng.uniform(-1.0, 1.0)
    return np.array([value], np.float32)


def test_an_adversary_executes_nothing_that_the_rule_rejects():
    rng = np.random.default_rng(5)
    inside = Fragile(rng)
    env = shield.ShieldedEnv(
        gymnasium.wrappers.TimeLimit(inside, 50),
        in_reset_set=near_start,
        overrides=BELOW_HALF,
        updates_per_step=0,
    )
    inside.in_attempt = lambda: env.shield.resetting
    is_over, aborted, interrupted, refused, seed = True, 0, 0, 0, 0
    for _ in range(STEPS):
        try:
            if is_over and rng.random() < 0.9:
                seed += 1
                env.reset(seed=seed if rng.random() < 0.1 else None)
                is_over = False
            executed = len(inside.forward)
            _, _, terminated, truncated, info = env.step(anything(rng))
        except Interrupted:
            interrupted += 1
            is_over = True
            # Where the environment stands is not known: nothing moves before its own reset.
            with pytest.raises(gymnasium.error.ResetNeeded):
                env.step(np.zeros(1, np.float32))
            continue
        except gymnasium.error.ResetNeeded:
            refused += 1
            is_over = True
            continue
        if info["shield"]["verdict"] == "abort":
            aborted += 1
            assert truncated and len(inside.forward) == executed and info["shield"]["reason"]
        is_over = terminated or truncated
    assert all(-1.0 <= force <= 0.5 for force in inside.forward)
    assert len(inside.forward) > 10_000 and aborted > 5_000 and interrupted > 100 and refused > 100
