"""torch's side of `cargo xtask bench --peers`: the same work as our DDPG, in torch's best eager form.

Reads lines `update BATCH THREADS REPEATS` or `value THREADS REPEATS` and answers each with the seconds that every repeat took. 20
critics 400-300 with the action entering at the second layer, an actor 400-300, 18 observations, 6 actions, tanh, Huber loss: batched matrix products over
the critics, Adam with `fused=True`, target networks by one `foreach` call. The observation's share of both critic passes is computed once, as
ours does; so is the actor's gradient at the critics' weights before their step.
"""

import sys
import time

import torch
from torch.nn.functional import huber_loss

CRITICS, OBSERVATION, ACTION, HIDDEN = 20, 18, 6, (400, 300)
DISCOUNT, TAU = 0.99, 0.005


def uniform(*shape, bound):
    return torch.empty(shape).uniform_(-bound, bound).requires_grad_()


class Critics:
    """Weights of all critics, side by side."""

    def __init__(self):
        first, second = HIDDEN
        joined = (first + ACTION) ** -0.5
        self.weights = [
            uniform(CRITICS, OBSERVATION, first, bound=OBSERVATION**-0.5),
            uniform(CRITICS, 1, first, bound=OBSERVATION**-0.5),
            uniform(CRITICS, first, second, bound=joined),
            uniform(CRITICS, ACTION, second, bound=joined),
            uniform(CRITICS, 1, second, bound=joined),
            uniform(CRITICS, second, 1, bound=3e-3),
            uniform(CRITICS, 1, 1, bound=3e-3),
        ]
        self.targets = [weight.detach().clone() for weight in self.weights]


def trunk(weights, observations):
    """What depends on the observation alone: critics × batch × second layer."""
    w1, b1, w2, _, b2, _, _ = weights
    seen = torch.baddbmm(b1, observations.expand(CRITICS, -1, -1), w1).tanh()
    return torch.baddbmm(b2, seen, w2)


def head(weights, joint, actions):
    """Values, critics × batch × 1."""
    _, _, _, wa, _, w3, b3 = weights
    return torch.baddbmm(b3, torch.baddbmm(joint, actions.expand(CRITICS, -1, -1), wa).tanh(), w3)


class Learner:
    def __init__(self):
        torch.manual_seed(0)
        self.critics = Critics()
        self.actor = torch.nn.Sequential(
            torch.nn.Linear(OBSERVATION, HIDDEN[0]),
            torch.nn.Tanh(),
            torch.nn.Linear(HIDDEN[0], HIDDEN[1]),
            torch.nn.Tanh(),
            torch.nn.Linear(HIDDEN[1], ACTION),
            torch.nn.Tanh(),
        )
        self.target_actor = [weight.detach().clone() for weight in self.actor.parameters()]
        self.critic_optimiser = torch.optim.Adam(self.critics.weights, lr=1e-3, fused=True)
        self.actor_optimiser = torch.optim.Adam(self.actor.parameters(), lr=1e-4, fused=True)

    def next_actions(self, observations):
        w1, b1, w2, b2, w3, b3 = self.target_actor
        hidden = torch.addmm(b2, torch.addmm(b1, observations, w1.t()).tanh_(), w2.t()).tanh_()
        return torch.addmm(b3, hidden, w3.t()).tanh_()

    def update(self, observations, actions, rewards, next_observations, continuations):
        critics = self.critics
        with torch.no_grad():
            next_actions = self.next_actions(next_observations)
            next_values = head(critics.targets, trunk(critics.targets, next_observations), next_actions)
            targets = rewards + DISCOUNT * continuations * next_values
        joint = trunk(critics.weights, observations)
        values = head(critics.weights, joint, actions)
        # The sum over the critics of each one's mean: every critic has the gradient that it would have alone.
        loss = huber_loss(values, targets) * CRITICS
        policy_values = head(critics.weights, joint.detach(), self.actor(observations))
        ascent = torch.autograd.grad(-policy_values.mean(), list(self.actor.parameters()))
        for weight, gradient in zip(critics.weights, torch.autograd.grad(loss, critics.weights)):
            weight.grad = gradient
        for weight, gradient in zip(self.actor.parameters(), ascent):
            weight.grad = gradient
        self.critic_optimiser.step()
        self.actor_optimiser.step()
        with torch.no_grad():
            torch._foreach_lerp_(critics.targets, critics.weights, TAU)
            torch._foreach_lerp_(self.target_actor, list(self.actor.parameters()), TAU)

    @torch.inference_mode()
    def value(self, observation, action):
        return head(self.critics.weights, trunk(self.critics.weights, observation), action)


def batch(size):
    return (
        torch.rand(size, OBSERVATION),
        torch.rand(size, ACTION),
        torch.rand(size, 1),
        torch.rand(size, OBSERVATION),
        torch.ones(size, 1),
    )


def timed(work, repeats):
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return times


def main():
    learner = Learner()
    print(torch.__version__, flush=True)
    for line in sys.stdin:
        case, *numbers = line.split()
        *size, threads, repeats = map(int, numbers)
        torch.set_num_threads(threads)
        if case == "update":
            data = batch(size[0])
            times = timed(lambda: learner.update(*data), repeats)
        else:
            observation, action = torch.rand(1, OBSERVATION), torch.rand(1, ACTION)
            times = timed(lambda: learner.value(observation, action), repeats)
        print(*times, flush=True)


if __name__ == "__main__":
    main()
