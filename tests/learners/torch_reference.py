"""What torch makes of twelve updates of our learners: writes `torch_reference.json`, with which their tests are compared.

`cargo xtask test --torch` calls it and compares what it writes with the file that is kept. Needs torch. Everything is computed in double precision,
by torch's own layers, densities and optimisers; batches, noise and initial weights come from one formula, which the tests repeat.
"""

import json
import math
import pathlib
import sys

import torch
from torch import nn
from torch.distributions import Normal, TransformedDistribution
from torch.distributions.transforms import TanhTransform

OBSERVATION, ACTION, ROWS, UPDATES = 3, 2, 8, 12
HIDDEN = [8, 6]
DISCOUNT, TAU, RATE = 0.99, 0.005, 1e-3
torch.set_default_dtype(torch.float64)


def number(index, seed):
    """In [-1, 1), the same in every language."""
    return ((index * 2654435761 + seed * 40503 + 12345) % 4294967296 // 128) % 2000 / 1000 - 1


def numbers(length, seed):
    return torch.tensor([number(index, seed) for index in range(length)]).float().double()


def batch(update):
    """Actions in [-1, 1]; the third transition ends an episode."""
    seed = 10 * update
    continuations = torch.ones(ROWS)
    continuations[2] = 0.0
    return {
        "observations": numbers(ROWS * OBSERVATION, seed + 1).view(ROWS, -1),
        "actions": numbers(ROWS * ACTION, seed + 2).view(ROWS, -1),
        "rewards": numbers(ROWS, seed + 3),
        "next_observations": numbers(ROWS * OBSERVATION, seed + 4).view(ROWS, -1),
        "continuations": continuations,
        "next_noise": numbers(ROWS * ACTION, seed + 5).view(ROWS, -1),
        "noise": numbers(ROWS * ACTION, seed + 6).view(ROWS, -1),
    }


class Network(nn.Module):
    """Hidden layers with ReLU; the action is concatenated with the input of the first (`join` 0) or of the second."""

    def __init__(self, seed, outputs, actions=0, join=0, tanh=False, layer_norm=False):
        super().__init__()
        self.join, self.tanh = join, tanh
        self.layers, self.norms = nn.ModuleList(), nn.ModuleList()
        inputs = OBSERVATION
        for index, width in enumerate(HIDDEN + [outputs]):
            rows = inputs + (actions if index == join else 0)
            self.layers.append(nn.Linear(rows, width))
            if layer_norm and index < len(HIDDEN):
                self.norms.append(nn.LayerNorm(width))
            inputs = width
        offset = 0
        with torch.no_grad():
            for parameter in self.linear():
                values = numbers(offset + parameter.numel(), seed)[offset:] * 0.5
                offset += parameter.numel()
                parameter.copy_(values.view(parameter.shape[::-1]).T if parameter.dim() == 2 else values)

    def linear(self):
        return [parameter for layer in self.layers for parameter in (layer.weight, layer.bias)]

    def forward(self, observations, actions=None):
        x = observations
        for index, layer in enumerate(self.layers):
            if actions is not None and index == self.join:
                x = torch.cat([x, actions], 1)
            x = layer(x)
            if index < len(HIDDEN):
                x = torch.relu(self.norms[index](x) if self.norms else x)
        return torch.tanh(x) if self.tanh else x

    def flat(self):
        """As ours: per layer the weights (inputs × outputs), the bias, then scale and shift of a layer norm."""
        parts = []
        for index, layer in enumerate(self.layers):
            parts += [layer.weight.T.flatten(), layer.bias]
            if index < len(self.norms):
                parts += [self.norms[index].weight, self.norms[index].bias]
        return torch.cat([part.detach().flatten() for part in parts])


def optimiser(networks, weight_decay):
    """AdamW; only matrices decay."""
    parameters = [parameter for network in networks for parameter in network.parameters()]
    groups = [
        {"params": [p for p in parameters if p.dim() == 2], "weight_decay": weight_decay},
        {"params": [p for p in parameters if p.dim() < 2], "weight_decay": 0.0},
    ]
    return torch.optim.AdamW(groups, lr=RATE)


def descend(optimiser, loss):
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()


def follow(target, network, tau):
    with torch.no_grad():
        for old, new in zip(target.parameters(), network.parameters()):
            old.lerp_(new, tau)


def policy(outputs, noise):
    """Actions of a squashed Gaussian and their log-densities."""
    mean, log = outputs.chunk(2, 1)
    normal = Normal(mean, log.clamp(-20, 2).exp())
    before = mean + normal.scale * noise
    squashed = TransformedDistribution(normal, [TanhTransform(cache_size=1)])
    action = squashed.transforms[0](before)
    return action, squashed.log_prob(action).sum(1)


def targets(b, next_values):
    return (b["rewards"] + DISCOUNT * b["continuations"] * next_values).detach()


def squared(critics, b, target):
    values = [critic(b["observations"], b["actions"])[:, 0] for critic in critics]
    return sum((0.5 * (value - target) ** 2).mean() for value in values)


def deterministic(twins, join, layer_norm=False, weight_decay=0.0):
    """DDPG with one critic; TD3 without noise and delay with two."""
    build = lambda seed: Network(seed, 1, ACTION, join, layer_norm=layer_norm)
    critics, target_critics = ([build(seed + 1) for seed in range(twins)] for _ in range(2))
    actor, target_actor = (Network(9, ACTION, join=-1, tanh=True) for _ in range(2))
    critic_step, actor_step = optimiser(critics, weight_decay), optimiser([actor], weight_decay)
    for update in range(UPDATES):
        b = batch(update)
        next_action = target_actor(b["next_observations"])
        next_values = torch.stack([critic(b["next_observations"], next_action)[:, 0] for critic in target_critics])
        target = targets(b, next_values.amin(0))
        ascent = -critics[0](b["observations"], actor(b["observations"])).mean()
        gradient = torch.autograd.grad(ascent, list(actor.parameters()))
        descend(critic_step, squared(critics, b, target))
        for parameter, value in zip(actor.parameters(), gradient):
            parameter.grad = value
        actor_step.step()
        for old, new in zip(target_critics + [target_actor], critics + [actor]):
            follow(old, new, TAU)
    return state(critics, target_critics, actor)


def sac(join=0, layer_norm=False, weight_decay=0.0):
    build = lambda seed: Network(seed, 1, ACTION, join, layer_norm=layer_norm)
    critics, target_critics = ([build(seed + 1) for seed in range(2)] for _ in range(2))
    actor = Network(9, 2 * ACTION, join=-1)
    log_temperature = nn.Parameter(torch.tensor(math.log(0.5)))
    critic_step, actor_step = optimiser(critics, weight_decay), optimiser([actor], weight_decay)
    temperature_step = torch.optim.Adam([log_temperature], lr=RATE)
    for update in range(UPDATES):
        b, temperature = batch(update), log_temperature.exp().detach()
        with torch.no_grad():
            next_action, next_log = policy(actor(b["next_observations"]), b["next_noise"])
            next_values = torch.stack([critic(b["next_observations"], next_action)[:, 0] for critic in target_critics])
        target = targets(b, next_values.amin(0) - temperature * next_log)
        action, log = policy(actor(b["observations"]), b["noise"])
        values = torch.stack([critic(b["observations"], action)[:, 0] for critic in critics])
        gradient = torch.autograd.grad((temperature * log - values.amin(0)).mean(), list(actor.parameters()))
        descend(critic_step, squared(critics, b, target))
        for parameter, value in zip(actor.parameters(), gradient):
            parameter.grad = value
        actor_step.step()
        descend(temperature_step, -(log_temperature * (log.detach() - ACTION)).mean())
        for old, new in zip(target_critics, critics):
            follow(old, new, TAU)
    return {**state(critics, target_critics, actor), "log_temperature": log_temperature.item()}


def state(critics, target_critics, actor):
    flat = lambda networks: [round(value, 9) for network in networks for value in network.flat().tolist()]
    return {"critics": flat(critics), "targets": flat(target_critics), "actor": flat([actor])}


CASES = {
    "ddpg": lambda: deterministic(1, 1),
    "td3": lambda: deterministic(2, 0),
    "sac": lambda: sac(),
}

if __name__ == "__main__":
    default = pathlib.Path(__file__).with_suffix(".json")
    path = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else default
    lines = [f'"{name}": {json.dumps(case())}' for name, case in CASES.items()]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n")
