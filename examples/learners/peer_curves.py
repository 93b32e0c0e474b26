"""Learning curves of Stable-Baselines3 with the settings of the experiments beside this file.

The environments are Gymnasium's HalfCheetah-v5 and InvertedPendulum-v5; `mujoco/half-cheetah` and `mujoco/inverted-pendulum`
are tested to be the same, step for step. Every EVERY steps, five greedy episodes in a second environment give the return.

    pip install torch==2.13.0 stable-baselines3==2.9.0 "gymnasium[mujoco]==1.2.3" mujoco==3.17.0
    python peer_curves.py curves/stable-baselines3.csv                 every curve; those already in the file are skipped
    python peer_curves.py --speed 3000 --threads 1                     environment steps per second while learning
"""

import argparse
import csv
import pathlib
import time

import gymnasium
import numpy as np
import torch
from stable_baselines3 import DDPG, TD3
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise

LEARNERS = {"td3": TD3, "ddpg": DDPG}
# Environment: steps, steps between evaluations.
TASKS = {"InvertedPendulum-v5": (20_000, 1_000), "HalfCheetah-v5": (50_000, 2_500)}
COLUMNS = ["learner", "environment", "seed", "step", "mean_return"]
EPISODES = 5


def learner(name, environment, seed):
    """The settings that the RON files beside this have; what is not named is the same by default on both sides."""
    dimensions = environment.action_space.shape[0]
    return LEARNERS[name](
        "MlpPolicy",
        environment,
        learning_rate=1e-3,
        batch_size=64,
        tau=0.005,
        gamma=0.99,
        learning_starts=1_000,
        train_freq=1,
        gradient_steps=1,
        action_noise=NormalActionNoise(np.zeros(dimensions), 0.1 * np.ones(dimensions)),
        policy_kwargs={"net_arch": [400, 300]},
        seed=seed,
        device="cpu",
    )


class Evaluation(BaseCallback):
    """Greedy episodes at fixed intervals."""

    def __init__(self, environment, every):
        super().__init__()
        self.environment = environment
        self.every = every
        self.returns = []

    def _on_step(self):
        if self.num_timesteps % self.every == 0:
            mean = np.mean([self.episode(1_000_000 + index) for index in range(EPISODES)])
            self.returns.append((self.num_timesteps, mean))
            print(f"  step {self.num_timesteps}: {mean:.1f}", flush=True)
        return True

    def episode(self, seed):
        observation, _ = self.environment.reset(seed=seed)
        total, ended = 0.0, False
        while not ended:
            action, _ = self.model.predict(observation, deterministic=True)
            observation, reward, terminated, truncated, _ = self.environment.step(action)
            total += reward
            ended = terminated or truncated
        return total


def curves(path, seeds):
    """Appends each curve when it is complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    done = set()
    if path.exists():
        with path.open(newline="") as file:
            done = {(row["learner"], row["environment"], row["seed"]) for row in csv.DictReader(file)}
    else:
        path.write_text(",".join(COLUMNS) + "\n")
    for seed in seeds:
        for task, (steps, every) in TASKS.items():
            for name in LEARNERS:
                if (name, task, str(seed)) in done:
                    continue
                print(f"{name} on {task}, seed {seed}", flush=True)
                evaluation = Evaluation(gymnasium.make(task), every)
                learner(name, gymnasium.make(task), seed).learn(steps, callback=evaluation)
                with path.open("a", newline="") as file:
                    rows = csv.writer(file, lineterminator="\n")
                    rows.writerows([name, task, seed, step, f"{mean:.3f}"] for step, mean in evaluation.returns)


def speed(steps):
    """Steps per second after the first 1,000, which are random and teach nothing."""
    for name in LEARNERS:
        model = learner(name, gymnasium.make("HalfCheetah-v5"), 0)
        model.learn(1_000)
        start = time.perf_counter()
        model.learn(steps, reset_num_timesteps=False)
        print(f"{name} {steps / (time.perf_counter() - start):.1f}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("csv", nargs="?", type=pathlib.Path, help="where the curves are kept")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--speed", type=int, metavar="STEPS", help="measure the speed instead")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    if arguments.speed:
        speed(arguments.speed)
    elif arguments.csv:
        curves(arguments.csv, arguments.seeds)
    else:
        parser.error("name a CSV file, or --speed")


if __name__ == "__main__":
    main()
