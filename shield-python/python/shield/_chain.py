"""What is inside a chain of wrappers, as far as a shield must know it."""

from __future__ import annotations

import copy
import itertools
import warnings
from collections.abc import Iterator
from typing import Any, SupportsFloat

import gymnasium

from ._shield import ShieldWarning

#: Starts that the reset task is shown where they cost nothing: with 19 and the first it can tell how far they scatter.
SIMULATED_STARTS = 20


def is_simulated(env: gymnasium.Env[Any, Any]) -> bool:
    """Whether the environment is one that Gymnasium brings itself. They are all simulators, in which a reset costs nobody's time."""
    entry = env.spec.entry_point if env.spec is not None else None
    return isinstance(entry, str) and entry.startswith("gymnasium.envs.")


class _Still(gymnasium.Env[Any, Any]):
    """An environment that does not move: what is left of one for a clock to count."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        return None, {}

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        return None, 0.0, False, False, {}


def without_time_limits(env: gymnasium.Env[Any, Any]) -> tuple[gymnasium.Env[Any, Any], int | None]:
    """The environment without the wrappers that end episodes by the clock, since a reset agent goes on from there; and the shortest of their limits."""
    limits: list[int] = []
    while isinstance(env, gymnasium.wrappers.TimeLimit):
        limits.append(steps_of(env))
        env = env.env
    outer = env
    while isinstance(outer, gymnasium.Wrapper):
        if isinstance(outer.env, gymnasium.wrappers.TimeLimit):
            limits.append(steps_of(outer.env))
            outer.env = outer.env.env
        else:
            outer = outer.env
    return env, min(limits, default=None)


def time_limit(env: gymnasium.Env[Any, Any]) -> int | None:
    """The shortest limit of the wrappers that end episodes by the clock; they stay."""
    limits: list[int] = []
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, gymnasium.wrappers.TimeLimit):
            limits.append(steps_of(env))
        env = env.env
    return min(limits, default=None)


def steps_of(limit: gymnasium.wrappers.TimeLimit[Any, Any]) -> int:
    """The steps after which a time limit ends an episode."""
    clock = copy.copy(limit)
    clock.env = _Still()
    clock.reset()
    return next(step for step in itertools.count(1) if clock.step(None)[3])


def wrappers_of(env: gymnasium.Env[Any, Any]) -> Iterator[gymnasium.Wrapper[Any, Any, Any, Any]]:
    """The wrappers around an environment, the outermost first."""
    while isinstance(env, gymnasium.Wrapper):
        yield env
        env = env.env


def refuse_misfits(env: Any, has_reset_policy: bool) -> None:
    """Raises TypeError or ValueError where an environment cannot be shielded as it is, with what to do instead."""
    if isinstance(env, gymnasium.vector.VectorEnv) or hasattr(env, "num_envs"):
        raise TypeError(
            f"{type(env).__name__} is a vector of environments; a shield is around one. Put it around each, where it is made:"
            " gymnasium.vector.SyncVectorEnv([lambda: shield.ShieldedEnv(make())]), or with Stable-Baselines3"
            " make_vec_env(make, wrapper_class=shield.ShieldedEnv)"
        )
    if not isinstance(env, gymnasium.Env):
        raise TypeError(
            f"{type(env).__name__} is not a gymnasium.Env; shimmy or `gymnasium.make` can make one of environments of older or other libraries"
        )
    names = [type(wrapper).__name__ for wrapper in wrappers_of(env)]
    if type(env.unwrapped).__module__.split(".")[0] == "safety_gymnasium" and SAFETY_WRAPPER not in names:
        raise TypeError(f"an environment of safety-gymnasium gives six values for a step. {SIX_VALUES}")
    if any(isinstance(wrapper, gymnasium.wrappers.ClipAction) for wrapper in wrappers_of(env)):
        raise ValueError(
            "ClipAction inside the shield makes the action space infinite. Put ClipAction around the shield,"
            " gymnasium.wrappers.ClipAction(shield.ShieldedEnv(env)), or leave it out and give clip=True"
        )
    if env.has_wrapper_attr("action_masks") and not has_reset_policy:
        raise ValueError(
            "the environment has action masks (`action_masks`), and a reset agent that learns does not know them: it may choose a masked"
            " action. Give `reset_policy`, a function that keeps to them"
        )


def warn_of_drift(env: gymnasium.Env[Any, Any], stacklevel: int) -> None:
    """Warns where observations mean something else as time goes by."""
    if any(isinstance(wrapper, gymnasium.wrappers.NormalizeObservation) for wrapper in wrappers_of(env)):
        text = (
            "NormalizeObservation is inside the shield: `in_reset_set`, `reset_reward` and the reset agent see normalised numbers, whose meaning"
            " drifts while its statistics change. Put it around: gymnasium.wrappers.NormalizeObservation(shield.ShieldedEnv(env))"
        )
        warnings.warn(ShieldWarning(f"{text} [normalised-inside]", "normalised-inside"), stacklevel=stacklevel + 1)


SAFETY_WRAPPER = "SafetyGymnasium2Gymnasium"
SIX_VALUES = f"safety_gymnasium.wrappers.{SAFETY_WRAPPER} around it makes five of them; put the shield around that"


def five(values: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
    """What a step gave. Raises ValueError if that is not the five values of Gymnasium."""
    if not isinstance(values, tuple) or len(values) != 5:
        number = len(values) if isinstance(values, (tuple, list)) else 1
        remedy = {6: SIX_VALUES, 4: "shimmy.GymV21CompatibilityV0 makes five of the four of an older Gym"}.get(number, "")
        raise ValueError(f"the step of the environment gave {number} values, not the five of Gymnasium. {remedy}".strip())
    return values


class Simulation:
    """Sees when MuJoCo has reset a simulation by itself, which it does after numbers that are not finite or too large, and goes on from the start."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        self._env = env.unwrapped
        self._before = self._read()

    def begin(self) -> None:
        """A step comes, or nothing is known of the time before."""
        self._before = self._read()

    def has_exploded(self) -> bool:
        """Whether MuJoCo has reset it since `begin`."""
        before, now = self._before, self._read()
        return before is not None and now is not None and (now[0] < before[0] or now[1] > before[1])

    def _read(self) -> tuple[float, int] | None:
        """The time, and the warnings of bad positions, velocities and accelerations, each of which comes with a reset."""
        data = getattr(self._env, "data", None)
        if type(data).__module__.split(".")[0] != "mujoco":
            return None
        import mujoco

        kinds = mujoco.mjtWarning
        bad = (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)
        return float(data.time), sum(int(data.warning[int(kind)].number) for kind in bad)
