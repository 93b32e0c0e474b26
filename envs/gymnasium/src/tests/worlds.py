"""Environments that misbehave or are unusual, registered for the tests."""

import os
import time

import gymnasium
import numpy
from gymnasium import spaces


class World(gymnasium.Env):
    """What it does in a step is its argument; the step's number is the reward."""

    observation_space = spaces.Box(-numpy.inf, numpy.inf, (2,), numpy.float64)
    action_space = spaces.Box(-1, 1, (2, 1), numpy.float32)
    metadata = {"render_modes": ["rgb_array"]}

    def __init__(self, fault="", observation=None, action=None, render_mode=None):
        self.fault, self.render_mode = fault, render_mode
        if observation == "mixed":
            parts = {"which": spaces.Discrete(3), "where": spaces.Tuple([spaces.Box(0, 1, (2,)), spaces.MultiBinary(2)])}
            self.observation_space = spaces.Dict(parts)
        if observation == "sequence":
            self.observation_space = spaces.Sequence(spaces.Discrete(2))
        if action is not None:
            shapes = {
                "from 3": spaces.Discrete(2, start=3),
                "unbounded": spaces.Box(-numpy.inf, 1, (1,)),
                "several": spaces.MultiDiscrete([2, 2]),
            }
            self.action_space = shapes[action]
        self.steps = 0

    def look(self):
        if isinstance(self.observation_space, spaces.Dict):
            return {"which": 2, "where": (numpy.array([0.25, 0.5], numpy.float32), numpy.array([0, 1], numpy.int8))}
        return numpy.array([self.steps, self.seeded], numpy.float64)

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.steps, self.seeded = 0, self.np_random.random()
        return self.look(), {}

    def step(self, action):
        assert self.action_space.contains(action), f"{action!r} is not in {self.action_space}"
        self.steps += 1
        observation, reward = self.look(), float(self.steps)
        match self.fault:
            case "dies":
                print("out of licences", flush=True)
                os._exit(3)
            case "hangs":
                time.sleep(60)
            case "raises":
                raise RuntimeError("the gripper is stuck")
            case "NaN":
                observation[1] = numpy.nan
            case "NaN reward":
                reward = float("nan")
            case "short":
                observation = observation[:1]
            case "prints":
                print("noise\n" * 10_000)
        # Past its time limit it says so for ever.
        return observation, reward, self.steps == 8, self.steps >= 3, {"is_success": self.steps == 2}


    def render(self):
        """Red is the column, green 100 times the row, blue the number of steps."""
        if self.fault == "grey":
            return numpy.zeros((2, 4), numpy.uint8)
        picture = numpy.zeros((2, 4, 3), numpy.uint8)
        picture[:, :, 0], picture[1, :, 1], picture[:, :, 2] = range(4), 100, self.steps
        return picture


gymnasium.register("Shield/World-v0", World, max_episode_steps=3)
gymnasium.register("Shield/Endless-v0", World)
