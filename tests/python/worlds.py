"""Small worlds, and shields whose decisions are known beforehand."""

import gymnasium
import numpy as np
import shield
from gymnasium import spaces

EDGE = 1.0


class Table(gymnasium.Env):
    """A cart on a line: an action moves it, beyond the edge it falls and stays down. Going right is the task."""

    metadata = {"render_modes": []}

    def __init__(self, observed="box", chosen=False, terminates=False):
        self.observed, self.chosen, self.terminates = observed, chosen, terminates
        position = spaces.Box(-2.0, 2.0, (1,), np.float64)
        self.observation_space = {
            "box": position,
            "dict": spaces.Dict({"position": position, "is_down": spaces.Discrete(2)}),
        }[observed]
        self.action_space = (
            spaces.Discrete(3, start=-1) if chosen else spaces.Box(-1.0, 1.0, (1,), np.float32)
        )
        self.position, self.executed, self.resets = 0.0, [], 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.position = float(self.np_random.uniform(-0.05, 0.05))
        self.resets += 1
        return self.observation(), {}

    def step(self, action):
        assert self.action_space.contains(action), f"{action!r} reached the environment"
        force = float(action) if self.chosen else float(action[0])
        self.executed.append(force)
        is_down = self.position >= EDGE
        if not is_down:
            self.position = max(self.position + 0.1 * force, -1.0)
        is_down = self.position >= EDGE
        return self.observation(), self.position, bool(is_down and self.terminates), False, {}

    def observation(self):
        position = np.array([self.position])
        if self.observed == "box":
            return position
        return {"position": position, "is_down": int(self.position >= EDGE)}


class Ending(Table):
    """Truncates itself after so many steps of its own."""

    def __init__(self, length):
        super().__init__()
        self.length, self.steps = length, 0

    def reset(self, *, seed=None, options=None):
        self.steps = 0
        return super().reset(seed=seed, options=options)

    def step(self, action):
        assert self.steps < self.length, "it was stepped on"
        self.steps += 1
        observation, reward, terminated, _, info = super().step(action)
        return observation, reward, terminated, self.steps >= self.length, info


def near_start(observation):
    return bool(abs(float(observation[0])) < 0.3)


def table(limit=20, **arguments):
    return gymnasium.wrappers.TimeLimit(Table(**arguments), limit)


#: A rule that compares the reset agent's values, and so has a warm-up.
BY_VALUES = {"shield.rules": '[(plugin: "ensemble-threshold", config: (q_min: -1e9))]'}

#: Nothing is learned, for want of a batch, so that the reset agent tries this and that; an action above a half is rejected.
BELOW_HALF = {
    "shield.rules": '[(plugin: "linear-constraints", config: (constraints: [(a: [1.0], b: 0.5)]))]',
    "shield.projection": None,
    "experience.batch": 100_000,
}


def act(value):
    return np.array([value], np.float32)


def shielded(env=None, in_reset_set=near_start, overrides=BELOW_HALF, **arguments):
    return shield.ShieldedEnv(env or table(), in_reset_set=in_reset_set, overrides=overrides, **arguments)
