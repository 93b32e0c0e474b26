"""How long the wrapper takes for a step, beside the environment itself: python overhead.py"""

import time

import gymnasium
import numpy as np
import shield
from worlds import near_start

RULE = '[(plugin: "linear-constraints", config: (constraints: [(a: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0], b: 0.5)]))]'
USUAL = {"updates_per_step": 0}
ENSEMBLE = '[(plugin: "ensemble-threshold", config: (q_min: -1e9))]'


class Nothing(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (17,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (6,), np.float32)
    seen = np.zeros(17, np.float32)

    def reset(self, *, seed=None, options=None):
        return self.seen, {}

    def step(self, action):
        return self.seen, 0.0, False, False, {}


def microseconds(env, steps=20_000, repetitions=5):
    action = np.zeros(6, np.float32)
    env.reset()
    times = []
    for _ in range(repetitions):
        start = time.perf_counter()
        for _ in range(steps):
            env.step(action)
        times.append((time.perf_counter() - start) / steps * 1e6)
    return min(times)


def main():
    simple = {"overrides": {"shield.rules": RULE}, "warm_up_steps": 0, "updates_per_step": 0}
    bare = microseconds(Nothing())
    for name, arguments in {
        "a rule without an ensemble": simple,
        "the same, calibrated-start judging": {**simple, "in_reset_set": None},
        "five critics 64-64, not learning": {
            **simple,
            "overrides": {"shield.rules": ENSEMBLE, "reset.config.critics": 5},
        },
        "the usual settings, not learning": USUAL,
    }.items():
        env = shield.ShieldedEnv(Nothing(), **{"in_reset_set": near_start, **arguments})
        print(f"{name}: {microseconds(env) - bare:.1f} µs a step")


if __name__ == "__main__":
    main()
