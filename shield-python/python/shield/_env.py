"""The shield as a Gymnasium wrapper."""

from __future__ import annotations

import copy
import itertools
import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, SupportsFloat

import gymnasium
from gymnasium.utils import RecordConstructorArgs

from ._report import figures_of, text_of
from ._settings import Settings
from ._shield import Decision, Shield, told

if TYPE_CHECKING:
    from typing_extensions import Unpack


class ShieldedEnv(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """An environment in which any agent is shielded and need not know.

    A step whose action is aborted is not executed: the observation is as before, the reward is `abort_reward`, `truncated` is True. The next `reset()` lets
    the reset agent undo what was done; the environment itself is reset only when that fails `reset_attempts` times in a row, when it has
    terminated or truncated itself, or when `reset` is given a seed or options.

    `TimeLimit`s inside are taken out; the wrapper counts in their place, and begins anew with each reset.

    `info["shield"]` of a step has the keys `verdict`, `proposed`, `executed`, `reset_value`, `undo_probability`, `rule`, `cause` and `reason`, as in
    `Decision`; of an aborted step `executed` is NaN, or for a Discrete action space one less than its first action. `info["shield"]` of a reset has `hard_reset` and `steps`, those of the
    reset agent.

    Two arguments are its own:

    - `abort_reward`: the reward of a step that was aborted.
    - `is_irreversible(observation)` says, as a bool, whether there is no way back from there. It changes nothing; entries into such states are counted, in the
      steps of both agents.

    The other arguments are those of `Shield`, where each is explained. Two of them have other defaults here if there is no `config`: `episode_length` is the time
    limit of the environment if it has one, and `calibration_resets` is 20 for the environments that Gymnasium brings itself, which are simulators.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        reset_reward: Callable[[Any], float] | None = None,
        in_reset_set: Callable[[Any], bool] | None = None,
        config: str | os.PathLike[str] | None = None,
        *,
        abort_reward: float = 0.0,
        is_irreversible: Callable[[Any], bool] | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        settings |= {"reset_reward": reset_reward, "in_reset_set": in_reset_set, "config": config}
        own = {"abort_reward": abort_reward, "is_irreversible": is_irreversible}
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, **own, **settings)
        if is_irreversible is not None and not callable(is_irreversible):
            raise TypeError(f"is_irreversible is {is_irreversible!r}, not a function of an observation")
        env, self._limit = without_time_limits(env)
        gymnasium.Wrapper.__init__(self, env)
        if settings.get("episode_length") is None and config is None and self._limit is not None:
            settings["episode_length"] = self._limit
        is_free = config is None and settings["reset_reward"] is None and settings["in_reset_set"] is None
        if settings.get("calibration_resets") is None and is_free and is_simulated(env):
            settings["calibration_resets"] = SIMULATED_STARTS
        self.abort_reward = float(abort_reward)
        #: The shield itself.
        self.shield = Shield(env.observation_space, env.action_space, **settings)
        self._observation: Any = None
        self._is_irreversible = is_irreversible

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Executes the action, as proposed or altered, if the shield allows it; `info["shield"]` says what it decided.

        Where it is aborted, nothing is executed: the observation is as before, the reward is `abort_reward`, `truncated` is True. Raises `ResetNeeded` where
        `reset()` must come first, and ValueError if the action's shape or dtype is wrong; nothing is executed then either.
        """
        shield = self.shield
        if not shield.placed or shield.resetting or shield.needs_hard_reset:
            raise gymnasium.error.ResetNeeded(self._why_not())
        decision = shield.decide(action)
        if not decision.allowed:
            return self._observation, self.abort_reward, False, True, {"shield": explained(decision, shield.no_action)}
        observation, reward, terminated, truncated, info = self._execute(decision.action)
        info["shield"] = explained(decision, decision.action)
        is_over = self._limit is not None and shield.episode_length >= self._limit
        return observation, reward, terminated, truncated or is_over, info

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Lets the reset agent act until the environment is as at its start; only if that fails, the environment itself is reset.

        It is reset at once if it is given a seed or options, even empty ones, if it has ended, or if a step was interrupted. `info["shield"]` says which it
        was, and how many steps the reset agent made.
        """
        shield, steps = self.shield, 0
        if shield.placed and seed is None and options is None:
            steps = self._undo()
            if not shield.needs_hard_reset:
                return self._observation, {"shield": {"hard_reset": False, "steps": steps}}
        self._calibrate(seed, options)
        if shield.placed:
            # If the environment's own reset raises, another must follow.
            shield.require_hard_reset(requested=True)
        observation, info = self.env.reset(seed=seed, options=options)
        info = {**info, "shield": {"hard_reset": True, "steps": steps}}
        shield.hard_reset_done(observation)
        self._observation = observation
        return observation, info

    def run(self, policy: Callable[[Any], Any], steps: int, *, seed: int | None = None) -> list[float]:
        """Lets a finished policy, a function from observation to action, act for so many steps. Returns the return of each episode; the last may
        be cut short."""
        returns: list[float] = []
        is_over = True
        for _ in range(steps):
            if is_over:
                observation, _ = self.reset(seed=None if returns else seed)
                returns.append(0.0)
            observation, reward, terminated, truncated, _ = self.step(policy(observation))
            returns[-1] += float(reward)
            is_over = terminated or truncated
        return returns

    def metrics(self) -> dict[str, float]:
        """Counts since the beginning, and the reset agent's figures; with `is_irreversible` also `irreversible_entries`."""
        counted = self.shield.metrics()
        if self._is_irreversible is not None:
            counted["irreversible_entries"] = float(self.shield.irreversible_entries)
        return counted

    def report(self, *, as_dict: bool = False) -> str | dict[str, Any]:
        """Says in a few lines what the shield has done so far, what it cost, and whether it helps.

        `as_dict` gives the figures by name; those that are not known are None.
        """
        shield = self.shield
        risk = shield.accepted_risk, shield.accepted_hard_resets_per_1000
        counted = self.metrics()
        # One that is under way has no outcome yet.
        counted["reset_episodes"] -= shield.resetting
        figures = figures_of(counted, *risk, self._limit, self.findings())
        return figures if as_dict else text_of(figures)

    def findings(self) -> list[tuple[str, str]]:
        """What keeps the shield from helping, as `Shield.findings`."""
        return self.shield.findings()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes everything that the shield has learned and counted into a file, as `Shield.save`."""
        self.shield.save(path)

    def load(self, path: str | os.PathLike[str]) -> None:
        """Goes on from a file, as `Shield.load`. The next `reset` is the environment's own; what `calibration_resets` were for is in the file."""
        self.shield.load(path)

    def close(self) -> None:
        """Closes the environment, and writes what waits in memory of the `record`."""
        try:
            super().close()
        finally:
            self.shield.close()

    def _calibrate(self, seed: int | None, options: dict[str, Any] | None) -> None:
        """Before the first start, shows the reset task some others. The first start itself is that of its seed, with or without them."""
        for number in range(self.shield.calibration_resets):
            start, _ = self.env.reset(seed=None if seed is None else seed + 1 + number, options=options)
            self.shield.observe_start(start)

    def _execute(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        try:
            observation, reward, terminated, truncated, info = self.env.step(action)
            irreversible = self._is_irreversible is not None and told("is_irreversible", self._is_irreversible(observation))
            self.shield.observe(observation, terminated=bool(terminated), irreversible=irreversible)
            truncated, info = bool(truncated), dict(info)
            if truncated:
                # It has ended its episode by itself, and does not promise to go on from here.
                self.shield.require_hard_reset(has_ended=True)
            self._observation = observation
        except BaseException:
            # Where the environment stands is not known.
            self.shield.require_hard_reset()
            raise
        return observation, reward, terminated, truncated, info

    def _undo(self) -> int:
        """Lets the reset agent act until its episode is over; returns the number of its steps."""
        shield, steps = self.shield, 0
        shield.begin_reset()
        while shield.resetting:
            self._execute(shield.reset_action())
            steps += 1
        return steps

    def _why_not(self) -> str:
        if not self.shield.placed:
            return "call reset() before step()"
        if self.shield.hard_reset_due == "lost":
            return "the last step was interrupted, so that it is not known where the environment stands: call reset()"
        if self.shield.hard_reset_due == "requested":
            return "the last reset did not come to its end: call reset()"
        if self.shield.resetting:
            return "the last action was aborted: call reset(), which lets the reset agent undo what was done"
        return "the environment has ended, or the reset agent has given up: call reset()"


def explained(decision: Decision, executed: Any) -> dict[str, Any]:
    return {
        "verdict": decision.verdict,
        "proposed": decision.proposed,
        "executed": executed,
        "reset_value": decision.reset_value,
        "undo_probability": decision.undo_probability,
        "rule": decision.rule,
        "cause": decision.cause,
        "reason": decision.reason,
    }


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
