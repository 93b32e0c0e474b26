"""Whether a shield can help in an environment, before anything is trained."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import gymnasium
import numpy as np

from ._core import Examination, written_at
from ._chain import time_limit
from ._env import ShieldedEnv
from ._meaning import NO_MEANING, Meaning
from ._settings import Settings, overrides, overrides_of_first_rule, refuse_unknown
from ._shield import PLUGINS
from ._spaces import Observations, actions

if TYPE_CHECKING:
    from typing_extensions import Unpack

_STARTS, _STEPS = Examination.USUAL


class Check(NamedTuple):
    """One check of an environment."""

    #: What it looked at, such as `starts`.
    name: str
    #: `ok`, `?` (it could not be told), `note`, `CHANGE` (a setting must be changed), or `CANNOT` (no setting helps).
    standing: str
    #: What was seen, with figures.
    seen: str
    #: What to do; may be empty.
    remedy: str


class Checkup(NamedTuple):
    """What `doctor` came to."""

    #: `works`, `change` (a setting must be changed first) or `cannot_help`.
    verdict: Literal["works", "change", "cannot_help"]
    #: Every check.
    checks: list[Check]
    #: Everything that was printed.
    text: str


def doctor(
    env: gymnasium.Env[Any, Any],
    reset_reward: Callable[[Any], float] | None = None,
    in_reset_set: Callable[[Any], bool] | None = None,
    config: str | os.PathLike[str] | None = None,
    *,
    steps: int = _STEPS,
    starts: int = _STARTS,
    verbose: bool = True,
    **settings: Unpack[Settings],
) -> Checkup:
    """Says whether a shield can help in an environment, before anything is trained, and which setting to change if not.

    The environment is reset `starts` times, and then makes `steps` random steps, with further resets where it ends; nothing is learned, and its state afterwards is
    that of the last step. What "reset" means is said by the same arguments as those of `ShieldedEnv`; of a `ShieldedEnv` they are its own. Prints each check with
    its figures and the verdict, if `verbose`.

        shield.doctor(gymnasium.make("Pendulum-v1"))
    """
    if isinstance(env, ShieldedEnv):
        given = {name: value for name, value in env._saved_kwargs.items() if name in Settings.__annotations__}
        settings = {**given, **settings}
        reset_reward = reset_reward or given.get("reset_reward")
        in_reset_set = in_reset_set or given.get("in_reset_set")
        config = config or given.get("config")
        env = env.env
    settings |= {"reset_reward": reset_reward, "in_reset_set": in_reset_set, "config": config}
    refuse_unknown(settings)
    meaning, limit = Meaning(settings), time_limit(env)
    observations, form = Observations(env.observation_space), actions(env.action_space).form
    sets = overrides(settings)
    if meaning.is_told:
        sets.insert(0, ("reset_task", "None", "reset_reward and in_reset_set"))
    is_discrete = isinstance(form, int)
    sets += overrides_of_first_rule(settings, lambda path: written_at(config, is_discrete, sets, path))
    bounds = observations.low.tolist(), observations.high.tolist()
    examination = Examination(bounds, form, config, sets, PLUGINS)
    if not meaning.is_told and not examination.has_reset_task:
        raise ValueError(NO_MEANING)
    seen = observations.empty()

    def look(observation: Any) -> bool | None:
        observations.write(observation, seen)
        signal = meaning.signal(observation) if np.isfinite(seen).all() else None
        return signal and signal[1]

    def start(seed: int | None = None) -> None:
        observation, _ = env.reset(seed=seed)
        is_inside = look(observation)
        examination.start(seen, is_inside)

    seed = settings.get("seed") or 0
    env.action_space.seed(seed)
    for number in range(starts):
        start(None if number else seed)
    made = 0
    while made < steps:
        start()
        examination.walk()
        for length in range(1, steps - made + 1):
            observation, _, terminated, truncated, _ = env.step(env.action_space.sample())
            made += 1
            # A `TimeLimit` is taken out of a `ShieldedEnv`.
            is_own = truncated and length != limit
            examination.step(seen, look(observation), bool(terminated), bool(is_own))
            if terminated or truncated or examination.is_walk_over(length, steps):
                break
    checks, verdict, text = examination.conclude()
    if verbose:
        print(text)
    return Checkup(verdict, [Check(*check) for check in checks], text)
