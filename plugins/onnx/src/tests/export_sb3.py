"""Exports policies of Stable-Baselines3 as README.md says, and writes down what they do: python export_sb3.py FOLDER

They are untrained, with weights large enough that their actions reach the bounds.
"""

import json
import pathlib
import sys

import gymnasium
import numpy
import torch
from gymnasium import spaces
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3

BOX = spaces.Box(numpy.array([-1, -4], numpy.float32), numpy.array([3, 4], numpy.float32))


class World(gymnasium.Env):
    observation_space = spaces.Box(-numpy.inf, numpy.inf, (3,), numpy.float32)

    def __init__(self, action_space):
        self.action_space = action_space


class Exported(torch.nn.Module):
    def __init__(self, network, **arguments):
        super().__init__()
        self.network, self.arguments = network, arguments

    def forward(self, observation):
        return self.network(observation, **self.arguments)


def actor(model):
    return model.policy.actor


def policy(model):
    return model.policy


# Else the exporter does not follow what PPO and A2C do: it cannot tell whether the check passes.
torch.distributions.Distribution.set_default_validate_args(False)


def main(folder):
    cases = [
        (PPO, BOX, policy, {"deterministic": True}, "Actions"),
        (A2C, BOX, policy, {"deterministic": True}, "Actions"),
        (SAC, BOX, actor, {"deterministic": True}, "Normalised"),
        (TD3, BOX, actor, {}, "Normalised"),
        (DDPG, BOX, actor, {}, "Normalised"),
        (PPO, spaces.Discrete(4), policy, {"deterministic": True}, "Actions"),
        (DQN, spaces.Discrete(4), lambda model: model.q_net, {}, "Actions"),
    ]
    observations = numpy.random.default_rng(0).normal(0, 2, (8, 3)).astype(numpy.float32)
    described = []
    for algorithm, action_space, part, arguments, output in cases:
        model = algorithm("MlpPolicy", World(action_space), seed=0, device="cpu")
        with torch.no_grad():
            for weights in model.policy.parameters():
                weights += 0.1 * torch.randn_like(weights)
        name = f"{algorithm.__name__}-{type(action_space).__name__}"
        network = Exported(part(model), **arguments).eval()
        torch.onnx.export(network, (torch.zeros(1, 3),), folder / f"{name}.onnx", input_names=["observation"])
        actions = [numpy.atleast_1d(model.predict(seen, deterministic=True)[0]).tolist() for seen in observations]
        described.append({"name": name, "output": output, "observations": observations.tolist(), "actions": actions})
    (folder / "expected.json").write_text(json.dumps(described))


main(pathlib.Path(sys.argv[1]))
