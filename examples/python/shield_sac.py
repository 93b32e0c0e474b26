"""SAC of Stable-Baselines3 with the shield and without: python shield_sac.py [--seeds 3] [--steps 6000] [--jobs 2]

The task has a state from which nothing leads back: a robot on a ledge, whose goal lies a hand's breadth from the edge. Usually the environment is reset after every episode,
by a person if it is a real robot. With the shield SAC learns in the same environment, at the same number of steps (the reset agent's included), and the
environment is reset only where the reset agent has failed. All of the shield's settings are the usual ones.

Needs `pip install ./shield-python stable-baselines3 matplotlib`. Writes curves.csv and shield_sac.png into --out.
"""

import argparse
import csv
import itertools
import multiprocessing
import pathlib

import gymnasium
import numpy as np
import shield
import torch
from gymnasium import spaces
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback

EDGE, GOAL = 1.0, 0.85


class Ledge(gymnasium.Env):
    """Position and speed; an action accelerates. Beyond the edge the robot lies on the floor: nothing moves it, and nothing is earned."""

    def __init__(self):
        self.observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.falls = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.position, self.speed = self.np_random.uniform(-0.05, 0.05, 2)
        return self.observation(), {}

    def step(self, action):
        if self.position < EDGE:
            self.speed = 0.9 * self.speed + 0.02 * float(action[0])
            self.position += self.speed
            if self.position < -EDGE:
                self.position, self.speed = -EDGE, 0.0
            if self.position >= EDGE:
                self.position, self.speed = 1.5, 0.0
                self.falls += 1
        reward = 0.0 if self.position >= EDGE else 1.0 - min(abs(self.position - GOAL), 1.0)
        return self.observation(), reward, False, False, {}

    def observation(self):
        return np.array([self.position, 10.0 * self.speed], np.float32)


def reset_reward(observation):
    """1 at rest at the start, and less the further away and the faster."""
    return float(np.exp(-4.0 * (observation[0] ** 2 + 0.5 * observation[1] ** 2)))


def make(is_shielded, seed):
    env = gymnasium.wrappers.TimeLimit(Ledge(), 100)
    if is_shielded:
        env = shield.ShieldedEnv(env, reset_reward=reset_reward, seed=seed)
    return env


def evaluate(agent, episodes=5):
    """Mean return of greedy episodes in an environment of their own, without a shield."""
    env, returns = make(False, 0), []
    for episode in range(episodes):
        observation, _ = env.reset(seed=episode)
        total, is_over = 0.0, False
        while not is_over:
            action, _ = agent.predict(observation, deterministic=True)
            observation, reward, terminated, truncated, _ = env.step(action)
            total, is_over = total + reward, terminated or truncated
        returns.append(total)
    return float(np.mean(returns))


class Record(BaseCallback):
    """A row every so many steps of the environment; ends the training when all are used up."""

    def __init__(self, env, steps, every, row):
        super().__init__()
        self.env, self.steps, self.every, self.row, self.rows, self.next = env, steps, every, row, [], every
        self.episodes = 0

    def _on_step(self):
        self.episodes += int(self.locals["dones"][0])
        steps, hard_resets = self.num_timesteps, self.episodes
        if isinstance(self.env, shield.ShieldedEnv):
            counted = self.env.metrics()
            steps, hard_resets = int(counted["steps"]), int(counted["hard_resets"])
        if steps >= self.next:
            falls = self.env.unwrapped.falls
            self.rows.append([*self.row, self.next, evaluate(self.model), hard_resets, falls])
            print("variant %s, seed %d: step %d, return %.1f, %d hard resets, %d falls" % tuple(self.rows[-1]), flush=True)
            self.next += self.every
        return steps < self.steps


def train(is_shielded, seed, steps):
    torch.set_num_threads(1)
    env = make(is_shielded, seed)
    record = Record(env, steps, 500, ["shielded" if is_shielded else "not shielded", seed])
    agent = SAC(
        "MlpPolicy",
        env,
        seed=seed,
        learning_starts=300,
        batch_size=64,
        learning_rate=1e-3,
        gamma=0.98,
        policy_kwargs={"net_arch": [64, 64]},
    )
    agent.learn(10 * steps, callback=record)
    return record.rows


def plot(rows, path):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(12, 3.4), layout="constrained")
    for variant, colour in (("not shielded", "tab:grey"), ("shielded", "tab:blue")):
        seeds = sorted({row[1] for row in rows if row[0] == variant})
        for column, (axis, title) in enumerate(
            zip(axes, ("return of greedy episodes", "hard resets", "falls")), start=3
        ):
            curves = [[row for row in rows if row[0] == variant and row[1] == seed] for seed in seeds]
            for curve in curves:
                axis.plot([row[2] for row in curve], [row[column] for row in curve], color=colour, alpha=0.3, lw=1)
            median = np.median([[row[column] for row in curve] for curve in curves], axis=0)
            axis.plot([row[2] for row in curves[0]], median, color=colour, lw=2, label=variant)
            axis.set(title=title, xlabel="steps of the environment")
    axes[0].legend(frameon=False)
    figure.savefig(path, dpi=110)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3, help="how many seeds (default: 3)")
    parser.add_argument("--steps", type=int, default=6_000, help="steps of the environment for each (default: 6000)")
    parser.add_argument("--jobs", type=int, default=2, help="how many trainings at the same time (default: 2)")
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("runs/shield_sac"), help="folder for the results")
    arguments = parser.parse_args()
    trainings = [(is_shielded, seed, arguments.steps) for seed in range(arguments.seeds) for is_shielded in (True, False)]
    with multiprocessing.get_context("spawn").Pool(arguments.jobs) as pool:
        rows = list(itertools.chain(*pool.starmap(train, trainings, chunksize=1)))
    arguments.out.mkdir(parents=True, exist_ok=True)
    with open(arguments.out / "curves.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["variant", "seed", "step", "mean_return", "hard_resets", "falls"])
        writer.writerows(rows)
    plot(rows, arguments.out / "shield_sac.png")


if __name__ == "__main__":
    main()
