"""What torch makes of twelve updates of our learners: writes `torch_reference.json`, with which their tests are compared.

Needs torch. Everything is computed in double precision, by torch's own layers, densities and optimisers; batches, noise and initial weights come
from one formula, which the tests repeat. `cargo xtask test --python` computes it again and compares it with the file.
"""

import json
import math
import pathlib

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


class Pcg64:
    """PCG XSL RR 128/64 (O'Neill 2014), as Rust's `rand_pcg` has it."""

    def __init__(self, state, stream):
        self.increment = (stream << 1) | 1
        self.state = state + self.increment
        self.draw()

    def draw(self):
        self.state = (self.state * 0x2360ED051FC65DA44385DF649FCCF645 + self.increment) % 2**128
        rotation, low = self.state >> 122, (self.state >> 64 ^ self.state) % 2**64
        return (low >> rotation | low << (64 - rotation)) % 2**64


def dropout_factors(generator, probability, width):
    """Four of 16 bits from each number of 64, the lowest first."""
    bits = []
    while len(bits) < ROWS * width:
        number = generator.draw()
        bits += [number >> shift & 0xFFFF for shift in (0, 16, 32, 48)]
    threshold = round(probability * 65536)
    kept = 65536 / (65536 - threshold)
    return torch.tensor([0.0 if value < threshold else kept for value in bits]).view(ROWS, width)


class BatchRenorm(nn.Module):
    """Ioffe 2017, algorithm 1; r and d are 1 and 0 before the warm-up is over."""

    MOMENTUM, WARM_UP, EPSILON = 0.9, 2, 1e-3

    def __init__(self, features):
        super().__init__()
        self.weight, self.bias = nn.Parameter(torch.ones(features)), nn.Parameter(torch.zeros(features))
        self.mean, self.variance, self.steps = torch.zeros(features), torch.ones(features), 0

    def forward(self, x, learns):
        running = (self.variance + self.EPSILON).sqrt()
        if not learns:
            return self.weight * (x - self.mean) / running + self.bias
        mean, variance = x.mean(0), x.var(0, unbiased=False)
        deviation = (variance + self.EPSILON).sqrt()
        normal = (x - mean) / deviation
        if self.steps >= self.WARM_UP:
            r = (deviation / running).clamp(1 / 3, 3).detach()
            d = ((mean - self.mean) / running).clamp(-5, 5).detach()
            normal = normal * r + d
        self.mean = self.mean.lerp(mean.detach(), 1 - self.MOMENTUM)
        self.variance = self.variance.lerp(variance.detach(), 1 - self.MOMENTUM)
        self.steps += 1
        return self.weight * normal + self.bias


class Network(nn.Module):
    """Hidden layers with ReLU; the action is concatenated with the input of the first (`join` 0) or of the second."""

    def __init__(self, seed, outputs, actions=0, join=0, tanh=False, layer_norm=False, renorm=False):
        super().__init__()
        self.join, self.tanh = join, tanh
        self.layers, self.norms, self.renorms = nn.ModuleList(), nn.ModuleList(), nn.ModuleList()
        inputs = OBSERVATION
        for index, width in enumerate(HIDDEN + [outputs]):
            rows = inputs + (actions if index == join else 0)
            self.layers.append(nn.Linear(rows, width))
            if renorm:
                self.renorms.append(BatchRenorm(rows))
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

    def forward(self, observations, actions=None, factors=None, learns=False):
        """`factors`: what dropout multiplies the hidden layers' sums by. `learns`: by the statistics of the batch."""
        x = observations
        for index, layer in enumerate(self.layers):
            if actions is not None and index == self.join:
                x = torch.cat([x, actions], 1)
            x = layer(self.renorms[index](x, learns) if self.renorms else x)
            if factors:
                x = x * factors[index] if index < len(HIDDEN) else x
            if index < len(HIDDEN):
                x = torch.relu(self.norms[index](x) if self.norms else x)
        return torch.tanh(x) if self.tanh else x

    def flat(self):
        """As ours: per layer the weights (inputs × outputs), the bias, scale and shift of a layer norm, scale, shift and statistics of a renorm."""
        parts = []
        for index, layer in enumerate(self.layers):
            parts += [layer.weight.T.flatten(), layer.bias]
            if index < len(self.norms):
                parts += [self.norms[index].weight, self.norms[index].bias]
            if self.renorms:
                renorm = self.renorms[index]
                parts += [renorm.weight, renorm.bias, renorm.mean, renorm.variance]
        return torch.cat([part.detach().flatten() for part in parts])


def optimiser(networks, weight_decay, beta1=0.9):
    """AdamW; only matrices decay."""
    parameters = [parameter for network in networks for parameter in network.parameters()]
    groups = [
        {"params": [p for p in parameters if p.dim() == 2], "weight_decay": weight_decay},
        {"params": [p for p in parameters if p.dim() < 2], "weight_decay": 0.0},
    ]
    return torch.optim.AdamW(groups, lr=RATE, betas=(beta1, 0.999))


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


def squared(critics, b, target, factors=None):
    values = [critic(b["observations"], b["actions"], factors)[:, 0] for critic in critics]
    return sum((0.5 * (value - target) ** 2).mean() for value in values)


def deterministic(twins, join, layer_norm=False, weight_decay=0.0, dropout=0.0):
    """DDPG with one critic; TD3 without noise and delay with two. With dropout, one critic that the action enters at the second layer."""
    seeds = Pcg64(1, 2)
    build = lambda seed: Network(seed, 1, ACTION, join, layer_norm=layer_norm)
    critics, target_critics = ([build(seed + 1) for seed in range(twins)] for _ in range(2))
    actor, target_actor = (Network(9, ACTION, join=-1, tanh=True) for _ in range(2))
    critic_step, actor_step = optimiser(critics, weight_decay), optimiser([actor], weight_decay)
    for update in range(UPDATES):
        b = batch(update)
        next_action = target_actor(b["next_observations"])
        next_factors, factors, policy_factors = None, None, None
        if dropout:
            generator = Pcg64(seeds.draw(), 0)
            draw = lambda layer: dropout_factors(generator, dropout, HIDDEN[layer])
            next_factors, factors = [draw(0), draw(1)], [draw(0), draw(1)]
            # The first layer depends on the observation alone, and is computed once.
            policy_factors = [factors[0], draw(1)]
        next_values = [critic(b["next_observations"], next_action, next_factors)[:, 0] for critic in target_critics]
        target = targets(b, torch.stack(next_values).amin(0))
        ascent = -critics[0](b["observations"], actor(b["observations"]), policy_factors).mean()
        gradient = torch.autograd.grad(ascent, list(actor.parameters()))
        descend(critic_step, squared(critics, b, target, factors))
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


def crossq():
    critics = [Network(seed + 1, 1, ACTION, 0, renorm=True) for seed in range(2)]
    actor = Network(9, 2 * ACTION, join=-1, renorm=True)
    log_temperature = nn.Parameter(torch.tensor(math.log(0.5)))
    critic_step, actor_step = optimiser(critics, 0.0, beta1=0.5), optimiser([actor], 0.0, beta1=0.5)
    temperature_step = torch.optim.Adam([log_temperature], lr=RATE)
    for update in range(UPDATES):
        b, temperature = batch(update), log_temperature.exp().detach()
        with torch.no_grad():
            next_action, next_log = policy(actor(b["next_observations"]), b["next_noise"])
        observations = torch.cat([b["observations"], b["next_observations"]])
        actions = torch.cat([b["actions"], next_action])
        values = torch.stack([critic(observations, actions, learns=True)[:, 0] for critic in critics])
        target = targets(b, values[:, ROWS:].amin(0) - temperature * next_log)
        loss = (0.5 * (values[:, :ROWS] - target) ** 2).mean(1).sum()
        parameters = [parameter for critic in critics for parameter in critic.parameters()]
        gradient = torch.autograd.grad(loss, parameters)
        if (update + 1) % 3 == 0:
            action, log = policy(actor(b["observations"], learns=True), b["noise"])
            ascent = torch.stack([critic(b["observations"], action)[:, 0] for critic in critics]).amin(0)
            descend(actor_step, (temperature * log - ascent).mean())
            descend(temperature_step, -(log_temperature * (log.detach() - ACTION)).mean())
        for parameter, value in zip(parameters, gradient):
            parameter.grad = value
        critic_step.step()
    return {**state(critics, [], actor), "log_temperature": log_temperature.item()}


def state(critics, target_critics, actor):
    flat = lambda networks: [round(value, 9) for network in networks for value in network.flat().tolist()]
    targets = {"targets": flat(target_critics)} if target_critics else {}
    return {"critics": flat(critics), **targets, "actor": flat([actor])}


CASES = {
    "ddpg": lambda: deterministic(1, 1),
    "td3": lambda: deterministic(2, 0),
    "sac": lambda: sac(),
    "crossq": lambda: crossq(),
    "ddpg-regularised": lambda: deterministic(1, 1, layer_norm=True, weight_decay=0.1, dropout=0.25),
    "td3-regularised": lambda: deterministic(2, 0, layer_norm=True, weight_decay=0.1),
    "sac-regularised": lambda: sac(1, layer_norm=True, weight_decay=0.1),
}

if __name__ == "__main__":
    path = pathlib.Path(__file__).with_suffix(".json")
    lines = [f'"{name}": {json.dumps(case())}' for name, case in CASES.items()]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n")
