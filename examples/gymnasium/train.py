"""PPO of Stable-Baselines3 in a Gymnasium environment, with the shield as it is and without: python train.py Pendulum-v1 --record Pendulum-v1.json

Every setting of the shield and of PPO is the usual one. With the shield, the steps of the reset agent count like those of PPO, so that both trainings make the same
number of steps of the environment. The file gets one entry for each training; those that it holds already are not made again.

Needs `pip install ./shield-python stable-baselines3 "gymnasium[mujoco]"`.
"""

import argparse
import json
import multiprocessing
import os
import pathlib
import warnings

import gymnasium
import numpy as np
import shield
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

#: Proposed actions for one step of the environment, at most: an agent that may do nothing at all would propose for ever.
MOST_PROPOSALS = 20


class Budget(BaseCallback):
    """Ends the training when the steps of the environment are used up."""

    def __init__(self, steps, env):
        super().__init__()
        self.steps, self.env, self.episodes = steps, env, 0

    def _on_step(self):
        self.episodes += int(self.locals["dones"][0])
        made = self.env.metrics()["steps"] if isinstance(self.env, shield.ShieldedEnv) else self.num_timesteps
        return made < self.steps


def greedily(agent, env):
    """The agent without exploration. PPO may mean an action outside of the box; Stable-Baselines3 clips it before it is executed."""
    return lambda observation: agent.predict(observation, deterministic=True)[0]


def mean_return(policy, env, episodes, guard=None):
    """Of whole episodes, each of which begins with a hard reset. Behind a shield an aborted action gives way to those of the reset agent, which goes on until it is
    back at the start, within the same episode."""
    env, limit = env, env.spec.max_episode_steps
    returns = []
    for episode in range(episodes):
        observation, _ = env.reset(seed=1_000 + episode)
        if guard is not None:
            guard.hard_reset_done(observation)
        total = 0.0
        for _ in range(limit):
            action = policy(observation)
            if guard is not None:
                action = guard.filter(observation, action).action
            observation, reward, terminated, truncated, _ = env.step(action)
            total += float(reward)
            if terminated or truncated:
                break
            if guard is not None:
                guard.observe(observation)
                if guard.needs_hard_reset:
                    # Nothing may move any more: what is left of the episode earns nothing.
                    break
        returns.append(total)
    return float(np.mean(returns))


def train(env_id, seed, is_shielded, steps, episodes):
    """One training, and what it came to."""
    torch.set_num_threads(1)
    env = gymnasium.make(env_id)
    run = {"seed": seed, "shielded": is_shielded, "findings": []}
    if is_shielded:
        env = shield.ShieldedEnv(env, seed=seed)

        def note(message, category, *_):
            if isinstance(message, shield.ShieldWarning):
                step = int(env.metrics()["steps"])
                run["findings"].append({"name": message.name, "step": step, "text": str(message)})

        warnings.showwarning = note
        warnings.simplefilter("always", shield.ShieldWarning)
    budget = Budget(steps, env)
    agent = PPO("MlpPolicy", env, seed=seed, device="cpu")
    agent.learn(MOST_PROPOSALS * steps, callback=budget)
    policy, bare = greedily(agent, env), gymnasium.make(env_id)
    if not is_shielded:
        made = agent.num_timesteps
        return run | {"steps": made, "hard_resets": budget.episodes, "return": mean_return(policy, bare, episodes)}
    report = env.report(as_dict=True)
    figures = ["steps", "forward_steps", "episodes", "hard_resets", "aborts", "attempts", "reset_successes", "realised_risk", "accepted_risk", "verdict"]
    run |= {name: report[name] for name in figures}
    # The resets of the evaluation are no matter of the training.
    warnings.simplefilter("ignore", shield.ShieldWarning)
    run["return_without_shield"] = mean_return(policy, bare, episodes)
    run["return"] = mean_return(policy, bare, episodes, env.shield)
    return run


def write(path, record):
    """In one step: an interruption leaves the old file as it was."""
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(record, indent=1) + "\n")
    os.replace(partial, path)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("environment", help="as gymnasium.make has it")
    parser.add_argument("--record", type=pathlib.Path, required=True, help="the file for the results, a JSON")
    parser.add_argument("--seeds", default="0,1,2", help="one training with the shield and one without for each (default: 0,1,2)")
    parser.add_argument("--steps", type=int, default=20_000, help="steps of the environment for each (default: 20000)")
    parser.add_argument("--episodes", type=int, default=5, help="greedy episodes at the end of each (default: 5)")
    parser.add_argument("--jobs", type=int, default=2, help="how many trainings at the same time (default: 2)")
    arguments = parser.parse_args()
    path, env_id, steps = arguments.record, arguments.environment, arguments.steps
    record = {"environment": env_id, "steps": steps, "runs": []}
    if path.exists():
        record = json.loads(path.read_text())
        if record["steps"] != steps:
            parser.error(f"{path} holds trainings of {record['steps']} steps: give --steps {record['steps']}, or another --record")
    known = {(run["seed"], run["shielded"]) for run in record["runs"]}
    wanted = [(int(seed), is_shielded) for seed in arguments.seeds.split(",") for is_shielded in (True, False)]
    missing = [run for run in wanted if run not in known]
    with multiprocessing.get_context("spawn").Pool(arguments.jobs) as pool:
        trainings = [pool.apply_async(train, (env_id, *run, steps, arguments.episodes)) for run in missing]
        for number, training in enumerate(trainings, 1):
            run = training.get()
            record["runs"].append(run)
            record["runs"].sort(key=lambda run: (run["seed"], not run["shielded"]))
            write(path, record)
            variant = "with the shield" if run["shielded"] else "without"
            print(
                f"{env_id}, seed {run['seed']} {variant}: return {run['return']:.1f}, {run['hard_resets']} hard resets"
                f" ({number} of {len(missing)})",
                flush=True,
            )


if __name__ == "__main__":
    main()
