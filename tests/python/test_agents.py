"""Agents of others train through the shield as they are."""

import gymnasium
import numpy as np
import pytest
import shield
import torch
from stable_baselines3 import DDPG, PPO, SAC, TD3
from stable_baselines3.common.env_checker import check_env
from worlds import near_start, table

torch.set_num_threads(1)
SHIELD = {
    "overrides": {"experience.batch": 16, "reset.config.random_steps": 100},
}


def small():
    # They add to what they are given.
    return {"policy_kwargs": {"net_arch": [16]}, "seed": 0}


def shielded(**arguments):
    return shield.ShieldedEnv(table(**arguments), in_reset_set=near_start, **SHIELD)


@pytest.mark.filterwarnings("ignore:.*asymmetric|.*symmetric.*:UserWarning")
@pytest.mark.parametrize("chosen", [False])
def test_the_checker_of_stable_baselines_accepts_the_wrapped_environment(chosen):
    check_env(shielded(chosen=chosen), skip_render_check=True)
    check_env(shield.ShieldedEnv(gymnasium.make("CartPole-v1")), skip_render_check=True)


@pytest.mark.parametrize(
    ("agent", "settings"),
    [
        (SAC, {"learning_starts": 20, "batch_size": 16}),
        (TD3, {"learning_starts": 20, "batch_size": 16}),
        (DDPG, {"learning_starts": 20, "batch_size": 16}),
        (PPO, {"n_steps": 64, "batch_size": 32, "n_epochs": 1}),
    ],
)
def test_an_agent_of_stable_baselines_trains(agent, settings):
    env = shielded()
    agent("MlpPolicy", env, **small(), **settings).learn(300)
    counted = env.metrics()
    assert counted["forward_steps"] + counted["early_aborts"] >= 300
    assert counted["reset_episodes"] > 3 and counted["reset/critic_loss"] >= 0.0
    assert np.isfinite(env.unwrapped.executed).all()


def test_an_agent_with_discrete_actions_trains():
    env = shield.ShieldedEnv(gymnasium.make("CartPole-v1"), **{**SHIELD, "overrides": {"experience.batch": 16}})
    PPO("MlpPolicy", env, n_steps=64, batch_size=32, n_epochs=1, **small()).learn(200)
    assert env.metrics()["hard_resets"] > 0


def test_a_loop_in_the_style_of_cleanrl_trains():
    """One file: several environments at once, statistics and clipping around them, actions from a network."""

    def make():
        env = gymnasium.wrappers.RecordEpisodeStatistics(shielded())
        return gymnasium.wrappers.ClipAction(env)

    envs = gymnasium.vector.SyncVectorEnv([make, make])
    network = torch.nn.Sequential(torch.nn.Linear(1, 16), torch.nn.Tanh(), torch.nn.Linear(16, 1))
    optimiser = torch.optim.Adam(network.parameters(), 1e-2)
    observation, _ = envs.reset(seed=1)
    finished = 0
    for _ in range(150):
        mean = network(torch.as_tensor(observation, dtype=torch.float32))
        action = torch.distributions.Normal(mean, 0.5).sample()
        observation, reward, terminated, truncated, info = envs.step(action.numpy())
        loss = -(torch.as_tensor(reward).unsqueeze(1) * -((action - mean) ** 2)).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        finished += int(np.logical_or(terminated, truncated).sum())
    assert finished > 4 and all(env.get_wrapper_attr("metrics")()["reset_episodes"] > 1 for env in envs.envs)
